"""A step by Radau IIA as RADAU5 makes it: simplified Newton; derivatives and factors are kept while it converges.

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8. The unknowns are the increments Z of three stages; transformed,
W = T**-1 Z, they are those of the two linear systems of `march.implicit.transformed`.
"""

from __future__ import annotations

import math

import numpy as np

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels import radau_lines, step_control
from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.formulas import compiled_function_of
from xdynamics.kernels.law import INSIDE
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.control import NONFINITE_FACTOR, trial_error_norm
from xdynamics.march.force_evaluation import State, evaluate_forces, evaluate_held, find_term_sizes, keep_sample
from xdynamics.march.implicit.corrections import (
    at_stages,
    corrections_are_rounding,
    largest_correction,
    settles_to_rounding,
)
from xdynamics.march.implicit.derivatives import LATE, linearise_forces, slope_apart
from xdynamics.march.implicit.transformed import factorise_both, solve_complex_system, solve_real_system
from xdynamics.march.run import BEGUN, MOVED, STAYED, Run
from xdynamics.methods import radau as constants

_ITERATIONS = (
    "simplified Newton iterations in transformed variables, with Jacobian and factors kept while they converge;"
)
_SOURCE = "(Hairer, Wanner, Solving ODEs II, section IV.8)"
SOLVED_BY = (
    f"{_ITERATIONS} in chosen steps until what they lack is below min(tolerance, sqrt(rtol)) of the error that is"
    " allowed, with the rtol of the error norm, in given ones until it is below the tolerance times the size of its"
    f" unknown {_SOURCE}"
)
SOLVED_WITH_LINKS = (  # whose steps are solved to rounding, see `settles_to_rounding`
    f"{_ITERATIONS} until what they lack is below the tolerance times the size of its unknown, which includes the"
    f" velocity that the forces of closed contacts keep from bodies in the step {_SOURCE}"
)
# single numbers: numba would build tuples anew at every use
C1, C2, _ = constants.NODES
E1, E2, E3 = constants.ERROR
(A00, A01, A02), (A10, A11, A12), (A20, A21, A22) = constants.T_INVERSE
MOST_TURNS = np.int64(constants.MOST_TURNS)  # no literal: numba compiles a copy of a function for each that it is given
MOST_SETTLING = np.int64(25)  # where the step is given
SETTLED = 1e-15  # a correction relative to the size of its unknown, where the step is given
ROUNDING = 1e-10  # below which corrections that no longer fall are rounding
NEAR = 1e-2  # below which the derivatives at an iterate serve the next ones too
UNSOLVED_GROWTH = 0.5
AT_START, AT_ITERATES = 1, 2  # where the derivatives are, after a first way in which they may be older
WEIGHED = 3  # the way in which corrections within the rounding of terms that cancel are none
OPEN, DONE, IN_VAIN = range(3)

error_norm_apart = noinline(trial_error_norm)
_polynomial = compiled_function_of(
    radau_lines.RADAU_POLYNOMIAL, "z0 z1 z2", "first second third", radau_lines.CONSTANTS
)
_guess = compiled_function_of(radau_lines.GUESS, "c relative first second third", "guess", radau_lines.CONSTANTS)
_convergence = compiled_function_of(
    radau_lines.CONVERGENCE, "size change ratio turn_now", "ratio_now theta_now eta_now"
)
_GIVEN = "norm width before norm_before turn turns theta safety least greatest"
_growth = compiled_function_of(step_control.PREDICTIVE, _GIVEN, "growth", step_control.CONSTANTS)


