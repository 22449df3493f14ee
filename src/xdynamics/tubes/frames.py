"""Frames that turn with the flow: orthogonal matrices, and proven products with their inverses (Lohner 1987)."""

from __future__ import annotations

from math import sqrt

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats

FAR = 0.25  # from orthogonal, where a frame is not taken
NEXT_TO_NOTHING = 1e-150  # entries of a frame that are taken for zero, so that none times a scale underflows
NEARLY_WITHIN = 1e-8  # a direction that is left of a column, as a part of it, below which it is none


def _sequential_dot(a: Floats, b: Floats) -> float:
    return float(np.add.accumulate(a * b)[-1])


def orthogonal(directions: Floats) -> Floats:
    """Return a frame whose first axes are along the first columns: Gram and Schmidt's, done twice.

    Parameters
    ----------
    directions : ndarray, shape (n, n)
        One a column, those that matter most first. Where one is in the span of those before, an axis is taken that is not.
    """
    n = len(directions)
    frame = np.zeros((n, n))
    spare = iter(range(n))
    for j in range(n):
        column = _unit_remainder(directions[:, j], frame[:, :j])
        while column is None:
            axis = np.zeros(n)
            axis[next(spare)] = 1.0
            column = _unit_remainder(axis, frame[:, :j])
        frame[:, j] = column
    frame[np.abs(frame) < NEXT_TO_NOTHING] = 0.0
    return frame


def _unit_remainder(direction: Floats, axes: Floats) -> Floats | None:
    """Return the unit vector of what is left of a direction beside some axes; None if that is next to nothing."""
    size = float(np.abs(direction).max())
    if not 0.0 < size < np.inf:
        return None
    left = direction / size
    length = sqrt(_sequential_dot(left, left))
    left = left / length
    for _ in range(2):
        for axis in axes.T:
            left = left - _sequential_dot(left, axis) * axis
    remaining = sqrt(_sequential_dot(left, left))
    if remaining < NEARLY_WITHIN:
        return None
    return np.asarray(left / remaining)


def solve_in_frame(frame: Floats, off: float, right: Box) -> Box:
    """Enclose frame**-1 times some columns, of a frame that is orthogonal but for rounding.

    With E = I - Q^T Q, whose norm is s, Q**-1 = (I - E)**-1 Q^T, and (I - E)**-1 w differs from w by at most
    s/(1 - s) of the largest of w.

    Parameters
    ----------
    frame : ndarray, shape (n, n)
    off : float
        A bound of s, below a half.
    right : ndarray, shape (2, n, m)
    """
    near = boxes.matrix_product(boxes.point_box(frame.T), right)
    error_bound = np.nextafter(2.0 * off * boxes.magnitude(near).max(axis=0), np.inf)
    return boxes.round_outward(near + np.array([-error_bound, error_bound])[:, None])


def off_orthogonal(frame: Floats) -> float:
    """Return a bound of how far a frame is from orthogonal: of the norm of I - Q^T Q by sums of rows."""
    lacking = boxes.subtract(
        boxes.point_box(np.eye(len(frame))), boxes.matrix_product(boxes.point_box(frame.T), boxes.point_box(frame))
    )
    return float(boxes.sum_along(boxes.point_box(boxes.magnitude(lacking)))[1].max())
