"""The broad phase: boxes of coordinates, and the links that may meet while every coordinate stays in its box.

A link is left out where its gap is positive all over its boxes. As long as every coordinate stays in its box, and
`keep_boxes` proves that for every step, no link that was left out can meet. Elements near each other are in one group;
a group whose hull proves that all its links are apart is left out whole (Ericson, Real-Time Collision Detection, 2005,
chapter 6). Within its box each coordinate has a narrow one, for few steps: candidates that narrow boxes prove to be
apart are not bounded in these steps.

A link's gap is enclosed, or evaluated at a state, by the programs of its pattern. The pattern is a run of its own, of
one link whose coordinates are what the gap reads; numbers of a link are copied there.
"""

from __future__ import annotations

from math import inf
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS, SMOOTH
from xdynamics.kernels.compiling import PLAINLY, UNCOMPILED, jit_separate
from xdynamics.kernels.interval_program import VARIABLE
from xdynamics.kernels.law import DETECT, SLOPES, TOUCHING
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law, enclosed_by, row_by, run_at
from xdynamics.march.run import ALL, ENCLOSE, Run

State = NDArray[Any]
# of a leaf: its first member, what they are counted by, whether it moves, the place of its interval, 1 at a second end
BASE, FAMILY, MOVES, TARGET, END = range(5)
ASSEMBLY, LINK, FIRST, SECOND, NEAR = range(5)  # of a candidate; whether narrow boxes do not prove it apart
WIDE, NARROW = 0, 2  # of the rows of boxes, the lower end of each
NOISE = 64.0 * EPS  # of the terms of a gap, or a rate: what rounding may leave

pattern_at: Any = UNCOMPILED.__getitem__ if PLAINLY else run_at


@jit_separate
def leaf_member(run: Run, leaf: int, link: int, first: int, second: int) -> int:
    """The index of the number that a leaf of a link reads, among coordinates or parameters."""
    family = run.pattern_inputs[leaf, FAMILY]
    entity = link if family == 0 else (first if family == 1 else second)
    return int(run.members[run.pattern_inputs[leaf, BASE] + entity])


@jit_separate
def gather_link_state(run: Run, state: State, target: State, c: int, link: int, first: int, second: int) -> None:
    """Copy the numbers of a state that a link reads to a state of the pattern."""
    assembly = run.assemblies[c]
    n, count = run.plan[0].coordinates, assembly.leaves
    for k in range(count):
        leaf = assembly.first_leaf + k
        source_index = leaf_member(run, leaf, link, first, second)
        if run.pattern_inputs[leaf, MOVES]:
            target[k], target[count + k] = state[source_index], state[n + source_index]
            target[2 * count + k] = state[run.plan[0].used + source_index]
        else:
            target[k], target[count + k], target[2 * count + k] = run.p[source_index], 0.0, 0.0


@jit_separate
def enclose_motion(run: Run, pattern: Run, y: State, z: State, k: int, slope: bool) -> None:
    """Enclose the gap of a candidate, perhaps its rate too, between two states; `run.piece` has their times."""
    c, link, first, second = run.candidates[k, 0], run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
    gather_link_state(run, y, pattern.y, c, link, first, second)
    gather_link_state(run, z, pattern.z, c, link, first, second)
    piece, pattern_piece = run.piece[0], pattern.piece[0]
    pattern_piece.start, pattern_piece.end, pattern_piece.width, pattern_piece.wide = (
        piece.start,
        piece.end,
        piece.width,
        0.0,
    )
    pattern_piece.part, pattern_piece.rough = piece.part, 0
    last = pattern.parts[2] if slope else pattern.parts[1]
    enclosed_by(pattern.functions[ENCLOSE], pattern, pattern.y, pattern.z, pattern.parts[0], last, ALL)


