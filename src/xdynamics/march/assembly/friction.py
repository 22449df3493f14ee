"""Coulomb's friction of many links: a force along each slip, at most a fraction of that link's normal force.

A link that grips has any force within its bounds and no slip, or that at a bound, against the slip; one that slides has
that of its sliding. One link is solved for after the other (nonlinear block Gauss-Seidel, M. Jean, Comput. Methods
Appl. Mech. Eng. 177, 1999, 235): each exactly, with the forces or impulses of all others as they are; a turn costs as
much as one product with W. Now and then all links are solved for that seem to press, to hold and to slide.

Where that does not settle, as with masses that differ by many powers of ten, normal forces are solved for with bounds
as they are, then bounds are made anew, until nothing changes (Necas, Jarusek, Haslinger, Boll. Un. Mat. Ital. B 17,
1980, 796; Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008, section 13.7).

The equations of all links that hold, where others drag as their links press, are solved at once. They are not
symmetric, as a drag is a share of another force. Generalised conjugate residuals (Eisenstat, Elman, Schultz, SIAM J.
Numer. Anal. 20, 1983, 345) need as many directions as there are forces at most, and a few at a time.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.banded_factors import order_coordinates
from xdynamics.march.assembly.broad_phase import ROWS
from xdynamics.march.assembly.closed_links import (
    AMISS,
    DRAG,
    GIVEN,
    GRIP,
    IMAGE,
    LEAST,
    LOAD,
    MOST,
    OWN_SCALE,
    RATIO,
    RESIDUE,
    RETURNED,
    RIGHT,
    SCALE,
    TRIED,
    TRIED_WAY,
    X,
    clear_responses,
    closed_from,
    respond,
    response_along,
    rows_of_closed,
)
from xdynamics.march.assembly.lemke_path import (
    GIVES,
    GIVES_AT_FIRST,
    GIVES_LESS,
    GIVES_MORE,
    follow_from_far,
    follow_from_near,
    solve_by_pivots,
)
from xdynamics.march.assembly.normal_forces import (
    ALLOWED,
    ENOUGH,
    MOST_RESTARTS,
    add_solution,
    apply_link_effects,
    eliminate,
    is_dependent,
    largest_entry,
    solve_bounded,
    solve_equations,
    solve_unilateral,
)
from xdynamics.march.force_evaluation import nan_maximum
from xdynamics.march.run import Run


@jit_separate
def sweep_links(run: Run, first: int, rows: int, relaxation: float, backward: bool) -> float:
    """Solve for one link after the other; return the largest change of a force, over the largest one.

    Each changes by `relaxation` times what it is to change by, within its bounds; above 1 motions in which many links share
    settle sooner.
    """
    largest_change = 0.0
    add_up(run, first, rows)
    # as names of their own: else each access would read anew where an array stands
    vectors, swing, indices = run.vectors, run.swing, run.coordinate_indices
    normals, responses, width = run.normals, run.unit_responses, run.coordinate_indices.shape[1]
    for row_offset in range(0, rows, 2):
        row = first + (rows - 2 - row_offset if backward else row_offset)
        scale, slip_scale = vectors[SCALE, row], vectors[SCALE, row + 1]
        if scale > 0.0 or slip_scale > 0.0:
            opening, slipping, across = 0.0, 0.0, 0.0
            for i in range(width):
                opening += normals[row, i] * swing[indices[row, i]]
                slipping += normals[row + 1, i] * swing[indices[row + 1, i]]
                across += normals[row + 1, i] * responses[row, i]
            opening, slipping = opening * scale - vectors[RIGHT, row], slipping * slip_scale - vectors[RIGHT, row + 1]
            old, drag = vectors[X, row], vectors[X, row + 1]
            solve_alone(run, row, opening, slipping, across * scale * slip_scale)
            if relaxation != 1.0:
                go_beyond(run, row, old, drag, relaxation)
            change, drag_change = vectors[X, row] - old, vectors[X, row + 1] - drag
            amount, slip_amount = change * scale, drag_change * slip_scale
            for i in range(width):
                swing[indices[row, i]] += responses[row, i] * amount
            for i in range(width):
                swing[indices[row + 1, i]] += responses[row + 1, i] * slip_amount
            largest_change = max(largest_change, abs(change), abs(drag_change))
    return largest_change / largest_entry(run, X, first, rows) if largest_change > 0.0 else 0.0


@jit_separate
def add_up(run: Run, first: int, rows: int) -> None:
    """Sum the solution's effect on all coordinates that links read."""
    clear_responses(run, first, rows)
    for row in range(first, first + rows):
        add_unknown_change(run, row, run.vectors[X, row])


