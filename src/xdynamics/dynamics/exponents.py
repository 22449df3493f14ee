"""Lyapunov exponents from the growth of tangent vectors, each with an uncertainty from its own convergence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.tangents import LocalGrowth
from xdynamics.elementary.arrays import apply_elementary, dot, log, product

Floats = NDArray[np.float64]

TRANSIENT = 0.1  # of a run, left out at its beginning
BATCHES = 16  # whose scatter gives the uncertainty
RULE = (
    "mean over time of the growth of tangent vectors by the variational equations along the run, orthonormal again"
    " after every step (Benettin et al. 1980), weighted by sin(pi s)**2, where s goes from 0 to 1 behind the transient"
)
TRANSIENT_RULE = "the first tenth of the run's time is left out, while vectors turn to where growth is largest"
UNCERTAINTY_RULE = (
    "root of the sum of squares of the standard error of the means of 16 equal parts of the time, the difference"
    " between the means of both halves, and the estimated error of the integration"
)
ROUNDING = 2.0**332  # bound below which factors are kept


@dataclass(frozen=True)
class Exponents:
    """Lyapunov exponents from the growth of tangent vectors.

    Attributes
    ----------
    values, uncertainties : ndarray, shape (m,), s-1
        The largest first.
    finite_time : float, s-1
        Logarithm of the growth until the end of the vector of the start that grows most, over the whole time.
    begin : float, s
        End of the transient.
    pieces, variables : int
        Number of pieces into which the steps were divided, and of variables of the state.
    """

    values: Floats
    uncertainties: Floats
    finite_time: float
    begin: float
    pieces: int
    variables: int


def exponents_of(local: LocalGrowth) -> Exponents:
    """Return the means of growth over the time after the transient, and their uncertainties."""
    begin, end = float(local.times[0]), float(local.times[-1])
    first = begin + TRANSIENT * (end - begin)
    growth = log(local.factors) + local.exponents * float(log(ROUNDING))
    values = _mean(local.times, growth, first, end)
    edges = first + (end - first) * np.arange(BATCHES + 1) / BATCHES
    batches = np.stack([_mean(local.times, growth, *edges[i : i + 2].tolist()) for i in range(BATCHES)])
    middle = first + (end - first) / 2.0
    integrated = float(_mean(local.times, local.errors[:, None], first, end)[0])
    with np.errstate(invalid="ignore"):  # of directions that an event forgets
        halves = _mean(local.times, growth, middle, end) - _mean(local.times, growth, first, middle)
        scatter = batches - _average(batches)
        standard = _average(scatter**2) / (BATCHES - 1)
        uncertainties = np.sqrt(standard + halves**2 + integrated**2)
    forgotten = np.isneginf(values)  # a direction that an event forgets, for certain
    order = np.argsort(-values, kind="stable")
    uncertainties = np.where(forgotten, 0.0, uncertainties)
    return Exponents(values[order], uncertainties[order], _finite_time(local), first, local.pieces, local.variables)


def _average(batches: Floats) -> Floats:
    total: Floats = product(np.full((1, BATCHES), 1.0 / BATCHES), batches)[0]
    return total


def _mean(times: Floats, growth: Floats, begin: float, end: float) -> Floats:
    """Return the weighted mean of growth per time between two times."""
    middles, lengths = (times[:-1] + times[1:]) / 2.0, np.diff(times)
    indices = np.flatnonzero((middles > begin) & (middles < end))
    weights = apply_elementary("sin", np.pi * (middles[indices] - begin) / (end - begin)) ** 2
    with np.errstate(invalid="ignore"):
        total = np.cumsum(weights[:, None] * growth[indices], axis=0)[-1]  # summed in this order on every machine
    time: float = np.cumsum(weights * lengths[indices])[-1]
    return np.asarray(total / time)


def _finite_time(local: LocalGrowth) -> float:
    """Return the logarithm of the largest singular value of the whole run's map of tangent vectors, over the time."""
    vector = np.ones((local.total_growth.shape[0], 1))
    largest = 0.0
    for _ in range(100):  # power iteration; nearly equal singular values need not be distinguished
        image = product(local.total_growth, vector)
        size = float(np.sqrt(dot(image[:, 0], image[:, 0]) / dot(vector[:, 0], vector[:, 0])))
        vector = product(local.total_growth.T, image)
        if not size > 0.0 or abs(size - largest) <= 1e-12 * size:
            largest = size
            break
        vector, largest = vector / np.abs(vector).max(), size
    growth = float(log(largest)) + local.total_exponent * float(log(ROUNDING))
    return growth / float(local.times[-1] - local.times[0])
