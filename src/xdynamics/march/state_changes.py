"""What events and controllers set a state to."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.run import Run

State = NDArray[Any]


@jit_separate
def put_reset_value(run: Run, k: int, state: State) -> None:
    """Put a value that was computed into its place of a state."""
    first_compensation = run.plan[0].used + run.plan[0].evaluated
    state[run.targets[k, 1]] = run.resets[k]
    if first_compensation < state.shape[0]:  # rounding carried for the value before is not that of the new one
        low_part = run.resets[run.targets.shape[0] + k] if run.plan[0].doubled > 0 else 0.0
        state[first_compensation + run.targets[k, 1]] = low_part