@jit_separate
def is_apart(pattern: Run) -> bool:
    """Whether the gap is positive wherever the leaves, whose bounds have been given, may be."""
    # 2 keeps the bounds that were given: `enclose_functions` does not enclose variables anew
    pattern.piece[0].rough = 2
    y = pattern.y
    enclosed_by(pattern.functions[ENCLOSE], pattern, y, y, pattern.parts[0], pattern.parts[1], ALL)
    value_index = pattern.detectors[0].value
    return bool(pattern.flaws[value_index] == SMOOTH and pattern.under[value_index] > 0.0)


@jit_separate
def bound_leaf(run: Run, pattern: Run, leaf: int, member_index: int, which: int) -> None:
    """Give the bounds of one leaf, those of the wide or narrow box of a coordinate, or a parameter."""
    target = run.pattern_inputs[leaf, TARGET]
    if target >= 0:
        moves = run.pattern_inputs[leaf, MOVES]
        pattern.under[target] = run.boxes[which, member_index] if moves else run.p[member_index]
        pattern.over[target] = run.boxes[which + 1, member_index] if moves else run.p[member_index]
        pattern.flaws[target] = SMOOTH


@jit_separate
def candidate_at(run: Run, state: State, t: float, k: int) -> Run:
    """Return the first pattern of a candidate, at a state."""
    c = run.candidates[k, ASSEMBLY]
    pattern = pattern_at(run.patterns[2 * c])
    gather_link_state(run, state, pattern.y, c, run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3])
    pattern.at[T] = t
    return pattern


@jit_separate
def gap_at(run: Run, state: State, t: float, k: int) -> float:
    """The gap of a candidate at a state."""
    pattern = candidate_at(run, state, t, k)
    call_law(pattern.law[DETECT], pattern, pattern.y, pattern.g, 0)
    return float(pattern.g[0])


@jit_separate
def rate_at(run: Run, state: State, t: float, k: int) -> float:
    """The rate of the gap of a candidate at a state."""
    pattern = candidate_at(run, state, t, k)
    call_law(pattern.law[SLOPES], pattern, pattern.y, pattern.slopes, 0)
    return float(pattern.slopes[0])


@jit_separate
def evaluate_candidate(run: Run, state: State, t: float, k: int) -> None:
    """Compute gap, rate, restitution and the directions of a candidate; they stand in the second pattern."""
    c = run.candidates[k, ASSEMBLY]
    evaluate_link(run, state, t, c, run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3])


@jit_separate
def evaluate_link(run: Run, state: State, t: float, c: int, link: int, first: int, second: int) -> None:
    """Evaluate the gap of a link, by its number and its elements, at a state."""
    pattern = pattern_at(run.patterns[2 * c + 1])
    gather_link_state(run, state, pattern.z, c, link, first, second)
    pattern.at[T] = t
    call_law(pattern.law[TOUCHING], pattern, pattern.z, pattern.contact_tables, 0)


# of `counters`: candidates, those that are close, whether there are boxes, elements with new boxes since they were last
# arranged; whether links meet, how many touch; what was wrong, with which assembly and link; slots of impulses, where the
# trial was to land
# whether patterns have the parameters of the run; rows of a link in systems of equations: two where there is friction;
# steps in a row in which forces of closed links hardly changed; events that followed each other within what times are
# located to; links whose slip was stopped by more than their friction, with assembly and link of the worst; landings in
# a row, soon after one another, at which nothing changed
COUNT, CLOSE, BEGUN, RENEWALS, MEETS, TOGETHER, FAULT, CULPRIT, CULPRIT_LINK, SLOTS, LANDING, READY = range(12)
ROWS, QUIET, HASTE, OUTSIDE, OUTSIDE_OF, OUTSIDE_LINK, IDLE = range(12, 19)
TALLIES = 19
OVERLAP, CROWDED, UNSOLVED, STRAINED, BOUNCED, SHIFTED, ENERGY, RUBBED, HASTY, SHARED, UNDECIDED = range(
    1, 12
)  # what was wrong
# of `spans`; from `STRAIN` on the residual of the forces of closed links, over the size of their terms; how far a closed
# gap is from zero beyond what is allowed; energy that an event took, and that moving surfaces gave, with their terms;
# the largest coefficient of friction, over that of its link, that an impulse needed which stopped a slip, and when; how
# much of a step over impacts a state inside it is reached by, if it is
SHARE, WHOLE_STEP, LEFT, RESIDUAL, FASTEST, DEPTH, AIM, STRAIN, ASTRAY, LOSS, WORK, TERMS, FIGURE, NEEDED, NEEDED_AT = (
    range(15)
)
SPREAD = 15
GROUP = 16  # elements of a group
AHEAD = 32.0  # steps that a box is to last, at the velocities of the step
NARROWER = 1.0 / 16.0  # of the width of a box: how far a narrow one reaches beyond the step
SAME, NARROW_ONE, BOTH = range(3)  # which boxes of a coordinate are new
UNSURE = 256.0 * EPS  # of the ends of a box
LEAST_SHARE = 1e-3  # of that, below which smaller boxes leave no fewer candidates


