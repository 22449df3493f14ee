"""What a picture of bodies is framed on: all of them, or those that stay where a few fly off for good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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

    def inside(self, points: Floats) -> Floats:
        """Return points, shape (dimensions, n), with nan for those that lie outside."""
        within = ((points >= self.limits[:, :1]) & (points <= self.limits[:, 1:])).all(axis=0)
        kept: Floats = np.where(within, points, np.nan)
        return kept


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
    whole, starts = _around(boxes), np.stack([path[:, :1] for path in paths])
    middle = np.median(starts[..., 0], axis=0)
    reach = np.abs(boxes - middle[:, None]).max(axis=(1, 2))
    order = np.argsort(-reach, kind="stable")
    for count in range(1, len(paths) // MOST_LEAVING + 1 if len(paths) >= FEWEST_BODIES else 0):
        held = np.concatenate([np.delete(boxes, order[:count], axis=0), np.repeat(starts[order[:count]], 2, axis=-1)])
        rest = _around(held)
        side = float(np.ptp(rest, axis=-1).max())
        if not 0.0 < GAIN * side <= float(np.ptp(whole, axis=-1).max()):
            continue
        limits = rest + EDGE * side * np.array([-1.0, 1.0])
        left = [(int(body), _leaves(paths[body], times[body], limits)) for body in order[:count]]
        if any(time is None for _, time in left):
            break
        said = sorted(((body, time) for body, time in left if time is not None), key=lambda each: (each[1], each[0]))
        return Frame(limits, tuple(said))
    return whole_frame(paths)


def whole_frame(paths: Sequence[Floats]) -> Frame:
    """Return the frame of all paths, each of shape (dimensions, n)."""
    return Frame(_around(np.stack([np.stack([path.min(axis=1), path.max(axis=1)], axis=-1) for path in paths])))


def leaving_note(frame: Frame, names: Sequence[str], unit: str, size: float = 1.0, of: str = "the frame") -> str:
    """Say which bodies leave a frame, or what else it is of, at what times, given in a unit of some size; empty if none does."""
    at = [f"at t = {time / size:.3g}{unit}" for _, time in frame.leaving]
    called = [names[body] for body, _ in frame.leaving]
    if not at:
        return ""
    if len(at) == 1:
        return f"{called[0]} leaves {of} {at[0]}"
    if len(at) <= MOST_SAID:
        return f"these leave {of}: {', '.join(map(' '.join, zip(called, at, strict=True)))}"
    return f"{len(at)} of {len(names)} leave {of}, {called[0]} first {at[0]}, {called[-1]} last {at[-1]}"


def _around(boxes: Floats) -> Floats:
    return np.stack([boxes[..., 0].min(axis=0), boxes[..., 1].max(axis=0)], axis=-1)


def _leaves(path: Floats, times: Floats, limits: Floats) -> float | None:
    """Return when a body that starts within limits leaves them for good; None if it is inside at the end, or turns back."""
    beyond = np.maximum(limits[:, :1] - path, path - limits[:, 1:]).max(axis=0)  # 0 at the edge
    if beyond[-1] <= 0.0 or beyond[-1] < FARTHEST * beyond.max():
        return None
    last = int(np.flatnonzero(beyond <= 0.0)[-1])
    part = beyond[last] / (beyond[last] - beyond[last + 1]) if beyond[last] < beyond[last + 1] else 0.0
    return float(times[last] + part * (times[last + 1] - times[last]))