@jit_separate
def add_unknown_change(run: Run, row: int, change: float) -> None:
    """Add the effect of a change of one unknown."""
    respond(run, row, change * run.vectors[SCALE, row])


@jit_separate
def solve_alone(run: Run, row: int, opening: float, slipping: float, across: float) -> None:
    """Solve for a link's normal force and friction from their gradients; both stay if there is no solution.

    Scaled, each answers itself with one: opening + x + across*t is zero, or positive where x is zero, and the friction t
    is -slipping - across*x, or at a bound, which is `ratio` times what the link presses with.
    """
    scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
    x, t = run.vectors[X, row], run.vectors[X, row + 1]
    opening, slipping = opening - (x + across * t), slipping - (across * x + t)
    low, high = run.vectors[DRAG, row + 1] - run.vectors[GRIP, row + 1], run.vectors[DRAG, row + 1]
    high += run.vectors[GRIP, row + 1]
    load = run.vectors[RETURNED, row] / slip_scale if slip_scale > 0.0 else 0.0
    share = scale / slip_scale if slip_scale > 0.0 else 0.0
    t = min(max(low * load, -slipping), high * load)
    if opening + across * t >= 0.0 or scale == 0.0:
        run.vectors[X, row], run.vectors[X, row + 1] = 0.0, t
        return
    determinant = 1.0 - across * across
    x = (across * slipping - opening) / determinant
    t = (across * opening - slipping) / determinant
    if x >= 0.0 and low * (share * x + load) <= t <= high * (share * x + load):
        run.vectors[X, row], run.vectors[X, row + 1] = x, t
        return
    for k in range(2):
        ratio = high if k == 0 else low
        reply, free_opening = 1.0 + across * ratio * share, opening + across * ratio * load
        if reply > 0.0 and free_opening <= 0.0:
            x = -free_opening / reply
            t = ratio * (share * x + load)
            against = slipping + across * x + t
            if low == high or (against <= 0.0 if k == 0 else against >= 0.0):
                run.vectors[X, row], run.vectors[X, row + 1] = x, t
                return


@jit_separate
def go_beyond(run: Run, row: int, old: float, drag: float, relaxation: float) -> None:
    """Change the force of a link and its friction by more than their solution, within their bounds."""
    x = max(0.0, old + relaxation * (run.vectors[X, row] - old))
    t, slip_scale = drag + relaxation * (run.vectors[X, row + 1] - drag), run.vectors[SCALE, row + 1]
    if slip_scale > 0.0:
        load = (x * run.vectors[SCALE, row] + run.vectors[RETURNED, row]) / slip_scale
        middle, far = run.vectors[DRAG, row + 1] * load, run.vectors[GRIP, row + 1] * load
        t = min(max(middle - far, t), middle + far)
    run.vectors[X, row], run.vectors[X, row + 1] = x, t


@jit_separate
def solve_at_once(run: Run, first: int, rows: int) -> float:
    """Find the forces of all that hold, from zero on; return the residual over the size of the terms."""
    right_size = 0.0
    for row in range(first, first + rows):
        run.vectors[LOAD, row] = 0.0
        right_size = max(right_size, abs(run.vectors[GIVEN, row]) if run.vectors[SCALE, row] > 0.0 else 0.0)
    n = eliminate(run, first, rows, run.problem.shape[0], True)
    left = refine_all(run, n, right_size, first, rows)
    if is_dependent(run, n) and not left <= 8.0 * ENOUGH:
        for row in range(first, first + rows):
            run.vectors[LOAD, row] = 0.0
        left = refine_all(run, 0, right_size, first, rows)
    for row in range(first, first + rows):
        run.vectors[X, row], run.vectors[RESIDUE, row] = run.vectors[LOAD, row], run.vectors[AMISS, row]
    return left


