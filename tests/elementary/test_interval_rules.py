"""Interval operations where their rules part: bounds that touch, ends of domains, jumps, crests, the cut of an angle.

The least and the greatest of some numbers, as functions of any kind of number.
"""

from __future__ import annotations

import itertools
from math import inf, pi

import numpy as np
import pytest

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.bounds import BREAKS, SMOOTH, UNBOUNDED, Interval, maximum, minimum
from xdynamics.elementary.intervals import Intervals

KIND = Intervals(FUNCTIONS)
LOW, HIGH, WIDE = Interval(1.0, 2.0), Interval(2.0, 3.0), Interval(1.5, 2.5)
TWO, THREE = Interval(2.0, 2.0), Interval(3.0, 3.0)
NO, YES, OPEN = (0.0, 0.0), (1.0, 1.0), (0.0, 1.0)
WIDENED = 16 * 2.0**-52  # relative, of bounds of a few roundings


@pytest.mark.parametrize(
    ("operation", "a", "b", "truth"),
    [
        ("less", LOW, HIGH, OPEN),
        ("less", LOW, THREE, YES),
        ("less", HIGH, LOW, NO),
        ("at_most", LOW, HIGH, YES),
        ("at_most", HIGH, LOW, OPEN),
        ("at_most", THREE, LOW, NO),
        ("more", LOW, HIGH, NO),
        ("more", HIGH, LOW, OPEN),
        ("more", THREE, LOW, YES),
        ("at_least", LOW, HIGH, OPEN),
        ("at_least", HIGH, LOW, YES),
        ("at_least", LOW, THREE, NO),
        ("equal", TWO, TWO, YES),
        ("equal", LOW, HIGH, OPEN),
        ("equal", LOW, THREE, NO),
        ("equal", THREE, LOW, NO),
        ("equal", TWO, LOW, OPEN),
        ("equal", LOW, TWO, OPEN),
        ("unequal", TWO, TWO, NO),
        ("unequal", LOW, THREE, YES),
        ("unequal", LOW, WIDE, OPEN),
    ],
)
def test_a_truth_is_known_where_no_number_decides_otherwise(
    operation: str, a: Interval, b: Interval, truth: tuple[float, float]
) -> None:
    """Assert a comparison of intervals that touch, lie apart, overlap or are one number; unbounded ones decide nothing."""
    assert KIND.of(operation, a, b)[:2] == truth
    assert KIND.of(operation, a, b._replace(flaw=UNBOUNDED))[:2] == OPEN