@jit_inline
def radau_step(run: Run, t: float, t1: float, h: float, y: State, z: State, sample: int) -> None:
    """Make one step of size h from t to t1 and y to z, with its force evaluations and the estimate of its error."""
    plan, used, width = run.plan[0], run.plan[0].used, run.log_samples.shape[0] - 2
    recall_last_step(run)
    done = solve_stages(run, t, h, y, sample)
    leave_stages(run, y)
    for i in range(used):
        z[i] = y[i] + run.stages[2 * used + i]
    evaluate_held(run, t1, z, h)
    keep_sample(run, t1, z, sample + 3 * width)
    run.at[UNSOUND] = 0.0
    for i in range(plan.state):
        if not np.isfinite(z[i]):
            run.at[UNSOUND] = np.nan
    if not done:
        run.trial[0].iterations = -1
    if plan.estimates and plan.steps == 1:
        run.kept[0].growth = UNSOLVED_GROWTH
        if done:
            estimate_error(run, t, h, y)
            look_ahead(run, h)


@jit_separate
def leave_stages(run: Run, y: State) -> None:
    """Leave the states at the stages where laws read them, if there is one for times inside a step or a polynomial."""
    used = run.plan[0].used
    if run.law[INSIDE] != 0 or run.plan[0].degree > 0 or run.delays.shape[0] > 0:
        for k in range(3):
            for i in range(used):
                run.w[k * used + i] = y[i] + run.stages[k * used + i]


@jit_separate
def recall_last_step(run: Run) -> None:
    """Keep of the last step what this one may use: nothing after a start, an event or a node of a drive."""
    step_memory = run.kept[0]
    if step_memory.since == BEGUN:
        step_memory.linearised, step_memory.fresh, step_memory.factored = 0, 0, 0.0
        step_memory.theta, step_memory.eta, step_memory.step, step_memory.norm = 0.0, 1.0, 0.0, 0.0
    elif step_memory.since == MOVED:
        keep_polynomial(run)
        step_memory.step = 0.0 if run.plan[0].steps > 1 else run.now[0].h
        step_memory.norm, step_memory.fresh = max(constants.LEAST_NORM, run.now[0].norm), 0
        if step_memory.turns > constants.FEW_TURNS and step_memory.theta > constants.SLOW:
            step_memory.linearised = 0
    step_memory.since = STAYED


@jit_inline
def solve_stages(run: Run, t: float, h: float, y: State, sample: int) -> bool:
    """Solve for the stages: with what is kept; with derivatives at y; if the step is given, at the iterates.

    If it is chosen, what is left may be the rounding of forces that cancel, below which corrections do not fall.
    """
    step_memory, plan, done = run.kept[0], run.plan[0], False
    for attempt in range(4):
        if done or (attempt == AT_START and step_memory.fresh) or (attempt == AT_ITERATES and plan.adaptive):
            continue
        if attempt == WEIGHED:
            if not (plan.adaptive and plan.rounding > 0.0):
                continue
            find_term_sizes(run, t + h, y)
        begin_iteration(run, h, attempt)
        done = iterate_stages(run, t, h, y, sample, attempt)
        if attempt == AT_ITERATES:  # these derivatives serve no other step
            done = done or corrections_are_rounding(run, h, y)
            step_memory.linearised, step_memory.fresh = 0, 0
    return done


@jit_separate
def begin_iteration(run: Run, h: float, attempt: int) -> None:
    """Choose starting values for an iteration, and discard derivatives that are older than this way allows."""
    step_memory = run.kept[0]
    guess_stages(run, h, 0.0 if attempt == AT_ITERATES else step_memory.step)
    step_memory.eta = max(step_memory.eta, EPS)
    step_memory.eta = math.sqrt(step_memory.eta) * math.sqrt(math.sqrt(step_memory.eta))
    step_memory.theta = 0.0
    if attempt == AT_START:
        step_memory.linearised = 0


