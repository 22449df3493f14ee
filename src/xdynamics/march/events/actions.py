"""What events declare: to stop, to go on by the forces of another regime, to reset the state."""

from __future__ import annotations

import numpy as np

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import RESETS
from xdynamics.kernels.program import REGIME
from xdynamics.march.calls import call_law
from xdynamics.march.log import first_of_group
from xdynamics.march.outcomes import STOPPED
from xdynamics.march.run import Run
from xdynamics.march.state_changes import put_reset_value
from xdynamics.model.detectors import KINK
from xdynamics.model.detectors import SWITCH as SWITCH_ROLE
from xdynamics.model.parts import ACTIONS
from xdynamics.schema import CROSSING, JUMP, REGIME_SWITCH, RESET_KIND

# no literals: numba compiles a copy of a function for each literal that it is given
_SWITCHED, _RESET = np.int64(REGIME_SWITCH), np.int64(RESET_KIND)
_CROSSED, _JUMPED = np.int64(CROSSING), np.int64(JUMP)
_, STOP, SWITCH, RESET = range(len(ACTIONS))


@jit_separate
def act(run: Run, row: int) -> bool:
    """Do what the events of a group declare, in the order of declaration; whether forces have to be evaluated anew."""
    now, changed = run.now[0], False
    for k in range(first_of_group(run, row), now.events - run.base[0].events):
        event = run.log_events[k]
        detector = run.detectors[event.detector]
        if detector.role in (SWITCH_ROLE, KINK) and event.kind in (_CROSSED, _JUMPED):
            event.kind = _SWITCHED
        if run.watches[event.detector].seen < detector.count:
            continue
        if detector.action == STOP:
            now.status = STOPPED
        elif detector.action == SWITCH:
            now.regime, run.at[REGIME], event.kind, changed = detector.to, detector.to, _SWITCHED, True
        elif detector.action == RESET:
            reset(run, event.detector, k)
            event.kind, changed = _RESET, True
    return changed


@jit_separate
def reset(run: Run, i: int, e: int) -> None:
    """Reset the state as an event declares, all from the state before; its row notes how far positions are moved."""
    first = run.log_impulses.shape[0] - run.plan[0].coordinates
    call_law(run.law[RESETS], run, run.z, run.resets, 0)
    for k in range(run.targets.shape[0]):
        if run.targets[k, 0] == i:
            if run.targets[k, 1] < run.plan[0].coordinates:
                run.log_impulses[first + run.targets[k, 1], e] += run.resets[k] - run.z[run.targets[k, 1]]
            put_reset_value(run, k, run.z)
