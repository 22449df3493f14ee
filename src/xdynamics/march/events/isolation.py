"""Isolating events: whether a trial holds one, and between which two of its states the first one is.

A step is halved until, on every piece, each event function is known to have no zero, is known to be monotone, or is
smaller than its uncertainty. The states at the cuts are those of shortened steps of the method itself, so that no
interpolant has to be trusted: `march.events.enclosures` encloses the motion between two of them.
"""

from __future__ import annotations

from math import nan

from xdynamics.elementary.bounds import BREAKS, SMOOTH, UNBOUNDED
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law, enclosed_by
from xdynamics.march.events.departures import end_leaving, happens_late, has_left, is_leaving, leave_again
from xdynamics.march.events.enclosures import may_reach_zero, set_region, stays_in_region
from xdynamics.march.events.zero_tests import (
    CLEAR,
    CROSSED,
    ENDED,
    FORCED,
    MONOTONE,
    MURK,
    MURKY,
    NONE,
    OPEN,
    STEEP,
    TOUCHED,
    classify_function,
    event_resolution,
    function_uncertainty,
    idles,
    moves_past_guard,
    noise_floor,
    returned_past_zero,
    sign_of,
    stays_within,
    tighten_slopes,
    trespasses,
    turns_back,
)
from xdynamics.march.force_evaluation import set_time
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.run import ALIVE, ALL, ENCLOSE, Run
from xdynamics.march.trial_step import copy_numbers, substep
from xdynamics.model.detectors import GAP

INFINITE = 1e299  # the function of a switch is no larger than 1e300 at a pole; see `model.switches.bounded_function`


@jit_separate
def is_event_free(run: Run) -> bool:
    """Whether no event function can have a zero in the trial; note which may."""
    now, trial, piece = run.now[0], run.trial[0], run.piece[0]
    piece.first, piece.last, piece.full = 0.0, 1.0, trial.h
    if run.plan[0].degree > 0:
        call_law(run.law[run.plan[0].polynomial], run, run.y, run.z, 0)
    if run.box_variables.shape[0] > 0 and stays_in_region(run):
        return True
    piece.start, piece.end, piece.width, piece.wide = now.t, trial.t, trial.h, 0.0
    piece.rough, piece.part = 1, 0
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, run.parts[0], run.parts[1], ALL)
    piece.rough, silent = 0, True
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if detector.role == GAP:
            touch = run.touches[detector.reaction]
            touch.largest = max(touch.largest, run.under[detector.value])
        watch.alive = int(may_reach_zero(run, i))
        if watch.alive:
            silent = False
    if silent and run.box_variables.shape[0] > 0:
        set_region(run)
    return silent


@jit_separate
def isolate(run: Run, final: bool) -> bool:
    """Find the first piece with events of the trial, which is the run's last if `final`; whether there is one."""
    last = 0
    end_leaving(run)
    for i in range(run.watches.shape[0]):
        watch = run.watches[i]
        watch.zone, watch.hit, watch.forced, watch.broken, watch.began = -1.0, NONE, 0, SMOOTH, watch.armed
        watch.greatest = max(below_infinity(run.g[i]), below_infinity(run.g1[i]))
    grow_branch(run, 0, run.trial[0].h)
    copy_numbers(run.z, run.full)
    copy_numbers(run.e, run.full_e)
    run.piece[0].full = run.trial[0].h
    copy_numbers(run.y, run.near)
    copy_numbers(run.g, run.near_g)
    start, budget = 0.0, MOST_SUBSTEPS
    while last >= 0:
        s = run.branches[last, 0]
        load_branch(run, last)
        finest = budget <= 0 or last + 1 >= run.branches.shape[0]
        if classify_functions(run, start, s, finest):
            middle = (start + s) / 2.0
            last, budget = last + 1, budget - 1
            step_to(run, middle)
            grow_branch(run, last, middle)
        elif decide_piece(run, start, s, last == 0 and final):
            hold_other_sides(run, start)
            return True
        else:
            last, start = last - 1, s
            copy_numbers(run.far, run.near)
            copy_numbers(run.far_g, run.near_g)
    return False


@jit_inline
def below_infinity(value: float) -> float:
    """Return the size of a value, and 0 for the large number that replaces infinity, which dwarfs all others."""
    return abs(value) if abs(value) < INFINITE else 0.0


@jit_separate
def step_to(run: Run, s: float) -> None:
    """Compute the state after part of the trial's step or, where only time matters, evaluate at that time."""
    moving = False
    for i in range(run.detectors.shape[0]):
        moving = moving or (run.watches[i].alive and not run.detectors[i].of_time)
    if moving:
        substep(run, s)
    else:
        set_time(run, T, run.now[0].t + s)
        call_law(run.law[DETECT], run, run.z, run.g1, 0)


