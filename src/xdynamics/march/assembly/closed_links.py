"""Closed links: their list, their rows at a state, their effect on coordinates, the margins of their release.

The gap of a closed link stays zero, by a normal force. Of the arrays that links have in common, `normals`,
`unit_responses`, `coordinate_indices` and `vectors`, those that are struck at an event have the first half, closed ones
the second, which begins at `closed_from`. A link has a row; two where any link has friction, the second along its slip.

Forces, or impulses, of links act on all coordinates, which is summed in `swing`, and from there along each link. W, the
effect of each link on each, is never formed: one product with it is `clear_responses`, then `respond` for every link,
then `response_along` every link.

A margin of a closed link falls to zero where it lifts, its grip breaks or its slip stops; rounding may leave it below
zero by a bound. The search for releases, that for their times and the sharing of forces judge by margins alone.

Patterns are prepared as a march begins or goes on.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import (
    BEGUN,
    FAULT,
    MEETS,
    NOISE,
    READY,
    ROWS,
    SHARE,
    evaluate_link,
    leaf_member,
    pattern_at,
)
from xdynamics.march.calls import enclosed_by
from xdynamics.march.run import ALL, ENCLOSE, Lists, Run

State = NDArray[Any]
# rows of `vectors`: the factor by which a link is scaled, what its rate, or acceleration, is to change by, and the
# solution; its gap and rate, the size of the terms of the gap, and of its derivatives; of `normal_forces`: bounds of
# the solution; of a row along a slip: friction over the normal force, the most of it while there is no slip, and what
# it is where there is; the scale of a row while it holds; the impulse that a link gives back whatever the solution, by
# which friction is bounded, too; of `lemke_path`: what a link does, rates without impulses, others that are added to these,
# impulses and rates, and how these change as the others do; the rest is of `friction`
SCALE, RIGHT, X, GAPS, RATES, ROUGHLY, STEEP, RESIDUE, WAY, IMAGE, WAY_IMAGE = range(11)
LEAST, MOST, GRIP, DRAG, OWN_SCALE, LOAD, GIVEN, RATIO, AMISS, TRIED, TRIED_WAY, FIRST_X, RETURNED = range(11, 24)
PIECE, FREE, TOWARD, FORCE, FORCE_SLOPE, RATE, RATE_SLOPE = range(24, 31)
VECTORS = 31
PATHS = 48  # directions in which forces of links that hold and drag are solved for at once
FRICTIONLESS, STICKS, SLIDES_ON, SLIDES_BACK = range(4)  # what a closed link does along its slip


@jit_separate
def closed_from(run: Run) -> int:
    """The index of the first row of closed links in arrays of links."""
    return int(run.normals.shape[0] // 2)


@jit_separate
def closed_link_row(run: Run, a: int) -> int:
    """The row of a closed link; that along its slip, if any, comes next."""
    return closed_from(run) + int(run.counters[ROWS]) * a


@jit_separate
def rows_of_closed(run: Run) -> int:
    """How many rows closed links have."""
    return int(run.counters[ROWS] * run.closed[0])


@jit_separate
def grip_at(run: Run, a: int) -> int:
    """The grip of a closed link."""
    return int(run.grips[a]) if run.counters[ROWS] == 2 else FRICTIONLESS


@jit_separate
def closed_index(run: Run, c: int, link: int) -> int:
    """The number of a link among the closed ones, -1 if it is not closed."""
    number, low, high = run.assemblies[c].first_link + link, 0, run.closed[0]
    while low < high:
        middle = (low + high) // 2
        if run.closed[1 + middle] < number:
            low = middle + 1
        else:
            high = middle
    return low if low < run.closed[0] and run.closed[1 + low] == number else -1


@jit_separate
def recall_closed(run: Run, closed: Lists, first: int, count: int) -> bool:
    """List the closed links of a record's row, with their grips; whether the record lists any."""
    if run.plan[0].assemblies == 0 or count < 0 or run.plan[0].steps_over > 0:
        return False
    run.closed[0] = count
    for a in range(count):
        run.closed[1 + a] = closed[0, first + a]
        if run.grips.shape[0] > 0:
            run.grips[a] = closed[1, first + a]
    return True


@jit_separate
def list_ends(run: Run) -> None:
    """List assembly, link and elements of every closed link, and which coordinates it reads."""
    for a in range(run.closed[0]):
        c, number = 0, run.closed[1 + a]
        while c + 1 < run.assemblies.shape[0] and run.assemblies[c + 1].first_link <= number:
            c += 1
        assembly = run.assemblies[c]
        link, first, second = number - assembly.first_link, 0, 0
        if assembly.paired:
            second = link
            while second >= assembly.elements - 1 - first:
                second -= assembly.elements - 1 - first
                first += 1
            second += first + 1
        (
            run.closed_link_ends[a, 0],
            run.closed_link_ends[a, 1],
            run.closed_link_ends[a, 2],
            run.closed_link_ends[a, 3],
        ) = c, link, first, second
        for row in range(closed_link_row(run, a), closed_link_row(run, a + 1)):
            for i in range(run.normals.shape[1]):
                run.coordinate_indices[row, i], run.normals[row, i], run.unit_responses[row, i] = 0, 0.0, 0.0
            for i in range(assembly.coordinates):
                run.coordinate_indices[row, i] = leaf_member(run, assembly.first_leaf + i, link, first, second)


