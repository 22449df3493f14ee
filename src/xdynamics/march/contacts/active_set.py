"""What contacts and friction elements do at a state: open or closed, sticking or slipping; and who is told.

Contacts that touch and do not part are candidates, and the accelerations say which of them stay closed, what sticks and
what slips.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import UNSOUND
from xdynamics.kernels.rounding_margins import EPS
from xdynamics.march.contacts.delassus import (
    ABSENT,
    FREE,
    GAP_OF,
    GRIPPING,
    KNOWN,
    MOST,
    NOISE,
    PRESSING,
    RATE,
    SIZE,
    SLIDING,
    gram,
    number,
    slips,
    solve_reactions,
    terms,
)
from xdynamics.march.contacts.gaps import size_of_gap, spread, struck
from xdynamics.march.contacts.projection import choose
from xdynamics.march.run import Run
from xdynamics.march.trial_step import usual_step
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL, SLIP
from xdynamics.model.reactions import MODES, NORMAL, TANGENT
from xdynamics.schema import BACKWARD, CLOSED, FORWARD, LOOSE, OPEN, SETTLING, STICKING

FLAT = 1e-9  # of the largest that a reaction did to its own row: a gap has no gradient there
ALIKE = 1e-10  # of what a reaction does to its own row: what is left where others do the same


@shared
def derive(run: Run) -> bool:
    """Find what contacts and friction do from the state, and say so to the forces; whether there is an answer."""
    for k in range(run.touches.shape[0]):
        assign(run, k)
    solved = run.at[UNSOUND] == 0.0 and sensible(run) and solvable(run) and solve_reactions(run)
    if solved:
        for k in range(run.touches.shape[0]):
            conclude(run, k)
    inform(run)
    return solved


@shared
def assign(run: Run, k: int) -> None:
    """Give a reaction its part among the forces."""
    one, reaction = run.touches[k], run.reactions[k]
    rate = number(run, k, RATE)
    still = abs(rate) <= one.slack
    one.origin, one.known, one.part = number(run, k, FREE), 0.0, ABSENT
    if reaction.role == NORMAL:
        settles = one.state == SETTLING and one.near and one.hit != PULL
        # a method of low order may close a gap that, by its velocities, opens
        late = one.hit == GAP and not struck(run) and rate <= abs(one.origin) * run.trial[0].h
        if settles or (one.near and (still or late) and one.hit != PULL):
            one.part = PRESSING
        return
    if reaction.role == TANGENT and run.touches[reaction.normal].part == ABSENT:
        return
    one.way = 1 if rate > 0.0 else -1
    if one.hit == GRIP and (still or one.state == STICKING):
        one.way, still = (-1 if number_of_force(run, k) > 0.0 else 1), False
    elif one.hit == SLIP:
        still = True
    if still:
        one.part, one.coefficient, one.bound = GRIPPING, number(run, k, MOST), 0.0 if reaction.role == TANGENT else number(run, k, MOST)  # fmt: skip
    elif reaction.role == TANGENT:
        one.part, one.coefficient = SLIDING, number(run, k, SIZE)
    else:
        one.part, one.known = KNOWN, -one.way * number(run, k, SIZE)


@shared
def number_of_force(run: Run, k: int) -> float:
    """The force of a reaction at the trial's state, as the last evaluation has it."""
    return run.z[run.plan[0].pressed + k]


@shared
def sensible(run: Run) -> bool:
    """Whether no friction pushes on, none sticks with less than it slips with, and no gap closes without a normal."""
    found = True
    for k in range(run.touches.shape[0]):
        if run.touches[k].near:
            found = found and gram(run, k, k) > FLAT * run.touches[k].steepest
        if run.reactions[k].role != NORMAL:
            size, most = number(run, k, SIZE), number(run, k, MOST)
            found = found and size >= 0.0 and most >= size
    return found


@shared
def solvable(run: Run) -> bool:
    """Whether what slides leaves one answer: pressing harder has to push apart (Painleve, 1895)."""
    for k in range(run.touches.shape[0]):
        one = run.touches[k]
        if one.part == SLIDING:
            normal = run.reactions[k].normal
            if not gram(run, normal, normal) - one.way * one.coefficient * gram(run, normal, k) > 0.0:
                return False
    return True


