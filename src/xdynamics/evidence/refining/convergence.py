"""Convergence of values with a step or another small number: observed orders, limits, uncertainties.

Plain numbers, levels along the last axis from coarse to fine. The grid convergence index is that of Celik and others
(2008, Journal of Fluids Engineering 130, 078001, doi:10.1115/1.2960953), the fits are those of Eca and Hoekstra (2014,
Journal of Computational Physics 262, 104-130, doi:10.1016/j.jcp.2014.01.006), with the formal order of the method in
place of the second order of their finite volumes.

A number that is compared between levels gets a verdict, a limit, an uncertainty, and the rule that gave the
uncertainty. Many numbers are judged at once; each has the bits that it has alone. `verdict_text` puts a verdict into
words.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import dot, expm1, least_squares, log, power
from xdynamics.record.flag_words import in_prose

Floats = NDArray[np.float64]

SAFETY, CAUTION = 1.25, 3.0  # safety factors of an error estimate that is trusted, and of one that is not
STEEPEST = 64.0  # largest order, of either sign, that is resolved
BISECTIONS = 60
BEYOND = 0.1  # by which the order of a fit may exceed the formal one
LEAST_SHARE = 0.25  # of the formal order, below which an observed one is not trusted
GRID = 96  # orders that a fit tries first


def observed_orders(values: Floats, steps: Floats) -> Floats:
    """Return the observed order of each level from its differences with the level before and after it.

    If the differences of neighbours are h1**p - h2**p times a constant, p is found for any ratios of steps. It is
    signed: below zero, differences grow. Where they change sign it is that of Celik's equation for oscillations.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    steps : ndarray, shape (n,)
        Decreasing.

    Returns
    -------
    ndarray, shape (..., n)
        nan at both ends, and where two values are the same.

    Examples
    --------
    >>> observed_orders(10 - 3 * np.array([0.4, 0.2, 0.1]) ** 2, np.array([0.4, 0.2, 0.1])).round(6).tolist()
    [nan, 2.0, nan]
    """
    orders = np.full(values.shape, np.nan)
    change, ratio = np.diff(values, axis=-1), steps[:-1] / steps[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        grown = change[..., :-1] / change[..., 1:]
    defined = np.isfinite(grown) & (grown != 0.0)
    coarse, fine = (np.broadcast_to(part, grown.shape)[defined] for part in (ratio[:-1], ratio[1:]))
    inner = np.full(grown.shape, np.nan)
    inner[defined] = _solve_orders(grown[defined], coarse, fine)
    orders[..., 1:-1] = inner
    return orders


def _solve_orders(grown: Floats, coarse: Floats, fine: Floats) -> Floats:
    """Solve Celik's equation ``abs(grown) = fine**p (coarse**p - s)/(fine**p - s)`` for p, in which it is monotonic."""
    orders = np.clip(log(np.abs(grown)) / log(fine), -STEEPEST, STEEPEST)  # where abs(grown) is a power of one ratio
    uneven = coarse != fine
    if uneven.any():
        orders[uneven] = _bisect_orders(grown[uneven], log(coarse[uneven]), log(fine[uneven]))
    return orders


def _bisect_orders(grown: Floats, coarse: Floats, fine: Floats) -> Floats:
    """Solve it by bisection for ratios that differ, from their logarithms: then order 0 is not 0/0."""
    size, sign = np.abs(grown), np.sign(grown)
    low, high = np.full(size.shape, -STEEPEST), np.full(size.shape, STEEPEST)
    for _ in range(BISECTIONS):
        p = (low + high) / 2.0
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            upper = expm1(p * coarse) + np.where(sign > 0, 0.0, 2.0)
            lower = np.where(sign > 0, -1.0, 1.0) * expm1(-p * fine) + np.where(sign > 0, 0.0, 2.0)
            # at order 0 the quotient tends to that of the logarithms; with alternating signs it is 2/2
            value = np.where(p == 0.0, np.where(sign > 0, coarse / fine, 1.0), upper / lower)
        above = value > size
        low, high = np.where(above, low, p), np.where(above, p, high)
    orders: Floats = (low + high) / 2.0
    return orders


