"""What events and controllers set a state to."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared
from xdynamics.march.run import Run

State = NDArray[Any]


@shared
def put(run: Run, k: int, state: State) -> None:
    """Put a value that was computed into its place of a state."""
    carried = run.plan[0].used + run.plan[0].evaluated
    state[run.targets[k, 1]] = run.resets[k]
    if carried < state.shape[0]:  # rounding carried for the value before is not that of the new one
        rest = run.resets[run.targets.shape[0] + k] if run.plan[0].doubled > 0 else 0.0
        state[carried + run.targets[k, 1]] = rest