@jit_separate
def look_at_closed(run: Run, t: float, state: State) -> None:
    """Compute of every closed link, at a state, its directions, gap and rate, and its acceleration, to be taken away."""
    accelerations = run.plan[0].used
    for a in range(run.closed[0]):
        c, row, self_response = run.closed_link_ends[a, 0], closed_link_row(run, a), 0.0
        evaluate_link(
            run, state, t, c, run.closed_link_ends[a, 1], run.closed_link_ends[a, 2], run.closed_link_ends[a, 3]
        )
        pattern = pattern_at(run.patterns[2 * c + 1])
        total, size, steep = pattern.links[0].free, abs(pattern.links[0].gap), 0.0
        for i in range(run.assemblies[c].coordinates):
            steep += abs(pattern.directions[0, i])
            size += abs(pattern.directions[0, i] * pattern.z[i])
            run.normals[row, i], run.unit_responses[row, i] = pattern.directions[0, i], pattern.responses[0, i]
            self_response += pattern.directions[0, i] * pattern.responses[0, i]
            total += pattern.directions[0, i] * state[accelerations + run.coordinate_indices[row, i]]
        scale = 1.0 / sqrt(self_response)
        run.vectors[SCALE, row], run.vectors[RIGHT, row] = scale, -total * scale
        run.vectors[GAPS, row], run.vectors[RATES, row] = pattern.links[0].gap, pattern.links[0].rate
        run.vectors[ROUGHLY, row], run.vectors[STEEP, row] = size, steep
        if run.counters[ROWS] == 2:
            look_along_slip(run, a, state)


@jit_separate
def look_along_slip(run: Run, a: int, state: State) -> None:
    """Compute the row along the slip of a closed link, whose normal row is known; a sliding link has no force."""
    c, row, self_response, steep, accelerations = (
        run.closed_link_ends[a, 0],
        closed_link_row(run, a) + 1,
        0.0,
        0.0,
        run.plan[0].used,
    )
    for vector in range(run.vectors.shape[0]):
        run.vectors[vector, row] = 0.0
    if run.assemblies[c].rubs == 0:
        return
    pattern = pattern_at(run.patterns[2 * c + 1])
    total = pattern.links[1].free
    for i in range(run.assemblies[c].coordinates):
        steep += abs(pattern.directions[1, i])
        run.normals[row, i], run.unit_responses[row, i] = pattern.directions[1, i], pattern.responses[1, i]
        self_response += pattern.directions[1, i] * pattern.responses[1, i]
        total += pattern.directions[1, i] * state[accelerations + run.coordinate_indices[row, i]]
    scale, grip = 1.0 / sqrt(self_response), run.grips[a]
    run.vectors[OWN_SCALE, row] = scale
    run.vectors[RATES, row], run.vectors[STEEP, row] = pattern.links[1].rate, steep
    run.vectors[ROUGHLY, row] = total
    if grip == STICKS:
        run.vectors[GRIP, row] = pattern.links[1].most
        run.vectors[SCALE, row], run.vectors[RIGHT, row] = scale, -total * scale
    else:
        run.vectors[DRAG, row] = (-1.0 if grip == SLIDES_ON else 1.0) * pattern.links[1].coefficient


@jit_separate
def add_answers(run: Run, state: State, offset: int) -> None:
    """Add the responses to the solved forces of closed links to a state, from an index on."""
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        amount = run.vectors[X, row] * run.vectors[SCALE, row]
        for i in range(run.normals.shape[1]):
            state[offset + run.coordinate_indices[row, i]] += run.unit_responses[row, i] * amount


@jit_separate
def clear_responses(run: Run, first: int, rows: int) -> None:
    """Clear the responses of every coordinate that rows read."""
    for row in range(first, first + rows):
        for i in range(run.coordinate_indices.shape[1]):
            run.swing[run.coordinate_indices[row, i]] = 0.0


@jit_separate
def respond(run: Run, row: int, amount: float) -> None:
    """Add the response of coordinates to a force along a row."""
    for i in range(run.coordinate_indices.shape[1]):
        run.swing[run.coordinate_indices[row, i]] += run.unit_responses[row, i] * amount


@jit_separate
def response_along(run: Run, row: int) -> float:
    """The sum of all added responses along a row."""
    total = 0.0
    for i in range(run.coordinate_indices.shape[1]):
        total += run.normals[row, i] * run.swing[run.coordinate_indices[row, i]]
    return total


