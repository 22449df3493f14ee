"""Links that touch as an impact begins, and what impulses along each of them do."""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import (
    BOUNCED,
    CLOSE,
    COUNT,
    CROWDED,
    DEPTH,
    FASTEST,
    OVERLAP,
    ROWS,
    RUBBED,
    TOGETHER,
    blame,
)
from xdynamics.march.assembly.closed_links import FRICTIONLESS, closed_index
from xdynamics.march.assembly.links import ASSEMBLY, LINK, NOISE, evaluate_candidate, leaf_member, pattern_at
from xdynamics.march.assembly.margins import BREAKS
from xdynamics.march.assembly.narrow_phase import reach_of
from xdynamics.march.run import Run

CANDIDATE, GAP, RATE, BOUNCE, SLACK, TARGET_RATE, IMPULSE, TOTAL, LOST, ACTS, BEFORE, OWN, EARLY, BIAS, ROUGH = range(
    15
)
# how far a gap may be from zero; whether the link was closed before, whether it then lifts; its force, the acceleration
# of its gap, whether its bounces are skipped, how
# long these would have lasted, and the energy that this takes
REACH, HELD, LIFTS, FORCE, AFTER, SKIPS, LASTS, TAKEN = range(15, 23)
# of a link with friction: whether it has any, its coefficients while it slides and before, its slip, how much of it is
# by time alone and how that changes, what rounding leaves of it, what it answers to a unit of its own impulse, this
# impulse and all at the time, its force and acceleration, and what it did before and does after
RUBS, KINETIC, STATIC, SLIP, SLIP_EARLY, SLIP_BIAS, SLIP_SLACK, SLIP_OWN = range(23, 31)
PULL, TOTAL_PULL, DRAGS, SLIP_AFTER, GRIPPED, GRIPS = range(31, 37)
# the impulse that it gives back by Poisson's law, what its slip answers to a normal impulse, the direction of the
# friction of a grip that has just broken, and why its slip is stopped if it is
GIVES_BACK, ACROSS, BROKEN, HALTED = range(37, 41)
GOES_ON = 41  # whether a slip is not to be stopped, as it would go on
BOUNCES = 42  # whether a bounce is not skipped though it is low, as no forces exist with its link held
NUMBERS = 43  # of a link that touches
WEDGED, SLIP_ENDED = 1.0, 2.0  # why a slow slip is stopped: no forces exist while it lasts, or friction ends it so soon
OVERLAPPING = 4.0  # times how far a gap may be from zero: a deeper overlap ends the run


@jit_separate
def list_touching(run: Run, t: float) -> bool:
    """List the links that touch in the order of their numbers, with what impulses along each do."""
    run.counters[TOGETHER], all_listed = 0, True
    for m in range(run.counters[CLOSE]):
        all_listed = all_listed and admit(run, run.close[m], t, False)
    if run.closed[0] > 0:
        for k in range(run.counters[COUNT]):
            if closed_index(run, run.candidates[k, ASSEMBLY], run.candidates[k, LINK]) >= 0:
                all_listed = all_listed and admit(run, k, t, True)
    return all_listed


@jit_separate
def admit(run: Run, k: int, t: float, is_closed: bool) -> bool:
    """List a candidate if it is closed, or its gap is as good as zero; False where the list cannot be made."""
    c, link = run.candidates[k, ASSEMBLY], run.candidates[k, LINK]
    evaluate_candidate(run, run.z, t, k)
    (gap, steep, size), reach = gap_of(run, k), reach_of(run, k)
    if gap > reach and not is_closed:
        return True
    if not gap >= -OVERLAPPING * reach and not (
        is_closed and gap > -inf
    ):  # gaps of closed links are seen to after steps
        blame(run, OVERLAP, c, link)
        run.spans[DEPTH] = gap
        return False
    list_index = enlist(run, k, gap, NOISE * steep * run.spans[FASTEST])
    if list_index < 0:
        return False
    run.touching[list_index, ROUGH], run.touching[list_index, REACH] = NOISE * size, reach
    closed_place = closed_index(run, c, link)
    run.touching[list_index, HELD] = 1.0 if closed_place >= 0 else 0.0
    run.touching[list_index, LIFTS] = (
        1.0 if closed_place >= 0 and run.lifted[closed_place] == 1 and run.loads[closed_place] <= 0.0 else 0.0
    )
    if run.counters[ROWS] == 2:
        run.touching[list_index, GRIPPED] = run.grips[closed_place] if closed_place >= 0 else FRICTIONLESS
        if closed_place >= 0 and run.lifted[closed_place] == BREAKS:
            run.touching[list_index, BROKEN] = 1.0 if run.pulls[closed_place] > 0.0 else -1.0
    return True


