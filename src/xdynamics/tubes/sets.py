"""A set of states that is carried along by a flow: a point, the set of starts seen from it, and what was lost on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.frames import FAR, off_orthogonal, orthogonal, solved


@dataclass(frozen=True)
class Seen:
    """All ``image + by @ parts``: the states of a set at a time, seen from those at another.

    Attributes
    ----------
    image : ndarray, shape (2, n)
    by : ndarray, shape (2, n, 2*n)
        Derivatives by the start, then by the rest.
    parts : ndarray, shape (2, 2*n)
        Start and rest.
    """

    image: Box
    by: Box
    parts: Box

    def box(self) -> Box:
        """Return a box that holds them."""
        return boxes.add(self.image, boxes.product(self.by, self.parts))

    def along(self, slopes: Box) -> Box:
        """Return what functions differ by from their values in the middle of the image, by their derivatives: a row each."""
        off = boxes.subtract(self.image, boxes.point(boxes.middle(self.image)))
        return boxes.add(boxes.product(slopes, off), boxes.product(boxes.product(slopes, self.by), self.parts))


@dataclass(frozen=True)
class Carried:
    """All ``point + spread @ start + scales * (frame @ rest)``, start and rest being any of two boxes.

    The first part is the image of the set of starts, which keeps its shape however it turns and shears; the second, what
    rounding, remainders and the curvature of the flow add, turns with the flow in an orthogonal frame (Lohner 1987;
    Mrozek, Zgliczynski 2000, "doubleton").

    Attributes
    ----------
    point : ndarray, shape (n,)
    spread : ndarray, shape (n, n)
    start : ndarray, shape (2, n)
    scales : ndarray, shape (n,)
        Powers of two of the size of each number, so that a frame may join metres with radians.
    frame : ndarray, shape (n, n)
    rest : ndarray, shape (2, n)
    """

    point: Floats
    spread: Floats
    start: Box
    scales: Floats
    frame: Floats
    rest: Box

    @classmethod
    def of(cls, start: Box, scales: Floats) -> Carried:
        """Return the set of a box."""
        point, n = boxes.middle(start), start.shape[1]
        return cls(
            point,
            np.eye(n),
            boxes.subtract(start, boxes.point(point)),
            scales,
            np.eye(n),
            np.zeros((2, n)),
        )

    @property
    def parts(self) -> Box:
        """Start and rest."""
        return np.concatenate([self.start, self.rest], axis=1)

    @property
    def by_parts(self) -> Box:
        """What start and rest are multiplied by."""
        return boxes.point(np.concatenate([self.spread, self.scales[:, None] * self.frame], axis=1))

    def box(self) -> Box:
        """Return a box that holds the set."""
        return boxes.add(boxes.point(self.point), boxes.product(self.by_parts, self.parts))

    def itself(self) -> Seen:
        """Return the set as it is."""
        return Seen(boxes.point(self.point), self.by_parts, self.parts)

    def seen(self, image: Box, jacobian: Box) -> Seen:
        """Return the image of the set under a map, by its value at the point and its derivatives over the set."""
        return Seen(image, boxes.product(jacobian, self.by_parts), self.parts)


def carried(seen: Seen, scales: Floats) -> Carried:
    """Return the image of a set under a map, as it is seen, to be carried on.

    Parameters
    ----------
    seen : Seen
    scales : ndarray, shape (n,)
        Of the new set.
    """
    n = len(scales)
    (by_start, by_rest), (start, rest) = np.split(seen.by, [n], axis=2), np.split(seen.parts, [n], axis=1)
    point, spread = boxes.middle(seen.image), boxes.middle(by_start)
    lost = boxes.product(boxes.subtract(by_start, boxes.point(spread)), start)
    lost = boxes.add(lost, boxes.subtract(seen.image, boxes.point(point)))
    # by powers of two, which is exact, but for numbers below the least normal one
    turned, lost = boxes.outward(by_rest / scales[:, None]), boxes.outward(lost / scales)
    directions = boxes.middle(turned)
    lengths = boxes.size(turned).max(axis=0) * boxes.width(rest)  # an order of columns, which proves nothing
    frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
    if (off := off_orthogonal(frame)) >= FAR:
        frame, off = np.eye(len(frame)), 0.0
    both = solved(frame, off, np.concatenate([turned, lost[:, :, None]], axis=2))
    rest = boxes.add(boxes.product(both[:, :, :-1], rest), both[:, :, -1])
    return Carried(point, spread, start, scales, frame, rest)
