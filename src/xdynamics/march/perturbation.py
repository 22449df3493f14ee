"""Growth of an error in a state along a run: two marches side by side from one of its rows, and their distance.

Both take the same steps of the Bogacki-Shampine pair of order 3 and 2 (1989, Applied Mathematics Letters 2, 321), as
long as two digits of their distance allow: the distance is the tangent map of the motion times a vector, by differences.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.march.force_evaluation import evaluate_forces, state_slope
from xdynamics.march.run import Run
from xdynamics.march.tolerance_sizes import time_at

State = NDArray[Any]
Floats = NDArray[np.float64]

STATES = 12  # two states, their ends, four slopes of each
EVALUATIONS = 6  # per step
SHORT = 2.0**-20  # of the sizes: initial distance, of which ten digits are free of rounding
FAR = 2.0**10  # times that: distance at which they are no longer followed
ROUGH = 1e-3  # of the sizes: allowed error of a step in a state
ROUGHER = 1e-2  # of the distance: allowed error of a step in the distance
FIRST = 1e-2  # of a time scale from sizes and slopes: the first step
SPARE = 1.0 / 16.0  # of the allowed error, below which the next step is twice as long


@jit_separate
def follow_error(run: Run, t: float, moves: Floats, work: Floats, growth_rows: Floats, row: int) -> None:
    """Fill two rows of `growth_rows` with times and ratios of the states' distance to the initial one, as far as they reach.

    Parameters
    ----------
    run : Run
        At the initial state, with its slopes; its state is changed.
    t : float
    moves : ndarray, shape (1 + n, 2)
        First the final time; then the displacement of the second state, and the size of each variable.
    work : ndarray, shape (12, n)
    growth_rows : ndarray, shape (…, k)
        Filled as far as the states were followed.
    row : int
    """
    used, near = run.plan[0].used, 0.0
    for i in range(used):
        near = max(near, abs(moves[1 + i, 0]) / moves[1 + i, 1])
    h = FIRST * time_at(run, run.y)
    if not (near > 0.0 and h > 0.0):
        return
    for i in range(used):
        work[0, i] = run.y[i]
        work[6, i] = run.y[i] + SHORT / near * moves[1 + i, 0]
    fill_slopes(run, t, work[0], work[2])
    fill_slopes(run, t, work[6], work[8])
    far = state_distance(run, work[0], work[6], moves)
    first, count = far, 1
    growth_rows[row, 0], growth_rows[row + 1, 0] = t, 1.0
    for _ in range(growth_rows.shape[1] - 1):
        h = min(h, moves[0, 0] - t)
        if not t + h > t:
            return
        advance_pair(run, t, h, work, 0)
        advance_pair(run, t, h, work, 6)
        norm = error_ratio(run, h, work, far, moves)
        if norm <= 1.0:
            t, far = t + h, state_distance(run, work[1], work[7], moves)
            for i in range(used):
                work[0, i], work[2, i], work[6, i], work[8, i] = work[1, i], work[5, i], work[7, i], work[11, i]
            growth_rows[row, count], growth_rows[row + 1, count] = t, far / first
            count += 1
            if not 0.0 < far < FAR * first:
                return
            enter_pieces(t, run.tables, run.places, run.of_time)
        h *= 2.0 if norm < SPARE else (1.0 if norm <= 1.0 else (0.5 if norm < inf else 0.125))


@jit_separate
def fill_slopes(run: Run, t: float, state: State, slopes: Floats) -> None:
    """Fill `slopes` with the time derivatives at a state."""
    for i in range(run.plan[0].used):
        run.probe[i] = state[i]
    evaluate_forces(run, t, run.probe)
    for i in range(run.plan[0].used):
        slopes[i] = state_slope(run, run.probe, i)


@jit_separate
def advance_pair(run: Run, t: float, h: float, work: Floats, first: int) -> None:
    """Make a step from row `first` of `work` to the next row, with slopes in the four rows after that."""
    used, y, end = run.plan[0].used, work[first], work[first + 1]
    a, b, c, d = work[first + 2], work[first + 3], work[first + 4], work[first + 5]
    for i in range(used):
        end[i] = y[i] + h / 2.0 * a[i]
    fill_slopes(run, t + h / 2.0, end, b)
    for i in range(used):
        end[i] = y[i] + 0.75 * h * b[i]
    fill_slopes(run, t + 0.75 * h, end, c)
    for i in range(used):
        end[i] = y[i] + h * (2.0 * a[i] + 3.0 * b[i] + 4.0 * c[i]) / 9.0
    fill_slopes(run, t + h, end, d)


@jit_separate
def error_ratio(run: Run, h: float, work: Floats, far: float, moves: Floats) -> float:
    """Return the largest ratio of a step's error to the allowed one; inf where something is not finite."""
    largest = 0.0
    for i in range(run.plan[0].used):
        error = error_of(work, 0, h, i)
        distance_error = abs(error_of(work, 6, h, i) - error)
        largest = max(
            largest, abs(error) / (ROUGH * moves[1 + i, 1]), distance_error / (ROUGHER * far * moves[1 + i, 1])
        )
        if not isfinite(error + distance_error):
            return inf
    return largest


@jit_separate
def error_of(work: Floats, first: int, h: float, i: int) -> float:
    """Return the estimated error of a variable in a step from row `first` of `work`."""
    a, b, c, d = work[first + 2, i], work[first + 3, i], work[first + 4, i], work[first + 5, i]
    return h * (-5.0 * a + 6.0 * b + 8.0 * c - 9.0 * d) / 72.0


@jit_separate
def state_distance(run: Run, first_state: State, second_state: State, moves: Floats) -> float:
    """Return the distance of two states, as the largest of their differences over the sizes."""
    distance = 0.0
    for i in range(run.plan[0].used):
        distance = max(distance, abs(second_state[i] - first_state[i]) / moves[1 + i, 1])
    return distance
