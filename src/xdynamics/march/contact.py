"""What contacts and friction elements do: which are open, closed, sticking or slipping, and how that changes at events.

Behind every event all of it is derived again from the state: contacts that touch and do not part are candidates, and
the accelerations say which of them stay closed, what sticks and what slips.
"""

from __future__ import annotations

from math import inf
from typing import Any

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import UNSOUND, T
from xdynamics.march.handle import enclosed_by, run_at
from xdynamics.march.holding import choose, hold
from xdynamics.march.impact import NOISE, collide, noise
from xdynamics.march.intervals import EPS
from xdynamics.march.isolation import NONE
from xdynamics.march.landing import end
from xdynamics.march.linking import (
    ABSENT,
    FREE,
    GAP_OF,
    GRIPPING,
    KNOWN,
    MOST,
    PRESSING,
    RATE,
    SIZE,
    SLIDING,
    gram,
    look_at_links,
    number,
    row,
    slips,
    solve_reactions,
)
from xdynamics.march.log import first_of_group
from xdynamics.march.outcomes import CONTACT_PENETRATED, RUNNING
from xdynamics.march.proposing import copy
from xdynamics.march.run import ENCLOSE, HOLD, INFORM, RESOLVE, SETTLE, STEP_IN_TIME, Run
from xdynamics.march.stepping import step_in_time
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL, SLIP
from xdynamics.model.reactions import MODES, NORMAL, TANGENT
from xdynamics.schema import (
    CLOSED,
    IMPACT,
    OPEN,
    REASON_CONTACT,
    REST,
    SETTLING,
    TAKEOFF,
    TOUCH,
)
from xdynamics.schema import SLIP as SLIPPED
from xdynamics.schema import STICK as STUCK

FREE_OF_GRIP, STICKING, FORWARD, BACKWARD = range(4)  # as in `schema.FRICTION_STATES`
LOW = 1e-9  # of the largest gap so far: bounces that may be skipped, where the model does not say
ALIKE = 1e-10  # of what a reaction does to its own row: what is left where others do the same
BLUR = 16.0 * EPS  # of what a gap is the difference of, or of t: less is not known
ROUNDS = 4  # of looking again who settles


def touch(address: Any, t: float, what: int) -> None:
    """Do what contacts ask for; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`.
    t : float
        The time of the trial's state; the start's where the march begins.
    what : int
        `BEGIN`: find what touches at the start. `HOLD`: put the trial's state back on what is closed. `SETTLE`: do so
        with the state that the march stands at, behind an event after which bounces are skipped. `RESOLVE`: change the
        trial's state by impacts, and say what contacts do behind the events that it ends at. `INFORM`: tell the forces
        what contacts do, which was put there. `STEP_IN_TIME`: add what contacts do over a step, for Moreau's method.
    """
    run = run_at(address)
    if what == STEP_IN_TIME:
        step_in_time(run, t)
    elif what == HOLD:
        hold(run, t, True)
    elif what == SETTLE:
        settle(run, t)
    elif what == RESOLVE:
        if not run.plan[0].stepping:
            resolve(run, t)
    elif what == INFORM:
        copy(run.y, run.z)
        look_at_links(run, t)
        inform(run)
    else:
        begin(run, t)


@shared
def begin(run: Run, t: float) -> None:
    """Say what contacts and friction do at the start."""
    copy(run.y, run.z)
    look_at_links(run, t)
    for k in range(run.touches.shape[0]):
        one = run.touches[k]
        one.state, one.limit, one.lost, one.hit, one.known = OPEN, -inf, 0.0, NONE, 0.0
        one.speed, one.since, one.doubt, one.total, one.fastest = 0.0, t, 0.0, 0.0, 0.0
        one.largest = max(0.0, number(run, k, GAP_OF))
        if run.reactions[k].role == NORMAL and number(run, k, GAP_OF) < -width(run, k):
            run.now[0].status = CONTACT_PENETRATED
        one.held = OPEN
    if run.plan[0].stepping:
        inform(run)
        return
    measure(run)
    if not derive(run) and run.now[0].status == RUNNING:
        run.now[0].status = REASON_CONTACT
    for k in range(run.touches.shape[0]):
        run.touches[k].held = run.touches[k].state