@jit_separate
def refine_all(run: Run, n: int, right_size: float, first: int, rows: int) -> float:
    """Solve by factors of n equations, or else along many directions; return the residual over the size of the terms."""
    share, best = inf, inf
    for _ in range(MOST_RESTARTS):
        apply_all(run, LOAD, AMISS, 1.0, first, rows)
        for row in range(first, first + rows):
            if run.vectors[SCALE, row] > 0.0:
                run.vectors[AMISS, row] = run.vectors[GIVEN, row] - run.vectors[AMISS, row]
        size, left = max(right_size, largest_entry(run, LOAD, first, rows)), largest_entry(run, AMISS, first, rows)
        share = left / size if left > 0.0 else left
        if share <= ENOUGH or not share < best / 2.0:
            break
        best = share
        if n > 0:
            add_solution(run, n, AMISS, LOAD)
        else:
            follow_paths(run, ENOUGH * size / 4.0, first, rows)
    return share


@jit_separate
def apply_all(run: Run, source: int, target: int, returned_share: float, first: int, rows: int) -> None:
    """Compute the effect of forces, their drags and a share of the returned drags along every holding row."""
    clear_responses(run, first, rows)
    for row in range(first, first + rows):
        amount, ratio = run.vectors[source, row] * run.vectors[SCALE, row], run.vectors[RATIO, row]
        if ratio != 0.0:
            load = run.vectors[source, row - 1] * run.vectors[SCALE, row - 1]
            amount = ratio * (load + returned_share * run.vectors[RETURNED, row - 1])
        respond(run, row, amount)
    for row in range(first, first + rows):
        scale = run.vectors[SCALE, row]
        run.vectors[target, row] = response_along(run, row) * scale if scale > 0.0 else 0.0


