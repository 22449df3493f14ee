"""Convergence of values with a step or another small number: observed orders, limits, uncertainty of the finest value.

Plain numbers, levels along the last axis from coarse to fine. The grid convergence index is that of Celik and others
(2008, Journal of Fluids Engineering 130, 078001, doi:10.1115/1.2960953), the fits are those of Eca and Hoekstra (2014,
Journal of Computational Physics 262, 104-130, doi:10.1016/j.jcp.2014.01.006), with the formal order of the method in
place of the second order of their finite volumes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import dot, expm1, least_squares, log, power

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
            value = np.where(p == 0.0, np.where(sign > 0, coarse / fine, 1.0), upper / lower)
        above = value > size
        low, high = np.where(above, low, p), np.where(above, p, high)
    orders: Floats = (low + high) / 2.0
    return orders


def extrapolated(coarse: Floats, fine: Floats, ratio: float, order: Floats | float) -> Floats:
    """Return Richardson's limit of two values whose steps have a ratio above 1."""
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
    bounds = tried[max(best - 1, 0)], tried[min(best + 1, GRID - 1)]
    optimum = minimize_scalar(fit_spread, bounds=bounds, method="bounded", options={"xatol": 1e-12})
    return _fit_fixed_orders(values, h, (float(optimum.x),), weights, free=True)


def _fit_fixed_orders(
    values: Floats, h: Floats, orders: tuple[float, ...], weights: Floats, *, free: bool = False
) -> Fit:
    """Fit with given orders; an order found by a search counts as a parameter too."""
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
