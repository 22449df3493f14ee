"""The active set: which contacts are open or closed at a state, and which friction elements stick or slip.

Contacts that touch and do not part are candidates; the accelerations decide which of them stay closed, and what sticks
or slips.

Of contacts whose bounces shrink, the end of the bounces and the bounce from which they are skipped are computed.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics import schema
from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.contacts.delassus import (
    ABSENT,
    BLUR,
    GRIPPING,
    KNOWN,
    PRESSING,
    SLIDING,
    SMALL,
    SUM_NOISE,
    TURNS,
    gap_width,
    had_impact,
    impact_spread,
    list_holding,
    look_at_links,
    move_along_reactions,
    size_of_gap,
    size_of_terms,
    slips,
    solve_compliantly,
    solve_reactions,
)
from xdynamics.march.run import Run
from xdynamics.march.trial_step import usual_step
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL, SLIP
from xdynamics.model.reactions import ALIKE, MODES, NORMAL, PIVOT_NOISE, TANGENT

FLAT = 1e-9  # of the largest effect of a reaction on its own row so far: below it, a gap has no gradient


@jit_separate
def solve_active_set(run: Run) -> bool:
    """Determine the modes of contacts and friction at the state, and inform the forces; whether they exist."""
    for k in range(run.touches.shape[0]):
        assign_part(run, k)
    sound = run.at[UNSOUND] == 0.0 and has_valid_friction(run) and solvable(run)
    if sound and run.plan[0].indeterminate and have_spare(run):
        return share_forces(run)
    solved = sound and solve_reactions(run)
    if solved:
        for k in range(run.touches.shape[0]):
            set_contact_mode(run, k)
    limited = inform(run)
    return share_forces(run) if limited and solved and run.plan[0].indeterminate else solved


@jit_separate
def have_spare(run: Run) -> bool:
    """Whether more reactions may hold than need to, of those that press or grip, or are at their bound without a slip."""
    count, holding = 0, 0
    for holds in (True, False):
        for k in range(run.touches.shape[0]):
            touch = run.touches[k]
            limited = touch.part in (SLIDING, KNOWN) and abs(run.links[k].rate) <= touch.slack
            if touch.part in (PRESSING, GRIPPING) if holds else limited:
                run.chosen[count] = k
                count += 1
        holding = count if holds else holding
    return mark_spare(run, count, holding)


@jit_separate
def share_forces(run: Run) -> bool:
    """Determine the modes where more reactions hold than need to, as if all gave way alike, and inform the forces.

    Returns
    -------
    bool
        Whether these modes exist.
    """
    limit_friction(run)
    for turn in range(run.touches.shape[0] + 2):
        # first with what gives way, of which the shares are; then as it is, whether that can be held
        if not solve_compliantly(run, 1 if turn == 0 else TURNS):
            return False
        slipped = let_slip(run)
        for k in range(run.touches.shape[0]):
            set_contact_mode(run, k)
        inform(run)
        if turn == 0:
            leave_out_unloaded(run)
        limited = limit_friction(run)  # a call of its own: an `or` would leave it out
        if turn > 0 and not (slipped or limited):
            break
    return True


@jit_separate
def leave_out_unloaded(run: Run) -> None:
    """Leave out contacts that have no share though they touch, and that others hold: what is nearer to none would have some."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if run.reactions[k].role == NORMAL and touch.state == schema.OPEN and run.spare[k] == 1:
            touch.part = ABSENT


@jit_separate
def let_slip(run: Run) -> bool:
    """Have grips slide that slip by the last solution, or give way at their bound; whether there is any."""
    changes = False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if touch.part == GRIPPING and slips(run, k):
            touch.way, changes = (1 if touch.after > 0.0 else -1), True
            take_sliding_part(run, k)
    return changes


@jit_separate
def limit_friction(run: Run) -> bool:
    """Give friction of grips that others keep from slipping its greatest value, else that of a slip; whether any changes."""
    changes = False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        size = run.links[k].most if run.spare[k] == 1 else run.links[k].coefficient
        if touch.part == SLIDING:
            changes = changes or touch.coefficient != size
            touch.coefficient = size
        elif touch.part == KNOWN:
            changes = changes or touch.known != -touch.way * size
            touch.known = -touch.way * size
    return changes


