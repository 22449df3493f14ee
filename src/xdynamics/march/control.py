"""Step control: the error test, the verdict on a trial, the first and the next step, and the landing on the end."""

from __future__ import annotations

import math
from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import formulas
from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.formulas import CONSTANTS, LEAST_LOGARITHM, SMALL, compiled_function_of, larger
from xdynamics.kernels.law import EXP, FORCES, LOG
from xdynamics.kernels.program import T
from xdynamics.march.calls import apply_function, call_law
from xdynamics.march.force_evaluation import find_term_sizes, state_slope
from xdynamics.march.log import note_sample
from xdynamics.march.outcomes import COMPLETED, EVENT_AT_ZERO, SOUND
from xdynamics.march.past import pass_breaks
from xdynamics.march.run import BEGUN, MOVED, Run
from xdynamics.march.tolerance_sizes import settle_tolerances, tops_of
from xdynamics.methods.method import Method
from xdynamics.schema import REASON_DOMAIN, REASON_ERROR, REASON_EVENT_FUNCTION, REASON_NEWTON, REASON_NONFINITE

State = NDArray[Any]
SPACINGS = 10.0  # of t in the shortest step, as in scipy
NONFINITE_FACTOR = 0.25
ERROR_NORM = "largest component of |error|/(atol + rtol*max(|value before|, |value after|))"
FIRST_STEP = (
    "Hairer, Norsett, Wanner I, section II.4, with the norm above, in units of T = max(size/slope,"
    " sqrt(size/curvature)): h0 = 0.01*size/slope, h = min(T, T*(0.01/max(slope*T, curvature*T**2))**(1/k)); size is 1"
    " at zero, h0 1e-6 of the time to the first node or the end where the slope is zero"
)
FORESEEN = "as every other: by the last two coefficients at the start"


def first_step_rule(method: Method) -> str:
    """Return how a method's first step is chosen, in words."""
    return FORESEEN if method.stepper.foresees else FIRST_STEP


# the lines as functions of numbers
_allowed = compiled_function_of(formulas.ALLOWED, "atol rtol rest floor top slope", "allowed")
_of_rate = compiled_function_of(formulas.LEAST_OF_RATE, "rounding width terms", "least")
_of_coordinate = compiled_function_of(formulas.LEAST_OF_COORDINATE, "rounding width terms", "least")
_floored_norm = compiled_function_of(formulas.FLOORED_NORM, "norm error before after allowed rtol least", "norm")
_norm = compiled_function_of(formulas.NORM, "norm error before after allowed rtol", "norm")
_exponent = compiled_function_of(formulas.EXPONENT, "norm logarithm step_log k", "exponent")
_proportional = compiled_function_of(
    formulas.PROPORTIONAL, "norm logarithm power safety least greatest", "factor next_log shrink", CONSTANTS
)
_predicted = compiled_function_of(formulas.PREDICTED, "growth least greatest", "factor next_log shrink", CONSTANTS)
_next = compiled_function_of(formulas.NEXT, "width factor cut rejected step min_step max_step", "next_step")


@jit_inline
def accepts(norm: float) -> bool:
    """Whether a trial passes the error test; nan does not."""
    return norm <= 1.0


@jit_inline
def allowed_of(run: Run, state: State, i: int) -> float:
    """Return the error that a variable may have at a state, besides its share of the value there."""
    plan, atol = run.plan[0], run.atol[i]
    if plan.follows and run.adaptive_atol[i]:  # variables that start from zero are measured by others of their kind
        atol = _allowed(atol, plan.rtol, plan.rest, plan.floor, run.tops[run.kinds[i]], state_slope(run, state, i))
    return float(atol)


@jit_inline
def trial_error_norm(run: Run) -> float:
    """Return the largest ratio of the trial's errors to their scales: the tolerances allow 1.

    Of a trial that fails, errors may be the rounding of forces that cancel: it is weighed again, with a floor from these;
    and so are those after it, whose steps would not grow by such errors, until one has none.
    """
    plan, trial = run.plan[0], run.trial[0]
    trial.weighed = 0
    if plan.follows:
        tops_of(run, run.z)
    norm = largest_ratio(run, 0.0)
    if plan.rounding > 0.0 and (norm > 1.0 or run.kept[0].weighs > 0):
        find_term_sizes(run, trial.t, run.z)
        lower = largest_ratio(run, trial.h)
        trial.weighed = int(lower < norm)
        return lower
    return norm


@jit_separate
def largest_ratio(run: Run, width: float) -> float:
    """Return the largest ratio of the trial's errors to their scales, with a floor from terms over a step, or none (0)."""
    plan, norm = run.plan[0], 0.0
    for i in range(plan.used):
        allowed = allowed_of(run, run.z, i)
        if width > 0.0 and run.adaptive_atol[i]:
            error_floor = term_rounding(run, i, width)
            norm = _floored_norm(norm, run.e[i], run.y[i], run.z[i], allowed, plan.rtol, error_floor)
        else:
            norm = _norm(norm, run.e[i], run.y[i], run.z[i], allowed, plan.rtol)
    return norm


