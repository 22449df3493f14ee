"""The guard of recorded rows: contacts press and do not pull, friction stays within its bound, gaps are not negative.

The march lands where one of these would be broken. A row that breaks one all the same contradicts the law of contact,
whatever led to it, and ends the run.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.contacts.gaps import impact_spread
from xdynamics.march.events.one_sided_rates import LATE
from xdynamics.march.events.zero_tests import NEAR, event_resolution, noise_floor
from xdynamics.march.exact_times import set_time
from xdynamics.march.outcomes import CONTACT_VIOLATED, RUNNING
from xdynamics.march.run import FIGURE, OWNER, Run
from xdynamics.model.detectors import GAP, GRIP, PULL, SLIP

State = NDArray[Any]

ALLOWED = 16.0  # times what rounding and the location of events leave of a force, slip or gap at its zero


@jit_separate
def check_contact_law(run: Run, t: float) -> None:
    """End a run where a contact pulls, holds more than friction can, slips against its friction, or is penetrated.

    The state is that of the trial, which is a row or becomes one, at time t.
    """
    state, values = run.z, run.g1
    set_time(run, T, t)
    call_law(run.law[DETECT], run, state, values, 0)
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if detector.role not in (GAP, PULL, GRIP, SLIP) or watch.asleep or not values[i] * watch.guard < 0.0:
            continue
        if run.now[0].status == RUNNING and abs(values[i]) > ALLOWED * allowed_residue(run, i, abs(values[i]), state):
            run.now[0].status = CONTACT_VIOLATED
            run.balance[OWNER], run.balance[FIGURE] = float(i), values[i]


@jit_separate
def allowed_residue(run: Run, i: int, value: float, state: State) -> float:
    """Return how far from its zero rounding and the location of events may leave a function that may not pass it.

    A force is compared with what it had to hold at the last event, and its larger value in the last step.
    """
    k, role = run.detectors[i].reaction, run.detectors[i].role
    call_law(run.law[SLOPES], run, state, run.arguments, 0)
    left = max(noise_floor(run, i, state), LATE * event_resolution(run, i, 0.0) * abs(run.arguments[i]))
    if role == GAP:
        return max(left, impact_spread(run, k))
    if role == SLIP:
        return max(left, run.touches[k].slack)
    held_force = abs(run.links[k].free) / run.delassus[k, k] if run.delassus[k, k] > 0.0 else 0.0
    return max(left, NEAR * max(held_force, run.watches[i].greatest - value))
