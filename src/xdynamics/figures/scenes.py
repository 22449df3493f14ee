"""What a film shows as its time goes on: bodies in the plane with their trails and links, or a quantity along a dimension."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.lattice import profiled, shapes_of
from xdynamics.figures.marks import COLOURS, words
from xdynamics.figures.plane import MOST_BODIES, Path, drawn_links, left_out, views

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

MARGIN = 0.06  # of the larger side
MOST_TRAILS = 30  # bodies with a trail; many would hide each other


class Scene(Protocol):
    """What is drawn once, and what moves."""

    @property
    def times(self) -> Floats:
        """The times that it is of: shape (n,), in the run's unit."""

    def start(self, axes: Axes) -> str:
        """Draw what stands still, and return what the title says beside the run's."""

    def at(self, now: float) -> list[Any]:
        """Move to a time, and return what moved."""


def scene_of(run: xr.Dataset, trail: float | None) -> Scene | None:
    """Return the scene of a run's plane, or of its first quantity along a dimension; None if it has neither."""
    if shown := views(run):
        return Bodies(shown[0], drawn_links(run), trail) if shown[0] else None
    for name, dim, elements in profiled(run, shapes_of(run)):
        values = np.stack([run[element].values for element in elements], axis=-1)
        return Profile(name, dim, str(run[elements[0]].attrs["units"]), run["time"].values, values)
    return None


@dataclass
class Bodies:
    """Bodies in the plane.

    Attributes
    ----------
    view : list of Path
    links : ndarray of int, shape (m, 2)
        Which bodies have a line between them.
    trail : float, optional
        How far back trails go; a tenth of the run.
    """

    view: list[Path]
    links: NDArray[np.int_]
    trail: float | None = None
    _trails: list[Any] = field(default_factory=list)
    _dots: list[Any] = field(default_factory=list)
    _lines: list[Any] = field(default_factory=list)

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.view[0].times

    def start(self, axes: Axes) -> str:
        """Draw empty lines; both axes have one scale, that holds the whole motion."""
        view = self.view
        low = np.array([min(body.x.min() for body in view), min(body.y.min() for body in view)])
        high = np.array([max(body.x.max() for body in view), max(body.y.max() for body in view)])
        half, middle = (0.5 + MARGIN) * float(max(high - low)) or 1.0, (low + high) / 2.0
        axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half), aspect="equal")
        axes.set(xlabel=f"across ({view[0].units})", ylabel=f"up ({view[0].units})")
        shown, colours = view[:MOST_BODIES], [COLOURS[k % len(COLOURS)] for k in range(len(view))]
        self.links = self.links[(self.links < len(shown)).all(axis=-1)]
        self._lines = [axes.plot([], [], "-", color="0.5", linewidth=1.5)[0] for _ in self.links]
        trails = colours[: len(shown)] if len(shown) <= MOST_TRAILS else []
        self._trails = [axes.plot([], [], "-", color=colour, linewidth=1.2, alpha=0.6)[0] for colour in trails]
        size = 8.0 if len(shown) <= MOST_TRAILS else 4.0
        self._dots = [axes.plot([], [], "o", color=colour, markersize=size)[0] for colour in colours[: len(shown)]]
        return left_out(view)

    def at(self, now: float) -> list[Any]:
        """Put dots, links and trails where they are."""
        shown = self.view[:MOST_BODIES]
        places = np.array([[np.interp(now, body.times, part) for part in (body.x, body.y)] for body in shown])
        for dot, place in zip(self._dots, places, strict=True):
            dot.set_data(place[:1], place[1:])
        for line, pair in zip(self._lines, self.links, strict=True):
            line.set_data(*places[pair].T)
        back = 0.1 * float(np.ptp(self.times)) if self.trail is None else self.trail
        past = np.linspace(max(float(self.times[0]), now - back), now, 120)
        for trail, body in zip(self._trails, shown, strict=False):
            trail.set_data(np.interp(past, body.times, body.x), np.interp(past, body.times, body.y))
        return [*self._trails, *self._lines, *self._dots]


@dataclass
class Profile:
    """A quantity along a dimension, straight in time between recorded states.

    Attributes
    ----------
    name, dim, units : str
    times : ndarray, shape (n,)
    values : ndarray, shape (n, elements)
    """

    name: str
    dim: str
    units: str
    times: Floats
    values: Floats
    _line: Any = None

    def start(self, axes: Axes) -> str:
        """Draw the range that the quantity has, and its start in grey."""
        low, high = float(np.nanmin(self.values)), float(np.nanmax(self.values))
        margin = MARGIN * (high - low) or 1.0
        elements = np.arange(self.values.shape[1])
        axes.plot(elements, self.values[0], "-", color="0.75", linewidth=1)
        self._line = axes.plot([], [], ".-", color=COLOURS[0], markersize=3, linewidth=1.2)[0]
        axes.set(ylim=(low - margin, high + margin), xlabel=words(f"element of {self.dim}"))
        axes.set_ylabel(words(f"{self.name} ({self.units})"))
        return " (grey: at the start)"

    def at(self, now: float) -> list[Any]:
        """Draw the quantity at a time."""
        row = int(np.clip(np.searchsorted(self.times, now, side="right"), 1, len(self.times) - 1))
        begin, end = (float(time) for time in self.times[row - 1 : row + 1])
        part = (now - begin) / (end - begin) if end > begin else 1.0
        values = self.values[row - 1] + part * (self.values[row] - self.values[row - 1])
        self._line.set_data(np.arange(len(values)), values)
        return [self._line]
