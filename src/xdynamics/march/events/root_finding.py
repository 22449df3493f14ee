"""Locating the first event of a trial: substeps of the method itself narrow its bracket to the time tolerance."""

from __future__ import annotations

from math import inf, isnan, nan
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import BREAKS, EPS, SMOOTH, UNBOUNDED
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import INSIDE, SLOPES
from xdynamics.kernels.program import T1, H, S, T
from xdynamics.march.calls import call_law
from xdynamics.march.events.zero_tests import (
    CROSSED,
    ENDED,
    FORCED,
    LOOKS,
    NONE,
    STEEP,
    TOUCHED,
    event_resolution,
    sign_of,
)
from xdynamics.march.force_evaluation import evaluate_forces, finite_state, set_time
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers, evaluate_events, restore_trial, store_trial, substep
from xdynamics.model.detectors import GAP
from xdynamics.schema import CLUSTER, CROSSING, JUMP, POLE, TOUCH

State = NDArray[Any]

WAITING = -1.0  # in the place of the drift of an event whose bracket is not narrowed yet
FAIR = 1e-3  # of the change of a sampled function from look to look: less is not a jump
TURNS = 3  # in which narrowing by rates has to bring a bracket, or the value at one end, to an eighth


@jit_separate
def locate_events(run: Run) -> None:
    """Shrink the trial by substeps until it ends just after its first event, ties included."""
    first = inf
    for i in range(run.detectors.shape[0]):
        run.watches[i].drift = 0.0 if run.watches[i].hit in (NONE, ENDED) else WAITING
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit != NONE:
            first = min(first, run.watches[i].right)
    if first != run.located[0].h:
        substep(run, first)
        store_trial(run)
    for k in range(run.detectors.shape[0]):
        i = k if run.plan[0].apart else earliest_event(run)
        if i < 0:
            break
        if run.watches[i].drift == WAITING:
            run.watches[i].drift = 0.0
            if happened(run, i, run.located[0].h):
                narrow_bracket(run, i, run.watches[i].left)
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit != NONE and not happened(run, i, run.located[0].h):
            extend_to_event(run, i)
    drop_later_events(run, first)
    restore_trial(run)


@jit_separate
def earliest_event(run: Run) -> int:
    """Return which event seems to be first, of those that have happened and whose brackets wait; -1 if none.

    Where it is not first, those before it still wait: their brackets were narrowed along with it.
    """
    first, earliest_root = -1, inf
    for i in range(run.detectors.shape[0]):
        watch, high = run.watches[i], run.located[0].h
        if watch.drift == WAITING:
            if not happened(run, i, high):
                watch.drift = 0.0
            else:
                value_after, share = run.located_g[i], 0.0
                if watch.armed * watch.before > 0.0:
                    share = abs(watch.before) / (abs(watch.before) + abs(value_after))
                root = watch.left + share * (high - watch.left)
                if root < earliest_root:
                    first, earliest_root = i, root
    return first


@jit_separate
def raise_left_ends(run: Run, i: int, s: float) -> None:
    """Raise the left ends of waiting brackets where a substep for another event shows that theirs has not happened."""
    if run.plan[0].apart or run.detectors[i].interpolant:
        return
    for k in range(run.detectors.shape[0]):
        watch = run.watches[k]
        waits = k != i and watch.drift == WAITING and watch.hit == CROSSED and not run.detectors[k].interpolant
        if waits and watch.left < s and not has_passed(run, k, run.g1[k]):
            watch.left, watch.before = s, run.g1[k]


@jit_separate
def drop_later_events(run: Run, first: float) -> None:
    """Leave events beyond the located trial to a later step; at least one stays, despite rounding."""
    any_reached = False
    for i in range(run.detectors.shape[0]):
        any_reached = any_reached or (run.watches[i].hit != NONE and happened(run, i, run.located[0].h))
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit != NONE and not (happened(run, i, run.located[0].h) if any_reached else watch.right == first):
            watch.hit = NONE


@jit_separate
def extend_to_event(run: Run, i: int) -> None:
    """Extend the trial past an event that follows the first within its time tolerance."""
    first_end, t = run.located[0].h, run.now[0].t
    if not run.plan[0].apart and run.watches[i].hit == CROSSED and is_far(run, i, first_end):
        return
    rounding_step = 8.0 * EPS * max(abs(t), abs(t + first_end))  # rounding may put one of two simultaneous events later
    for distance in (rounding_step, event_resolution(run, i, first_end)):
        s = min(first_end + distance, run.watches[i].right)
        if (run.plan[0].apart and distance == rounding_step) or not max(first_end, run.watches[i].left) < s:
            continue
        substep(run, s)
        if run.trial[0].iterations >= 0 and has_passed(run, i, sign_quantity(run, i)) and positions_are_met(run):
            store_trial(run)
            run.watches[i].left, run.watches[i].before = first_end, nan
            return


