"""Forces, or impulses, of links with friction, one link after the other.

M. Jean, Comput. Methods Appl. Mech. Eng. 177, 1999, 235 (nonlinear block Gauss-Seidel). Each link is solved for exactly,
with those of all others as they are; a turn costs as much as one product with W.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import DRAG, GRIP, RETURNED, RIGHT, SCALE, X
from xdynamics.march.assembly.normal_forces import largest_entry
from xdynamics.march.assembly.responses import clear_responses, respond, response_along
from xdynamics.march.run import Run


@jit_separate
def sweep_links(run: Run, first: int, rows: int, relaxation: float, backward: bool) -> float:
    """Solve for one link after the other; return the largest change of a force, over the largest one.

    Each changes by `relaxation` times what it is to change by, within its bounds; above 1 motions in which many links share
    settle sooner.
    """
    largest_change = 0.0
    add_up(run, first, rows)
    for row_offset in range(0, rows, 2):
        row = first + (rows - 2 - row_offset if backward else row_offset)
        if run.vectors[SCALE, row] > 0.0 or run.vectors[SCALE, row + 1] > 0.0:
            old, drag = run.vectors[X, row], run.vectors[X, row + 1]
            solve_alone(run, row, gradient_along(run, row), gradient_along(run, row + 1))
            if relaxation != 1.0:
                go_beyond(run, row, old, drag, relaxation)
            change, drag_change = run.vectors[X, row] - old, run.vectors[X, row + 1] - drag
            add_unknown_change(run, row, change)
            add_unknown_change(run, row + 1, drag_change)
            largest_change = max(largest_change, abs(change), abs(drag_change))
    return largest_change / largest_entry(run, X, first, rows) if largest_change > 0.0 else 0.0


@jit_separate
def add_up(run: Run, first: int, rows: int) -> None:
    """Sum what the solution changes of everything that links read."""
    clear_responses(run, first, rows)
    for row in range(first, first + rows):
        add_unknown_change(run, row, run.vectors[X, row])


@jit_separate
def add_unknown_change(run: Run, row: int, change: float) -> None:
    """Add what a change of one unknown does."""
    respond(run, row, change * run.vectors[SCALE, row])


@jit_separate
def gradient_along(run: Run, row: int) -> float:
    """The gradient W x - b along one unknown."""
    return float(response_along(run, row) * run.vectors[SCALE, row] - run.vectors[RIGHT, row])


@jit_separate
def solve_alone(run: Run, row: int, opening: float, slipping: float) -> None:
    """Solve for the force of one link and its friction, of gradients; they stay where these two have no solution.

    Scaled, each answers itself with one: opening + x + across*t is zero, or positive where x is zero, and the friction t
    is -slipping - across*x, or at a bound, which is `ratio` times what the link presses with.
    """
    scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
    across, x, t = across_of(run, row), run.vectors[X, row], run.vectors[X, row + 1]
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
def across_of(run: Run, row: int) -> float:
    """What the slip of a link answers to its own normal force, scaled."""
    total = 0.0
    for i in range(run.coordinate_indices.shape[1]):
        total += run.normals[row + 1, i] * run.unit_responses[row, i]
    return float(total * run.vectors[SCALE, row] * run.vectors[SCALE, row + 1])
