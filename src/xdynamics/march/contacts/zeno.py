"""Contacts whose bounces shrink: when they end, and from which on they are skipped."""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import shared
from xdynamics.march.contacts.active_set import derive, inform
from xdynamics.march.contacts.delassus import NOISE, RATE, SIZE, gram, number
from xdynamics.march.contacts.gaps import BLUR, size_of_gap, struck
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP, PULL
from xdynamics.model.reactions import NORMAL
from xdynamics.schema import CLOSED, OPEN, SETTLING

LOW = 1e-9  # of the largest gap so far: bounces that may be skipped, where the model does not say
ROUNDS = 4  # of looking again who settles


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
            if leaves and one.way == 0 and ((impact and ends_soon(run, k, t)) or unseen(run, k, t)):
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
    share = 1.0 - number(run, k, SIZE)  # of all bounces that are left each is shorter than the last by as much
    one.limit, one.doubt = t, 2.0 * abs(rate) / fall / share if share > 0.0 else inf
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
    again = 2.0 * rate / fall if one.hit == GAP else past * q  # a flight, or that of the other corners too
    rest, size = again / (1.0 - q), size_of_gap(run, k)
    limit = t + rest
    one.doubt = min(rest, abs(limit - one.limit))
    one.limit = limit
    # what rounding of the gap, and of t, leaves of a time that every bounce hands on to the next
    blur = BLUR * (size / rate + abs(t)) / (1.0 - q)
    low = reaction.rest_height if reaction.rest_height >= 0.0 else LOW * one.largest
    return bool(one.doubt <= max(reaction.tolerance, blur) and height <= low)
