"""Contacts whose bounces shrink: when the bounces end, and when skipping them begins."""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.contacts.active_set import inform, solve_active_set
from xdynamics.march.contacts.delassus import SUM_NOISE
from xdynamics.march.contacts.gaps import BLUR, had_impact, size_of_gap
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP, PULL
from xdynamics.model.reactions import NORMAL
from xdynamics.schema import CLOSED, OPEN, SETTLING

LOW = 1e-9  # of the largest gap so far: height of bounces that may be skipped, unless the model states one
ROUNDS = 4  # of examining again which contacts settle


@jit_separate
def bounce(run: Run, t: float) -> bool:
    """Let contacts settle whose bounces shrink to nothing; whether there is a solution then."""
    impact = had_impact(run)
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role == NORMAL:
            run.touches[k].way = 0  # 1 once it was examined
    for _ in range(ROUNDS):
        changed = False
        for k in range(run.touches.shape[0]):
            touch = run.touches[k]
            leaves = run.reactions[k].role == NORMAL and touch.near == 1 and touch.state == OPEN and touch.hit != PULL
            if leaves and touch.way == 0 and ((impact and ends_soon(run, k, t)) or unseen(run, k, t)):
                touch.state, changed = SETTLING, True
                touch.lost = run.links[k].rate * run.links[k].rate / (2.0 * run.delassus[k, k])
            touch.way = 1 if leaves else touch.way
        if not changed:
            break
        if not solve_active_set(run):
            return False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if (
            run.reactions[k].role == NORMAL
            and touch.state == SETTLING
            and touch.limit - t <= run.reactions[k].tolerance
        ):
            touch.state = CLOSED
    inform(run)
    return True


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
    """Whether bounces end at a known time, and all of them are low; that time is kept.

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
    touch.doubt = min(time_left, abs(limit - touch.limit))
    touch.limit = limit
    # what rounding of the gap and of t leaves uncertain of a time that every bounce passes on to the next
    blur = BLUR * (size / rate + abs(t)) / (1.0 - q)
    low = reaction.rest_height if reaction.rest_height >= 0.0 else LOW * touch.largest
    return bool(touch.doubt <= max(reaction.tolerance, blur) and height <= low)
