"""A step by Radau IIA as RADAU5 makes it, by simplified Newton iterations.

Derivatives and factors are kept while the iterations converge.

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8. The unknowns are the increments Z of three stages; transformed,
W = T**-1 Z, they are those of two linear systems, gamma/h - J and (alpha + i beta)/h - J. In both, the coordinates are
eliminated by their rows c dq - dv = r, so that only velocities and first-order states are factorised.

Corrections are measured by tolerances, by the sizes of unknowns, and by rounding.

The memory that a step leaves for the next step is put into a lane and taken out of it for `kernels.collocation`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels import collocation, formulas
from xdynamics.kernels.collocation import KEPT
from xdynamics.kernels.collocation import PLACES as K
from xdynamics.kernels.compiling import jit_inline, jit_separate, jit_uncounted, noinline
from xdynamics.kernels.formulas import compiled_function_of, larger
from xdynamics.kernels.lane_step import LANE
from xdynamics.kernels.law import INSIDE
from xdynamics.kernels.linear import (
    COMPLEX,
    REAL,
    factorise,
    factorise_band,
    factorise_complex,
    factorise_complex_band,
    note_extents,
    substitute,
    substitute_band,
    substitute_complex,
    substitute_complex_band,
)
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.assembly.closed_links import SCALE, X, closed_from, rows_of_closed
from xdynamics.march.control import NONFINITE_FACTOR, term_rounding, trial_error_norm
from xdynamics.march.force_evaluation import State, evaluate_forces, evaluate_held, find_term_sizes, keep_sample
from xdynamics.march.implicit.newton import LATE, ROUNDED, column_height, linearise_forces, matrix_index, slope_apart
from xdynamics.march.run import BEGUN, MOVED, STAYED, Run
from xdynamics.methods import implicit as constants
from xdynamics.methods.implicit import ALPHA, BETA, GAMMA
from xdynamics.methods.implicit import T as TRANSFORMATION

# single numbers: numba would build tuples anew at every use
(T00, T01, T02), (T10, T11, T12), (T20, _, _) = TRANSFORMATION


@jit_separate
def largest_correction(run: Run, h: float, y: State, weighed: bool) -> float:
    """Return the largest of the last corrections, relative to its tolerance or to the size of its unknown.

    They stand where stages will; the largest of each unknown is left in `right`, for messages. If `weighed` by the sizes
    of terms, those within their rounding are none.
    """
    n, plan, largest = run.plan[0].used, run.plan[0], 0.0
    holds_links = plan.assemblies > 0 and run.closed[0] > 0
    if holds_links:
        held_of_kinds(run, h)
    for i in range(n):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        move = largest_move(run, i)
        if plan.follows and scale == 0.0:  # it was at rest: its move is the only scale
            scale = plan.rtol * move
        if settles_to_rounding(run):
            scale = abs(y[i]) + abs(h * slope_apart(run, y, i)) + move
            if holds_links:
                scale += held_from(run, h, i)
        run.right[i] = 0.0
        rounding_floor = term_rounding(run, i, h) if weighed and run.adaptive_atol[i] else 0.0
        for k in range(3):
            change = abs(run.stages[k * n + i])
            run.right[i] = larger(run.right[i], change)
            if change <= rounding_floor and scale < rounding_floor:
                continue
            # without a change the scale may be zero, too
            if change != 0.0:
                largest = larger(largest, change / scale)
    return largest


@jit_separate
def largest_move(run: Run, i: int) -> float:
    """Return how far an unknown has moved since the start of the step, at most."""
    n, transformed = run.plan[0].used, run.turned
    first, second, third = at_stages(transformed[i], transformed[n + i], transformed[2 * n + i])
    return max(abs(first), abs(second), abs(third))


@jit_separate
def settles_to_rounding(run: Run) -> bool:
    """Whether steps are solved to rounding: given ones, and where links meet, as a gap is to pass through zero but once."""
    return not run.plan[0].adaptive or run.plan[0].assemblies > 0


@jit_separate
def held_of_kinds(run: Run, h: float) -> None:
    """Compute the largest velocity of each kind that forces of closed links prevent in the step.

    What links hold has no size of its own but rounding about zero, and that is a share of the terms that cancel.
    """
    n = run.plan[0].coordinates
    for k in range(run.tops.shape[0]):
        run.tops[k] = 0.0
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        amount = h * run.vectors[X, row] * run.vectors[SCALE, row]
        for i in range(run.normals.shape[1]):
            kind = run.kinds[n + run.coordinate_indices[row, i]]
            run.tops[kind] = max(run.tops[kind], abs(run.unit_responses[row, i] * amount))


@jit_separate
def held_from(run: Run, h: float, i: int) -> float:
    """Return the change of an unknown's kind that closed links prevent in the step."""
    n = run.plan[0].coordinates
    if i < n:
        return float(h * run.tops[run.kinds[n + i]])
    return float(run.tops[run.kinds[i]]) if i < 2 * n else 0.0


