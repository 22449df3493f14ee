"""One token of the source is made wrong at a time; the tests that touch it are to find it.

    python tests/mutation.py                                      all modules that a test names
    python tests/mutation.py units/reading.py --most 40 --seed 1  a sample of one file: of 40 in evidence, budgeting, units
                                                                  and march/events 34 are to be found
    python tests/mutation.py march/events/root_finding.py --lines 38 40        all mutants of some lines
    python tests/mutation.py keywords.py --tests "test_keywords.py -k not chosen" test_settings.py

The tests of a module are those given, the quickest first, each perhaps with a choice as for -k; else all that import it.

A mutant is compiled in memory and takes the place of its module in a forked process: no file is ever changed, and the
libraries are imported once. Tests that start processes of their own do not see it. What is compiled by numba runs as
plain Python here; what prints laws prints each anew, and none is kept. Lines of a program that stand in a text, as
those of step control, are made wrong like the source's own. A mutant that makes the tests hang is found. A file's own doctests are tried before its tests. What
only guards (`strict` of a zip whose parts are equally long) or is only shown (`repr` of a field) is left as it is.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType
from typing import Any

HERE = Path(__file__).parent
SOURCE = HERE.parent / "src" / "xdynamics"
IMPORTED = (
    "pytest",
    "hypothesis",
    "numpy",
    "xarray",
    "dask.array",
    "netCDF4",
    "numba",
    "llvmlite.binding",
    "scipy.interpolate",
    "pandas",
)
AGAIN = "-Wignore::pytest.PytestAssertRewriteWarning"  # a second call of pytest finds its plugins imported
EXAMPLES = (
    "--assert=plain",
    "-opython_classes=",
    "-opython_functions=",
)  # doctests of a module, and no tests of its own
MEMORY = 8 << 30
PATIENCE = 5.0  # times what the tests take on the source as it is
LEAST = 5.0  # s of the processor that a group of tests may have in any case

PLAIN = ("march/", "kernels/drive_tables", "kernels/linear", "dynamics/growth")  # what numba compiles

ORDER = {ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt), ast.GtE: (ast.Gt, ast.Lt)}
EQUAL = {ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,), ast.IsNot: (ast.Is,)}
WITHIN = {ast.In: (ast.NotIn,), ast.NotIn: (ast.In,)}
COMPARED: dict[type, tuple[type, ...]] = ORDER | EQUAL | WITHIN
REACHED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
REACHED |= {ast.FloorDiv: ast.Div, ast.Mod: ast.Mult, ast.BitOr: ast.BitAnd, ast.BitAnd: ast.BitOr}
NAMES = {"min": "max", "minimum": "maximum", "any": "all", "sorted": "list", "left": "right"}
NAMES |= {other: name for name, other in NAMES.items() if name != "sorted"}
UNTOUCHED = ("annotation", "returns", "decorator_list", "type_params", "keywords_only")
GUARDS = ("strict", "repr", "covariant")  # keywords that no value which comes out depends on


@dataclass(frozen=True)
class Mutant:
    """A module with one token changed."""

    line: int
    before: str
    after: str
    code: CodeType


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file, in the order of its text."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for parent, field, index, node in list(places(tree)):
        for other in variants(node):
            replace(parent, field, index, ast.fix_missing_locations(ast.copy_location(other, node)))
            yield Mutant(node.lineno, ast.unparse(node), ast.unparse(other), compile(tree, str(path), "exec"))
            replace(parent, field, index, node)


def places(parent: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, Any]]:
    """Yield where every statement and expression stands, what is never computed left out."""
    for field, value in ast.iter_fields(parent):
        if field in UNTOUCHED:
            continue
        for index, node in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
                continue
            if isinstance(node, ast.keyword) and node.arg in GUARDS:
                continue
            if isinstance(node, ast.AST):
                yield parent, field, index, node
                yield from places(node)


def replace(parent: ast.AST, field: str, index: int | None, node: ast.AST) -> None:
    """Put a node in its place."""
    if index is None:
        setattr(parent, field, node)
    else:
        getattr(parent, field)[index] = node


def variants(node: Any) -> Iterator[ast.AST]:
    """Yield what a node may wrongly be."""
    match node:
        case ast.Compare(left, [*ops], comparators):
            for i, op in enumerate(ops):
                for other in COMPARED[type(op)]:
                    yield ast.Compare(left, [*ops[:i], other(), *ops[i + 1 :]], comparators)
        case ast.BinOp(left, op, right) if type(op) in REACHED:
            yield ast.BinOp(left, REACHED[type(op)](), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(ast.Or() if isinstance(op, ast.And) else ast.And(), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.IfExp(test, body, orelse):
            yield ast.IfExp(test, orelse, body)
        case ast.Constant(value) if (other := other_value(value)) is not None:
            yield ast.Constant(other)
        case ast.Constant(str() as text):
            yield from map(ast.Constant, other_programs(text))
        case ast.Name(name) if name in NAMES:
            yield ast.Name(NAMES[name], node.ctx)
        case ast.Attribute(of, name) if name in NAMES:
            yield ast.Attribute(of, NAMES[name], node.ctx)
        case ast.stmt():
            yield from statements(node)


def other_value(value: Any) -> Any:
    """Return another value of a constant; none of a text that is no word of an interface."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return type(value)({0: 1, 1: 0}.get(value, 2 * value))
    return NAMES.get(value) if isinstance(value, str) else None


