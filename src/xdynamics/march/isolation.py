"""Whether a trial holds an event, and between which two of its states the first one is.

A step is cut in halves until on every piece each event function is known to have no zero, or to be monotone, or is
smaller than what is known of it. The states at the cuts are those of shortened steps of the method itself, so that no
interpolant has to be trusted: what lies between two of them is enclosed by `march.enclosures`.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.handle import called, enclosed_by
from xdynamics.march.intervals import BREAKS, EPS, SMOOTH, UNBOUNDED, above, below
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.proposing import copy, substep
from xdynamics.march.run import ENCLOSE, Run
from xdynamics.model.detectors import GAP

State = NDArray[Any]

CLEAR, MONOTONE, MURKY, OPEN = range(4)  # what is known of an event function on a piece
# what was found there: `FORCED` where it could not be told apart further, `ENDED` where the model ends with it
NONE, CROSSED, TOUCHED, FORCED, ENDED = range(5)
NEAR = 1e-9  # of the largest value of an event function: near enough to zero to look twice
STEEP = 100.0  # times what a slope explains: no more of the same function
LOOKS = 8  # pieces of a step on which a function is looked at of which nothing is known between them
ROUGHLY = 8.0 * EPS  # of such a function: what rounding may have made of it
MURK = 4.0  # uncertainties of an event function that count as zero


@shared
def sign(x: float) -> int:
    """1, 0 or -1."""
    return 1 if x > 0.0 else (-1 if x < 0.0 else 0)


@shared
def arm(run: Run, i: int, value: float) -> None:
    """Let an event be found once its function leaves zero, or at once where it is away from it."""
    watch = run.watches[i]
    if watch.asleep:
        watch.armed = 0
        return
    away = abs(value) > max(murk(run, i, run.z), NEAR * watch.greatest)
    watch.armed = sign(value) if away else 0
    watch.ever = max(watch.ever, abs(watch.armed))


@shared
def renew_constants(run: Run) -> None:
    """Have enclosures know numbers and parameters, of which modes and sides change behind events."""
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.y, 0, run.parts[0])


@shared
def forget(run: Run) -> None:
    """Have every event armed as it was before a trial that is rejected."""
    for i in range(run.watches.shape[0]):
        run.watches[i].armed = run.watches[i].began


@shared
def uncertainty(run: Run, i: int, state: State) -> float:
    """How far rounding, and the error of the step where it is estimated, may have an event function from its value.

    What may not leave a side is held to it where the march is, so that of a gap there is rounding only.
    """
    piece, place = run.piece[0], run.detectors[i].value
    start, end, width = piece.start, piece.end, piece.width
    piece.start, piece.end, piece.width, piece.wide = (
        run.at[T],
        run.at[T],
        0.0,
        1.0 if run.watches[i].guard == 0 else 0.0,
    )
    enclosed_by(run.functions[ENCLOSE], run, state, state, run.parts[0], run.parts[1])
    piece.start, piece.end, piece.width, piece.wide = start, end, width, 0.0
    if run.detectors[i].sampled:
        return ROUGHLY * run.watches[i].greatest
    if run.flaws[place] != SMOOTH:  # where it jumps, both sides are in the interval
        return 0.0
    return (run.over[place] - run.under[place]) / 2.0


@shared
def murk(run: Run, i: int, state: State) -> float:
    """How large an event function may be and count as zero."""
    return max(MURK * uncertainty(run, i, state), run.watches[i].floor)


@shared
def quiet(run: Run) -> bool:
    """Whether no event function can have a zero in the trial; keeps which may."""
    now, trial, piece = run.now[0], run.trial[0], run.piece[0]
    piece.start, piece.end, piece.width, piece.wide = now.t, trial.t, trial.h, 0.0
    piece.rough, piece.part = 1, 0
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, run.parts[0], run.parts[1])
    piece.rough, silent = 0, True
    for i in range(run.detectors.shape[0]):
        place, watch = run.detectors[i].value, run.watches[i]
        if run.detectors[i].role == GAP:
            touch = run.touches[run.detectors[i].reaction]
            touch.largest = max(touch.largest, run.under[place])
        settled = (watch.armed > 0 and run.under[place] > 0.0) or (watch.armed < 0 and run.over[place] < 0.0)
        unguarded = watch.guard == 0 or watch.armed == watch.guard
        watch.alive = int(watch.asleep == 0 and not (settled and unguarded))
        if watch.alive:
            silent = False
    return silent


@shared
def isolate(run: Run, final: bool) -> bool:
    """Find the first piece of the trial with events, of the run's last one if it is `final`; whether there is one."""
    last = 0
    for i in range(run.watches.shape[0]):
        watch = run.watches[i]
        watch.zone, watch.hit, watch.forced, watch.broken, watch.began = -1.0, NONE, 0, SMOOTH, watch.armed
        watch.greatest = max(abs(run.g[i]), abs(run.g1[i]))
    grow_branch(run, 0, run.trial[0].h)
    copy(run.z, run.full)
    copy(run.e, run.full_e)
    run.piece[0].full = run.trial[0].h
    copy(run.y, run.near)
    copy(run.g, run.near_g)
    start, budget = 0.0, MOST_SUBSTEPS
    while last >= 0:
        s = run.branches[last, 0]
        load_branch(run, last)
        finest = budget <= 0 or last + 1 >= run.branches.shape[0]
        if weigh(run, start, s, finest):
            middle = (start + s) / 2.0
            last, budget = last + 1, budget - 1
            step_to(run, middle)
            grow_branch(run, last, middle)
        elif decide(run, start, s, last == 0 and final):
            return True
        else:
            last, start = last - 1, s
            copy(run.far, run.near)
            copy(run.far_g, run.near_g)
    return False


