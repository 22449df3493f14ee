"""How many digits of a number a sentence shows: those that its uncertainty supports. Records keep all of them."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil, inf, isfinite, log10

MOST = 15  # digits that every double holds
UNKNOWN = 1e-9  # part of a number that its error is taken for, where nothing estimates it
REACHED = 0.1  # of the relative uncertainty of an input: what is taken to reach a number that follows from it


def digits(value: float, *, uncertainty: float = 0.0, relative: float = 0.0, apart: float = inf) -> int:
    """Return how many significant digits of a number to write.

    So many that rounding to them moves it by less than half its uncertainty, the larger of `uncertainty` and `relative` times its size; never
    fewer than distinguish it from another number that is `apart` away.

    Examples
    --------
    >>> digits(3.71119918, uncertainty=0.002), digits(3.71119918, relative=1e-6), digits(3.71119918, apart=1e-7)
    (5, 7, 9)
    """
    size, doubt = abs(value), max(uncertainty, relative * abs(value))
    if not isfinite(value) or size == 0.0:
        return 1
    needed = [ceil(log10(size / resolution)) + 1 for resolution in (doubt, apart) if 0.0 < resolution < inf]
    return min(MOST, max(1, *needed)) if needed else MOST


def known_part(tolerance: float | None, inputs: Iterable[tuple[float, float]]) -> float:
    """Return the relative uncertainty that a run leaves in its numbers.

    Parameters
    ----------
    tolerance : float, optional
        The relative tolerance of its steps; without one their error is not known.
    inputs : iterable of (float, float)
        Value and standard uncertainty of every uncertain parameter and start: of those the best known counts, as how much
        each moves a number is what a budget tells.
    """
    parts = [REACHED * doubt / abs(value) for value, doubt in inputs if value and doubt > 0.0]
    return max(UNKNOWN if tolerance is None else tolerance, min(parts, default=0.0))