@jit_separate
def classify_functions(run: Run, start: float, end: float, finest: bool) -> bool:
    """Classify each event function on a piece; whether the piece has to be cut."""
    piece, t, cut = run.piece[0], run.now[0].t, False
    piece.start, piece.end, piece.width, piece.wide = t + start, t + end, end - start, 0.0
    piece.part = int(end - start < run.located[0].h)
    piece.first, piece.last = start / piece.full, end / piece.full
    enclosed_by(run.functions[ENCLOSE], run, run.near, run.far, run.parts[0], run.parts[3], ALIVE)
    bent = False
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if watch.alive:
            value, slope = detector.value, detector.slope
            watch.low, watch.high = run.under[value], run.over[value]
            watch.down, watch.up, watch.flaw = (
                run.under[slope],
                run.over[slope],
                max(run.flaws[value], run.flaws[slope]),
            )
            if detector.bend >= 0:
                bent = True
                watch.least_bend, watch.most_bend = run.under[detector.bend], run.over[detector.bend]
    if bent:
        tighten_slopes(run)
    for i in range(run.detectors.shape[0]):  # only once all are noted: further tests overwrite the intervals
        if run.watches[i].alive:
            run.watches[i].state = OPEN if start == 0.0 and returned_past_zero(run, i) else classify_function(run, i)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.alive and watch.state == OPEN:
            narrow = end - start <= event_resolution(run, i, end)
            set_time(run, T, t + start)
            size = noise_floor(run, i, run.near)
            small = stays_within(run, i, size, end - start) or idles(run, i, size)
            if not small and (narrow or finest) and not turns_back(run, i):
                watch.state = CLEAR
            elif small or narrow or finest:
                watch.state = MURKY
                watch.broken = max(watch.broken, watch.flaw)
                watch.forced = max(watch.forced, int(not small and watch.flaw == SMOOTH))
            else:
                cut = True
    return cut


@jit_separate
def decide_piece(run: Run, start: float, end: float, border: bool) -> bool:
    """Note each event's verdict on a piece; whether a watched event is in it or right before it.

    Parameters
    ----------
    run : Run
    start, end : float
        The piece, as steps.
    border : bool
        Whether the motion ends at the piece's end, so that a zero there cannot be left to a later step.
    """
    any_hit = False
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        watch.hit, run.entered[i] = NONE, watch.armed
        if not watch.alive:
            continue
        if watch.state == MURKY:
            if watch.zone < 0.0:
                watch.zone = start
            watch.clear = end
            is_open = border and watch.armed != 0 and not is_leaving(run, i)
            ended = is_open and not turns_before_zero(run, i, watch.zone, end)
            if ended or trespasses(run, i, end):
                note_event_in_piece(run, i, watch.zone, end, ENDED if ended else FORCED)
        else:
            decide_side(run, i, start, end)
        any_hit = any_hit or watch.hit != NONE
    return any_hit


@jit_separate
def decide_side(run: Run, i: int, start: float, end: float) -> None:
    """Store the side of a function after a piece that ends away from zero, and the event if the side changed.

    One that is as good as zero before the piece, and on the same side before and after, has touched zero, unless it only
    leaves it.
    """
    watch, side_before, side_after = run.watches[i], sign_of(run.near_g[i]), sign_of(run.far_g[i])
    leaving, waiting = is_leaving(run, i), watch.armed == 0
    if leaving and side_before == side_after == -watch.armed and abs(run.far_g[i]) <= abs(run.near_g[i]):
        return  # from beyond zero, where the event was met, it is on its way back
    if side_before == -watch.armed and watch.zone < 0.0 and start == 0.0 and not leaving:
        watch.broken = BREAKS  # at the very start, after a node where a drive jumps
    leaves_through_zero = leaving and side_after == watch.armed  # where it is beyond zero, it is so by rounding
    came = side_after if watch.state == MONOTONE or side_before == 0 or leaves_through_zero else side_before
    watch.clear = start
    pending, left = watch.zone >= 0.0, watch.zone if watch.zone >= 0.0 else start
    if moves_past_guard(run, i, came):
        watch.armed, left = watch.guard, start
    elif waiting and happens_late(run, i, came):
        watch.armed, left = -came, start
    elif waiting:
        watch.armed = came
    if came != watch.armed:
        note_event_in_piece(run, i, left, end, FORCED if pending and watch.forced else CROSSED)
        if watch.hit == NONE:
            watch.armed = came
    elif pending and not waiting and not leaving and reaches_zero(run, i, start, end):
        note_event_in_piece(run, i, left, start, TOUCHED)
    if not (leaving and is_near_zero(run, i, end)):
        has_left(run, i)
    watch.ever = max(watch.ever, abs(watch.armed))
    if watch.hit == NONE:
        watch.zone, watch.forced, watch.broken, run.pending[i] = -1.0, 0, SMOOTH, 0.0


