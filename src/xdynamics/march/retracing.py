"""The past of a march with delays, made again from the rows of its log: for states between them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.program import REGIME
from xdynamics.march.calls import call_phase, run_at
from xdynamics.march.force_evaluation import evaluate_forces
from xdynamics.march.past import begin_past, enter_past, note_past
from xdynamics.march.run import CONTACT_PHASE, EVENT_PHASE, INFORM, SETTLE, TAKE_SIDES, Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE, NODE, STEP

Floats = NDArray[np.float64]


def retrace(address: Any, steps: Floats, states: Floats) -> None:
    """Make the polynomials of all steps of a log again, in their order, as the march made them; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run` with room for as many pieces as there are rows.
    steps : ndarray, shape (4 + m, rows)
        Time, size of the step to it, regime, kind of the row, the state of each of m reactions.
    states : ndarray, shape (n, rows)
    """
    run = run_at(address)
    begin_past(run)
    for k in range(steps.shape[1] - 1):
        if np.int64(steps[3, k]) in (NODE, EVENT_BEFORE):
            run.book[0].stretch += 1
        if steps[0, k + 1] > steps[0, k]:
            stand_between(run, steps, states, k)
            note_past(run)


@jit_separate
def stand_between(run: Run, steps: Floats, states: Floats, k: int) -> None:
    """Set a run to the step from row k to the next, with the forces at both of its ends."""
    now, trial = run.now[0], run.trial[0]
    t, t1, regime = steps[0, k], steps[0, k + 1], np.int64(steps[2, k])
    for i in range(run.touches.shape[0]):
        run.touches[i].state = np.int64(steps[4 + i, k])
    copy_numbers(run.z, run.whole)
    for i in range(run.y.shape[0]):
        run.y[i] = states[i, k] if i < states.shape[0] else 0.0
    now.t, now.regime, run.at[REGIME], trial.t, trial.h = t, regime, regime, t1, steps[1, k + 1]
    enter_pieces(t, run.tables, run.places, run.of_time)
    enter_past(run, t1)
    if run.plan[0].switches > 0:
        call_phase(run.functions[EVENT_PHASE], run, 0.0, TAKE_SIDES)
    if run.plan[0].reactions > 0:
        call_phase(run.functions[CONTACT_PHASE], run, t, INFORM)
    if np.int64(steps[3, k]) == STEP and k > 0:  # forces are evaluated anew at nodes and events alone
        copy_numbers(run.whole, run.y)
    else:
        evaluate_forces(run, t, run.y)
    if np.int64(steps[3, k]) == EVENT_AFTER and run.plan[0].reactions > 0:
        call_phase(run.functions[CONTACT_PHASE], run, t, SETTLE)
    for i in range(run.z.shape[0]):  # contacts have used it
        run.z[i] = states[i, k + 1] if i < states.shape[0] else 0.0
    evaluate_forces(run, t1, run.z)
