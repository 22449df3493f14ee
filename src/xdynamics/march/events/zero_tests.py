"""Tests of event functions on a piece of a trial by enclosures, values and slopes: no zero, one, or undecided."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS, SMOOTH
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law, enclosed_by
from xdynamics.march.events.enclosures import above, below
from xdynamics.march.run import ALIVE, ALL, ENCLOSE, Run
from xdynamics.model.detectors import GAP

State = NDArray[Any]

CLEAR, MONOTONE, MURKY, OPEN = range(4)  # what is known of an event function on a piece
# the event found there: `FORCED` where it could not be resolved further, `ENDED` where the model ends with it
NONE, CROSSED, TOUCHED, FORCED, ENDED = range(5)
NEAR = 1e-9  # of the largest value of an event function: near enough to zero to look twice
STEEP = 100.0  # times the change that a slope explains: more is none of the same smooth function
LOOKS = 8  # pieces of a step at whose ends a sampled function is examined: nothing is known of it in between
ROUGHLY = 8.0 * EPS  # of the greatest value of such a function: what rounding may amount to
MURK = 4.0  # uncertainties of an event function that count as zero


@jit_separate
def sign_of(x: float) -> int:
    """1, 0 or -1."""
    return 1 if x > 0.0 else (-1 if x < 0.0 else 0)


@jit_separate
def enclose_constants(run: Run) -> None:
    """Enclose numbers and parameters, and functions of these alone."""
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.y, 0, run.parts[0], ALL)


@jit_separate
def enclose_here(run: Run, i: int, state: State, last: int, wide: float) -> None:
    """Enclose an event function's arguments at a state, whose time is among the numbers: rounding alone."""
    piece = run.piece[0]
    start, end, width, wider = piece.start, piece.end, piece.width, piece.wide
    piece.start, piece.end, piece.width, piece.wide = run.at[T], run.at[T], 0.0, wide
    enclosed_by(run.functions[ENCLOSE], run, state, state, run.parts[0], last, i)
    piece.start, piece.end, piece.width, piece.wide = start, end, width, wider


@jit_separate
def function_uncertainty(run: Run, i: int, state: State) -> float:
    """How far an event function may be off by rounding and, where it is estimated, by the error of the step.

    A guarded function is held to its side where the march is, so that only rounding counts for a gap.
    """
    value_index = run.detectors[i].value
    enclose_here(run, i, state, run.parts[1], 1.0 if run.watches[i].guard == 0 else 0.0)
    if run.detectors[i].sampled:
        return ROUGHLY * run.watches[i].greatest
    if run.flaws[value_index] != SMOOTH:  # where it jumps, both sides are in the interval
        return 0.0
    return (run.over[value_index] - run.under[value_index]) / 2.0


@jit_separate
def noise_floor(run: Run, i: int, state: State) -> float:
    """How large an event function may be and still count as zero."""
    return max(MURK * function_uncertainty(run, i, state), gap_floor(run, i))


@jit_separate
def gap_floor(run: Run, i: int) -> float:
    """The size below which an event function cannot be told from zero: the residue of a closed gap."""
    detector, floor = run.detectors[i], run.watches[i].floor
    return max(floor, run.lingering[detector.reaction]) if detector.role == GAP else floor


@jit_separate
def event_resolution(run: Run, i: int, s: float) -> float:
    """The width below which a piece is not cut any further for the sake of an event."""
    t = run.now[0].t
    return max(run.detectors[i].tolerance, 2.0 * EPS * max(abs(t), abs(t + s)))


@jit_separate
def tighten_slopes(run: Run) -> None:
    """Bound the slopes of gaps by those at the piece's start and by how much they change.

    A body that leaves its support, or comes down on it, hardly moves relative to it, however fast both move.
    """
    piece, w = run.piece[0], run.piece[0].width
    end = piece.end
    piece.end, piece.width = piece.start, 0.0
    enclosed_by(run.functions[ENCLOSE], run, run.near, run.near, run.parts[0], run.parts[2], ALIVE)
    piece.end, piece.width = end, w
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if watch.alive and detector.bend >= 0 and watch.flaw == SMOOTH:
            # slopes on the piece differ from that at its start by at most the bend times the width
            at_start, to = run.under[detector.slope], run.over[detector.slope]
            watch.down = max(watch.down, at_start + min(0.0, below(watch.least_bend * w, run.plan[0].margin)))
            watch.up = min(watch.up, to + max(0.0, above(watch.most_bend * w, run.plan[0].margin)))


@jit_separate
def classify_function(run: Run, i: int) -> int:
    """Classify an event function on a piece by the enclosures of it and of its derivative."""
    watch, w = run.watches[i], run.piece[0].width
    if run.detectors[i].sampled:
        return classify_by_samples(run, i)
    if watch.low > 0.0 or watch.high < 0.0:
        return CLEAR
    if watch.flaw == SMOOTH:
        if watch.down > 0.0 or watch.up < 0.0:
            vanishes = max(abs(run.near_g[i]), abs(run.far_g[i])) <= gap_floor(run, i)
            return OPEN if vanishes or ends_near_zero(run, i) else MONOTONE
        if cannot_reach_zero(run.near_g[i], run.far_g[i], watch.down, watch.up, w):
            return CLEAR
    return OPEN


