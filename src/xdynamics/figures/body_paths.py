"""Where one body of a picture is, at times that bend as its motion does."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.units import NONE, parse_unit

Floats = NDArray[np.float64]

NUMBERED = re.compile(r"\d+(, \d+)*")


@dataclass(frozen=True)
class BodyPath:
    """Where one body is.

    Attributes
    ----------
    across, up : str
        What the axes are.
    units : str
        Of both, or of the axis across if the other one has its own.
    times, x, y : ndarray, shape (n,)
        A line that bends as the motion does.
    body : str
        Which of several it is: a name, labels, or numbers of elements.
    up_units : str
        Of the axis up, in a plane of unlike quantities.
    names : pair of str
        The coordinates that the axes are, as the run's elements are called; empty where an axis is none.
    dims : str
        Dimensions of which `body` is an element.
    depth : ndarray, shape (n,), optional
        Along the axis that a view in space does not show.
    depth_name : str
        The coordinate that it is.
    """

    across: str
    up: str
    units: str
    times: Floats
    x: Floats
    y: Floats
    body: str = ""
    up_units: str = ""
    names: tuple[str, str] = ("", "")
    dims: str = ""
    depth: Floats | None = None
    depth_name: str = ""

    @property
    def all_names(self) -> tuple[str, ...]:
        """The coordinates of the axes, and of the depth where there is one."""
        return (*self.names, self.depth_name) if self.depth_name else self.names

    @property
    def points(self) -> Floats:
        """Where the body is, shape (2, n), or (3, n) where there is a depth."""
        return np.stack([self.x, self.y] if self.depth is None else [self.x, self.y, self.depth])

    @property
    def label(self) -> str:
        """How pictures call it: numbers of elements with what they are of."""
        return f"{self.dims} {self.body}" if NUMBERED.fullmatch(self.body) else self.body

    @property
    def is_space(self) -> bool:
        """Whether both axes are lengths, so that one scale suits both."""
        return not self.up_units and is_length(self.units)

    @property
    def is_fixed(self) -> bool:
        """Whether the body never moves: an anchor, a wall."""
        return not np.ptp(self.points, axis=-1).any()


def is_length(units: str) -> bool:
    """Whether a unit is that of a position: neither of an angle, nor unreadable."""
    try:
        return parse_unit(units).dimension != NONE
    except InputError:
        return False
