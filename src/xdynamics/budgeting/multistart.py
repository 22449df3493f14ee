"""Searches of a fit: from the model's own values, over growing parts of the data, and from drawn starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.losses import Loss
from xdynamics.elementary.arrays import power
from xdynamics.faults import InputError

Floats = NDArray[np.float64]

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
    """What searches need to know of a fit."""

    @property
    def loss(self) -> Loss:
        """What a residual counts."""

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
    """Return starts around a given one; the farthest third of them by factors, or between bounds if there are any."""
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
