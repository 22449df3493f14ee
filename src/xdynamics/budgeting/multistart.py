"""Searches of a fit from several starts, robust losses of its residuals, and intervals of its fitted numbers.

A search starts from the model's own values, over growing parts of the data, or from drawn starts.

A loss bounds the influence of a residual many times its uncertainty. With z the square of a residual over its scale, a
loss rho(z) takes the place of z in the sum of squares; near zero it is z. A residual has the influence psi(r) = r
rho'(z): bounded, of `cauchy` falling again, so that an outlier moves the estimate by no more than a good value does.
The scales are those at which an estimate from normal residuals is 95 % as sharp as that of least squares (Holland,
Welsch 1977, doi:10.1080/03610927708827533).

An interval of a fitted number follows from the covariance, or from the profile of the sum of squares. A profile fixes a
number at a value, fits all others again, and asks how much larger the smallest sum of squares is. It needs no law to be
linear: its ends may lie at unlike distances (Bates, Watts 1988, Nonlinear Regression Analysis and Its Applications,
section 6.1). Where the data have no uncertainties, their variance is that of the residuals, which few residuals
determine badly: Student's t takes the place of the normal distribution.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import log, power
from xdynamics.faults import InputError

Floats = NDArray[np.float64]

LINEAR = "linear"
LOSS_WIDTHS = {LINEAR: 1.0, "soft_l1": 1.287, "huber": 1.345, "cauchy": 2.385}  # scales, in standard uncertainties
NORMAL = 0.6744897501960817  # median size of a normal residual, in standard deviations


@dataclass(frozen=True)
class Loss:
    """A loss with its scale.

    Attributes
    ----------
    name : {"linear", "soft_l1", "huber", "cauchy"}
    spread : float
        Standard deviation of good residuals, in the units of the weighted ones: 1 where uncertainties are known.
    """

    name: str = LINEAR
    spread: float = 1.0

    @property
    def scale(self) -> float:
        """Size of a residual at which it begins to count less."""
        return LOSS_WIDTHS[self.name] * self.spread

    def sizes(self, residuals: Floats) -> Floats:
        """Return the loss of each residual, its addend in the minimised sum."""
        z = (residuals / self.scale) ** 2
        if self.name == "soft_l1":
            z = 2.0 * (np.sqrt(1.0 + z) - 1.0)
        elif self.name == "huber":
            z = np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0)
        elif self.name == "cauchy":
            z = log(1.0 + z)
        return z * self.scale**2

    def influences(self, residuals: Floats) -> tuple[Floats, Floats]:
        """Return psi of each residual, and its derivative."""
        z = (residuals / self.scale) ** 2
        if self.name == "soft_l1":
            return residuals / np.sqrt(1.0 + z), (1.0 + z) ** -1.5
        if self.name == "huber":
            is_near = z <= 1.0
            return np.clip(residuals, -self.scale, self.scale), is_near.astype(float)
        if self.name == "cauchy":
            return residuals / (1.0 + z), (1.0 - z) / (1.0 + z) ** 2
        return residuals, np.ones_like(residuals)

    def variance(self, residuals: Floats, fitted: int) -> float:
        """Return the factor of (J^T J)^-1 that makes it the covariance of the estimates.

        Huber 1981, Robust Statistics, equation 7.6.8; with a linear loss it is the variance of the residuals.
        """
        psi, slope = self.influences(residuals)
        share, mean = fitted / residuals.size, float(slope.mean())
        if not mean > 0.0:
            return float("inf")
        correction = 1.0 + share * float(slope.var()) / mean**2
        return correction**2 * float(psi @ psi) / (residuals.size - fitted) / mean**2


def loss_by_name(name: str) -> Loss:
    """Return a loss by its name.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in LOSS_WIDTHS:
        raise InputError(f"loss is {name!r}; there are {', '.join(LOSS_WIDTHS)}")
    return Loss(name)


def residual_spread(residuals: Floats) -> float:
    """Return the standard deviation of good residuals, of any shape: their median size over that of normal ones."""
    return float(np.median(np.abs(residuals))) / NORMAL


OWN, GROWING, DRAWN = (
    "the model's own values",
    "fits to parts of the time that grow",
    "drawn about the model's own values",
)
CLOSE = 1e-10  # relative tolerance of parameters and sum of squares at which a search ends
MAX_EVALUATIONS = 100  # evaluations
SHARES = (0.06, 0.12, 0.25, 0.5)  # of the time of the data, in this order
LOOKED_AT = 96  # drawn starts, from the best of which searches begin
START_WIDTHS = (0.1, 0.5, 1.0)  # relative to the numbers, equally many starts of each; the last by factors
FARTHEST = 8.0  # largest such factor


