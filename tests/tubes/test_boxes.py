"""Intervals in arrays: every operation holds what exact arithmetic gives.

Frames, and proven products with their inverses.
Numbers as they are written: what no float is lies between two.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from cases.smooth_models import of_rate
from xdynamics import Model
from xdynamics.tubes import boxes, interval_problem_of
from xdynamics.tubes.boxes import FAR, Box, Polynomials, off_orthogonal, orthogonal, solve_in_frame

POLYNOMIALS = Polynomials(2, 4)
OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b,
}


def random_box(random: np.random.Generator, *shape: int) -> boxes.Box:
    """Return intervals of many sizes, some of them numbers."""
    ends = random.normal(size=(2, *shape)) * 10.0 ** random.integers(-20, 20, shape)
    ends[1] = np.where(random.random(shape) < 0.2, ends[0], ends[1])
    return np.sort(ends, axis=0)


def inside(box: boxes.Box, exact: Fraction) -> bool:
    """Whether an interval holds a number."""
    return Fraction(float(box[0])) <= exact <= Fraction(float(box[1]))


@pytest.mark.parametrize("name", OPERATIONS)
@pytest.mark.cases(40)
def test_operations_hold_exact_results(case: int, name: str) -> None:
    """Assert that the exact result of any two members, ends among them, is in the interval, and that ends are next to it."""
    random = np.random.default_rng([32, case])
    a, b = random_box(random, 8), random_box(random, 8)
    if name == "divide":
        b = np.where(boxes.multiply(b, b)[0] < 0.0, b + 2.0 * boxes.magnitude(b), b)
        b = b[:, (b[0] > 0.0) | (b[1] < 0.0)]
        a = a[:, : b.shape[1]]
    found = getattr(boxes, name)(a, b)
    for i in range(found.shape[1]):
        exact = [
            OPERATIONS[name](Fraction(float(x)), Fraction(float(y)))
            for x in (a[0, i], boxes.midpoint(a)[i], a[1, i])
            for y in (b[0, i], boxes.midpoint(b)[i], b[1, i])
        ]
        assert all(inside(found[:, i], member) for member in exact)
        ends = np.array([float(min(exact)), float(max(exact))])
        assert (np.abs(found[:, i] - ends) <= 2.0 * np.spacing(np.abs(ends))).all()


@pytest.mark.cases(20)
def test_sums_and_products_hold_exact_results(case: int) -> None:
    """Assert that sums along an axis, products of matrices and polynomials hold those of members."""
    random = np.random.default_rng([33, case])
    a, b, x = random_box(random, 3, 4), random_box(random, 4, 2), random_box(random, 1)[:, 0]
    low, high = (
        [[Fraction(float(number)) for number in row] for row in ends] for ends in (a[0], np.minimum(a[1], a[0]))
    )
    total = boxes.sum_along(a, axis=2)
    assert all(inside(total[:, i], sum(low[i], Fraction(0))) for i in range(3))
    matrix = boxes.matrix_product(a, b)
    for i in range(3):
        for k in range(2):
            exact = sum((low[i][j] * Fraction(float(b[1, j, k])) for j in range(4)), Fraction(0))
            assert inside(matrix[:, i, k], exact)
    at = Fraction(float(boxes.midpoint(x)))
    value = POLYNOMIALS.values_at(x, a)
    for k in range(4):
        exact = sum((high[i][k] * at**i for i in range(3)), Fraction(0))
        assert inside(value[:, k], exact)
    positive = np.sort(np.abs(random.normal(size=2)))
    for n in (0, 1, 2, 7, 21):
        powers = boxes.interval_power(positive, n)
        assert all(inside(powers, Fraction(float(end)) ** n) for end in positive)


@pytest.mark.cases(20)
def test_long_sums_that_cancel(case: int) -> None:
    """Assert that a sum of sixty numbers that nearly cancel, whose rounding errs by many spacings of it, is held."""
    random = np.random.default_rng([34, case])
    terms = random.normal(size=(3, 60))
    terms[:, 1::2] = -terms[:, ::2] * (1.0 + 1e-12 * random.normal(size=(3, 30)))
    for i, row in enumerate(terms):
        assert inside(boxes.sum_along(boxes.point_box(row)), sum(map(Fraction, row.tolist()), Fraction(0))), i
    assert boxes.width(boxes.sum_along(boxes.point_box(terms[0]))) < 1e-11


def test_numbers_as_written() -> None:
    """Assert that a decimal number that no float is lies between two neighbours, and one that is stays a point."""
    tenth, half = boxes.enclosed(Fraction("0.1")), boxes.enclosed(Fraction("0.5"))
    assert Fraction(float(tenth[0])) < Fraction("0.1") < Fraction(float(tenth[1]))
    assert tenth[1] == np.nextafter(tenth[0], 1.0)
    assert half.tolist() == [0.5, 0.5]
    wide = boxes.enclosed(Fraction("0.1"), Fraction("0.02"))
    assert Fraction(float(wide[0])) <= Fraction("0.08")
    assert Fraction(float(wide[1])) >= Fraction("0.12")


def test_products_that_underflow() -> None:
    """Assert that a product below the least float is not taken for zero."""
    tiny = boxes.multiply(boxes.point_box(1e-200), boxes.point_box(1e-200))
    assert tiny[0] <= 0.0 < tiny[1]
    assert boxes.has_zero(boxes.point_box(np.nan))


@pytest.mark.parametrize("off", [0.0, 1e-9, 0.02])
def test_inverses_hold_exact_ones(off: float) -> None:
    """Assert that frame**-1 times frame times a vector holds the vector exactly, of frames that are orthogonal, or nearly."""
    random = np.random.default_rng(32)
    frame = orthogonal(random.normal(size=(4, 4))) + off * random.normal(size=(4, 4))
    assert off_orthogonal(frame) < FAR
    x = random.normal(size=4)
    right = [
        sum((Fraction(a) * Fraction(b) for a, b in zip(row, x.tolist(), strict=True)), Fraction(0))
        for row in frame.tolist()
    ]
    columns = np.stack([boxes.enclosed(number) for number in right], axis=1)[:, :, None]
    found = solve_in_frame(frame, off_orthogonal(frame), columns)[:, :, 0]
    assert ((found[0] <= x) & (x <= found[1])).all()
    assert boxes.width(found).max() < 1e-13 + 60.0 * off


def test_frames_of_any_directions() -> None:
    """Assert that columns in one plane, of any size, zero or not finite give an orthogonal frame, the first along the first."""
    random = np.random.default_rng(33)
    for directions in (
        random.normal(size=(3, 3)) * np.array([1e200, 1e-200, 1.0]),
        np.outer([1.0, 2.0, 2.0], [1.0, 3.0, -1.0]),
        np.zeros((3, 3)),
        np.full((3, 3), np.nan),
        np.eye(3)[:, ::-1] * 1e-320,
    ):
        frame = orthogonal(directions)
        assert off_orthogonal(frame) < FAR
        assert np.abs(frame.T @ frame - np.eye(3)).max() < 1e-14
    assert np.abs(orthogonal(np.outer([1.0, 2.0, 2.0], [3.0, 1.0, 1.0]))[:, 0] - [1 / 3, 2 / 3, 2 / 3]).max() < 1e-15
    assert off_orthogonal(np.ones((3, 3))) >= FAR


PI = Fraction("3.14159265358979323846264338327950288419716939937510582")


def holds(box: Box, exact: Fraction) -> bool:
    """Whether an interval holds a number strictly, and is at most two spacings wide."""
    low, high = (Fraction(float(end)) for end in np.asarray(box).ravel()[:2])
    return low < exact < high and float(high - low) <= 2.0 * np.spacing(abs(float(exact)))


def test_constants_and_literals() -> None:
    """Assert that a decimal fraction, pi, a degree and a literal lie strictly inside, and that half a metre is a number."""
    model = Model(
        name="numbers",
        coordinates={"q": {"unit": "rad"}},
        parameters={"tenth": "0.1 m", "half": "0.5 m", "wide": {"value": "0.3 m", "half_width": "0.1 m"}},
        mass={"q": "1*kilogram*metre**2"},
        forces={"all": {"q": "newton*(tenth + half + wide)*(0.7 + pi + degree)"}},
        initial={"q": "30 degree", "v_q": "0 rad s-1"},
    )
    problem = interval_problem_of(model)
    boxes = [value for value in problem.motions.straight.constants.values() if isinstance(value, np.ndarray)]
    for exact in (Fraction("0.1"), PI, PI / 180):
        assert sum(holds(box, exact) for box in boxes) == 1
    assert [value for value in problem.motions.straight.constants.values() if isinstance(value, float)].count(0.5) == 1
    assert [holds(box, Fraction("0.7")) for box in problem.motions.straight.literals.values()] == [True]
    assert problem.names == ("q", "v_q", "wide")
    assert holds(problem.start[:, 0], PI / 6)
    assert Fraction(float(problem.start[0, 2])) <= Fraction("0.2")
    assert Fraction(float(problem.start[1, 2])) >= Fraction("0.4")


def test_times_as_written() -> None:
    """Assert that a start at 0.1 s, which no float is, lies between two."""
    model = of_rate("1 + x").replace(initial={"t": "0.1 s"})
    assert interval_problem_of(model).time[0] <= 0.1 <= interval_problem_of(model).time[1]
    assert Fraction(float(interval_problem_of(model).time[0])) <= Fraction("0.1")