@jit_separate
def prepare_patterns(run: Run) -> None:
    """Copy the run's parameters to patterns, list the coordinates of closed links, and discard all boxes."""
    run.counters[BEGUN], run.counters[FAULT], run.counters[MEETS], run.spans[SHARE] = 0, 0, 0, 1.0
    for k in range(run.handed.shape[0]):
        pattern = pattern_at(run.patterns[run.handed[k, 0]])
        pattern.p[run.handed[k, 1]] = run.p[run.handed[k, 2]]
    for c in range(run.patterns.shape[0]):
        pattern = pattern_at(run.patterns[c])
        enclosed_by(pattern.functions[ENCLOSE], pattern, pattern.y, pattern.y, 0, pattern.parts[0], ALL)
    list_ends(run)
    run.counters[READY] = 1


LIFTING = 1e-10  # of the largest force: a pull, or a drag beyond its bound, that is smaller may be rounding
LIFTS, BREAKS, STOPS = range(1, 4)  # what happens to a closed link: its force, its grip, or its slip passes zero
# rows of `margins`: at start, middle and end of a step, its start, and what happens at its end
FIRST, MIDDLE, LAST, SINCE, AT_END = range(5)


@jit_separate
def margin(run: Run, a: int, release_kind: int) -> float:
    """The margin of a closed link, which falls to zero where it lifts, its grip breaks, or its slip stops."""
    row = closed_link_row(run, a)
    if release_kind == LIFTS:
        return float(run.loads[a])
    if release_kind == BREAKS:
        return float(run.vectors[GRIP, row + 1] * run.loads[a] - abs(run.pulls[a]))
    return slip_on(run, a)


@jit_separate
def slip_on(run: Run, a: int) -> float:
    """The slip of a link that slides, in the direction in which it began to."""
    from_row = run.vectors[RATES, closed_link_row(run, a) + 1]
    return float(from_row if run.grips[a] == SLIDES_ON else -from_row)


@jit_separate
def margin_rounding(run: Run, a: int, release_kind: int, size: float) -> float:
    """How far below zero rounding may leave a margin, with forces of a size."""
    row = closed_link_row(run, a)
    if release_kind == LIFTS:
        return float(LIFTING * size * run.vectors[SCALE, row])
    if release_kind == BREAKS:
        return float(LIFTING * size * run.vectors[OWN_SCALE, row + 1])
    return float(NOISE * run.vectors[STEEP, row + 1] * run.greatest[0])


@jit_separate
def size_of_forces(run: Run) -> float:
    """The largest scaled force of closed links, or acceleration that they oppose, of the last solution."""
    size = 0.0
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        size = max(size, abs(run.vectors[X, row]), abs(run.vectors[RIGHT, row]))
    return size


@jit_separate
def release_of(run: Run, a: int, size: float) -> int:
    """The release of a closed link by the last forces, whose size is given; 0 for none."""
    if margin(run, a, LIFTS) < -margin_rounding(run, a, LIFTS, size):
        return LIFTS
    grip = grip_at(run, a)
    if grip == FRICTIONLESS:
        return 0
    release_kind = BREAKS if grip == STICKS else STOPS
    return release_kind if margin(run, a, release_kind) < -margin_rounding(run, a, release_kind, size) else 0


@jit_separate
def note_margins(run: Run, margin_row: int) -> None:
    """Store the margins of every closed link: its normal force, and the rest of its grip, or its slip."""
    for a in range(run.closed[0]):
        grip = grip_at(run, a)
        run.release_functions[margin_row, 2 * a], run.release_functions[margin_row, 2 * a + 1] = (
            margin(run, a, LIFTS),
            inf,
        )
        if grip != FRICTIONLESS:
            run.release_functions[margin_row, 2 * a + 1] = margin(run, a, BREAKS if grip == STICKS else STOPS)


@jit_separate
def least_margin(run: Run) -> float:
    """The least margin of releasing links in the trial, by the last forces.

    One that rounding cannot tell from zero where the search begins, as a slip that has just begun, falls to below zero by as
    much.
    """
    smallest, size = inf, size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0:
            smallest = min(smallest, remaining_margin(run, a, size))
    return smallest


@jit_separate
def remaining_margin(run: Run, a: int, size: float) -> float:
    """The margin of a releasing link, by forces of a given size, plus rounding if the margin began as rounding."""
    release_kind = run.lifted[a]
    begins, rounding = (
        run.release_functions[FIRST, 2 * a + (0 if release_kind == LIFTS else 1)],
        margin_rounding(run, a, release_kind, size),
    )
    return float(margin(run, a, release_kind) + (rounding if begins <= rounding else 0.0))


@jit_separate
def keep_passed_margins(run: Run) -> None:
    """Discard releases whose margin has not reached zero by the end that the trial was shortened to."""
    size = size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0 and remaining_margin(run, a, size) > 0.0:
            run.lifted[a] = 0
