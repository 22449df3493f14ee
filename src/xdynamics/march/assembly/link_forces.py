"""Forces of links that touch, at accelerations without them: which press, which grip, and which slide."""

from __future__ import annotations

from math import sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import ROWS, STRAIN, STRAINED, TOGETHER, blame
from xdynamics.march.assembly.closed_links import DRAG, GRIP, RETURNED, RIGHT, SCALE, X
from xdynamics.march.assembly.friction import solve_links
from xdynamics.march.assembly.impact import pose_slip
from xdynamics.march.assembly.links import ASSEMBLY, LINK
from xdynamics.march.assembly.low_motions import link_resolution, slip_falling
from xdynamics.march.assembly.normal_forces import ALLOWED
from xdynamics.march.assembly.responses import clear_responses, respond
from xdynamics.march.assembly.touching import (
    ACTS,
    AFTER,
    BIAS,
    BROKEN,
    CANDIDATE,
    DRAGS,
    FORCE,
    HALTED,
    KINETIC,
    OWN,
    RUBS,
    SLIP_AFTER,
    SLIP_BIAS,
    SLIP_SLACK,
    STATIC,
    acceleration_along,
    slip_of,
)
from xdynamics.march.run import Run


@jit_separate
def solve_forces(run: Run) -> bool:
    """Find the forces of links that do not part, and the acceleration of every gap with them."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    for a in range(count):
        acts, row = run.touching[a, ACTS] == 1.0, rows * a
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, row] = -acceleration_along(run, row, run.touching[a, BIAS]) * run.vectors[SCALE, row]
        run.vectors[RETURNED, row] = 0.0
        if rows == 2:
            pose_grip(run, a, acts)
    left = solve_links(run, 0, count)
    if not left <= ALLOWED:
        k = int(run.touching[0, CANDIDATE])
        blame(run, STRAINED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        run.spans[STRAIN] = left
        return False
    for a in range(count):
        run.touching[a, FORCE] = run.vectors[X, rows * a] * run.vectors[SCALE, rows * a]
        if rows == 2:
            run.touching[a, DRAGS] = run.vectors[X, rows * a + 1] * run.vectors[SCALE, rows * a + 1]
    note_accelerations(run)
    return True


@jit_separate
def pose_grip(run: Run, a: int, acts: bool) -> None:
    """Write down whether a link grips, and within which bounds, or slides already, or since its grip has just broken."""
    row = 2 * a + 1
    pose_slip(run, a, acts, acceleration_along(run, row, run.touching[a, SLIP_BIAS]))
    if run.touching[a, RUBS] == 1.0:
        slip, fast = slip_of(run, a), run.touching[a, SLIP_SLACK] + slip_falling(run, a) * link_resolution(run, a)
        if abs(slip) > fast and run.touching[a, HALTED] == 0.0:
            run.vectors[DRAG, row] = -run.touching[a, KINETIC] if slip > 0.0 else run.touching[a, KINETIC]
        elif run.touching[a, BROKEN] != 0.0:
            run.vectors[DRAG, row] = run.touching[a, BROKEN] * run.touching[a, KINETIC]
        else:
            run.vectors[GRIP, row] = run.touching[a, STATIC]


@jit_separate
def note_accelerations(run: Run) -> None:
    """Note the acceleration of every gap that touches, with the forces just found."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    clear_responses(run, 0, rows * count)
    for a in range(count):
        respond(run, rows * a, run.touching[a, FORCE])
        if rows == 2:
            respond(run, 2 * a + 1, run.touching[a, DRAGS])
    for a in range(count):
        run.touching[a, AFTER] = pressed_along(run, rows * a, run.touching[a, BIAS])
        if rows == 2:
            run.touching[a, SLIP_AFTER] = pressed_along(run, 2 * a + 1, run.touching[a, SLIP_BIAS])


@jit_separate
def pressed_along(run: Run, row: int, bias: float) -> float:
    """The acceleration along a row with what forces of links add."""
    total = acceleration_along(run, row, bias)
    for i in range(run.coordinate_indices.shape[1]):
        total += run.normals[row, i] * run.swing[run.coordinate_indices[row, i]]
    return total