class Problem(Protocol):
    """The interface of a fit that searches need."""

    @property
    def loss(self) -> Loss:
        """The loss of a residual."""

    def weighted_residuals(self, scaled: Floats, share: float = 1.0) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes, for the data up to a share of their time."""

    def squares(self, scaled: Floats, share: float) -> Floats:
        """Return the sums of squares of many starts over a share of the time; infinite if a run ends before."""


@dataclass(frozen=True)
class Search:
    """One search, in scaled numbers.

    Attributes
    ----------
    rule : str
        How its start was chosen.
    start, end : ndarray, shape (n,)
    square : float
        Sum of squares, or of losses, at the end; infinite if a run ended before all times.
    evaluations : int
    converged : bool
    stopped : str
        Why it ended.
    residual, slopes : ndarray, shape (m,) and (m, n)
        Divided by the uncertainties, at the end.
    bounded : ndarray of bool, shape (n,)
        Whether it ended on a bound, within the tolerance of the search; it never reaches one exactly.
    """

    rule: str
    start: Floats
    end: Floats
    square: float
    evaluations: int
    converged: bool
    stopped: str
    residual: Floats = field(default_factory=lambda: np.zeros(0), repr=False)
    slopes: Floats = field(default_factory=lambda: np.zeros((0, 0)), repr=False)
    bounded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool), repr=False)


def searches(
    problem: Problem, start: Floats, low: Floats, high: Floats, max_searches: int, seed: int
) -> Iterator[Search]:
    """Yield up to `max_searches` searches, one after the other; the caller stops once one suffices.

    A search with a run that ends before all times has an infinite sum of squares.
    """
    yield _search_or_fail(problem, OWN, start, low, high)
    if max_searches > 1:
        yield search_growing(problem, GROWING, start, low, high)
    if max_searches > 2:
        starts = drawn_starts(np.random.default_rng(seed), start, low, high)
        for i in np.argsort(problem.squares(starts, SHARES[-2]), kind="stable")[: max_searches - 2].tolist():
            yield search_growing(problem, DRAWN, starts[i], low, high)


def drawn_starts(rng: np.random.Generator, start: Floats, low: Floats, high: Floats) -> Floats:
    """Return starts around a given one, shape (starts, n), within the bounds.

    The widest of them differ from it by factors, or lie anywhere between bounds if there are any.
    """
    shape = LOOKED_AT, start.size
    width = np.array(START_WIDTHS)[np.arange(LOOKED_AT) % len(START_WIDTHS), None]
    offsets = rng.uniform(-1.0, 1.0, shape)
    far_starts = np.where(start == 0.0, offsets, start * power(FARTHEST, offsets))
    bounded = np.isfinite(low) & np.isfinite(high)
    lowest, highest = np.where(bounded, low, 0.0), np.where(bounded, high, 1.0)
    far_starts = np.where(bounded, lowest + (highest - lowest) * rng.random(shape), far_starts)
    return np.clip(np.where(width == START_WIDTHS[-1], far_starts, start + width * offsets), low, high)


def search_growing(problem: Problem, rule: str, start: Floats, low: Floats, high: Floats) -> Search:
    """Search over growing parts of the time, each from the end of the previous one.

    For a motion of many periods the minima of the sum of squares lie close together over all of them, and are wide over
    the first few.
    """
    end, evaluations = start, 0
    for share in SHARES:
        stage = _search_or_fail(problem, rule, end, low, high, share)
        end, evaluations = stage.end, evaluations + stage.evaluations
    last = _search_or_fail(problem, rule, end, low, high)
    return replace(last, start=start, evaluations=evaluations + last.evaluations)


def search_from_start(
    problem: Problem, rule: str, start: Floats, low: Floats, high: Floats, share: float = 1.0
) -> Search:
    """Minimise the sum of squares from one start.

    Raises
    ------
    InputError
        If a run ends before all times, or there are too few data.
    """
    from scipy.optimize import least_squares

    cache: dict[bytes, tuple[Floats, Floats]] = {}

    def cached_evaluation(scaled: Floats) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes, remembering the last ones."""
        # scipy asks for residuals and slopes in two calls at the same point, and one march gives both
        key = scaled.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = problem.weighted_residuals(scaled, share)
        return cache[key]

    residual: Callable[[Floats], Floats] = lambda x: cached_evaluation(x)[0]  # noqa: E731
    solution = least_squares(
        residual,
        np.clip(start, low, high),
        lambda x: cached_evaluation(x)[1],
        bounds=(low, high),
        xtol=CLOSE,
        ftol=CLOSE,
        gtol=CLOSE,
        max_nfev=MAX_EVALUATIONS,
        loss=problem.loss.name,
        f_scale=problem.loss.scale,
    )
    return Search(
        rule,
        start,
        solution.x,
        # the cost of scipy is half the sum
        2.0 * float(solution.cost),
        int(solution.nfev),
        bool(solution.status > 0),
        str(solution.message),
        solution.fun,
        cached_evaluation(solution.x)[1],  # scipy's is multiplied by the loss's curvature
        solution.active_mask != 0,
    )


def _search_or_fail(
    problem: Problem, rule: str, start: Floats, low: Floats, high: Floats, share: float = 1.0
) -> Search:
    """Search from a start that may fail; a failed search ends at its start with an infinite sum of squares."""
    try:
        return search_from_start(problem, rule, start, low, high, share)
    except InputError as error:
        return Search(rule, start, start, np.inf, 0, converged=False, stopped=str(error))


COVARIANCE, PROFILE = "covariance", "profile"
MAX_PROFILE_POINTS = 20  # values at which a profile is asked for an end
NEAR = 1e-4  # of the distance in units of the quantile, at which an end is found
WIDEST = 3.0  # largest factor from one value to the next


@dataclass(frozen=True)
class ProfilePoint:
    """The problem of a fit in which one number is fixed at a value."""

    problem: Problem
    held_index: int
    value: float

    @property
    def loss(self) -> Loss:
        """The loss of the full problem."""
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
    """Return the rise of the sum of squares with one number fixed, and the other numbers fitted there."""
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
    """Return intervals of estimates, shape (n, 2), `half` standard uncertainties to either side."""
    ends: Any = values[:, None] + half * deviations[:, None] * np.array([-1.0, 1.0])
    return np.asarray(ends, float)
