"""How near contacts are, how fast what they hold apart moves, and what of both rounding leaves open."""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import T
from xdynamics.kernels.rounding_margins import EPS
from xdynamics.march.contacts.delassus import FREE, GAP_OF, NOISE, RATE, SIZE, gram, number, row
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.model.reactions import NORMAL, TANGENT
from xdynamics.schema import SETTLING

BLUR = 16.0 * EPS  # of what a gap is the difference of, or of t: less is not known


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
def spread(run: Run, k: int) -> float:
    """How far from zero impacts may have left a gap, each of which is met within the time tolerance, or the spacing of t.

    Bodies that stay together behind one are apart, or in each other, by as much: that is no flight, and no penetration.
    """
    return run.swiftest[k] * within(run, k)


@shared
def within(run: Run, k: int) -> float:
    """Within which time an event of a contact or friction is met: its tolerance, or the spacing of t."""
    return max(run.reactions[k].tolerance, BLUR * abs(run.at[T]))


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
        one.steepest = max(one.steepest, gram(run, k, k))
        run.swiftest[k] = max(run.swiftest[k], size)
        size = max(one.fastest, run.swiftest[k])
        one.slack = max(NOISE * size, (abs(number(run, k, FREE)) + brake(run, k)) * run.reactions[k].tolerance)
        one.near = 0
        if run.reactions[k].role == NORMAL:
            still = abs(number(run, k, RATE)) <= one.slack
            reach = max(width(run, k), spread(run, k)) if still else width(run, k)
            one.near = int(one.hit == GAP or number(run, k, GAP_OF) <= reach)


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


@shared
def struck(run: Run) -> bool:
    """Whether there was an impact."""
    found = False
    for k in range(run.touches.shape[0]):
        found = found or run.touches[k].total != 0.0
    return found