@jit_separate
def classify_by_samples(run: Run, i: int) -> int:
    """Classify a function on a piece by its values at the ends alone; `up` becomes its mean slope."""
    watch, w, value_before, value_after = run.watches[i], run.piece[0].width, run.near_g[i], run.far_g[i]
    watch.down = watch.up = abs(value_after - value_before) / w
    # rounding of the cuts may leave an eighth of the step a little longer than that
    if w * LOOKS > run.located[0].h * (1.0 + EPS):
        return OPEN
    if sign_of(value_before) != sign_of(value_after):
        return MONOTONE
    # a line through both would reach zero within another such piece: the function may turn in between
    return OPEN if min(abs(value_before), abs(value_after)) < abs(value_after - value_before) else CLEAR


@jit_separate
def ends_near_zero(run: Run, i: int) -> bool:
    """Whether a monotone function ends so near zero, and so slowly, that its side is not settled there."""
    watch, value = run.watches[i], abs(run.far_g[i])
    if value > NEAR * watch.greatest:
        return False
    run.at[T] = run.piece[0].end
    doubt = function_uncertainty(run, i, run.far)
    width = run.piece[0].width
    slowest, finest = min(abs(watch.down), abs(watch.up)), event_resolution(run, i, width)
    bends = slowest * width < (watch.up - watch.down) * finest  # within what cannot be resolved
    return bends or (value <= MURK * doubt and doubt > finest * slowest)


@jit_separate
def cannot_reach_zero(value_before: float, value_after: float, down: float, up: float, w: float) -> bool:
    """Whether a function with these values at both ends and slopes between cannot reach zero."""
    # a tent that clears zero by its own rounding alone proves nothing
    if value_before > 0.0 and value_after > 0.0:
        return tent_tip(value_before, value_after, down, up, w) > 8.0 * EPS * max(value_before, value_after)
    if value_before < 0.0 and value_after < 0.0:
        return tent_tip(value_before, value_after, up, down, w) < 8.0 * EPS * min(value_before, value_after)
    return False


@jit_inline
def tent_tip(value_before: float, value_after: float, first_slope: float, second_slope: float, w: float) -> float:
    """The value where lines of two slopes through the values at both ends meet: a bound in between (Piyavskii's tent)."""
    return value_before + first_slope * ((value_before - value_after + second_slope * w) / (second_slope - first_slope))


@jit_separate
def returned_past_zero(run: Run, i: int) -> bool:
    """Whether a function passed zero unnoticed before the piece and returns in it: two events, separated by cuts."""
    watch = run.watches[i]
    return bool(watch.armed != 0 and sign_of(run.near_g[i]) == -watch.armed and sign_of(run.far_g[i]) == watch.armed)


@jit_separate
def stays_within(run: Run, i: int, size: float, w: float) -> bool:
    """Whether a function is no larger than a size on a piece: by its enclosure, or by values at the ends and slopes.

    Where two large numbers move together, as do a body and its support, the enclosure alone is far too wide.
    """
    watch, value_before, value_after = run.watches[i], run.near_g[i], run.far_g[i]
    low, high = watch.low, watch.high
    if watch.flaw == SMOOTH and watch.down < 0.0 < watch.up:
        low = max(low, tent_tip(value_before, value_after, watch.down, watch.up, w))
        high = min(high, tent_tip(value_before, value_after, watch.up, watch.down, w))
    return -size <= low and high <= size


@jit_separate
def idles(run: Run, i: int, size: float) -> bool:
    """Whether a force that presses nothing, say, is as good as zero at both ends of a piece, and may be between.

    So is the gap of an open contact that lingers: nothing would move it farther on the way. A switch is none of these:
    a sine of time is zero at both ends of its period, and in the middle.
    """
    watch, detector = run.watches[i], run.detectors[i]
    quiet = detector.reaction >= 0 and (detector.role != GAP or run.lingering[detector.reaction] > 0.0)
    largest = max(abs(run.near_g[i]), abs(run.far_g[i]))
    return watch.guard != 0 and watch.armed == 0 and quiet and largest <= size


@jit_separate
def turns_back(run: Run, i: int) -> bool:
    """Whether a function on one side at both ends of a piece first approaches zero, and then recedes from it."""
    watch, piece, side = run.watches[i], run.piece[0], sign_of(run.near_g[i])
    if watch.flaw != SMOOTH or side == 0 or side != sign_of(run.far_g[i]):
        return True  # or it may: nothing more is known of it
    run.at[T] = piece.start
    call_law(run.law[SLOPES], run, run.near, run.slopes, 0)
    approaches = side * run.slopes[i] < 0.0
    run.at[T] = piece.end
    call_law(run.law[SLOPES], run, run.far, run.slopes, 0)
    return approaches and side * run.slopes[i] > 0.0


@jit_separate
def trespasses(run: Run, i: int, end: float) -> bool:
    """Whether a function is beyond doubt on the forbidden side after a piece that was too costly to resolve.

    If it were left to the pieces that follow, an event of another function there would step over it.
    """
    watch = run.watches[i]
    if watch.guard == 0 or watch.armed != watch.guard or sign_of(run.far_g[i]) != -watch.guard:
        return False
    run.at[T] = run.now[0].t + end
    return abs(run.far_g[i]) > noise_floor(run, i, run.far)


@jit_separate
def moves_past_guard(run: Run, i: int, came: int) -> bool:
    """Whether a function is on the forbidden side, and moves farther into it: a gap that was zero and no more, say."""
    watch = run.watches[i]
    if watch.guard == 0 or came != -watch.guard or watch.armed == watch.guard:
        return False
    run.at[T] = run.piece[0].end
    if not abs(run.far_g[i]) > noise_floor(run, i, run.far) or sign_of(run.far_g[i]) != came:
        return False
    run.at[T] = run.piece[0].end
    call_law(run.law[SLOPES], run, run.far, run.slopes, 0)
    return bool(watch.guard * run.slopes[i] < 0.0)