@jit_inline
def corrections_are_rounding(run: Run, h: float, y: State) -> bool:
    """Whether the last corrections are as small as the effect of the state's rounding on the forces.

    What is left of large terms that cancel, as of bars that pull to both sides, has no digits below: a correction is then
    no share of its unknown.
    """
    n, used, first, scratch = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.turned
    if not run.kept[0].factored > 0.0:
        return False
    for i in range(used):  # of each unknown: its size; the terms of its equation; how steeply they follow it
        size = abs(y[i]) + largest_move(run, i)
        scratch[i], scratch[used + i], scratch[2 * used + i] = size, size, 1.0
    for k in range(run.entries.shape[0]):
        row, column, slope = n + run.entries[k, 0], run.entries[k, 1], abs(h * run.w[first + k])
        scratch[used + row] += slope * scratch[column]
        if column == row or column == row - n:
            scratch[2 * used + row] += slope if column == row else h * slope
    for i in range(used):
        terms = scratch[used + i] / scratch[2 * used + i]
        if i < n:
            terms += h * scratch[used + n + i] / scratch[2 * used + n + i]
        if not run.right[i] <= ROUNDED * terms:
            return False
    return True


@jit_separate
def at_stages(w0: float, w1: float, w2: float) -> tuple[float, float, float]:
    """Multiply one component of three vectors by T."""
    return T00 * w0 + T01 * w1 + T02 * w2, T10 * w0 + T11 * w1 + T12 * w2, T20 * w0 + w1


@jit_separate
def factorise_both(run: Run, h: float) -> bool:
    """Assemble the real and the complex matrix for a step size, and factorise them; False if one is singular."""
    n, first, matrix = run.plan[0].coordinates, 3 * run.plan[0].used, run.matrix
    size = run.plan[0].used - n
    gamma, alpha, beta = GAMMA / h, ALPHA / h, BETA / h
    square = alpha * alpha + beta * beta
    plane = size * column_height(run)
    for i in range(3 * plane):
        matrix[i] = 0.0
    re, im = plane, 2 * plane
    for i in range(size):
        diagonal = matrix_index(run, i, i)
        matrix[diagonal], matrix[re + diagonal], matrix[im + diagonal] = gamma, alpha, beta
    for k in range(run.entries.shape[0]):
        row, column, slope = run.entries[k, 0], run.entries[k, 1], run.w[first + k]
        if column < n:  # dq = dv/c, and 1/(alpha + i beta) is (alpha - i beta)/square
            entry_index = matrix_index(run, row, column)
            matrix[entry_index] -= slope / gamma
            matrix[re + entry_index] -= slope * (alpha / square)
            matrix[im + entry_index] += slope * (beta / square)
        else:
            entry_index = matrix_index(run, row, column - n)
            matrix[entry_index] -= slope
            matrix[re + entry_index] -= slope
    # before trying: factors that could not be made are of no step
    run.kept[0].factored = 0.0
    if not (factorised_in_band(run, size) if run.band.shape[0] > 0 else factorised_whole(run, size)):
        return False
    run.kept[0].factored = h
    run.now[0].factorisations += 1
    return True


@jit_separate
def factorised_whole(run: Run, size: int) -> bool:
    """Factorise both full matrices."""
    return factorise(run.matrix, run.pivots, size) and factorise_complex(run.matrix, run.pivots, size)


@jit_separate
def factorised_in_band(run: Run, size: int) -> bool:
    """Factorise both band matrices."""
    lower, upper = run.band[0], run.band[1]
    real = factorise_band(run.matrix, run.pivots, size, lower, upper)
    return real and factorise_complex_band(run.matrix, run.pivots, size, lower, upper)


