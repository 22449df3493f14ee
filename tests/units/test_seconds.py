"""No room but `units` writes a second: the unit of time is the model's."""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator

import pytest

from cases.sources import SOURCES, trees

# by room: literals that are no unit (plurals, markers, names of scalars, a stand-in for text)
OTHER_LETTERS = {
    "archive": 1,
    "cli": 1,
    "documenting": 1,
    "evidence": 1,
    "figures": 4,
    "kernels": 3,
    "methods": 2,
    "model": 6,
    "record": 1,
}
# and sentences with seconds of a clock, or of models that have them by definition: of `scales`, of `solve`, and of motors' files by RASP
CLOCKS = {
    "archive": 3,
    "budgeting": 1,
    "cli": 1,
    "expressions": 1,
    "figures": 1,
    "march": 1,
    "model": 1,
    "simulation": 2,
}


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


@pytest.mark.every(2)
@pytest.mark.parametrize(("search", "allowed"), [(letters, OTHER_LETTERS), (sentences, CLOCKS)])
def test_only_units_writes_a_second(search: object, allowed: dict[str, int]) -> None:
    """Assert that there is none in the syntax trees of the package but those that are listed."""
    assert callable(search)
    found: Counter[str] = Counter()
    for path, tree in trees().items():
        if (room := path.relative_to(SOURCES / "xdynamics").parts[0]) != "units":
            found[room] += len([*search(tree)])
    assert +found == allowed


def test_a_second_that_is_written_is_seen() -> None:
    """Assert that both searches find what they are for."""
    tree = ast.parse('about("s", "time")\nx = f"{t:.3g} s"\ny = f"{run} steps"\n')
    assert ([*letters(tree)], [*sentences(tree)]) == ([1], [2])