@jit_separate
def assign_part(run: Run, k: int) -> None:
    """Give a reaction its part among the forces."""
    touch, reaction = run.touches[k], run.reactions[k]
    rate = run.links[k].rate
    still = abs(rate) <= touch.slack
    touch.origin, touch.known, touch.part = run.links[k].free, 0.0, ABSENT
    if reaction.role == NORMAL:
        # it was skipping bounces no faster than this; an impact of others may open it
        skipped = max(touch.slack, (1.0 + SMALL) * sqrt(2.0 * run.delassus[k, k] * touch.lost))
        settles = touch.state == schema.SETTLING and touch.near and touch.hit != PULL
        settles = settles and not (had_impact(run) and rate > skipped)
        # a method of low order may close a gap that, by its velocities, opens
        late = touch.hit == GAP and not had_impact(run) and rate <= abs(touch.origin) * run.trial[0].h
        if settles or (touch.near and (still or late) and touch.hit != PULL):
            touch.part = PRESSING
        return
    if reaction.role == TANGENT and run.touches[reaction.normal].part == ABSENT:
        return
    touch.way = 1 if rate > 0.0 else -1
    if touch.hit == GRIP and (still or touch.state == schema.STICKING):
        # what begins to slip moves against the force that held it; its rate is still rounding
        touch.way, still = (-1 if number_of_force(run, k) > 0.0 else 1), False
    elif touch.hit == SLIP:
        still = True
    if still:
        touch.part, touch.coefficient = GRIPPING, run.links[k].most
        touch.bound = 0.0 if reaction.role == TANGENT else run.links[k].most
    else:
        take_sliding_part(run, k)


@jit_separate
def take_sliding_part(run: Run, k: int) -> None:
    """Give friction the part of one that slips."""
    touch = run.touches[k]
    if run.reactions[k].role == TANGENT:
        touch.part, touch.coefficient = SLIDING, run.links[k].coefficient
    else:
        touch.part, touch.known = KNOWN, -touch.way * run.links[k].coefficient


@jit_separate
def number_of_force(run: Run, k: int) -> float:
    """The force of a reaction at the trial's state, by the last evaluation."""
    return run.z[run.plan[0].pressed + k]


@jit_separate
def has_valid_friction(run: Run) -> bool:
    """Whether no friction drives, none sticks with less than it slips with, and no gap closes without a normal."""
    valid = True
    for k in range(run.touches.shape[0]):
        if run.touches[k].near:
            valid = valid and run.delassus[k, k] > FLAT * run.touches[k].steepest
        if run.reactions[k].role != NORMAL:
            size, static_friction = run.links[k].coefficient, run.links[k].most
            valid = valid and size >= 0.0 and static_friction >= size
    return valid


