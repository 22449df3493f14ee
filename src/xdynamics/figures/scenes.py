"""What a film shows as its time goes on: bodies, or a quantity along a dimension or two.

Films of a quantity along a dimension, or over two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.figures.bodies_scene import BodiesScene, mechanism_of, two_views_of
from xdynamics.figures.boundaries import boundaries_of, disc_radii, fastenings_of
from xdynamics.figures.element_maps import ElementField, colour_bar, colours, draw_cells, fields_of, name_elements
from xdynamics.figures.framing import MARGIN, PROFILE, frame_size
from xdynamics.figures.marks import draw_line, label_panel
from xdynamics.figures.plane import line_views, views

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

BAR = 1.0  # inches, of a scale of colours beside a map


@dataclass
class Profile:
    """A quantity along a dimension, or over two as a map, straight in time between recorded states.

    Attributes
    ----------
    field : ElementField
    times : ndarray, shape (n,)
    values : ndarray, shape (n, elements) or (n, across, up)
    """

    field: ElementField
    times: Floats
    values: Floats
    _artist: Any = None

    @property
    def is_map(self) -> bool:
        """Whether it has two dimensions."""
        return self.values.ndim > 2

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a frame: of a map with square cells, and a scale of colours beside them."""
        if not self.is_map:
            return PROFILE
        width, height = frame_size(np.array([[0.0, float(size)] for size in self.values.shape[1:]]), [])
        return width + BAR, height

    def start(self, axes: Axes) -> str:
        """Draw the range that the quantity has and its start in grey, or a map of the start with the colours of all times."""
        field, label = self.field, (self.field.name, self.field.units)
        if self.is_map:
            self._artist = draw_cells(self.values[0], field.extents, axes, **colours(self.values))
            colour_bar(self._artist, label, axes)
            return f", {field.name} over {field.dims[0]} and {field.dims[1]}"
        low, high = float(np.nanmin(self.values)), float(np.nanmax(self.values))
        margin = MARGIN * (high - low) or 1.0
        draw_line(axes, np.arange(self.values.shape[1]), self.values[0], "-", "0.75")
        self._artist = draw_line(axes, [], [], ".-", width=1.2, size=3)
        axes.set_ylim(low - margin, high + margin)
        name_elements(axes, field.extents[0])
        label_panel(axes, y=(field.name, field.units))
        return " (grey: at the start)"

    def move_to(self, time: float) -> list[Any]:
        """Draw the quantity at a time."""
        values = _values_at_time(self.times, self.values, time)
        if self.is_map:
            self._artist.set_array(values.T)
        else:
            self._artist.set_data(np.arange(len(values)), values)
        return [self._artist]


def _values_at_time(times: Floats, values: Floats, time: float) -> Floats:
    """Return values at a time, straight between rows; behind an event those after it."""
    row = int(np.clip(np.searchsorted(times, time, side="right"), 1, max(1, len(times) - 1)))
    begin, end = float(times[row - 1]), float(times[min(row, len(times) - 1)])
    part = (time - begin) / (end - begin) if end > begin else 1.0
    between: Floats = values[row - 1] + part * (values[min(row, len(times) - 1)] - values[row - 1])
    return between


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

    def move_to(self, time: float) -> list[Any]:
        """Move to a time, and return what moved."""


def scene_of(run: xr.Dataset, trail: float | None) -> Scene | None:
    """Return the scene of a run's plane, of bodies that turn, or of a quantity along one dimension or two; None without any."""
    body_views = views(run)
    in_space = (
        bool(body_views and body_views[0])
        and body_views[0][0].is_space
        and bool(model_of_record(run, None).elements.pictured.plane)
    )
    if not in_space and (mechanism := mechanism_of(run, trail)) is not None:
        return mechanism
    if (two_views := two_views_of(run, body_views, trail)) is not None:
        return two_views
    if (body_views := body_views or line_views(run)) and body_views[0]:
        view = body_views[0]
        radii = disc_radii(run, view)
        return BodiesScene(view, run["time"], trail, fastenings_of(run, view), boundaries_of(run, view, radii), radii)
    if body_views:
        return None
    for field in (*fields_of(run, 1), *fields_of(run, 2)):
        return Profile(field, run.variables["time"].values, field.values_at(run))
    return None
