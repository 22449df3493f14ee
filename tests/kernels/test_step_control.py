"""The texts of step control as functions of numbers, by the formulas of the books written a second time."""

from __future__ import annotations

import math

import pytest

from cases.plain import plain
from xdynamics.kernels import formulas
from xdynamics.kernels.formulas import compiled_function_of
from xdynamics.methods import implicit

LEAST, GREATEST, SAFETY = 0.125, 8.0, 0.9

tolerance = plain(compiled_function_of(formulas.TOLERANCE, "rtol size floor top", "atol"))
allowed = plain(compiled_function_of(formulas.ALLOWED, "atol rtol rest floor top slope", "allowed"))
ratio = plain(compiled_function_of(formulas.RATIO, "error before after allowed rtol", "ratio"))
worst = plain(compiled_function_of(formulas.NORM, "norm error before after allowed rtol", "norm"))
proportional = plain(
    compiled_function_of(
        formulas.PROPORTIONAL,
        "norm logarithm power safety least greatest",
        "factor next_log shrink",
        formulas.CONSTANTS,
    )
)
growth = plain(
    compiled_function_of(
        formulas.PREDICTIVE,
        "norm turn turns theta width before norm_before safety least greatest",
        "growth",
        formulas.CONSTANTS,
    )
)
predicted = plain(
    compiled_function_of(formulas.PREDICTED, "growth least greatest", "factor next_log shrink", formulas.CONSTANTS)
)
next_step = plain(compiled_function_of(formulas.NEXT, "width factor cut rejected step min_step max_step", "next_step"))


@pytest.mark.parametrize(
    ("rtol", "size", "floor", "top", "found"),
    [(1e-3, 2.0, 1e-6, 5.0, 2e-3), (1e-3, 1e-9, 1e-6, 5.0, 5e-6), (1e-3, 0.0, 1e-6, 0.0, 0.0)],
)
def test_a_tolerance_follows_the_size(rtol: float, size: float, floor: float, top: float, found: float) -> None:
    """Assert the relative tolerance of the size, and at least a part of the largest of its kind."""
    assert tolerance(rtol, size, floor, top) == pytest.approx(found, rel=1e-15)


@pytest.mark.parametrize(
    ("atol", "top", "slope", "found"),
    [
        (1e-3, 2.0, 9.0, 1e-3),
        (1e-9, 2.0, 9.0, 2e-6),
        (0.0, 2e-9, -9.0, 1e-2 * 0.5 * 9.0),
        (0.0, 2e9, -9.0, 2e3),
        (0.0, 0.0, 0.0, 0.0),
    ],
)
def test_what_has_no_size_is_allowed_the_motion_of_its_rate(
    atol: float, top: float, slope: float, found: float
) -> None:
    """Assert rtol of |slope| over the time `rest` where there is no tolerance yet, and only there."""
    assert allowed(atol, 1e-2, 0.5, 1e-6, top, slope) == pytest.approx(found, rel=1e-15)


def test_the_norm_is_the_largest_ratio() -> None:
    """Assert error over scale at the larger end, kept where a component before was worse."""
    assert ratio(-3e-3, -2.0, 1.0, 1e-3, 1e-3) == pytest.approx(3e-3 / (1e-3 + 2e-3), rel=1e-15)
    assert ratio(0.0, 0.0, 0.0, 0.0, 1e-3) == 0.0
    assert worst(0.5, -3e-3, -2.0, 1.0, 1e-3, 1e-3) == ratio(-3e-3, -2.0, 1.0, 1e-3, 1e-3)
    assert worst(7.0, -3e-3, -2.0, 1.0, 1e-3, 1e-3) == 7.0


@pytest.mark.parametrize(
    ("norm", "power", "found"),
    [
        (0.5, 2.0, (1.8, math.log(0.5), 0.9)),
        (1e-9, 99.0, (GREATEST, formulas.LEAST_LOGARITHM, 0.9)),
        (0.0, 1.0, (GREATEST, formulas.LEAST_LOGARITHM, 0.9)),
        (9.0, 0.5, (0.45, math.log(9.0), 0.45)),
        (1e9, 1e-3, (LEAST, math.log(1e9), LEAST)),
    ],
)
def test_the_factor_keeps_to_its_limits(norm: float, power: float, found: tuple[float, float, float]) -> None:
    """Assert growth, what the next step remembers, and the factor after a rejection: 0.9 at most."""
    logarithm = math.log(norm) if norm else -1.0
    assert proportional(norm, logarithm, power, SAFETY, LEAST, GREATEST) == pytest.approx(found, rel=1e-15)


