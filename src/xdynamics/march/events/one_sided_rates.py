"""Where the motion goes from an instant at which an event function is zero: by its rate, else by how its rate changes."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import T
from xdynamics.march.events.zero_tests import enclose_here
from xdynamics.march.exact_times import set_time
from xdynamics.march.force_evaluation import evaluate_forces, state_slope
from xdynamics.march.run import Run

State = NDArray[Any]

SHARE = 2.0**-20  # of a time over which the first steps count: a moment
SPACINGS = 64.0  # of t, which a moment is not shorter than
LATE = 4.0  # time tolerances within which a root is located: a function that may still be zero
DOUBTS = 4.0  # uncertainties of a rate that count as zero


@jit_separate
def moment(run: Run) -> float:
    """Return a time that is short for the motion and long for rounding."""
    return max(SHARE * run.plan[0].rest, SPACINGS * EPS * abs(run.now[0].t))


@jit_separate
def step_ahead(run: Run, state: State, duration: float) -> None:
    """Leave in `z` about where the motion is a moment after a state, with the forces there; t is the time then."""
    n, used, t = run.plan[0].coordinates, run.plan[0].used, run.now[0].t + duration
    for i in range(used):
        run.z[i] = state[i] + duration * state_slope(run, state, i)
    for i in range(n):
        run.z[i] += 0.5 * duration * duration * state_slope(run, state, n + i)
    evaluate_forces(run, t, run.z)
    set_time(run, T, t)


@jit_separate
def is_certain(run: Run, i: int, state: State) -> bool:
    """Whether the rate of an event function at a state is more than rounding; `slopes` are those there."""
    return bool(abs(run.slopes[i]) > DOUBTS * uncertainty_of_rate(run, i, state))


@jit_separate
def uncertainty_of_rate(run: Run, i: int, state: State) -> float:
    """How far rounding may move the rate of an event function at a state; t is its time."""
    slope = run.detectors[i].slope
    enclose_here(run, i, state, run.parts[2], 0.0)
    return float((run.over[slope] - run.under[slope]) / 2.0)
