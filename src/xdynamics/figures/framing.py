"""What a picture of bodies is framed on: all of them, or those that stay where a few fly off for good.

How large the frames of films are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.long_times import long_unit
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

FEWEST_BODIES = 3  # of which one may fly off
MOST_LEAVING = 3  # one of so many bodies at most
GAIN = 2.5  # times that the frame is smaller, from which on those that fly off are left behind
FARTHEST = 0.98  # of its distance at most, at which a body is at the end that goes for good
EDGE = 0.05  # of the longer side, around the bodies that stay
MOST_SAID = 3  # bodies that are named with their times


@dataclass(frozen=True)
class Frame:
    """What the axes of a picture hold.

    Attributes
    ----------
    limits : ndarray, shape (dimensions, 2)
        Of the bodies that stay, with a margin where some leave.
    leaving : tuple of (int, float)
        Which bodies leave the frame, and when, in that order.
    """

    limits: Floats
    leaving: tuple[tuple[int, float], ...] = ()

    @property
    def sides(self) -> Floats:
        """How long each side is, shape (dimensions,)."""
        lengths: Floats = np.ptp(self.limits, axis=-1)
        return lengths

    def points_inside(self, points: Floats) -> Floats:
        """Return points, shape (dimensions, n), with nan for those that lie outside."""
        is_inside = ((points >= self.limits[:, :1]) & (points <= self.limits[:, 1:])).all(axis=0)
        visible_points: Floats = np.where(is_inside, points, np.nan)
        return visible_points


def frame_of(paths: Sequence[Floats], times: Sequence[Floats]) -> Frame:
    """Return the frame of paths, without the fewest that fly off for good if all others are seen much better then.

    The frame holds where such a body starts; it leaves it for good, and is farthest from it at the end.

    Parameters
    ----------
    paths : sequence of ndarray, shape (dimensions, n)
        Of each body.
    times : sequence of ndarray, shape (n,)
    """
    boxes = np.stack([np.stack([path.min(axis=1), path.max(axis=1)], axis=-1) for path in paths])
    full_box, starts = _bounding_box(boxes), np.stack([path[:, :1] for path in paths])
    middle = np.median(starts[..., 0], axis=0)
    reach = np.abs(boxes - middle[:, None]).max(axis=(1, 2))
    order = np.argsort(-reach, kind="stable")
    for count in range(1, len(paths) // MOST_LEAVING + 1 if len(paths) >= FEWEST_BODIES else 0):
        kept_boxes = np.concatenate(
            [np.delete(boxes, order[:count], axis=0), np.repeat(starts[order[:count]], 2, axis=-1)]
        )
        kept_box = _bounding_box(kept_boxes)
        side = float(np.ptp(kept_box, axis=-1).max())
        if not 0.0 < GAIN * side <= float(np.ptp(full_box, axis=-1).max()):
            continue
        limits = kept_box + EDGE * side * np.array([-1.0, 1.0])
        left = [(int(body), _leaving_time(paths[body], times[body], limits)) for body in order[:count]]
        if any(time is None for _, time in left):
            break
        leaving_bodies = sorted(
            ((body, time) for body, time in left if time is not None),
            key=lambda body_and_time: (body_and_time[1], body_and_time[0]),
        )
        return Frame(limits, tuple(leaving_bodies))
    return whole_frame(paths)


def whole_frame(paths: Sequence[Floats]) -> Frame:
    """Return the frame of all paths, each of shape (dimensions, n)."""
    return Frame(_bounding_box(np.stack([np.stack([path.min(axis=1), path.max(axis=1)], axis=-1) for path in paths])))


def leaving_note(frame: Frame, names: Sequence[str], time: xr.DataArray, frame_name: str = "the frame") -> str:
    """Say, behind other words of a title, which bodies leave a frame, or what else it is of, at what times; nothing if none does."""
    unit, size = long_unit(time)
    times = [f"at t = {moment / size:.3g}{unit_suffix(unit)}" for _, moment in frame.leaving]
    bodies = [names[body] for body, _ in frame.leaving]
    if not times:
        return ""
    if len(times) == 1:
        return f"; {bodies[0]} leaves {frame_name} {times[0]}"
    if len(times) <= MOST_SAID:
        return f"; these leave {frame_name}: {', '.join(map(' '.join, zip(bodies, times, strict=True)))}"
    return f"; {len(times)} of {len(names)} leave {frame_name}, {bodies[0]} first {times[0]}, {bodies[-1]} last {times[-1]}"


def _bounding_box(boxes: Floats) -> Floats:
    return np.stack([boxes[..., 0].min(axis=0), boxes[..., 1].max(axis=0)], axis=-1)


def _leaving_time(path: Floats, times: Floats, limits: Floats) -> float | None:
    """Return when a body that starts within limits leaves them for good; None if it is inside at the end, or turns back."""
    overshoot = np.maximum(limits[:, :1] - path, path - limits[:, 1:]).max(axis=0)  # 0 at the edge
    if overshoot[-1] <= 0.0 or overshoot[-1] < FARTHEST * overshoot.max():
        return None
    last = int(np.flatnonzero(overshoot <= 0.0)[-1])
    # a row follows, as the body is outside at the end
    part = overshoot[last] / (overshoot[last] - overshoot[last + 1]) if overshoot[last] < overshoot[last + 1] else 0.0
    return float(times[last] + part * (times[last + 1] - times[last]))


PROFILE = (6.0, 4.0)  # inches: of a quantity along a dimension
MARGIN = 0.06  # of the larger side
SLIM = 0.15  # of the longer side, that half of the shorter one has at least
DOUBLE = 6.0  # inches: of the longer side of two views together
SIDE, LEAST, LABELS = 5.2, 1.8, 0.8  # inches: of the longer side, of any side, of what stands beside the axes
KEY, LETTER = 0.4, 0.075  # inches: of a legend beside the axes, and of each letter in it


def padded_limits(low: Floats, high: Floats, longer: Floats | float) -> Floats:
    """Return the limits of a picture around a motion, shape (2, 2): with a margin, no side much shorter than the longer one."""
    middle, half = (low + high) / 2.0, np.maximum((high - low) / 2.0 + MARGIN * longer, SLIM * longer)
    return np.stack([middle - half, middle + half], axis=-1)


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
    """Return width and height of a frame of two views with one scale, one over the other or side by side; see `frame_size`."""
    sides = np.array([np.ptp(view_limits, axis=-1) for view_limits in limits])
    width, height = (sides[0, 0], sides[:, 1].sum()) if is_stacked else (sides[:, 0].sum(), sides[0, 1])
    scale = DOUBLE / max(width, height)
    return max(LEAST, scale * width) + LABELS + _room_beside_axes(names), max(LEAST, scale * height) + 2.0 * LABELS


def _room_beside_axes(names: Sequence[str]) -> float:
    """Return the room that stands beside the axes."""
    return LABELS + (KEY + LETTER * max(map(len, names)) if names else 0.0)
