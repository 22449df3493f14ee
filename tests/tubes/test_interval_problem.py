"""Numbers as they are written: what no float is lies between two."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from cases.smooth_models import of_rate
from xdynamics import Model
from xdynamics.tubes import interval_problem_of
from xdynamics.tubes.boxes import Box

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