@jit_inline
def term_rounding(run: Run, i: int, width: float) -> float:
    """Return the rounding of a variable in a step by its terms, whose sizes are known."""
    n, rounding = run.plan[0].coordinates, run.plan[0].rounding
    if i < n:
        return float(_of_coordinate(rounding, width, state_slope(run, run.probe, n + i)))
    return float(_of_rate(rounding, width, state_slope(run, run.probe, i)))


@jit_separate
def forget_rounding(run: Run) -> None:
    """Reset to zero the sizes of variables that moved by no more than the rounding of forces since the start."""
    plan, now = run.plan[0], run.now[0]
    if not plan.follows or plan.rounding == 0.0:
        return
    find_term_sizes(run, now.t, run.y)
    for i in range(plan.used):
        if run.largest[i] <= term_rounding(run, i, now.t - plan.start):
            run.largest[i] = 0.0
    settle_tolerances(run)


@jit_inline
def shortest_step(run: Run) -> float:
    """Return the shortest step that may be tried where the march stands."""
    t = run.now[0].t
    # t + h is rounded to the spacing of floats at t: of a shorter step too few digits would be left
    return max(run.plan[0].min_step, SPACINGS * (np.nextafter(t, np.inf) - t))


@jit_inline
def step_factors(run: Run) -> tuple[float, float, float]:
    """Return the factor after an accepted step, the controller's memory, and the factor after a rejected step."""
    plan, now = run.plan[0], run.now[0]
    if run.kept[0].growth > 0.0:  # the stepper proposes it
        return _predicted(run.kept[0].growth, plan.least, plan.greatest)
    logarithm = apply_function(run.law[LOG], now.norm) if now.norm > 0.0 else LEAST_LOGARITHM
    power = apply_function(run.law[EXP], _exponent(now.norm, logarithm, now.step_log, plan.order))
    return _proportional(now.norm, logarithm, power, plan.safety, plan.least, plan.greatest)


@jit_inline
def grow_step(run: Run, h: float, cut: bool) -> None:
    """Choose the step after an accepted one: no growth right after a rejection, no loss from a cut step."""
    plan, now = run.plan[0], run.now[0]
    if plan.series > 0:  # the next step is foreseen at its start
        now.rejected = 0
        return
    factor, now.step_log, _ = step_factors(run)
    now.step = _next(h, factor, cut, now.rejected, now.step, plan.min_step, plan.max_step)
    now.rejected = 0


@jit_inline
def reduce_step(run: Run, h: float, failed_test: bool) -> None:
    """Choose the step after a rejected trial of step h."""
    now, factor = run.now[0], NONFINITE_FACTOR
    unsolved = run.kept[0].growth > 0.0 and run.trial[0].iterations < 0
    if unsolved or (failed_test and math.isfinite(now.norm)):
        _, _, factor = step_factors(run)
    now.step = max(h * factor, shortest_step(run))
    now.rejected = 1


@jit_separate
def first_step(run: Run) -> float:
    """Choose the first step from the sizes of the state, its slope and its curvature, all over their tolerances.

    The rule of Hairer, Norsett, Wanner I, section II.4, takes the unit of time for the time scale of the problem; here
    it is a time scale of the problem itself, so that steps are the same in all units. The Euler probe is logged as a force
    sample after the initial one, and stands where the first trial will.
    """
    plan, t, y, probe = run.plan[0], run.now[0].t, run.y, run.z
    node = run.nodes[run.now[0].node] if run.now[0].node < run.nodes.shape[0] else plan.end
    span = node - t
    size, slope, change = 0.0, 0.0, 0.0
    for i in range(plan.used):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        if scale > 0.0:  # a tolerance that follows a size of 0 is 0 for now
            size = larger(size, abs(y[i]) / scale)
            slope = larger(slope, abs(state_slope(run, y, i)) / scale)
    if not size > 0.0:  # natural sizes where tolerances follow them
        size = 1.0 / plan.rtol if plan.follows else 1.0
    time = size / slope if slope > 0.0 else 1e-4 * span
    guess = min(0.01 * time, span, plan.max_step)
    for i in range(plan.used):
        probe[i] = y[i] + guess * state_slope(run, y, i)
    run.at[T] = t + guess
    call_law(run.law[FORCES], run, probe, probe, 0)
    run.now[0].evaluations += 1
    note_sample(run, t + guess, probe, 0)
    for i in range(plan.used):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        if scale > 0.0:
            change = larger(change, abs(state_slope(run, probe, i) - state_slope(run, y, i)) / scale)
    curvature = change / guess
    if curvature > 0.0:  # the slope of a body at rest says little
        time = max(time, math.sqrt(size / curvature))
    steepest = max(slope * time, curvature * time * time)
    step = guess
    if 0.0 < steepest < math.inf:
        step = min(
            time, time * apply_function(run.law[EXP], apply_function(run.law[LOG], 0.01 / steepest) / plan.order)
        )
    return min(max(step, shortest_step(run)), plan.max_step)


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
