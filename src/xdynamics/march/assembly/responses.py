"""What forces, or impulses, of links do: to all coordinates, which is summed in `swing`, and from there along each link.

W, the effect of each link on each, is never formed: one product with it is `clear`, then `respond` for every link, then
`response_along` every link.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.march.run import Run


@shared
def clear(run: Run, first: int, rows: int) -> None:
    """Set to zero what links do to every coordinate that rows read."""
    for row in range(first, first + rows):
        for i in range(run.reads.shape[1]):
            run.swing[run.reads[row, i]] = 0.0


@shared
def respond(run: Run, row: int, amount: float) -> None:
    """Add what a force along a row does to coordinates."""
    for i in range(run.reads.shape[1]):
        run.swing[run.reads[row, i]] += run.replies[row, i] * amount


@shared
def response_along(run: Run, row: int) -> float:
    """What all that was added does along a row."""
    total = 0.0
    for i in range(run.reads.shape[1]):
        total += run.normals[row, i] * run.swing[run.reads[row, i]]
    return total