@jit_separate
def reaches_zero(run: Run, i: int, start: float, end: float) -> bool:
    """Whether a function on one side before and after pieces that are not resolved, up to this one, reaches zero in them.

    A smooth one does unless it is seen to turn back before. One with a kink does if its slope explains its value beside it;
    one that is infinite there, or stays away, does not.
    """
    watch = run.watches[i]
    if watch.broken == SMOOTH:
        return not turns_before_zero(run, i, watch.zone, start)
    if watch.broken == UNBOUNDED and abs(run.near_g[i]) >= watch.greatest:
        return False
    run.at[T] = run.piece[0].start
    explained = STEEP * max(abs(watch.down), abs(watch.up)) * (end - watch.zone)
    return abs(run.near_g[i]) <= explained + MURK * function_uncertainty(run, i, run.near)


@jit_separate
def turns_before_zero(run: Run, i: int, left: float, right: float) -> bool:
    """Whether a smooth function turns back clearly before zero, on pieces that were too many to resolve.

    Bounds of a force that many supports share are too wide to prove it. Where its slope changes sign its value is looked
    at: one that is far from zero there has not touched it.
    """
    watch, side, t = run.watches[i], sign_of(run.far_g[i]), run.now[0].t
    if watch.forced == 0 or watch.broken != SMOOTH or side == 0:
        return False
    finest, value, slope, resolved = event_resolution(run, i, right), 0.0, 0.0, False
    while not resolved:
        resolved, middle = right - left <= finest, (left + right) / 2.0
        step_to(run, middle)
        run.at[T] = t + middle
        call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
        value, slope = run.g1[i], run.slopes[i]
        if run.trial[0].iterations < 0 or sign_of(value) != side:
            return False
        left, right = (middle, right) if side * slope < 0.0 else (left, middle)
    return bool(abs(value) > abs(slope) * finest + noise_floor(run, i, run.z))


@jit_separate
def is_near_zero(run: Run, i: int, end: float) -> bool:
    """Whether a function is as good as zero after a piece: it has yet to leave, and would seem to touch zero later."""
    run.at[T] = run.now[0].t + end
    return abs(run.far_g[i]) <= noise_floor(run, i, run.far)


@jit_separate
def hold_other_sides(run: Run, start: float) -> None:
    """Leave other functions on the sides on which they entered a piece: the motion ends at an event in it."""
    leave_again(run)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit == NONE and run.plan[0].apart == 0:
            watch.armed, watch.left = int(run.entered[i]), watch.zone if watch.zone >= 0.0 else start


@jit_separate
def ends_near_event(run: Run) -> bool:
    """Whether a trial that ends where the model does is within a time tolerance of an event, by the slopes there."""
    any_hit, s = False, run.located[0].h
    copy_numbers(run.located_z, run.z)
    set_time(run, T, run.now[0].t + s)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        watch, value, slope = run.watches[i], run.located_g[i], run.slopes[i]
        watch.hit = NONE
        if watch.armed * slope < 0.0 and abs(value) <= event_resolution(run, i, s) * abs(slope):
            time_to_event = abs(value / slope)  # to the event, by the slope
            watch.zone, watch.clear = max(0.0, s - time_to_event), s + time_to_event
            note_event_in_piece(run, i, s, s, ENDED)
            any_hit = any_hit or watch.hit != NONE
    return any_hit


@jit_separate
def note_event_in_piece(run: Run, i: int, left: float, right: float, hit_kind: int) -> None:
    """Store an event in a piece, if its direction is watched for; a touch has the direction of its approach."""
    watch, direction = run.watches[i], run.detectors[i].direction
    if direction == 0 or direction == -watch.armed:
        watch.hit, watch.left, watch.right = hit_kind, left, right
        if run.plan[0].apart == 0:
            at_start = hit_kind == CROSSED and run.now[0].t + left == run.piece[0].start
            watch.before = run.near_g[i] if at_start else nan


@jit_separate
def grow_branch(run: Run, k: int, s: float) -> None:
    """Keep the trial's state until the piece before it is done."""
    n = run.z.shape[0]
    run.branches[k, 0] = s
    for i in range(n):
        run.branches[k, 1 + i] = run.z[i]
    for i in range(run.g1.shape[0]):
        run.branches[k, 1 + n + i] = run.g1[i]


@jit_separate
def load_branch(run: Run, k: int) -> None:
    """Load a stored state as the end of a piece."""
    n = run.far.shape[0]
    for i in range(n):
        run.far[i] = run.branches[k, 1 + i]
    for i in range(run.far_g.shape[0]):
        run.far_g[i] = run.branches[k, 1 + n + i]