@jit_separate
def is_far(run: Run, i: int, s: float) -> bool:
    """Whether an event function after the first event is too far from zero to be simultaneous."""
    if run.watches[i].broken != SMOOTH or run.detectors[i].sampled:
        return False
    rate = event_rate(run, i, run.located_z, s)
    return bool(abs(run.located_g[i]) > STEEP * event_resolution(run, i, s) * abs(rate))


@jit_separate
def positions_are_met(run: Run) -> bool:
    """Whether every event that the trial has passed is as near its zero as its tolerance of position demands."""
    near = True
    for i in range(run.detectors.shape[0]):
        tolerance = run.detectors[i].position
        if tolerance < inf and run.watches[i].hit not in (NONE, TOUCHED, ENDED) and has_passed(run, i, run.g1[i]):
            near = near and abs(run.g1[i]) <= tolerance
    return near


@jit_separate
def happened(run: Run, i: int, s: float) -> bool:
    """Whether the located trial ends after an event."""
    if run.watches[i].hit == ENDED:
        return True
    copy_numbers(run.located_z, run.z)
    copy_numbers(run.located_g, run.g1)
    set_time(run, T, run.now[0].t + s)
    return has_passed(run, i, sign_quantity(run, i))


@jit_inline
def has_passed(run: Run, i: int, value: float) -> bool:
    """Whether the quantity that changes sign at an event has done so; zero counts as the other side."""
    return value >= 0.0 if run.watches[i].armed < 0 else value <= 0.0


@jit_separate
def sign_quantity(run: Run, i: int) -> float:
    """The quantity that changes sign at an event, at the trial's end: its function or, at a touch, minus its slope."""
    if run.watches[i].hit != TOUCHED:
        return run.g1[i]
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    return -run.slopes[i]


@jit_separate
def narrow_bracket(run: Run, i: int, left: float) -> None:
    """Narrow one event's bracket [low, high] of steps to its time tolerance, by the ITP method.

    Event i has not happened at `low` and has at `high`, where the located trial ends; where another event is earlier, a
    later call narrows further.
    """
    t, watch, at_high = run.now[0].t, run.watches[i], sign_quantity(run, i)
    low, high, at_low = left, run.located[0].h, watch.before
    if run.detectors[i].interpolant:
        substep(run, run.piece[0].full)  # the interpolant is that of the whole step's stages
    # nan where the left end is not the start of the piece: see `note_event_in_piece`
    if run.plan[0].apart or not is_plain(run, i) or isnan(at_low):
        at_low = start_of(run, i, low)
    if run.detectors[i].interpolant and low > 0.0 and sign_of(at_low) != watch.armed:
        low = 0.0  # by the interpolant it is earlier than by the shortened step
        at_low = start_of(run, i, low)
    spacing, position = (
        2.0 * EPS * max(abs(t), abs(t + high)),
        inf if watch.hit == TOUCHED else run.detectors[i].position,
    )
    time_tolerance = max(run.detectors[i].tolerance, spacing)
    # where a position is demanded too, the time may have to be resolved to rounding
    tolerance = time_tolerance if position == inf else spacing
    believed = sign_of(at_low) == watch.armed
    if not run.plan[0].apart and believed and is_plain(run, i):
        narrow_by_rates(run, i, low, at_low, time_tolerance, position)
        low, at_low, high, at_high = watch.left, watch.before, run.located[0].h, run.located_g[i]
    # kappa_1 of ITP, over the first width: truncation then does not depend on the unit of time
    slack, scale = bisection_reach(high - low, tolerance), 0.2 / (high - low)
    for _ in range(MOST_SUBSTEPS - 1):
        if high - low <= tolerance or (high - low <= time_tolerance and abs(at_high) <= position):
            break
        if sign_of(at_low) != watch.armed:  # too small to be trusted, unlike the side
            at_low = -at_high if at_high != 0.0 else float(watch.armed)
        # ITP's radius eps*2**(n - j) - (b - a)/2 allows one substep beyond bisection's (Oliveira, Takahashi, 2021)
        s = point_inside(itp(low, high, at_low, at_high, scale, slack - (high - low) / 2.0), low, high, tolerance)
        slack = slack / 2.0
        if not low < s < high:
            break
        evaluate_part(run, i, s)
        # unsolved equations tell nothing: the bracket stays as wide as it is
        if run.trial[0].iterations < 0:
            break
        value = sign_quantity(run, i)
        if has_passed(run, i, value):
            high, at_high = s, value
            store_trial(run)
        else:
            low, at_low, believed = s, value, True
            raise_left_ends(run, i, s)
    watch.left, watch.right, watch.before = low, high, at_low
    if run.detectors[i].interpolant:
        note_drift(run, i)
    if run.detectors[i].role == GAP:
        polish(run, i, at_high if believed else 0.0)


