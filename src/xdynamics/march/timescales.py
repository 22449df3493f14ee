"""Time scales of a finished march, at its start and at a few of its rows, from its compiled forces."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.model_programs import has_loops
from xdynamics.march.engine import engine
from xdynamics.march.run import CHANGING, PLAN
from xdynamics.march.runner import March
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.constraints import beyond_trees
from xdynamics.units import TIME

Floats = NDArray[np.float64]

FEWEST, MOST = 3, 16  # rows that are examined besides the start
SHARE = 200  # evaluations of a march for each such row, which takes seven
MOST_TOGETHER = 1 << 20  # numbers of states that are examined in one call
FEW = 12  # numbers of a state up to which all eigenvalues are computed
MOST_NUMBERS = 240  # of a state up to which a fixed step is compared with what is stable: eigenvalues take 0.1 s
SLOW = 1e-5  # of the fastest rate, below which differences resolve none
KEPT = 3e-3  # the same where constraints keep what has a zero twice, which differences part by the root of their error
DIGITS = 3  # of eigenvalues, so that the last bits of a library enter no digest
_STEP_SIZE = (PLAN.names or ()).index("step_size")
_STANDING = (
    "at",
    "places",
    "now",
)  # what an evaluation at another state changes, where there are neither events nor contacts
_CHANGING = tuple(name for name in CHANGING if name != "y")
RULE = (
    "omega: the fastest rate, estimated by six products of the Jacobian and a vector, contacts open; at the"
    " start with the first step, and at {rows} rows spread over the run with the step that led to them"
)


@dataclass(frozen=True)
class TimeScales:
    """Rates of a motion, s-1, and their products with steps.

    Attributes
    ----------
    rate : float
        The fastest rate at the start.
    start : float
        That rate times the first step.
    largest : float
        The largest such product.
    rows : int
        Number of rows examined besides the start.
    period : float
        The longest period of oscillations about the start, s; nan where not computed, inf where nothing oscillates.
    """

    rate: float
    start: float
    largest: float
    rows: int
    period: float


def time_scales(march: March) -> TimeScales | None:
    """Return the time scales of the motion; None where forces cannot be evaluated at the start."""
    witnesses, run, n = march.witnesses, march.run, march.layout.used.size
    if not witnesses.steps.shape[1]:
        return None
    plan = run.plan.tolist()[0]
    examined_rows = _examined_rows(march)
    rates, states_per_call = np.zeros((1, len(examined_rows))), max(1, MOST_TOGETHER // n)
    in_place = witnesses.end_with(run.y[:n])
    states_per_call = 1 if in_place else states_per_call
    with put_aside(march, in_place=in_place) as room:
        for first in range(0, len(examined_rows), states_per_call):
            part = slice(first, first + states_per_call)
            states = (
                witnesses.put_in(run.y, examined_rows[first])
                if in_place
                else witnesses.states(examined_rows[part], room)
            )
            engine().fastest_rates(run, states, rates[:, part])
        jacobian = _scaled_derivatives(march, 0) if n <= FEW else None
    if not 0.0 <= rates[0, 0] < np.inf:
        return None
    first = plan[_STEP_SIZE] or (run.steps[0] if len(run.steps) else march.now.first_step)
    steps = witnesses.steps[2, examined_rows]
    steps[0] = first
    products = rates[0] * steps
    scale = march.settings.scales.si_factor(TIME)
    resolved = KEPT if march.model.constraints else SLOW
    period = np.nan if jacobian is None else slowest_period(jacobian, resolved) * scale
    return TimeScales(
        float(rates[0, 0]) / scale, float(products[0]), float(products.max()), len(examined_rows) - 1, period
    )


def jacobian_at(march: March, row: int) -> Floats:
    """Return the derivatives of the state's rates by the state at one row, scaled by sizes, by differences.

    The matrix has the eigenvalues of the Jacobian, in the march's unit of time, contacts open, for the first regime.
    """
    with put_aside(march):
        return _scaled_derivatives(march, row)


def _scaled_derivatives(march: March, row: int) -> Floats:
    """Return the scaled derivatives of the motion at a row, from a march whose state may be overwritten."""
    n = march.layout.used.size
    derivatives = np.zeros((1 + n, n))
    engine().fastest_rates(march.run, march.witnesses.states([row]), derivatives)
    return derivatives[1:]


def beyond_eigenvalues(model: Model) -> bool:
    """Whether a model has too many numbers to look for eigenvalues: one in loops, or one that constraints couple."""
    return beyond_trees(model) or (
        has_loops(model)
        and 2 * len(model.elements.statement.coordinates) + len(model.elements.statement.states) > MOST_NUMBERS
    )


def jacobian_at_start(model: Model, settings: Settings) -> Floats | None:
    """Return the derivatives of (v, a, r) by (q, v, x) at the start, by differences; None where there are none.

    Variables are over their sizes, velocities over those of coordinates in a second: q' = v, as in the Jacobian.
    """
    march = March(model, settings)
    run, n, used = march.run, march.layout.coordinates.size, march.layout.used.size
    derivative_rows = np.zeros((1 + used, used))
    engine().fastest_rates(run, np.array([[run.now[0]["t"], *run.y[:used]]]).T, derivative_rows)
    derivatives, sizes = derivative_rows[1:] / settings.scales.si_factor(TIME), np.ones(used)
    sizes[n : 2 * n] = derivatives[:n, n : 2 * n].diagonal()
    if not (np.isfinite(derivatives).all() and sizes.all()):
        return None
    derivatives *= sizes[:, None] / sizes
    derivatives[:n] = np.eye(n, used, n)
    stiffness = derivatives[n : 2 * n, :n]
    if np.abs(stiffness - stiffness.T).max(initial=0.0) <= SLOW * np.abs(stiffness).max(initial=0.0):
        stiffness[:] = (stiffness + stiffness.T) / 2.0  # but for rounding errors it is symmetric
    return derivatives


def _examined_rows(march: March) -> list[int]:
    """Return the start and some rows, independent of a march's parts; with several regimes only the start."""
    rows = march.witnesses.steps.shape[1]
    if len(march.model.regimes) > 1:
        return [0]
    count = min(MOST, max(FEWEST, int(march.now.evaluations) // SHARE), rows - 1)
    return [0, *(1 + (i * (rows - 1)) // count for i in range(count))] if count > 0 else [0]


def slowest_period(matrix: Floats, resolved: float = SLOW) -> float:
    """Return the longest period of the oscillating eigenmodes of a matrix, to a few digits; inf if there are none.

    Modes slower than a part of the fastest rate, `resolved`, are left out.
    """
    if not matrix.size or not np.isfinite(matrix).all():
        return np.nan
    if len(matrix) == 2:  # one coordinate: most models that are marched for a moment
        (a, b), (c, d) = matrix.tolist()
        half, square = (a + d) / 2.0, (a - d) * (a - d) / 4.0 + b * c
        slowest = math.sqrt(-square) if -square > half * half else math.inf
    else:
        eigenvalues = np.linalg.eigvals(matrix)
        turning = np.abs(eigenvalues.imag)
        fast = (turning > resolved * np.abs(eigenvalues).max()) & (turning > np.abs(eigenvalues.real))
        slowest = float(turning[fast].min(initial=math.inf))
    return float(f"{2.0 * math.pi / slowest:.{DIGITS}g}") if slowest < math.inf else math.inf


@contextmanager
def put_aside(march: March, *, in_place: bool = False) -> Iterator[Floats | None]:
    """Restore a march's current numbers afterwards; yield room for a time and the state after it, which the run reads.

    In place there is no such room: other states are put in that of the march, which its record has, too; force terms
    beside it are not to be changed then.
    """
    run, used = march.run, march.layout.used.size
    plain = not (len(run.detectors) or len(run.touches))
    saved_arrays = {name: getattr(run, name).copy() for name in (_STANDING if plain else (*_CHANGING, "p"))}
    y, slopes = run.y, slice(used, 2 * used - march.layout.coordinates.size)
    saved_slopes = y[slopes].copy() if in_place else np.empty(0)
    room = None if in_place else np.zeros(1 + y.size)  # of which what is not written takes no memory
    if room is not None:
        run.put(y=room[1:])
    march.now.regime = run.plan[0].regime
    try:
        yield room
    finally:
        if in_place:
            march.witnesses.put_end_in(y)
            y[slopes] = saved_slopes
        run.put(y=y)
        for name, array in saved_arrays.items():
            getattr(run, name)[...] = array
