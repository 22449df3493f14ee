"""Equations of all links that hold, where others drag as their links press: solved for at once.

They are not symmetric, as a drag is a share of another force. Generalised conjugate residuals (Eisenstat, Elman, Schultz,
SIAM J. Numer. Anal. 20, 1983, 345) need as many directions as there are forces at most, and a few at a time.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import (
    AMISS,
    GIVEN,
    IMAGE,
    LOAD,
    RATIO,
    RESIDUE,
    RETURNED,
    SCALE,
    TRIED_WAY,
    X,
)
from xdynamics.march.assembly.direct_solution import add_solution, eliminate, is_dependent
from xdynamics.march.assembly.normal_forces import ENOUGH, MOST_RESTARTS, largest_entry
from xdynamics.march.assembly.responses import clear_responses, respond, response_along
from xdynamics.march.run import Run


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
    """Compute what forces, their drags and a share of what is given back do along everything that holds."""
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
    """Go along the newest direction, made to differ from all before, as far as what is amiss falls; whether it leads on."""
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