@jit_separate
def solvable(run: Run) -> bool:
    """Whether sliding leaves a unique solution: pressing harder has to push apart (Painleve, 1895)."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if touch.part == SLIDING:
            normal = run.reactions[k].normal
            if not run.delassus[normal, normal] - touch.way * touch.coefficient * run.delassus[normal, k] > 0.0:
                return False
    return True


@jit_separate
def set_contact_mode(run: Run, k: int) -> None:
    """Set the mode of a reaction from the last forces and accelerations."""
    touch = run.touches[k]
    if run.reactions[k].role == NORMAL:
        if touch.part != PRESSING or contact_opens(run, k):
            touch.state = schema.OPEN
        elif touch.state != schema.SETTLING or touch.hit == LIMIT:
            touch.state = schema.CLOSED
        return
    if touch.part == ABSENT or (
        run.reactions[k].role == TANGENT and run.touches[run.reactions[k].normal].state == schema.OPEN
    ):
        touch.state = schema.LOOSE
    elif touch.part == GRIPPING and not slips(run, k):
        touch.state = schema.STICKING
    else:
        if touch.part == GRIPPING:
            touch.way = 1 if touch.after > 0.0 else -1
        touch.state = schema.FORWARD if touch.way > 0 else schema.BACKWARD


@jit_separate
def contact_opens(run: Run, k: int) -> bool:
    """Whether a contact that touches opens."""
    return bool(run.touches[k].after > SUM_NOISE * size_of_terms(run, k))


@jit_separate
def inform(run: Run) -> bool:
    """Store the modes of contacts after the parameters, and wake the detectors of possible next events.

    Returns
    -------
    bool
        Whether more reactions hold than needs holding.
    """
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if run.plan[0].steps_over > 0:
            run.modes[MODES * k], run.modes[MODES * k + 1] = 0.0, 0.0
        elif run.reactions[k].role == NORMAL:
            run.modes[MODES * k] = 0.0 if touch.state == schema.OPEN else 1.0
            run.modes[MODES * k + 1] = touch.limit if touch.state == schema.SETTLING else 0.0
        else:
            run.modes[MODES * k] = 1.0 if touch.state == schema.STICKING else 0.0
            run.modes[MODES * k + 1] = (
                1.0 if touch.state == schema.FORWARD else (-1.0 if touch.state == schema.BACKWARD else 0.0)
            )
    if run.plan[0].indeterminate:
        for i in range(run.touches.shape[0] * (run.touches.shape[0] - 1) // 2):
            run.modes[MODES * run.touches.shape[0] + i] = 0.0
    indeterminate = find_spare(run)
    for i in range(run.detectors.shape[0]):
        update_detector(run, i)
    return indeterminate


@jit_separate
def find_spare(run: Run) -> bool:
    """Find reactions whose rows follow from those of others before them, by L D L^T of those that hold; whether there is any.

    Two corners of a block on a floor both keep it from sliding, and the second is spare. So is one that is at the limit
    of its friction while the first holds: it does not slip.
    """
    holding = list_holding(run, True)
    count = list_limited(run, holding) if run.plan[0].indeterminate else holding
    indeterminate = mark_spare(run, count, holding)
    for i in range(count if indeterminate else 0):
        if run.spare[run.chosen[i]] == 1:
            bear_spare(run, i, count)
    return indeterminate


@jit_separate
def mark_spare(run: Run, count: int, holding: int) -> bool:
    """Mark the listed reactions whose rows follow from rows before, of those that hold; whether there is any.

    Their factors L are in `square`, the pivots D in `column`.
    """
    indeterminate = False
    for k in range(run.touches.shape[0]):
        run.spare[k] = 0
    for i in range(count):
        noise = 0.0  # of the pivot, by what is left of those before
        for j in range(i + 1):
            total = run.delassus[run.chosen[i], run.chosen[j]]
            for k in range(j):
                total -= run.square[i * count + k] * run.square[j * count + k] * run.column[k]
            if i != j:
                # a pivot of zero marks a spare reaction, which takes no part in later rows
                run.square[i * count + j] = total / run.column[j] if run.column[j] > 0.0 else 0.0
                noise += PIVOT_NOISE * run.square[i * count + j] ** 2 * run.delassus[run.chosen[j], run.chosen[j]]
            elif total > max(noise, ALIKE * run.delassus[run.chosen[i], run.chosen[i]]):
                run.column[i] = total if i < holding else 0.0
            else:
                run.column[i], run.spare[run.chosen[i]], indeterminate = 0.0, 1, True
    return indeterminate


@jit_separate
def list_limited(run: Run, count: int) -> int:
    """List, behind reactions that hold, those at their limit that do not move, which press with nothing or are about to slip."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touches = touch.near == 1 if run.reactions[k].role == NORMAL else touch.state != schema.LOOSE
        if touches and run.modes[MODES * k] == 0.0 and abs(run.links[k].rate) <= touch.slack:
            run.chosen[count] = k
            count += 1
    return count