@shared
def step_to(run: Run, s: float) -> None:
    """Have the state after part of the trial's step, or where only time is asked for, that time alone."""
    moving = False
    for i in range(run.detectors.shape[0]):
        moving = moving or (run.watches[i].alive and not run.detectors[i].of_time)
    if moving:
        substep(run, s)
    else:
        run.at[T] = run.now[0].t + s
        called(run.law[DETECT], run, run.z, run.g1, 0)


@shared
def weigh(run: Run, start: float, end: float, finest: bool) -> bool:
    """Look what is known of each event function on a piece; whether it has to be cut."""
    piece, t, cut = run.piece[0], run.now[0].t, False
    piece.start, piece.end, piece.width, piece.wide = t + start, t + end, end - start, 0.0
    piece.part = int(end - start < run.located[0].h)
    enclosed_by(run.functions[ENCLOSE], run, run.near, run.far, run.parts[0], run.parts[3])
    bent = False
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if watch.alive:
            value, slope = detector.value, detector.slope
            watch.low, watch.high = run.under[value], run.over[value]
            watch.down, watch.up, watch.flaw = run.under[slope], run.over[slope], max(run.flaws[value], run.flaws[slope])  # fmt: skip
            if detector.bend >= 0:
                bent = True
                watch.least_bend, watch.most_bend = run.under[detector.bend], run.over[detector.bend]
    if bent:
        tighten(run)
    for i in range(run.detectors.shape[0]):  # when all are taken down: to know more, intervals are written over
        if run.watches[i].alive:
            run.watches[i].state = known(run, i)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.alive and watch.state == OPEN:
            narrow = end - start <= resolution(run, i, end)
            run.at[T] = t + start
            size = murk(run, i, run.near)
            small = stays_within(run, i, size, end - start) or idles(run, i, size)
            if not small and (narrow or finest) and not turns(run, i):
                watch.state = CLEAR
            elif small or narrow or finest:
                watch.state = MURKY
                watch.broken = max(watch.broken, watch.flaw)
                watch.forced = max(watch.forced, int(not small and watch.flaw == SMOOTH))
            else:
                cut = True
    return cut


@shared
def tighten(run: Run) -> None:
    """Bound the slopes of gaps by those at the piece's start and by how much they change.

    A body that leaves what it stands on, or comes down on it, hardly moves against it, however fast both do.
    """
    piece, w = run.piece[0], run.piece[0].width
    end = piece.end
    piece.end, piece.width = piece.start, 0.0
    enclosed_by(run.functions[ENCLOSE], run, run.near, run.near, run.parts[0], run.parts[2])
    piece.end, piece.width = end, w
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if watch.alive and detector.bend >= 0 and watch.flaw == SMOOTH:
            at_start, to = run.under[detector.slope], run.over[detector.slope]
            watch.down = max(watch.down, at_start + min(0.0, below(watch.least_bend * w)))
            watch.up = min(watch.up, to + max(0.0, above(watch.most_bend * w)))


