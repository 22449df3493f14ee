"""A step by Radau IIA as RADAU5 makes it: simplified Newton; derivatives and factors are kept while it converges.

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8. The unknowns are the increments Z of three stages; transformed,
W = T**-1 Z, they are those of the two linear systems of `march.implicit.transformed`.
"""

from __future__ import annotations

import math

import numpy as np

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels import radau_lines, step_control
from xdynamics.kernels.compiling import apart, compiled, shared
from xdynamics.kernels.formulas import function_of
from xdynamics.kernels.law import INSIDE
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.control import NONFINITE_FACTOR, error_norm
from xdynamics.march.force_evaluation import State, evaluate, evaluate_held, find_term_sizes, keep_sample
from xdynamics.march.implicit.corrections import at_stages, correction, is_rounding, settles
from xdynamics.march.implicit.derivatives import LATE, linearise, slope_apart
from xdynamics.march.implicit.transformed import factorise_both, solve_complex, solve_real
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
SOLVED_WITH_LINKS = (  # whose steps are solved to rounding, see `settles`
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

error_norm_apart = apart(error_norm)
_polynomial = function_of(radau_lines.POLYNOMIAL, "z0 z1 z2", "first second third", radau_lines.CONSTANTS)
_guess = function_of(radau_lines.GUESS, "c relative first second third", "guess", radau_lines.CONSTANTS)
_convergence = function_of(radau_lines.CONVERGENCE, "size change ratio turn_now", "ratio_now theta_now eta_now")
_GIVEN = "norm width before norm_before turn turns theta safety least greatest"
_growth = function_of(step_control.PREDICTIVE, _GIVEN, "growth", step_control.CONSTANTS)


@compiled
def radau_step(run: Run, t: float, t1: float, h: float, y: State, z: State, sample: int) -> None:
    """Make one step of size h from t to t1 and y to z, with its force evaluations and the estimate of its error."""
    plan, used, width = run.plan[0], run.plan[0].used, run.log_samples.shape[0] - 2
    recall(run)
    done = solved(run, t, h, y, sample)
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
            estimate(run, t, h, y)
            look_ahead(run, h)


@shared
def leave_stages(run: Run, y: State) -> None:
    """Leave the states at the stages where laws read them, if there is one for times inside a step or a polynomial."""
    used = run.plan[0].used
    if run.law[INSIDE] != 0 or run.plan[0].degree > 0 or run.delays.shape[0] > 0:
        for k in range(3):
            for i in range(used):
                run.w[k * used + i] = y[i] + run.stages[k * used + i]


@shared
def recall(run: Run) -> None:
    """Keep of the last step what this one may use: nothing after a start, an event or a node of a drive."""
    kept = run.kept[0]
    if kept.since == BEGUN:
        kept.linearised, kept.fresh, kept.factored = 0, 0, 0.0
        kept.theta, kept.eta, kept.step, kept.norm = 0.0, 1.0, 0.0, 0.0
    elif kept.since == MOVED:
        keep_polynomial(run)
        kept.step = 0.0 if run.plan[0].steps > 1 else run.now[0].h
        kept.norm, kept.fresh = max(constants.LEAST_NORM, run.now[0].norm), 0
        if kept.turns > constants.FEW_TURNS and kept.theta > constants.SLOW:
            kept.linearised = 0
    kept.since = STAYED


@compiled
def solved(run: Run, t: float, h: float, y: State, sample: int) -> bool:
    """Solve for the stages: with what is kept; with derivatives at y; if the step is given, at the iterates.

    If it is chosen, what is left may be the rounding of forces that cancel, below which corrections do not fall.
    """
    kept, plan, done = run.kept[0], run.plan[0], False
    for way in range(4):
        if done or (way == AT_START and kept.fresh) or (way == AT_ITERATES and plan.adaptive):
            continue
        if way == WEIGHED:
            if not (plan.adaptive and plan.rounding > 0.0):
                continue
            find_term_sizes(run, t + h, y)
        prepare(run, h, way)
        done = iterate(run, t, h, y, sample, way)
        if way == AT_ITERATES:  # these derivatives serve no other step
            done = done or is_rounding(run, h, y)
            kept.linearised, kept.fresh = 0, 0
    return done


@shared
def prepare(run: Run, h: float, way: int) -> None:
    """Choose starting values for an iteration, and discard derivatives that are older than this way allows."""
    kept = run.kept[0]
    guess(run, h, 0.0 if way == AT_ITERATES else kept.step)
    kept.eta = max(kept.eta, EPS)
    kept.eta = math.sqrt(kept.eta) * math.sqrt(math.sqrt(kept.eta))
    kept.theta = 0.0
    if way == AT_START:
        kept.linearised = 0


@compiled
def iterate(run: Run, t: float, h: float, y: State, sample: int, way: int) -> bool:
    """Correct the stages until their error is small enough; whether that was reached.

    When following the iterates, derivatives are those at the second stage of each, until the solution is near.
    """
    kept, verdict, turn, following = run.kept[0], OPEN, 0, way == AT_ITERATES
    while verdict == OPEN:
        freshen(run, t, h, y, following)
        if not abs(h - kept.factored) <= constants.SAME_STEP * h and not factorise_both(run, h):
            verdict = IN_VAIN
            continue
        if turn == 0:  # factors of nearly the same step correct no better than that, whatever earlier ones did
            kept.eta = max(kept.eta, abs(h - kept.factored) / h)
        size, turn = correct(run, t, h, y, sample, way == WEIGHED), turn + 1
        if not following:
            verdict = judged(run, size, turn)
        elif size <= NEAR:
            following, turn, kept.eta = False, 0, 1.0
        elif turn == MOST_SETTLING or not math.isfinite(size):
            verdict = IN_VAIN
        elif turn >= LATE and is_rounding(run, h, y):
            verdict = DONE
    return verdict == DONE


@shared
def freshen(run: Run, t: float, h: float, y: State, following: bool) -> None:
    """Evaluate the derivatives at the second stage of the iterate that is followed, or at y where none are kept."""
    used, kept, time = run.plan[0].used, run.kept[0], t
    if kept.linearised and not following:
        return
    for i in range(y.shape[0]):
        run.stage[i] = y[i]
    if following:
        time = t + C2 * h
        for i in range(used):
            run.stage[i] = y[i] + run.stages[used + i]
        if run.plan[0].differences or run.groups.shape[0] > 0:
            evaluate(run, time, run.stage)
    linearise(run, time, h, run.stage)
    kept.fresh = 1


@shared
def judged(run: Run, size: float, turn: int) -> int:
    """Judge an iteration by its corrections, the last of this size: DONE, IN_VAIN, or OPEN while it may converge."""
    kept, rtol = run.kept[0], run.plan[0].rtol
    tolerance, rounding, most = SETTLED, ROUNDING, MOST_SETTLING
    if not settles(run):
        rounding, most = 10.0 * EPS / rtol, MOST_TURNS
        tolerance = max(0.05 * rounding, min(constants.SHARE, math.sqrt(rtol)))
    if not math.isfinite(size):
        return IN_VAIN
    if turn > 1:
        kept.ratio, kept.theta, eta = _convergence(size, kept.change, kept.ratio, turn)
        if size <= rounding and kept.ratio >= constants.STALLED:
            return DONE
        if not kept.theta < constants.DIVERGING:
            return IN_VAIN
        kept.eta = eta
        remaining = kept.eta * size
        for _ in range(most - turn):
            remaining *= kept.theta
        if remaining > max(tolerance, rounding):
            return IN_VAIN
    kept.change, kept.turns = max(size, EPS), turn
    if kept.eta * size <= tolerance or (turn == most and size <= rounding):
        return DONE
    return OPEN if turn < most else IN_VAIN


@compiled
def correct(run: Run, t: float, h: float, y: State, sample: int, weighed: bool) -> float:
    """Correct all stages once; return the largest correction relative to the tolerance of its unknown."""
    if run.trial[0].iterations >= 0:
        run.trial[0].iterations += 1
    slopes_at_stages(run, t, h, y, sample)
    corrections, turned, n = run.stages, run.turned, run.plan[0].used
    gamma, alpha, beta = constants.GAMMA / h, constants.ALPHA / h, constants.BETA / h
    to_transformed(corrections, corrections, n)
    for i in range(n):
        w1, w2 = turned[n + i], turned[2 * n + i]
        corrections[i] -= gamma * turned[i]
        corrections[n + i] -= alpha * w1 - beta * w2
        corrections[2 * n + i] -= beta * w1 + alpha * w2
    solve_real(run, corrections)
    solve_complex(run, corrections)
    for i in range(3 * n):
        turned[i] += corrections[i]
    size = correction(run, h, y, weighed)
    to_stages(turned, run.stages, n)
    return size


@shared
def to_transformed(given: State, found: State, n: int) -> None:
    """Multiply three vectors of n components, stored one after the other, by T**-1."""
    for i in range(n):
        z0, z1, z2 = given[i], given[n + i], given[2 * n + i]
        found[i] = A00 * z0 + A01 * z1 + A02 * z2
        found[n + i] = A10 * z0 + A11 * z1 + A12 * z2
        found[2 * n + i] = A20 * z0 + A21 * z1 + A22 * z2


@shared
def to_stages(given: State, found: State, n: int) -> None:
    """Multiply three vectors of n components, stored one after the other, by T."""
    for i in range(n):
        found[i], found[n + i], found[2 * n + i] = at_stages(given[i], given[n + i], given[2 * n + i])


@shared
def slopes_at_stages(run: Run, t: float, h: float, y: State, sample: int) -> None:
    """Evaluate the forces at the stages, and put the slopes there into their place."""
    n, stage, width = run.plan[0].used, run.stage, run.log_samples.shape[0] - 2
    for k in range(3):
        time = t + (C1 if k == 0 else C2 if k == 1 else 1.0) * h
        for i in range(n):
            stage[i] = y[i] + run.stages[k * n + i]
        evaluate(run, time, stage)
        keep_sample(run, time, stage, sample + k * width)
        for i in range(n):
            run.stages[k * n + i] = slope_apart(run, stage, i)


@shared
def guess(run: Run, h: float, before: float) -> None:
    """Start the iteration on the collocation polynomial of the step before, or at rest if its size `before` is 0."""
    n, past, relative = run.plan[0].used, run.past, h / before if before > 0.0 else 0.0
    for i in range(n):
        first, second, third = past[i], past[n + i], past[2 * n + i]
        run.stages[i] = _guess(C1, relative, first, second, third)
        run.stages[n + i] = _guess(C2, relative, first, second, third)
        run.stages[2 * n + i] = _guess(1.0, relative, first, second, third)
    to_transformed(run.stages, run.turned, n)


@shared
def keep_polynomial(run: Run) -> None:
    """Keep the differences of the collocation polynomial, from the end of the step backwards."""
    n, past, stages = run.plan[0].used, run.past, run.stages
    for i in range(n):
        past[i], past[n + i], past[2 * n + i] = _polynomial(stages[i], stages[n + i], stages[2 * n + i])


@compiled
def estimate(run: Run, t: float, h: float, y: State) -> None:
    """Estimate the error by the embedded formula; where that fails at a start or again, at the state it leads to."""
    n, e, kept, now, defects = run.plan[0].used, run.e, run.kept[0], run.now[0], run.turned  # solved, which is free
    if not kept.factored > 0.0:
        return
    for i in range(n):
        defects[i] = (E1 * run.stages[i] + E2 * run.stages[n + i] + E3 * run.stages[2 * n + i]) / h
        e[i] = defects[i] + slope_apart(run, y, i)
    solve_real(run, e)
    if (now.rejected or not kept.step > 0.0) and not error_norm_apart(run) <= 1.0:
        for i in range(n):
            run.stage[i] = y[i] + e[i]
        evaluate(run, t, run.stage)
        for i in range(n):
            e[i] = defects[i] + slope_apart(run, run.stage, i)
        solve_real(run, e)


@shared
def look_ahead(run: Run, h: float) -> None:
    """Note by which factor the next step may differ: by the predictive controller if the trial passes, as in RADAU5."""
    plan, kept, norm = run.plan[0], run.kept[0], error_norm_apart(run)
    if not math.isfinite(norm):
        kept.growth = NONFINITE_FACTOR
        return
    kept.growth = _growth(
        norm,
        h,
        kept.step,
        kept.norm,
        run.trial[0].iterations,
        kept.turns,
        kept.theta,
        plan.safety,
        plan.least,
        plan.greatest,
    )
