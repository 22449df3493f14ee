"""What forces, or impulses, of links do: to all coordinates, which is summed in `swing`, and from there along each link.

W, the effect of each link on each, is never formed: one product with it is `clear_responses`, then `respond` for every link, then
`response_along` every link.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.run import Run


@jit_separate
def clear_responses(run: Run, first: int, rows: int) -> None:
    """Set to zero what links do to every coordinate that rows read."""
    for row in range(first, first + rows):
        for i in range(run.coordinate_indices.shape[1]):
            run.swing[run.coordinate_indices[row, i]] = 0.0


@jit_separate
def respond(run: Run, row: int, amount: float) -> None:
    """Add what a force along a row does to coordinates."""
    for i in range(run.coordinate_indices.shape[1]):
        run.swing[run.coordinate_indices[row, i]] += run.unit_responses[row, i] * amount


@jit_separate
def response_along(run: Run, row: int) -> float:
    """What all that was added does along a row."""
    total = 0.0
    for i in range(run.coordinate_indices.shape[1]):
        total += run.normals[row, i] * run.swing[run.coordinate_indices[row, i]]
    return total
