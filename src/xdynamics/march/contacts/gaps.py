"""Gaps of contacts, their rates, and how uncertain rounding leaves both."""

from __future__ import annotations

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import T
from xdynamics.march.contacts.delassus import SUM_NOISE
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.model.reactions import NORMAL, TANGENT
from xdynamics.schema import SETTLING

BLUR = 16.0 * EPS  # of the numbers whose difference a gap is, or of t: less is not resolved


@jit_separate
def collect_detectors(run: Run) -> None:
    """Note which detector has located an event of each reaction."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touch.hit, touch.total = NONE, 0.0
        if touch.state != SETTLING:
            touch.lost, touch.doubt = 0.0, 0.0
    for i in range(run.detectors.shape[0]):
        detector = run.detectors[i]
        if detector.reaction >= 0 and run.watches[i].hit != NONE:
            run.touches[detector.reaction].hit = detector.role


@jit_separate
def gap_width(run: Run, k: int) -> float:
    """How wide a gap may be by rounding alone, or by its rate and acceleration within the time tolerance.

    Of a gap that was never open nothing else is known: what holds it closed leaves rounding of any size.
    """
    time = run.reactions[k].tolerance
    return max(SUM_NOISE * size_of_gap(run, k), (abs(run.links[k].rate) + abs(run.links[k].free) * time) * time)


@jit_separate
def impact_spread(run: Run, k: int) -> float:
    """How far from zero impacts may have left a gap: each is located within the time tolerance, or the spacing of t.

    Bodies that stay together after an impact are apart, or overlap, by as much: that is neither flight nor penetration.
    """
    return run.swiftest[k] * location_time(run, k)


@jit_separate
def location_time(run: Run, k: int) -> float:
    """The time within which an event of a contact or friction is located: its tolerance, or the spacing of t."""
    return max(run.reactions[k].tolerance, BLUR * abs(run.at[T]))


@jit_separate
def size_of_gap(run: Run, k: int) -> float:
    """The size of the numbers whose difference a gap is."""
    size, n = abs(run.links[k].gap), run.plan[0].coordinates
    rate_by_time = run.links[k].rate  # by time alone
    for i in range(n):
        size += abs(run.directions[k, i] * run.z[i])
        rate_by_time -= run.directions[k, i] * run.z[n + i]
    return max(size + abs(rate_by_time * run.at[T]), run.touches[k].largest)


@jit_separate
def find_touching(run: Run) -> None:
    """Find which contacts touch, and how uncertain rates are."""
    n = run.plan[0].coordinates
    for k in range(run.touches.shape[0]):
        touch, size = run.touches[k], abs(run.links[k].rate)
        for i in range(n):
            size += abs(run.directions[k, i] * run.z[n + i])
        touch.fastest = max(touch.fastest, abs(run.links[k].rate))
        touch.steepest = max(touch.steepest, run.delassus[k, k])
        run.swiftest[k] = max(run.swiftest[k], size)
        size = max(touch.fastest, run.swiftest[k])
        touch.slack = max(SUM_NOISE * size, (abs(run.links[k].free) + brake(run, k)) * run.reactions[k].tolerance)
        touch.near = 0
        if run.reactions[k].role == NORMAL:
            still = abs(run.links[k].rate) <= touch.slack
            reach = max(gap_width(run, k), impact_spread(run, k)) if still else gap_width(run, k)
            touch.near = int(touch.hit == GAP or run.links[k].gap <= reach)


@jit_separate
def brake(run: Run, k: int) -> float:
    """The deceleration of a slip by friction at its limit."""
    if run.reactions[k].role == NORMAL:
        return 0.0
    force, normal = run.links[k].coefficient, run.reactions[k].normal
    if run.reactions[k].role == TANGENT:
        force *= abs(run.links[normal].free) / run.delassus[normal, normal]
    return force * run.delassus[k, k]


@jit_separate
def approaching(run: Run) -> bool:
    """Whether a contact that touches approaches."""
    approaches = False
    for k in range(run.touches.shape[0]):
        approaches = approaches or (run.touches[k].near == 1 and run.links[k].rate < -run.touches[k].slack)
    return approaches


@jit_separate
def had_impact(run: Run) -> bool:
    """Whether there was an impact."""
    impact = False
    for k in range(run.touches.shape[0]):
        impact = impact or run.touches[k].total != 0.0
    return impact