def other_programs(text: str) -> Iterator[str]:
    """Yield what the lines of a program may wrongly be; nothing of a text that has none."""
    try:
        tree = ast.parse(text.strip())
    except SyntaxError:
        return
    if tree.body and all(isinstance(line, ast.Assign) for line in tree.body):
        for parent, field, index, node in list(places(tree)):
            for other in variants(node):
                replace(parent, field, index, other)
                yield f"\n{ast.unparse(tree)}\n"
                replace(parent, field, index, node)


def statements(node: ast.stmt) -> Iterator[ast.stmt]:
    """Yield what a statement may wrongly be: nothing, most of the time."""
    match node:
        case ast.If(ast.Name() | ast.Call() | ast.Attribute() as test, body, orelse):
            yield ast.If(ast.UnaryOp(ast.Not(), test), body, orelse)
        case ast.Return(ast.AST() as value) if ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))
        case ast.AugAssign(target, op, value) if type(op) in REACHED:
            yield ast.AugAssign(target, REACHED[type(op)](), value)
            yield ast.Pass()
        case ast.Raise() | ast.Break() | ast.Continue() | ast.Assign([ast.Attribute() | ast.Subscript(), *_]):
            yield ast.Pass()
        case ast.Expr(value) if not isinstance(value, ast.Constant):
            yield ast.Pass()


def passed(module: str, code: CodeType | None, tests: tuple[str, ...], timeout: float, taken: Path) -> bool:
    """Run tests in a forked process, a module replaced; tell whether all of them passed in time.

    What each group of them takes on the source as it is stands in `taken` then, and limits those on mutants.
    """
    pid = os.fork()
    if not pid:
        ended = 3
        try:
            os.setsid()
            ended = run(module, code, tests, taken)
        finally:  # never on in the parent's place
            os._exit(ended)
    end, status = time.monotonic() + timeout, None
    while status is None and time.monotonic() < end:
        done, left = os.waitpid(pid, os.WNOHANG)
        status = left if done else time.sleep(0.02)
    os.killpg(pid, signal.SIGKILL) if status is None else None
    status = os.waitpid(pid, 0)[1] if status is None else status
    return status == 0


