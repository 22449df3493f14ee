"""A set of states that is carried along by a flow: a point, the set of starts seen from it, and what was lost on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.frames import FAR, off_orthogonal, orthogonal, solve_in_frame


@dataclass(frozen=True)
class AffineImage:
    """All ``image + by @ parts``: the states of a set at a time, seen from those at another.

    Attributes
    ----------
    image : ndarray, shape (2, n)
    derivatives : ndarray, shape (2, n, 2*n)
        Derivatives by the start, then by the rest.
    parts : ndarray, shape (2, 2*n)
        Start and rest.
    """

    image: Box
    derivatives: Box
    parts: Box

    def box(self) -> Box:
        """Return a box that holds them."""
        return boxes.add(self.image, boxes.matrix_product(self.derivatives, self.parts))

    def mean_value_form(self, slopes: Box) -> Box:
        """Return what functions differ by from their values in the middle of the image, by their derivatives: a row each."""
        off = boxes.subtract(self.image, boxes.point_box(boxes.midpoint(self.image)))
        return boxes.add(
            boxes.matrix_product(slopes, off),
            boxes.matrix_product(boxes.matrix_product(slopes, self.derivatives), self.parts),
        )


@dataclass(frozen=True)
class Doubleton:
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
    remainder : ndarray, shape (2, n)
    """

    point: Floats
    spread: Floats
    start: Box
    scales: Floats
    frame: Floats
    remainder: Box

    @classmethod
    def of_box(cls, start: Box, scales: Floats) -> Doubleton:
        """Return the set of a box."""
        point, n = boxes.midpoint(start), start.shape[1]
        return cls(point, np.eye(n), boxes.subtract(start, boxes.point_box(point)), scales, np.eye(n), np.zeros((2, n)))

    @property
    def parts(self) -> Box:
        """Start and rest."""
        return np.concatenate([self.start, self.remainder], axis=1)

    @property
    def by_parts(self) -> Box:
        """What start and rest are multiplied by."""
        return boxes.point_box(np.concatenate([self.spread, self.scales[:, None] * self.frame], axis=1))

    def box(self) -> Box:
        """Return a box that holds the set."""
        return boxes.add(boxes.point_box(self.point), boxes.matrix_product(self.by_parts, self.parts))

    def itself(self) -> AffineImage:
        """Return the set as it is."""
        return AffineImage(boxes.point_box(self.point), self.by_parts, self.parts)

    def image_under(self, image: Box, jacobian: Box) -> AffineImage:
        """Return the image of the set under a map, by its value at the point and its derivatives over the set."""
        return AffineImage(image, boxes.matrix_product(jacobian, self.by_parts), self.parts)


def doubleton_of(seen: AffineImage, scales: Floats) -> Doubleton:
    """Return the image of a set under a map, as it is seen, to be carried on.

    Parameters
    ----------
    seen : Seen
    scales : ndarray, shape (n,)
        Of the new set.
    """
    n = len(scales)
    (by_start, by_rest), (start, remainder) = np.split(seen.derivatives, [n], axis=2), np.split(seen.parts, [n], axis=1)
    point, spread = boxes.midpoint(seen.image), boxes.midpoint(by_start)
    lost = boxes.matrix_product(boxes.subtract(by_start, boxes.point_box(spread)), start)
    lost = boxes.add(lost, boxes.subtract(seen.image, boxes.point_box(point)))
    # by powers of two, which is exact, but for numbers below the least normal one
    basis, lost = boxes.round_outward(by_rest / scales[:, None]), boxes.round_outward(lost / scales)
    directions = boxes.midpoint(basis)
    lengths = boxes.magnitude(basis).max(axis=0) * boxes.width(remainder)  # an order of columns, which proves nothing
    frame = orthogonal(directions[:, np.argsort(-lengths, kind="stable")])
    if (off := off_orthogonal(frame)) >= FAR:
        frame, off = np.eye(len(frame)), 0.0
    both = solve_in_frame(frame, off, np.concatenate([basis, lost[:, :, None]], axis=2))
    remainder = boxes.add(boxes.matrix_product(both[:, :, :-1], remainder), both[:, :, -1])
    return Doubleton(point, spread, start, scales, frame, remainder)
