"""Forces, or impulses, of many links together: equations W x = b, and complementarity 0 <= W x - b, 0 <= x.

W is the effect of each link on each, scaled so that every link answers itself with one; it is never formed. Equations
are solved by conjugate residuals (Saad, Iterative Methods for Sparse Linear Systems, 2nd ed., 2003, algorithm 6.20),
whose residual never grows; where links hold more than needs holding, the solution from zero on is that of least norm.
The complementarity problem is that of a quadratic function on x >= 0, solved by modified proportioning with reduced
gradient projections (Dostal, Schoeberl, Comput. Optim. Appl. 30, 2005, 23, doi:10.1007/s10589-005-4557-7); with
friction each unknown has a greatest value, too.

Equations of a few links are a dense matrix, eliminated with the largest pivot of each column. Iterations need about as
many products with the matrix as there are forces, and generalised residuals as many directions, each made to differ
from all before; up to some hundred forces elimination is several times as fast (Golub, Van Loan, Matrix Computations,
4th ed., 2013, section 3.4). Where links hold more than needs holding a pivot vanishes. Its unknown is put last; of what
is left in the end the largest entry is the pivot, until that is zero: what a solution may have added to it, the null
space, is taken from it, which leaves that of least norm (section 5.5). Whether it is one of all equations, those that
depend on others too, the residual tells.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import ROWS
from xdynamics.march.assembly.closed_links import (
    IMAGE,
    LEAST,
    MOST,
    RATIO,
    RESIDUE,
    RIGHT,
    SCALE,
    WAY,
    WAY_IMAGE,
    X,
    clear_responses,
    respond,
    response_along,
)
from xdynamics.march.force_evaluation import nan_maximum
from xdynamics.march.run import Run

VANISHING = 1e-9  # of the largest entry: a pivot of links that hold more than needs holding
DEPENDENT = 1e-12  # of that entry: all that is left of equations that depend on others
# columns of `problem` behind n unknowns: the order of equations, that of unknowns, the rank, and the null space
EQUATIONS, UNKNOWNS, RANK, NULL = range(4)


@jit_separate
def eliminate(run: Run, first: int, rows: int, max_equations: int, drags: bool) -> int:
    """Eliminate the equations of rows that hold, perhaps with drags of links that press; return how many, 0 if not solvable.

    The rows are in `basis`, in the order of unknowns; in `problem` the factors, with the order of equations behind them.
    """
    n = 0
    for row in range(first, first + rows):
        if run.vectors[SCALE, row] > 0.0:
            if n >= max_equations or n >= run.problem.shape[0]:
                return 0
            run.basis[n] = row
            n += 1
    largest = pose_equations(run, first, rows, n, drags)
    rank = factor_rows(run, n, VANISHING * largest)
    if rank == n:
        return n
    return n if factor_dependent(run, n, rank, DEPENDENT * largest) else 0


@jit_separate
def pose_equations(run: Run, first: int, rows: int, n: int, drags: bool) -> float:
    """Write down the matrix of n equations, in their own order; return its largest entry."""
    largest, width, offset = 0.0, run.coordinate_indices.shape[1], run.swing.shape[0]
    clear_responses(run, first, rows)
    chain_rows(run, n)
    for i in range(n):
        for j in range(n):
            run.problem[i, j] = 0.0
        run.problem[i, n + EQUATIONS], run.problem[i, n + UNKNOWNS], run.problem[i, n + RANK] = i, i, n
    for j in range(n):
        row = run.basis[j]
        respond(run, row, run.vectors[SCALE, row])
        if drags and (row - first) % 2 == 0 and run.vectors[RATIO, row + 1] != 0.0:
            respond(run, row + 1, run.vectors[RATIO, row + 1] * run.vectors[SCALE, row])
        for k in range(width):
            entry_index = (
                run.chains[run.coordinate_indices[row, k]] if run.swing[run.coordinate_indices[row, k]] != 0.0 else 0
            )
            while entry_index > 0:
                i = (entry_index - offset) // width
                run.problem[i, j] = response_along(run, run.basis[i]) * run.vectors[SCALE, run.basis[i]]
                largest = max(largest, abs(run.problem[i, j]))
                entry_index = run.chains[entry_index]
        # one row is enough, as both rows of a link read the same coordinates
        clear_responses(run, row, 1)
    return largest


@jit_separate
def chain_rows(run: Run, n: int) -> None:
    """Chain the rows of n equations that read a common coordinate: most of a heap's links have none in common.

    `chains` has, for each coordinate, the place of the first entry of a row that reads it, and for each entry the next.
    """
    width, offset = run.coordinate_indices.shape[1], run.swing.shape[0]
    for coordinate in range(offset):
        run.chains[coordinate] = 0
    for i in range(n):
        for k in range(width):
            if run.normals[run.basis[i], k] != 0.0:
                coordinate, entry_index = run.coordinate_indices[run.basis[i], k], offset + i * width + k
                run.chains[entry_index], run.chains[coordinate] = run.chains[coordinate], entry_index


@jit_separate
def factor_rows(run: Run, n: int, smallest_pivot: float) -> int:
    """Factor the matrix by rows; unknowns with too small pivots go last. Return the number of the others."""
    k, last = 0, n
    while k < last:
        best = k
        for i in range(k + 1, n):
            best = i if abs(run.problem[i, k]) > abs(run.problem[best, k]) else best
        if abs(run.problem[best, k]) > smallest_pivot:
            exchange_rows(run, n, k, best)
            reduce_rows(run, n, k)
            k += 1
        else:
            last -= 1
            exchange_columns(run, n, k, last)
    return k


@jit_separate
def exchange_rows(run: Run, n: int, k: int, second_row: int) -> None:
    """Exchange two equations."""
    # one column more, which has the order of equations
    for j in range(n + 1 if second_row != k else 0):
        run.problem[k, j], run.problem[second_row, j] = run.problem[second_row, j], run.problem[k, j]


@jit_separate
def reduce_rows(run: Run, n: int, k: int) -> None:
    """Eliminate an unknown from all later equations."""
    for i in range(k + 1, n):
        if run.problem[i, k] != 0.0:
            share = run.problem[i, k] / run.problem[k, k]
            run.problem[i, k] = share
            for j in range(k + 1, n):
                run.problem[i, j] -= share * run.problem[k, j]


@jit_separate
def factor_dependent(run: Run, n: int, done: int, smallest_pivot: float) -> bool:
    """Factor the rest with complete pivoting, and compute the null space; whether most equations are independent."""
    rank = n
    for k in range(done, n):
        row, column = k, k
        for i in range(k, n):
            for j in range(k, n):
                if abs(run.problem[i, j]) > abs(run.problem[row, column]):
                    row, column = i, j
        if not abs(run.problem[row, column]) > smallest_pivot:
            rank = k
            break
        exchange_rows(run, n, k, row)
        exchange_columns(run, n, k, column)
        reduce_rows(run, n, k)
    if not 2 * rank > n:
        return False
    for i in range(n):
        run.problem[i, n + RANK] = rank
    for j in range(n - rank):
        note_null_vector(run, n, rank, j)
    return True


@jit_separate
def exchange_columns(run: Run, n: int, k: int, second_column: int) -> None:
    """Exchange two unknowns."""
    for i in range(n if second_column != k else 0):
        run.problem[i, k], run.problem[i, second_column] = run.problem[i, second_column], run.problem[i, k]
    order = n + UNKNOWNS
    run.problem[k, order], run.problem[second_column, order] = run.problem[second_column, order], run.problem[k, order]


@jit_separate
def note_null_vector(run: Run, n: int, rank: int, j: int) -> None:
    """Store one vector of the null space, in the unknowns' own order, orthogonal to those before."""
    target, order = n + NULL + j, n + UNKNOWNS
    for i in range(n):
        run.problem[i, target] = 0.0
    for i in range(rank - 1, -1, -1):
        total = -run.problem[i, rank + j]
        for k in range(i + 1, rank):
            total -= run.problem[i, k] * run.solution[k]
        run.solution[i] = total / run.problem[i, i]
        run.problem[int(run.problem[i, order]), target] = run.solution[i]
    run.problem[int(run.problem[rank + j, order]), target] = 1.0
    for k in range(n + NULL, target):
        overlap = 0.0
        for i in range(n):
            overlap += run.problem[i, k] * run.problem[i, target]
        for i in range(n):
            run.problem[i, target] -= overlap * run.problem[i, k]
    size = 0.0
    for i in range(n):
        size += run.problem[i, target] * run.problem[i, target]
    for i in range(n):
        run.problem[i, target] /= sqrt(size)


