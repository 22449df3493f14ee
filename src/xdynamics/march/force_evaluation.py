"""Force evaluations at a state: their storage, times to 31 digits, unit quaternions, and reset values.

Where numbers are sums of two floats, a time is a float and the rest of the time beside it. The grid, nodes and ends lie
at the floats at which they lie without rests, so that the rows of both runs belong together; a rest may therefore be
larger than half a spacing.

Attitudes are quaternions of unit length, to which they are brought back after every step. A step by a method of order p
followed by that projection is one of order p (Hairer, Lubich, Wanner, Geometric Numerical Integration, 2nd ed., IV.4).
"""

from __future__ import annotations

from math import nan, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import numbers
from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import FORCES
from xdynamics.kernels.program import AT, T1, UNSOUND, H, T
from xdynamics.march.calls import call_law
from xdynamics.march.run import Run

RESTS = len(AT)  # how many places after a number that laws read of a step its rest stands
exact_sum = jit_inline(numbers.exact_sum)
SPLITTER = 134217729.0  # 2**27 + 1: it parts a float into halves of 26 bits


@jit_inline
def time_rest(run: Run, t: float) -> float:
    """Return the rest of a time: of the state's or of the trial's; any other time is a float."""
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
    """Return the rest of start + number*step beside its float, by exact products and sums (Dekker 1971, Knuth)."""
    count = float(number)
    product = count * step
    scaled_count, scaled_step = SPLITTER * count, SPLITTER * step
    count_high, step_high = scaled_count - (scaled_count - count), scaled_step - (scaled_step - step)
    count_low, step_low = count - count_high, step - step_high
    lost = ((count_high * step_high - product) + count_high * step_low + count_low * step_high) + count_low * step_low
    _, rounded = exact_sum(start, product)
    return float(rounded + (lost + (count * step_rest + start_rest)))


State = NDArray[Any]


@jit_separate
def evaluate_forces(run: Run, t: float, state: State) -> None:
    """Evaluate the forces at a state; they are stored after it in the same array."""
    set_time(run, T, t)
    call_law(run.law[FORCES], run, state, state, 0)
    run.now[0].evaluations += 1


@jit_separate
def evaluate_held(run: Run, t: float, state: State, h: float) -> None:
    """Evaluate the forces at a state after its projection onto constraints, if any; h is the step before, or 0."""
    if run.plan[0].held > 0:
        settle_constraints(run, t, state, h)
    else:
        evaluate_forces(run, t, state)


@jit_separate
def settle_constraints(run: Run, t: float, state: State, h: float) -> None:
    """Project a state onto constraints, and evaluate the forces there; h is the step before, or 0."""
    set_time(run, T, t)
    run.at[H] = h
    call_law(run.law[run.plan[0].held], run, state, state, 0)
    run.now[0].evaluations += 1


@jit_separate
def find_term_sizes(run: Run, t: float, state: State) -> None:
    """Compute the term sizes of accelerations and rates at a state, stored in `probe` in place of these."""
    time = run.at[T]
    run.at[T] = t
    call_law(run.law[run.law.shape[0] - 2], run, state, run.probe, 0)
    run.at[T] = time


@jit_separate
def finite_state(run: Run) -> bool:
    """Whether every number of the trial's state is finite."""
    finite = True
    for i in range(run.plan[0].state):
        finite = finite and np.isfinite(run.z[i])
    return finite


@jit_inline
def nan_maximum(largest: float, value: float) -> float:
    """Return the larger of two numbers; nan where either is, as `maximum` of IEEE 754-2019."""
    # every comparison with nan is false: without the first one a number after nan would take its place
    return largest if np.isnan(largest) or value <= largest else value


@jit_inline
def state_slope(run: Run, state: State, i: int) -> float:
    """Return the time derivative of a variable: v for q, a for v, and the rate of a first-order state."""
    n, used = run.plan[0].coordinates, run.plan[0].used
    return state[n + i] if i < n else state[used + i - n]


@jit_inline
def leaves_samples(run: Run) -> bool:
    """Whether force samples are counted and not stored, since no column of the record shows them."""
    return run.base[0].room == 0


@jit_separate
def keep_sample(run: Run, t: float, state: State, first: int) -> None:
    """Store a force evaluation of the trial, from index `first` of its samples on."""
    used, samples, evaluated = run.plan[0].used, run.samples, run.log_samples.shape[0] - 3 - run.plan[0].used
    forces = used + run.plan[0].evaluated - evaluated  # the last of them
    if run.plan[0].samples == 0 or leaves_samples(run):
        return
    samples[first] = t
    for i in range(used):
        samples[first + 1 + i] = state[i]
    for i in range(evaluated):
        samples[first + 1 + used + i] = state[forces + i]


PARTS = 4
ROUNDING = 4.0 * EPS  # of the square of a length that needs no projection


@jit_separate
def hold_attitudes(run: Run, t: float) -> None:
    """Bring the quaternions of the trial's state back to unit length, and evaluate the forces there.

    Numbers of two floats are left as the method has them: their lengths are off by its error alone.
    """
    trial, any_moved = run.trial[0], False
    trial.deviation = 0.0
    for k in range(run.attitudes.shape[0]):
        square = 0.0
        for i in range(PARTS):
            square += run.z[run.attitudes[k, i]] * run.z[run.attitudes[k, i]]
        trial.deviation = max(trial.deviation, abs(sqrt(square) - 1.0))
        if abs(square - 1.0) > ROUNDING and run.plan[0].doubled == 0:
            normalise_quaternion(run, k, sqrt(square))
            any_moved = True
    if any_moved:
        evaluate_held(run, t, run.z, trial.h)
        run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@jit_separate
def normalise_quaternion(run: Run, k: int, length: float) -> None:
    """Divide a quaternion by its length; rounding carried for the value before is not that of the new one."""
    first_compensation = run.plan[0].used + run.plan[0].evaluated
    for i in range(PARTS):
        part_index = run.attitudes[k, i]
        run.z[part_index] = run.z[part_index] / length
        if first_compensation < run.z.shape[0]:
            run.z[first_compensation + part_index] = 0.0


@jit_separate
def put_reset_value(run: Run, k: int, state: State) -> None:
    """Write a computed reset value into a state, with its own compensation: 0, or the rest of a sum of two floats."""
    first_compensation = run.plan[0].used + run.plan[0].evaluated
    state[run.targets[k, 1]] = run.resets[k]
    if first_compensation < state.shape[0]:  # rounding carried for the value before is not that of the new one
        low_part = run.resets[run.targets.shape[0] + k] if run.plan[0].doubled > 0 else 0.0
        state[first_compensation + run.targets[k, 1]] = low_part
