"""Many elements of one quantity as one line of the ledger: the worst of them, and how many were judged."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from xdynamics.evidence.validating.ledger_rows import LedgerRow
    from xdynamics.shapes.blocks import Block

MOST_ALONE = 100  # elements of one closed form, each of which has a line of its own


def of_worst(
    row: LedgerRow, block: Block, residual: Any, bound: Any, scale: Any, of_form: Any = 0.0, of_start: Any = 0.0
) -> LedgerRow:
    """Return a line with residual, bound and scale of the element whose residual is the largest part of its bound.

    Parameters
    ----------
    row : LedgerRow
    block : Block
        The elements; without dimensions there is one number.
    residual, bound, scale : float or ndarray, shape of the block or ()
        A residual of nan has failed.
    of_form, of_start : float or ndarray, shape of the block or ()
        The parts of the bound that are for the rounding of expressions.
    """
    row_numbers = (residual, bound, scale, of_form, of_start)
    residuals, bounds, scales, forms, starts = (np.broadcast_to(number, block.shape).ravel() for number in row_numbers)
    failed = ~(residuals <= bounds)
    parts = np.divide(residuals, bounds, out=np.where(residuals > 0.0, np.inf, 0.0), where=bounds > 0.0)
    parts = np.where(np.isnan(parts) | np.isnan(residuals), np.inf, parts)
    # a quotient may round to 1 on either side of the bound: where any has failed, the worst is one of those
    worst = int(np.argmax(np.where(failed, parts, -1.0) if failed.any() else parts))
    return replace(
        row,
        residual=float(residuals[worst]),
        bound=float(bounds[worst]),
        scale=float(scales[worst]),
        of_form=float(forms[worst]),
        of_start=float(starts[worst]),
        worst=block.element(worst) if block.dims else "",
        failed_elements=int(failed.sum()),
    )