@shared
def conclude(run: Run, k: int) -> None:
    """Say what a reaction does, from the forces and accelerations that were found."""
    one = run.touches[k]
    if run.reactions[k].role == NORMAL:
        if one.part != PRESSING or parts(run, k):
            one.state = OPEN
        elif one.state != SETTLING or one.hit == LIMIT:
            one.state = CLOSED
        return
    if one.part == ABSENT or (run.reactions[k].role == TANGENT and run.touches[run.reactions[k].normal].state == OPEN):
        one.state = LOOSE
    elif one.part == GRIPPING and not slips(run, k):
        one.state = STICKING
    else:
        if one.part == GRIPPING:
            one.way = 1 if one.after > 0.0 else -1
        one.state = FORWARD if one.way > 0 else BACKWARD


@shared
def parts(run: Run, k: int) -> bool:
    """Whether a contact that touches opens."""
    return bool(run.touches[k].after > NOISE * terms(run, k))


@shared
def inform(run: Run) -> None:
    """Put what contacts do behind the parameters, and wake the detectors of what may come next."""
    for k in range(run.touches.shape[0]):
        one = run.touches[k]
        if run.plan[0].stepping:
            run.modes[MODES * k], run.modes[MODES * k + 1] = 0.0, 0.0
        elif run.reactions[k].role == NORMAL:
            run.modes[MODES * k] = 0.0 if one.state == OPEN else 1.0
            run.modes[MODES * k + 1] = one.limit if one.state == SETTLING else 0.0
        else:
            run.modes[MODES * k] = 1.0 if one.state == STICKING else 0.0
            run.modes[MODES * k + 1] = 1.0 if one.state == FORWARD else (-1.0 if one.state == BACKWARD else 0.0)
    relieve(run)
    for i in range(run.detectors.shape[0]):
        wake(run, i)


@shared
def relieve(run: Run) -> None:
    """Let those hold nothing that hold what others hold already.

    Two corners of a block on a floor both keep it from sliding, and rigid bodies do not tell which force does how much of
    it: the motion is one, and the first of them have all of the force. Found by L D L^T of what holds.
    """
    count = choose(run, True)
    for i in range(count):
        for j in range(i + 1):
            total = gram(run, run.chosen[i], run.chosen[j])
            for k in range(j):
                total -= run.square[i * count + k] * run.square[j * count + k] * run.column[k]
            if i != j:
                run.square[i * count + j] = total / run.column[j] if run.column[j] > 0.0 else 0.0
            elif total > ALIKE * gram(run, run.chosen[i], run.chosen[i]):
                run.column[i] = total
            else:
                run.column[i] = 0.0
                run.modes[MODES * run.chosen[i]] = 0.0


@shared
def lingers(run: Run, k: int) -> bool:
    """Whether a contact that is open stays as good as closed: neither its rate nor its acceleration opens it in a step.

    Where nothing presses, as between balls that hang side by side, rounding alone would make it open and close. What is
    pulled open leaves at no rate and no acceleration, too, but for good.
    """
    one, h = run.touches[k], usual_step(run)
    touches = one.state == OPEN and one.near == 1 and one.hit != PULL and abs(number(run, k, RATE)) <= one.slack
    return bool(touches and abs(one.after) * h * h <= spread(run, k))


@shared
def wake(run: Run, i: int) -> None:
    """Have a detector look, or sleep; a gap may not be negative, nor what presses or grips."""
    detector, watch = run.detectors[i], run.watches[i]
    if detector.reaction < 0:
        return
    state = run.touches[detector.reaction].state
    watch.guard, watch.floor, awake = 1, 0.0, False
    if detector.role == GAP:
        awake = state == OPEN
        run.lingering[detector.reaction] = spread(run, detector.reaction) if lingers(run, detector.reaction) else 0.0
        watch.floor = 4.0 * EPS * size_of_gap(run, detector.reaction)
        if run.touches[detector.reaction].near:  # it opens from what is left of it, and that is its zero
            watch.floor = max(watch.floor, 2.0 * abs(number(run, detector.reaction, GAP_OF)))
    elif detector.role == PULL:
        awake = state != OPEN
    elif detector.role == LIMIT:
        watch.guard, awake = -1, state == SETTLING
    elif detector.role == GRIP:
        awake = state == STICKING
    else:
        watch.guard, awake = 1 if state == FORWARD else -1, state in (FORWARD, BACKWARD)
    if watch.asleep and awake:
        watch.greatest = 0.0
    watch.asleep = 0 if awake and not run.plan[0].stepping else 1