@shared
def stays_within(run: Run, i: int, size: float, w: float) -> bool:
    """Whether a function is no larger than a size on a piece: by its values, or by those at the ends and its slopes.

    Where two large numbers move together, as a body and what it stands on, the values alone say far too much.
    """
    watch, before, after = run.watches[i], run.near_g[i], run.far_g[i]
    low, high = watch.low, watch.high
    if watch.flaw == SMOOTH and watch.down < 0.0 < watch.up:
        low = max(low, before + watch.down * ((before - after + watch.up * w) / (watch.up - watch.down)))
        high = min(high, before + watch.up * ((after - before - watch.down * w) / (watch.up - watch.down)))
    return -size <= low and high <= size


@shared
def idles(run: Run, i: int, size: float) -> bool:
    """Whether a force that presses nothing, say, is as good as zero at both ends of a piece, and may be between."""
    watch = run.watches[i]
    largest = max(abs(run.near_g[i]), abs(run.far_g[i]))
    return watch.guard != 0 and watch.armed == 0 and run.detectors[i].role != GAP and largest <= size


@shared
def turns(run: Run, i: int) -> bool:
    """Whether a function that is on one side at both ends of a piece comes nearer to zero first, and leaves it then."""
    watch, piece, side = run.watches[i], run.piece[0], sign(run.near_g[i])
    if watch.flaw != SMOOTH or side == 0 or side != sign(run.far_g[i]):
        return True  # or it may: nothing more is known of it
    run.at[T] = piece.start
    called(run.law[SLOPES], run, run.near, run.slopes, 0)
    approaches = side * run.slopes[i] < 0.0
    run.at[T] = piece.end
    called(run.law[SLOPES], run, run.far, run.slopes, 0)
    return approaches and side * run.slopes[i] > 0.0


@shared
def known(run: Run, i: int) -> int:
    """Say what the enclosures of an event function and its derivative on a piece tell."""
    watch, w = run.watches[i], run.piece[0].width
    if run.detectors[i].sampled:
        return known_by_samples(run, i)
    if watch.low > 0.0 or watch.high < 0.0:
        return CLEAR
    if watch.flaw == SMOOTH:
        if watch.down > 0.0 or watch.up < 0.0:
            nothing = max(abs(run.near_g[i]), abs(run.far_g[i])) <= watch.floor
            return OPEN if nothing or lingers(run, i) else MONOTONE
        if clears(run.near_g[i], run.far_g[i], watch.down, watch.up, w):
            return CLEAR
    return OPEN


@shared
def known_by_samples(run: Run, i: int) -> int:
    """Say what values at the ends of a piece tell of a function of which nothing else is known; `up` is its mean slope."""
    watch, w, before, after = run.watches[i], run.piece[0].width, run.near_g[i], run.far_g[i]
    watch.down = watch.up = abs(after - before) / w
    if w * LOOKS > run.located[0].h * (1.0 + EPS):
        return OPEN
    if sign(before) != sign(after):
        return MONOTONE
    # a line through both would come to zero within as much again: it may turn in between
    return OPEN if min(abs(before), abs(after)) < abs(after - before) else CLEAR


@shared
def lingers(run: Run, i: int) -> bool:
    """Whether a monotone function ends so near to zero, and so slowly, that its side is not settled there."""
    watch, value = run.watches[i], abs(run.far_g[i])
    if value > NEAR * watch.greatest:
        return False
    run.at[T] = run.piece[0].end
    doubt = uncertainty(run, i, run.far)
    width = run.piece[0].width
    slowest, near = min(abs(watch.down), abs(watch.up)), resolution(run, i, width)
    bends = slowest * width < (watch.up - watch.down) * near  # within what cannot be told apart
    return bends or (value <= MURK * doubt and doubt > near * slowest)


@shared
def clears(before: float, after: float, down: float, up: float, w: float) -> bool:
    """Whether a function with such values at the ends of a piece and slopes on it cannot reach zero (Piyavskii's tent)."""
    if before > 0.0 and after > 0.0:
        low = before + down * ((before - after + up * w) / (up - down))
        return low > 8.0 * EPS * max(before, after)
    if before < 0.0 and after < 0.0:
        high = before + up * ((after - before - down * w) / (up - down))
        return high < 8.0 * EPS * min(before, after)
    return False


@shared
def resolution(run: Run, i: int, s: float) -> float:
    """The width of a piece under which it is not cut any further for the sake of an event."""
    t = run.now[0].t
    return max(run.detectors[i].tolerance, 2.0 * EPS * max(abs(t), abs(t + s)))