@jit_separate
def gap_of(run: Run, k: int) -> tuple[float, float, float]:
    """Return the gap of a candidate that was just looked at, how steep it is, and the size of the terms it is the sum of."""
    c = run.candidates[k, ASSEMBLY]
    pattern, steep = pattern_at(run.patterns[2 * c + 1]), 0.0
    size = abs(pattern.links[0].gap)
    for i in range(run.assemblies[c].coordinates):
        steep += abs(pattern.directions[0, i])
        size += abs(pattern.directions[0, i] * pattern.z[i])
    return pattern.links[0].gap, steep, size


@jit_separate
def enlist(run: Run, k: int, gap: float, slack: float) -> int:
    """List a candidate, which has just been looked at, in its place; return this, -1 where the list cannot be made."""
    c, link, list_index = run.candidates[k, ASSEMBLY], run.candidates[k, LINK], run.counters[TOGETHER]
    pattern = pattern_at(run.patterns[2 * c + 1])
    if list_index >= run.touching.shape[0]:
        blame(run, CROWDED, c, link)
        return -1
    if run.assemblies[c].rubs == 1 and not 0.0 <= pattern.links[1].coefficient <= pattern.links[1].most:
        blame(run, RUBBED, c, link)
        run.spans[DEPTH] = pattern.links[1].coefficient
        return -1
    if not 0.0 <= pattern.links[0].coefficient <= 1.0:
        blame(run, BOUNCED, c, link)
        run.spans[DEPTH] = pattern.links[0].coefficient
        return -1
    while list_index > 0 and is_listed_after(run, list_index - 1, c, link):
        move_listed_link(run, list_index - 1, list_index)
        list_index -= 1
    note_link(run, list_index, k, gap, slack)
    run.counters[TOGETHER] += 1
    return list_index


@jit_separate
def is_listed_after(run: Run, a: int, c: int, link: int) -> bool:
    """Whether a link that is listed comes after another one."""
    k = int(run.touching[a, CANDIDATE])
    listed_assembly = run.candidates[k, ASSEMBLY]
    return bool(listed_assembly > c or (listed_assembly == c and run.candidates[k, LINK] > link))


@jit_separate
def move_listed_link(run: Run, source: int, target: int) -> None:
    """Move a link that is listed to another place."""
    for j in range(run.touching.shape[1]):
        run.touching[target, j] = run.touching[source, j]
    rows = run.counters[ROWS]
    for row in range(rows):
        old, new = rows * source + row, rows * target + row
        for i in range(run.normals.shape[1]):
            run.normals[new, i], run.unit_responses[new, i] = run.normals[old, i], run.unit_responses[old, i]
            run.coordinate_indices[new, i] = run.coordinate_indices[old, i]


