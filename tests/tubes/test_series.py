"""Taylor coefficients in intervals, and their derivatives, against mpmath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from cases.smooth_models import of_rate, oscillator
from xdynamics.tubes import IntervalProblem, interval_problem_of
from xdynamics.tubes.series import MotionSeries, UndefinedError

ORDER = 9
PATH = "(a + 0.75*t/second - 0.5*(t/second)**2)"
FUNCTIONS: dict[str, tuple[str, Callable[[Any], Any], float]] = {
    "exp": ("exp(u)", mp.exp, 0.3),
    "log": ("log(u)", mp.log, 0.7),
    "sqrt": ("sqrt(u)", mp.sqrt, 1.3),
    "power": ("u**(1/3)", lambda u: u ** (mp.mpf(1) / 3), 0.6),
    "quotient": ("1/(1 + u*u)", lambda u: 1 / (1 + u * u), 0.4),
    "sin": ("sin(u)", mp.sin, 0.9),
    "cos": ("cos(u)", mp.cos, 2.9),
    "tan": ("tan(u)", mp.tan, 0.5),
    "asin": ("asin(u)", mp.asin, 0.2),
    "acos": ("acos(u)", mp.acos, -0.3),
    "atan": ("atan(u)", mp.atan, 1.7),
    "sinh": ("sinh(u)", mp.sinh, 0.8),
    "cosh": ("cosh(u)", mp.cosh, -0.8),
    "tanh": ("tanh(u)", mp.tanh, 0.6),
    "hypot": ("hypot(u, 2*u - 3)", lambda u: mp.sqrt(u * u + (2 * u - 3) ** 2), 0.5),
    "atan2": ("atan2(u - 2, u)", lambda u: mp.atan2(u - 2, u), 0.4),
    "abs": ("u*abs(u - 5)", lambda u: u * (5 - u), 0.7),
    "min": ("min(u*u, u + 9)", lambda u: u * u, 0.7),
    "max": ("max(u*u, u + 9)", lambda u: u + 9, 0.7),
    "where": ("where(u < 3, u*sin(u), sqrt(-u))", lambda u: u * mp.sin(u), 0.7),
    "mod": ("mod(u + 2.5, 1)", lambda u: u + mp.mpf("0.5"), 0.25),
    "mod of what moves": ("mod(3*u, u + 0.1)", lambda u: u - mp.mpf("0.2"), 0.25),
    "literal": ("0.1*u", lambda u: u / 10, 0.7),
    "pi": ("pi*u**3", lambda u: mp.pi * u**3, 0.7),
}


def held(problem: IntervalProblem) -> np.ndarray:
    """Return what holds for a step from the start."""
    return problem.constants.values_from(problem.regime, problem.begin)


def expanded(text: str, a: str, *, derivatives: bool) -> np.ndarray:
    """Return the coefficients of x with x' = f(u), u a path that begins at a, and those of its derivatives."""
    problem = interval_problem_of(of_rate(text.replace("u", PATH), a=a))
    series = MotionSeries(problem.motions, problem.start.shape[1], ORDER, derivatives=derivatives)
    return series.coefficients_of(problem.time, problem.start, held(problem))