@shared
def decide(run: Run, start: float, end: float, border: bool) -> bool:
    """Take what is known of a piece down; whether an event that is watched for is in it or right before it.

    Parameters
    ----------
    run : Run
    start, end : float
        The piece, as steps.
    border : bool
        Whether the motion ends at the piece's end, so that a zero there is left to no step to come.
    """
    found = False
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        watch.hit = NONE
        if not watch.alive:
            continue
        before, after = sign(run.near_g[i]), sign(run.far_g[i])
        if watch.state == MURKY:
            if watch.zone < 0.0:
                watch.zone = start
            watch.clear = end
            if border and watch.armed != 0:
                strike(run, i, watch.zone, end, ENDED)
        else:
            if before == -watch.armed and watch.zone < 0.0 and start == 0.0:
                watch.broken = BREAKS  # at the very start, behind a node where a drive jumps
            came = after if watch.state == MONOTONE else (before if before != 0 else after)
            watch.clear = start
            pending, left = watch.zone >= 0.0, watch.zone if watch.zone >= 0.0 else start
            waiting = watch.armed == 0
            if leaves(run, i, came):
                watch.armed, left = watch.guard, start
            elif waiting:
                watch.armed = came
            if came != watch.armed:
                strike(run, i, left, end, FORCED if pending and watch.forced else CROSSED)
                if watch.hit == NONE:
                    watch.armed = came
            elif pending and not waiting and reaches(run, i, end - watch.zone):
                strike(run, i, left, start, TOUCHED)
            watch.ever = max(watch.ever, abs(watch.armed))
            if watch.hit == NONE:
                watch.zone, watch.forced, watch.broken = -1.0, 0, SMOOTH
        found = found or watch.hit != NONE
    return found


@shared
def leaves(run: Run, i: int, came: int) -> bool:
    """Whether a function is on the side where it may not be, and goes on there: a gap that was zero and no more, say."""
    watch = run.watches[i]
    if watch.guard == 0 or came != -watch.guard or watch.armed == watch.guard:
        return False
    run.at[T] = run.piece[0].end
    if not abs(run.far_g[i]) > murk(run, i, run.far) or sign(run.far_g[i]) != came:
        return False
    run.at[T] = run.piece[0].end
    called(run.law[SLOPES], run, run.far, run.slopes, 0)
    return bool(watch.guard * run.slopes[i] < 0.0)


@shared
def reaches(run: Run, i: int, width: float) -> bool:
    """Whether a function that is on one side before and after where nothing is known of it comes to zero there.

    One with a kink does if its slope explains its value beside it; one that is infinite there, or is left away, does not.
    """
    watch = run.watches[i]
    if watch.broken == SMOOTH:
        return True
    if watch.broken == UNBOUNDED and abs(run.near_g[i]) >= watch.greatest:
        return False
    run.at[T] = run.piece[0].start
    explained = STEEP * max(abs(watch.down), abs(watch.up)) * width
    return abs(run.near_g[i]) <= explained + MURK * uncertainty(run, i, run.near)


@shared
def arrives(run: Run) -> bool:
    """Whether a trial that ends where the model does is, by the slopes there, within a time tolerance of an event."""
    found, s = False, run.located[0].h
    copy(run.located_z, run.z)
    run.at[T] = run.now[0].t + s
    called(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        watch, value, slope = run.watches[i], run.located_g[i], run.slopes[i]
        watch.hit = NONE
        if watch.armed * slope < 0.0 and abs(value) <= resolution(run, i, s) * abs(slope):
            rest = abs(value / slope)  # to the event, by the slope
            watch.zone, watch.clear = max(0.0, s - rest), s + rest
            strike(run, i, s, s, ENDED)
            found = found or watch.hit != NONE
    return found


@shared
def strike(run: Run, i: int, left: float, right: float, what: int) -> None:
    """Take down that an event is in a piece, if it is of the direction watched; a touch goes the way it came."""
    watch, direction = run.watches[i], run.detectors[i].direction
    if direction == 0 or direction == -watch.armed:
        watch.hit, watch.left, watch.right = what, left, right


@shared
def grow_branch(run: Run, k: int, s: float) -> None:
    """Keep the trial's state for when the piece before it is done."""
    n = run.z.shape[0]
    run.branches[k, 0] = s
    for i in range(n):
        run.branches[k, 1 + i] = run.z[i]
    for i in range(run.g1.shape[0]):
        run.branches[k, 1 + n + i] = run.g1[i]


@shared
def load_branch(run: Run, k: int) -> None:
    """Stand at a state that was kept."""
    n = run.far.shape[0]
    for i in range(n):
        run.far[i] = run.branches[k, 1 + i]
    for i in range(run.far_g.shape[0]):
        run.far_g[i] = run.branches[k, 1 + n + i]
