"""Finding the first event of a step: sign changes, brackets, substeps of the method itself."""

from __future__ import annotations

from math import nan
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import apart, compiled, shared
from xdynamics.march.log import MOST_SUBSTEPS, note_trial
from xdynamics.march.proposing import propose
from xdynamics.march.run import Run
from xdynamics.schema import REASON_EVENT

ROOT_METHOD = "ITP bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597) on re-integrated substeps; the right end is accepted"
EPS = 2.220446049250313e-16
RISING, FALLING = 1, -1

propose_apart = apart(propose)


@compiled
def crosses(direction: int, before: float, after: float) -> bool:
    """Whether an event function changed its sign in the direction watched; one that starts at zero did not."""
    if direction == RISING:
        return before < 0.0 <= after
    if direction == FALLING:
        return before > 0.0 >= after
    return before < 0.0 <= after or before > 0.0 >= after


@compiled
def crosses_any(run: Run) -> bool:
    """Whether any event function crossed in the trial."""
    crossed = False
    for i in range(run.detectors.shape[0]):
        crossed = crossed or crosses(run.detectors[i].direction, run.g[i], run.g1[i])
    return crossed


@shared
def locate(run: Run) -> None:
    """Shrink the trial until it ends just behind its first event; every substep on the way is a rejected trial."""
    keep(run)
    for i in range(run.detectors.shape[0]):
        run.lows[i] = 0.0
        if crosses(run.detectors[i].direction, run.g[i], run.located_g[i]):
            bracket(run, i)
    take(run)


@shared
def bracket(run: Run, i: int) -> None:
    """Narrow one event's bracket [low, high] of steps to its time tolerance, by the ITP method.

    Event i has not crossed after `low` and has after `high`, where the located trial ends; where another event crosses
    earlier, a later call narrows further.
    """
    t, direction = run.now[0].t, run.detectors[i].direction
    low, high, at_low = 0.0, run.located[0].h, run.g[i]
    tolerance = max(run.detectors[i].tolerance, 2.0 * EPS * max(abs(t), abs(t + high)))
    slack, scale = reach(high, tolerance), 0.2 / high
    for _ in range(MOST_SUBSTEPS - 1):
        if high - low <= tolerance:
            break
        s = itp(low, high, at_low, run.located_g[i], scale, slack - (high - low) / 2.0)
        slack = slack / 2.0
        if s >= high:  # the point fell on an end of the bracket: probe a tolerance inside it
            s = max((low + high) / 2.0, high - tolerance)
        elif s <= low:
            s = min((low + high) / 2.0, low + tolerance)
        if not low < s < high:
            break
        note_trial(run, s, nan, REASON_EVENT)
        propose_apart(run, t + s, s)
        if (
            run.trial[0].iterations < 0
        ):  # equations that were not solved tell nothing: the bracket stays as wide as it is
            break
        if crosses(direction, run.g[i], run.g1[i]):
            high = s
            keep(run)
        else:
            low, at_low = s, run.g1[i]
    run.lows[i] = low


@compiled
def keep(run: Run) -> None:
    """Take the trial for the one that ends at the event."""
    copy_trial(run.trial, run.located)
    copy(run.z, run.located_z)
    copy(run.e, run.located_e)
    copy(run.g1, run.located_g)
    copy(run.samples, run.located_samples)


@compiled
def take(run: Run) -> None:
    """Go back to the trial that ends at the event: it is not made a second time."""
    copy_trial(run.located, run.trial)
    copy(run.located_z, run.z)
    copy(run.located_e, run.e)
    copy(run.located_g, run.g1)
    copy(run.located_samples, run.samples)


@shared
def copy_trial(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy a trial's numbers."""
    one, other = source[0], target[0]
    other.t, other.h, other.landing, other.iterations = one.t, one.h, one.landing, one.iterations
    other.unsound, other.unsound_events = one.unsound, one.unsound_events


@shared
def copy(source: NDArray[Any], target: NDArray[Any]) -> None:
    """Copy numbers, in a loop: a slice assignment takes numba seconds to compile."""
    for i in range(source.shape[0]):
        target[i] = source[i]


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
    side = 1.0 if middle >= secant else -1.0
    shift = scale * (high - low) * (high - low)
    point = secant + side * shift if shift <= abs(middle - secant) else middle
    return point if abs(point - middle) <= slack else middle - side * slack
