"""Equations of a few links at once: a dense matrix, eliminated with the largest pivot of each column.

Iterations need about as many products with the matrix as there are forces, and generalised residuals as many directions,
each made to differ from all before; up to some hundred forces elimination is several times as fast (Golub, Van Loan,
Matrix Computations, 4th ed., 2013, section 3.4). Where links hold more than needs holding a pivot vanishes, and there is
no solution of that kind: iterations then find that of least norm.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.closed_links import RATIO, SCALE
from xdynamics.march.assembly.responses import clear, respond, response_along
from xdynamics.march.run import Run

VANISHING = 1e-9  # of the largest entry: a pivot of links that hold more than needs holding


@shared
def eliminate(run: Run, first: int, rows: int, most: int, drags: bool) -> int:
    """Eliminate the equations of rows that hold, perhaps with drags of links that press; return how many, 0 if not solvable.

    The rows are in `basis`, in the order of unknowns; in `problem` the factors, with the order of equations behind them.
    """
    n, largest = 0, 0.0
    for row in range(first, first + rows):
        if run.vectors[SCALE, row] > 0.0:
            if n >= most or n >= run.basis.shape[0]:
                return 0
            run.basis[n] = row
            n += 1
    clear(run, first, rows)
    for j in range(n):
        row = run.basis[j]
        respond(run, row, run.vectors[SCALE, row])
        if drags and (row - first) % 2 == 0 and run.vectors[RATIO, row + 1] != 0.0:
            respond(run, row + 1, run.vectors[RATIO, row + 1] * run.vectors[SCALE, row])
        for i in range(n):
            run.problem[i, j] = response_along(run, run.basis[i]) * run.vectors[SCALE, run.basis[i]]
            largest = max(largest, abs(run.problem[i, j]))
        clear(run, row, 1)
    for i in range(n):
        run.problem[i, n] = i
    return n if factor(run, n, VANISHING * largest) else 0


@shared
def factor(run: Run, n: int, least: float) -> bool:
    """Factor the matrix by rows; whether no pivot is below the least."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            best = i if abs(run.problem[i, k]) > abs(run.problem[best, k]) else best
        if not abs(run.problem[best, k]) > least:
            return False
        for j in range(n + 1 if best != k else 0):
            run.problem[k, j], run.problem[best, j] = run.problem[best, j], run.problem[k, j]
        for i in range(k + 1, n):
            if run.problem[i, k] != 0.0:
                share = run.problem[i, k] / run.problem[k, k]
                run.problem[i, k] = share
                for j in range(k + 1, n):
                    run.problem[i, j] -= share * run.problem[k, j]
    return True


@shared
def add_solution(run: Run, n: int, residual: int, target: int) -> None:
    """Add to a vector what removes a residual, by the factors of n equations."""
    for i in range(n):
        total = run.vectors[residual, run.basis[int(run.problem[i, n])]]
        for j in range(i):
            total -= run.problem[i, j] * run.solution[j]
        run.solution[i] = total
    for i in range(n - 1, -1, -1):
        total = run.solution[i]
        for j in range(i + 1, n):
            total -= run.problem[i, j] * run.solution[j]
        run.solution[i] = total / run.problem[i, i]
    for i in range(n):
        run.vectors[target, run.basis[i]] += run.solution[i]
