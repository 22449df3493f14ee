"""Locating the first event of a trial: its bracket is narrowed to the time tolerance by substeps of the method itself."""

from __future__ import annotations

from math import inf, nan

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.doubt import BREAKS, EPS, UNBOUNDED
from xdynamics.kernels.law import INSIDE, SLOPES
from xdynamics.kernels.program import T1, H, S, T
from xdynamics.march.evaluating import evaluate, finite_state
from xdynamics.march.events.certainty import ENDED, FORCED, LOOKS, NONE, STEEP, TOUCHED, resolution, sign
from xdynamics.march.handle import called
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.proposing import copy, keep, look, substep, take
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.schema import CLUSTER, CROSSING, JUMP, POLE, TOUCH

FAIR = 1e-3  # of what a sampled function changes by from look to look: less is no jump
ROOT_METHOD = "ITP bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597) on re-integrated substeps; the right end is accepted"


@shared
def locate(run: Run) -> None:
    """Shrink the trial until it ends just behind its first event, ties with it; substeps on the way are rejected trials."""
    first = inf
    for i in range(run.detectors.shape[0]):
        run.watches[i].drift = 0.0
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit != NONE:
            first = min(first, run.watches[i].right)
    if first != run.located[0].h:
        substep(run, first)
        keep(run)
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit not in (NONE, ENDED) and happened(run, i, run.located[0].h):
            bracket(run, i, run.watches[i].left)
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit != NONE and not happened(run, i, run.located[0].h):
            join(run, i)
    settle(run, first)
    take(run)


@shared
def settle(run: Run, first: float) -> None:
    """Leave events for a later step that the located trial does not reach; one is in it, whatever rounding says."""
    left = False
    for i in range(run.detectors.shape[0]):
        left = left or (run.watches[i].hit != NONE and happened(run, i, run.located[0].h))
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit != NONE and not (happened(run, i, run.located[0].h) if left else watch.right == first):
            watch.hit = NONE


@shared
def join(run: Run, i: int) -> None:
    """Have the trial end behind an event too that follows the first within its time tolerance."""
    before = run.located[0].h
    s = min(before + resolution(run, i, before), run.watches[i].right)
    if not max(before, run.watches[i].left) < s:
        return
    substep(run, s)
    if run.trial[0].iterations >= 0 and passed(run, i, measured(run, i)) and placed(run):
        keep(run)
        run.watches[i].left, run.watches[i].before = before, nan


@shared
def placed(run: Run) -> bool:
    """Whether every event that the trial ends behind is as near to its zero as is asked for."""
    near = True
    for i in range(run.detectors.shape[0]):
        asked = run.detectors[i].position
        if asked < inf and run.watches[i].hit not in (NONE, TOUCHED, ENDED) and passed(run, i, run.g1[i]):
            near = near and abs(run.g1[i]) <= asked
    return near


@shared
def happened(run: Run, i: int, s: float) -> bool:
    """Whether the located trial ends behind an event."""
    if run.watches[i].hit == ENDED:
        return True
    copy(run.located_z, run.z)
    copy(run.located_g, run.g1)
    run.at[T] = run.now[0].t + s
    return passed(run, i, measured(run, i))


@compiled
def passed(run: Run, i: int, value: float) -> bool:
    """Whether what changes its sign at an event has done so; zero is the other side."""
    return value >= 0.0 if run.watches[i].armed < 0 else value <= 0.0


@shared
def measured(run: Run, i: int) -> float:
    """What changes its sign at an event, at the trial's end: its function, or where that only touches its slope."""
    if run.watches[i].hit != TOUCHED:
        return run.g1[i]
    called(run.law[SLOPES], run, run.z, run.slopes, 0)
    return -run.slopes[i]


@shared
def bracket(run: Run, i: int, left: float) -> None:
    """Narrow one event's bracket [low, high] of steps to its time tolerance, by the ITP method.

    Event i has not happened at `low` and has at `high`, where the located trial ends; where another event is earlier, a
    later call narrows further.
    """
    t, watch = run.now[0].t, run.watches[i]
    low, high = left, run.located[0].h
    at_high = measured(run, i)
    if run.detectors[i].interpolant:
        substep(run, run.piece[0].full)  # the interpolant is that of the whole step's stages
    at_low = start_of(run, i, low)
    if run.detectors[i].interpolant and low > 0.0 and sign(at_low) != watch.armed:
        low = 0.0  # by the interpolant it is earlier than by the shortened step
        at_low = start_of(run, i, low)
    spacing, place = 2.0 * EPS * max(abs(t), abs(t + high)), inf if watch.hit == TOUCHED else run.detectors[i].position
    asked = max(run.detectors[i].tolerance, spacing)
    # where a place is asked for too, the time may have to be known as well as numbers tell it
    tolerance = asked if place == inf else spacing
    slack, scale = reach(high - low, tolerance), 0.2 / (high - low)
    believed = sign(at_low) == watch.armed
    for _ in range(MOST_SUBSTEPS - 1):
        if high - low <= tolerance or (high - low <= asked and abs(at_high) <= place):
            break
        if sign(at_low) != watch.armed:  # too small to be believed: only the side is
            at_low = -at_high if at_high != 0.0 else float(watch.armed)
        s = itp(low, high, at_low, at_high, scale, slack - (high - low) / 2.0)
        slack = slack / 2.0
        if s >= high:  # the point fell on an end of the bracket: probe a tolerance inside it
            s = max((low + high) / 2.0, high - tolerance)
        elif s <= low:
            s = min((low + high) / 2.0, low + tolerance)
        if not low < s < high:
            break
        probe(run, i, s)
        if (
            run.trial[0].iterations < 0
        ):  # equations that were not solved tell nothing: the bracket stays as wide as it is
            break
        value = measured(run, i)
        if passed(run, i, value):
            high, at_high = s, value
            keep(run)
        else:
            low, at_low, believed = s, value, True
    watch.left, watch.right, watch.before = low, high, at_low
    if run.detectors[i].interpolant:
        note_drift(run, i)
    if run.detectors[i].role == GAP:
        polish(run, i, at_high if believed else 0.0)