@shared
def settle(run: Run, t: float) -> None:
    """Go on as if the bounces that are left were none."""
    waiting = False
    for k in range(run.touches.shape[0]):
        waiting = waiting or (run.reactions[k].role == NORMAL and run.touches[k].state == SETTLING)
    if waiting:
        copy(run.y, run.z)
        hold(run, t, True)
        copy(run.z, run.y)


@shared
def resolve(run: Run, t: float) -> None:
    """Change the trial's state by what happens to contacts at its end."""
    look_at_links(run, t)
    hear(run)
    measure(run)
    first = first_of_group(run, run.now[0].rows - 1)
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role == NORMAL and number(run, k, GAP_OF) < -(width(run, k) + run.touches[k].slack) and run.touches[k].hit == NONE:  # fmt: skip
            end(run, CONTACT_PENETRATED)
            return
    if approaching(run):
        if not collide(run):
            end(run, REASON_CONTACT)
            return
        note_impacts(run, first)
        for k in range(run.touches.shape[0]):
            run.touches[k].slack, run.touches[k].lost = noise(run, k), 0.0
        look_at_links(run, t)
    if not (derive(run) and bounce(run, t)):
        end(run, REASON_CONTACT)
        return
    note_changes(run, first)
    if choose(run, False) > 0:
        hold(run, t, False)
        if run.at[UNSOUND] != 0.0:
            end(run, REASON_CONTACT)


# ------------------------------------------------------------------------------------------------ what is there


@shared
def hear(run: Run) -> None:
    """Take down which detector has met each reaction."""
    for k in range(run.touches.shape[0]):
        one = run.touches[k]
        one.hit, one.total = NONE, 0.0
        if one.state != SETTLING:
            one.lost, one.doubt = 0.0, 0.0
    for i in range(run.detectors.shape[0]):
        detector = run.detectors[i]
        if detector.reaction >= 0 and run.watches[i].hit != NONE:
            run.touches[detector.reaction].hit = detector.role


@shared
def width(run: Run, k: int) -> float:
    """How wide a gap rounding alone may leave, and what it changes within the time tolerance."""
    return max(NOISE * size_of_gap(run, k), abs(number(run, k, RATE)) * run.reactions[k].tolerance)


@shared
def size_of_gap(run: Run, k: int) -> float:
    """How large the numbers are that a gap is the difference of."""
    size, n = abs(number(run, k, GAP_OF)), run.plan[0].coordinates
    moved = number(run, k, RATE)  # by time alone
    for i in range(n):
        size += abs(row(run, k, i) * run.z[i])
        moved -= row(run, k, i) * run.z[n + i]
    return max(size + abs(moved * run.at[T]), run.touches[k].largest)


@shared
def measure(run: Run) -> None:
    """Find which contacts touch, and what rates are uncertain by."""
    n = run.plan[0].coordinates
    for k in range(run.touches.shape[0]):
        one, size = run.touches[k], abs(number(run, k, RATE))
        for i in range(n):
            size += abs(row(run, k, i) * run.z[n + i])
        one.fastest = max(one.fastest, abs(number(run, k, RATE)))
        size = max(size, one.fastest)
        one.slack = max(NOISE * size, (abs(number(run, k, FREE)) + brake(run, k)) * run.reactions[k].tolerance)
        one.near = 0
        if run.reactions[k].role == NORMAL:
            one.near = int(one.hit == GAP or number(run, k, GAP_OF) <= width(run, k))


@shared
def brake(run: Run, k: int) -> float:
    """How much friction can slow a slip down."""
    if run.reactions[k].role == NORMAL:
        return 0.0
    force, normal = number(run, k, SIZE), run.reactions[k].normal
    if run.reactions[k].role == TANGENT:
        force *= abs(number(run, normal, FREE)) / gram(run, normal, normal)
    return force * gram(run, k, k)


@shared
def approaching(run: Run) -> bool:
    """Whether a contact that touches approaches."""
    found = False
    for k in range(run.touches.shape[0]):
        found = found or (run.touches[k].near == 1 and number(run, k, RATE) < -run.touches[k].slack)
    return found


