"""The narrow phase: the first links of a trial that meet, and the first closed links that release.

Pieces of the step are cut until every link is proven to stay apart, or meets. A link stays apart on a piece where its
gap is positive, or its rate nowhere negative; it meets where its rate is negative all over a piece that ends with a gap
that is not positive. States at cuts are those of shortened steps, put back on closed links, which moves bodies a
little: a link that sinks by that alone, though it does not approach, meets as well.

A closed link lifts, its grip breaks or its slip stops: at a step's end, or within a step at whose end it holds again.
Forces within a step are looked at on the cubic that its states and velocities leave: at its middle, for a method of
many stages at more places, and where a parabola through a force, or what is left of a grip, at start, middle and end
falls to zero. What is found there is found again in a shortened step before it counts; a step shortened to a release at
its end is looked into as well. What passes zero and returns between these places, by more than a parabola shows, is not
found. Where nothing changed by more than a twentieth in several steps, nor at their middles, only every sixteenth step
is looked into, and those in which something changes.
"""

from __future__ import annotations

from math import inf, nan
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS, SMOOTH
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import FORCES
from xdynamics.kernels.program import T
from xdynamics.march.assembly.broad_phase import (
    ASSEMBLY,
    CLOSE,
    COUNT,
    FASTEST,
    LEFT,
    LINK,
    NEAR,
    NOISE,
    QUIET,
    ROWS,
    STRAIN,
    WHOLE_STEP,
    enclose_motion,
    evaluate_candidate,
    gap_at,
    pattern_at,
    rate_at,
)
from xdynamics.march.assembly.closed_links import (
    AT_END,
    FIRST,
    LAST,
    MIDDLE,
    SCALE,
    SINCE,
    closed_index,
    closed_link_row,
    keep_passed_margins,
    least_margin,
    note_margins,
    release_of,
    size_of_forces,
)
from xdynamics.march.calls import call_law
from xdynamics.march.events.zero_tests import cannot_reach_zero
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers, restore_trial, store_trial, substep

State = NDArray[Any]
FREE, MEETS, OPEN = range(3)  # what is known of a link on a piece
MOST_TURNS = 200
INSIDE = 0.4  # of the time tolerance: how far beyond an estimated root the other side of it is looked for


@jit_separate
def find_first(run: Run) -> bool:
    """Shorten the trial to end just after links first meet; whether any do."""
    piece, trial = run.piece[0], run.trial[0]
    piece.part, run.counters[CLOSE] = 0, 0
    run.spans[FASTEST], run.spans[WHOLE_STEP] = (
        max(fastest_velocity(run), run.greatest[0], velocity_held_back(run)),
        trial.h,
    )
    for k in range(run.counters[COUNT]):
        is_near = run.candidates[k, NEAR] == 1
        if not is_near or closed_index(run, run.candidates[k, ASSEMBLY], run.candidates[k, LINK]) >= 0:
            continue
        pattern = pattern_at(run.patterns[2 * run.candidates[k, ASSEMBLY]])
        enclose_motion(run, pattern, run.y, run.z, k, False)
        value_index = pattern.detectors[0].value
        if pattern.under[value_index] > 0.0 and pattern.flaws[value_index] == SMOOTH:
            continue
        run.close[run.counters[CLOSE]] = k
        run.counters[CLOSE] += 1
    if run.counters[CLOSE] == 0:
        return False
    store_trial(run)
    start, last, budget, any_meets = 0.0, 0, MOST_SUBSTEPS, False
    push_piece(run, 0, trial.h)
    copy_numbers(run.y, run.near)
    while last >= 0 and not any_meets:
        end = run.branches[last, 0]
        for i in range(run.far.shape[0]):
            run.far[i] = run.branches[last, 1 + i]
        finest = budget <= 0 or last + 1 >= run.branches.shape[0]
        verdict = classify_links(run, start, end, finest)
        if verdict == OPEN:
            middle = (start + end) / 2.0
            substep(run, middle)
            last, budget = last + 1, budget - 1
            push_piece(run, last, middle)
        elif verdict == MEETS:
            close_in(run, start, end, True)
            any_meets = True
        else:
            last, start = last - 1, end
            copy_numbers(run.far, run.near)
    if not any_meets:
        restore_trial(run)
        run.piece[0].cut = int(run.piece[0].substeps > 0)
    return any_meets


@jit_separate
def fastest_velocity(run: Run) -> float:
    """The largest velocity at either end of the trial."""
    n, largest = run.plan[0].coordinates, 0.0
    for i in range(n, 2 * n):
        largest = max(largest, abs(run.y[i]), abs(run.z[i]))
    return largest


