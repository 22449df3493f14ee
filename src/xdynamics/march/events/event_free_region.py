"""A region of the motion in which no event function has a zero: while steps stay inside it, none of them is examined.

The region is a box of the variables of event functions: positions, velocities, states, time. Their enclosures show
once that none has a zero anywhere in it; a step then costs only bounds of its positions, however many detectors there
are. A step that leaves the box is examined by itself, and the box grows, or a new one is put around it.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.march.calls import enclosed_by
from xdynamics.march.run import ALL, ENCLOSE, Run

# of `Run.region`: whether there is a box, how many widths of a step it reaches beyond the step, for how many steps none
# is tried, and how many of these are left; then the box, and after it the bounds of the step
STANDS, REACH, PAUSE, WAIT, BOX = range(5)
POSITION, INSTANT, OTHER = range(3)  # kinds of variables of the box
FARTHEST, LONGEST = 64.0, 16.0
GROWN = 0.5  # of the width of a step that left the box: how far the box grows beyond it
SLACK = (
    1e-9  # of a bound: `coordinate_bounds` takes fewer operations than the enclosure, which its bounds have to contain
)


@jit_inline
def stays_in_region(run: Run) -> bool:
    """Whether all variables of event functions stay inside the box during the trial."""
    now, trial, piece, n = run.now[0], run.trial[0], run.piece[0], run.box_variables.shape[0]
    if run.region[STANDS] == 0.0:
        return False
    piece.start, piece.end, piece.width, piece.wide = now.t, trial.t, trial.h, 0.0
    piece.rough, piece.part = 1, 0
    for j in range(n):
        sort, k = run.box_variables[j, 0], run.box_variables[j, 1]
        low, high = now.t, trial.t
        if sort == POSITION:
            low, high = coordinate_bounds(run, k)
        elif sort == OTHER:
            enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, k, k + 1, ALL)
            low, high = run.under[run.rows[k, 1]], run.over[run.rows[k, 1]]
        if not (run.region[BOX + j] <= low and high <= run.region[BOX + n + j]):
            return False
    return True


@jit_inline
def coordinate_bounds(run: Run, i: int) -> tuple[float, float]:
    """Bounds of a coordinate between the states y and z, in few operations: they contain `enclosures.coordinate`'s."""
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.trial[0].h
    q0, v0, a0, q1, v1, a1 = run.y[i], run.y[n + i], run.y[used + i], run.z[i], run.z[n + i], run.z[used + i]
    slant0, slant1, bend0, bend1 = 0.4 * w * v0, -0.4 * w * v1, 0.05 * w * w * a0, 0.05 * w * w * a1
    odd = abs((q1 - q0) - 0.5 * w * (v0 + v1) + (w * w * (1.0 / 12.0)) * (a1 - a0))
    even = abs(w * (v1 - v0) - 0.5 * w * w * (a0 + a1))
    size = max(abs(q0), abs(q1)) + abs(slant0) + abs(slant1) + abs(bend0) + abs(bend1)
    off = odd + even * (1.0 / 128.0) + SLACK * size
    low = min(q0 + min(slant0, 0.0) + min(bend0, 0.0), q1 + min(slant1, 0.0) + min(bend1, 0.0))
    high = max(q0 + max(slant0, 0.0) + max(bend0, 0.0), q1 + max(slant1, 0.0) + max(bend1, 0.0))
    return low - off, high + off


@jit_separate
def end_region(run: Run) -> None:
    """Discard the box: after an event or a node, event functions change, or have to stay on other sides."""
    if run.box_variables.shape[0] > 0:
        run.region[STANDS] = 0.0


@jit_separate
def set_region(run: Run) -> None:
    """Put a box around the trial just enclosed: extend the last box as far as this trial, or make a new one."""
    n, region = run.box_variables.shape[0], run.region
    if region[WAIT] > 0.0:
        region[WAIT] -= 1.0
        return
    for j in range(n):
        target = run.box_variables[j, 2]
        low, high = (
            coordinate_bounds(run, run.box_variables[j, 1])
            if run.box_variables[j, 0] == POSITION
            else (run.under[target], run.over[target])
        )
        region[BOX + 2 * n + j], region[BOX + 3 * n + j] = low, high
    run.piece[0].rough = 2
    stands = region[STANDS] != 0.0 and (is_silent(run, GROWN, True) or is_silent(run, GROWN / 8.0, True))
    if not stands:
        stands = is_silent(run, max(region[REACH], GROWN), False)
        region[REACH] = min(FARTHEST, 2.0 * max(region[REACH], GROWN)) if stands else region[REACH] / 4.0
    run.piece[0].rough = 0
    region[STANDS] = 1.0 if stands else 0.0
    region[PAUSE] = 1.0 if stands else min(LONGEST, 2.0 * max(1.0, region[PAUSE]))
    region[WAIT] = 0.0 if stands else region[PAUSE]


@jit_separate
def is_silent(run: Run, reach: float, joins_last_box: bool) -> bool:
    """Whether no event function has a zero in a box `reach` widths beyond the step, joined to the last box or not."""
    n, region = run.box_variables.shape[0], run.region
    for j in range(n):
        target, low, high = run.box_variables[j, 2], region[BOX + 2 * n + j], region[BOX + 3 * n + j]
        beyond = reach * (high - low)
        if joins_last_box:
            box_low, box_high = region[BOX + j], region[BOX + n + j]
            low, high = (
                min(box_low, low - beyond if low < box_low else low),
                max(box_high, high + beyond if high > box_high else high),
            )
        else:
            low, high = low - beyond, high + beyond
        run.under[target], run.over[target] = low, high
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, run.parts[0], run.parts[1], ALL)
    for i in range(run.detectors.shape[0]):
        value_index, watch = run.detectors[i].value, run.watches[i]
        keeps_side = (watch.armed > 0 and run.under[value_index] > 0.0) or (
            watch.armed < 0 and run.over[value_index] < 0.0
        )
        if watch.asleep == 0 and not (keeps_side and (watch.guard == 0 or watch.armed == watch.guard)):
            return False
    for j in range(n):
        region[BOX + j], region[BOX + n + j] = run.under[run.box_variables[j, 2]], run.over[run.box_variables[j, 2]]
    return True
