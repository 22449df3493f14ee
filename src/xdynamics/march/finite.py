"""The one question that every trial is asked."""

from __future__ import annotations

import numpy as np

from xdynamics.kernels.compiling import compiled


@compiled
def all_finite(values: tuple[float, ...]) -> bool:
    """Whether no number of a tuple is nan or infinite."""
    finite = True
    for value in values:
        finite = finite and np.isfinite(value)
    return finite
