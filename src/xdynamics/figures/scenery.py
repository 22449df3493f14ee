"""What stands or moves beside the bodies of a film: rods, springs and threads that a model names, and where its gaps close."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.shortened_steps import model_of
from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import Name
from xdynamics.figures.plane import BodyPath
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.model.parts import ORIGIN
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

WIDTHS = {"links": 3.0, "springs": 1.2, "threads": 0.9}
COILS = 8  # of a spring
COIL = 0.025  # of the longer side, that a coil goes to either side
STRAIGHT = 0.12  # of a spring at either end
GRID = 160  # points along each side, among which a gap's zero is looked for
GROUND = "0.6"


@dataclass
class Fastening:
    """Rods, springs or threads from body to body.

    Attributes
    ----------
    kind : {"links", "springs", "threads"}
    ends : ndarray of int, shape (m, 2)
        Numbers of bodies, -1 for the origin.
    """

    kind: str
    ends: NDArray[np.int_]
    _coil: float = 0.0
    _lines: Any = None

    def start(self, axes: Axes, limits: Floats) -> None:
        """Prepare the lines."""
        from matplotlib.collections import LineCollection

        self._coil = COIL * float(np.ptp(limits, axis=-1).max())
        self._lines = axes.add_collection(
            LineCollection([], colors="0.45", linewidths=WIDTHS[self.kind]), autolim=False
        )

    def at(self, places: Floats) -> Any:
        """Put the lines between the places of bodies, the last of which is the origin."""
        pairs = places[self.ends]
        self._lines.set_segments(
            [coiled(start, end, self._coil) for start, end in pairs] if self.kind == "springs" else pairs
        )
        return self._lines


def coiled(start: Floats, end: Floats, coil: float) -> Floats:
    """Return the zigzag of a spring, shape (n, 2), from one end to the other."""
    along = end - start
    length = float(np.hypot(*along)) or 1.0
    part = np.concatenate([[0.0], np.linspace(STRAIGHT, 1.0 - STRAIGHT, 2 * COILS + 1), [1.0]])
    side = np.zeros(part.size)
    side[2:-2] = coil * np.where(np.arange(part.size - 4) % 2, -1.0, 1.0)
    across = np.array([-along[1], along[0]]) / length
    points: Floats = start + part[:, None] * along + side[:, None] * across
    return points


def fastenings(run: xr.Dataset, view: list[BodyPath]) -> list[Fastening]:
    """Return what the model fastens its bodies by."""
    if "model_toml" not in run:
        return []
    pictured = model_of(run, None).pictured
    number = {name: k for k, name in enumerate(pictured.bodies[: len(view)])} | {ORIGIN: -1}
    found = []
    for kind in WIDTHS:
        ends = [[number[end] for end in pair] for pair in getattr(pictured, kind) if {*pair} <= number.keys()]
        if ends:
            found.append(Fastening(kind, np.array(ends)))
    return found


@dataclass
class Boundary:
    """A floor or wall: where a contact's gap is zero in the plane.

    Attributes
    ----------
    model : Model
    gap : Node
    names : pair of str
        The coordinates across and up, empty where an axis has none.
    factor : float
        Of the axes' unit, in SI units.
    """

    model: Model
    gap: Node
    names: tuple[str, str]
    factor: float
    _grid: Any = None
    _line: Any = None

    @property
    def moves(self) -> bool:
        """Whether the gap depends on time."""
        return "t" in free_names(self.gap)

    def start(self, axes: Axes, limits: Floats) -> None:
        """Draw what stands still, with the forbidden side shaded; prepare what moves."""
        from matplotlib.collections import LineCollection

        self._grid = np.meshgrid(*(np.linspace(low, high, GRID) for low, high in limits))
        if self.moves:
            self._line = axes.add_collection(LineCollection([], colors=GROUND, linewidths=2.0), autolim=False)
            return
        gaps = self.gaps(0.0)
        if gaps.min() < 0.0 < gaps.max():
            axes.contourf(*self._grid, gaps, levels=[-np.inf, 0.0], colors=[GROUND], alpha=0.25)
            axes.contour(*self._grid, gaps, levels=[0.0], colors=[GROUND], linewidths=2.0)

    def gaps(self, now: float) -> Floats:
        """Return the gap at each point of the grid, shape (n, n)."""
        namespace: Mapping[str, Any] = dict(constants(self.model)) | {"t": np.float64(now)}
        places = {name: self.factor * axis.ravel() for name, axis in zip(self.names, self._grid, strict=True) if name}
        values: Floats = np.broadcast_to(evaluate_many(self.gap, {**namespace, **places}), self._grid[0].size)
        return values.reshape(self._grid[0].shape)

    def at(self, now: float) -> Any:
        """Put the line to where the gap is zero at a time."""
        from contourpy import contour_generator

        across, up = self._grid
        self._line.set_segments(contour_generator(x=across, y=up, z=self.gaps(now * self.clock)).lines(0.0))
        return self._line

    @property
    def clock(self) -> float:
        """The unit of recorded times, in SI units."""
        return float(self.model.time_unit.factor)


def boundaries(run: xr.Dataset, view: list[BodyPath]) -> list[Boundary]:
    """Return where gaps of contacts close that read no more than what one view shows."""
    if "model_toml" not in run or not view[0].is_space:
        return []
    model = model_of(run, None)
    names = _axes_of(model, view[0])
    shown = {*filter(None, names), "t", *constants(model)}
    gaps = [model.expanded(contact.gap) for contact in model.contacts.values() if isinstance(contact.gap, Node)]
    return [
        Boundary(model, gap, names, float(parse_unit(view[0].units).factor))
        for gap in gaps
        if (read := free_names(gap)) <= shown and read & {*filter(None, names)}
    ]


def _axes_of(model: Model, path: BodyPath) -> tuple[str, str]:
    """Name the coordinates that the axes of a view are; empty where they are none."""
    pairs = model.pictured.plane
    if not pairs:
        return path.across, path.up
    across, up = ("", "")
    for pair in pairs:
        across, up = (
            part.name if isinstance(part, Name) else known for part, known in zip(pair, (across, up), strict=True)
        )
    return across, up