@jit_separate
def is_dependent(run: Run, n: int) -> bool:
    """Whether some of the equations that were eliminated depend on others."""
    return bool(n > 0 and run.problem[0, n + RANK] < n)


@jit_separate
def add_solution(run: Run, n: int, residual: int, target: int) -> None:
    """Add to a vector the correction of a residual by the factors of n equations, of least norm."""
    rank, order = int(run.problem[0, n + RANK]), n + UNKNOWNS
    for i in range(rank):
        total = run.vectors[residual, run.basis[int(run.problem[i, n + EQUATIONS])]]
        for j in range(i):
            total -= run.problem[i, j] * run.solution[j]
        run.solution[i] = total
    for i in range(rank - 1, -1, -1):
        total = run.solution[i]
        for j in range(i + 1, rank):
            total -= run.problem[i, j] * run.solution[j]
        run.solution[i] = total / run.problem[i, i]
    for i in range(rank):
        run.vectors[target, run.basis[int(run.problem[i, order])]] += run.solution[i]
    for k in range(n + NULL, n + NULL + n - rank):
        overlap = 0.0
        for i in range(n):
            overlap += run.problem[i, k] * run.vectors[target, run.basis[i]]
        for i in range(n):
            run.vectors[target, run.basis[i]] -= overlap * run.problem[i, k]


