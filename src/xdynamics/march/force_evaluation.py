"""Force evaluations at a state, and their storage."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import FORCES
from xdynamics.kernels.program import H, T
from xdynamics.march.calls import call_law
from xdynamics.march.exact_times import set_time
from xdynamics.march.run import Run

State = NDArray[Any]


@jit_separate
def evaluate_forces(run: Run, t: float, state: State) -> None:
    """Evaluate the forces at a state; they are stored after it in the same array."""
    set_time(run, T, t)
    call_law(run.law[FORCES], run, state, state, 0)
    run.now[0].evaluations += 1


@jit_separate
def evaluate_held(run: Run, t: float, state: State, h: float) -> None:
    """Evaluate the forces at a state, which is put where constraints hold, if there are any, after a step or none (0)."""
    if run.plan[0].held > 0:
        settle_constraints(run, t, state, h)
    else:
        evaluate_forces(run, t, state)


@jit_separate
def settle_constraints(run: Run, t: float, state: State, h: float) -> None:
    """Put a state where constraints hold, after a step or none (0), and evaluate the forces there."""
    set_time(run, T, t)
    run.at[H] = h
    call_law(run.law[run.plan[0].held], run, state, state, 0)
    run.now[0].evaluations += 1


@jit_separate
def find_term_sizes(run: Run, t: float, state: State) -> None:
    """Find the sizes of the terms of accelerations and rates at a state; they are stored in `probe`, where these would be."""
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
def state_slope(run: Run, state: State, i: int) -> float:
    """Return the time derivative of a variable: v for q, a for v, and the rate of a first-order state."""
    n, used = run.plan[0].coordinates, run.plan[0].used
    return state[n + i] if i < n else state[used + i - n]


@jit_inline
def leaves_samples(run: Run) -> bool:
    """Whether force samples are counted and not kept, since no column of the record shows them."""
    return run.base[0].room == 0


@jit_separate
def keep_sample(run: Run, t: float, state: State, first: int) -> None:
    """Store a force evaluation of the trial, from place `first` of its samples on."""
    used, samples, evaluated = run.plan[0].used, run.samples, run.log_samples.shape[0] - 3 - run.plan[0].used
    forces = used + run.plan[0].evaluated - evaluated  # the last of them
    if run.plan[0].samples == 0 or leaves_samples(run):
        return
    samples[first] = t
    for i in range(used):
        samples[first + 1 + i] = state[i]
    for i in range(evaluated):
        samples[first + 1 + used + i] = state[forces + i]