@jit_separate
def solve_real_system(run: Run, vector: State) -> None:
    """Solve (gamma/h - J) d = r in place, with the factors at hand."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    gamma = GAMMA / run.kept[0].factored
    for i in range(n, used):
        right[run.order[i - n]] = vector[i]
    for k in range(run.entries.shape[0]):
        column = run.entries[k, 1]
        if column < n:
            right[run.order[run.entries[k, 0]]] += run.w[first + k] * (vector[column] / gamma)
    if run.band.shape[0] > 0:
        substitute_band(run.matrix, run.pivots, right, used - n, run.band[0], run.band[1])
    else:
        substitute(run.matrix, run.pivots, right, used - n)
    for i in range(n, used):
        vector[i] = right[run.order[i - n]]
    for i in range(n):
        vector[i] = (vector[i] + vector[n + i]) / gamma


@jit_separate
def solve_complex_system(run: Run, vectors: State) -> None:
    """Solve ((alpha + i beta)/h - J) d = r in place, for the second and the third part of three vectors."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    size = used - n
    alpha, beta = ALPHA / run.kept[0].factored, BETA / run.kept[0].factored
    square = alpha * alpha + beta * beta
    x, y = alpha / square, -beta / square
    for i in range(n):
        u, v = vectors[used + i], vectors[2 * used + i]
        vectors[used + i], vectors[2 * used + i] = u * x - v * y, u * y + v * x
    for i in range(size):
        ordered_index = run.order[i]
        right[ordered_index], right[size + ordered_index] = vectors[used + n + i], vectors[2 * used + n + i]
    for k in range(run.entries.shape[0]):
        row, column = run.order[run.entries[k, 0]], run.entries[k, 1]
        if column < n:
            right[row] += run.w[first + k] * vectors[used + column]
            right[size + row] += run.w[first + k] * vectors[2 * used + column]
    if run.band.shape[0] > 0:
        substitute_complex_band(run.matrix, run.pivots, right, size, run.band[0], run.band[1])
    else:
        substitute_complex(run.matrix, run.pivots, right, size)
    for i in range(size):
        ordered_index = run.order[i]
        vectors[used + n + i], vectors[2 * used + n + i] = right[ordered_index], right[size + ordered_index]
    for i in range(n):
        u, v = right[run.order[i]], right[size + run.order[i]]
        vectors[used + i] += u * x - v * y
        vectors[2 * used + i] += u * y + v * x


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
    collocation.RADAU_POLYNOMIAL, "z0 z1 z2", "first second third", collocation.CONSTANTS
)
_guess = compiled_function_of(collocation.GUESS, "c relative first second third", "guess", collocation.CONSTANTS)
_convergence = compiled_function_of(
    collocation.CONVERGENCE, "size change ratio turn_now", "ratio_now theta_now eta_now"
)
_GIVEN = "norm width before norm_before turn turns theta safety least greatest"
_growth = compiled_function_of(formulas.PREDICTIVE, _GIVEN, "growth", formulas.CONSTANTS)


