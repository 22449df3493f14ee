"""Errors that given absolute tolerances, or given steps, do not control, and the variables in which they matter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels import Layout
from xdynamics.march.engine import engine
from xdynamics.march.perturbation import EVALUATIONS, STATES
from xdynamics.march.runner import March
from xdynamics.march.timescales import put_aside
from xdynamics.march.tolerances import Tolerances
from xdynamics.methods.steppers import SIMPLIFIED

Floats = NDArray[np.float64]

LOSS = 0.03  # of a variable: allowed sum of errors of its absolute tolerance in every step
NOISE = 1e3 * EPS  # of the largest of its kind: smaller values are due to rounding
COMPARABLE = 10.0  # ratio of a value's absolute to relative tolerance up to which both count as intended
SHARE = 16  # evaluations of a march for each one that follows an error
FEWEST, SMALL = 240, 48  # evaluations that cost little beside the record, for states up to that size
UNRESOLVED = 100.0  # time scales in one step: no explicit method is stable there, nor follows a growth
FEWEST_ROWS, AT_ONCE = 8, 0.5  # rows of a run, and the part of its motion that such a step makes alone
MOST_FOLLOWED = 1000  # steps; over the rest of a long run growth is extrapolated


class Effect(NamedTuple):
    """The effect of errors of given absolute tolerances.

    Attributes
    ----------
    words : str
        For the record, with the reason if it was not examined; empty where no tolerance is given.
    loose : ndarray of bool
        Variables whose tolerances allow too large errors.
    """

    words: str
    loose: NDArray[np.bool_]


def uncontrolled(
    tolerances: Tolerances, layout: Layout, largest: Floats, accepted: int | NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return the variables whose given absolute tolerances allow errors that add up to a part of their size.

    Judged from sizes alone, as if errors neither grew nor decayed. A variable that is very small beside others of its
    kind is rounding, of which nothing is lost.

    Parameters
    ----------
    tolerances : Tolerances
    layout : Layout
        Names the variables and their kinds.
    largest : ndarray, shape (…, n), SI
        The largest absolute value of each.
    accepted : int or ndarray, shape (…)
        Steps of each run.
    """
    steps, atols, tops = np.asarray(accepted)[..., None], _given_atols(tolerances, layout), _kind_tops(layout, largest)
    significant = (largest > 0.0) & (largest >= NOISE * tops)
    return significant & (atols > COMPARABLE * tolerances.rtol * largest) & (steps * atols > LOSS * largest)


def error_effect(march: March) -> Effect:
    """Follow errors of given absolute tolerances along a finished run, from its start and its middle."""
    tolerances, layout, scales = march.settings.tolerances, march.layout, march.settings.scales
    none_loose = np.zeros(layout.used.size, bool)
    if not march.settings.adaptive or tolerances is None or not march.witnesses.steps.shape[1]:
        return Effect("", none_loose)
    factors = layout.sizes(scales)
    atols = _given_atols(tolerances, layout) / factors
    if not atols.any():
        return Effect("", none_loose)
    if march.model.delays:
        return Effect("not looked at: forces read delayed values", none_loose)
    end, steps = float(march.now.t), _followed_step_count(march)  # before the march's state is changed below
    with put_aside(march), np.errstate(all="ignore"):
        sizes = _error_scales(march, atols)
        loose = (atols > COMPARABLE * tolerances.rtol * sizes) & (sizes > 0.0)
        if not loose.any():
            return Effect(
                f"not looked at: no atol is above {COMPARABLE:g} rtol times the size of its variable", none_loose
            )
        moves = np.where(loose, np.fmin(atols, _largest_estimates(march)), 0.0)
        share = march.accepted * np.where(loose, moves / np.where(sizes > 0.0, sizes, 1.0), 0.0)
        reason = _obstacle(march, steps) or ("steps had none" if not moves.any() else "")
        followed = None if reason else _follow_growth(march, end, steps, moves, sizes)
    if followed is None:
        reason = reason or "the forces give no finite slopes beside the run"
        words = (
            f"not looked at: {reason}; errors of atol, or as large as estimated, in each of {march.accepted} steps are"
            f" {share.max():.2g} of a variable if they neither grow nor decay"
        )
        return Effect(words, share > LOSS)
    growth, covered, rows = followed
    words = (
        f"{share.max() * growth:.2g} of a variable, by errors of atol, or as large as estimated, in each of"
        f" {march.accepted} steps that come to {growth:.3g} times their size over the run; followed from {rows} of its"
        f" rows over {covered:.0%} of it"
    )
    return Effect(words, share * growth > LOSS)


