"""Judge a trial, and land the march on its end."""

from __future__ import annotations

from math import nan

import numpy as np

from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.step_control import SMALL
from xdynamics.march.control import accepts, trial_error_norm
from xdynamics.march.outcomes import COMPLETED, EVENT_AT_ZERO, SOUND
from xdynamics.march.past import pass_breaks
from xdynamics.march.run import BEGUN, MOVED, Run
from xdynamics.march.tolerance_sizes import settle_tolerances
from xdynamics.schema import REASON_DOMAIN, REASON_ERROR, REASON_EVENT_FUNCTION, REASON_NEWTON, REASON_NONFINITE

# the fourth: the border of the model's domain; then a breaking point of delayed values, perhaps at a grid time
AT_GRID, AT_NODE, AT_BOTH, AT_BORDER, AT_BREAK, AT_BREAK_AND_GRID = range(1, 7)


@jit_inline
def judge_trial(run: Run) -> int:
    """Return SOUND for a trial that may be accepted, else the reason for its rejection; store its error norm."""
    now, trial = run.now[0], run.trial[0]
    now.norm = nan
    if trial.iterations < 0:
        return REASON_NEWTON
    if trial.unsound != 0.0:
        return nonfinite_reason(run)
    if trial.unsound_events != 0.0:
        return REASON_EVENT_FUNCTION
    now.norm = trial_error_norm(run) if run.plan[0].estimates else 0.0
    if run.plan[0].rounding > 0.0:
        run.kept[0].weighs = weighs_next(run)
    return REASON_ERROR if run.plan[0].adaptive and not accepts(now.norm) else SOUND


@jit_inline
def weighs_next(run: Run) -> int:
    """Return whether the next trial is weighed by its terms: after one that was, or while errors are small and steps grow."""
    norm, trial = run.now[0].norm, run.trial[0]
    if trial.weighed > 0:
        return 2
    return 0 if norm > SMALL or trial.h >= run.plan[0].max_step else int(run.kept[0].weighs)


@jit_separate
def nonfinite_reason(run: Run) -> int:
    """Return why a state is not finite: nan means that a function or table was evaluated outside its domain."""
    undefined = False
    if run.plan[0].held > 0 and np.isnan(run.z[run.plan[0].moved]) and np.isfinite(run.z[0]):
        return REASON_NEWTON  # to where constraints hold
    for i in range(run.plan[0].state):
        undefined = undefined or np.isnan(run.z[i])
    return REASON_DOMAIN if undefined and run.plan[0].limited else REASON_NONFINITE


@jit_inline
def count_landing(run: Run) -> None:
    """Count the grid time or node that the trial ends at; after the last one the run is complete."""
    now, trial = run.now[0], run.trial[0]
    if run.delays.shape[0] > 0:
        at_node = trial.landing in (AT_NODE, AT_BOTH) and now.node < run.nodes.shape[0]
        pass_breaks(run, trial.t, run.jumps[now.node] if at_node else np.int64(-1))
    now.on_grid = trial.landing in (AT_GRID, AT_BOTH, AT_BREAK_AND_GRID)
    if trial.landing == AT_GRID:  # as nearly every step does
        now.grid += 1
        return
    now.grid += now.on_grid
    if trial.landing in (AT_NODE, AT_BOTH):
        pass_node(run)


@jit_inline
def pass_node(run: Run) -> None:
    """Count a node; after the last one, the end, the run is complete."""
    now = run.now[0]
    now.node += 1
    if now.node > run.nodes.shape[0]:
        now.status = COMPLETED
        for i in range(run.detectors.shape[0]):
            if run.watches[i].ever == 0:
                now.status = EVENT_AT_ZERO


@jit_inline
def move_to_trial_end(run: Run) -> None:
    """Move the march to the end of the trial."""
    now, trial = run.now[0], run.trial[0]
    now.t, now.h, now.rest = trial.t, trial.h, trial.rest
    run.kept[0].since = BEGUN if run.piece[0].cut else MOVED  # remains of substeps do not belong to the step
    run.piece[0].cut = 0
    if run.plan[0].adaptive or run.plan[0].follows:
        for i in range(run.largest.shape[0]):
            run.largest[i] = max(run.largest[i], abs(run.z[i]))
    if run.plan[0].follows:
        settle_tolerances(run)
    for i in range(run.y.shape[0]):  # a loop: a slice assignment takes numba seconds to compile
        run.y[i] = run.z[i]


@jit_inline
def end_march(run: Run, why: int) -> None:
    """End the march where it stands; `h` is the step that failed."""
    run.now[0].status, run.now[0].h = why, run.trial[0].h


judge_trial_apart, count_landing_apart, move_to_end_apart = (
    noinline(judge_trial),
    noinline(count_landing),
    noinline(move_to_trial_end),
)
