"""Distributions propagated by drawing, and whether a linear budget is adequate: JCGM 101:2008."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.model.spread import normal_quantile

Floats = NDArray[np.float64]

LINEAR = ("adequate", "not_adequate", "not_checked")
ADEQUATE, NOT_ADEQUATE, NOT_CHECKED = range(len(LINEAR))
PARTS = 20  # of the draws, whose numbers tell how far those of all may be off
SURE = 2.0  # standard uncertainties of what few draws tell


@dataclass(frozen=True)
class Drawn:
    """What draws of a number tell.

    Attributes
    ----------
    mean, standard : float
    shortest, symmetric : (float, float)
        Intervals that hold the stated part of all draws: the shortest one, and one with as many on either side.
    standard_doubt, ends_doubt : float
        How far the standard uncertainty and the ends of the symmetric interval may be off, being of so many draws.
    """

    mean: float
    standard: float
    shortest: tuple[float, float]
    symmetric: tuple[float, float]
    standard_doubt: float
    ends_doubt: float


def drawn(values: Floats, coverage: float) -> Drawn:
    """Say what draws tell (JCGM 101:2008, 7.6 and 7.7).

    Raises
    ------
    InputError
        If there are too few for the coverage.

    Examples
    --------
    >>> one = drawn(np.arange(1000.0), 0.9)
    >>> one.symmetric, round(one.shortest[1] - one.shortest[0])
    ((49.0, 949.0), 900)
    """
    count = len(values)
    held = round(coverage * count)  # draws in an interval
    if count < 2 * PARTS or not 0 < held < count:
        raise InputError(f"{count} draws are too few for an interval of {coverage:.4g}; take {max(10_000, 2 * PARTS)}")
    ordered = np.sort(values)
    widths = ordered[held:] - ordered[: count - held]
    k, tail = int(np.argmin(widths)), max((count - held) // 2 - 1, 0)
    parts = np.array_split(values, PARTS)
    ends = np.array([np.quantile(one, [(1 - coverage) / 2, (1 + coverage) / 2]) for one in parts])
    deviations = np.array([one.std(ddof=1) for one in parts])
    return Drawn(
        float(values.mean()),
        float(values.std(ddof=1)),
        (float(ordered[k]), float(ordered[k + held])),
        (float(ordered[tail]), float(ordered[tail + held])),
        float(deviations.std(ddof=1) / np.sqrt(PARTS)),
        float(ends.std(axis=0, ddof=1).max() / np.sqrt(PARTS)),
    )


def tolerance_of(standard: float, digits: int = 1) -> float:
    """Return half of the last place that a standard uncertainty of so many digits has (JCGM 101:2008, 7.9.2).

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
    return float(f"5e{power - digits}")


def draws_needed(apart: float, found: Drawn, draws: int, digits: int = 1) -> float:
    """Return about how many draws tell whether the linear budget is adequate, where so many leave it open.

    What draws leave uncertain falls with the root of their number: until it is the distance of the ends from the tolerance.

    Examples
    --------
    >>> few = Drawn(0.0, 0.061, (-0.12, 0.12), (-0.12, 0.12), 0.0006, 0.003)
    >>> draws_needed(0.002, few, 4000), draws_needed(0.005, few, 4000)
    (16000.0, inf)
    """
    left = abs(tolerance_of(found.standard, digits) - apart)
    if not left > 0.0:
        return inf
    needed = draws * (SURE * found.ends_doubt / left) ** 2
    return float(f"{1.05 * needed:.1e}")


def judged(value: float, standard: float, found: Drawn, coverage: float, digits: int = 1) -> tuple[int, float]:
    """Compare a linear budget's interval with the draws' own (JCGM 101:2008, 8.1).

    Returns
    -------
    int
        Place in `LINEAR`: adequate where both ends are within the tolerance of the draws' standard uncertainty, not
        checked where too few draws leave it open.
    float
        The larger distance of the ends.
    """
    factor = float(normal_quantile(np.array([(1.0 + coverage) / 2.0]))[0])
    linear = value - factor * standard, value + factor * standard
    apart = max(abs(one - other) for one, other in zip(linear, found.symmetric, strict=True))
    tolerance, doubt = tolerance_of(found.standard, digits), SURE * found.ends_doubt
    if apart + doubt <= tolerance or apart == doubt == 0.0:
        return ADEQUATE, apart
    return (NOT_ADEQUATE if apart - doubt > tolerance else NOT_CHECKED), apart