ENOUGH = 16.0 * EPS  # of the size of the terms: residual at which iterations end
ALLOWED = 1e-9  # of that size: a larger residual ends the run
MOST_RESTARTS = 4
LEAST_TURNS = 50
MOST_AT_ONCE = 256  # equations of links with friction that elimination solves sooner than iterations
MOST_TURNS = 100  # for each unknown


@jit_separate
def apply_link_effects(run: Run, source: int, target: int, first: int, count: int) -> None:
    """Apply W to a vector."""
    clear_responses(run, first, count)
    for a in range(first, first + count):
        respond(run, a, run.vectors[source, a] * run.vectors[SCALE, a])
    for a in range(first, first + count):
        run.vectors[target, a] = response_along(run, a) * run.vectors[SCALE, a]


@jit_separate
def scalar_product(run: Run, left_vector: int, right_vector: int, first: int, count: int) -> float:
    """The scalar product of two vectors."""
    total = 0.0
    for a in range(first, first + count):
        total += run.vectors[left_vector, a] * run.vectors[right_vector, a]
    return total


@jit_separate
def largest_entry(run: Run, vector: int, first: int, count: int) -> float:
    """The largest absolute value in a vector; nan where one is."""
    maximum = 0.0
    for a in range(first, first + count):
        value = abs(run.vectors[vector, a])
        maximum = nan_maximum(maximum, value)
    return maximum


@jit_separate
def solve_equations(run: Run, first: int, count: int) -> float:
    """Solve W x = b; return the residual over the size of the terms."""
    for a in range(first, first + count):
        run.vectors[X, a] = 0.0
    right_size = largest_entry(run, RIGHT, first, count)
    if right_size == 0.0:
        for a in range(first, first + count):
            run.vectors[RESIDUE, a] = 0.0
        return 0.0
    n = eliminate(run, first, count, MOST_AT_ONCE, False) if run.counters[ROWS] == 2 else 0
    left = refine_solution(run, n, right_size, first, count)
    if is_dependent(run, n) and not left <= 8.0 * ENOUGH:
        for a in range(first, first + count):
            run.vectors[X, a] = 0.0
        left = refine_solution(run, 0, right_size, first, count)
    return left


@jit_separate
def refine_solution(run: Run, n: int, right_size: float, first: int, count: int) -> float:
    """Solve by factors of n equations, or else by iterations; return the residual over the size of the terms."""
    best = inf
    for _ in range(MOST_RESTARTS):
        apply_link_effects(run, X, RESIDUE, first, count)
        for a in range(first, first + count):
            run.vectors[RESIDUE, a] = run.vectors[RIGHT, a] - run.vectors[RESIDUE, a]
        size = max(right_size, largest_entry(run, X, first, count))
        share = largest_entry(run, RESIDUE, first, count) / size
        if share <= ENOUGH or not share < best / 2.0:
            return min(share, best)
        best = share
        if n > 0:
            add_solution(run, n, RESIDUE, X)
        else:
            reduce_residual(run, ENOUGH * size, first, count)
    return best


