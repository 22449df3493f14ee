"""Pieces of generated Python."""

from __future__ import annotations

from collections.abc import Iterable

CONTEXT = "_p, _tables, _pieces"  # what a force evaluation needs besides time and state


def tuple_of(items: Iterable[str]) -> str:
    """Write a tuple."""
    listed = list(items)
    return f"({listed[0]},)" if len(listed) == 1 else f"({', '.join(listed)})"


def function_of(signature: str, docstring: str, lines: list[str], decorator: str = "compiled") -> str:
    """Write a function."""
    body = "\n".join(f"    {line}" for line in lines)
    return f'\n@{decorator}\ndef {signature}:\n    """{docstring}"""\n{body}\n'
