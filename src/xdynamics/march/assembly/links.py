"""One link of an assembly: its gap enclosed, or at a state, by the programs of its pattern.

The pattern is a run of its own, of one link whose coordinates are what the gap reads; numbers of a link are copied there.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS, SMOOTH
from xdynamics.kernels.compiling import PLAINLY, UNCOMPILED, jit_separate
from xdynamics.kernels.law import DETECT, SLOPES, TOUCHING
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law, enclosed_by, run_at
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
    """The place of what a leaf of a link reads, among coordinates or parameters."""
    family = run.pattern_inputs[leaf, FAMILY]
    entity = link if family == 0 else (first if family == 1 else second)
    return int(run.members[run.pattern_inputs[leaf, BASE] + entity])


@jit_separate
def gather_link_state(run: Run, state: State, target: State, c: int, link: int, first: int, second: int) -> None:
    """Copy what a link reads of a state to a state of the pattern."""
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
    """Do so for a link by its number and its elements."""
    pattern = pattern_at(run.patterns[2 * c + 1])
    gather_link_state(run, state, pattern.z, c, link, first, second)
    pattern.at[T] = t
    call_law(pattern.law[TOUCHING], pattern, pattern.z, pattern.contact_tables, 0)