def passed_over(march: March) -> float:
    """Return how many times the fastest time scale at the start a given first step is; 0 if few, or if stiff decay is damped.

    Such a step is finite where what it starts from is over at once: of ``P/v`` at 1 um/s the first stage alone counts,
    and the speed it leads to has nothing to do with the force.
    """
    settings, plan = march.settings, march.run.plan[0]
    if settings.adaptive or settings.method.solver == SIMPLIFIED or not march.witnesses.steps.shape[1]:
        return 0.0
    first, rates = float(plan.step_size or (march.run.steps[0] if len(march.run.steps) else 0.0)), np.zeros((1, 1))
    with put_aside(march), np.errstate(all="ignore"):
        engine().fastest_rates(march.run, march.witnesses.states([0]), rates)
    product, rows = float(rates[0, 0]) * first, march.witnesses.rows[3:]
    if not UNRESOLVED < product < np.inf or rows.shape[1] < FEWEST_ROWS:
        return 0.0
    first_change, largest = np.abs(rows[:, 1] - rows[:, 0]), np.abs(rows - rows[:, :1]).max(axis=1)
    return product if ((first_change > AT_ONCE * largest) & (largest > 0.0)).any() else 0.0  # else a jump at rest, say


def _given_atols(tolerances: Tolerances, layout: Layout) -> Floats:
    """Return the given absolute tolerances, SI; 0 for those that follow sizes, whose errors are in proportion."""
    atols = tolerances.of_all(layout.used)
    return np.where(np.isnan(atols), 0.0, atols)


def _largest_estimates(march: March) -> Floats:
    """Return the largest estimated error of each variable in any kept step; nan where none is known.

    Steps are as short as the strictest tolerance requires: other errors are far below what theirs would allow.
    """
    errors = np.abs(march.witnesses.errors)
    if not errors.shape[1] or np.isnan(errors).any():  # kept by a version that did not have them
        return np.full(march.layout.used.size, np.nan)
    largest: Floats = errors.max(axis=1)
    return largest


def _kind_tops(layout: Layout, largest: Floats) -> Floats:
    """Return the largest value of each variable's kind."""
    kinds, tops = layout.kinds, np.zeros_like(largest)
    for kind in np.unique(kinds).tolist():
        tops[..., kinds == kind] = largest[..., kinds == kind].max(axis=-1, keepdims=True)
    return tops


def _error_scales(march: March, atols: Floats) -> Floats:
    """Return the scale of each variable's errors: its largest value, or if that is rounding a natural one.

    Natural is the largest of its kind, for a velocity also that of its coordinates in the fastest time scale. What begins
    as rounding, and grows no more than errors of its tolerance may have made it, counts as rounding throughout.
    """
    run, used, n, rates = march.run, march.layout.used.size, march.layout.coordinates.size, np.zeros((1, 1))
    engine().fastest_rates(run, march.witnesses.states([0]), rates)
    rate = float(rates[0, 0]) if 0.0 < rates[0, 0] < np.inf else 0.0
    largest, born = run.largest.copy(), np.abs(run.y[:used])
    natural = _kind_tops(march.layout, largest)
    natural[n : 2 * n] = np.maximum(natural[n : 2 * n], rate * natural[:n])
    if rate > 0.0:  # the slopes of velocities follow the state
        born[n : 2 * n] = np.maximum(born[n : 2 * n], np.abs(run.y[used : used + n]) / rate)
        born[:n] = np.maximum(born[:n], born[n : 2 * n] / rate)
    rounding = (born < NOISE * natural) & (largest <= march.accepted * atols) & (np.arange(used) < 2 * n)
    return np.where((largest < NOISE * natural) | rounding, natural, largest)