@jit_inline
def iterate_stages(run: Run, t: float, h: float, y: State, sample: int, attempt: int) -> bool:
    """Correct the stages until their error is small enough; whether that was reached.

    When following the iterates, derivatives are those at the second stage of each, until the solution is near.
    """
    step_memory, verdict, turn, following = run.kept[0], OPEN, 0, attempt == AT_ITERATES
    while verdict == OPEN:
        refresh_derivatives(run, t, h, y, following)
        if not abs(h - step_memory.factored) <= constants.SAME_STEP * h and not factorise_both(run, h):
            verdict = IN_VAIN
            continue
        if turn == 0:  # factors of nearly the same step correct no better than that, whatever earlier ones did
            step_memory.eta = max(step_memory.eta, abs(h - step_memory.factored) / h)
        size, turn = correct_stages(run, t, h, y, sample, attempt == WEIGHED), turn + 1
        if not following:
            verdict = judge_iteration(run, size, turn)
        elif size <= NEAR:
            following, turn, step_memory.eta = False, 0, 1.0
        elif turn == MOST_SETTLING or not math.isfinite(size):
            verdict = IN_VAIN
        elif turn >= LATE and corrections_are_rounding(run, h, y):
            verdict = DONE
    return verdict == DONE


@jit_separate
def refresh_derivatives(run: Run, t: float, h: float, y: State, following: bool) -> None:
    """Evaluate the derivatives at the second stage of the iterate that is followed, or at y where none are kept."""
    used, step_memory, time = run.plan[0].used, run.kept[0], t
    if step_memory.linearised and not following:
        return
    for i in range(y.shape[0]):
        run.stage[i] = y[i]
    if following:
        time = t + C2 * h
        for i in range(used):
            run.stage[i] = y[i] + run.stages[used + i]
        if run.plan[0].differences or run.groups.shape[0] > 0:
            evaluate_forces(run, time, run.stage)
    linearise_forces(run, time, h, run.stage)
    step_memory.fresh = 1


@jit_separate
def judge_iteration(run: Run, size: float, turn: int) -> int:
    """Judge an iteration by its corrections, the last of this size: DONE, IN_VAIN, or OPEN while it may converge."""
    step_memory, rtol = run.kept[0], run.plan[0].rtol
    tolerance, rounding, max_turns = SETTLED, ROUNDING, MOST_SETTLING
    if not settles_to_rounding(run):
        rounding, max_turns = 10.0 * EPS / rtol, MOST_TURNS
        tolerance = max(0.05 * rounding, min(constants.SHARE, math.sqrt(rtol)))
    if not math.isfinite(size):
        return IN_VAIN
    if turn > 1:
        step_memory.ratio, step_memory.theta, eta = _convergence(size, step_memory.change, step_memory.ratio, turn)
        if size <= rounding and step_memory.ratio >= constants.STALLED:
            return DONE
        if not step_memory.theta < constants.DIVERGING:
            return IN_VAIN
        step_memory.eta = eta
        remaining = step_memory.eta * size
        for _ in range(max_turns - turn):
            remaining *= step_memory.theta
        if remaining > max(tolerance, rounding):
            return IN_VAIN
    step_memory.change, step_memory.turns = max(size, EPS), turn
    if step_memory.eta * size <= tolerance or (turn == max_turns and size <= rounding):
        return DONE
    return OPEN if turn < max_turns else IN_VAIN


@jit_inline
def correct_stages(run: Run, t: float, h: float, y: State, sample: int, weighed: bool) -> float:
    """Correct all stages once; return the largest correction relative to the tolerance of its unknown."""
    if run.trial[0].iterations >= 0:
        run.trial[0].iterations += 1
    slopes_at_stages(run, t, h, y, sample)
    corrections, transformed, n = run.stages, run.turned, run.plan[0].used
    gamma, alpha, beta = constants.GAMMA / h, constants.ALPHA / h, constants.BETA / h
    to_transformed(corrections, corrections, n)
    for i in range(n):
        w1, w2 = transformed[n + i], transformed[2 * n + i]
        corrections[i] -= gamma * transformed[i]
        corrections[n + i] -= alpha * w1 - beta * w2
        corrections[2 * n + i] -= beta * w1 + alpha * w2
    solve_real_system(run, corrections)
    solve_complex_system(run, corrections)
    for i in range(3 * n):
        transformed[i] += corrections[i]
    size = largest_correction(run, h, y, weighed)
    to_stages(transformed, run.stages, n)
    return size