@jit_separate
def blame(run: Run, fault: int, c: int, link: int) -> None:
    """Note a fault, and its link."""
    run.counters[FAULT], run.counters[CULPRIT], run.counters[CULPRIT_LINK] = fault, c, link


@jit_separate
def keep_boxes(run: Run) -> bool:
    """Extend boxes until each contains its coordinate over the trial, and renew the candidates if any changed.

    Returns
    -------
    bool
        False where there is no room for all candidates.
    """
    while fit_boxes(run):
        if list_candidates(run):
            run.counters[BEGUN] = 1
            break
        if run.spans[SHARE] < LEAST_SHARE:
            return False
        run.spans[SHARE] /= 2.0  # smaller boxes, fewer candidates
        run.counters[BEGUN] = 0
    mark_near(run)
    return True


@jit_separate
def fit_boxes(run: Run) -> bool:
    """Make new boxes of coordinates that leave theirs in the trial; whether any left its wide one."""
    n, any_renewed = run.plan[0].coordinates, False
    # one rule encloses any coordinate between two states, so that the first pattern's serves for all
    pattern, first = pattern_at(run.patterns[0]), run.assemblies[0]
    pattern_piece, piece = pattern.piece[0], run.piece[0]
    (
        pattern_piece.start,
        pattern_piece.end,
        pattern_piece.width,
        pattern_piece.wide,
        pattern_piece.part,
        pattern_piece.rough,
    ) = piece.start, piece.end, piece.width, 0.0, 0, 0
    row, leaf, count, accelerations = first.row, first.row_leaf, first.leaves, run.plan[0].used
    target = run.pattern_inputs[first.first_leaf + leaf, TARGET]
    for i in range(n):
        run.renewed[i] = SAME
        if run.counters[BEGUN] == 1 and stays_in_narrow_box(run, i, piece.width):
            continue
        pattern.y[leaf], pattern.z[leaf] = run.y[i], run.z[i]
        pattern.y[count + leaf], pattern.z[count + leaf] = run.y[n + i], run.z[n + i]
        pattern.y[2 * count + leaf], pattern.z[2 * count + leaf] = run.y[accelerations + i], run.z[accelerations + i]
        row_by(pattern.functions[VARIABLE], pattern, pattern.y, pattern.z, row)
        low, high = pattern.under[target], pattern.over[target]
        run.renewed[i] = NARROW_ONE
        if run.counters[BEGUN] == 0 or not (run.boxes[WIDE, i] <= low and high <= run.boxes[WIDE + 1, i]):
            far = AHEAD * (high - low) * run.spans[SHARE]
            run.boxes[WIDE, i], run.boxes[WIDE + 1, i], run.renewed[i], any_renewed = low - far, high + far, BOTH, True
        fit_narrow_box(run, i, low, high)
    return any_renewed


