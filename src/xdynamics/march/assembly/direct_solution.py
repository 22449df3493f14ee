"""Equations of a few links at once: a dense matrix, eliminated with the largest pivot of each column.

Iterations need about as many products with the matrix as there are forces, and generalised residuals as many directions,
each made to differ from all before; up to some hundred forces elimination is several times as fast (Golub, Van Loan,
Matrix Computations, 4th ed., 2013, section 3.4). Where links hold more than needs holding a pivot vanishes. Its unknown is
put last; of what is left in the end the largest entry is the pivot, until that is zero: what a solution may have added to it, the null space, is taken
from it, which leaves that of least norm (section 5.5). Whether it is one of all equations, those that depend on others too,
the residual tells.
"""

from __future__ import annotations

from math import sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import RATIO, SCALE
from xdynamics.march.assembly.responses import clear_responses, respond, response_along
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
        clear_responses(run, row, 1)
    return largest


@jit_separate
def chain_rows(run: Run, n: int) -> None:
    """Chain the rows of n equations that read the same coordinate: most of a heap's links have none in common.

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
    """Factor the matrix by rows, with unknowns that have no pivot above the least put last; return how many have one."""
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
    for j in range(n + 1 if second_row != k else 0):
        run.problem[k, j], run.problem[second_row, j] = run.problem[second_row, j], run.problem[k, j]


@jit_separate
def reduce_rows(run: Run, n: int, k: int) -> None:
    """Take an unknown out of all later equations."""
    for i in range(k + 1, n):
        if run.problem[i, k] != 0.0:
            share = run.problem[i, k] / run.problem[k, k]
            run.problem[i, k] = share
            for j in range(k + 1, n):
                run.problem[i, j] -= share * run.problem[k, j]


@jit_separate
def factor_dependent(run: Run, n: int, done: int, smallest_pivot: float) -> bool:
    """Factor what is left until nothing above the least is, and find the null space; whether most equations are independent."""
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
    """Note, in the unknowns' own order, one vector of what a solution may have added to it, orthogonal to those before."""
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
    """Add to a vector what removes a residual, by the factors of n equations, and leave it the one of least norm."""
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
