"""No room but `units` writes a second: the unit of time is the model's."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

import xdynamics

SRC = Path(xdynamics.__file__).parent
# literals that are no unit: plurals, markers, names of scalars, a stand-in for text
OTHER_LETTERS = {
    "archive/inventory.py": 1, "cli/proving.py": 1, "documenting/plain_text.py": 1, "figures/marks.py": 2, "kernels/program.py": 1,
    "kernels/step_programs.py": 1, "methods/method.py": 1, "model/consistency.py": 2, "model/text_limits.py": 1, "schema.py": 2,
}  # fmt: skip
# sentences with seconds of a clock, or of models that have them by definition: of `scales`, and of `solve`
CLOCKS = {
    "archive/sandboxed_reading.py": 1, "budgeting/numerical.py": 1, "cli/sweeping.py": 1, "expressions/repeating.py": 1,
    "figures/animation.py": 1, "march/settings.py": 1, "simulation/scipy_interface.py": 1,
}  # fmt: skip


def letters(tree: ast.AST) -> Iterator[int]:
    """Yield the lines with a literal "s"."""
    yield from (node.lineno for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value == "s")


def sentences(tree: ast.AST) -> Iterator[int]:
    """Yield the lines of texts in which a second follows a number that is filled in."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            for number, text in zip(node.values, node.values[1:], strict=False):
                if isinstance(number, ast.FormattedValue) and isinstance(text, ast.Constant):
                    yield from [node.lineno] * bool(re.match(r" (s|seconds)\b(?!')", str(text.value)))


@pytest.mark.parametrize(("search", "allowed"), [(letters, OTHER_LETTERS), (sentences, CLOCKS)])
def test_only_units_writes_a_second(search: object, allowed: dict[str, int]) -> None:
    """Assert that there is none in the syntax trees of the package but those that are listed."""
    assert callable(search)
    found: Counter[str] = Counter()
    for path in SRC.rglob("*.py"):
        if (name := path.relative_to(SRC).as_posix()).split("/")[0] != "units":
            found[name] += len([*search(ast.parse(path.read_text()))])
    assert {name: count for name, count in found.items() if count} == allowed


def test_a_second_that_is_written_is_seen() -> None:
    """Assert that both searches find what they are for."""
    tree = ast.parse('about("s", "time")\nx = f"{t:.3g} s"\ny = f"{run} steps"\n')
    assert ([*letters(tree)], [*sentences(tree)]) == ([1], [2])