def extrapolated(coarse: Floats, fine: Floats, ratio: float, order: Floats | float) -> Floats:
    """Return Richardson's limit of coarse and fine values, element by element, for a ratio of steps above 1."""
    limit: Floats = fine + (fine - coarse) / expm1(order * log(ratio))
    return limit


@dataclass(frozen=True)
class Fit:
    """One fit of ``limit + sum(slopes * steps**orders)``.

    Attributes
    ----------
    limit : float
    slopes, orders : tuple of float
    spread : float
        Standard deviation of the values from the fit.
    residual : float
        How far the finest value is from the fit.
    error : float
        How far the finest value is from the limit.
    """

    limit: float
    slopes: tuple[float, ...]
    orders: tuple[float, ...]
    spread: float
    residual: float
    error: float


def fitted(values: Sequence[float], steps: Sequence[float], formal: float) -> Fit:
    """Fit values to a power of their steps by least squares, as Eca and Hoekstra do.

    At first the order is free, with equal weights and with weights by 1/step; the fit with the smaller spread is
    taken. An order above the formal one is set to it; one that is far below is replaced by the best fit with
    the formal order, half of it, or both.

    Parameters
    ----------
    values, steps : sequence of float, at least 4
    formal : float
        The order of the method.

    Examples
    --------
    >>> h = np.array([0.4, 0.3, 0.2, 0.1])
    >>> one = fitted(10 - 3 * h**2, h, 2.0)
    >>> round(one.limit, 7), round(one.slopes[0], 6), round(one.orders[0], 6)
    (10.0, -3.0, 2.0)
    """
    numbers, h = np.asarray(values, float), np.asarray(steps, float)
    free = _best_fit(_fit_free_order(numbers, h, formal, weights) for weights in _weightings(h))
    order = free.orders[0]
    if LEAST_SHARE * formal <= order <= formal + BEYOND:
        return free
    if order > formal:
        return _best_fit(_fit_fixed_orders(numbers, h, (formal,), weights) for weights in _weightings(h))
    trials = ((formal,), (formal / 2.0,), (formal / 2.0, formal))
    return _best_fit(_fit_fixed_orders(numbers, h, orders, weights) for orders in trials for weights in _weightings(h))


def fitted_uncertainty(values: Sequence[float], steps: Sequence[float], formal: float) -> tuple[float, Fit]:
    """Return the uncertainty of the finest value at 95 %, and its fit (Eca and Hoekstra, section 4)."""
    fit = fitted(values, steps, formal)
    scale = (max(values) - min(values)) / (len(values) - 1)
    trusted = LEAST_SHARE * formal <= fit.orders[0] <= formal + BEYOND and len(fit.orders) == 1
    remainder = fit.spread + abs(fit.residual)
    if fit.spread < scale:
        return (SAFETY if trusted else CAUTION) * abs(fit.error) + remainder, fit
    return (CAUTION * fit.spread / scale * (abs(fit.error) + remainder) if scale > 0.0 else remainder), fit


def _weightings(h: Floats) -> tuple[Floats, Floats]:
    """Return equal weights and weights by 1/step, each with a mean of 1."""
    return np.ones(len(h)), len(h) * (1.0 / h) / np.sum(1.0 / h)


def _best_fit(fits: Iterable[Fit]) -> Fit:
    return min(fits, key=lambda fit: fit.spread)


def _fit_free_order(values: Floats, h: Floats, formal: float, weights: Floats) -> Fit:
    """Fit with a free order: for each order the fit is linear, so the search is over one number."""
    from scipy.optimize import minimize_scalar

    def fit_spread(orders: Any) -> Floats:
        return _solution(values, power(h / h[0], np.asarray(orders)[..., None, None]), weights, free=True)[2]

    tried = np.linspace(LEAST_SHARE * formal / 8.0, 4.0 * formal, GRID)
    best = int(np.argmin(fit_spread(tried)))
    # a bounded search may end in any local minimum: the grid has found the neighbourhood of the lowest
    bounds = tried[max(best - 1, 0)], tried[min(best + 1, GRID - 1)]
    optimum = minimize_scalar(fit_spread, bounds=bounds, method="bounded", options={"xatol": 1e-12})
    return _fit_fixed_orders(values, h, (float(optimum.x),), weights, free=True)