@jit_separate
def is_plain(run: Run, i: int) -> bool:
    """Whether an event function is smooth where it crosses zero, and its rate is known."""
    detector, watch = run.detectors[i], run.watches[i]
    return watch.hit == CROSSED and watch.broken == SMOOTH and not detector.sampled and not detector.interpolant


@jit_separate
def narrow_by_rates(
    run: Run, i: int, left: float, at_left: float, time_tolerance: float, position_tolerance: float
) -> None:
    """Narrow a smooth event's bracket by values and rates, while a few turns bring it, or the value, to an eighth."""
    watch, low, high, at_low, at_high = run.watches[i], left, run.located[0].h, at_left, run.located_g[i]
    slope_high = event_rate(run, i, run.located_z, high)
    lifted = at_low != run.near_g[i]  # by a substep whose state was not kept
    slope_low = (at_high - at_low) / (high - low) if lifted else event_rate(run, i, run.near, low)
    width, turns, t = high - low, 0, run.now[0].t
    spacing = 2.0 * EPS * max(abs(t), abs(t + high))
    beyond, smallest = spacing / 16.0, min(abs(at_low), abs(at_high))
    while (
        not (high - low <= spacing or (high - low <= time_tolerance and abs(at_high) <= position_tolerance))
        and turns < TURNS
    ):
        point = hermite(low, high, at_low, at_high, slope_low, slope_high)
        tolerance = time_tolerance if abs(at_high) <= position_tolerance else spacing
        near = point >= high - max(4.0 * spacing, tolerance / 64.0)  # what is left is the bracket's other end
        s = max((low + high) / 2.0, high - 0.9 * tolerance) if near else point + beyond
        if not low < s < high:
            break
        substep(run, s)
        if run.trial[0].iterations < 0:
            break
        value, slope, turns = run.g1[i], event_rate(run, i, run.z, s), turns + 1
        if has_passed(run, i, value):
            high, at_high, slope_high = s, value, slope
            store_trial(run)
        else:
            low, at_low, slope_low = s, value, slope
            beyond = min(16.0 * beyond, tolerance / 2.0)  # rounding may keep a function on its side past its root
            raise_left_ends(run, i, s)
        nearest = min(abs(at_low), abs(at_high))
        if 8.0 * (high - low) <= width or 8.0 * nearest <= smallest:
            width, smallest, turns = high - low, nearest, 0
    watch.left, watch.before = low, at_low


@jit_separate
def event_rate(run: Run, i: int, state: State, s: float) -> float:
    """The rate of an event function at a state that is part of the trial."""
    set_time(run, T, run.now[0].t + s)
    call_law(run.law[SLOPES], run, state, run.slopes, 0)
    return run.slopes[i]


@jit_separate
def point_inside(s: float, low: float, high: float, tolerance: float) -> float:
    """A point inside a bracket: one that fell on an end of it is moved a tolerance inwards."""
    if s >= high:
        return max((low + high) / 2.0, high - tolerance)
    return min((low + high) / 2.0, low + tolerance) if s <= low else s


@jit_separate
def polish(run: Run, i: int, at_high: float) -> None:
    """Move the right end next to the zero by one more secant: any remaining gap enters every later bounce.

    Where the function was zero from the left end on, with no value to go by, `at_high` is 0.
    """
    watch, t = run.watches[i], run.now[0].t
    low, high, at_low = watch.left, watch.right, watch.before
    root = low if at_high == 0.0 else (at_high * low - at_low * high) / (at_high - at_low)
    # two spacings of t beyond the root, or rounding might leave it on the near side
    s = root + 2.0 * EPS * max(abs(t), abs(t + high))
    if not low < s < high:
        return
    evaluate_part(run, i, s)
    if run.trial[0].iterations >= 0 and has_passed(run, i, sign_quantity(run, i)):
        store_trial(run)
        watch.right = s