def run(module: str, code: CodeType | None, tests: tuple[str, ...], taken: Path) -> int:
    """Run tests in this process, to their first failure."""
    import pytest

    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    if code:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
    sys.frozen = True  # type: ignore[attr-defined]  # so that archives are examined in this process, where the mutant is
    found = SourceFileLoader.get_code
    SourceFileLoader.get_code = lambda self, name: code if code and name == module else found(self, name)  # type: ignore[method-assign]
    plain = module.startswith(tuple(f"xdynamics.{one.replace('/', '.')}" for one in PLAIN))
    os.environ["NUMBA_DISABLE_JIT"] = str(int(plain))
    law_cache = import_module("xdynamics.kernels.law")  # whose keys are of the files, which are not changed
    vars(law_cache).update(read=lambda _key: None, write=lambda *_: None)
    spent: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for k, test in enumerate(tests):
            name, *choice = test.split(" ", 2)
            begun = time.process_time()
            if code:
                allowed = max(LEAST, PATIENCE * json.loads(taken.read_text())[k])
                resource.setrlimit(resource.RLIMIT_CPU, (int(begun + allowed) + 1, resource.RLIM_INFINITY))
            else:
                spent.append(0.0)
            asked = [
                str(next(HERE.rglob(name)) if name.startswith("test_") else name),
                *(choice if name.startswith("test_") else EXAMPLES),
                "-x",
                "-q",
                "-p",
                "no:cacheprovider",
                "-p",
                "no:unraisableexception",  # which collects garbage, at every end
                AGAIN,
                *(["-Wignore::RuntimeWarning"] if plain else []),  # of what numba divides by 0 without a word
                f"--basetemp={folder}/{Path(name).name}",
            ]
            if ended := int(pytest.main(asked)):
                return ended
            if not code:
                spent[k] = time.process_time() - begun
                taken.write_text(json.dumps(spent))
    return 0


def naming() -> dict[str, tuple[str, ...]]:
    """Return the test modules that import each module of the package, the shortest first."""
    texts = {path.name: path.read_text(encoding="utf-8") for path in HERE.rglob("test_*.py")}
    named = {}
    for path in SOURCE.rglob("*.py"):
        room, _, module = ".".join(("xdynamics", *path.relative_to(SOURCE).with_suffix("").parts)).rpartition(".")
        import_line = re.compile(rf"^ *from {room}(\.{module} import| import [^\n]*\b{module}\b)", re.MULTILINE)
        tests = sorted((name for name in texts if import_line.search(texts[name])), key=lambda name: len(texts[name]))
        if tests:
            named[str(path.relative_to(SOURCE))] = tuple(tests)
    return named


def survey(name: str, tests: tuple[str, ...], most: int, seed: int, lines: list[int], taken: Path) -> None:
    """Try a sample of a file's mutants, and tell what became of each."""
    module = f"xdynamics.{name[:-3].replace('/', '.')}"
    examples = (str(SOURCE / name),) if ">>>" in (SOURCE / name).read_text(encoding="utf-8") else ()
    tests = (*examples, *tests)
    before = time.monotonic()
    if not passed(module, None, tests, 600.0, taken):
        raise SystemExit(f"{name}: its tests fail without a mutant: {', '.join(tests)}")
    timeout = max(10.0, PATIENCE * (time.monotonic() - before))
    known = [mutant for mutant in mutants(SOURCE / name) if not lines or mutant.line in lines]
    tried = sorted(random.Random(seed).sample(range(len(known)), min(most, len(known))))
    survivors = 0
    for one in (known[i] for i in tried):
        survived = passed(module, one.code, tests, timeout, taken)
        survivors += survived
        about = f"{name}:{one.line}: {'survived' if survived else 'found   '}  {one.before!r:.90} -> {one.after!r:.90}"
        print(about, flush=True)
    print(f"{name}: {len(tried)} of {len(known)} mutants tried, {len(tried) - survivors} found, {survivors} survived")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", help="below src/xdynamics")
    parser.add_argument("--tests", nargs="*", default=[], help="test modules, each perhaps with a choice as for -k")
    parser.add_argument("--most", type=int, default=60, help="mutants of a file, drawn at random")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--lines", type=int, nargs="*", default=[], help="all mutants of these")
    given = parser.parse_args()
    sys.path.insert(0, str(SOURCE.parent))
    for name in IMPORTED:
        import_module(name)
    with tempfile.TemporaryDirectory() as folder:  # what forked processes compile, one for the next
        sys.dont_write_bytecode, sys.pycache_prefix = False, folder
        named = naming()
        for name in given.files or named:
            tests = tuple(given.tests) or named[name]
            survey(name, tests, given.most, given.seed, given.lines, Path(folder) / "taken.json")


if __name__ == "__main__":
    main()
