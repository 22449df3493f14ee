"""Finding the first event of a step: sign changes, brackets, substeps of the method itself."""

from __future__ import annotations

from math import nan

from xdynamics.march.interface import State, detect, propose
from xdynamics.march.log import MOST_SUBSTEPS, Log, Memory, Plan, Tally, note_trial
from xdynamics.schema import REASON_EVENT

ROOT_METHOD = "ITP bracketing (Oliveira, Takahashi 2021, doi:10.1145/3423597) on re-integrated substeps; the right end is accepted"
EPS = 2.220446049250313e-16
RISING, FALLING = 1, -1


def crosses(direction: int, before: float, after: float) -> bool:
    """Whether an event function changed its sign in the direction watched; one that starts at zero did not."""
    if direction == RISING:
        return before < 0.0 <= after
    if direction == FALLING:
        return before > 0.0 >= after
    return before < 0.0 <= after or before > 0.0 >= after


def crosses_any(directions: tuple[int, ...], before: State, after: State) -> bool:
    """Whether any event function crossed."""
    crossed = False
    for i in range(len(before)):
        crossed = crossed or crosses(directions[i], before[i], after[i])
    return crossed


def locate(
    plan: Plan, memory: Memory, log: Log, base: Tally, h: float, trial: State, values: State,
) -> tuple[float, int, int]:  # fmt: skip
    """Shrink the step until it ends just behind its first event.

    Returns
    -------
    s : float
        The step from the unchanged state to the event.
    trials : int
        Rejected trials of the run so far; each substep is one.
    evaluations : int
        Force evaluations of the substeps.
    """
    trials, evaluations = memory.tally.trials + 1, 0
    for i in range(len(values)):
        log.lows[i] = 0.0
        if crosses(plan.directions[i], memory.values[i], values[i]):
            h, trial, values, trials, more = _bracket(i, plan, memory, log, base, h, trial, values, trials)
            evaluations += more
    return h, trials, evaluations


def _bracket(
    i: int, plan: Plan, memory: Memory, log: Log, base: Tally, high: float, trial: State, values: State, trials: int,
) -> tuple[float, State, State, int, int]:  # fmt: skip
    """Narrow one event's bracket [low, high] of steps to its time tolerance, by the ITP method.

    Event i has not crossed after `low` and has after `high`; where another event crosses earlier, a later call
    narrows further.
    """
    low, at_low, evaluations = 0.0, memory.values[i], 0
    tolerance = max(plan.tolerances[i], 2.0 * EPS * max(abs(memory.t), abs(memory.t + high)))
    slack = _reach(high, tolerance)
    scale = 0.2 / high
    for _ in range(MOST_SUBSTEPS - 1):
        if high - low <= tolerance:
            break
        s = _itp(low, high, at_low, values[i], scale, slack - (high - low) / 2.0)
        slack = slack / 2.0
        if s >= high:  # the point fell on an end of the bracket: probe a tolerance inside it
            s = max((low + high) / 2.0, high - tolerance)
        elif s <= low:
            s = min((low + high) / 2.0, low + tolerance)
        if not low < s < high:
            break
        note_trial(log, trials - base.trials, memory, s, nan, REASON_EVENT)
        trials += 1
        at = memory.tally.samples - base.samples
        tried, _error, _at, effort = propose(memory.t, memory.t + s, s, memory.state, plan.parameters, plan.tables,
                                              memory.pieces, log, at, memory.tally.rows)  # fmt: skip
        evaluations += effort[0]
        if effort[1] < 0:  # equations that were not solved tell nothing: the bracket stays as wide as it is
            break
        found = detect(memory.t + s, tried, plan.parameters, plan.tables, memory.pieces)
        if crosses(plan.directions[i], memory.values[i], found[i]):
            high, trial, values = s, tried, found
        else:
            low, at_low = s, found[i]
    log.lows[i] = low
    return high, trial, values, trials, evaluations


def _reach(width: float, tolerance: float) -> float:
    """(tolerance/2) * 2**(n + 1), with n the halvings that bisection needs: the slack of ITP's first step."""
    slack = tolerance
    while slack < width:
        slack = 2.0 * slack
    return slack


def _itp(low: float, high: float, at_low: float, at_high: float, scale: float, slack: float) -> float:
    """Interpolate, truncate towards the middle, project: one step of ITP with kappa_2 = 2, n_0 = 1."""
    middle = (low + high) / 2.0
    secant = (at_high * low - at_low * high) / (at_high - at_low)
    side = 1.0 if middle >= secant else -1.0
    shift = scale * (high - low) * (high - low)
    point = secant + side * shift if shift <= abs(middle - secant) else middle
    return point if abs(point - middle) <= slack else middle - side * slack