@jit_separate
def reduce_residual(run: Run, enough: float, first: int, count: int) -> None:
    """Improve the solution by conjugate residuals, from the residual on."""
    apply_link_effects(run, RESIDUE, IMAGE, first, count)
    for a in range(first, first + count):
        run.vectors[WAY, a], run.vectors[WAY_IMAGE, a] = run.vectors[RESIDUE, a], run.vectors[IMAGE, a]
    energy = scalar_product(run, RESIDUE, IMAGE, first, count)
    for _ in range(2 * count + LEAST_TURNS):
        bent = scalar_product(run, WAY_IMAGE, WAY_IMAGE, first, count)
        # negated, so that nan ends it
        if not (energy > 0.0 and bent > 0.0):
            return
        length = energy / bent
        for a in range(first, first + count):
            run.vectors[X, a] += length * run.vectors[WAY, a]
            run.vectors[RESIDUE, a] -= length * run.vectors[WAY_IMAGE, a]
        if largest_entry(run, RESIDUE, first, count) <= enough / 4.0:
            return
        apply_link_effects(run, RESIDUE, IMAGE, first, count)
        energy_before, energy = energy, scalar_product(run, RESIDUE, IMAGE, first, count)
        for a in range(first, first + count):
            run.vectors[WAY, a] = run.vectors[RESIDUE, a] + energy / energy_before * run.vectors[WAY, a]
            run.vectors[WAY_IMAGE, a] = run.vectors[IMAGE, a] + energy / energy_before * run.vectors[WAY_IMAGE, a]


@jit_separate
def solve_unilateral(run: Run, first: int, count: int) -> float:
    """Solve 0 <= x, 0 <= W x - b, one by one not both positive; return the residual over the size of the terms.

    The gradient W x - b is in `RESIDUE` afterwards.
    """
    for a in range(first, first + count):
        run.vectors[LEAST, a], run.vectors[MOST, a] = 0.0, inf
        run.vectors[X, a] = 0.0
    return solve_bounded(run, first, count)


@jit_separate
def solve_bounded(run: Run, first: int, count: int) -> float:
    """Solve W x = b where bounds do not hinder it, from an x within bounds on; return the residual, as above."""
    # row sums bound the spectral norm of the symmetric W; projected steps below 2 over that always descend
    right_size, step, restarts = largest_entry(run, RIGHT, first, count), 1.0 / greatest_answer(run, first, count), 0
    renew_gradient(run, first, count)
    for _ in range(MOST_TURNS * (count + LEAST_TURNS)):
        share = gradient_violation(run, first, count)
        if share <= ENOUGH * max(right_size, largest_entry(run, X, first, count)):
            # the gradient carried along has gathered rounding: the true one decides
            renew_gradient(run, first, count)
            share = gradient_violation(run, first, count)
            restarts += 1
            if share <= ENOUGH * max(right_size, largest_entry(run, X, first, count)) or restarts > MOST_RESTARTS:
                break
        if not is_proportional(run, step, first, count):
            release_from_bounds(run, first, count)
        elif not follow_way(run, step, first, count):
            break
    renew_gradient(run, first, count)
    share = gradient_violation(run, first, count)
    return share / max(right_size, largest_entry(run, X, first, count)) if share > 0.0 else 0.0


@jit_separate
def greatest_answer(run: Run, first: int, count: int) -> float:
    """An upper bound of the norm of W: the largest sum of absolute values in a row."""
    clear_responses(run, first, count)
    for a in range(first, first + count):
        for i in range(run.coordinate_indices.shape[1]):
            run.swing[run.coordinate_indices[a, i]] += abs(run.unit_responses[a, i]) * run.vectors[SCALE, a]
    maximum = 1.0
    for a in range(first, first + count):
        total = 0.0
        for i in range(run.coordinate_indices.shape[1]):
            total += abs(run.normals[a, i]) * run.swing[run.coordinate_indices[a, i]]
        maximum = max(maximum, total * run.vectors[SCALE, a])
    return maximum


@jit_separate
def free_gradient(run: Run, a: int) -> float:
    """The gradient along an unknown that is not at its bound."""
    return run.vectors[RESIDUE, a] if run.vectors[LEAST, a] < run.vectors[X, a] < run.vectors[MOST, a] else 0.0


@jit_separate
def bound_gradient(run: Run, a: int) -> float:
    """The gradient along an unknown that is at its bound, if it is to leave it."""
    lower_bound, upper_bound = run.vectors[LEAST, a], run.vectors[MOST, a]
    if lower_bound == upper_bound:
        return 0.0
    if run.vectors[X, a] == lower_bound:
        return min(run.vectors[RESIDUE, a], 0.0)
    return max(run.vectors[RESIDUE, a], 0.0) if run.vectors[X, a] == upper_bound else 0.0