@jit_separate
def note_link(run: Run, a: int, k: int, gap: float, slack: float) -> None:
    """Note a link that touches, from its pattern."""
    c = run.candidates[k, ASSEMBLY]
    assembly, pattern, self_response = run.assemblies[c], pattern_at(run.patterns[2 * c + 1]), 0.0
    row = int(run.counters[ROWS]) * a
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.unit_responses[row, i], run.coordinate_indices[row, i] = 0.0, 0.0, 0
    for i in range(assembly.coordinates):
        run.normals[row, i], run.unit_responses[row, i] = pattern.directions[0, i], pattern.responses[0, i]
        link, first, second = run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        run.coordinate_indices[row, i] = leaf_member(run, assembly.first_leaf + i, link, first, second)
        self_response += pattern.directions[0, i] * pattern.responses[0, i]
    numbers = run.touching
    numbers[a, CANDIDATE], numbers[a, GAP], numbers[a, SLACK], numbers[a, OWN] = k, gap, slack, self_response
    numbers[a, BOUNCE], numbers[a, TOTAL], numbers[a, LOST] = pattern.links[0].coefficient, 0.0, 0.0
    numbers[a, BIAS], numbers[a, GIVES_BACK] = pattern.links[0].free, 0.0
    numbers[a, SKIPS], numbers[a, LASTS], numbers[a, TAKEN], numbers[a, BOUNCES] = 0.0, 0.0, 0.0, 0.0
    rate_by_time = pattern.links[0].rate  # by time alone
    for i in range(assembly.coordinates):
        rate_by_time -= pattern.directions[0, i] * pattern.z[assembly.leaves + i]
    numbers[a, EARLY] = rate_by_time
    numbers[a, RATE] = pattern.links[0].rate
    if run.counters[ROWS] == 2:
        note_slip(run, a, k)


@jit_separate
def note_slip(run: Run, a: int, k: int) -> None:
    """Note the slip of a link that touches, from its pattern."""
    assembly, row, numbers = run.assemblies[run.candidates[k, ASSEMBLY]], 2 * a + 1, run.touching
    for j in range(RUBS, NUMBERS):
        numbers[a, j] = 0.0
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.unit_responses[row, i], run.coordinate_indices[row, i] = (
            0.0,
            0.0,
            run.coordinate_indices[row - 1, i],
        )
    if assembly.rubs == 0:
        return
    pattern, self_response, steep = pattern_at(run.patterns[2 * run.candidates[k, ASSEMBLY] + 1]), 0.0, 0.0
    slip_by_time, across = pattern.links[1].rate, 0.0
    for i in range(assembly.coordinates):
        run.normals[row, i], run.unit_responses[row, i] = pattern.directions[1, i], pattern.responses[1, i]
        self_response += pattern.directions[1, i] * pattern.responses[1, i]
        across += pattern.directions[1, i] * pattern.responses[0, i]
        steep += abs(pattern.directions[1, i])
        slip_by_time -= pattern.directions[1, i] * pattern.z[assembly.leaves + i]
    numbers[a, RUBS], numbers[a, KINETIC], numbers[a, STATIC] = 1.0, pattern.links[1].coefficient, pattern.links[1].most
    numbers[a, SLIP], numbers[a, SLIP_EARLY], numbers[a, SLIP_BIAS] = (
        pattern.links[1].rate,
        slip_by_time,
        pattern.links[1].free,
    )
    numbers[a, SLIP_SLACK], numbers[a, SLIP_OWN] = NOISE * steep * run.spans[FASTEST], self_response
    numbers[a, ACROSS] = across


@jit_separate
def sum_along_row(run: Run, row: int, total: float, first: int) -> float:
    """A row of a link times numbers of the trial's state, those of coordinates' owners from `first` on, added to a total."""
    for i in range(run.normals.shape[1]):
        total += run.normals[row, i] * run.z[first + run.coordinate_indices[row, i]]
    return total


@jit_separate
def gap_rate(run: Run, a: int) -> float:
    """The rate of a gap with the velocities as they are now."""
    return sum_along_row(run, int(run.counters[ROWS]) * a, run.touching[a, EARLY], run.plan[0].coordinates)


@jit_separate
def slip_of(run: Run, a: int) -> float:
    """The slip of a link with friction, with the velocities as they are now."""
    return sum_along_row(run, 2 * a + 1, run.touching[a, SLIP_EARLY], run.plan[0].coordinates)


@jit_separate
def acceleration_along(run: Run, row: int, bias: float) -> float:
    """The acceleration of a gap, or of a slip, with the accelerations of the trial's state."""
    return sum_along_row(run, row, bias, run.plan[0].used)


@jit_separate
def apply_impulse(run: Run, row: int, impulse: float) -> None:
    """Change velocities by an impulse along a row."""
    n = run.plan[0].coordinates
    for i in range(run.unit_responses.shape[1]):
        run.z[n + run.coordinate_indices[row, i]] += run.unit_responses[row, i] * impulse
