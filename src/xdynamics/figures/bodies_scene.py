"""Bodies in the plane as a film shows them: dots or discs with their trails, links and walls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.body_names import (
    MOST_BODIES,
    MOST_ENDS,
    SMALL,
    brief_names,
    colours_of,
    names_at_bodies,
    omitted_bodies_note,
)
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.boundaries import Boundary, outside_note, widened_limits
from xdynamics.figures.contrast import LETTERS, legible
from xdynamics.figures.frame_sizes import MARGIN, PROFILE, SLIM, frame_size
from xdynamics.figures.framing import Frame
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import escaped_text, typeset
from xdynamics.figures.plane import axis_text, frame_of_view, leaving_bodies_note
from xdynamics.figures.scenery import Fastening
from xdynamics.runtime.cached_properties import cached_property

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

LARGE = 8.0  # points of a name on a disc
BESIDE = (4.0, 3.0)  # points from the middle of a dot to its name
LOOKED_AT = 9  # times at which walls that move are looked for
MOST_TRAILED = 1000  # points of a trail
MOST_TRAILS = 30  # bodies with a trail; many would hide each other


@dataclass
class BodiesScene:
    """Bodies in the plane.

    Attributes
    ----------
    view : list of BodyPath
    time : DataArray
        Recorded times, in whose unit the title says when a body leaves.
    trail : float, optional
        How far back trails go; a tenth of the run.
    fastenings : list of Fastening
        Rods, springs and threads that the model names.
    boundaries : list of Boundary
        Walls and floors, where gaps are zero.
    radii : ndarray, shape (bodies,)
        Of discs, in the axes' unit; empty where bodies are dots.
    frame : Frame, optional
        Of the motion; found from the view if not given.
    fixed_limits : ndarray, shape (2, 2), optional
        What the axes hold, across and up; the motion and walls nearby if not given.
    is_named : bool
        Whether there is a legend, where bodies have names.
    """

    view: list[BodyPath]
    time: xr.DataArray
    trail: float | None = None
    fastenings: Sequence[Fastening] = ()
    boundaries: Sequence[Boundary] = ()
    radii: Floats = field(default_factory=lambda: np.zeros(0))
    frame: Frame | None = None
    fixed_limits: Floats | None = None
    is_named: bool = True
    _dots: Any = None
    _trails: Any = None
    _tags: list[Any] = field(default_factory=list)

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.view[0].times

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as the motion."""
        if not self.view[0].is_space:
            return PROFILE
        return frame_size(self.limits, self.legend_names)

    @property
    def legend_names(self) -> list[str]:
        """What bodies are called, where there are several, and not too many for a legend."""
        names = [body.label for body in self.view]
        return names if 1 < len(names) <= MOST_NAMED and all(names) else []

    @cached_property
    def _motion_frame(self) -> Frame:
        """The motion of all bodies that are drawn, but for those that fly off."""
        return frame_of_view(self.view) if self.frame is None else self.frame

    @property
    def limits(self) -> Floats:
        """What the axes hold, shape (2, 2)."""
        return self._limits_and_far_walls[0] if self.fixed_limits is None else self.fixed_limits

    @property
    def far_walls(self) -> list[str]:
        """Contacts whose walls are outside the frame."""
        return self._limits_and_far_walls[1]

    @cached_property
    def _limits_and_far_walls(self) -> tuple[Floats, list[str]]:
        """What the axes hold: the motion, no side much shorter than the other, and walls nearby; and which walls they do not."""
        low, high = self._motion_frame.limits.T
        if any((part.ends < 0).any() for part in self.fastenings):  # to the origin
            low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        for anchor in (anchor[:2] for part in self.fastenings for anchor in part.anchors):
            low, high = np.minimum(low, anchor), np.maximum(high, anchor)
        largest_radius = float(self.radii.max(initial=0.0))
        low, high = low - largest_radius, high + largest_radius
        longer = float(max(high - low)) or 1.0 if self.view[0].is_space else np.where(high > low, high - low, 1.0)
        half = np.maximum((high - low) / 2.0 + MARGIN * longer, SLIM * longer)
        limits = np.stack([(low + high) / 2.0 - half, (low + high) / 2.0 + half], axis=-1)
        times = np.linspace(float(self.times[0]), float(self.times[-1]), LOOKED_AT).tolist()
        return widened_limits(limits, self.boundaries, times)

    def start(self, axes: Axes) -> str:
        """Prepare dots, links and trails; both axes have one scale, that holds the whole motion."""
        from matplotlib.collections import LineCollection

        view, (across, up) = self.view, self.limits
        first = view[0]
        axes.set(xlim=across, ylim=up, aspect="equal" if first.is_space else "auto")
        is_one = all((body.across, body.up) == (first.across, first.up) for body in view)
        labels = (axis_text(first.across, "across"), axis_text(first.up, "up")) if is_one else ("across", "up")
        axes.set_xlabel(escaped_text(f"{labels[0]} ({typeset(first.units)})"))
        axes.set_ylabel(escaped_text(f"{labels[1]} ({typeset(first.up_units or first.units)})"))
        drawn_bodies, colours = view[:MOST_BODIES], colours_of(view)
        has_trails = len(drawn_bodies) <= MOST_TRAILS
        trails = LineCollection(
            [], colors=colours[: len(drawn_bodies)], linewidths=1.2 if has_trails else 0.0, alpha=0.6
        )
        self._trails = axes.add_collection(trails, autolim=False)
        for fastening in self.fastenings:
            fastening.start(axes, self.limits)
        for wall in self.boundaries:
            wall.start(axes, self.limits)
        self._dots = self._prepare_bodies(axes, colours[: len(drawn_bodies)])
        for name, colour in zip(self.legend_names, colours, strict=False):
            axes.plot([], [], "o", color=colour, markersize=6, label=escaped_text(name))
        if self.legend_names and self.is_named:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, handletextpad=0.2)
        self._tags = self._prepare_name_tags(axes, colours)
        return f"{self.title_notes}{outside_note(self.far_walls)}"

    @property
    def title_notes(self) -> str:
        """What the title says of the bodies."""
        drawn_bodies = self.view[:MOST_BODIES]
        scale = f", colours from {drawn_bodies[0].label} to {drawn_bodies[-1].body}" if self._is_scaled else ""
        return f"{omitted_bodies_note(self.view)}{leaving_bodies_note(self._motion_frame, self.view, self.time)}{escaped_text(scale)}"

    @property
    def _is_scaled(self) -> bool:
        """Whether there are so many bodies that colours alone tell them apart."""
        return len(self.view) > MOST_ENDS and bool(brief_names(self.view))

    def _prepare_name_tags(self, axes: Axes, colours: list[str]) -> list[Any]:
        """Prepare the names that go along with bodies: on discs, or beside dots."""
        discs, tags = bool(self.radii.size), []
        style: dict[str, Any] = {"textcoords": "offset points", "zorder": 4, "annotation_clip": True}
        style |= {"ha": "center", "va": "center", "fontsize": LARGE} if discs else {"fontsize": SMALL}
        for name, colour in zip(names_at_bodies(self.view), colours, strict=False):
            ink = "white" if discs else legible(colour, LETTERS)
            tags.append(axes.annotate(name, (0.0, 0.0), (0.0, 0.0) if discs else BESIDE, color=ink, **style))
        return tags

    def _prepare_bodies(self, axes: Axes, colours: list[str]) -> Any:
        """Prepare the bodies: discs as large as they are, or dots."""
        from matplotlib.collections import EllipseCollection

        unplaced = np.full((len(colours), 2), np.nan)
        if not self.radii.size:
            area = 64.0 if len(colours) <= MOST_TRAILS else 16.0
            return axes.scatter(unplaced[:, 0], unplaced[:, 1], s=area, c=colours, zorder=3)
        size = 2.0 * self.radii[: len(colours)]
        style: dict[str, Any] = {"facecolors": colours, "edgecolors": "none", "zorder": 3}
        discs = EllipseCollection(
            size, size, np.zeros(len(size)), units="xy", offsets=unplaced, offset_transform=axes.transData, **style
        )
        return axes.add_collection(discs, autolim=False)

    def move_to(self, time: float) -> list[Any]:
        """Put dots, links and trails where they are."""
        drawn_bodies = self.view[:MOST_BODIES]
        places = np.array([[np.interp(time, body.times, part) for part in (body.x, body.y)] for body in drawn_bodies])
        self._dots.set_offsets(places)
        places_and_origin = np.vstack([places, np.zeros((1, 2))])  # the last is the origin
        moved_artists = [part.place_lines(places_and_origin) for part in self.fastenings] + [
            part.move_to(time) for part in self.boundaries if part.moves
        ]
        if len(drawn_bodies) <= MOST_TRAILS:
            trail_duration = 0.1 * float(np.ptp(self.times)) if self.trail is None else self.trail
            self._trails.set_segments([_trail(body, time - trail_duration, time) for body in drawn_bodies])
        for tag, body_place in zip(self._tags, places, strict=False):
            tag.xy = tuple(body_place)
        return [self._trails, *moved_artists, self._dots, *self._tags]


def _trail(body: BodyPath, begin: float, end: float) -> Floats:
    """Return where a body was from one time to another, shape (n, 2): all points of its path, or some of very many."""
    first, last = (int(row) for row in np.searchsorted(body.times, (begin, end)))
    row_spacing = max(1, (last - first) // MOST_TRAILED)
    times = np.concatenate([[max(begin, float(body.times[0]))], body.times[first:last:row_spacing], [end]])
    return np.stack([np.interp(times, body.times, body.x), np.interp(times, body.times, body.y)], axis=-1)
