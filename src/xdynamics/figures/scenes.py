"""What a film shows as its time goes on: bodies in the plane with their trails and links, or a quantity along a dimension."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.shortened_steps import model_of
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.boundaries import Boundary, boundaries, radii_of
from xdynamics.figures.frame_sizes import MARGIN, SLIM, frame_size
from xdynamics.figures.lattice import name_elements, profiled, shapes_of
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import COLOURS, typeset, words
from xdynamics.figures.mechanism import mechanism_of
from xdynamics.figures.plane import MOST_BODIES, along_a_line, colours_of, drawn_links, left_out, short, views
from xdynamics.figures.scenery import Fastening, fastenings
from xdynamics.shapes import Extent

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

PROFILE = (6.0, 4.0)  # inches
MOST_TRAILED = 1000  # points of a trail
MOST_TRAILS = 30  # bodies with a trail; many would hide each other


class Scene(Protocol):
    """What is drawn once, and what moves."""

    @property
    def times(self) -> Floats:
        """The times that it is of: shape (n,), in the run's unit."""

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a frame, inches."""

    def start(self, axes: Axes) -> str:
        """Draw what stands still, and return what the title says beside the run's."""

    def at(self, now: float) -> list[Any]:
        """Move to a time, and return what moved."""


def scene_of(run: xr.Dataset, trail: float | None) -> Scene | None:
    """Return the scene of a run's plane, of bodies that turn, or of a quantity along a dimension; None if it has neither."""
    shown = views(run)
    in_space = bool(shown and shown[0]) and shown[0][0].is_space and bool(model_of(run, None).pictured.plane)
    if not in_space and (mechanism := mechanism_of(run, trail)) is not None:
        return mechanism
    if (shown := shown or along_a_line(run)) and shown[0]:
        view = shown[0]
        radii = radii_of(run, view)
        return Bodies(view, drawn_links(run), trail, fastenings(run, view), boundaries(run, view, radii), radii)
    if shown:
        return None
    for name, dim, elements in profiled(run, shapes_of(run)):
        values = np.stack([run.variables[element].values for element in elements], axis=-1)
        extent, units = shapes_of(run).extent(dim), str(run.variables[elements[0]].attrs["units"])
        return Profile(name, dim, extent, units, run.variables["time"].values, values)
    return None