def by_the_book(norm: float, turns: int, theta: float, width: float, before: float, norm_before: float) -> float:
    """Hairer, Wanner II, section IV.8: (8.25) after the text of (8.21), for errors that fall as h**4.

    The factor is 0.9 (2 k + 1)/(2 k + n) of n Newton iterations out of k, and the smaller of both predictions counts
    after an accepted step; a growth of 1 to 1.2 is left out where iterations converge so fast that factors are kept.
    """
    most = implicit.MOST_TURNS
    norm = max(norm, 1e-10)
    factor = SAFETY * min(1.0, (2 * most + 1) / (2 * most + turns)) * norm**-0.25
    if norm <= 1.0 and before > 0.0:
        factor = min(factor, SAFETY * width / before * norm**-0.25 * (norm_before / norm) ** 0.25)
    factor = min(GREATEST, max(LEAST, factor))
    return 1.0 if (turns <= 2 or theta <= 1e-3) and 1.0 <= factor <= 1.2 else factor


@pytest.mark.parametrize("norm", [0.0, 1e-12, 1e-4, 0.3, 0.6, 1.0, 1.5, 40.0, 1e9])
@pytest.mark.parametrize("turns", [1, 2, 3, 7])
def test_radau_predicts_by_the_book(norm: float, turns: int) -> None:
    """Assert the predictive controller of Gustafsson, the work of the iterations, and what is left as it is."""
    for theta in (1e-4, 1e-3, 0.2):
        for width, before, norm_before in ((0.1, 0.0, 0.5), (0.1, 0.2, 0.5), (0.2, 0.1, 0.01), (0.1, 0.09, 0.9)):
            found = growth(norm, float(turns), float(turns), theta, width, before, norm_before, SAFETY, LEAST, GREATEST)
            wanted = by_the_book(norm, turns, theta, width, before, norm_before)
            assert found == pytest.approx(wanted, rel=1e-14)


def test_small_growth_is_left_out_to_its_very_limits() -> None:
    """Assert that 1 and 1.2 are still left out, and the number after that is not."""
    held = (SAFETY / 1.2) ** 4
    assert growth(held * (1 + 1e-9), 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, SAFETY, LEAST, GREATEST) == 1.0
    assert growth(held * (1 - 1e-9), 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, SAFETY, LEAST, GREATEST) > 1.2
    assert growth(SAFETY**4 * (1 + 1e-9), 1.0, 1.0, 0.0, 1.0, 0.0, 1.0, SAFETY, LEAST, GREATEST) < 1.0


@pytest.mark.parametrize(
    ("own", "found"),
    [(2.0, (2.0, 0.9)), (0.5, (0.5, 0.5)), (99.0, (GREATEST, 0.9)), (0.01, (LEAST, 0.01)), (0.95, (0.95, 0.9))],
)
def test_predicted_growth_keeps_to_the_limits(own: float, found: tuple[float, float]) -> None:
    """Assert the bounds of growth, that no norm is remembered, and at most 0.9 after a rejection."""
    assert predicted(own, LEAST, GREATEST) == (found[0], formulas.LEAST_LOGARITHM, found[1])


@pytest.mark.parametrize(
    ("factor", "cut", "rejected", "found"),
    [
        (2.0, 0.0, 0.0, 0.2),
        (2.0, 0.0, 1.0, 0.1),
        (0.5, 0.0, 1.0, 0.05),
        (2.0, 1.0, 0.0, 0.7),
        (9.0, 1.0, 0.0, 0.9),
        (2.0, 1.0, 1.0, 0.1),
        (90.0, 0.0, 0.0, 5.0),
        (1e-9, 0.0, 0.0, 1e-3),
    ],
)
def test_the_next_step(factor: float, cut: float, rejected: float, found: float) -> None:
    """Assert no growth after a rejection, no loss by a cut, and both bounds."""
    assert next_step(0.1, factor, cut, rejected, 0.7, 1e-3, 5.0) == pytest.approx(found, rel=1e-15)
