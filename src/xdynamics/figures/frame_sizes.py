"""How large the frames of films are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PROFILE = (6.0, 4.0)  # inches: of a quantity along a dimension
MARGIN = 0.06  # of the larger side
SLIM = 0.15  # of the longer side, that half of the shorter one has at least
DOUBLE = 6.0  # inches: of the longer side of two views together
SIDE, LEAST, LABELS = 5.2, 1.8, 0.8  # inches: of the longer side, of any side, of what stands beside the axes
KEY, LETTER = 0.4, 0.075  # inches: of a legend beside the axes, and of each letter in it


def frame_size(limits: NDArray[np.float64], names: Sequence[str]) -> tuple[float, float]:
    """Return width and height of a frame with one scale, in inches.

    Parameters
    ----------
    limits : ndarray, shape (2, 2)
        What the axes hold, across and up.
    names : sequence of str
        Of the legend beside them.
    """
    width, height = np.ptp(limits, axis=-1)
    longer = max(width, height)
    return max(LEAST, SIDE * width / longer) + _room_beside_axes(names), max(LEAST, SIDE * height / longer) + LABELS


def double_frame_size(
    limits: Sequence[NDArray[np.float64]], names: Sequence[str], *, is_stacked: bool
) -> tuple[float, float]:
    """Return width and height of a frame of two views with one scale, in inches.

    Parameters
    ----------
    limits : sequence of ndarray, shape (2, 2)
        What the axes of each hold, across and up.
    names : sequence of str
        Of the legend beside them.
    is_stacked : bool
        Whether one is over the other.
    """
    sides = np.array([np.ptp(view_limits, axis=-1) for view_limits in limits])
    width, height = (sides[0, 0], sides[:, 1].sum()) if is_stacked else (sides[:, 0].sum(), sides[0, 1])
    scale = DOUBLE / max(width, height)
    return max(LEAST, scale * width) + LABELS + _room_beside_axes(names), max(LEAST, scale * height) + 2.0 * LABELS


def _room_beside_axes(names: Sequence[str]) -> float:
    """Return the room that stands beside the axes."""
    return LABELS + (KEY + LETTER * max(map(len, names)) if names else 0.0)