@dataclass
class Bodies:
    """Bodies in the plane.

    Attributes
    ----------
    view : list of BodyPath
    links : ndarray of int, shape (m, 2)
        Which bodies have a line between them.
    trail : float, optional
        How far back trails go; a tenth of the run.
    fastenings : list of Fastening
        Rods, springs and threads that the model names.
    boundaries : list of Boundary
        Walls and floors, where gaps are zero.
    radii : ndarray, shape (bodies,)
        Of discs, in the axes' unit; empty where bodies are dots.
    """

    view: list[BodyPath]
    links: NDArray[np.int_]
    trail: float | None = None
    fastenings: Sequence[Fastening] = ()
    boundaries: Sequence[Boundary] = ()
    radii: Floats = field(default_factory=lambda: np.zeros(0))
    _dots: Any = None
    _trails: Any = None
    _lines: Any = None

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.view[0].times

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as the motion."""
        if not self.view[0].is_space:
            return PROFILE
        return frame_size(self._limits, self._names)

    @property
    def _names(self) -> list[str]:
        """What bodies are called, where there are several, and not too many for a legend."""
        names = [body.label for body in self.view]
        return names if 1 < len(names) <= MOST_NAMED and all(names) else []

    @property
    def _limits(self) -> Floats:
        """What the axes hold, shape (2, 2): the whole motion, and no side much shorter than the other."""
        ends = np.array(
            [[getattr(body, letter).min(), getattr(body, letter).max()] for body in self.view for letter in "xy"]
        )
        ends = ends.reshape(-1, 2, 2)
        if any((part.ends < 0).any() for part in self.fastenings):  # to the origin
            ends = np.concatenate([ends, np.zeros((1, 2, 2))])
        beyond = float(self.radii.max(initial=0.0))
        low, high = ends[..., 0].min(axis=0) - beyond, ends[..., 1].max(axis=0) + beyond
        longer = float(max(high - low)) or 1.0 if self.view[0].is_space else np.where(high > low, high - low, 1.0)
        half = np.maximum((high - low) / 2.0 + MARGIN * longer, SLIM * longer)
        return np.stack([(low + high) / 2.0 - half, (low + high) / 2.0 + half], axis=-1)

    def start(self, axes: Axes) -> str:
        """Prepare dots, links and trails; both axes have one scale, that holds the whole motion."""
        from matplotlib.collections import LineCollection

        view, (across, up) = self.view, self._limits
        first = view[0]
        axes.set(xlim=across, ylim=up, aspect="equal" if first.is_space else "auto")
        is_one = len(view) == 1 or not first.is_space
        labels = (short(first.across, "across"), short(first.up, "up")) if is_one else ("across", "up")
        axes.set_xlabel(words(f"{labels[0]} ({typeset(first.units)})"))
        axes.set_ylabel(words(f"{labels[1]} ({typeset(first.up_units or first.units)})"))
        shown, colours = view[:MOST_BODIES], colours_of(view)
        self.links = self.links[(self.links < len(shown)).all(axis=-1)]
        self._lines = axes.add_collection(LineCollection([], colors="0.5", linewidths=1.5), autolim=False)
        few = len(shown) <= MOST_TRAILS
        trails = LineCollection([], colors=colours[: len(shown)], linewidths=1.2 if few else 0.0, alpha=0.6)
        self._trails = axes.add_collection(trails, autolim=False)
        for fastening in self.fastenings:
            fastening.start(axes, self._limits)
        for boundary in self.boundaries:
            boundary.start(axes, self._limits)
        self._dots = self._bodies(axes, colours[: len(shown)])
        for name, colour in zip(self._names, colours, strict=False):
            axes.plot([], [], "o", color=colour, markersize=6, label=words(name))
        if self._names:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, handletextpad=0.2)
        return left_out(view)

    def _bodies(self, axes: Axes, colours: list[str]) -> Any:
        """Prepare the bodies: discs as large as they are, or dots."""
        from matplotlib.collections import EllipseCollection

        none = np.full((len(colours), 2), np.nan)
        if not self.radii.size:
            area = 64.0 if len(colours) <= MOST_TRAILS else 16.0
            return axes.scatter(none[:, 0], none[:, 1], s=area, c=colours, zorder=3)
        size = 2.0 * self.radii[: len(colours)]
        style: dict[str, Any] = {"facecolors": colours, "edgecolors": "none", "zorder": 3}
        discs = EllipseCollection(
            size, size, np.zeros(len(size)), units="xy", offsets=none, offset_transform=axes.transData, **style
        )
        return axes.add_collection(discs, autolim=False)

    def at(self, now: float) -> list[Any]:
        """Put dots, links and trails where they are."""
        shown = self.view[:MOST_BODIES]
        places = np.array([[np.interp(now, body.times, part) for part in (body.x, body.y)] for body in shown])
        self._dots.set_offsets(places)
        self._lines.set_segments(places[self.links])
        known = np.vstack([places, np.zeros((1, 2))])  # the last is the origin
        others = [part.at(known) for part in self.fastenings] + [part.at(now) for part in self.boundaries if part.moves]
        if len(shown) <= MOST_TRAILS:
            back = 0.1 * float(np.ptp(self.times)) if self.trail is None else self.trail
            self._trails.set_segments([_trail(body, now - back, now) for body in shown])
        return [self._trails, self._lines, *others, self._dots]


def _trail(body: BodyPath, begin: float, end: float) -> Floats:
    """Return where a body was from one time to another, shape (n, 2): all points of its path, or some of very many."""
    first, last = (int(row) for row in np.searchsorted(body.times, (begin, end)))
    every = max(1, (last - first) // MOST_TRAILED)
    times = np.concatenate([[max(begin, float(body.times[0]))], body.times[first:last:every], [end]])
    return np.stack([np.interp(times, body.times, body.x), np.interp(times, body.times, body.y)], axis=-1)


@dataclass
class Profile:
    """A quantity along a dimension, straight in time between recorded states.

    Attributes
    ----------
    name, dim : str
    extent : Extent
        Of the dimension.
    units : str
    times : ndarray, shape (n,)
    values : ndarray, shape (n, elements)
    """

    name: str
    dim: str
    extent: Extent
    units: str
    times: Floats
    values: Floats
    _line: Any = None

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a frame."""
        return PROFILE

    def start(self, axes: Axes) -> str:
        """Draw the range that the quantity has, and its start in grey."""
        low, high = float(np.nanmin(self.values)), float(np.nanmax(self.values))
        margin = MARGIN * (high - low) or 1.0
        elements = np.arange(self.values.shape[1])
        axes.plot(elements, self.values[0], "-", color="0.75", linewidth=1)
        self._line = axes.plot([], [], ".-", color=COLOURS[0], markersize=3, linewidth=1.2)[0]
        axes.set(ylim=(low - margin, high + margin))
        name_elements(axes, self.dim, self.extent)
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
