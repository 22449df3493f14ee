"""A set of states that is carried along by a flow: a point, the set of starts seen from it, and what was lost on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.frames import is_orthogonal, orthogonal, solved


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

    def moved(self, image: Box, jacobian: Box, scales: Floats) -> Carried:
        """Return the image of the set under a map.

        Parameters
        ----------
        image : ndarray, shape (2, n)
            Of the point.
        jacobian : ndarray, shape (2, n, n)
            The derivatives of the map in a convex set that holds this one.
        scales : ndarray, shape (n,)
        """
        point = boxes.middle(image)
        spread_image = boxes.product(jacobian, boxes.point(self.spread))
        spread = boxes.middle(spread_image)
        lost = boxes.product(boxes.subtract(spread_image, boxes.point(spread)), self.start)
        lost = boxes.add(lost, boxes.subtract(image, boxes.point(point)))
        turned = boxes.product(jacobian, boxes.point(self.scales[:, None] * self.frame))
        # by powers of two, which is exact, but for numbers below the least normal one
        turned, lost = boxes.outward(turned / scales[:, None]), boxes.outward(lost / scales)
        directions = boxes.middle(turned)
        lengths = boxes.size(boxes.multiply(turned, boxes.point(boxes.width(self.rest)[None, :]))).max(axis=0)
        frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
        if not is_orthogonal(frame):
            frame = np.eye(len(frame))
        rest = boxes.add(boxes.product(solved(frame, turned), self.rest), solved(frame, lost))
        return Carried(point, spread, self.start, scales, frame, rest)
