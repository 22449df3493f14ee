"""Forces, or impulses, of links with friction by Lemke's method, where improving one after the other does not settle.

Friction along a known line is one complementarity problem (Stewart, Trinkle, Int. J. Numer. Methods Eng. 39, 1996, 2673):
of each link its normal force; of one that grips also its friction either way, and a slip rate that is positive only where
that friction is at its bound. A link that slides drags in proportion to its normal force, which needs no unknown.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import AMISS, DRAG, GRIP, RETURNED, RIGHT, SCALE, X
from xdynamics.march.assembly.responses import clear_responses, respond, response_along
from xdynamics.march.contacts.complementarity import clear_tableau, solve_complementarity
from xdynamics.march.run import Run

MOST_UNKNOWNS = 512  # four of a link that grips; exchanges grow with their number, and each with its square


@jit_separate
def solve_by_pivots(run: Run, first: int, rows: int) -> bool:
    """Solve for forces and friction of all links at once; whether that ended with a solution."""
    links, grips = count_unknowns(run, first, rows)
    n = links + 3 * grips
    if not 0 < n <= run.problem.shape[0]:
        return False
    clear_tableau(run, n)
    pose_forces(run, first, rows, links, grips)
    pose_friction_bounds(run, first, rows, links, grips)
    if not solve_complementarity(run, n):
        return False
    take_forces(run, first, rows, links, grips)
    return True


@jit_separate
def count_unknowns(run: Run, first: int, rows: int) -> tuple[int, int]:
    """Count links that may press and those that grip; the place of each among these is in `AMISS`."""
    links, grips = 0, 0
    for row in range(first, first + rows, 2):
        run.vectors[AMISS, row], run.vectors[AMISS, row + 1] = -1.0, -1.0
        if run.vectors[SCALE, row] > 0.0:
            run.vectors[AMISS, row] = links
            links += 1
        if run.vectors[SCALE, row + 1] > 0.0 and run.vectors[GRIP, row + 1] > 0.0:
            run.vectors[AMISS, row + 1] = grips
            grips += 1
    return links, grips


@jit_separate
def pose_forces(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Write what a unit of each force does along every link, and what is there without them."""
    n, constant_column = links + 3 * grips, 2 * (links + 3 * grips) + 1
    clear_responses(run, first, rows)
    for row in range(first, first + rows, 2):
        add_drag(run, row, run.vectors[RETURNED, row])
    for row in range(first, first + rows):
        rate = response_along(run, row) * run.vectors[SCALE, row] - run.vectors[RIGHT, row]
        pose_entry(run, row, first, links, grips, constant_column, rate)
    for row in range(first, first + rows):
        unknown_index = int(run.vectors[AMISS, row])
        if unknown_index < 0:
            continue
        clear_responses(run, first, rows)
        respond(run, row, run.vectors[SCALE, row])
        presses = (row - first) % 2 == 0
        if presses:
            add_drag(run, row, run.vectors[SCALE, row])
        for effect_row in range(first, first + rows):
            effect = response_along(run, effect_row) * run.vectors[SCALE, effect_row]
            if presses:
                pose_entry(run, effect_row, first, links, grips, n + unknown_index, -effect)
            else:
                pose_entry(run, effect_row, first, links, grips, n + links + unknown_index, -effect)
                pose_entry(run, effect_row, first, links, grips, n + links + grips + unknown_index, effect)


@jit_separate
def add_drag(run: Run, row: int, load: float) -> None:
    """Add what a link that slides drags with, if it presses with a load."""
    if run.vectors[SCALE, row + 1] > 0.0:
        respond(run, row + 1, run.vectors[DRAG, row + 1] * load)


@jit_separate
def pose_entry(run: Run, row: int, first: int, links: int, grips: int, column: int, value: float) -> None:
    """Write an entry of the rows of a link: of its gap, or of both ways of its slip."""
    unknown_index = int(run.vectors[AMISS, row])
    if unknown_index < 0:
        return
    if (row - first) % 2 == 0:
        run.problem[unknown_index, column] = value
    else:
        run.problem[links + unknown_index, column], run.problem[links + grips + unknown_index, column] = value, -value


@jit_separate
def pose_friction_bounds(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Write that friction is at most what its link presses with allows, or slips."""
    n = links + 3 * grips
    for row in range(first + 1, first + rows, 2):
        grip, press = int(run.vectors[AMISS, row]), int(run.vectors[AMISS, row - 1])
        if grip < 0:
            continue
        ratio, bound = run.vectors[GRIP, row] / run.vectors[SCALE, row], links + 2 * grips + grip
        for direction in range(2):
            unknown_index = links + direction * grips + grip
            run.problem[unknown_index, n + bound], run.problem[bound, n + unknown_index] = -1.0, 1.0
        if press >= 0:
            run.problem[bound, n + press] = -ratio * run.vectors[SCALE, row - 1]
        run.problem[bound, 2 * n + 1] = ratio * run.vectors[RETURNED, row - 1]


@jit_separate
def take_forces(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Read the solution."""
    for row in range(first, first + rows, 2):
        press, grip = int(run.vectors[AMISS, row]), int(run.vectors[AMISS, row + 1])
        run.vectors[X, row] = run.solution[press] if press >= 0 else 0.0
        load = run.vectors[X, row] * run.vectors[SCALE, row] + run.vectors[RETURNED, row]
        if grip >= 0:
            run.vectors[X, row + 1] = run.solution[links + grip] - run.solution[links + grips + grip]
        elif run.vectors[SCALE, row + 1] > 0.0:
            run.vectors[X, row + 1] = run.vectors[DRAG, row + 1] * load / run.vectors[SCALE, row + 1]
        else:
            run.vectors[X, row + 1] = 0.0
