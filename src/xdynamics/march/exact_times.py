"""Times to 31 digits, where numbers are sums of two floats: a float as ever, and what is left of the time beside it.

The grid, nodes and ends lie at the floats at which they lie without rests, so that the rows of both runs belong together;
a rest may therefore be larger than half a spacing.
"""

from __future__ import annotations

from xdynamics.elementary import numbers
from xdynamics.kernels.compiling import jit_inline
from xdynamics.kernels.program import AT, T1, H, T
from xdynamics.march.run import Run

RESTS = len(AT)  # how many places after a number that laws read of a step its rest stands
exact_sum = jit_inline(numbers.exact_sum)
SPLITTER = 134217729.0  # 2**27 + 1: it parts a float into halves of 26 bits


@jit_inline
def time_rest(run: Run, t: float) -> float:
    """Return what is left of a time: of the state's or of the trial's; any other is a float."""
    now, trial = run.now[0], run.trial[0]
    if t == now.t:
        return float(now.rest)
    return float(trial.rest) if t == trial.t else 0.0


@jit_inline
def set_time(run: Run, time_index: int, t: float) -> None:
    """Set a time that laws read."""
    run.at[time_index] = t
    if run.plan[0].doubled > 0:
        run.at[RESTS + time_index] = time_rest(run, t)


@jit_inline
def set_step(run: Run, t: float, t1: float, h: float) -> None:
    """Set the times between which laws make a step, and its size."""
    run.at[T], run.at[T1], run.at[H] = t, t1, h
    if run.plan[0].doubled > 0:
        run.at[RESTS + T], run.at[RESTS + T1] = time_rest(run, t), time_rest(run, t1)


@jit_inline
def grid_rest(start: float, start_rest: float, step: float, step_rest: float, number: int) -> float:
    """Return what start + number*step is more than its float, by exact products and sums (Dekker 1971, Knuth)."""
    count = float(number)
    product = count * step
    scaled_count, scaled_step = SPLITTER * count, SPLITTER * step
    count_high, step_high = scaled_count - (scaled_count - count), scaled_step - (scaled_step - step)
    count_low, step_low = count - count_high, step - step_high
    lost = ((count_high * step_high - product) + count_high * step_low + count_low * step_high) + count_low * step_low
    _, rounded = exact_sum(start, product)
    return float(rounded + (lost + (count * step_rest + start_rest)))
