"""A set of states that is carried along by a flow: a point, the set of starts seen from it, and what was lost on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.frames import FAR, off_orthogonal, orthogonal, solved


@dataclass(frozen=True)
class Seen:
    """All ``image + by_start @ start + by_rest @ rest``: the states of a set at a time, seen from those at another."""

    image: Box
    by_start: Box
    start: Box
    by_rest: Box
    rest: Box

    def box(self) -> Box:
        """Return a box that holds them."""
        return boxes.add(self.image, self.beside(self.by_start, self.by_rest))

    def beside(self, by_start: Box, by_rest: Box) -> Box:
        """Return what two matrices make of start and rest."""
        return boxes.add(boxes.product(by_start, self.start), boxes.product(by_rest, self.rest))

    def along(self, slopes: Box) -> Box:
        """Return what a function differs by from its value in the middle of the image, by its derivatives: a row."""
        off = boxes.subtract(self.image, boxes.point(boxes.middle(self.image)))
        both = self.beside(boxes.product(slopes, self.by_start), boxes.product(slopes, self.by_rest))
        return boxes.add(boxes.product(slopes, off), both)


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

    def box(self) -> Box:
        """Return a box that holds the set."""
        beside = boxes.product(boxes.point(self.scales[:, None] * self.frame), self.rest)
        return boxes.add(
            boxes.add(boxes.point(self.point), boxes.product(boxes.point(self.spread), self.start)), beside
        )

    def seen(self, image: Box, jacobian: Box) -> Seen:
        """Return the image of the set under a map, by its value at the point and its derivatives over the set."""
        frame = boxes.point(self.scales[:, None] * self.frame)
        by_start = boxes.product(jacobian, boxes.point(self.spread))
        return Seen(image, by_start, self.start, boxes.product(jacobian, frame), self.rest)


def carried(seen: Seen, scales: Floats) -> Carried:
    """Return the image of a set under a map, as it is seen, to be carried on.

    Parameters
    ----------
    seen : Seen
    scales : ndarray, shape (n,)
        Of the new set.
    """
    point, spread = boxes.middle(seen.image), boxes.middle(seen.by_start)
    lost = boxes.product(boxes.subtract(seen.by_start, boxes.point(spread)), seen.start)
    lost = boxes.add(lost, boxes.subtract(seen.image, boxes.point(point)))
    # by powers of two, which is exact, but for numbers below the least normal one
    turned, lost = boxes.outward(seen.by_rest / scales[:, None]), boxes.outward(lost / scales)
    directions = boxes.middle(turned)
    lengths = boxes.size(turned).max(axis=0) * boxes.width(seen.rest)  # an order of columns, which proves nothing
    frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
    if (off := off_orthogonal(frame)) >= FAR:
        frame, off = np.eye(len(frame)), 0.0
    both = solved(frame, off, np.concatenate([turned, lost[:, :, None]], axis=2))
    rest = boxes.add(boxes.product(both[:, :, :-1], seen.rest), both[:, :, -1])
    return Carried(point, spread, seen.start, scales, frame, rest)
