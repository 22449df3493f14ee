"""How programs are printed as Python: signs, and how deep an expression may be."""

from __future__ import annotations

from itertools import pairwise

import pytest

from xdynamics.kernels.program import Compute, Load, Place, Program, StoreTo
from xdynamics.kernels.python_text import HIGHEST, python_of


def printed(*body: Compute) -> list[str]:
    """Lines of a program that computes `_r` of `_a` and `_b`, and stores it."""
    used = {argument for line in body for argument in line.arguments}
    loads = [Load(name, Place("y", k)) for k, name in enumerate(("_a", "_b")) if name in used]
    whole = (*loads, *body, StoreTo(Place("z"), "_r"))
    return [line.strip() for line in python_of(Program("lines", "Lines.", whole)).splitlines()[2:]]


@pytest.mark.parametrize(
    ("operation", "of", "line"),
    [
        ("negative", ("_s",), "_z[0] = --_y[0]"),
        ("add", ("_s", "_b"), "_z[0] = -_y[0] + _y[1]"),
        ("multiply", ("_s", "_b"), "_z[0] = -_y[0]*_y[1]"),
        ("divide", ("_b", "_s"), "_z[0] = _y[1]/-_y[0]"),
        ("divide", ("_s", 0.0), "_z[0] = -_y[0]/_zero"),
        ("subtract", (-1.0, "_s"), "_z[0] = -1.0 - -_y[0]"),
        ("multiply", ("_s", -2.0), "_z[0] = -_y[0]*-2.0"),
    ],
)
def test_signs_need_no_parentheses(operation: str, of: tuple[str | float, ...], line: str) -> None:
    """Assert that a sign binds more tightly than sums, products and other signs."""
    assert printed(Compute("_s", "negative", ("_a",)), Compute("_r", operation, of))[-1] == line


@pytest.mark.parametrize(("levels", "lines"), [(HIGHEST - 1, 1), (HIGHEST, 2), (2 * HIGHEST - 1, 2), (2 * HIGHEST, 3)])
def test_expressions_have_so_many_levels(levels: int, lines: int) -> None:
    """Assert that an expression is nested up to the limit, and parted above it, so that Python can compile it."""
    names = ["_a", *(f"_{k}" for k in range(1, levels)), "_r"]
    body = [Compute(new, "sin", (old,)) for old, new in pairwise(names)]
    made = printed(*body)
    assert len(made) == lines
    assert "".join(made).count("sin(") == levels
