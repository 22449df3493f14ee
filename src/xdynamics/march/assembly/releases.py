"""When a closed link lifts, its grip breaks or its slip stops: at a step's end, or within a step at whose end it holds again.

Forces within a step are looked at on the cubic that its states and velocities leave: at its middle, for a method of many
stages at more places, and where a parabola through a force, or what is left of a grip, at start, middle and end falls to
zero. What is found there is found again in a shortened step before it counts. What passes zero and returns between these
places, by more than a parabola shows, is not found. Where nothing changed by more than a twentieth in several steps, nor
at their middles, only every sixteenth step is looked into, and those in which something changes.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.broad_phase import QUIET, STRAIN
from xdynamics.march.assembly.closed_links import (
    FRICTIONLESS,
    OWN_SCALE,
    RIGHT,
    SLIDES_ON,
    STEEP,
    STICKS,
    X,
    closed_from,
    grip_at,
    row_of,
    rows_of_closed,
)
from xdynamics.march.assembly.friction import BREAKS, LIFTING, LIFTS, STOPS, margin
from xdynamics.march.assembly.narrow_phase import NOISE, close_in, forces_at
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy, keep, substep, take

FIRST, MIDDLE, LAST, SINCE = range(4)  # rows of `margins`: at start, middle and end of a step, and its start
STEADY, STEADY_STEPS, SIXTEENTH = 0.05, 3, 16  # what is no change; steps in a row after which few are looked into
STAGES_FOR_ONE = 8  # of a method, for each two further places at which forces are looked at


@shared
def find_release(run: Run) -> bool:
    """Shorten the trial to end just after a closed link lifts, its grip breaks or its slip stops; whether one does."""
    if run.closed[0] == 0:
        return False
    h = run.trial[0].h
    if run.piece[0].substeps > 0:  # else they are those of the trial's last evaluation
        forces_at(run, run.z, run.trial[0].t)
    releases = any_release(run)
    if not releases:
        s = within(run, h)
        releases = s > 0.0 and is_confirmed(run, s)
        h = s if releases else h
    if releases:
        copy(run.y, run.near)
        copy(run.z, run.far)
        close_in(run, 0.0, h, False)
        run.margins[SINCE, 0] = -inf
    return releases


@shared
def any_release(run: Run) -> bool:
    """Note what happens to each closed link by the forces just found; whether anything does."""
    size, releases = 0.0, False
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        size = max(size, abs(run.vectors[X, row]), abs(run.vectors[RIGHT, row]))
    for a in range(run.closed[0]):
        run.lifted[a] = release_of(run, a, size)
        releases = releases or run.lifted[a] > 0
    return releases


@shared
def release_of(run: Run, a: int, size: float) -> int:
    """What happens to a closed link by the forces just found, of a size; 0 for nothing."""
    row, grip = row_of(run, a), grip_at(run, a)
    if run.vectors[X, row] < -LIFTING * size:
        return LIFTS
    if grip == STICKS and margin(run, a, BREAKS) < -LIFTING * size * run.vectors[OWN_SCALE, row + 1]:
        return BREAKS
    if grip >= SLIDES_ON and margin(run, a, STOPS) < -NOISE * run.vectors[STEEP, row + 1] * run.greatest[0]:
        return STOPS
    return 0


@shared
def within(run: Run, h: float) -> float:
    """A part of a step by whose end something seems to happen to a closed link; 0 where nothing does."""
    strain, share = run.spans[STRAIN], 0.0
    note_margins(run, LAST)
    if run.margins[SINCE, 0] != run.now[0].t:
        forces_at(run, run.y, run.now[0].t)
        note_margins(run, FIRST)
        run.tallies[QUIET] = 0
    steady, quiet = is_steady(run, LAST), run.tallies[QUIET]
    if not steady or quiet < STEADY_STEPS or quiet % SIXTEENTH == 0:
        share = first_inside(run, h)
        steady = steady and is_steady(run, MIDDLE)
    run.tallies[QUIET] = quiet + 1 if steady else 0
    for i in range(run.margins.shape[1]):
        run.margins[FIRST, i] = run.margins[LAST, i]
    run.margins[SINCE, 0] = run.trial[0].t
    run.spans[STRAIN] = strain
    for a in range(run.closed[0]):
        run.lifted[a] = 0
    return share * h


@shared
def is_steady(run: Run, place: int) -> bool:
    """Whether nothing of a closed link has changed much since the step's start."""
    steady = True
    for i in range(2 * run.closed[0]):
        start, now = run.margins[FIRST, i], run.margins[place, i]
        steady = steady and (start == now or abs(now - start) <= STEADY * min(start, now))
    return steady


@shared
def first_inside(run: Run, h: float) -> float:
    """The part of a step at which something seems to happen: one of those looked at, or the lowest; 0 where nothing does."""
    count = 1 + 2 * (run.plan[0].stages // STAGES_FOR_ONE)
    for k in range(count):
        share = (k + 1.0) / (count + 1.0)
        releases = seems_to_release(run, share, h)
        if 2 * k + 1 == count:
            note_margins(run, MIDDLE)
        if releases:
            return share
    share = lowest(run)
    return share if 0.0 < share < 1.0 and seems_to_release(run, share, h) else 0.0


@shared
def note_margins(run: Run, place: int) -> None:
    """Note what may fall to zero of every closed link: its force, and what is left of its grip, or its slip."""
    for a in range(run.closed[0]):
        grip = grip_at(run, a)
        run.margins[place, 2 * a], run.margins[place, 2 * a + 1] = margin(run, a, LIFTS), inf
        if grip != FRICTIONLESS:
            run.margins[place, 2 * a + 1] = margin(run, a, BREAKS if grip == STICKS else STOPS)


@shared
def seems_to_release(run: Run, share: float, h: float) -> bool:
    """Whether something happens at a part of a step, by the cubic of its states; first-order states go straight."""
    n, before, after = run.plan[0].coordinates, run.y, run.z
    for i in range(run.far.shape[0]):
        run.far[i] = before[i] + share * (after[i] - before[i])
    for i in range(n):
        v0, v1, mean = before[n + i], after[n + i], (after[i] - before[i]) / h
        bend, twist = 3.0 * mean - 2.0 * v0 - v1, v0 + v1 - 2.0 * mean
        run.far[i] = before[i] + h * share * (v0 + share * (bend + share * twist))
        run.far[n + i] = v0 + share * (2.0 * bend + share * 3.0 * twist)
    forces_at(run, run.far, run.now[0].t + share * h)
    return any_release(run)


@shared
def lowest(run: Run) -> float:
    """The first part of a step at which a parabola through three margins is lowest, of those that are below zero there."""
    first = inf
    for i in range(2 * run.closed[0]):
        start, middle, end = run.margins[FIRST, i], run.margins[MIDDLE, i], run.margins[LAST, i]
        bend = 2.0 * (start - 2.0 * middle + end)
        slope = 4.0 * middle - 3.0 * start - end
        if 0.0 < bend < inf and 0.0 < -slope < 2.0 * bend and start - slope * slope / (4.0 * bend) < 0.0:
            first = min(first, -slope / (2.0 * bend))
    return first


@shared
def is_confirmed(run: Run, s: float) -> bool:
    """Whether something happens to a closed link in a step that is shortened; else the trial is as it was."""
    strain = run.spans[STRAIN]
    keep(run)
    substep(run, s)
    if any_release(run):
        return True
    take(run)
    run.piece[0].cut, run.spans[STRAIN] = 1, strain
    return False