def _fit_fixed_orders(
    values: Floats, h: Floats, orders: tuple[float, ...], weights: Floats, *, free: bool = False
) -> Fit:
    """Fit with given orders; `free` counts an order that a search determined as a further parameter."""
    # steps are divided by the coarsest: powers of small numbers would differ too much in size
    powers = power(h / h[0], np.array(orders)[:, None])
    solution, residuals, spread = _solution(values, powers, weights, free=free)
    slopes = tuple(float(term / power(h[0], p)) for term, p in zip(solution[1:], orders, strict=True))
    limit = float(solution[0])
    return Fit(limit, slopes, orders, float(spread), float(residuals[-1]), float(values[-1]) - limit)


def _solution(values: Floats, powers: Floats, weights: Floats, *, free: bool) -> tuple[Floats, Floats, Floats]:
    """Return the coefficients of 1 and the powers, shape (..., p, n), the residuals, and their standard deviation."""
    columns = np.stack([np.ones_like(powers[..., 0, :]), *np.moveaxis(powers, -2, 0)], axis=-1)
    root = np.sqrt(weights)
    solution = least_squares(root[:, None] * columns, root * values)
    residuals = values - dot(columns, solution[..., None, :])
    freedom = len(values) - 1 - powers.shape[-2] - int(free)
    spread = (
        np.sqrt(np.sum(weights * residuals**2, axis=-1) / freedom)
        if freedom > 0
        else np.full(residuals.shape[:-1], inf)
    )
    return solution, residuals, spread


VERDICTS = ("asymptotic", "pre_asymptotic", "roundoff", "event_limited", "interpolation_limited", "not_converging")
ASYMPTOTIC, PRE_ASYMPTOTIC, ROUNDOFF, EVENT_LIMITED, INTERPOLATION_LIMITED, NOT_CONVERGING = range(len(VERDICTS))
# largest order assumed for a switch that was stepped over: a single level may by chance have it at the end of a step
ABRUPT = 2.0
RESTRAINED = (
    "three times the last difference and the sum of the steps own estimates: others than the tolerance set the steps"
)
STEPPED_OVER = "three times the last differences: a switch was stepped over"
THRICE, RICHARDSON, SQUARES = (
    "three times the last difference",
    "three times the error by Richardson extrapolation",
    "least squares",
)
MISSING, ROUNDED, INDEX, POWER = (
    "none: a value is missing",
    "rounding",
    "grid convergence index",
    "a power of the tolerance",
)
UNCERTAINTY_RULES = (POWER, INDEX, SQUARES, MISSING, ROUNDED, RICHARDSON, THRICE, STEPPED_OVER, RESTRAINED)
FREE = 0.7  # of the growth in steps that tolerances ask for: with less, something else sets many of them
CLOSE = 0.05  # distance of an observed order from that of the method, or from a whole number above it
STEADY = 0.25  # distance from the order before, where there are four levels
# times the square of the method's order, over the root of the number of steps: how far the logarithm of an error may
# deviate from a power of the tolerance, at 95 %. An error is the order-th power of steps that are chosen anew at each
# tolerance, and the higher the order, the fewer and longer are the steps in which most of it arises. From 800 studies
# of orbits and 400 of others; of 3,200 numbers of the eccentric ones by dop853 96 in 100 are covered, of 580 others 98.
ERRATIC = 0.15
HIGHEST = 8.0  # order assumed where the method is not known
MOST_ERRATIC = 10.0  # largest factor by which an error may deviate from a power of the tolerance
FEW_STEPS = 100  # number of steps assumed where it is not known
FITTED = 4  # fewest levels of a fit that leave a residual
LOOKED_AT = 3  # finest levels, whose differences give the distance from the limit
SHARE = 0.3  # of the last difference: largest effect of the location of events


