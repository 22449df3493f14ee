"""Masses of coordinates, stiffened by links that press or hold: M + sum k a b^T over these, factored in a band.

There are as many equations as coordinates, however many links hold these. A heap's bodies touch few others: in the order of
Cuthill and McKee (Proc. 24th Nat. Conf. ACM, 1969, 157), reversed, the matrix is a band about as wide as the heap, and
groups of bodies that do not touch are parts of it by themselves. Where one link does something else, one product a b^T is
added to the factors as they are (Sherman, Morrison, Ann. Math. Stat. 21, 1950, 124, doi:10.1214/aoms/1177729893).
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import SCALE
from xdynamics.march.run import Run

WIDEST = 512  # entries of a row of the band up to its diagonal
# rows of `ordering`: the place of each coordinate, -1 where no link reads it, and before that whether it was met; the
# coordinate at each place, the first column of its row that has an entry, and the last row of its column
PLACE, COORDINATE, LOWEST, HIGHEST = range(4)
ORDERS = 4
MET, UNMET = -2, -1
MOST_CHANGES = 24  # products that are added to factors, before these are made anew
AT_ZERO, BY_T = (
    MOST_CHANGES,
    MOST_CHANGES + 1,
)  # rows of `changes` after them: solutions that are kept as factors change
CHANGED_LINK, ALONG_NORMAL, ALONG_SLIP, SHARE = range(4)  # columns of `changes`, before those of coordinates
CHANGE = 4
LEAST_SHARE = 1e-10  # of a pivot that is left by a product: below, too few digits are


@jit_separate
def order_coordinates(run: Run, first: int, rows: int) -> int:
    """Give coordinates that links read their places; return how many there are, 0 where the band would be too wide."""
    for coordinate in range(run.ordering.shape[1]):
        run.ordering[PLACE, coordinate] = UNMET
    chain_links(run, first, rows)
    n = 0
    for row in range(first, first + rows, 2):
        for i in range(run.coordinate_indices.shape[1]):
            coordinate = run.coordinate_indices[row, i]
            if reads_it(run, row, i) and run.ordering[PLACE, coordinate] == UNMET:
                end = follow_links(run, first, coordinate, n, UNMET)
                n = follow_links(run, first, run.ordering[COORDINATE, end - 1], n, MET)
    for k in range(n // 2):
        later_coordinate = run.ordering[COORDINATE, n - 1 - k]
        run.ordering[COORDINATE, n - 1 - k], run.ordering[COORDINATE, k] = run.ordering[COORDINATE, k], later_coordinate
    for k in range(n):
        run.ordering[PLACE, run.ordering[COORDINATE, k]] = k
        run.ordering[LOWEST, k], run.ordering[HIGHEST, k] = k, k
    return n if is_narrow(run, first, rows, n) else 0


@jit_separate
def reads_it(run: Run, row: int, i: int) -> bool:
    """Whether a link's rate, or its slip, depends on a coordinate that it reads."""
    presses = run.vectors[SCALE, row] > 0.0 and run.normals[row, i] != 0.0
    return bool(presses or (run.vectors[SCALE, row + 1] > 0.0 and run.normals[row + 1, i] != 0.0))


@jit_separate
def chain_links(run: Run, first: int, rows: int) -> None:
    """Chain the links that read a common coordinate: `chains` has the index of the first and each next entry."""
    width, offset = run.coordinate_indices.shape[1], run.swing.shape[0]
    for coordinate in range(offset):
        run.chains[coordinate] = 0
    for row in range(first, first + rows, 2):
        for i in range(width):
            if reads_it(run, row, i):
                coordinate, entry_index = run.coordinate_indices[row, i], offset + (row - first) // 2 * width + i
                run.chains[entry_index], run.chains[coordinate] = run.chains[coordinate], entry_index


