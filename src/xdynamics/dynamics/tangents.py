"""Tangent vectors of a run and its Lyapunov exponents, each with an uncertainty from its own convergence.

`growth` carries the vectors along; its law with derivatives, rows and events are prepared here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics import growth
from xdynamics.dynamics.growth import DONE, GROWTH, LOST, STAGES, Grown, GrowthScheme, Rows, Tangent
from xdynamics.dynamics.path import RunPath
from xdynamics.dynamics.variational import NotVariedError
from xdynamics.elementary.arrays import apply_elementary, dot, log, product
from xdynamics.kernels.compiling import PLAINLY
from xdynamics.methods.runge_kutta import DOP853_FIFTH, DOP853_OF_THIRD, DOP853_TABLEAU
from xdynamics.methods.tableau import weight_differences

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]

TOLERANCE = 1e-8  # of one piece of a step, relative to the tangent vectors
CHUNK = 1024  # rows per call: between calls the computation can be interrupted
PIECES, PIECES_PER_ROW = 5_000_000, 100  # largest number: with more, the equations are called too stiff
# most variables of which all exponents are computed; number of vectors where there are more
MOST_VARIABLES, FEW = 64, 16


@dataclass(frozen=True)
class LocalGrowth:
    """The growth of a run's tangent vectors, block by block.

    Attributes
    ----------
    times : ndarray, shape (b + 1,), s
        Beginning of the first block and ends of all blocks.
    factors : ndarray, shape (b, m)
        Growth of each vector in each block, over 2**(332*exponents).
    exponents : ndarray of int, shape (b, m)
    errors : ndarray, shape (b,)
        Of the factors, relative, as estimated.
    total_growth : ndarray, shape (m, m)
        Growth since the start, over 2**(332*whole_exponent): product of the upper triangles R.
    total_exponent : int
    pieces, variables : int
        Number of pieces into which the steps were divided, and of variables of the state.
    """

    times: Floats
    factors: Floats
    exponents: IntArray
    errors: Floats
    total_growth: Floats
    total_exponent: int
    pieces: int
    variables: int


def local_growth(
    run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None, vectors: int | None
) -> LocalGrowth:
    """Carry tangent vectors along a run, from its first row to its last.

    Parameters
    ----------
    run : xarray.Dataset
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    vectors : int, optional
        How many; by default as many as there are variables, or `FEW` if these are more than `MOST_VARIABLES`.

    Raises
    ------
    NotVariedError
        If the variational equations do not describe something in the run, or they are too stiff.
    """
    path = RunPath(run, functions)
    path.check()
    n = path.size
    allowed = path.changes
    m = count_of(allowed.shape[1], vectors)
    rows, times = path.rows, path.block_times
    law, references = path.law()
    tangent = _initial_tangent(allowed, m, float(rows.times[-1] - rows.times[0]))
    grown = Grown(np.ones((len(times) - 1, m)), np.zeros((len(times) - 1, m), np.int64), np.zeros(len(times) - 1))
    scheme = _scheme(PIECES + PIECES_PER_ROW * len(rows.times))
    for chunk in _row_chunks(rows):
        outcome = _compiled_grow(law, scheme, chunk, tangent, grown)
        if outcome != DONE:
            where = f"at t = {float(chunk.times[0]):.6g} to {float(chunk.times[-1]):.6g}"
            if outcome == LOST:
                raise NotVariedError(f"{where} the equations have no finite solution")
            raise NotVariedError(
                f"{where} the equations are too stiff: they would take more than {scheme.most_pieces} pieces of steps"
            )
    # compiled code reads these arrays by address: they had to live until here
    del references
    return LocalGrowth(
        times,
        grown.factors,
        grown.exponents,
        grown.errors,
        tangent.total,
        int(tangent.exponents[0]),
        int(tangent.pieces[0]),
        n,
    )


def count_of(size: int, vectors: int | None) -> int:
    """Return how many tangent vectors of so many variables are carried along; see `local_growth`."""
    return min(size, vectors or (size if size <= MOST_VARIABLES else FEW))


def _row_chunks(rows: Rows) -> Iterator[Rows]:
    """Yield `CHUNK` rows at a time."""
    for k in range(0, len(rows.times) - 1, CHUNK):
        steps = slice(k, k + CHUNK)
        yield rows._replace(
            times=rows.times[k : k + CHUNK + 1],
            states=rows.states[steps],
            regimes=rows.regimes[steps],
            sides=rows.sides[steps],
            pieces=rows.pieces[steps],
            jumps=rows.jumps[steps],
            parts=rows.parts[steps],
            blocks=rows.blocks[steps],
        )


def _initial_tangent(allowed: Floats, m: int, pace: float) -> Tangent:
    """Return m orthonormal vectors that mix all changes allowed, so that none is orthogonal to a growing direction."""
    n, changes = allowed.shape
    mixing = np.zeros((m, changes))
    for c in range(m):
        for i in range(changes):  # rows of a Hilbert matrix plus the unit matrix: independent, and none has a zero
            mixing[c, i] = float(c == i) + 1.0 / (c + i + 2.0)
    state = np.zeros((1 + m, n))
    state[1:] = mixing if n == changes else product(mixing, allowed.T)
    buffers = np.zeros_like(state), np.zeros_like(state), np.zeros((STAGES, 1 + m, n))
    upper = np.zeros((m, m))
    plain: Any = getattr(growth.orthonormalise, "py_func", growth.orthonormalise)
    plain(state, upper)
    integers = np.zeros(1, np.int64), np.zeros(1, np.int64)
    return Tangent(state, *buffers, np.zeros((m, m)), np.eye(m), np.zeros((m, m)), np.array([pace]), *integers)


@lru_cache
def _scheme(most_pieces: int) -> GrowthScheme:
    """Return the coefficients of dop853."""
    a = np.zeros((STAGES, STAGES))
    for i, row in enumerate(DOP853_TABLEAU.a[:STAGES]):
        a[i, : len(row)] = _fraction_array(row)
    third = weight_differences(DOP853_TABLEAU.b, DOP853_OF_THIRD)
    b, c, fifth, third_order = (
        _fraction_array(weights[:STAGES]) for weights in (DOP853_TABLEAU.b, DOP853_TABLEAU.c, DOP853_FIFTH, third)
    )
    return GrowthScheme(a, b, c, fifth, third_order, TOLERANCE, most_pieces)


def _fraction_array(texts: tuple[str, ...]) -> Floats:
    return np.array([float(Fraction(text)) for text in texts])


def _compiled_grow(*arguments: Any) -> int:
    """Call `growth.grow`, compiled or from the cache."""
    if PLAINLY:
        return growth.grow(*arguments)
    (grow,) = GROWTH.entries()
    return int(grow(*arguments))


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
    """Return the logarithm of the largest singular value of the complete run's tangent map, over the time."""
    vector = np.ones((local.total_growth.shape[0], 1))
    largest = 0.0
    for _ in range(100):  # power iteration; nearly equal singular values need not be distinguished
        image = product(local.total_growth, vector)
        size = float(np.sqrt(dot(image[:, 0], image[:, 0]) / dot(vector[:, 0], vector[:, 0])))
        vector = product(local.total_growth.T, image)
        # also true of nan; and of zero, where the vector has no direction left to iterate
        if not size > 0.0 or abs(size - largest) <= 1e-12 * size:
            largest = size
            break
        vector, largest = vector / np.abs(vector).max(), size
    growth = float(log(largest)) + local.total_exponent * float(log(ROUNDING))
    return growth / float(local.times[-1] - local.times[0])