@jit_separate
def gradient_violation(run: Run, first: int, count: int) -> float:
    """The largest gradient that is not zero as it should be; nan where one is."""
    maximum = 0.0
    for a in range(first, first + count):
        value = abs(free_gradient(run, a) + bound_gradient(run, a))
        maximum = nan_maximum(maximum, value)
    return maximum


@jit_separate
def renew_gradient(run: Run, first: int, count: int) -> None:
    """Compute the gradient, and begin a new way."""
    apply_link_effects(run, X, RESIDUE, first, count)
    for a in range(first, first + count):
        run.vectors[RESIDUE, a] -= run.vectors[RIGHT, a]
    begin_way(run, first, count)


@jit_separate
def begin_way(run: Run, first: int, count: int) -> None:
    """Set the search direction to the free gradient."""
    for a in range(first, first + count):
        run.vectors[WAY, a] = free_gradient(run, a)


@jit_separate
def is_proportional(run: Run, step: float, first: int, count: int) -> bool:
    """Whether more is to be gained from unknowns off their bounds than from those at them."""
    free, bound = 0.0, 0.0
    for a in range(first, first + count):
        free_slope, bound_slope = free_gradient(run, a), bound_gradient(run, a)
        low, high = run.vectors[LEAST, a] - run.vectors[X, a], run.vectors[MOST, a] - run.vectors[X, a]
        free += free_slope * (min(-low / step, free_slope) if free_slope > 0.0 else max(-high / step, free_slope))
        bound += bound_slope * bound_slope
    return bound <= free


@jit_separate
def release_from_bounds(run: Run, first: int, count: int) -> None:
    """Go along the gradient of unknowns that are to leave their bounds, as far as it falls."""
    for a in range(first, first + count):
        run.vectors[WAY, a] = bound_gradient(run, a)
    apply_link_effects(run, WAY, IMAGE, first, count)
    curve = scalar_product(run, WAY, IMAGE, first, count)
    length = scalar_product(run, WAY, WAY, first, count) / curve if curve > 0.0 else 1.0
    length = min(length, way_to_bounds(run, first, count))
    for a in range(first, first + count):
        new_value = run.vectors[X, a] - length * run.vectors[WAY, a]
        run.vectors[X, a] = min(max(run.vectors[LEAST, a], new_value), run.vectors[MOST, a])
        run.vectors[RESIDUE, a] -= length * run.vectors[IMAGE, a]
    begin_way(run, first, count)


@jit_separate
def way_to_bounds(run: Run, first: int, count: int) -> float:
    """How far an unknown may go along the way until the first of them is at a bound."""
    longest = inf
    for a in range(first, first + count):
        if run.vectors[WAY, a] > 0.0:
            longest = min(longest, (run.vectors[X, a] - run.vectors[LEAST, a]) / run.vectors[WAY, a])
        elif run.vectors[WAY, a] < 0.0:
            longest = min(longest, (run.vectors[X, a] - run.vectors[MOST, a]) / run.vectors[WAY, a])
    return longest


@jit_separate
def follow_way(run: Run, step: float, first: int, count: int) -> bool:
    """Make a step of conjugate gradients, or to the first bound and along the free gradient; whether there is one."""
    apply_link_effects(run, WAY, IMAGE, first, count)
    curve, longest = scalar_product(run, WAY, IMAGE, first, count), way_to_bounds(run, first, count)
    # negated, so that a curvature of nan ends the search as well
    if not curve > 0.0:
        return False
    length = scalar_product(run, RESIDUE, WAY, first, count) / curve
    for a in range(first, first + count):
        run.vectors[X, a] -= min(length, longest) * run.vectors[WAY, a]
        run.vectors[RESIDUE, a] -= min(length, longest) * run.vectors[IMAGE, a]
    if length > longest:
        for a in range(first, first + count):
            new_value = run.vectors[X, a] - step * free_gradient(run, a)
            run.vectors[X, a] = min(max(run.vectors[LEAST, a], new_value), run.vectors[MOST, a])
        renew_gradient(run, first, count)
        return True
    conjugate_part = 0.0
    for a in range(first, first + count):
        conjugate_part += free_gradient(run, a) * run.vectors[IMAGE, a]
    for a in range(first, first + count):
        run.vectors[WAY, a] = free_gradient(run, a) - conjugate_part / curve * run.vectors[WAY, a]
    return True
