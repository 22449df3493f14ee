"""Propagation of distributions by drawing, and a test of linear budgets: JCGM 101:2008.

Runs are marched with inputs drawn from the declared distributions: a given number of runs, or as many as suffice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, floor, inf, nan, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.physical import input_axis_name
from xdynamics.elementary.arrays import exp
from xdynamics.faults import InputError
from xdynamics.model.uncertainty import normal_quantile
from xdynamics.sweeping.axes import DECLARED, MIN_PROBABILITY, Draws
from xdynamics.units import Unit, parse_quantity

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

LINEAR = ("adequate", "not_adequate", "not_checked")
ADEQUATE, NOT_ADEQUATE, NOT_CHECKED = range(len(LINEAR))
PARTS = 20  # of the draws, whose scatter gives the uncertainty over all draws
SURE = 2.0  # standard uncertainties allowed for the few draws
REFUTED = 1.5  # times that, beyond which a linear budget is not adequate
NARROW = 0.2  # of the tolerance; a smaller distance of the ends from it cannot be resolved
MARGIN = 2.5  # more standard uncertainties, by which chance may enlarge the distance of the ends


@dataclass(frozen=True)
class DrawStatistics:
    """Statistics of the draws of a number.

    Attributes
    ----------
    mean, standard : float
    shortest, symmetric : (float, float)
        Intervals that hold the stated part of all draws: the shortest one, and one with as many draws on either side.
    standard_doubt, ends_doubt : float
        Standard uncertainties of the standard uncertainty and of the ends of the symmetric interval, from the finite
        number of draws.
    ends_reach : float
        Largest error of the ends, at `SURE` standard uncertainties; infinite where the draws are too few to bracket
        them.
    """

    mean: float
    standard: float
    shortest: tuple[float, float]
    symmetric: tuple[float, float]
    standard_doubt: float
    ends_doubt: float
    ends_reach: float


NOTHING_DRAWN = DrawStatistics(nan, nan, (nan, nan), (nan, nan), nan, nan, nan)  # before anything is


def draw_statistics(values: Floats, coverage: float) -> DrawStatistics:
    """Return the statistics of draws (JCGM 101:2008, 7.6 and 7.7).

    Raises
    ------
    InputError
        If there are too few draws for the coverage.

    Examples
    --------
    >>> one = draw_statistics(np.arange(1000.0), 0.9)
    >>> one.symmetric, round(one.shortest[1] - one.shortest[0])
    ((49.0, 949.0), 900)
    """
    count = len(values)
    interval_draws = round(coverage * count)  # draws in an interval
    if count < 2 * PARTS or not 0 < interval_draws < count:
        raise InputError(f"{count} draws are too few for an interval of {coverage:.4g}; take {max(10_000, 2 * PARTS)}")
    ordered = np.sort(values)
    widths = ordered[interval_draws:] - ordered[: count - interval_draws]
    k, tail_index = int(np.argmin(widths)), (count - interval_draws + 1) // 2 - 1
    deviations = np.array([part.std(ddof=1) for part in np.array_split(values, PARTS)])
    return DrawStatistics(
        float(values.mean()),
        float(values.std(ddof=1)),
        (float(ordered[k]), float(ordered[k + interval_draws])),
        (float(ordered[tail_index]), float(ordered[tail_index + interval_draws])),
        float(deviations.std(ddof=1) / np.sqrt(PARTS)),
        _end_reach(ordered, coverage, 1.0),
        _end_reach(ordered, coverage, SURE),
    )


def _end_reach(ordered: Floats, coverage: float, coverage_factor: float) -> float:
    """Return half the larger distance of the order statistics that bracket the ends of an interval.

    The number of draws below a quantile p is binomial: n p, with the standard deviation sqrt(n p (1 - p)), for any
    distribution (David and Nagaraja, Order Statistics, 2003, section 7.1).
    """
    count, p = len(ordered), (1.0 - coverage) / 2.0
    rank_deviation = coverage_factor * float(np.sqrt(count * p * (1.0 - p)))
    ends = [
        (floor(centre - rank_deviation), ceil(centre + rank_deviation)) for centre in (count * p, count * (1.0 - p))
    ]
    if ends[-1][1] >= count:  # then the lower end may lie below all draws too
        return inf
    return max(float(ordered[high] - ordered[low]) for low, high in ends) / 2.0


def tolerance_of(standard: float, digits: int = 1) -> float:
    """Return half a unit in the last digit of a standard uncertainty with so many digits (JCGM 101:2008, 7.9.2).

    Examples
    --------
    >>> tolerance_of(0.0755), tolerance_of(12.0)
    (0.005, 5.0)
    >>> tolerance_of(0.0755, 2)
    0.0005
    """
    if not standard > 0.0:
        return nan
    power = int(f"{standard:.{digits - 1}e}".split("e")[1])
    # read from decimal text it is the nearest float, which a product of powers of ten may miss
    return float(f"5e{power - digits}")


def draws_needed(distance: float, statistics: DrawStatistics, draws: int, coverage: float, digits: int = 1) -> float:
    """Return about how many draws decide whether the linear budget is adequate, where `draws` leave it open.

    Ends of an interval of n normal numbers are uncertain by sqrt(p (1 - p)/n)/density(p): four and a half times that
    must fit between the tolerance and the distance of the ends, reduced by chance.

    Examples
    --------
    >>> few = DrawStatistics(0.0, 0.061, (-0.12, 0.12), (-0.12, 0.12), 0.0006, 0.003, 0.006)
    >>> draws_needed(0.002, few, 4000, 0.95), draws_needed(0.005, few, 4000, 0.95)
    (23000.0, 230000.0)
    """
    p = (1.0 - coverage) / 2.0
    quantile = float(normal_quantile(np.array([p]))[0])
    density = float(exp(np.array(-(quantile**2) / 2.0))) / sqrt(2.0 * pi)
    single_draw_doubt = statistics.standard * sqrt(p * (1.0 - p)) / density  # of a single draw
    chance = single_draw_doubt / sqrt(draws)
    tolerance = tolerance_of(statistics.standard, digits)
    gap = min(abs(tolerance - sqrt(max(distance**2 - 2.0 * chance**2, 0.0))), tolerance)
    draw_count = max(((SURE + MARGIN) * single_draw_doubt / max(gap, NARROW * tolerance)) ** 2, 2.0 * draws)
    return float(f"{1.05 * draw_count:.1e}")


def judge_linear(
    value: float, standard: float, statistics: DrawStatistics, coverage: float, digits: int = 1
) -> tuple[int, float]:
    """Compare a linear budget's interval with the draws' own (JCGM 101:2008, 8.1).

    Returns
    -------
    int
        Index in `LINEAR`: adequate where both ends are within the tolerance of the draws' standard uncertainty, not
        checked where too few draws leave it open.
    float
        The larger distance of the ends.
    """
    factor = float(normal_quantile(np.array([(1.0 + coverage) / 2.0]))[0])
    linear = value - factor * standard, value + factor * standard
    distance = max(abs(end - drawn_end) for end, drawn_end in zip(linear, statistics.symmetric, strict=True))
    tolerance, doubt = tolerance_of(statistics.standard, digits), statistics.ends_reach
    if distance + doubt <= tolerance or distance == doubt == 0.0:
        return ADEQUATE, distance
    return (NOT_ADEQUATE if distance - REFUTED * doubt > tolerance else NOT_CHECKED), distance


MAX_DRAWS = 1 << 22
STREAM = 1  # of random numbers, besides that of the inputs


@dataclass(frozen=True)
class Propagation:
    """The distributions that are propagated to a number.

    Attributes
    ----------
    measurand : Measurand
    names : sequence of str
        The uncertain inputs of the model that are drawn.
    value : float
        The number in the run itself, used if no input is drawn.
    added : sequence of float
        Standard uncertainties of terms that are not inputs of the model, added to each draw as normal.
    """

    measurand: Measurand
    names: Sequence[str]
    value: float
    added: Sequence[float]

    def values(self, draws: int) -> Floats:
        """March runs with drawn inputs, and return the number in each.

        Raises
        ------
        InputError
            If nothing is uncertain, or a run does not have the number.
        """
        numbers = self.numbers(draws)
        return self.added_to(None if numbers is None else numbers.values, draws)

    def check(self) -> None:
        """Check that something is uncertain.

        Raises
        ------
        InputError
            If nothing is.
        """
        if not self.names and not self.added:
            raise InputError(
                "nothing in the model has an uncertainty to draw from; give parameters or initial values one"
            )

    def numbers(self, draws: int) -> xr.DataArray | None:
        """Return the number in runs with drawn inputs, lazy; None if no input is drawn."""
        if not self.names:
            return None
        names = [input_axis_name(self.measurand.model, name) for name in self.names]
        return self.measurand.numbers({"draw": Draws(draws, names, design=DECLARED, seed=self.measurand.seed)})

    def added_to(self, input_numbers: Floats | None, draws: int) -> Floats:
        """Add the drawn effects of terms that are no inputs of the model to the number of each run.

        Raises
        ------
        InputError
            If nothing is uncertain, or a run does not have the number.
        """
        self.check()
        values = np.full(draws, self.value) if input_numbers is None else input_numbers
        if missing := int(np.count_nonzero(~np.isfinite(values))):
            raise InputError(
                f"{self.measurand.target.description} does not exist in {missing} of {draws} draws: the inputs are too uncertain for it to"
                " be one number"
            )
        points = np.random.default_rng([self.measurand.seed, STREAM]).random((draws, len(self.added)))
        for k, standard in enumerate(self.added):
            # a drawn point may be 0, whose quantile is infinite
            values = values + standard * normal_quantile(np.maximum(points[:, k], MIN_PROBABILITY))
        return values


def draw_until_known(
    propagation: Propagation, draws: int, coverage: float, end_tolerance: float
) -> tuple[DrawStatistics, int]:
    """Draw until the intervals' ends are known as well as wanted; return the result and the number of draws.

    Raises
    ------
    InputError
        If the largest number of draws does not suffice.
    """
    while True:
        statistics = draw_statistics(propagation.values(draws), coverage)
        if statistics.ends_doubt <= end_tolerance:
            return statistics, draws
        if draws >= MAX_DRAWS:
            raise InputError(
                f"{draws} draws leave the ends of the interval uncertain by {statistics.ends_doubt:.3g}, and {end_tolerance:.3g}"
                " is wanted; ask for less"
            )
        draws *= 2


def end_tolerance_of(size_text: str, unit: Unit, target: Target, default_level: float) -> float:
    """Return the standard uncertainty wanted of the intervals' ends.

    Raises
    ------
    InputError
        If it is not a positive size in a unit of the number, optionally with a percentage.
    """
    size, separator, level_text = str(size_text).partition(" at ")
    quantity = parse_quantity(size)
    try:
        level = float(level_text.strip().removesuffix("%")) / 100.0 if separator else default_level
    except ValueError:
        level = nan
    if quantity.unit.dimension != unit.dimension or not quantity.value > 0 or not 0.0 < level < 1.0:
        raise InputError(
            f"until_uncertainty is {size_text!r}, needs a positive size of {target.description}, like '1 {unit.text} at 95 %'"
        )
    return quantity.si / float(unit.factor) / float(normal_quantile(np.array([(1.0 + level) / 2.0]))[0])