def are_restrained(accepted: Sequence[int], tolerances: Floats, order: float) -> bool:
    """Whether steps do not get as many, from the coarsest level to the finest, as their tolerances ask for.

    Breaking points of delayed values, ticks, times of tables and the largest step set many of them then: differences of
    levels are those of the few steps that the tolerance chose, and say nothing of the others.

    Examples
    --------
    >>> are_restrained([100, 158], np.array([1e-6, 1e-7]), 5.0), are_restrained([100, 120], np.array([1e-6, 1e-7]), 5.0)
    (False, True)
    """
    coarse, fine = (max(int(accepted[level]), 1) for level in (0, -1))
    requested_growth = float(log(np.array(tolerances[0] / tolerances[-1]))) / order
    return float(log(np.array(fine / coarse))) < FREE * requested_growth


@dataclass(frozen=True)
class Judged:
    """The verdicts of levels on numbers; on one number they are no arrays.

    Attributes
    ----------
    verdict : int, or ndarray of int
        Indices into `VERDICTS`.
    limit : float, or ndarray
        Of values with ever smaller steps; nan if it is not known.
    uncertainty : float, or ndarray
        Of the finest value, at about 95 %.
    rule : str, or ndarray of int
        How the uncertainty is estimated: one of `UNCERTAINTY_RULES`, of many numbers its index there.
    """

    verdict: Any
    limit: Any
    uncertainty: Any
    rule: Any


def judge(
    values: Floats,
    steps: Floats,
    formal: float,
    rounding: Any,
    interpolation: Any,
    events: Any,
    *,
    smooth: bool = True,
    kink: Any = inf,
    accepted: int = FEW_STEPS,
    order: float = HIGHEST,
    estimated: Any = 0.0,
) -> Judged:
    """Judge the convergence of values of levels, from coarse to fine.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    steps : ndarray, shape (n,)
    formal : float
        The order of the method in the steps.
    rounding, interpolation, events : float, or ndarray, shape (...)
        Errors of the finest two values by rounding, interpolation and the location of events.
    smooth : bool
        Whether errors have an expansion in powers of the steps; in tolerances, with which chosen steps jump, they have
        none.
    kink : float, or ndarray, shape (...)
        The order that is left by a switch in a force that steps went over, with a factor that is not bounded: it
        depends on where in a step the switch lies, and changes from level to level.
    accepted : int
        Steps of the finest level, where they are chosen: the fewer, the more erratic.
    order : float
        The order of the method in its steps, where tolerances are varied.
    estimated : float, or ndarray, shape (...)
        Where something else than the tolerance sets the steps, so that levels differ by little whatever they are off: what
        the steps of the finest estimate themselves, together.
    """
    shape = values.shape[:-1]
    numbers = np.asarray(values, float).reshape(-1, values.shape[-1])
    off = (
        np.broadcast_to(np.asarray(error, float), shape).ravel()
        for error in (rounding, interpolation, events, kink, estimated)
    )
    judging = _Judging(numbers, np.asarray(steps, float), formal, *off)
    judging.judge(None if smooth else ERRATIC * order * order / float(np.sqrt(max(accepted, 1))))
    if not shape:
        limit, uncertainty = float(judging.limit[0]), float(judging.uncertainty[0])
        return Judged(int(judging.verdict[0]), limit, uncertainty, UNCERTAINTY_RULES[judging.rule[0]])
    many = judging.verdict, judging.limit, judging.uncertainty, judging.rule
    return Judged(*(judged_values.reshape(shape) for judged_values in many))