@jit_separate
def to_transformed(stages: State, transformed: State, n: int) -> None:
    """Multiply three vectors of n components, stored one after the other, by T**-1."""
    for i in range(n):
        z0, z1, z2 = stages[i], stages[n + i], stages[2 * n + i]
        transformed[i] = A00 * z0 + A01 * z1 + A02 * z2
        transformed[n + i] = A10 * z0 + A11 * z1 + A12 * z2
        transformed[2 * n + i] = A20 * z0 + A21 * z1 + A22 * z2


@jit_separate
def to_stages(transformed: State, stages: State, n: int) -> None:
    """Multiply three vectors of n components, stored one after the other, by T."""
    for i in range(n):
        stages[i], stages[n + i], stages[2 * n + i] = at_stages(
            transformed[i], transformed[n + i], transformed[2 * n + i]
        )


@jit_separate
def slopes_at_stages(run: Run, t: float, h: float, y: State, sample: int) -> None:
    """Evaluate the forces at the stages, and put the slopes there into their place."""
    n, stage, width = run.plan[0].used, run.stage, run.log_samples.shape[0] - 2
    for k in range(3):
        time = t + (C1 if k == 0 else C2 if k == 1 else 1.0) * h
        for i in range(n):
            stage[i] = y[i] + run.stages[k * n + i]
        evaluate_forces(run, time, stage)
        keep_sample(run, time, stage, sample + k * width)
        for i in range(n):
            run.stages[k * n + i] = slope_apart(run, stage, i)


@jit_separate
def guess_stages(run: Run, h: float, size_before: float) -> None:
    """Start the iteration on the collocation polynomial of the step before, or at rest if its size `size_before` is 0."""
    n, past, relative = run.plan[0].used, run.past, h / size_before if size_before > 0.0 else 0.0
    for i in range(n):
        first, second, third = past[i], past[n + i], past[2 * n + i]
        run.stages[i] = _guess(C1, relative, first, second, third)
        run.stages[n + i] = _guess(C2, relative, first, second, third)
        run.stages[2 * n + i] = _guess(1.0, relative, first, second, third)
    to_transformed(run.stages, run.turned, n)


@jit_separate
def keep_polynomial(run: Run) -> None:
    """Keep the differences of the collocation polynomial, from the end of the step backwards."""
    n, past, stages = run.plan[0].used, run.past, run.stages
    for i in range(n):
        past[i], past[n + i], past[2 * n + i] = _polynomial(stages[i], stages[n + i], stages[2 * n + i])


@jit_inline
def estimate_error(run: Run, t: float, h: float, y: State) -> None:
    """Estimate the error by the embedded formula; where that fails at a start or again, at the state it leads to."""
    n, e, step_memory, now, defects = (
        run.plan[0].used,
        run.e,
        run.kept[0],
        run.now[0],
        run.turned,
    )  # solved, which is free
    if not step_memory.factored > 0.0:
        return
    for i in range(n):
        defects[i] = (E1 * run.stages[i] + E2 * run.stages[n + i] + E3 * run.stages[2 * n + i]) / h
        e[i] = defects[i] + slope_apart(run, y, i)
    solve_real_system(run, e)
    if (now.rejected or not step_memory.step > 0.0) and not error_norm_apart(run) <= 1.0:
        for i in range(n):
            run.stage[i] = y[i] + e[i]
        evaluate_forces(run, t, run.stage)
        for i in range(n):
            e[i] = defects[i] + slope_apart(run, run.stage, i)
        solve_real_system(run, e)


@jit_separate
def look_ahead(run: Run, h: float) -> None:
    """Note by which factor the next step may differ: by the predictive controller if the trial passes, as in RADAU5."""
    plan, step_memory, norm = run.plan[0], run.kept[0], error_norm_apart(run)
    if not math.isfinite(norm):
        step_memory.growth = NONFINITE_FACTOR
        return
    step_memory.growth = _growth(
        norm,
        h,
        step_memory.step,
        step_memory.norm,
        run.trial[0].iterations,
        step_memory.turns,
        step_memory.theta,
        plan.safety,
        plan.least,
        plan.greatest,
    )
