"""Tables of cubic pieces: where a number is found, and the value and slope there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from xdynamics.elementary.numbers import FunctionLines, LaneValue
from xdynamics.elementary.piecewise import bend_at, cube_at, find_piece, last_piece_begun, slope_at, value_at
from xdynamics.elementary.text import declarations
from xdynamics.kernels import drive_tables, machine

ORIGINS = np.array([-2.0, -1.0, 0.5, 0.75, 4.0, 7.0])
TABLE = np.concatenate([[ORIGINS], np.random.default_rng(2).normal(size=(4, 6))])


def read(row: int, piece: object) -> object:
    """An element of the table."""
    return TABLE[row, piece]


def wanted(x: float) -> int:
    """The last origin at or before x, the first if there is none."""
    return max([k for k, origin in enumerate(ORIGINS.tolist()) if origin <= x], default=0)


NUMBERS = [-3.0, -2.0, -1.5, -1.0, 0.0, 0.5, 0.6, 0.75, 3.9999, 4.0, 6.0, 7.0, 8.0, np.inf, -np.inf]


def test_a_piece_applies_from_its_origin_on() -> None:
    """Assert the piece of every number, one by one and in an array; the last point belongs to the piece before."""
    for x in NUMBERS:
        assert last_piece_begun(read, 6, x) == wanted(x)
        assert find_piece(read, 6, x) == (4 if x == 7.0 else wanted(x))
    numbers = np.array(NUMBERS).reshape(3, 5)
    assert np.array_equal(last_piece_begun(read, 6, numbers).ravel(), list(map(wanted, NUMBERS)))
    assert np.array_equal(find_piece(read, 6, numbers).ravel(), [4 if x == 7.0 else wanted(x) for x in NUMBERS])
    assert find_piece(read, 6, np.nan) == 0


def test_the_engine_finds_the_same_piece() -> None:
    """Assert that the engine's own search, in a flat array of tables, ends where that of programs does."""
    engines = getattr(drive_tables.find_piece_of_table, "py_func", drive_tables.find_piece_of_table)
    flat = np.concatenate([[9.0, 9.0], TABLE.ravel(), [9.0]])
    between = [(low + high) / 2.0 for low, high in pairwise(ORIGINS.tolist())]
    for x in [
        *NUMBERS,
        *between,
        *np.nextafter(ORIGINS, -np.inf).tolist(),
        *np.nextafter(ORIGINS, np.inf).tolist(),
        np.nan,
    ]:
        for count in (2, 5, 6):
            assert engines(x, flat, 2, count) == find_piece(read, count, x), (x, count)


@pytest.mark.parametrize("lanes", [1, 4, 8])
def test_machine_code_finds_the_same_piece_in_every_lane(lanes: int) -> None:
    """Assert that lanes, each at a number of its own, find what Python does."""
    import ctypes

    lines = FunctionLines(lanes)
    kind, whole = lines.kind("n"), lines.kind("w")
    x = lines.line("n", f"load {kind}, ptr %x, align 8")
    found = find_piece(lambda _, piece: lines.read("n", "%table", piece), lines.constant(6), x)
    assert isinstance(found, LaneValue)
    body = "\n  ".join([*lines.lines, f"store {whole} {found.text}, ptr %z, align 8", "ret void"])
    text = f"{declarations(lanes)}\ndefine void @found(ptr %table, ptr %x, ptr %z) {{\nentry:\n  {body}\n}}\n"
    code = machine.Code(machine.build_object(text), ["found"])
    call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 3)(code.addresses["found"])
    numbers = np.array([*NUMBERS, np.nan])
    pieces = np.full(16, -1, np.int64)
    for first in range(0, 16, lanes):
        call(*(array.ctypes.data for array in (TABLE, numbers[first:], pieces[first:])))
    assert pieces.tolist() == [find_piece(read, 6, x) for x in numbers.tolist()]


def test_values_and_slopes_are_those_of_the_cubic() -> None:
    """Assert a polynomial in the distance from the origin of its piece, and its derivative."""
    for piece in range(6):
        cubic = np.polynomial.Polynomial(TABLE[:0:-1, piece])
        for x in (ORIGINS[piece], ORIGINS[piece] + 0.3):
            u = x - ORIGINS[piece]
            assert value_at(read, x, piece) == pytest.approx(cubic(u), rel=1e-14)
            assert slope_at(read, x, piece) == pytest.approx(cubic.deriv()(u), rel=1e-14)
            assert bend_at(read, x, piece) == pytest.approx(cubic.deriv(2)(u) / 2.0, rel=1e-14)
            assert cube_at(read, x, piece) == cubic.coef[3]
