"""Names and lines of the source: a class is known by its name alone, and lines that the formatter leaves are few."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCES = sorted((HERE.parent / "src").rglob("*.py"))
MOST_UNFORMATTED = 40  # tables of numbers and of names


def test_no_two_classes_have_one_name() -> None:
    """Assert that a class in a message or an annotation is one class of the package."""
    names = Counter(
        node.name
        for path in SOURCES
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    )
    assert len(names) > 100
    assert [name for name, count in names.items() if count > 1] == []


def test_few_lines_are_left_by_the_formatter() -> None:
    """Assert how many lines of source and tests stand as they were typed."""
    skips = [
        path
        for path in [*SOURCES, *HERE.rglob("*.py")]
        for _ in range(path.read_text("utf-8").count("# fmt" + ": skip"))
    ]
    assert len(skips) <= MOST_UNFORMATTED