@pytest.mark.every(4)
@pytest.mark.parametrize("name", FUNCTIONS)
def test_coefficients_hold_those_of_mpmath(name: str) -> None:
    """Assert that every coefficient to order 9, and its derivative by the start, is between its bounds, which are narrow."""
    text, function, start = FUNCTIONS[name]
    found = expanded(text, repr(start), derivatives=True)[:, 1:, 0]
    with mp.workdps(60):
        a = mp.mpf(repr(start))
        exact = mp.taylor(lambda t: function(a + mp.mpf("0.75") * t - t * t / 2), 0, ORDER - 1)
        slopes = mp.taylor(lambda t: mp.diff(function, a + mp.mpf("0.75") * t - t * t / 2), 0, ORDER - 1)
        for k in range(ORDER):
            for column, number in ((0, exact[k]), (2, slopes[k])):
                low, high = found[:, k, column] * (k + 1)
                size = max(abs(float(number)), 1.0)
                slack = 1e-20 * size + 4.0 * 2.0**-52 * abs(high) * (k > 0)  # of (k + 1), and of differences in mpmath
                assert low - slack <= number <= high + slack, (k, column)
                assert high - low < 1e-12 * size, (k, column)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("sqrt(u - 0.7)", r"sqrt is not defined, or not finite, for some of the values between -0\.125 and 0\.125$"),
        ("log(u - 1)", "log is not defined"),
        ("atan(1/(u - 0.7))", r"a divisor may be zero: it lies between -0\.125 and 0\.125$"),
        ("asin(u + 1)", "asin is not defined"),
        ("sin(u)*abs(u - 0.7)", r"abs has a corner among the values between -0\.125 and 0\.125$"),
        ("max(0.7, u)", r"max is not decided for values between 0\.7 and 0\.7 and between 0\.575 and 0\.825$"),
        ("mod(u, 0.7)", r"mod jumps for some of the values between 0\.575 and 0\.825 and between 0\.7 and 0\.7$"),
        ("hypot(u - 0.7, u - 0.7)", "a divisor may be zero: it lies between 0 and"),
        (
            "where(u < 0.7, u, -u)",
            r"a comparison is not decided for values between 0\.575 and 0\.825 and between 0\.7 and 0\.7$",
        ),
        ("where(log(u - 1) < 0, u, -u)", "log is not defined"),
        ("where(u > 0, 1/(u - 0.7), sqrt(-u))", "a divisor may be zero"),
        ("tan(u + 0.8707963267948966)", "tan is not defined"),
        ("exp(1000*u + 300)", "exp is not defined, or not finite"),
        ("exp(u + 600)*exp(u + 600)", "beyond the range"),
        ("sqrt(-u)*where(u < 0, 1, 0)", "sqrt is not defined"),
    ],
)
def test_what_is_not_defined(text: str, reason: str) -> None:
    """Assert that no coefficients are told of what may have no value or no derivative for one of the starts."""
    model = of_rate(text.replace("u", PATH), a="0.7")
    model = model.replace(initial={"a": {"value": "0.7", "half_width": 0.125}})
    problem = interval_problem_of(model)
    series = MotionSeries(problem.motions, problem.start.shape[1], 3, derivatives=True)
    with pytest.raises(UndefinedError, match=reason):
        series.coefficients_of(problem.time, problem.start, held(problem))


def test_a_branch_that_is_not_taken_may_be_undefined() -> None:
    """Assert that the root of a negative number does not matter where a condition that is decided leaves it out."""
    found = expanded("where(u > 0, u, sqrt(-u))", "0.7", derivatives=True)
    assert found[0, 1, 0, 0] <= 0.7 <= found[1, 1, 0, 0]
    assert np.isfinite(found).all()


def test_quotients_and_roots_of_literals_are_intervals() -> None:
    """Assert that what is computed of literals alone is rounded outward: (1/49)*49 - 1 holds zero, which floats miss."""
    assert (1.0 / 49.0) * 49.0 - 1.0 != 0.0
    found = expanded("(1/49)*49 - 1 + (sqrt(2)*sqrt(2) - 2)", "0.7", derivatives=False)[:, 1, 0, 0]
    assert found[0] <= 0.0 <= found[1]
    assert found[1] - found[0] < 1e-14


def test_a_literal_is_the_number_that_is_written() -> None:
    """Assert that the float next to 0.1, which is more than that, is not taken for as much."""
    nearest = "0.1000000000000000055511151231257827021181583404541015625"
    with pytest.raises(UndefinedError, match="a comparison is not decided"):
        expanded("where(a > 0.1, 1, -1)", nearest, derivatives=False)


def test_uncertain_constants_are_intervals() -> None:
    """Assert that coefficients over a set hold those of any stiffness within its half width, ends included."""
    problem = interval_problem_of(oscillator({"value": "4 N m-1", "half_width": "1 N m-1"}))
    found = MotionSeries(problem.motions, 3, 4).coefficients_of(problem.time, problem.start, held(problem))[..., 0]
    for k in (3.0, 4.0, 5.0):
        exact = np.array([1.0, 0.0, -k / 2.0, 0.0, k * k / 24.0])
        assert ((found[0, :, 0] <= exact) & (exact <= found[1, :, 0])).all(), k
