"""Ticks of controllers, where what they hold changes, all from what holds just before; nodes with periodic events."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import RESETS
from xdynamics.kernels.program import T
from xdynamics.march.acceptance import AT_BOTH, AT_NODE
from xdynamics.march.calls import call_law
from xdynamics.march.events.zero_tests import CROSSED
from xdynamics.march.exact_times import set_time
from xdynamics.march.force_evaluation import evaluate_forces
from xdynamics.march.run import Run
from xdynamics.march.state_changes import put_reset_value
from xdynamics.model.detectors import PERIODIC

State = NDArray[Any]


@jit_separate
def tick_at_start(run: Run) -> None:
    """Let controllers act at the start, before anything else reads what they hold."""
    if run.ticks.shape[0] > 0 and run.ticks[0] != 0:
        evaluate_forces(run, run.now[0].t, run.y)
        apply_actions(run, run.ticks[0], run.now[0].t, run.y)


@jit_separate
def tick_at_end(run: Run) -> bool:
    """Let controllers act at the end of a trial, if it is a tick; whether it is."""
    if not ticks_at_end(run):
        return False
    apply_actions(run, run.ticks[run.now[0].node + 1], run.trial[0].t, run.z)
    evaluate_forces(run, run.trial[0].t, run.z)
    return True


@jit_separate
def ticks_at_end(run: Run) -> bool:
    """Whether controllers act at the end of a trial that reaches its node."""
    landed = run.ticks.shape[0] > 0 and run.trial[0].landing in (AT_NODE, AT_BOTH)
    return bool(landed and run.ticks[run.now[0].node + 1] != 0)


@jit_separate
def rings_at_end(run: Run) -> bool:
    """Whether periodic events are met at the end of a trial."""
    now = run.now[0]
    landed = run.alarms.shape[0] > 0 and run.trial[0].landing in (AT_NODE, AT_BOTH)
    return bool(landed and run.alarms[now.node + 1] != 0)


@jit_separate
def ring_events(run: Run) -> None:
    """Have the periodic events of the trial's end among those that it is noted with."""
    due, number = run.alarms[run.now[0].node + 1], 0
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].role == PERIODIC:
            if (due >> number) & 1 == 1:
                run.watches[i].hit, run.watches[i].armed = CROSSED, -1
            number += 1


@jit_separate
def apply_actions(run: Run, actions: int, t: float, state: State) -> None:
    """Set what some actions change in a state, all from what holds in it."""
    set_time(run, T, t)
    call_law(run.law[RESETS], run, state, run.resets, 0)
    for k in range(run.targets.shape[0]):
        action = -1 - run.targets[k, 0]
        if action >= 0 and (actions >> action) & 1 == 1:
            put_reset_value(run, k, state)
