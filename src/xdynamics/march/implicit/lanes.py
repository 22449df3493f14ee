"""What a step of Radau IIA keeps for the next one, put into a lane and taken out of it: `kernels.collocation`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.lane_numbers import LANE
from xdynamics.kernels.linear import COMPLEX, REAL, note_extents
from xdynamics.kernels.radau_memory import KEPT
from xdynamics.kernels.radau_memory import PLACES as K
from xdynamics.march.run import BEGUN, MOVED, Run

Floats = NDArray[np.float64]

OF_LANE, OF_KEPT = np.int64(len(LANE)), np.int64(len(KEPT))


@jit_uncounted
def step_memory_index(run: Run) -> int:
    """Return the place in a lane of what a step of Radau IIA keeps."""
    return OF_LANE + 3 * run.plan[0].used + 2 * run.detectors.shape[0]


@jit_uncounted
def step_number_count(run: Run) -> int:
    """Return how many numbers of a lane hold the polynomial of a step and the states that it is made of."""
    plan = run.plan[0]
    return run.stages.shape[0] + (plan.degree + 1) * plan.used if plan.degree > 0 else 0


@jit_uncounted
def forget_step_memory(run: Run, w: Floats, lane: int) -> None:
    """Let the next step use nothing of those before, as after a node."""
    if run.stages.shape[0] > 0:
        w[step_memory_index(run) + K.since, lane] = BEGUN


@jit_uncounted
def enter_step_memory(run: Run, w: Floats, lane: int) -> int:
    """Put what a step keeps for the next one into a lane, ordered as `radau_memory.lengths`; return the place after."""
    first, step_memory = step_memory_index(run), run.kept[0]
    if run.stages.shape[0] == 0:
        return first
    w[first + K.factored, lane], w[first + K.theta, lane], w[first + K.eta, lane] = (
        step_memory.factored,
        step_memory.theta,
        step_memory.eta,
    )
    w[first + K.before, lane], w[first + K.norm_before, lane] = step_memory.step, step_memory.norm
    w[first + K.linearised, lane], w[first + K.fresh, lane] = float(step_memory.linearised), float(step_memory.fresh)
    w[first + K.since, lane], w[first + K.turns, lane] = float(step_memory.since), float(step_memory.turns)
    w[first + K.iterations, lane] = w[first + K.evaluations, lane] = 0.0
    w[first + K.jacobians, lane] = w[first + K.factorisations, lane] = 0.0
    first += OF_KEPT
    stages, matrix, size = run.stages.shape[0], run.matrix.shape[0], run.pivots.shape[0] // 6
    for k in range(run.entries.shape[0]):
        w[first + k, lane] = run.w[stages + k]
    first += run.entries.shape[0]
    for i in range(stages):
        w[first + i, lane], w[first + stages + i, lane] = run.stages[i], run.past[i]
    first += 2 * stages
    for i in range(matrix):
        w[first + i, lane] = run.matrix[i]
    for k in range(size):
        w[first + matrix + k, lane] = float(run.pivots[k])
        w[first + matrix + size + k, lane] = float(run.pivots[3 * size + k])
    return first + matrix + 2 * size + stages + step_number_count(run)


@jit_uncounted
def leave_step_memory(run: Run, w: Floats, lane: int, accepted: int, rejected: int) -> int:
    """Take what a step keeps out of a lane, with its counts; return the place after it."""
    first, step_memory, now = step_memory_index(run), run.kept[0], run.now[0]
    if run.stages.shape[0] == 0:
        now.evaluations += run.plan[0].stages * (accepted + rejected)
        if accepted > 0:
            step_memory.since, run.trial[0].iterations = MOVED, 0
        return first
    step_memory.factored, step_memory.theta, step_memory.eta = (
        w[first + K.factored, lane],
        w[first + K.theta, lane],
        w[first + K.eta, lane],
    )
    step_memory.step, step_memory.norm = w[first + K.before, lane], w[first + K.norm_before, lane]
    step_memory.linearised, step_memory.fresh = (
        np.int64(w[first + K.linearised, lane]),
        np.int64(w[first + K.fresh, lane]),
    )
    step_memory.since, step_memory.turns = np.int64(w[first + K.since, lane]), np.int64(w[first + K.turns, lane])
    run.trial[0].iterations = np.int64(w[first + K.iterations, lane])
    now.evaluations += np.int64(w[first + K.evaluations, lane])
    now.jacobians += np.int64(w[first + K.jacobians, lane])
    now.factorisations += np.int64(w[first + K.factorisations, lane])
    first += OF_KEPT
    stages, matrix, size = run.stages.shape[0], run.matrix.shape[0], run.pivots.shape[0] // 6
    for k in range(run.entries.shape[0]):
        run.w[stages + k] = w[first + k, lane]
    first += run.entries.shape[0]
    for i in range(stages):
        run.stages[i], run.past[i] = w[first + i, lane], w[first + stages + i, lane]
    first += 2 * stages
    for i in range(matrix):
        run.matrix[i] = w[first + i, lane]
    for k in range(size):
        run.pivots[k] = np.int64(w[first + matrix + k, lane])
        run.pivots[3 * size + k] = np.int64(w[first + matrix + size + k, lane])
    note_extents(run.matrix, run.pivots, size, REAL)
    note_extents(run.matrix, run.pivots, size, COMPLEX)
    return first + matrix + 2 * size + stages + step_number_count(run)