@jit_inline
def radau_step(run: Run, t: float, t1: float, h: float, y: State, z: State, sample: int) -> None:
    """Make one step of size h from t to t1 and y to z, with its force evaluations and the estimate of its error."""
    plan, used, width = run.plan[0], run.plan[0].used, run.log_samples.shape[0] - 2
    recall_last_step(run)
    done = solve_stages(run, t, h, y, sample)
    leave_stages(run, y)
    # the last node is 1: the third stage is the end of the step
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
    """Validate the memory of the last step: none of it after a start, an event or a node of a drive."""
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
    """Solve for the stages: with stored derivatives; with those at y; with a given step, at the iterates.

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
    # RADAU5 takes the power 0.8; three quarters need square roots alone
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
    """Evaluate the derivatives at the second stage of a followed iterate, or at y where none are stored."""
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
        # negated, so that a ratio of nan counts as divergence
        if not step_memory.theta < constants.DIVERGING:
            return IN_VAIN
        step_memory.eta = eta
        remaining = step_memory.eta * size
        # a power would be the C library's, whose bits differ between machines
        for _ in range(max_turns - turn):
            remaining *= step_memory.theta
        if remaining > max(tolerance, rounding):
            return IN_VAIN
    # the next size is divided by it
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
    """Evaluate the forces at the stages, and store their slopes."""
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
    """Store the factor of the next step: by the predictive controller if the trial passes, as in RADAU5."""
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


Floats = NDArray[np.float64]

OF_LANE, OF_KEPT = np.int64(len(LANE)), np.int64(len(KEPT))


@jit_uncounted
def step_memory_index(run: Run) -> int:
    """Return the index in a lane of the step memory of Radau IIA."""
    return OF_LANE + 3 * run.plan[0].used + 2 * run.detectors.shape[0]


@jit_uncounted
def step_number_count(run: Run) -> int:
    """Return how many numbers of a lane hold the polynomial of a step and the states that it is made of."""
    plan = run.plan[0]
    return run.stages.shape[0] + (plan.degree + 1) * plan.used if plan.degree > 0 else 0


@jit_uncounted
def forget_step_memory(run: Run, w: Floats, lane: int) -> None:
    """Discard the memory of earlier steps, as after a node."""
    if run.stages.shape[0] > 0:
        w[step_memory_index(run) + K.since, lane] = BEGUN


@jit_uncounted
def enter_step_memory(run: Run, w: Floats, lane: int) -> int:
    """Write the step memory into a lane, ordered as `kernels.collocation.lengths`; return the index after it."""
    first, step_memory = step_memory_index(run), run.kept[0]
    if run.stages.shape[0] == 0:
        return first
    w[first + K.factored, lane], w[first + K.theta, lane], w[first + K.eta, lane] = (
        step_memory.factored,
        step_memory.theta,
        step_memory.eta,
    )
    w[first + K.before, lane], w[first + K.norm_before, lane] = step_memory.step, step_memory.norm
    w[first + K.linearised, lane], w[first + K.fresh, lane] = float(step_memory.linearised), float(step_memory.fresh)
    w[first + K.since, lane], w[first + K.turns, lane] = float(step_memory.since), float(step_memory.turns)
    w[first + K.iterations, lane] = w[first + K.evaluations, lane] = 0.0
    w[first + K.jacobians, lane] = w[first + K.factorisations, lane] = 0.0
    first += OF_KEPT
    stages, matrix, size = run.stages.shape[0], run.matrix.shape[0], run.pivots.shape[0] // 6
    for k in range(run.entries.shape[0]):
        w[first + k, lane] = run.w[stages + k]
    first += run.entries.shape[0]
    for i in range(stages):
        w[first + i, lane], w[first + stages + i, lane] = run.stages[i], run.past[i]
    first += 2 * stages
    for i in range(matrix):
        w[first + i, lane] = run.matrix[i]
    for k in range(size):
        w[first + matrix + k, lane] = float(run.pivots[k])
        w[first + matrix + size + k, lane] = float(run.pivots[3 * size + k])
    return first + matrix + 2 * size + stages + step_number_count(run)


@jit_uncounted
def leave_step_memory(run: Run, w: Floats, lane: int, accepted: int, rejected: int) -> int:
    """Read the step memory out of a lane, with its counts; return the index after it."""
    first, step_memory, now = step_memory_index(run), run.kept[0], run.now[0]
    if run.stages.shape[0] == 0:
        now.evaluations += run.plan[0].stages * (accepted + rejected)
        if accepted > 0:
            step_memory.since, run.trial[0].iterations = MOVED, 0
        return first
    step_memory.factored, step_memory.theta, step_memory.eta = (
        w[first + K.factored, lane],
        w[first + K.theta, lane],
        w[first + K.eta, lane],
    )
    step_memory.step, step_memory.norm = w[first + K.before, lane], w[first + K.norm_before, lane]
    step_memory.linearised, step_memory.fresh = (
        np.int64(w[first + K.linearised, lane]),
        np.int64(w[first + K.fresh, lane]),
    )
    step_memory.since, step_memory.turns = np.int64(w[first + K.since, lane]), np.int64(w[first + K.turns, lane])
    run.trial[0].iterations = np.int64(w[first + K.iterations, lane])
    now.evaluations += np.int64(w[first + K.evaluations, lane])
    now.jacobians += np.int64(w[first + K.jacobians, lane])
    now.factorisations += np.int64(w[first + K.factorisations, lane])
    first += OF_KEPT
    stages, matrix, size = run.stages.shape[0], run.matrix.shape[0], run.pivots.shape[0] // 6
    for k in range(run.entries.shape[0]):
        run.w[stages + k] = w[first + k, lane]
    first += run.entries.shape[0]
    for i in range(stages):
        run.stages[i], run.past[i] = w[first + i, lane], w[first + stages + i, lane]
    first += 2 * stages
    for i in range(matrix):
        run.matrix[i] = w[first + i, lane]
    for k in range(size):
        run.pivots[k] = np.int64(w[first + matrix + k, lane])
        run.pivots[3 * size + k] = np.int64(w[first + matrix + size + k, lane])
    note_extents(run.matrix, run.pivots, size, REAL)
    note_extents(run.matrix, run.pivots, size, COMPLEX)
    return first + matrix + 2 * size + stages + step_number_count(run)
