"""A set of states that is carried along by a flow: a point, the set of starts seen from it, and what was lost on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.frames import is_orthogonal, orthogonal, solved


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

    def seen(self, image: Box, jacobian: Box) -> Box:
        """Return a box that holds the image of the set under a map, by its value at the point and its derivatives."""
        by_start = boxes.product(boxes.product(jacobian, boxes.point(self.spread)), self.start)
        frame = boxes.point(self.scales[:, None] * self.frame)
        by_rest = boxes.product(boxes.product(jacobian, frame), self.rest)
        return boxes.add(boxes.add(image, by_start), by_rest)

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
        turned, lost = turned / scales[:, None], lost / scales  # by powers of two, exact
        directions = boxes.middle(turned)
        lengths = boxes.size(boxes.multiply(turned, boxes.point(boxes.width(self.rest)[None, :]))).max(axis=0)
        frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
        if not is_orthogonal(frame):
            frame = np.eye(len(frame))
        rest = boxes.add(boxes.product(solved(frame, turned), self.rest), solved(frame, lost))
        return Carried(point, spread, self.start, scales, frame, rest)
