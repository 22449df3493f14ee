"""Linear complementarity problems: w = M z + q with w and z non-negative and, one by one, not both positive.

Lemke's method, with ties broken lexicographically so that it cannot circle (Cottle, Pang, Stone, The Linear
Complementarity Problem, 1992, section 4.4). It finds a solution where M is copositive-plus and there is one, as in
impacts and contacts with Coulomb's friction; where it ends on a ray, it has found none.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.run import Run

SMALL = 1e-12  # relative to the numbers compared: as good as zero
MOST_TURNS = 50  # exchanges for each unknown


@jit_separate
def clear_tableau(run: Run, n: int) -> None:
    """Clear the tableau of a problem of size n: columns n and on, of z, of the artificial unknown, and q.

    Unknowns are numbered: w from 0, z from n, then the artificial one. Only those that are not in the basis have a column,
    at first their own; what leaves the basis takes that of what enters. Behind the basis stands where each of them is: in
    a column, or in the basis, -1.
    """
    for i in range(n):
        run.basis[i] = i
        for j in range(n, 2 * n + 2):
            run.problem[i, j] = 0.0
        run.problem[i, 2 * n] = -1.0
    for unknown in range(2 * n + 1):
        run.basis[n + unknown] = unknown if unknown >= n else -1


@jit_separate
def solve_complementarity(run: Run, n: int) -> bool:
    """Solve the problem of size n that is in `problem` as w - M z - z0 = q; fill `solution` with z.

    Returns
    -------
    bool
        False where the method ends on a ray, or takes too long.
    """
    for i in range(n):
        run.solution[i] = 0.0
    worst = 0
    for i in range(n):
        worst = i if run.problem[i, 2 * n + 1] < run.problem[worst, 2 * n + 1] else worst
    if n == 0 or run.problem[worst, 2 * n + 1] >= 0.0:
        return True
    entering = 2 * n
    row = worst
    for _ in range(MOST_TURNS * n):
        leaving = run.basis[row]
        exchange(run, n, row, entering)
        if leaving == 2 * n:
            take_solution(run, n)
            return True
        entering = leaving + n if leaving < n else leaving - n
        row = least_ratio(run, n, entering)
        if row < 0:
            return False
    return False


@jit_separate
def exchange(run: Run, n: int, row: int, entering: int) -> None:
    """Solve a row for an unknown, and substitute it into the others."""
    column, leaving = run.basis[n + entering], run.basis[row]
    run.basis[row], run.basis[n + entering], run.basis[n + leaving] = entering, -1, column
    pivot = run.problem[row, column]
    run.problem[row, column] = 1.0
    for j in range(n, 2 * n + 2):
        run.problem[row, j] /= pivot
    for i in range(n):
        factor = run.problem[i, column]
        if i != row:
            run.problem[i, column] = 0.0
        if i != row and factor != 0.0:
            for j in range(n, 2 * n + 2):
                run.problem[i, j] -= factor * run.problem[row, j]


@jit_separate
def entry_of(run: Run, n: int, row: int, unknown: int) -> float:
    """An entry of the tableau, of unknowns in the basis, too."""
    column = run.basis[n + unknown]
    if column >= 0:
        return float(run.problem[row, column])
    return 1.0 if run.basis[row] == unknown else 0.0


@jit_separate
def least_ratio(run: Run, n: int, entering: int) -> int:
    """Choose the row that limits a growing unknown: that of the artificial one if possible, -1 if none does."""
    largest, best, column = 0.0, -1, run.basis[n + entering]
    for i in range(n):
        largest = max(largest, abs(run.problem[i, column]))
    for i in range(n):
        if run.problem[i, column] > SMALL * largest and (best < 0 or limits_before(run, n, i, best, column)):
            best = i
    return best


@jit_separate
def limits_before(run: Run, n: int, first_row: int, second_row: int, column: int) -> bool:
    """Whether one row limits the unknown that enters, of a column, earlier than another."""
    pivot, second_pivot, q = run.problem[first_row, column], run.problem[second_row, column], 2 * n + 1
    for k in range(n + 1):
        left = (run.problem[first_row, q] if k == 0 else entry_of(run, n, first_row, k - 1)) / pivot
        right = (run.problem[second_row, q] if k == 0 else entry_of(run, n, second_row, k - 1)) / second_pivot
        if abs(left - right) > SMALL * max(abs(left), abs(right)):
            return bool(left < right)
        if k == 0 and (run.basis[first_row] == 2 * n or run.basis[second_row] == 2 * n):
            return bool(run.basis[first_row] == 2 * n)
    return False


@jit_separate
def take_solution(run: Run, n: int) -> None:
    """Read the unknowns z that are in the basis."""
    for i in range(n):
        if n <= run.basis[i] < 2 * n:
            run.solution[run.basis[i] - n] = max(0.0, run.problem[i, 2 * n + 1])
