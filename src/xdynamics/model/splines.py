"""Slopes at the points of a measured table, in a fixed order of arithmetic that no library's version changes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def hermite_pieces(x: Floats, y: Floats, slope: Floats) -> Floats:
    """Return the cubic of every piece from the values and slopes at its ends.

    Parameters
    ----------
    x, y, slope : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (4, n - 1)
        Coefficients of (t - x[k])**3 … **0.
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    bend = (slope[:-1] + slope[1:] - 2.0 * secant) / h
    return np.stack([bend / h, (secant - slope[:-1]) / h - bend, slope[:-1], y[:-1]])


def monotone_slopes(x: Floats, y: Floats) -> Floats:
    """Weighted harmonic means of neighbouring secants, zero where these differ in sign.

    Fritsch and Butland 1984 (SIAM J. Sci. Stat. Comput. 5, 300); the ends by a shape-preserving three-point formula
    (Moler, Numerical Computing with MATLAB, section 3.6).
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    if len(x) == 2:
        return np.repeat(secant, 2)
    w1, w2 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w1 / secant[:-1] + w2 / secant[1:]) / (w1 + w2)
        inner = np.where(np.sign(secant[:-1]) * np.sign(secant[1:]) > 0.0, 1.0 / mean, 0.0)
    first, last = _end_slope(h[0], h[1], secant[0], secant[1]), _end_slope(h[-1], h[-2], secant[-1], secant[-2])
    return np.concatenate([[first], inner, [last]])


def _end_slope(h: float, h_next: float, secant: float, next_secant: float) -> float:
    slope = ((2.0 * h + h_next) * secant - h * next_secant) / (h + h_next)
    if np.sign(slope) != np.sign(secant):
        return 0.0
    turns = np.sign(secant) != np.sign(next_secant)
    return 3.0 * secant if turns and abs(slope) > 3.0 * abs(secant) else slope


def spline_slopes(x: Floats, y: Floats) -> Floats:
    """Slopes of the cubic spline with continuous third derivative at the second and last-but-one points (not-a-knot).

    de Boor, A Practical Guide to Splines (1978), chapter IV: a tridiagonal system, eliminated from the first row on,
    whose pivots stay positive. Three points are joined by a parabola, two by a line.
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    if len(x) == 2:
        return np.repeat(secant, 2)
    if len(x) == 3:
        middle = (h[1] * secant[0] + h[0] * secant[1]) / (h[0] + h[1])
        return np.array([2.0 * secant[0] - middle, middle, 2.0 * secant[1] - middle])
    first, last = x[2] - x[0], x[-1] - x[-3]
    lower = np.concatenate([[0.0], h[1:], [last]]).tolist()
    middle = np.concatenate([[h[1]], 2.0 * (h[:-1] + h[1:]), [h[-2]]]).tolist()
    upper = np.concatenate([[first], h[:-1], [0.0]]).tolist()
    inner = 3.0 * (h[1:] * secant[:-1] + h[:-1] * secant[1:])
    at_first = ((h[0] + 2.0 * first) * h[1] * secant[0] + h[0] * h[0] * secant[1]) / first
    at_last = (h[-1] * h[-1] * secant[-2] + (2.0 * last + h[-1]) * h[-2] * secant[-1]) / last
    right = np.concatenate([[at_first], inner, [at_last]]).tolist()
    for i in range(1, len(right)):
        factor = lower[i] / middle[i - 1]
        middle[i] -= factor * upper[i - 1]
        right[i] -= factor * right[i - 1]
    right[-1] /= middle[-1]
    for i in range(len(right) - 2, -1, -1):
        right[i] = (right[i] - upper[i] * right[i + 1]) / middle[i]
    return np.array(right)
