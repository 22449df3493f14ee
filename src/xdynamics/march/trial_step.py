"""One trial: the method's step, with step doubling where it is requested."""

from __future__ import annotations

from math import nan
from typing import Any

from numpy import int64
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.law import DETECT, PROPOSE
from xdynamics.kernels.program import UNSOUND, T
from xdynamics.march.calls import call_law, stepped_by
from xdynamics.march.force_evaluation import (
    evaluate_forces,
    finite_state,
    hold_attitudes,
    keep_sample,
    set_step,
    set_time,
)
from xdynamics.march.log import note_trial
from xdynamics.march.past import enter_past
from xdynamics.march.phases import WATCHERS, later, phase
from xdynamics.march.run import Run
from xdynamics.schema import REASON_EVENT

State = NDArray[Any]
act_on_trial, act_on_links = later("act_on_trial"), later("act_on_links")  # of contacts and of assemblies
_FIRST = int64(0)  # no literal: numba compiles a copy of a function for every literal argument


@jit_inline
def propose_step(run: Run, t1: float, h: float) -> None:
    """Make one step from the current state, which stays unchanged."""
    trial = run.trial[0]
    trial.t, trial.h, trial.iterations = t1, h, 0
    if run.delays.shape[0] > 0:
        enter_past(run, t1)
    if run.plan[0].steps > 1:
        make_half_steps(run, t1, h)
    else:
        advance_step(run, run.now[0].t, t1, h, run.y, run.z, _FIRST)
    if run.attitudes.shape[0] > 0 and run.at[UNSOUND] == 0.0:
        hold_attitudes(run, t1)
    if run.plan[0].reactions > 0 and run.at[UNSOUND] == 0.0:
        act_on_trial(run, t1)
    if run.plan[0].assemblies > 0 and run.at[UNSOUND] == 0.0:
        act_on_links(run, t1)
    trial.unsound, trial.unsound_events = run.at[UNSOUND], 0.0


@jit_inline
def advance_step(run: Run, t: float, t1: float, h: float, y: State, z: State, sample: int) -> None:
    """Make one step by the lines of the method, and store its force evaluations from index `sample` on."""
    set_step(run, t, t1, h)
    solver = run.law[run.law.shape[0] - 1]
    if solver != 0:
        stepped_by(solver, run, t, t1, h, y, z, sample)
    else:
        call_law(run.law[PROPOSE], run, y, z, sample)
        run.now[0].evaluations += run.plan[0].stages


advance_step_apart = noinline(advance_step)


@jit_separate
def make_half_steps(run: Run, t1: float, h: float) -> None:
    """Make two half steps, and a full one for comparison: the difference over 2**p - 1 is the error of the two."""
    plan, t = run.plan[0], run.now[0].t
    width = plan.stages * (run.log_samples.shape[0] - 2)
    middle = t + h / 2.0
    advance_step_apart(run, t, t1, h, run.y, run.whole, _FIRST)
    advance_step_apart(run, t, middle, h / 2.0, run.y, run.half, width)
    run.kept[0].fresh = 0  # derivatives belong to the first half
    advance_step_apart(run, middle, t1, h / 2.0, run.half, run.z, 2 * width)
    run.kept[0].fresh = 0
    for i in range(plan.used):
        run.e[i] = (run.z[i] - run.whole[i]) / plan.divisor
    if plan.extrapolated:
        for i in range(plan.used):
            run.z[i] = run.z[i] + run.e[i]
        evaluate_forces(run, t1, run.z)
        run.at[UNSOUND] = 0.0 if finite_state(run) else nan
        keep_sample(run, t1, run.z, 3 * width)


propose_step_apart = noinline(propose_step)


@jit_separate
def usual_step(run: Run) -> float:
    """Return the length of a step that nothing cuts; where a recorded step is repeated, its own."""
    now, plan = run.now[0], run.plan[0]
    if not plan.adaptive and plan.step_size > 0.0:
        return plan.step_size
    if plan.adaptive or run.steps.shape[0] == 0:
        return now.step
    return run.steps[min(now.grid, run.steps.shape[0] - 1)]


@jit_separate
def evaluate_events(run: Run) -> None:
    """Evaluate the event functions at the trial's end."""
    set_time(run, T, run.trial[0].t)
    call_law(run.law[DETECT], run, run.z, run.g1, 0)
    run.trial[0].unsound_events = run.at[UNSOUND]


@phase(WATCHERS)
def substep(run: Run, s: float) -> None:
    """Make a part of the step, as a step of size `s` from the current state, and evaluate the event functions at its end."""
    run.piece[0].substeps += 1
    if run.plan[0].apart:
        note_trial(run, s, nan, REASON_EVENT)
    run.trial[0].rest = 0.0
    propose_step_apart(run, run.now[0].t + s, s)
    evaluate_events(run)


@jit_separate
def store_trial(run: Run) -> None:
    """Store the trial, for instance as the one that ends at an event."""
    copy_trial(run.trial, run.located)
    copy_numbers(run.z, run.located_z)
    copy_numbers(run.e, run.located_e)
    copy_numbers(run.g1, run.located_g)
    copy_numbers(run.samples, run.located_samples)


@jit_separate
def restore_trial(run: Run) -> None:
    """Restore the stored trial, so that it need not be made again, but for impulses of links over the step."""
    copy_trial(run.located, run.trial)
    if run.plan[0].assemblies > 0 and run.plan[0].steps_over > 0:
        propose_step_apart(run, run.trial[0].t, run.trial[0].h)
    copy_numbers(run.located_z, run.z)
    copy_numbers(run.located_e, run.e)
    copy_numbers(run.located_g, run.g1)
    copy_numbers(run.located_samples, run.samples)


@jit_separate
def copy_trial(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy a trial's numbers."""
    origin, copied = source[0], target[0]
    copied.t, copied.h, copied.landing, copied.iterations = origin.t, origin.h, origin.landing, origin.iterations
    copied.unsound, copied.unsound_events, copied.rest = origin.unsound, origin.unsound_events, origin.rest
    copied.deviation, copied.weighed = origin.deviation, origin.weighed


@jit_separate
def copy_numbers(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy numbers, in a loop: a slice assignment takes numba seconds to compile."""
    for i in range(source.shape[0]):
        target[i] = source[i]