@jit_separate
def fit_narrow_box(run: Run, i: int, low: float, high: float) -> None:
    """Make the narrow box of a coordinate, about its bounds in the trial and within its wide box."""
    wide_low, wide_high = run.boxes[WIDE, i], run.boxes[WIDE + 1, i]
    far = NARROWER * (wide_high - wide_low)
    run.boxes[NARROW, i], run.boxes[NARROW + 1, i] = max(wide_low, low - far), min(wide_high, high + far)


@jit_separate
def stays_in_narrow_box(run: Run, i: int, w: float) -> bool:
    """Whether a coordinate provably stays in its narrow box, by less arithmetic than bounds of its pattern need.

    They are the Bernstein coefficients of Hermite's quintic, widened by its distance from cubics; see
    `elementary.bounds`. Every term of them is within a few widths of the box if they are in it, so that rounding is
    less than `UNSURE` of its ends.
    """
    n, accelerations = run.plan[0].coordinates, run.plan[0].used
    q0, v0, a0 = run.y[i], run.y[n + i], run.y[accelerations + i]
    q1, v1, a1 = run.z[i], run.z[n + i], run.z[accelerations + i]
    odd = abs((q1 - q0) - w * (v0 + v1) / 2.0 + w * w * (a1 - a0) / 12.0)
    even = abs(v1 - v0 - w * (a0 + a1) / 2.0)
    b1, b2 = q0 + w * v0 / 5.0, q0 + 2.0 * w * v0 / 5.0 + w * w * a0 / 20.0
    b4, b3 = q1 - w * v1 / 5.0, q1 - 2.0 * w * v1 / 5.0 + w * w * a1 / 20.0
    off = odd + w * even / 128.0 + UNSURE * max(abs(run.boxes[NARROW, i]), abs(run.boxes[NARROW + 1, i]))
    low, high = run.boxes[NARROW, i] + off, run.boxes[NARROW + 1, i] - off
    first_half_inside = low <= q0 <= high and low <= b1 <= high and low <= b2 <= high
    return bool(first_half_inside and low <= b3 <= high and low <= b4 <= high and low <= q1 <= high)


@jit_separate
def list_candidates(run: Run) -> bool:
    """List the links that boxes which are new do not prove to be apart; whether there is room for them."""
    drop_renewed(run)
    for c in range(run.assemblies.shape[0]):
        all_listed = list_pairs(run, c) if run.assemblies[c].paired else list_links(run, c)
        if not all_listed:
            return False
    return True


@jit_separate
def drop_renewed(run: Run) -> None:
    """Leave out candidates of boxes that are new."""
    kept_count = 0
    if run.counters[BEGUN] == 0:
        run.counters[COUNT] = 0
    for k in range(run.counters[COUNT]):
        c, link, first, second = run.candidates[k, 0], run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        if not is_renewed(run, c, link, first, second, BOTH):
            for j in range(run.candidates.shape[1]):
                run.candidates[kept_count, j] = run.candidates[k, j]
            kept_count += 1
    run.counters[COUNT] = kept_count


@jit_separate
def is_renewed(run: Run, c: int, link: int, first: int, second: int, which: int) -> bool:
    """Whether a coordinate that a link reads has a new narrow box, or both boxes are new."""
    assembly, new = run.assemblies[c], False
    for k in range(assembly.leaves):
        leaf = assembly.first_leaf + k
        if run.pattern_inputs[leaf, MOVES] and run.renewed[leaf_member(run, leaf, link, first, second)] >= which:
            new = True
    return new


@jit_separate
def append_candidate(run: Run, c: int, link: int, first: int, second: int) -> bool:
    """Add a candidate, near until it is proven not to be; whether there is room for it."""
    count = run.counters[COUNT]
    if count >= run.candidates.shape[0]:
        return False
    run.candidates[count, 0], run.candidates[count, 1] = c, link
    run.candidates[count, 2], run.candidates[count, 3], run.candidates[count, NEAR] = first, second, 1
    run.counters[COUNT] = count + 1
    return True


