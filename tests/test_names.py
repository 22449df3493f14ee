"""Names, lines and docstrings of the source: what a stranger reads, in every module."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from cases.sources import trees

HERE = Path(__file__).resolve().parent
MOST_UNFORMATTED = 40  # tables of numbers and of names
LONGEST_MODULE, LONGEST_BODY = 700, 50  # lines; of a body, its docstring left out


def definitions(scope: ast.AST) -> Iterator[ast.ClassDef | ast.FunctionDef]:
    """Yield classes and functions, those inside others too; what stands under a condition is left out."""
    for node in getattr(scope, "body", ()):
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            yield node
            yield from definitions(node)


def public_functions(scope: ast.Module | ast.ClassDef) -> Iterator[ast.FunctionDef]:
    """Yield functions and methods without an underscore; commands are left out, whose docstrings are their help."""
    for node in scope.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from public_functions(node)
        elif isinstance(node, ast.FunctionDef) and not (node.name.startswith("_") or is_command(node)):
            yield node


def is_command(node: ast.FunctionDef) -> bool:
    """Whether a function is one of the command line."""
    return any("command" in ast.unparse(decorator) for decorator in node.decorator_list)


def raises(node: ast.AST) -> bool:
    """Whether a function raises an error by itself: none that a ledger of faults notes, or an inner function raises."""
    for inner in ast.iter_child_nodes(node):
        noted = isinstance(inner, ast.With) and ".entry(" in ast.unparse(inner.items[0])
        if isinstance(inner, ast.Raise) and inner.exc is not None:
            return True
        if not noted and not isinstance(inner, ast.FunctionDef | ast.Lambda) and raises(inner):
            return True
    return False


def arguments(node: ast.ClassDef | ast.FunctionDef) -> set[str]:
    """Return the names of a function's arguments; of a class, of its makers, and of its fields."""
    if isinstance(node, ast.FunctionDef):
        return {part.arg for part in ast.walk(node.args) if isinstance(part, ast.arg)}
    fields = {
        part.target.id for part in node.body if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name)
    }
    makers = (part for part in node.body if isinstance(part, ast.FunctionDef) and part.name in ("__init__", "__new__"))
    return fields.union(*map(arguments, makers))


def documented_arguments(node: ast.AST) -> list[str]:
    """Return the names under `Parameters` in a docstring."""
    section = re.search(
        r"^Parameters\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)", ast.get_docstring(node) or "", re.DOTALL | re.MULTILINE
    )
    heads = [line for line in section[1].splitlines() if line[:1].strip()] if section else []
    return [name.strip().lstrip("*") for head in heads for name in head.split(" : ")[0].split(",")]


def test_documented_arguments_exist() -> None:
    """Assert that docstrings describe no argument that its function or class does not have."""
    strange = [
        f"{path.name}:{node.lineno} {name}"
        for path, tree in trees().items()
        for node in definitions(tree)
        for name in documented_arguments(node)
        if name not in arguments(node)
    ]
    assert not strange, strange


def test_errors_are_documented() -> None:
    """Assert that the docstring of a public function that raises an error names it under Raises."""
    silent = [
        f"{path.name}: {node.name}"
        for path, tree in trees().items()
        for node in public_functions(tree)
        if "Raises\n------\n" not in (ast.get_docstring(node) or "") and raises(node)
    ]
    assert silent == []
    assert raises(ast.parse("def f():\n    if x:\n        raise ValueError").body[0])
    assert not raises(ast.parse("def f():\n    with ledger.entry('x'):\n        raise ValueError").body[0])


def test_modules_and_functions_fit() -> None:
    """Assert that no module and no body of a function is longer than the style allows."""
    lines = {path: path.read_text(encoding="utf-8").count("\n") for path in trees()}
    assert [str(path) for path, count in lines.items() if count > LONGEST_MODULE] == []
    bodies = [
        (f"{path.name}: {node.name}", (node.end_lineno or 0) - rest[0].lineno + 1)
        for path, tree in trees().items()
        for node in definitions(tree)
        if isinstance(node, ast.FunctionDef) and (rest := node.body[ast.get_docstring(node) is not None :])
    ]
    assert [name for name, count in bodies if count > LONGEST_BODY] == []


def test_no_two_classes_have_one_name() -> None:
    """Assert that a class in a message or an annotation is one class of the package."""
    names = Counter(
        node.name for tree in trees().values() for node in definitions(tree) if isinstance(node, ast.ClassDef)
    )
    assert len(names) > 100
    assert [name for name, count in names.items() if count > 1] == []


def test_few_lines_are_left_by_the_formatter() -> None:
    """Assert how many lines of source and tests stand as they were typed."""
    skips = [
        path
        for path in [*trees(), *HERE.rglob("*.py")]
        for _ in range(path.read_text("utf-8").count("# fmt" + ": skip"))
    ]
    assert len(skips) <= MOST_UNFORMATTED
