"""Steps of Taylor series: the series at a state is computed once, for every step that begins there, and for its size."""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.formulas import larger
from xdynamics.kernels.law import EXP, EXPAND, LOG, PROPOSE
from xdynamics.kernels.program import T
from xdynamics.march.calls import applied, called
from xdynamics.march.control import allowed_of, shortest
from xdynamics.march.run import STAYED, Run
from xdynamics.march.tolerance_sizes import tops_of

State = NDArray[Any]


@compiled
def series_step(run: Run, y: State, z: State, sample: int) -> None:
    """Sum the series at the end of the step; compute it before, unless it is known from the state that the march is at."""
    plan, kept = run.plan[0], run.kept[0]
    if kept.since != STAYED or plan.steps > 1:
        called(run.law[EXPAND], run, y, z, sample)
        kept.since = STAYED
    called(run.law[PROPOSE], run, y, z, sample)
    run.now[0].evaluations += plan.stages


@shared
def foresee(run: Run) -> None:
    """Choose the step by the last two coefficients of the series.

    Each gives a radius of convergence, in which its term would be as large as the state; in the step that of the smaller
    one has fallen to what is allowed.
    """
    now, plan, kept = run.now[0], run.plan[0], run.kept[0]
    if kept.since == STAYED:  # after a rejected trial, which chose
        return
    run.at[T] = now.t
    called(run.law[EXPAND], run, run.y, run.z, 0)
    kept.since = STAYED
    if now.rows == 1 and plan.first_step > 0.0:
        return
    if plan.follows:
        tops_of(run, run.y)
    size, time = norm_of(run, 0), time_of(run)
    size = max(1.0, size)  # a state that is smaller than its tolerance
    radius = math.inf
    for order in range(plan.series - 1, plan.series + 1):
        norm = norm_of(run, order) / size
        for _ in range(order):  # without a unit, so that steps are the same in all units
            norm = norm * time
        if norm > 0.0:
            radius = min(radius, time * applied(run.law[EXP], -applied(run.law[LOG], norm) / order))
    tolerated = applied(run.law[EXP], -applied(run.law[LOG], size) / plan.series)
    step = radius * tolerated
    # a motion that is a polynomial of lower degree is one step to the end
    now.step = min(max(plan.safety * step, shortest(run)), plan.max_step, plan.end - now.t)
    if now.rows == 1:
        now.first_step = now.step


@compiled
def norm_of(run: Run, order: int) -> float:
    """Return the largest ratio of the coefficients of an order to what is allowed as errors."""
    plan, norm = run.plan[0], 0.0
    for i in range(plan.used):
        term = abs(run.w[order * plan.used + i])
        if term > 0.0:
            norm = larger(norm, term / allowed_of(run, run.y, i))
    return norm


@compiled
def time_of(run: Run) -> float:
    """Return a time scale of the motion: its size over its slope."""
    plan = run.plan[0]
    size, slope = norm_of(run, 0), norm_of(run, 1)
    return size / slope if size > 0.0 and slope > 0.0 else plan.end - run.now[0].t