@jit_separate
def list_links(run: Run, c: int) -> bool:
    """List candidates among links that are examined one by one."""
    assembly = run.assemblies[c]
    for link in range(assembly.links):
        if not is_renewed(run, c, link, 0, 0, BOTH) and run.counters[BEGUN] == 1:
            continue
        if not is_apart_in_boxes(run, c, link, 0, 0, WIDE) and not append_candidate(run, c, link, 0, 0):
            return False
    return True


@jit_separate
def is_apart_in_boxes(run: Run, c: int, link: int, first: int, second: int, which: int) -> bool:
    """Whether the gap of a link is proven to be positive wherever its coordinates are in their wide, or narrow, boxes."""
    assembly, pattern = run.assemblies[c], pattern_at(run.patterns[2 * c])
    if assembly.timed:
        return False
    for k in range(assembly.leaves):
        leaf = assembly.first_leaf + k
        bound_leaf(run, pattern, leaf, leaf_member(run, leaf, link, first, second), which)
    return bool(is_apart(pattern))


@jit_separate
def mark_near(run: Run) -> None:
    """Mark the candidates, among those with new boxes, that narrow boxes do not prove to be apart."""
    for k in range(run.counters[COUNT]):
        c, link, first, second = run.candidates[k, 0], run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        if is_renewed(run, c, link, first, second, NARROW_ONE):
            run.candidates[k, NEAR] = int(not is_apart_in_boxes(run, c, link, first, second, NARROW))


@jit_separate
def list_pairs(run: Run, c: int) -> bool:
    """List candidates among all pairs of elements, by groups."""
    assembly = run.assemblies[c]
    if run.counters[BEGUN] == 0 or run.counters[RENEWALS] > assembly.elements:
        arrange(run, c)
        run.counters[RENEWALS] = 0
    for g in range(assembly.groups):
        stale = run.counters[BEGUN] == 0
        for m in range(g * GROUP, min((g + 1) * GROUP, assembly.elements)):
            stale = stale or entity_is_renewed(run, c, run.grouped[assembly.first_order + m])
        if stale or run.counters[RENEWALS] == 0:
            span_group(run, c, g)
    for e in range(assembly.elements):
        if run.counters[BEGUN] == 0 or entity_is_renewed(run, c, e):
            run.counters[RENEWALS] += 1
            if not list_partners(run, c, e):
                return False
    return True


@jit_separate
def entity_is_renewed(run: Run, c: int, e: int) -> bool:
    """Whether an element of a relation has a new wide box, at either end."""
    assembly, new = run.assemblies[c], False
    for k in range(assembly.leaves):
        leaf = assembly.first_leaf + k
        if run.pattern_inputs[leaf, MOVES] and run.renewed[run.members[run.pattern_inputs[leaf, BASE] + e]] == BOTH:
            new = True
    return new


@jit_separate
def list_partners(run: Run, c: int, e: int) -> bool:
    """List the candidates of one element: with each one that may meet it and is not listed with it elsewhere."""
    assembly, pattern = run.assemblies[c], pattern_at(run.patterns[2 * c])
    for element_end in (1, 2):  # the end at which the element is
        for k in range(assembly.leaves):
            leaf = assembly.first_leaf + k
            if run.pattern_inputs[leaf, FAMILY] == element_end:
                bound_leaf(run, pattern, leaf, run.members[run.pattern_inputs[leaf, BASE] + e], WIDE)
        for g in range(assembly.groups):
            if not is_apart_from_group(run, c, g, element_end) and not list_members(run, c, e, g, element_end):
                return False
    return True


@jit_separate
def is_apart_from_group(run: Run, c: int, g: int, element_end: int) -> bool:
    """Whether an element, whose bounds have been given, is apart from all of a group."""
    assembly, pattern = run.assemblies[c], pattern_at(run.patterns[2 * c])
    for k in range(assembly.leaves):
        leaf = assembly.first_leaf + k
        target = run.pattern_inputs[leaf, TARGET]
        if run.pattern_inputs[leaf, FAMILY] != element_end and target >= 0:
            hull = assembly.first_hull + g * assembly.leaves + k
            pattern.under[target], pattern.over[target] = run.hulls[0, hull], run.hulls[1, hull]
            pattern.flaws[target] = SMOOTH
    return is_apart(pattern)