# --------------------------------------------------------------------------------------------------- what follows


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
    """Whether no friction pushes on, and none sticks with less than it slips with."""
    found = True
    for k in range(run.touches.shape[0]):
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
        one.state = FREE_OF_GRIP
    elif one.part == GRIPPING and not slips(run, k):
        one.state = STICKING
    else:
        if one.part == GRIPPING:
            one.way = 1 if one.after > 0.0 else -1
        one.state = FORWARD if one.way > 0 else BACKWARD


@shared
def parts(run: Run, k: int) -> bool:
    """Whether a contact that touches opens."""
    one = run.touches[k]
    size = abs(one.origin)
    for j in range(run.touches.shape[0]):
        size += abs(gram(run, k, j) * run.touches[j].found)
    return bool(one.after > NOISE * size)


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
    enclosed_by(run.functions[ENCLOSE], run, run.z, run.z, 0, run.parts[0])


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
def wake(run: Run, i: int) -> None:
    """Have a detector look, or sleep; a gap may not be negative, nor what presses or grips."""
    detector, watch = run.detectors[i], run.watches[i]
    if detector.reaction < 0:
        return
    state = run.touches[detector.reaction].state
    watch.guard, watch.floor, awake = 1, 0.0, False
    if detector.role == GAP:
        awake = state == OPEN
        watch.floor = 4.0 * EPS * size_of_gap(run, detector.reaction)
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


# ------------------------------------------------------------------------------------------------------- bouncing


@shared
def struck(run: Run) -> bool:
    """Whether there was an impact."""
    found = False
    for k in range(run.touches.shape[0]):
        found = found or run.touches[k].total != 0.0
    return found


@shared
def bounce(run: Run, t: float) -> bool:
    """Have contacts settle whose bounces shrink to nothing; whether there is an answer then."""
    impact = struck(run)
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role == NORMAL:
            run.touches[k].way = 0  # 1 once it was asked
    for _ in range(ROUNDS):
        found = False
        for k in range(run.touches.shape[0]):
            one = run.touches[k]
            leaves = run.reactions[k].role == NORMAL and one.near == 1 and one.state == OPEN and one.hit != PULL
            if leaves and one.way == 0 and (unseen(run, k, t) or (impact and ends_soon(run, k, t))):
                one.state, found = SETTLING, True
                one.lost = number(run, k, RATE) * number(run, k, RATE) / (2.0 * gram(run, k, k))
            one.way = 1 if leaves else one.way
        if not found:
            break
        if not derive(run):
            return False
    for k in range(run.touches.shape[0]):
        one = run.touches[k]
        if run.reactions[k].role == NORMAL and one.state == SETTLING and one.limit - t <= run.reactions[k].tolerance:
            one.state = CLOSED
    inform(run)
    return True


@shared
def unseen(run: Run, k: int, t: float) -> bool:
    """Whether a contact would open by less, or for less long, than numbers can tell, and close again."""
    one = run.touches[k]
    rate, fall = number(run, k, RATE), -one.after
    low = rate * rate <= 8.0 * NOISE * size_of_gap(run, k) * fall
    if not (fall > 0.0 and (low or abs(rate) <= BLUR * abs(t) * fall)):
        return False
    one.limit, one.doubt = t, abs(rate) / fall
    return True


@shared
def ends_soon(run: Run, k: int, t: float) -> bool:
    """Whether bounces end at a time that is known, and all of them are low; that time is kept.

    Each time a contact opens more slowly than the last time, by a factor q, and what follows takes q times as long: the
    times are a geometric series, of a ball (q is its coefficient of restitution) and, once it is small, of a block that
    rocks. How far the sum is from that of the time before, or from now, is what it is uncertain by.
    """
    one, reaction = run.touches[k], run.reactions[k]
    rate, fall = number(run, k, RATE), -one.after
    before, past = one.speed, t - one.since
    one.speed, one.since = rate, t
    if not (fall > 0.0 and 0.0 < rate < before):
        one.limit = -inf
        return False
    q, height = rate / before, rate * rate / (2.0 * fall)
    one.largest = max(one.largest, height)
    again = 2.0 * rate / fall if one.hit == GAP else past * q  # a flight, or that of the other corners too
    rest, size = again / (1.0 - q), size_of_gap(run, k)
    limit = t + rest
    one.doubt = min(rest, abs(limit - one.limit))
    one.limit = limit
    # what rounding of the gap, and of t, leaves of a time that every bounce hands on to the next
    blur = BLUR * (size / rate + abs(t)) / (1.0 - q)
    low = reaction.rest_height if reaction.rest_height >= 0.0 else LOW * one.largest
    return bool(one.doubt <= max(reaction.tolerance, blur) and height <= low)