def _obstacle(march: March, steps: int) -> str:
    """Return why errors cannot be followed along a run; empty where they can be."""
    layout, plan = march.layout, march.run.plan[0]
    reasons = {
        "forces change with regimes": len(march.model.regimes) > 1,
        "contacts or friction act": bool(layout.reactions),
        "events set the state": bool(layout.resets),
        "switches in forces are located": int(plan.switches) > 0,
        f"the run has {int(march.now.evaluations)} evaluations alone": steps < 1,
    }
    return ", ".join(reason for reason, applies in reasons.items() if applies)


def _followed_step_count(march: March) -> int:
    """Return the number of steps for which an error is followed from each row."""
    floor = FEWEST if march.layout.used.size <= SMALL else 0
    return min(MOST_FOLLOWED, max(floor, int(march.now.evaluations) // SHARE) // (2 * EVALUATIONS))


def _follow_growth(
    march: March, end: float, steps: int, moves: Floats, sizes: Floats
) -> tuple[float, float, int] | None:
    """Return the mean growth of an error over the run, the part of the run covered, and from how many rows."""
    last = march.witnesses.steps.shape[1] - 1
    start_rows = [0, last // 2] if last > 1 else [0]
    states = march.witnesses.states(start_rows)
    perturbations = np.zeros((1 + len(moves), 2))
    perturbations[0, 0], perturbations[1:, 0], perturbations[1:, 1] = end, moves, np.where(sizes > 0.0, sizes, np.inf)
    results = np.full((2 * len(start_rows), 1 + steps), np.nan)
    engine().growths(march.run, states, perturbations, np.empty((STATES, len(moves))), results)
    span, growths, covered = end - float(states[0, 0]), [], 0.0
    for k in range(len(start_rows)):
        count = int(np.count_nonzero(~np.isnan(results[2 * k])))
        if count > 1:
            times, distances = results[2 * k : 2 * k + 2, :count].tolist()
            growths.append(mean_growth(times, distances, span))
            covered += times[-1] - times[0]
    return (max(growths), min(1.0, covered / span), len(growths)) if growths and span > 0.0 else None


def mean_growth(times: list[float], distances: list[float], span: float) -> float:
    """Return the mean over a span of a ratio followed for a part of it; beyond that, growth continues and decay ends.

    Examples
    --------
    >>> mean_growth([0.0, 1.0, 2.0], [1.0, 2.0, 3.0], 10.0), mean_growth([0.0, 1.0, 2.0], [1.0, 1.0, 1.0], 10.0)
    (6.0, 1.0)
    """
    middle, halves = (times[0] + times[-1]) / 2.0, [[0.0, 0.0], [0.0, 0.0]]
    for t, t1, a, b in zip(times[:-1], times[1:], distances[:-1], distances[1:], strict=True):
        half = halves[t + t1 > 2.0 * middle]
        half[0], half[1] = half[0] + (t1 - t) * (a + b) / 2.0, half[1] + t1 - t
    followed, remaining = times[-1] - times[0], span - (times[-1] - times[0])
    mean = (halves[0][0] + halves[1][0]) / followed
    if remaining <= 0.0:
        return mean
    early, late = (part / length if length > 0.0 else mean for part, length in halves)
    slope = max(0.0, late - early) / (followed / 2.0)
    beyond = late + slope * (followed / 4.0 + remaining / 2.0)
    return (mean * followed + beyond * remaining) / span