@jit_separate
def remember_fastest(run: Run) -> None:
    """Update the march's largest velocity, of which, with that of forces, the rounding of rates is a share."""
    run.greatest[0] = max(run.greatest[0], run.spans[FASTEST], velocity_held_back(run))


@jit_separate
def velocity_held_back(run: Run) -> float:
    """The largest velocity that the forces of closed links keep from bodies in the trial."""
    largest = 0.0
    for a in range(run.closed[0]):
        largest = max(largest, abs(run.loads[a]) / run.vectors[SCALE, closed_link_row(run, a)] ** 2)
    return largest * run.trial[0].h


@jit_separate
def push_piece(run: Run, k: int, s: float) -> None:
    """Keep the trial's state until the piece before it is done."""
    run.branches[k, 0] = s
    for i in range(run.z.shape[0]):
        run.branches[k, 1 + i] = run.z[i]


@jit_separate
def classify_links(run: Run, start: float, end: float, finest: bool) -> int:
    """Classify the close links on a piece: none meets, one meets, or the piece has to be cut."""
    piece, t, verdict = run.piece[0], run.now[0].t, FREE
    piece.start, piece.end, piece.width = t + start, t + end, end - start
    piece.part = int(end - start < run.spans[WHOLE_STEP])
    for m in range(run.counters[CLOSE]):
        link_verdict = judge_link(run, run.close[m], start, end, finest)
        run.meets[m] = link_verdict == MEETS
        if link_verdict == OPEN:
            return OPEN
        verdict = max(verdict, link_verdict)
    return verdict


@jit_separate
def judge_link(run: Run, k: int, start: float, end: float, finest: bool) -> int:
    """Classify a link on a piece."""
    pattern = pattern_at(run.patterns[2 * run.candidates[k, ASSEMBLY]])
    enclose_motion(run, pattern, run.near, run.far, k, True)
    value, slope = pattern.detectors[0].value, pattern.detectors[0].slope
    smooth = pattern.flaws[value] == SMOOTH and pattern.flaws[slope] == SMOOTH
    down, up = pattern.under[slope], pattern.over[slope]
    if smooth and pattern.under[value] > 0.0:
        return FREE
    slack = link_rate_noise(run, run.near, run.now[0].t + start, k)
    floor = -reach_of(run, k)
    gap_before, gap_after = gap_at(run, run.near, run.now[0].t + start, k), gap_at(run, run.far, run.now[0].t + end, k)
    sinks = gap_before > floor >= gap_after
    if smooth and down >= -slack and not sinks:
        return FREE
    if smooth and up < 0.0:
        return FREE if gap_after > 0.0 else MEETS
    # a gap that begins below zero, by what rounding left, and stays there is no free one
    if smooth and gap_before > 0.0 and cannot_reach_zero(gap_before, gap_after, down, up, end - start):
        return FREE
    if smooth and run.counters[ROWS] == 2 and gap_after > floor and is_parting(run, start, end, k, down, slack):
        return FREE
    if finest or end - start <= resolution_of(run, k, end):
        approaches = gap_after <= 0.0 and rate_at(run, run.far, run.now[0].t + end, k) < -slack
        return MEETS if sinks or approaches else FREE
    return OPEN


@jit_separate
def is_parting(run: Run, start: float, end: float, k: int, down: float, slack: float) -> bool:
    """Whether a link parts at both ends, and cannot sink farther between them than one that is located may.

    Of bodies that are pushed together, as in a heap, rates change by far less than the terms of their bounds.
    """
    sinks = -down * (end - start)
    if not sinks <= slack / NOISE * resolution_of(run, k, end):
        return False
    return rate_at(run, run.near, run.now[0].t + start, k) >= -slack <= rate_at(run, run.far, run.now[0].t + end, k)


@jit_separate
def link_rate_noise(run: Run, state: State, t: float, k: int) -> float:
    """How far from zero rounding may leave the rate of a link."""
    c = run.candidates[k, ASSEMBLY]
    evaluate_candidate(run, state, t, k)
    pattern, size = pattern_at(run.patterns[2 * c + 1]), 0.0
    for i in range(run.assemblies[c].coordinates):
        size += abs(pattern.directions[0, i])
    return NOISE * size * run.spans[FASTEST]