@jit_separate
def evaluate_part(run: Run, i: int, s: float) -> None:
    """Compute the state after part of the trial, by a shortened step or, if the event asks for it, the interpolant."""
    now, piece, used = run.now[0], run.piece[0], run.plan[0].used
    if not run.detectors[i].interpolant or s >= piece.full:
        substep(run, s)
        return
    run.at[T], run.at[T1], run.at[H], run.at[S] = now.t, now.t + piece.full, piece.full, s / piece.full
    call_law(run.law[INSIDE], run, run.y, run.full, 0)
    for k in range(used):
        run.z[k], run.e[k] = run.e[k], run.full_e[k]
    evaluate_forces(run, now.t + s, run.z)
    run.trial[0].t, run.trial[0].h, run.trial[0].iterations = now.t + s, s, 0
    run.trial[0].unsound = 0.0 if finite_state(run) else nan
    evaluate_events(run)


@jit_separate
def note_drift(run: Run, i: int) -> None:
    """Store the difference of the event function on the interpolant from that of the shortened step."""
    s, value = run.located[0].h, run.located_g[i]
    substep(run, s)
    run.watches[i].drift = abs(run.g1[i] - value) if run.trial[0].iterations >= 0 else inf


@jit_separate
def start_of(run: Run, i: int, s: float) -> float:
    """The quantity that changes sign at an event, at the left end of its bracket."""
    if s > 0.0:
        evaluate_part(run, i, s)
        return sign_quantity(run, i)
    if run.watches[i].hit != TOUCHED:
        return run.g[i]
    return -event_rate(run, i, run.y, 0.0)


@jit_separate
def event_kind(run: Run, i: int) -> int:
    """Tell a crossing from a touch, a jump, a pole and an unresolved cluster; slopes are those at the end."""
    watch, value_after = run.watches[i], run.g1[i]
    if watch.hit == ENDED and run.places.shape[0] > 0 and watch.armed * run.slopes[i] < 0.0:
        return CROSSING  # on its way through zero, where a table ends; where a law ends, as a root does, it slows down to it
    if watch.hit in (TOUCHED, ENDED):
        return TOUCH
    if run.detectors[i].sampled:
        explained = STEEP * (watch.up * (watch.right - watch.left) + EPS * watch.greatest)
        over_a_look = watch.up * (run.piece[0].full / LOOKS)  # solved equations leave more than rounding does
        return JUMP if abs(value_after - watch.before) > max(explained, FAIR * over_a_look) else CROSSING
    if watch.broken >= BREAKS:
        if watch.broken == UNBOUNDED and min(abs(watch.before), abs(value_after)) > STEEP * watch.greatest:
            return POLE
        width = watch.right - watch.left
        if abs(value_after - watch.before) > STEEP * (abs(run.slopes[i]) * width + EPS * watch.greatest):
            return JUMP
    return CLUSTER if watch.hit == FORCED else CROSSING


@jit_inline
def bisection_reach(width: float, tolerance: float) -> float:
    """(tolerance/2) * 2**(n + 1), with n the halvings that bisection needs: the slack of ITP's first step."""
    slack = tolerance
    # doubling is exact and needs no logarithm
    while slack < width:
        slack = 2.0 * slack
    return slack


@jit_inline
def hermite(low: float, high: float, at_low: float, at_high: float, slope_low: float, slope_high: float) -> float:
    """The zero by the cubic of time over value, through both ends with their rates; else the middle."""
    change = at_high - at_low
    if not (slope_low * change > 0.0 and slope_high * change > 0.0):
        return (low + high) / 2.0
    u = -at_low / change
    v = 1.0 - u
    point = low + u * u * (3.0 - 2.0 * u) * (high - low) + change * u * v * (v / slope_low - u / slope_high)
    return point if low <= point <= high else (low + high) / 2.0


@jit_inline
def itp(low: float, high: float, at_low: float, at_high: float, scale: float, slack: float) -> float:
    """Interpolate, truncate towards the middle, project: one step of ITP with kappa_2 = 2, n_0 = 1."""
    middle = (low + high) / 2.0
    secant = (at_high * low - at_low * high) / (at_high - at_low)
    if not low <= secant <= high:  # of infinite values
        secant = middle
    side = 1.0 if middle >= secant else -1.0
    shift = scale * (high - low) * (high - low)
    point = secant + side * shift if shift <= abs(middle - secant) else middle
    return point if abs(point - middle) <= slack else middle - side * slack