@pytest.mark.parametrize(
    ("operation", "operands", "low", "high", "flaw"),
    [
        ("negative", [Interval(-1.0, 2.0)], -2.0, 1.0, SMOOTH),
        ("add", [LOW, Interval(-1.0, 3.0)], 0.0, 5.0, SMOOTH),
        ("subtract", [LOW, Interval(-1.0, 3.0)], -2.0, 3.0, SMOOTH),
        ("multiply", [Interval(-1.0, 2.0), Interval(-3.0, 5.0)], -6.0, 10.0, SMOOTH),
        ("multiply", [Interval(0.0, 1.0), Interval(0.0, inf)], -inf, inf, SMOOTH),
        ("square", [Interval(-3.0, 2.0)], 0.0, 9.0, SMOOTH),
        ("least", [LOW, WIDE], 1.0, 2.0, SMOOTH),
        ("greatest", [LOW, WIDE], 1.5, 2.5, SMOOTH),
        ("sign", [Interval(0.0, 0.0)], 0.0, 0.0, SMOOTH),
        ("sign", [Interval(0.0, 1.0)], 0.0, 1.0, BREAKS),
        ("sign", [Interval(-2.0, -1.0)], -1.0, -1.0, SMOOTH),
        ("abs", [Interval(-1.0, 2.0)], 0.0, 2.0, SMOOTH),
        ("abs", [Interval(-3.0, -1.0)], 1.0, 3.0, SMOOTH),
        ("abs", [Interval(0.0, 2.0)], 0.0, 2.0, SMOOTH),
        ("sqrt", [Interval(0.0, 4.0)], 0.0, 2.0, SMOOTH),
        ("sqrt", [Interval(4.0, 9.0)], 2.0, 3.0, SMOOTH),
        ("sqrt", [Interval(-1.0, 4.0)], 0.0, 2.0, UNBOUNDED),
        ("positive", [Interval(0.0, 1.0)], 0.0, 1.0, UNBOUNDED),
        ("positive", [Interval(0.5, 1.0)], 0.5, 1.0, SMOOTH),
        ("log", [Interval(1.0, 1.0)], 0.0, 0.0, SMOOTH),
        ("log", [Interval(0.0, 1.0)], -inf, 0.0, UNBOUNDED),
        ("power", [Interval(0.0, 4.0), Interval(0.5, 0.5)], 0.0, 2.0, SMOOTH),
        ("power", [Interval(4.0, inf), Interval(0.5, 0.5)], 2.0, inf, SMOOTH),
        ("power", [Interval(-1.0, 4.0), Interval(0.5, 0.5)], 0.0, 2.0, UNBOUNDED),
        ("power", [Interval(4.0, 9.0), Interval(-0.5, -0.5)], 1.0 / 3.0, 0.5, SMOOTH),
        ("divide", [LOW, Interval(2.0, 4.0)], 0.25, 1.0, SMOOTH),
        ("divide", [LOW, Interval(-4.0, -2.0)], -1.0, -0.25, SMOOTH),
        ("divide", [LOW, Interval(0.0, 1.0)], -inf, inf, UNBOUNDED),
        ("divide", [LOW, Interval(-1.0, 0.0)], -inf, inf, UNBOUNDED),
        ("floor", [Interval(1.5, 1.9)], 1.0, 1.0, SMOOTH),
        ("floor", [Interval(1.5, 2.0)], 1.0, 2.0, BREAKS),
        ("ceil", [Interval(1.0, 1.5)], 1.0, 2.0, BREAKS),
        ("mod", [Interval(5.25, 5.75), TWO], 1.25, 1.75, SMOOTH),
        ("hypot", [Interval(-3.0, 1.0), Interval(-4.0, -4.0)], 4.0, 5.0, SMOOTH),
        ("hypot", [Interval(0.0, 0.0), Interval(0.0, 0.0)], 0.0, 0.0, SMOOTH),
        ("asin", [Interval(0.0, 1.0)], 0.0, pi / 2.0, SMOOTH),
        ("asin", [Interval(0.0, 1.5)], 0.0, pi / 2.0, UNBOUNDED),
        ("acos", [Interval(-1.5, 1.0)], 0.0, pi, UNBOUNDED),
        ("tan", [Interval(-pi / 4.0, pi / 4.0)], -1.0, 1.0, SMOOTH),
        ("tan", [Interval(1.5, 1.6)], -inf, inf, UNBOUNDED),
        ("tan", [Interval(-1.7, -1.5)], -inf, inf, UNBOUNDED),
        ("sin", [Interval(0.0, pi)], 0.0, 1.0, SMOOTH),
        ("sin", [Interval(pi, 2.0 * pi)], -1.0, 0.0, SMOOTH),
        ("sin", [Interval(-7.0, 7.0)], -1.0, 1.0, SMOOTH),
        ("sin", [Interval(0.0, inf)], -1.0, 1.0, UNBOUNDED),
        ("cos", [Interval(-0.5, pi / 3.0)], 0.5, 1.0, SMOOTH),
        ("cos", [Interval(pi / 2.0, 3.0)], -0.9899924966004454, 0.0, SMOOTH),
        ("choose", [Interval(1.0, 1.0), LOW, HIGH], 1.0, 2.0, SMOOTH),
        ("choose", [Interval(0.0, 0.0), LOW, HIGH], 2.0, 3.0, SMOOTH),
        ("choose", [Interval(0.0, 1.0), LOW, HIGH], 1.0, 3.0, BREAKS),
        ("atan2", [Interval(1.0, 1.0), Interval(-1.0, 1.0)], pi / 4.0, 3.0 * pi / 4.0, SMOOTH),
        ("atan2", [Interval(-1.0, 1.0), Interval(1.0, 1.0)], -pi / 4.0, pi / 4.0, SMOOTH),
        ("atan2", [Interval(-1.0, -1.0), Interval(-1.0, 0.5)], -3.0 * pi / 4.0, -1.1071487177940904, SMOOTH),
        ("atan2", [Interval(1.0, 2.0), Interval(-2.0, -1.0)], 2.0344439357957027, 2.677945044588987, SMOOTH),
        ("atan2", [Interval(-1.0, 1.0), Interval(-2.0, -1.0)], -pi, pi, BREAKS),
        ("atan2", [Interval(0.0, 1.0), Interval(-2.0, -1.0)], -pi, pi, BREAKS),
        ("atan2", [Interval(-1.0, 0.0), Interval(0.0, 1.0)], -pi, pi, BREAKS),
    ],
)
def test_bounds_are_those_of_the_operation(
    operation: str, operands: list[Interval], low: float, high: float, flaw: int
) -> None:
    """Assert the exact bounds, widened by a few roundings at most, and what is known of the value between them."""
    found = KIND.of(operation, *operands)
    assert found.flaw == flaw
    for bound, exact, outward in ((found.low, low, -1.0), (found.high, high, 1.0)):
        if abs(exact) == inf:
            assert bound == exact
        else:
            assert 0.0 <= outward * (bound - exact) + 2e-16 <= WIDENED * max(1.0, abs(exact))


def test_a_flaw_is_handed_on() -> None:
    """Assert that what may jump in an operand may jump in the result, and that the worse of two flaws is taken."""
    jumps, lost = LOW._replace(flaw=BREAKS), HIGH._replace(flaw=UNBOUNDED)
    for operation in ("add", "subtract", "multiply", "divide", "least", "greatest", "hypot", "atan2", "mod"):
        assert KIND.of(operation, jumps, HIGH).flaw >= BREAKS, operation
        assert KIND.of(operation, LOW, jumps).flaw >= BREAKS, operation
        assert KIND.of(operation, jumps, lost).flaw == UNBOUNDED, operation
    for operation in ("square", "negative", "abs", "sqrt", "exp", "log", "sin", "tanh", "cosh", "positive", "sign"):
        assert KIND.of(operation, jumps).flaw == BREAKS, operation


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8])
def test_least_and_greatest_of_any_number(count: int) -> None:
    """Assert those of Python, of one number and of three too, in any order and number by number in arrays."""
    numbers = [3.0, -1.5, 2.0**-1074, -np.inf, 7.25, 0.5, np.inf, -2.0][:count]
    for given in itertools.islice(itertools.permutations(numbers), 200):
        assert (minimum(*given), maximum(*given)) == (min(given), max(given))
    arrays = [np.array([number, -number]) for number in numbers]
    assert np.array_equal(minimum(*arrays), np.min(arrays, axis=0))
    assert np.array_equal(maximum(*arrays), np.max(arrays, axis=0))