@shared
def polish(run: Run, i: int, at_high: float) -> None:
    """Move the right end next to the zero by one secant more: what is left of a gap goes into every bounce behind it.

    Where it was zero from the left end on, with no value to go by, `at_high` is 0.
    """
    watch, t = run.watches[i], run.now[0].t
    low, high, at_low = watch.left, watch.right, watch.before
    root = low if at_high == 0.0 else (at_high * low - at_low * high) / (at_high - at_low)
    s = root + 2.0 * EPS * max(abs(t), abs(t + high))
    if not low < s < high:
        return
    probe(run, i, s)
    if run.trial[0].iterations >= 0 and passed(run, i, measured(run, i)):
        keep(run)
        watch.right = s


@shared
def probe(run: Run, i: int, s: float) -> None:
    """Have the state after part of the trial: of a shortened step, or where the event asks for it of the interpolant."""
    now, piece, used = run.now[0], run.piece[0], run.plan[0].used
    if not run.detectors[i].interpolant or s >= piece.full:
        substep(run, s)
        return
    run.at[T], run.at[T1], run.at[H], run.at[S] = now.t, now.t + piece.full, piece.full, s / piece.full
    called(run.law[INSIDE], run, run.y, run.full, 0)
    for k in range(used):
        run.z[k], run.e[k] = run.e[k], run.full_e[k]
    evaluate(run, now.t + s, run.z)
    run.trial[0].t, run.trial[0].h, run.trial[0].iterations = now.t + s, s, 0
    run.trial[0].unsound = 0.0 if finite_state(run) else nan
    look(run)


@shared
def note_drift(run: Run, i: int) -> None:
    """Note how far the event function on the interpolant is from that of the shortened step."""
    s, value = run.located[0].h, run.located_g[i]
    substep(run, s)
    run.watches[i].drift = abs(run.g1[i] - value) if run.trial[0].iterations >= 0 else inf


@shared
def start_of(run: Run, i: int, s: float) -> float:
    """What changes its sign at an event, at the left end of its bracket."""
    if s > 0.0:
        probe(run, i, s)
        return measured(run, i)
    if run.watches[i].hit != TOUCHED:
        return run.g[i]
    run.at[T] = run.now[0].t
    called(run.law[SLOPES], run, run.y, run.slopes, 0)
    return -run.slopes[i]


@shared
def kind_of(run: Run, i: int) -> int:
    """Tell a crossing from a touch, a jump, a pole, and from what could not be told apart; slopes are those at the end."""
    watch, after = run.watches[i], run.g1[i]
    if watch.hit in (TOUCHED, ENDED):
        return TOUCH
    if run.detectors[i].sampled:
        explained = STEEP * (watch.up * (watch.right - watch.left) + EPS * watch.greatest)
        over_a_look = watch.up * (run.piece[0].full / LOOKS)  # equations that are solved leave more than rounding does
        return JUMP if abs(after - watch.before) > max(explained, FAIR * over_a_look) else CROSSING
    if watch.broken >= BREAKS:
        if watch.broken == UNBOUNDED and min(abs(watch.before), abs(after)) > STEEP * watch.greatest:
            return POLE
        width = watch.right - watch.left
        if abs(after - watch.before) > STEEP * (abs(run.slopes[i]) * width + EPS * watch.greatest):
            return JUMP
    return CLUSTER if watch.hit == FORCED else CROSSING


@compiled
def reach(width: float, tolerance: float) -> float:
    """(tolerance/2) * 2**(n + 1), with n the halvings that bisection needs: the slack of ITP's first step."""
    slack = tolerance
    while slack < width:
        slack = 2.0 * slack
    return slack


@compiled
def itp(low: float, high: float, at_low: float, at_high: float, scale: float, slack: float) -> float:
    """Interpolate, truncate towards the middle, project: one step of ITP with kappa_2 = 2, n_0 = 1."""
    middle = (low + high) / 2.0
    secant = (at_high * low - at_low * high) / (at_high - at_low)
    if not low <= secant <= high:  # of infinities
        secant = middle
    side = 1.0 if middle >= secant else -1.0
    shift = scale * (high - low) * (high - low)
    point = secant + side * shift if shift <= abs(middle - secant) else middle
    return point if abs(point - middle) <= slack else middle - side * slack