@jit_separate
def follow_links(run: Run, first: int, start: int, n: int, mark_before: int) -> int:
    """List coordinates marked `mark_before` by distance from `start`, from index n on; return the list's end.

    Those that were unmet are met then: the last of them is at a far end, from which on those that were met are placed.
    """
    width, offset, done, end = run.coordinate_indices.shape[1], run.swing.shape[0], n, n + 1
    run.ordering[COORDINATE, n], run.ordering[PLACE, start] = start, MET if mark_before == UNMET else n
    while done < end:
        entry_index = run.chains[run.ordering[COORDINATE, done]]
        done += 1
        while entry_index > 0:
            row = first + 2 * ((entry_index - offset) // width)
            for i in range(width):
                coordinate = run.coordinate_indices[row, i]
                if run.ordering[PLACE, coordinate] == mark_before and reads_it(run, row, i):
                    run.ordering[COORDINATE, end] = coordinate
                    run.ordering[PLACE, coordinate] = MET if mark_before == UNMET else end
                    end += 1
            entry_index = run.chains[entry_index]
    return end


@jit_separate
def is_narrow(run: Run, first: int, rows: int, n: int) -> bool:
    """Find where rows of the matrix begin and columns end; whether there is room for all."""
    widest = 0
    for row in range(first, first + rows, 2):
        for i in range(run.coordinate_indices.shape[1]):
            for j in range(run.coordinate_indices.shape[1] if reads_it(run, row, i) else 0):
                if reads_it(run, row, j):
                    row_position, column_position = (
                        run.ordering[PLACE, run.coordinate_indices[row, i]],
                        run.ordering[PLACE, run.coordinate_indices[row, j]],
                    )
                    run.ordering[LOWEST, row_position] = min(run.ordering[LOWEST, row_position], column_position)
                    widest = max(widest, row_position - column_position)
    for k in range(n):
        lowest = run.ordering[LOWEST, k]
        run.ordering[HIGHEST, lowest] = max(run.ordering[HIGHEST, lowest], k)
    for k in range(1, n):
        run.ordering[HIGHEST, k] = max(run.ordering[HIGHEST, k], run.ordering[HIGHEST, k - 1])
    return bool(widest <= middle_of(run))


@jit_separate
def middle_of(run: Run) -> int:
    """The index of the diagonal in a row of the band."""
    return int((run.stiffened.shape[1] - 1) // 2)


@jit_separate
def pose_masses(run: Run, first: int, rows: int, n: int) -> None:
    """Write down the matrix of n coordinates without links."""
    middle = middle_of(run)
    for k in range(n):
        for j in range(run.ordering[LOWEST, k], run.ordering[HIGHEST, k] + 1):
            run.stiffened[k, middle - k + j] = 0.0
    for row in range(first, first + rows):
        for i in range(run.coordinate_indices.shape[1] if run.vectors[SCALE, row] > 0.0 else 0):
            if run.normals[row, i] != 0.0:
                # masses are diagonal here: a response is the direction over the mass
                mass = run.normals[row, i] / run.unit_responses[row, i]
                run.stiffened[run.ordering[PLACE, run.coordinate_indices[row, i]], middle] = mass


@jit_separate
def add_product(run: Run, row: int, left: float, left_slip: float, right: float, right_slip: float) -> None:
    """Add to the matrix a product of two sums of a link's directions, each along its normal and along its slip."""
    middle = middle_of(run)
    for i in range(run.coordinate_indices.shape[1]):
        share = left * run.normals[row, i] + left_slip * run.normals[row + 1, i]
        for j in range(run.coordinate_indices.shape[1] if share != 0.0 else 0):
            if reads_it(run, row, j):
                k, m = (
                    run.ordering[PLACE, run.coordinate_indices[row, i]],
                    run.ordering[PLACE, run.coordinate_indices[row, j]],
                )
                entry = right * run.normals[row, j] + right_slip * run.normals[row + 1, j]
                run.stiffened[k, middle - k + m] += share * entry


@jit_separate
def factor_band(run: Run, n: int) -> None:
    """Factor the matrix as L U in place, without pivoting; `swing` has a row of U."""
    # as names of their own: else each access would read anew where an array stands
    middle, stiffened, swing, ordering = middle_of(run), run.stiffened, run.swing, run.ordering
    for k in range(n):
        pivot, end = stiffened[k, middle], ordering[HIGHEST, k] + 1
        for j in range(k + 1, end):
            swing[j] = stiffened[k, middle - k + j]
        for i in range(k + 1, end):
            share = stiffened[i, middle - i + k] / pivot if ordering[LOWEST, i] <= k else 0.0
            if share != 0.0:
                for j in range(k + 1, end):
                    stiffened[i, middle - i + j] -= share * swing[j]
                stiffened[i, middle - i + k] = share


@jit_separate
def change_factors(
    run: Run, row: int, n: int, changes: int, left: float, left_slip: float, right: float, right_slip: float
) -> int:
    """Add a product a b^T beside the factors; return their number, `MOST_CHANGES` where too few digits are left."""
    for k in range(n):
        run.swing[run.ordering[COORDINATE, k]] = 0.0
    for i in range(run.coordinate_indices.shape[1]):
        run.swing[run.coordinate_indices[row, i]] += left * run.normals[row, i] + left_slip * run.normals[row + 1, i]
    solve_factors(run, n, changes)
    run.changes[changes, CHANGED_LINK] = row
    run.changes[changes, ALONG_NORMAL], run.changes[changes, ALONG_SLIP] = right, right_slip
    # Sherman and Morrison's divisor 1 + b^T A**-1 a: near zero the changed matrix is nearly singular
    left_over = 1.0 + along_change(run, changes)
    if not abs(left_over) > LEAST_SHARE:
        return MOST_CHANGES
    run.changes[changes, SHARE] = 1.0 / left_over
    for k in range(n):
        run.changes[changes, CHANGE + k] = run.solution[k]
    return changes + 1


@jit_separate
def keep_solution(run: Run, n: int, solved: int) -> None:
    """Store the last solution among `changes`."""
    for k in range(n):
        run.changes[solved, CHANGE + k] = run.solution[k]


@jit_separate
def recall_solution(run: Run, n: int, solved: int) -> None:
    """Put a stored solution in `solution`, and in `swing` by coordinates."""
    for k in range(n):
        run.solution[k] = run.changes[solved, CHANGE + k]
        run.swing[run.ordering[COORDINATE, k]] = run.solution[k]


@jit_separate
def change_solution(run: Run, n: int, change: int, solved: int, right: float) -> None:
    """Change a stored solution as the last product a b^T changes factors, and its right side by -`right` times a."""
    recall_solution(run, n, solved)
    share, changes = (along_change(run, change) + right) * run.changes[change, SHARE], run.changes
    for k in range(n):
        changes[solved, CHANGE + k] -= share * changes[change, CHANGE + k]


@jit_separate
def along_change(run: Run, change: int) -> float:
    """Return the solution along the right side of a product."""
    row, total = int(run.changes[change, CHANGED_LINK]), 0.0
    normal_part, slip_part = run.changes[change, ALONG_NORMAL], run.changes[change, ALONG_SLIP]
    for i in range(run.coordinate_indices.shape[1]):
        if reads_it(run, row, i):
            direction = normal_part * run.normals[row, i] + slip_part * run.normals[row + 1, i]
            total += direction * run.solution[run.ordering[PLACE, run.coordinate_indices[row, i]]]
    return float(total)


@jit_separate
def solve_factors(run: Run, n: int, changes: int) -> None:
    """Solve for changes of rates by the momenta in `swing`; the result is there and in `solution`."""
    middle, stiffened, solution, ordering = middle_of(run), run.stiffened, run.solution, run.ordering
    for k in range(n):
        total = run.swing[ordering[COORDINATE, k]]
        for j in range(ordering[LOWEST, k], k):
            total -= stiffened[k, middle - k + j] * solution[j]
        solution[k] = total
    for k in range(n - 1, -1, -1):
        total = solution[k]
        for j in range(k + 1, ordering[HIGHEST, k] + 1):
            total -= stiffened[k, middle - k + j] * solution[j]
        solution[k] = total / stiffened[k, middle]
    for change in range(changes):
        share, products = along_change(run, change) * run.changes[change, SHARE], run.changes
        for k in range(n):
            solution[k] -= share * products[change, CHANGE + k]
    for k in range(n):
        run.swing[ordering[COORDINATE, k]] = solution[k]
