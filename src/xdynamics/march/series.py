"""Steps of Taylor series: the series at a state is computed once, for every step that begins there, and for its size."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.formulas import function_of, larger
from xdynamics.kernels.law import EXP, EXPAND, LOG, PROPOSE
from xdynamics.kernels.program import T
from xdynamics.kernels.step_control import CONSTANTS, FORESEEN, TERM
from xdynamics.march.calls import applied, called
from xdynamics.march.control import allowed_of, shortest
from xdynamics.march.run import STAYED, Run
from xdynamics.march.tolerance_sizes import tops_of

State = NDArray[Any]

_ratio = function_of(TERM, "term allowed", "ratio")
_foreseen = function_of(FORESEEN, "norm_before norm_last log_size log_before log_last order", "exponent", CONSTANTS)


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
    size = larger(1.0, norm_of(run, 0))  # a state may be smaller than its tolerance
    before, last = norm_of(run, plan.series - 1), norm_of(run, plan.series)
    # of zero the logarithm is not looked at
    logarithms = applied(run.law[LOG], size), applied(run.law[LOG], before), applied(run.law[LOG], last)
    exponent = _foreseen(before, last, logarithms[0], logarithms[1], logarithms[2], plan.series)
    step = plan.safety * applied(run.law[EXP], exponent)
    now.step = min(max(step, shortest(run)), plan.max_step, plan.end - now.t)
    if now.rows == 1:
        now.first_step = now.step


@compiled
def norm_of(run: Run, order: int) -> float:
    """Return the largest ratio of the coefficients of an order to what is allowed as errors."""
    plan, norm = run.plan[0], 0.0
    for i in range(plan.used):
        norm = larger(norm, _ratio(run.w[order * plan.used + i], allowed_of(run, run.y, i)))
    return norm
