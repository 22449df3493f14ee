"""Links that are closed: their gap stays zero, and a normal force holds it. Which they are, and each one at a state.

Of the arrays that links have in common, `normals`, `replies`, `reads` and `vectors`, those that are struck at an event
have the first half, closed ones the second, which begins at `closed_from`.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.links import member, pattern_at, touch_link
from xdynamics.march.run import Run

State = NDArray[Any]
# rows of `vectors`: the factor by which a link is scaled, what its rate, or acceleration, is to change by, and the
# solution; its gap and rate, the size of the terms of the gap, and of its derivatives; the rest is of `normal_forces`
SCALE, RIGHT, X, GAPS, RATES, ROUGHLY, STEEP, RESIDUE, WAY, IMAGE, WAY_IMAGE = range(11)
VECTORS = 11


@shared
def closed_from(run: Run) -> int:
    """The place of the first closed link in arrays of links."""
    return int(run.touching.shape[0])


@shared
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


@shared
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
        run.held[a, 0], run.held[a, 1], run.held[a, 2], run.held[a, 3] = c, link, first, second
        row = closed_from(run) + a
        for i in range(run.normals.shape[1]):
            run.reads[row, i], run.normals[row, i], run.replies[row, i] = 0, 0.0, 0.0
        for i in range(assembly.coordinates):
            run.reads[row, i] = member(run, assembly.first_leaf + i, link, first, second)


@shared
def look_at_closed(run: Run, t: float, state: State) -> None:
    """Compute of every closed link, at a state, its directions, gap and rate, and its acceleration, to be taken away."""
    accelerations = run.plan[0].used
    for a in range(run.closed[0]):
        c, row, own = run.held[a, 0], closed_from(run) + a, 0.0
        touch_link(run, state, t, c, run.held[a, 1], run.held[a, 2], run.held[a, 3])
        pattern = pattern_at(run.patterns[2 * c + 1])
        total, size, steep = pattern.links[0].free, abs(pattern.links[0].gap), 0.0
        for i in range(run.assemblies[c].coordinates):
            steep += abs(pattern.directions[0, i])
            size += abs(pattern.directions[0, i] * pattern.z[i])
            run.normals[row, i], run.replies[row, i] = pattern.directions[0, i], pattern.responses[0, i]
            own += pattern.directions[0, i] * pattern.responses[0, i]
            total += pattern.directions[0, i] * state[accelerations + run.reads[row, i]]
        scale = 1.0 / sqrt(own)
        run.vectors[SCALE, row], run.vectors[RIGHT, row] = scale, -total * scale
        run.vectors[GAPS, row], run.vectors[RATES, row] = pattern.links[0].gap, pattern.links[0].rate
        run.vectors[ROUGHLY, row], run.vectors[STEEP, row] = size, steep


@shared
def add_answers(run: Run, state: State, offset: int) -> None:
    """Add to a state, from a place on, what the solution for closed links changes there."""
    for a in range(run.closed[0]):
        row = closed_from(run) + a
        amount = run.vectors[X, row] * run.vectors[SCALE, row]
        for i in range(run.normals.shape[1]):
            state[offset + run.reads[row, i]] += run.replies[row, i] * amount
