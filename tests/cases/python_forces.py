"""Forces written in Python."""

from __future__ import annotations


def stiff_push(x: float, F: float) -> float:
    """A force in Python: SI in, SI out."""
    return F - 40.0 * x * x * x