@jit_separate
def follow_paths(run: Run, enough: float, first: int, rows: int) -> None:
    """Improve forces along one direction after the other, until little is amiss or all directions are used up."""
    for k in range(run.paths.shape[0] // 2):
        if largest_entry(run, AMISS, first, rows) <= enough:
            return
        for row in range(first, first + rows):
            run.vectors[TRIED_WAY, row] = run.vectors[AMISS, row]
        apply_all(run, TRIED_WAY, IMAGE, 0.0, first, rows)
        for row in range(first, first + rows):
            run.paths[2 * k, row], run.paths[2 * k + 1, row] = run.vectors[TRIED_WAY, row], run.vectors[IMAGE, row]
        if not follow_path(run, k, first, rows):
            return


@jit_separate
def follow_path(run: Run, k: int, first: int, rows: int) -> bool:
    """Step along the newest direction, orthogonalised, to the least residual; whether it decreases."""
    for j in range(k):
        across, image_square = 0.0, 0.0
        for row in range(first, first + rows):
            across += run.paths[2 * k + 1, row] * run.paths[2 * j + 1, row]
            image_square += run.paths[2 * j + 1, row] * run.paths[2 * j + 1, row]
        for row in range(first, first + rows):
            run.paths[2 * k, row] -= across / image_square * run.paths[2 * j, row]
            run.paths[2 * k + 1, row] -= across / image_square * run.paths[2 * j + 1, row]
    across, image_square = 0.0, 0.0
    for row in range(first, first + rows):
        across += run.vectors[AMISS, row] * run.paths[2 * k + 1, row]
        image_square += run.paths[2 * k + 1, row] * run.paths[2 * k + 1, row]
    if not image_square > 0.0:
        return False
    for row in range(first, first + rows):
        run.vectors[LOAD, row] += across / image_square * run.paths[2 * k, row]
        run.vectors[AMISS, row] -= across / image_square * run.paths[2 * k + 1, row]
    return True


MOST_BOUNDS = 300  # turns of making bounds anew
MOST_SWEEPS = 1 << 13  # turns over all links, one after the other
MOST_SETS = 10  # of links that press and that slip, tried in a row
FEWEST_SETS = 3  # tried even where they do not come nearer to a solution
SWEEPS_BEFORE_PIVOTS = 256  # of them, after which all links are solved for at once
# of sweeps for impulses over a step: how far beyond, by how much less in each stage, the change at which they may end
RELAXATION, RELAXED_LESS, SETTLED = 1.6, 0.3, 1e-12
PASSABLE = 1e-6  # residual of impulses over a step with which they are taken
# rows of links that are solved for along a path, in a band; and turns before it: from farther off it crosses far more often
FEWEST_ON_PATH, SWEEPS_BEFORE_PATH = 64, 128
MOST_STARTS, SWEEPS_BETWEEN = 4, 128  # of such paths, from where further turns have come to
MOST_NEARER = 40  # turns of taking impulses for what they are nearly
RESTLESS = 1e3 * ENOUGH  # change of bounds that may be due to rounding


@jit_separate
def solve_links(run: Run, first: int, count: int) -> float:
    """Find forces, or impulses, of links within their bounds; return the residual over the size of the terms."""
    rows = 2 * count
    if run.counters[ROWS] == 1:
        return solve_unilateral(run, first, count)
    for row in range(first, first + rows):
        run.vectors[X, row] = 0.0
    return solve_from(run, first, count)


@jit_separate
def solve_from(run: Run, first: int, count: int) -> float:
    """Solve for forces of links with friction, from the present forces on."""
    rows = 2 * count
    pose_press_bounds(run, first, rows)
    if run.plan[0].steps_over > 0:
        return relax_all(run, first, rows)
    left = sweep_all(run, first, rows)
    return left if left <= RESTLESS else follow_bounds(run, first, rows)


@jit_separate
def pose_press_bounds(run: Run, first: int, rows: int) -> None:
    """Store the right sides of all links, and unbounded pressures."""
    for row in range(first, first + rows):
        run.vectors[GIVEN, row], run.vectors[OWN_SCALE, row] = run.vectors[RIGHT, row], run.vectors[SCALE, row]
        run.vectors[LEAST, row], run.vectors[MOST, row] = 0.0, inf


@jit_separate
def follow_bounds(run: Run, first: int, rows: int) -> float:
    """Solve with fixed bounds, then renew these, until no bound changes; return the residual of the full problem."""
    left, change, change_before, turn, attempt = 0.0, 0.0, inf, 0, 2
    for row in range(first + 1, first + rows, 2):
        grips = run.vectors[GRIP, row] > 0.0 and run.vectors[SCALE, row] > 0.0
        run.vectors[X, row - 1], run.vectors[X, row] = 0.0, 0.0
        run.vectors[LEAST, row], run.vectors[MOST, row] = (-inf, inf) if grips else (0.0, 0.0)
    while turn < MOST_BOUNDS:
        turn += 1
        left = solve_bounded(run, first, rows)
        change = renew_bounds(run, first, rows)
        if not left <= ALLOWED or change <= ENOUGH or change_before <= change <= RESTLESS:
            break
        if turn == attempt:
            attempt *= 2
            if try_contact_sets(run, first, rows):
                break
        change_before = change
    return friction_residual(run, first, rows)


@jit_separate
def sweep_all(run: Run, first: int, rows: int) -> float:
    """Improve forces of one link after the other; return the residual over the size of the terms."""
    attempt = 8
    for turn in range(1, MOST_SWEEPS + 1):
        if sweep_links(run, first, rows, 1.0, False) <= ENOUGH:
            break
        if turn == attempt:
            attempt = 2 * turn
            bound_all(run, first, rows)
            if try_contact_sets(run, first, rows):
                # turns count from 1, so that no other attempt is made
                attempt = 0
            elif turn == SWEEPS_BEFORE_PIVOTS and pivots_settle(run, first, rows):
                break
    return friction_residual(run, first, rows)


@jit_separate
def relax_all(run: Run, first: int, rows: int) -> float:
    """Solve by over-relaxation, for impulses of steps, whose own error is far larger.

    Where such changes go round in a circle, smaller ones, or one turn up the list of links and one down, often do not. Many
    links are solved for along Lemke's path, and fewer of them where nothing else did.
    """
    many = rows > FEWEST_ON_PATH or 2 * rows > run.problem.shape[0]  # for pivots
    attempt, on_path = 8, many and order_coordinates(run, first, rows) > 0
    for turn in range(1, 4 * MOST_SWEEPS + 1):
        stage = (turn - 1) // MOST_SWEEPS
        relaxation = RELAXATION - RELAXED_LESS * stage
        backward = stage % 2 == 1 and turn % 2 == 0
        change = sweep_links(run, first, rows, relaxation, backward)
        if change <= SETTLED and (change <= ENOUGH or friction_residual(run, first, rows) <= 8.0 * SETTLED):
            break
        if turn == attempt:
            attempt = 2 * turn
            bound_all(run, first, rows)
            if on_path:
                if turn == SWEEPS_BEFORE_PATH and path_settles(run, first, rows):
                    break
            elif try_contact_sets(run, first, rows):
                break
            if turn == SWEEPS_BEFORE_PIVOTS and pivots_settle(run, first, rows):
                break
    left = friction_residual(run, first, rows)
    return friction_residual(run, first, rows) if left > PASSABLE and path_settles(run, first, rows) else left


@jit_separate
def path_settles(run: Run, first: int, rows: int) -> bool:
    """Solve along Lemke's path, from impulses that are there or else from none; whether the result is a solution."""
    n, left = order_coordinates(run, first, rows), inf
    for start in range(MOST_STARTS if n > 0 else 0):
        for _ in range(SWEEPS_BETWEEN if start > 0 else 0):
            sweep_links(run, first, rows, RELAXATION, False)
        left = approach_solution(run, first, rows, n)
        if left <= PASSABLE:
            return True
    if n > 0 and follow_from_far(run, first, rows, n):
        left = approach_solution(run, first, rows, n)
    return left <= PASSABLE


@jit_separate
def approach_solution(run: Run, first: int, rows: int, n: int) -> float:
    """Solve near the present impulses again and again, with links that give way less and less; return the least residual.

    Where links that give way a little lead astray, ones that give way more do not, only more slowly (the proximal point
    method, R. T. Rockafellar, SIAM J. Control Optim. 14, 1976, 877).
    """
    best, gives, factored_with = friction_residual(run, first, rows), GIVES_AT_FIRST, 0.0
    for row in range(first, first + rows):
        run.vectors[TRIED, row] = run.vectors[X, row]
    for _ in range(MOST_NEARER):
        if not follow_from_near(run, first, rows, n, gives, gives == factored_with):
            gives, factored_with = min(1.0, GIVES_MORE * gives), 0.0
            continue
        factored_with = gives
        left = friction_residual(run, first, rows)
        stalls = best <= PASSABLE and not left < best / 2.0
        if left < best:
            best = left
            for row in range(first, first + rows):
                run.vectors[TRIED, row] = run.vectors[X, row]
        if stalls or best <= 8.0 * SETTLED:
            break
        gives = max(GIVES, gives / GIVES_LESS)
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[TRIED, row]
    return best


@jit_separate
def pivots_settle(run: Run, first: int, rows: int) -> bool:
    """Solve by pivots; whether the result is a solution, perhaps after its sets are solved for again."""
    if not solve_by_pivots(run, first, rows):
        return False
    if friction_residual(run, first, rows) <= RESTLESS:
        return True
    bound_all(run, first, rows)
    return try_contact_sets(run, first, rows)


@jit_separate
def bound_all(run: Run, first: int, rows: int) -> None:
    """Give all friction the bounds that normal forces set."""
    for row in range(first + 1, first + rows, 2):
        bound_row(run, row)


@jit_separate
def renew_bounds(run: Run, first: int, rows: int) -> float:
    """Give friction the bounds that normal forces set; return by how much a force changes, over the largest one."""
    largest_change = 0.0
    for row in range(first + 1, first + rows, 2):
        old = run.vectors[X, row]
        at_least, at_most = old == run.vectors[LEAST, row], old == run.vectors[MOST, row]
        bound_row(run, row)
        new = min(max(run.vectors[LEAST, row], old), run.vectors[MOST, row])
        # friction at its bound goes with it, also where the bound widens
        new = run.vectors[MOST, row] if at_most else (run.vectors[LEAST, row] if at_least else new)
        run.vectors[X, row] = new
        largest_change = max(largest_change, abs(new - old))
    size = max(largest_entry(run, X, first, rows), largest_entry(run, RIGHT, first, rows))
    return largest_change / size if largest_change > 0.0 else 0.0


@jit_separate
def bound_row(run: Run, row: int) -> None:
    """Give one friction the bounds that its normal force sets."""
    scale = run.vectors[SCALE, row]
    force = load_of(run, X, row - 1, 1.0) / scale if scale > 0.0 else 0.0
    middle, far = run.vectors[DRAG, row] * force, run.vectors[GRIP, row] * force
    run.vectors[LEAST, row], run.vectors[MOST, row] = middle - far, middle + far


@jit_separate
def load_of(run: Run, pressing: int, row: int, returned_share: float) -> float:
    """The pressure of a link: its solution, if it presses, and a share of its restitution."""
    return max(run.vectors[pressing, row], 0.0) * run.vectors[SCALE, row] + returned_share * run.vectors[RETURNED, row]


@jit_separate
def friction_residual(run: Run, first: int, rows: int) -> float:
    """The residual of the full problem over the size of its terms; gradients are in `RESIDUE`."""
    worst, size = 0.0, max(largest_entry(run, X, first, rows), largest_entry(run, RIGHT, first, rows))
    apply_link_effects(run, X, RESIDUE, first, rows)
    for row in range(first, first + rows):
        run.vectors[RESIDUE, row] -= run.vectors[RIGHT, row]
    for row in range(first, first + rows, 2):
        bound_row(run, row + 1)
        for row_index in range(row, row + 2):
            x, slope = run.vectors[X, row_index], run.vectors[RESIDUE, row_index]
            near = min(max(run.vectors[LEAST, row_index], x - slope), run.vectors[MOST, row_index])
            worst = nan_maximum(worst, abs(x - near))
    return worst / size if worst != 0.0 else 0.0


@jit_separate
def try_contact_sets(run: Run, first: int, rows: int) -> bool:
    """Try whether links that press, and those at a bound of their friction, are the right ones; whether they are.

    Where they are not, what the forces found ask for is tried in its turn, a few times: Newton's method on the projections
    that the conditions are (Alart and Curnier, Comput. Methods Appl. Mech. Eng. 92, 1991, 353).
    """
    for row in range(first, first + rows):
        run.vectors[TRIED, row], run.vectors[RESIDUE, row] = run.vectors[X, row], 0.0
    best = inf
    for turn in range(MOST_SETS):
        choose_sets(run, first, rows)
        solve_sets(run, first, rows)
        for row in range(first, first + rows):
            run.vectors[SCALE, row], run.vectors[RIGHT, row] = run.vectors[OWN_SCALE, row], run.vectors[GIVEN, row]
        left = friction_residual(run, first, rows)
        if left <= RESTLESS:
            return True
        if turn >= FEWEST_SETS and not left < best:
            break
        best = min(left, best)
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[TRIED, row]
        if (row - first) % 2 == 1:
            bound_row(run, row)
            run.vectors[X, row] = min(max(run.vectors[LEAST, row], run.vectors[X, row]), run.vectors[MOST, row])
    return False


@jit_separate
def choose_sets(run: Run, first: int, rows: int) -> None:
    """Choose the links that hold; others are set by a step along their gradients, onto their bounds."""
    for row in range(first, first + rows, 2):
        pressing = run.vectors[X, row] - run.vectors[RESIDUE, row]
        rubbing = run.vectors[X, row + 1] - run.vectors[RESIDUE, row + 1]
        low, high = run.vectors[LEAST, row + 1], run.vectors[MOST, row + 1]
        run.vectors[RATIO, row], run.vectors[RATIO, row + 1] = 0.0, 0.0
        if pressing <= 0.0:
            run.vectors[SCALE, row] = 0.0
        if pressing <= 0.0 and run.vectors[RETURNED, row] == 0.0:
            run.vectors[SCALE, row + 1] = 0.0
        elif not low < rubbing < high:
            grip = run.vectors[GRIP, row + 1]
            run.vectors[RATIO, row + 1] = run.vectors[DRAG, row + 1] + (-grip if rubbing <= low else grip)
            run.vectors[SCALE, row + 1] = 0.0


@jit_separate
def solve_closed(run: Run) -> float:
    """Find forces of closed links after which none that holds accelerates; those that slide drag as they press."""
    first, rows = closed_from(run), rows_of_closed(run)
    if run.counters[ROWS] == 1:
        return solve_equations(run, first, rows)
    for row in range(first, first + rows):
        run.vectors[GIVEN, row], run.vectors[RATIO, row] = run.vectors[RIGHT, row], run.vectors[DRAG, row]
    for row in range(first, first + rows, 2):
        run.vectors[OWN_SCALE, row] = run.vectors[SCALE, row]
    return solve_sets(run, first, rows)


@jit_separate
def solve_sets(run: Run, first: int, rows: int) -> float:
    """Find forces of links that press, and of rows that hold, where others drag as their links press.

    Rows that drag have their own scale afterwards.
    """
    any_drags = False
    for row in range(first, first + rows):
        any_drags = any_drags or run.vectors[RATIO, row] != 0.0
    left = solve_at_once(run, first, rows) if any_drags else inf
    if not left <= 8.0 * ENOUGH:
        left = solve_in_turn(run, first, rows)
    for row in range(first + 1, first + rows, 2):
        if run.vectors[RATIO, row] != 0.0:
            run.vectors[SCALE, row] = run.vectors[OWN_SCALE, row]
            load = run.vectors[LOAD, row - 1] * run.vectors[SCALE, row - 1] + run.vectors[RETURNED, row - 1]
            run.vectors[X, row] = run.vectors[RATIO, row] * load / run.vectors[SCALE, row]
    return left


@jit_separate
def solve_in_turn(run: Run, first: int, rows: int) -> float:
    """Solve for forces with drags as they are supposed to be, then for drags, until both agree.

    With each direction of generalised conjugate residuals, equations of all that hold are solved: where many hold more
    than needs holding, this finds forces that `solve_at_once` does not.
    """
    for row in range(first, first + rows):
        run.vectors[LOAD, row] = 0.0
    left, share, best = press_along(run, LOAD, 1.0, first, rows), drag_residual(run, first, rows), inf
    while share > ENOUGH and share < 0.9 * best and left <= ALLOWED:
        best = share
        reduce_drag_residual(run, ENOUGH * largest_entry(run, X, first, rows), first, rows)
        left = press_along(run, LOAD, 1.0, first, rows)
        share = drag_residual(run, first, rows)
    return max(left, share)


@jit_separate
def press_along(run: Run, pressing: int, given_share: float, first: int, rows: int) -> float:
    """Solve for forces of links that drag by the pressures of a vector, and by a share of given forces."""
    clear_responses(run, first, rows)
    for row in range(first + 1, first + rows, 2):
        if run.vectors[RATIO, row] != 0.0:
            load = run.vectors[pressing, row - 1] * run.vectors[SCALE, row - 1]
            drag = run.vectors[RATIO, row] * (load + given_share * run.vectors[RETURNED, row - 1])
            respond(run, row, drag)
    for row in range(first, first + rows):
        scale = run.vectors[SCALE, row]
        run.vectors[RIGHT, row] = (
            given_share * run.vectors[GIVEN, row] - response_along(run, row) * scale if scale > 0.0 else 0.0
        )
    return solve_equations(run, first, rows)


@jit_separate
def drag_residual(run: Run, first: int, rows: int) -> float:
    """By how much links that drag press otherwise than was supposed, over the largest force; each is in `AMISS`."""
    largest_residual = 0.0
    for row in range(first, first + rows, 2):
        drags = run.vectors[RATIO, row + 1] != 0.0
        run.vectors[AMISS, row] = run.vectors[X, row] - run.vectors[LOAD, row] if drags else 0.0
        run.vectors[AMISS, row + 1] = 0.0
        largest_residual = nan_maximum(largest_residual, abs(run.vectors[AMISS, row]))
    return largest_residual / largest_entry(run, X, first, rows) if largest_residual > 0.0 else 0.0


@jit_separate
def reduce_drag_residual(run: Run, enough: float, first: int, rows: int) -> None:
    """Change the pressures of dragging links until forces agree, or all directions are used up."""
    for k in range(run.paths.shape[0] // 2):
        if largest_entry(run, AMISS, first, rows) <= enough / 4.0:
            return
        for row in range(first, first + rows):
            run.vectors[TRIED_WAY, row] = run.vectors[AMISS, row]
        press_along(run, TRIED_WAY, 0.0, first, rows)
        for row in range(first, first + rows):
            direction = run.vectors[TRIED_WAY, row]
            drags = (row - first) % 2 == 0 and run.vectors[RATIO, row + 1] != 0.0
            run.paths[2 * k, row] = direction
            run.paths[2 * k + 1, row] = direction - run.vectors[X, row] if drags else 0.0
        if not follow_path(run, k, first, rows):
            return
