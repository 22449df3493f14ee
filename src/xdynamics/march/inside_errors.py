"""How far a state inside a step is from a more accurate one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.run import Run

Floats = NDArray[np.float64]


@jit_separate
def judge_inside(
    run: Run, s: float, states: Floats, ends: Floats, interior_states: Floats, k: int, solved: bool
) -> None:
    """Replace the single step by the state's distance from two half steps, extrapolated with it.

    Two half steps have 2**-p of the error of the whole one. Rounding is added, one spacing of the numbers that
    were summed; so is the mismatch at the step's end, which is added to the state in proportion to how errors grow.
    """
    n, divisor, cube = states.shape[0], run.plan[0].divisor, s * s * s
    if run.plan[0].extrapolated:
        divisor = 2.0 * divisor + 1.0  # one order higher
    for i in range(n):
        value, whole_step, halves = interior_states[i, k], interior_states[n + i, k], run.z[i] if solved else np.nan
        off = abs((value - halves) + (whole_step - halves) / divisor)
        missing = cube * cube * (ends[i, k] - run.located_z[i]) if ends.shape[0] > 0 else 0.0
        interior_states[i, k] = value + missing
        interior_states[n + i, k] = off + abs(missing) + EPS * max(abs(states[i, k]), abs(value))
