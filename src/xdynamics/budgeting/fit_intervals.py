"""Intervals of fitted numbers: by their covariance, or by the profile of the sum of squares.

A profile holds one number at a value, fits all others again, and asks how much larger the smallest sum of squares is. It
needs no law to be linear: its ends may lie at unlike distances (Bates, Watts 1988, Nonlinear Regression Analysis and Its
Applications, section 6.1). Where the data have no uncertainties their variance is that of the residuals, and few of them tell
it badly: Student's t takes the place of the normal distribution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.losses import Loss
from xdynamics.budgeting.multistart import Problem, Search, search_from_start

Floats = NDArray[np.float64]

COVARIANCE, PROFILE = "covariance", "profile"
MAX_PROFILE_POINTS = 20  # values at which a profile is asked for an end
NEAR = 1e-4  # of the distance in units of the quantile, at which an end is found
WIDEST = 3.0  # largest factor from one value to the next


@dataclass(frozen=True)
class ProfilePoint:
    """The problem in which one number is held at a value."""

    problem: Problem
    held_index: int
    value: float

    @property
    def loss(self) -> Loss:
        """That of the problem."""
        return self.problem.loss

    def all_numbers(self, free: Floats) -> Floats:
        """Return all numbers, from the others."""
        return np.insert(free, self.held_index, self.value)

    def weighted_residuals(self, scaled: Floats, share: float = 1.0) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes by the others."""
        residuals, slopes = self.problem.weighted_residuals(self.all_numbers(scaled), share)
        return residuals, np.delete(slopes, self.held_index, axis=1)

    def squares(self, scaled: Floats, share: float) -> Floats:
        """Return the sums of squares of many starts of the others."""
        return self.problem.squares(np.insert(scaled, self.held_index, self.value, axis=1), share)


def quantile(coverage: float, freedom: int, *, has_uncertainties: bool) -> float:
    """Return the half width of an interval in standard uncertainties.

    Examples
    --------
    >>> round(quantile(0.95, 3, has_uncertainties=True), 3), round(quantile(0.95, 3, has_uncertainties=False), 3)
    (1.96, 3.182)
    """
    from scipy.special import ndtri, stdtrit

    upper = 0.5 + coverage / 2.0
    return float(ndtri(upper) if has_uncertainties else stdtrit(freedom, upper))


def profile_intervals(
    problem: Problem, best: Search, low: Floats, high: Floats, deviations: Floats, rise: float, width: float
) -> Floats:
    """Return both ends of each number's interval, shape (n, 2); infinite where the profile does not rise enough.

    Parameters
    ----------
    problem : Problem
    best : Search
    low, high : ndarray, shape (n,)
        Bounds, scaled; an interval ends there at the latest.
    deviations : ndarray, shape (n,)
        Standard uncertainties, scaled.
    rise : float
        By how much the sum of squares is larger at an end.
    width : float
        How many standard uncertainties an end is away, of a linear law.
    """
    return np.array(
        [
            [_profile_end(problem, best, low, high, i, side * width * deviations[i], rise) for side in (-1.0, 1.0)]
            for i in range(best.end.size)
        ]
    )


def _profile_end(problem: Problem, best: Search, low: Floats, high: Floats, i: int, step: float, rise: float) -> float:
    """Follow the profile of one number to an end: secants of the root of its rise, which is linear of a linear law."""
    bound = float(high[i] if step > 0 else low[i])
    centre, free = float(best.end[i]), np.delete(best.end, i)
    inner, outer, root = (0.0, np.inf, 0.0)  # distances with less and with more than the rise, and the root at `inside`
    distance = abs(step)
    for _ in range(MAX_PROFILE_POINTS):
        distance = min(distance, abs(bound - centre))
        risen, free = _profile_rise(ProfilePoint(problem, i, centre + np.sign(step) * distance), free, best, low, high)
        distance_share = float(np.sqrt(max(risen, 0.0) / rise))
        if abs(distance_share - 1.0) < NEAR:
            return centre + float(np.sign(step)) * distance
        if distance_share < 1.0 and distance == abs(bound - centre):
            return bound
        slope = (distance_share - root) / (distance - inner) if np.isfinite(distance_share) else np.inf
        inner, root, outer = (distance, distance_share, outer) if distance_share < 1.0 else (inner, root, distance)
        next_distance = distance + (1.0 - distance_share) / slope if np.isfinite(slope) and slope > 0.0 else np.inf
        if not inner < next_distance < outer:
            next_distance = 0.5 * (inner + outer) if np.isfinite(outer) else WIDEST * distance
        distance = min(next_distance, WIDEST * distance)
    return float(np.sign(step)) * np.inf


def _profile_rise(point: ProfilePoint, free: Floats, best: Search, low: Floats, high: Floats) -> tuple[float, Floats]:
    """Return by how much the sum of squares is larger with one number held, and the others there."""
    from xdynamics.faults import InputError

    try:
        if not free.size:
            residuals, _ = point.weighted_residuals(free)
            return float(residuals @ residuals) - best.square, free
        optimum = search_from_start(
            point, PROFILE, free, np.delete(low, point.held_index), np.delete(high, point.held_index)
        )
    except InputError:
        return np.inf, free
    return optimum.square - best.square, optimum.end


def intervals_as(values: Floats, deviations: Floats, half: float) -> Floats:
    """Return intervals of estimates by their standard uncertainties."""
    ends: Any = values[:, None] + half * deviations[:, None] * np.array([-1.0, 1.0])
    return np.asarray(ends, float)
