"""Steps of Taylor series: the series at a state serves every step that begins there, and gives the step size."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.numbers import FRACTION, ONE
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.formulas import (
    CONSTANTS,
    FORESEEN,
    LOG2,
    TERM,
    TIME_OF,
    TINY,
    WEIGHT,
    WITHOUT_UNIT,
    compiled_function_of,
    larger,
)
from xdynamics.kernels.law import EXPAND, PROPOSE
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.control import allowed_of, shortest_step, term_rounding
from xdynamics.march.force_evaluation import find_term_sizes, state_slope
from xdynamics.march.run import STAYED, Run
from xdynamics.march.tolerance_sizes import tops_of

State = NDArray[Any]
LONGER = 4  # times that a step is foreseen again

_weight = compiled_function_of(WEIGHT, "allowed rtol value", "weight")
_ratio = compiled_function_of(TERM.format("any"), "term_any weight", "norm_any")
_time_of = compiled_function_of(TIME_OF, "norm_size norm_slope remaining", "time")
_without_unit = compiled_function_of(
    WITHOUT_UNIT, "norm_size norm_before norm_last half rest_before rest_last", "top first second before last"
)
_log2 = compiled_function_of(LOG2, "part whole", "log2")
_foreseen = compiled_function_of(
    FORESEEN, "first second log2_top log2_before log2_last per_before per_last safety time", "factor whole", CONSTANTS
)


@jit_inline
def series_step(run: Run, y: State, z: State, sample: int) -> None:
    """Sum the series at the end of the step; compute it before, unless it is known from the state that the march is at."""
    plan, step_memory = run.plan[0], run.kept[0]
    if step_memory.since != STAYED or plan.steps > 1:
        call_law(run.law[EXPAND], run, y, z, sample)
        step_memory.since = STAYED
    call_law(run.law[PROPOSE], run, y, z, sample)
    run.now[0].evaluations += plan.stages


@jit_separate
def choose_series_step(run: Run) -> None:
    """Choose the step by the last two coefficients of the series.

    Each gives a radius of convergence, in which its term would be as large as the state; in the step that of the smaller
    one has fallen to what is allowed.
    """
    now, plan, step_memory = run.now[0], run.plan[0], run.kept[0]
    if step_memory.since == STAYED:  # after a rejected trial, which chose
        return
    # what the state and its slopes suffice for comes first, so that it is done while the series is
    if plan.follows:
        tops_of(run, run.y)
    size, slope = norms_at_start(run, 0.0)
    time = _time_of(size, slope, plan.end - now.t)
    lower = whole_power(time, (plan.series - 1) // 2)
    run.at[T] = now.t
    call_law(run.law[EXPAND], run, run.y, run.z, 0)
    step_memory.since = STAYED
    if now.rows == 1 and plan.first_step > 0.0:
        return
    now.step = foreseen_step(run, size, time, lower)
    if plan.rounding > 0.0 and may_be_rounding(run):
        lengthen(run)
    if now.rows == 1:
        now.first_step = now.step


@jit_inline
def foreseen_step(run: Run, size: float, time: float, lower: float) -> float:
    """Return the step by the last two coefficients, from the size of the state, a time, and a power of it."""
    plan, order, remaining = run.plan[0], run.plan[0].series, run.plan[0].end - run.now[0].t
    higher = lower * time
    half, rest_last = (lower, higher) if order % 2 == 1 else (higher, higher)
    norm_before, norm_last = norms_of(run, order)
    top, first, second, norm_before, norm_last = _without_unit(size, norm_before, norm_last, half, lower, rest_last)
    logarithms = coarse_log2(top), coarse_log2(norm_before), coarse_log2(norm_last)
    factor, doublings = _foreseen(
        first, second, logarithms[0], logarithms[1], logarithms[2], 1.0 / (order - 1), 1.0 / order, plan.safety, time
    )
    # 2**doublings, put together from its exponent's bits: exact, without the C library
    step = factor * np.int64((np.int64(doublings) + 1023) << 52).view(np.float64)
    return float(min(max(step, shortest_step(run)), plan.max_step, remaining))


@jit_inline
def may_be_rounding(run: Run) -> bool:
    """Whether a step may be as short as it is by the rounding of terms: so it was before, or it is much shorter than that."""
    now, plan = run.now[0], run.plan[0]
    if run.kept[0].weighs > 1:
        return True
    return bool(now.step < (plan.least * now.h if now.h > 0.0 else TINY * plan.rest))


@jit_separate
def lengthen(run: Run) -> None:
    """Choose the step again with the rounding of terms over its length, which the tolerances also allow."""
    now, plan = run.now[0], run.plan[0]
    for _ in range(LONGER):
        find_term_sizes(run, now.t + now.step, run.y)
        size, slope = norms_at_start(run, now.step)
        time = _time_of(size, slope, plan.end - now.t)
        step = foreseen_step(run, size, time, whole_power(time, (plan.series - 1) // 2))
        if not step > now.step:
            break
        now.step = step


@jit_inline
def whole_power(base: float, exponent: int) -> float:
    """Return an integer power by squaring from the highest bit on: as `Assignments.power` writes it."""
    if exponent == 0:
        return 1.0
    bit = 1
    while 2 * bit <= exponent:
        bit *= 2
    product = base
    while bit > 1:
        bit //= 2
        product = product * product
        if exponent & bit:
            product = product * base
    return product


@jit_inline
def coarse_log2(x: float) -> float:
    """Return the logarithm of a positive normal number to base 2, to 0.001."""
    word = np.float64(x).view(np.int64)
    part = np.int64((word & FRACTION) | ONE).view(np.float64)
    return _log2(part, (word >> 52) - 1023)


@jit_inline
def norms_at_start(run: Run, width: float) -> tuple[float, float]:
    """Return the largest ratios of the state and its slopes to allowed errors; store the weights.

    With a width, what rounding of terms makes of a step of that length is allowed, too.
    """
    plan, size, slope = run.plan[0], 0.0, 0.0
    for i in range(plan.used):
        weight = _weight(allowed_of(run, run.y, i), plan.rtol, run.y[i])
        if width > 0.0 and run.adaptive_atol[i]:
            rounding_floor = term_rounding(run, i, width)
            weight = min(weight, 1.0 / rounding_floor) if rounding_floor > 0.0 else weight
        size = larger(size, _ratio(run.y[i], weight))
        slope = larger(slope, _ratio(state_slope(run, run.y, i), weight))
        run.half[i] = weight
    return size, slope


@jit_inline
def norms_of(run: Run, order: int) -> tuple[float, float]:
    """Return the largest ratios of the last two coefficients to allowed errors."""
    plan, (norm_before, norm_last) = run.plan[0], (0.0, 0.0)
    for i in range(plan.used):
        norm_before = larger(norm_before, _ratio(run.w[(order - 1) * plan.used + i], run.half[i]))
        norm_last = larger(norm_last, _ratio(run.w[order * plan.used + i], run.half[i]))
    return norm_before, norm_last