class _Judging:
    """Numbers of which those that are judged leave those that remain."""

    def __init__(
        self,
        values: Floats,
        steps: Floats,
        formal: float,
        rounding: Floats,
        interpolation: Floats,
        events: Floats,
        kink: Floats,
        estimated: Floats,
    ) -> None:
        self.values, self.steps, self.formal, self.kink, self.estimated = values, steps, formal, kink, estimated
        self.rounding, self.interpolation, self.events = rounding, interpolation, events
        self.remainder = rounding + interpolation + events
        count = len(values)
        self.verdict, self.rule = np.zeros(count, np.int8), np.zeros(count, np.int8)
        self.limit, self.uncertainty = np.full(count, np.nan), np.full(count, np.nan)
        self.open = np.ones(count, bool)
        with np.errstate(invalid="ignore"):
            self.last = np.abs(values[:, -1] - values[:, -2])

    def settle(self, which: Any, verdict: Any, rule: str, uncertainty: Any, limit: Any = np.nan) -> None:
        """Judge those of the open numbers that something is true of."""
        newly_settled = self.open & which
        for results, value in ((self.verdict, verdict), (self.uncertainty, uncertainty), (self.limit, limit)):
            results[newly_settled] = np.broadcast_to(value, newly_settled.shape)[newly_settled]
        self.rule[newly_settled] = UNCERTAINTY_RULES.index(rule)
        self.open &= ~which

    def judge(self, erratic: float | None) -> None:
        """Judge every number; `erratic` where errors have no expansion in powers of the steps."""
        values, steps, last, remainder = self.values, self.steps, self.last, self.remainder
        self.settle(~np.isfinite(values[:, -2:]).all(axis=-1), NOT_CONVERGING, MISSING, np.nan)
        # it is not known on which side of an event these are, however close they are
        self.settle(np.isinf(self.events), EVENT_LIMITED, THRICE, np.inf)
        restrained = self.estimated > self.rounding
        self.settle(restrained, PRE_ASYMPTOTIC, RESTRAINED, CAUTION * last + self.estimated + remainder)
        self.settle(last <= self.rounding, ROUNDOFF, ROUNDED, remainder + last)
        ratio, orders = float(steps[-2] / steps[-1]), observed_orders(values, steps)
        observed = orders[:, -2] if len(steps) > 2 else np.full(len(values), np.nan)
        least_order = LEAST_SHARE * self.formal
        with np.errstate(all="ignore"):
            slowest = np.where(np.isfinite(observed), np.clip(observed, least_order, self.formal), least_order)
            cautious = CAUTION * self.distance_bound(slowest)
            wider = np.maximum(CAUTION * last, cautious) + remainder
            self.settle(self.interpolation >= last, INTERPOLATION_LIMITED, THRICE, wider)
            self.settle(self.events >= SHARE * last, EVENT_LIMITED, THRICE, wider)
            if erratic is not None:
                self.in_tolerances(orders, erratic)
                return
            stepped_over = CAUTION * self.distance_bound(np.minimum(self.kink, ABRUPT)) + remainder
            self.settle(self.kink <= self.formal, EVENT_LIMITED, STEPPED_OVER, stepped_over)
            trusted = self.trusted(observed, orders)
            limit = extrapolated(values[:, -2], values[:, -1], ratio, observed)
            error = SAFETY * self.distance_bound(np.minimum(observed, trusted)) + remainder
            self.settle(np.isfinite(trusted), ASYMPTOTIC, INDEX, error, limit)
            self.unsteady(cautious)

    def unsteady(self, cautious: Floats) -> None:
        """Judge values whose observed order is not that of the method: by a fit, where there are levels enough for one."""
        values, steps = self.values, self.steps
        earlier_changes = np.abs(np.diff(values, axis=-1))[:, :-1]
        falls = (
            self.last < np.fmax.reduce(earlier_changes, axis=-1) / 2.0
            if earlier_changes.size
            else np.ones(len(values), bool)
        )
        verdict = np.where(falls, PRE_ASYMPTOTIC, NOT_CONVERGING)
        if len(steps) >= FITTED:
            limits, errors = np.full((2, len(values)), np.nan)
            fittable = self.open & np.isfinite(values[:, -FITTED:]).all(axis=-1)
            for i in np.flatnonzero(fittable).tolist():
                numbers = values[i, -FITTED:].tolist()
                errors[i], fit = fitted_uncertainty(numbers, steps[-FITTED:].tolist(), self.formal)
                limits[i] = fit.limit if falls[i] else np.nan
            # one power of the step does not fit values that fall by thousands from the coarsest to the finest
            self.settle(errors <= cautious, verdict, SQUARES, errors + self.remainder, limits)
            self.settle(fittable, verdict, RICHARDSON, cautious + self.remainder, limits)
        self.settle(self.open, verdict, RICHARDSON, cautious + self.remainder)

    def in_tolerances(self, orders: Floats, erratic: float) -> None:
        """Judge values whose errors are proportional to a tolerance, up to a factor that varies with the choice of steps.

        The logarithm of that factor is `erratic` at 95 %. The deviation of an observed exponent from 1 shows how much the
        factor varies from level to level, so it bounds the unseen part too. A single exponent is never called steady.
        """
        values, tolerances = self.values, self.steps
        changes, ratio = np.abs(np.diff(values, axis=-1)), float(tolerances[-2] / tolerances[-1])
        exponents = orders[:, 1:-1][:, -2:]
        away = np.fmax.reduce(np.abs(exponents - 1.0), axis=-1, initial=-inf)
        deviation = np.where(away >= 0.0, away * float(log(ratio)), 0.0)
        growth = expm1(np.minimum(np.maximum(deviation, erratic), STEEPEST))
        factor = SAFETY * np.minimum(MOST_ERRATIC, 1.0 + growth)
        uncertainty = factor * self.distance_bound(np.ones(len(values))) + self.remainder
        self.settle(self.kink < inf, EVENT_LIMITED, STEPPED_OVER, CAUTION * uncertainty)
        if exponents.shape[-1] > 1:
            steady = (np.ptp(exponents, axis=-1) <= STEADY) & (away <= STEADY)
            limit = extrapolated(values[:, -2], values[:, -1], ratio, exponents[:, -1])
            self.settle(steady, ASYMPTOTIC, POWER, uncertainty, limit)
        falls = np.ones(len(values), bool)
        if changes.shape[-1] > 1:
            falls = self.last < np.fmax.reduce(changes[:, :-1], axis=-1)
        self.settle(self.open, np.where(falls, PRE_ASYMPTOTIC, NOT_CONVERGING), POWER, uncertainty)

    def trusted(self, order: Floats, orders: Floats) -> Floats:
        """Return trusted orders: the formal order, or a higher integer order that four levels agree on; else nan."""
        order_change = np.abs(order - orders[:, -3]) if orders.shape[-1] >= FITTED else np.full(len(order), np.nan)
        whole_order, near = np.round(order), np.abs(order - self.formal) <= CLOSE
        higher = (order_change <= STEADY) & (whole_order > self.formal) & (np.abs(order - whole_order) <= CLOSE)
        return np.where(near & ~(order_change > STEADY), self.formal, np.where(higher, whole_order, np.nan))

    def distance_bound(self, order: Floats) -> Floats:
        """Return how far finest values may be from their limits, by the worst of the last differences, scaled to its step.

        A single difference may be small by chance, where two terms of the error cancel.
        """
        values, steps, worst = self.values, self.steps, np.zeros(len(self.values))
        for k in range(max(0, len(steps) - LOOKED_AT), len(steps) - 1):
            change, ratio, down = (
                np.abs(values[:, k + 1] - values[:, k]),
                steps[k] / steps[k + 1],
                steps[k + 1] / steps[-1],
            )
            scaled = change / expm1(order * log(ratio)) / power(down, order)
            worst = np.where(np.isfinite(change), np.fmax(worst, scaled), worst)
        return worst


IN_WORDS = (
    "differences of levels fall at the method's order, so that the limit and its uncertainty follow from that order",
    "differences fall, but not yet at the method's order: none is relied on, and the uncertainty is wider for it",
    "levels differ by no more than rounding: finer ones would tell nothing more",
    "locating events, or a switch that steps went over, is as uncertain as levels are apart: the uncertainty has it",
    "the number between steps is as uncertain as levels are apart: the uncertainty has it",
    "differences do not fall, or a value is missing: finer levels are needed before anything is said of the number",
)
MEANINGS = dict(zip(VERDICTS, IN_WORDS, strict=True))


def verdict_text(verdict: str) -> str:
    """Return a verdict with its meaning.

    Examples
    --------
    >>> verdict_text("roundoff")
    'roundoff: levels differ by no more than rounding: finer ones would tell nothing more'
    """
    return f"{in_prose(verdict)}: {MEANINGS[verdict]}"