@jit_separate
def list_members(run: Run, c: int, e: int, g: int, element_end: int) -> bool:
    """List the candidates of one element, at one end, with the elements of a group; whether there is room for them."""
    assembly, pattern = run.assemblies[c], pattern_at(run.patterns[2 * c])
    size = assembly.elements
    for m in range(g * GROUP, min((g + 1) * GROUP, size)):
        partner = run.grouped[assembly.first_order + m]
        if (element_end == 1) != (e < partner) or partner == e:
            continue
        if element_end == 2 and (run.counters[BEGUN] == 0 or entity_is_renewed(run, c, partner)):
            continue  # two that are both new are listed by the first
        for k in range(assembly.leaves):
            leaf = assembly.first_leaf + k
            if run.pattern_inputs[leaf, FAMILY] != element_end:
                bound_leaf(run, pattern, leaf, run.members[run.pattern_inputs[leaf, BASE] + partner], WIDE)
        if not is_apart(pattern):
            i, j = min(e, partner), max(e, partner)
            # a pair's place in the upper triangle, row by row, which `list_ends` inverts
            if not append_candidate(run, c, i * size - i * (i + 1) // 2 + j - i - 1, i, j):
                return False
    return True


@jit_separate
def span_group(run: Run, c: int, g: int) -> None:
    """Compute the hull of the boxes, and parameters, of a group's elements at either end."""
    assembly = run.assemblies[c]
    for k in range(assembly.leaves):
        leaf, low, high = assembly.first_leaf + k, inf, -inf
        for m in range(g * GROUP, min((g + 1) * GROUP, assembly.elements)):
            member_index = run.members[run.pattern_inputs[leaf, BASE] + run.grouped[assembly.first_order + m]]
            moves = run.pattern_inputs[leaf, MOVES]
            low = min(low, run.boxes[WIDE, member_index] if moves else run.p[member_index])
            high = max(high, run.boxes[WIDE + 1, member_index] if moves else run.p[member_index])
        hull = assembly.first_hull + g * assembly.leaves + k
        run.hulls[0, hull], run.hulls[1, hull] = low, high


@jit_separate
def arrange(run: Run, c: int) -> None:
    """Order elements so that those of a group are near each other: halves along the longest extent, in turn."""
    assembly = run.assemblies[c]
    size, first = assembly.elements, assembly.first_order
    for m in range(size):
        run.grouped[first + m] = m
    part = size
    while part > GROUP:
        groups = -(-part // GROUP)
        for start in range(0, size, part):
            halve(run, c, first + start, min(part, size - start))
        part = -(-groups // 2) * GROUP


@jit_separate
def halve(run: Run, c: int, start: int, count: int) -> None:
    """Sort a stretch of elements along the coordinate in which they are farthest apart (Shell's method)."""
    assembly, best, widest = run.assemblies[c], -1, -1.0
    for k in range(assembly.leaves):
        leaf = assembly.first_leaf + k
        if run.pattern_inputs[leaf, MOVES] and run.pattern_inputs[leaf, FAMILY] == 1:
            low, high = inf, -inf
            for m in range(start, start + count):
                q = run.y[run.members[run.pattern_inputs[leaf, BASE] + run.grouped[m]]]
                low, high = min(low, q), max(high, q)
            if high - low > widest:
                widest, best = high - low, run.pattern_inputs[leaf, BASE]
    gap = count // 2
    while gap > 0:
        for m in range(start + gap, start + count):
            element = run.grouped[m]
            q, j = run.y[run.members[best + element]], m
            while j - gap >= start and run.y[run.members[best + run.grouped[j - gap]]] > q:
                run.grouped[j] = run.grouped[j - gap]
                j -= gap
            run.grouped[j] = element
        gap //= 2