@jit_separate
def bear_spare(run: Run, i: int, count: int) -> None:
    """Have a spare reaction that is listed share in what those bear that it follows from, or have all the friction it can."""
    k = run.chosen[i]
    if run.modes[MODES * k] == 0.0:
        if run.links[k].coefficient > 0.0:
            run.modes[MODES * k + 1] *= run.links[k].most / run.links[k].coefficient
        return
    run.modes[MODES * k] = 0.0
    if not run.plan[0].indeterminate:
        return
    first = MODES * run.touches.shape[0] + k * (k - 1) // 2
    # by how much of each row before it is its row, from L^T x = l; its force is these times their forces, scaled
    for j in range(i - 1, -1, -1):
        total = run.square[i * count + j]
        for m in range(j + 1, i):
            if run.column[m] > 0.0:
                total -= run.square[m * count + j] * run.modes[first + run.chosen[m]]
        run.modes[first + run.chosen[j]] = total if run.column[j] > 0.0 else 0.0
    for j in range(i):
        b = run.chosen[j]
        run.modes[first + b] *= run.delassus[b, b] / run.delassus[k, k]


@jit_separate
def stays_closed(run: Run, k: int) -> bool:
    """Whether an open contact stays as good as closed: neither its rate nor its acceleration opens it in a step.

    Where nothing presses, as between balls that hang side by side, rounding alone would make it open and close. One
    that is pulled open starts with no rate and no acceleration, too, but leaves for good.
    """
    touch, h = run.touches[k], usual_step(run)
    touches = (
        touch.state == schema.OPEN and touch.near == 1 and touch.hit != PULL and abs(run.links[k].rate) <= touch.slack
    )
    return bool(touches and abs(touch.after) * h * h <= impact_spread(run, k))


@jit_separate
def gap_that_stays(run: Run, k: int) -> float:
    """How wide a gap may be that is as good as closed, or that others keep from opening and from closing; else zero."""
    if run.spare[k] == 1:
        return max(impact_spread(run, k), gap_width(run, k))
    return impact_spread(run, k) if stays_closed(run, k) else 0.0


@jit_separate
def update_detector(run: Run, i: int) -> None:
    """Wake or suspend a detector; gaps, pressing forces and grips must stay non-negative."""
    detector, watch = run.detectors[i], run.watches[i]
    if detector.reaction < 0:
        return
    state = run.touches[detector.reaction].state
    watch.guard, watch.floor, awake = 1, 0.0, False
    if detector.role == GAP:
        awake = state == schema.OPEN
        run.lingering[detector.reaction] = gap_that_stays(run, detector.reaction)
        watch.floor = 4.0 * EPS * size_of_gap(run, detector.reaction)
        if run.touches[detector.reaction].near:  # it opens from what is left of it, and that is its zero
            watch.floor = max(watch.floor, 2.0 * abs(run.links[detector.reaction].gap))
    elif detector.role == PULL:
        awake = state != schema.OPEN
    elif detector.role == LIMIT:
        watch.guard, awake = -1, state == schema.SETTLING
    elif detector.role == GRIP:
        awake = state == schema.STICKING
    else:
        watch.guard, awake = 1 if state == schema.FORWARD else -1, state in (schema.FORWARD, schema.BACKWARD)
        awake = awake and run.spare[detector.reaction] == 0
    if watch.asleep and awake:
        watch.greatest = 0.0
    watch.asleep = 0 if awake and run.plan[0].steps_over == 0 else 1


LOW = 1e-9  # of the largest gap so far: height of bounces that may be skipped, unless the model states one
ROUNDS = 4  # of examining again which contacts settle


