"""Searches of a fit: from the model's own values, by parts of the data that grow, and from starts that are drawn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import power
from xdynamics.faults import InputError

Floats = NDArray[np.float64]

OWN, GROWING, DRAWN = (
    "the model's own values",
    "fits to parts of the time that grow",
    "drawn about the model's own values",
)
CLOSE = 1e-10  # relative, of parameters and of the sum of squares, when a search ends
MOST = 100  # evaluations
SHARES = (0.06, 0.12, 0.25, 0.5)  # of the time of the data, one after the other
LOOKED_AT = 96  # starts that are drawn, of which the best are searched from
WIDTHS = (0.1, 0.5, 1.0)  # of the sizes of the numbers, as many starts of each; the last by factors
FARTHEST = 8.0  # such a factor


class Problem(Protocol):
    """What searches need to know of a fit."""

    def looked(self, scaled: Floats, share: float = 1.0) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes, of the data up to a share of their time."""

    def squares(self, scaled: Floats, share: float) -> Floats:
        """Return the sums of squares of many starts, of a share of the time; infinite where a run does not come to all times."""


@dataclass(frozen=True)
class Search:
    """One search, of numbers over their sizes.

    Attributes
    ----------
    rule : str
        Where it began.
    start, end : ndarray, shape (n,)
    square : float
        Sum of squares at the end; infinite of one that came to a run without an end.
    evaluations : int
    converged : bool
    stopped : str
        Why it ended.
    residual, slopes : ndarray, shape (m,) and (m, n)
        Over the uncertainties, at the end.
    bounded : ndarray of bool, shape (n,)
        Whether it ended on a bound, but for how closely it searched: it never comes to one whole.
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


def searches(problem: Problem, start: Floats, low: Floats, high: Floats, most: int, seed: int) -> Iterator[Search]:
    """Yield one search after the other, as many as are asked for: whoever reads them stops where one does.

    One that comes to a run that does not come to all times has an infinite sum of squares.
    """
    yield _tried(problem, OWN, start, low, high)
    if most > 1:
        yield grown(problem, GROWING, start, low, high)
    if most > 2:
        drawn = drawn_starts(np.random.default_rng(seed), start, low, high)
        for i in np.argsort(problem.squares(drawn, SHARES[-2]), kind="stable")[: most - 2].tolist():
            yield grown(problem, DRAWN, drawn[i], low, high)


def drawn_starts(rng: np.random.Generator, start: Floats, low: Floats, high: Floats) -> Floats:
    """Return starts about one, near and far: a third of them farther, by factors, or where there are bounds between them."""
    shape = LOOKED_AT, start.size
    width = np.array(WIDTHS)[np.arange(LOOKED_AT) % len(WIDTHS), None]
    offsets = rng.uniform(-1.0, 1.0, shape)
    far = np.where(start == 0.0, offsets, start * power(FARTHEST, offsets))
    bounded = np.isfinite(low) & np.isfinite(high)
    least, widest = np.where(bounded, low, 0.0), np.where(bounded, high, 1.0)
    far = np.where(bounded, least + (widest - least) * rng.random(shape), far)
    return np.clip(np.where(width == WIDTHS[-1], far, start + width * offsets), low, high)


def grown(problem: Problem, rule: str, start: Floats, low: Floats, high: Floats) -> Search:
    """Search by parts of the time that grow, each from where the one before has ended.

    Of a motion that turns many times the sum of squares over all of them has minima close to each other, over the first of
    them wide ones.
    """
    end, evaluations = start, 0
    for share in SHARES:
        stage = _tried(problem, rule, end, low, high, share)
        end, evaluations = stage.end, evaluations + stage.evaluations
    last = _tried(problem, rule, end, low, high)
    return replace(last, start=start, evaluations=evaluations + last.evaluations)


def search(problem: Problem, rule: str, start: Floats, low: Floats, high: Floats, share: float = 1.0) -> Search:
    """Search the least sum of squares from one start."""
    from scipy.optimize import least_squares

    cache: dict[bytes, tuple[Floats, Floats]] = {}

    def looked(scaled: Floats) -> tuple[Floats, Floats]:
        """Return weighted residuals and their slopes; the last ones are remembered."""
        key = scaled.tobytes()
        if key not in cache:
            cache.clear()
            cache[key] = problem.looked(scaled, share)
        return cache[key]

    residual: Callable[[Floats], Floats] = lambda x: looked(x)[0]  # noqa: E731
    solution = least_squares(
        residual, np.clip(start, low, high), lambda x: looked(x)[1], bounds=(low, high), xtol=CLOSE, ftol=CLOSE, gtol=CLOSE, max_nfev=MOST,
    )  # fmt: skip
    return Search(
        rule, start, solution.x, 2.0 * float(solution.cost), int(solution.nfev), bool(solution.status > 0), str(solution.message),
        solution.fun, solution.jac, solution.active_mask != 0,
    )  # fmt: skip


def _tried(problem: Problem, rule: str, start: Floats, low: Floats, high: Floats, share: float = 1.0) -> Search:
    """Search from a start that need not lead to an end: of one that does not it stays where it was."""
    try:
        return search(problem, rule, start, low, high, share)
    except InputError as error:
        return Search(rule, start, start, np.inf, 0, converged=False, stopped=str(error))
