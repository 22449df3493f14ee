"""When a closed link lifts, its grip breaks or its slip stops: at a step's end, or within a step at whose end it holds again.

Forces within a step are looked at on the cubic that its states and velocities leave: at its middle, for a method of many
stages at more places, and where a parabola through a force, or what is left of a grip, at start, middle and end falls to
zero. What is found there is found again in a shortened step before it counts; a step shortened to a release at its end is
looked into as well. What passes zero and returns between these places, by more than a parabola shows, is not found. Where
nothing changed by more than a twentieth in several steps, nor at their middles, only every sixteenth step is looked into,
and those in which something changes.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import QUIET, STRAIN
from xdynamics.march.assembly.margins import (
    AT_END,
    FIRST,
    LAST,
    MIDDLE,
    SINCE,
    keep_passed_margins,
    note_margins,
    release_of,
    size_of_forces,
)
from xdynamics.march.assembly.narrow_phase import close_in, forces_at
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers, restore_trial, store_trial, substep

STEADY, STEADY_STEPS, SIXTEENTH = 0.05, 3, 16  # what is no change; steps in a row after which few are looked into
STAGES_FOR_ONE = 8  # of a method, for each two further places at which forces are looked at


@jit_separate
def find_release(run: Run) -> bool:
    """Shorten the trial to end just after a closed link lifts, its grip breaks or its slip stops; whether one does."""
    if run.closed[0] == 0:
        return False
    if run.piece[0].substeps > 0:  # else they are those of the trial's last evaluation
        forces_at(run, run.z, run.trial[0].t)
    ends = any_release(run)
    if ends:
        shorten_to_release(run, run.trial[0].h)
        for a in range(run.closed[0]):
            run.release_functions[AT_END, a] = run.lifted[a]
    s = part_with_release(run, run.trial[0].h)
    if s > 0.0 and is_confirmed(run, s):
        shorten_to_release(run, s)
        return True
    if ends:
        forces_at(run, run.z, run.trial[0].t)
        for a in range(run.closed[0]):
            run.lifted[a] = int(run.release_functions[AT_END, a])
        run.release_functions[SINCE, 0] = -inf
    return ends


@jit_separate
def shorten_to_release(run: Run, h: float) -> None:
    """Shorten the trial, or a part of it, to end just after the first of what happens to links by its end; note only that."""
    copy_numbers(run.y, run.near)
    copy_numbers(run.z, run.far)
    close_in(run, 0.0, h, False)
    keep_passed_margins(run)
    run.release_functions[SINCE, 0] = -inf


@jit_separate
def any_release(run: Run) -> bool:
    """Note what happens to each closed link by the forces just found; whether anything does."""
    size, releases = size_of_forces(run), False
    for a in range(run.closed[0]):
        run.lifted[a] = release_of(run, a, size)
        releases = releases or run.lifted[a] > 0
    return releases


@jit_separate
def part_with_release(run: Run, h: float) -> float:
    """A part of a step by whose end something seems to happen to a closed link; 0 where nothing does."""
    strain, share = run.spans[STRAIN], 0.0
    note_margins(run, LAST)
    if run.release_functions[SINCE, 0] != run.now[0].t:
        forces_at(run, run.y, run.now[0].t)
        note_margins(run, FIRST)
        run.counters[QUIET] = 0
    steady, quiet = is_steady(run, LAST), run.counters[QUIET]
    if not steady or quiet < STEADY_STEPS or quiet % SIXTEENTH == 0:
        share = first_release_part(run, h)
        steady = steady and is_steady(run, MIDDLE)
    run.counters[QUIET] = quiet + 1 if steady else 0
    for i in range(run.release_functions.shape[1]):
        run.release_functions[FIRST, i] = run.release_functions[LAST, i]
    run.release_functions[SINCE, 0] = run.trial[0].t
    run.spans[STRAIN] = strain
    for a in range(run.closed[0]):
        run.lifted[a] = 0
    return share * h


@jit_separate
def is_steady(run: Run, margin_row: int) -> bool:
    """Whether nothing of a closed link has changed much since the step's start."""
    steady = True
    for i in range(2 * run.closed[0]):
        start, now = run.release_functions[FIRST, i], run.release_functions[margin_row, i]
        steady = steady and (start == now or abs(now - start) <= STEADY * min(start, now))
    return steady


@jit_separate
def first_release_part(run: Run, h: float) -> float:
    """The part of a step at which something seems to happen: one of those looked at, or the lowest; 0 where nothing does."""
    count = 1 + 2 * (run.plan[0].stages // STAGES_FOR_ONE)
    for k in range(count):
        share = (k + 1.0) / (count + 1.0)
        releases = seems_to_release(run, share, h)
        if 2 * k + 1 == count:
            note_margins(run, MIDDLE)
        if releases:
            return share
    share = lowest_margin_part(run)
    return share if 0.0 < share < 1.0 and seems_to_release(run, share, h) else 0.0


@jit_separate
def seems_to_release(run: Run, share: float, h: float) -> bool:
    """Whether something happens at a part of a step, by the cubic of its states; first-order states go straight."""
    n, start_state, end_state = run.plan[0].coordinates, run.y, run.z
    for i in range(run.far.shape[0]):
        run.far[i] = start_state[i] + share * (end_state[i] - start_state[i])
    for i in range(n):
        v0, v1, mean = start_state[n + i], end_state[n + i], (end_state[i] - start_state[i]) / h
        bend, twist = 3.0 * mean - 2.0 * v0 - v1, v0 + v1 - 2.0 * mean
        run.far[i] = start_state[i] + h * share * (v0 + share * (bend + share * twist))
        run.far[n + i] = v0 + share * (2.0 * bend + share * 3.0 * twist)
    forces_at(run, run.far, run.now[0].t + share * h)
    return any_release(run)


@jit_separate
def lowest_margin_part(run: Run) -> float:
    """The first part of a step at which a parabola through three margins is lowest, of those that are below zero there."""
    first = inf
    for i in range(2 * run.closed[0]):
        start, middle, end = (
            run.release_functions[FIRST, i],
            run.release_functions[MIDDLE, i],
            run.release_functions[LAST, i],
        )
        bend = 2.0 * (start - 2.0 * middle + end)
        slope = 4.0 * middle - 3.0 * start - end
        if 0.0 < bend < inf and 0.0 < -slope < 2.0 * bend and start - slope * slope / (4.0 * bend) < 0.0:
            first = min(first, -slope / (2.0 * bend))
    return first


@jit_separate
def is_confirmed(run: Run, s: float) -> bool:
    """Whether something happens to a closed link in a step that is shortened; else the trial is as it was."""
    strain = run.spans[STRAIN]
    store_trial(run)
    substep(run, s)
    if any_release(run):
        return True
    restore_trial(run)
    run.piece[0].cut, run.spans[STRAIN] = 1, strain
    return False