@jit_separate
def bounce(run: Run, t: float) -> bool:
    """Close contacts whose bounces shrink to nothing; whether there is a solution then."""
    impact = had_impact(run)
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role == NORMAL:
            run.touches[k].way = 0  # 1 once it was examined
    for _ in range(ROUNDS):
        changed = False
        for k in range(run.touches.shape[0]):
            touch = run.touches[k]
            leaves = (
                run.reactions[k].role == NORMAL and touch.near == 1 and touch.state == schema.OPEN and touch.hit != PULL
            )
            if leaves and touch.way == 0 and ((impact and ends_soon(run, k, t)) or unseen(run, k, t)):
                touch.state, changed = schema.SETTLING, True
                # kinetic energy of this rate, whose effective mass is the inverse of its own effect
                touch.lost = run.links[k].rate * run.links[k].rate / (2.0 * run.delassus[k, k])
            touch.way = 1 if leaves else touch.way
        if not changed:
            break
        if not (solve_at_rest(run, t) if has_friction(run) else solve_active_set(run)):
            return False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if (
            run.reactions[k].role == NORMAL
            and touch.state == schema.SETTLING
            and touch.limit - t <= run.reactions[k].tolerance
        ):
            touch.state = schema.CLOSED
    inform(run)
    return True


@jit_separate
def has_friction(run: Run) -> bool:
    """Whether there is any friction."""
    rubs = False
    for k in range(run.touches.shape[0]):
        rubs = rubs or run.reactions[k].role != NORMAL
    return rubs


@jit_separate
def solve_at_rest(run: Run, t: float) -> bool:
    """Solve for modes with the velocities that are left when bounces have been skipped, as slips change with their rates."""
    n, solved = run.plan[0].coordinates, True
    for i in range(n, 2 * n):
        run.half[i] = run.z[i]
    inform(run)
    for _ in range(ROUNDS):  # as what holds may be less than was thought
        count = list_holding(run, True)
        for i in range(count):
            run.column[i] = -run.links[run.chosen[i]].rate
        solved = solved and move_along_reactions(run, count, n)
        look_at_links(run, t)
        solved = solved and solve_active_set(run)
        for i in range(n, 2 * n):
            run.z[i] = run.half[i]
        look_at_links(run, t)
    return solved


@jit_separate
def unseen(run: Run, k: int, t: float) -> bool:
    """Whether a contact would open by less, or for a shorter time, than rounding resolves, and close again."""
    touch = run.touches[k]
    rate, fall = run.links[k].rate, -touch.after
    low = rate * rate <= 8.0 * SUM_NOISE * size_of_gap(run, k) * fall
    if not (fall > 0.0 and (low or abs(rate) <= BLUR * abs(t) * fall)):
        return False
    share = 1.0 - run.links[k].coefficient  # by which each remaining bounce is shorter than the last
    touch.limit, touch.doubt = t, 2.0 * abs(rate) / fall / share if share > 0.0 else inf
    return True


@jit_separate
def ends_soon(run: Run, k: int, t: float) -> bool:
    """Whether bounces end at a known time, which is stored, and all of them are low.

    Each time, a contact opens more slowly than the last time, by a factor q, and the next bounce takes q times as long:
    durations are a geometric series, for a ball (q is its coefficient of restitution) and, once it is small, for a
    rocking block. The uncertainty of the end is how far it is from the one predicted last, or from now.
    """
    touch, reaction = run.touches[k], run.reactions[k]
    rate, fall = run.links[k].rate, -touch.after
    speed_before, last_duration = touch.speed, t - touch.since
    touch.speed, touch.since = rate, t
    if not (fall > 0.0 and 0.0 < rate < speed_before):
        touch.limit = -inf
        return False
    q, height = rate / speed_before, rate * rate / (2.0 * fall)
    # of the next bounce: a flight, or the other corners' flights too
    duration = 2.0 * rate / fall if touch.hit == GAP else last_duration * q
    time_left, size = duration / (1.0 - q), size_of_gap(run, k)
    limit = t + time_left
    # before any prediction the limit is -inf, and the distance from it inf
    touch.doubt = min(time_left, abs(limit - touch.limit))
    touch.limit = limit
    # what rounding of the gap and of t leaves uncertain of a time that every bounce passes on to the next
    blur = BLUR * (size / rate + abs(t)) / (1.0 - q)
    low = reaction.rest_height if reaction.rest_height >= 0.0 else LOW * touch.largest
    return bool(touch.doubt <= max(reaction.tolerance, blur) and height <= low)