@jit_separate
def reach_of(run: Run, k: int) -> float:
    """How far from zero the gap of a link that touches may be, where `evaluate_candidate` looked: by rounding, and by its location."""
    c = run.candidates[k, ASSEMBLY]
    pattern = pattern_at(run.patterns[2 * c + 1])
    steep, size = 0.0, abs(pattern.links[0].gap)
    for i in range(run.assemblies[c].coordinates):
        steep += abs(pattern.directions[0, i])
        size += abs(pattern.directions[0, i] * pattern.z[i])
    return NOISE * size + 2.0 * steep * run.spans[FASTEST] * resolution_of(run, k, 0.0)


@jit_separate
def resolution_of(run: Run, k: int, s: float) -> float:
    """The width below which a piece is not cut any further for the sake of a link."""
    t = run.now[0].t
    return max(run.assemblies[run.candidates[k, ASSEMBLY]].tolerance, 2.0 * EPS * max(abs(t), abs(t + s)))


@jit_separate
def close_in(run: Run, start: float, end: float, of_gaps: bool) -> None:
    """Shorten the trial to end just after the first zero of a gap, or of a force, on a piece on which they fall."""
    low, high, s = start, end, end
    t, tolerance = run.now[0].t, finest_resolution(run, end)
    run.spans[LEFT], earlier = start, 4.0 * (end - start)
    copy_numbers(run.far, run.z)
    at_low = least_at_start(run, t + start, of_gaps)
    at_high = least_on_piece(run, run.far, t + end, of_gaps)
    turns = 0
    while high - low > tolerance and turns < MOST_TURNS:
        turns += 1
        low_is_nearer = abs(at_low) < abs(at_high)
        width = high - low
        # two zeros have no secant: halve, in plain Python as in machine code, where 0/0 is nan
        s = low + at_low / (at_low - at_high) * width if at_low != at_high else nan
        s = s + INSIDE * tolerance if low_is_nearer else s - INSIDE * tolerance
        # secants may creep: bisect while the bracket is over half of what it was at the last third turn
        if not low < s < high or width > earlier / 2.0:
            s = (low + high) / 2.0
        earlier = width if turns % 3 == 0 else earlier
        substep(run, s)
        value = least_gap(run, run.z, t + s) if of_gaps else least_margin(run)  # which the substep found
        if value > 0.0:
            low, at_low = s, value
        else:
            high, at_high = s, value
    if s != high or turns == 0:
        substep(run, high)
    run.spans[LEFT] = low


@jit_separate
def finest_resolution(run: Run, s: float) -> float:
    """The width to which the time of an event is located: that of the finest contact."""
    tolerance = inf
    for c in range(run.assemblies.shape[0]):
        tolerance = min(tolerance, run.assemblies[c].tolerance)
    return max(tolerance, 2.0 * EPS * max(abs(run.now[0].t), abs(run.now[0].t + s)))


@jit_separate
def least_at_start(run: Run, t: float, of_gaps: bool) -> float:
    """The least gap, or force of closed links, at the start of the piece."""
    if of_gaps:
        return least_gap(run, run.near, t)
    forces_at(run, run.near, t)
    note_margins(run, FIRST)
    return least_margin(run)


@jit_separate
def least_on_piece(run: Run, state: State, t: float, of_gaps: bool) -> float:
    """The least gap, or force of closed links, at a state of the piece."""
    if of_gaps:
        return least_gap(run, state, t)
    forces_at(run, state, t)
    return least_margin(run)


@jit_separate
def forces_at(run: Run, state: State, t: float) -> None:
    """Compute the forces of closed links at a state."""
    copy_numbers(state, run.probe)
    run.at[T] = t
    call_law(run.law[FORCES], run, run.probe, run.probe, 0)


@jit_separate
def least_gap(run: Run, state: State, t: float) -> float:
    """The least gap of the links that meet on the piece."""
    smallest = inf
    for m in range(run.counters[CLOSE]):
        if run.meets[m]:
            smallest = min(smallest, gap_at(run, state, t, run.close[m]))
    return smallest


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
    """Shorten the trial, or a part of it, to just after the first release, and store only that release."""
    copy_numbers(run.y, run.near)
    copy_numbers(run.z, run.far)
    close_in(run, 0.0, h, False)
    keep_passed_margins(run)
    run.release_functions[SINCE, 0] = -inf


@jit_separate
def any_release(run: Run) -> bool:
    """Store the release of each closed link by the last forces; whether there is any."""
    size, releases = size_of_forces(run), False
    for a in range(run.closed[0]):
        run.lifted[a] = release_of(run, a, size)
        releases = releases or run.lifted[a] > 0
    return releases


@jit_separate
def part_with_release(run: Run, h: float) -> float:
    """A part of a step by whose end something seems to happen to a closed link; 0 where nothing does."""
    # forces looked at on the way are no part of the march: what their equations leave must not end it
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