# ---------------------------------------------------------------------------------------------------- what is noted


@shared
def row_of(run: Run, k: int, first: int) -> int:
    """The row of the event that a reaction was met by; a new one where there is none."""
    for e in range(first, run.now[0].events - run.base[0].events):
        detector = run.detectors[run.log_events[e].detector]
        if detector.role == run.touches[k].hit and detector.reaction == k:
            return e
    return another_row(run, k, first)


@shared
def another_row(run: Run, k: int, first: int) -> int:
    """Write one more row of the group, of a reaction that no detector has met."""
    e = run.now[0].events - run.base[0].events
    one = run.log_events[e]
    one.time, one.left = run.trial[0].t, run.trial[0].t
    if e > first:
        one.left = run.log_events[first].left
    one.residual, one.slope, one.uncertainty, one.murk, one.substeps = 0.0, 0.0, 0.0, 0.0, 0
    one.interpolation = 0.0
    one.row_before, one.row_after, one.direction = run.now[0].rows - 1, run.now[0].rows, -1
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].reaction == k:
            one.detector = i
            break
    for i in range(run.log_rates.shape[0]):
        run.log_rates[i, e] = run.slopes[run.detectors.shape[0] + i]
    clear_impulses(run, e)
    run.now[0].events += 1
    return e


@shared
def clear_impulses(run: Run, e: int) -> None:
    """Say that an event had no impulse."""
    for i in range(run.log_impulses.shape[0]):
        run.log_impulses[i, e] = 0.0


@shared
def note_impacts(run: Run, first: int) -> None:
    """Note the impulse of each contact, and the energy that it took."""
    n = run.plan[0].coordinates
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role != NORMAL or run.touches[k].total == 0.0:
            continue
        e = row_of(run, k, first)
        run.log_events[e].kind = IMPACT
        for j in range(run.touches.shape[0]):
            if j == k or (run.reactions[j].role == TANGENT and run.reactions[j].normal == k):
                for i in range(n):
                    run.log_impulses[i, e] += row(run, j, i) * run.touches[j].total
                run.log_impulses[n, e] += run.touches[j].lost


@shared
def note_changes(run: Run, first: int) -> None:
    """Note what has become of contacts and friction behind the events."""
    for k in range(run.touches.shape[0]):
        one, held = run.touches[k], run.touches[k].held
        if run.reactions[k].role == NORMAL:
            note_contact(run, k, first)
        elif one.hit in (SLIP, GRIP):
            run.log_events[row_of(run, k, first)].kind = STUCK if one.state == STICKING else SLIPPED
        elif STICKING in (one.state, held) and one.state != held and FREE_OF_GRIP not in (one.state, held):
            run.log_events[another_row(run, k, first)].kind = STUCK if one.state == STICKING else SLIPPED
        one.held = one.state


@shared
def note_contact(run: Run, k: int, first: int) -> None:
    """Note that a contact came to rest, or opened."""
    one, struck = run.touches[k], run.touches[k].total != 0.0
    if one.hit == LIMIT and one.state == CLOSED:
        rest(run, k, row_of(run, k, first))
    elif one.hit == PULL:
        run.log_events[row_of(run, k, first)].kind = TAKEOFF
    elif one.state == CLOSED and one.held == OPEN:
        rest(run, k, another_row(run, k, first) if struck or one.hit == NONE else row_of(run, k, first))
    elif one.hit == GAP and not struck:
        run.log_events[row_of(run, k, first)].kind = TOUCH
    elif one.state == OPEN and one.held != OPEN and not struck:
        run.log_events[another_row(run, k, first)].kind = TAKEOFF


@shared
def rest(run: Run, k: int, e: int) -> None:
    """Note that a contact came to rest, with the energy of the bounces that were skipped."""
    run.log_events[e].kind, run.log_events[e].murk = REST, 2.0 * run.touches[k].doubt
    run.log_impulses[run.plan[0].coordinates, e] += run.touches[k].lost
