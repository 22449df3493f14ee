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
from xdynamics.figures.element_maps import (
    colour_bar,
    colours,
    model_shapes,
    name_axis,
    name_elements,
    profiled_quantities,
    recorded_fields,
)
from xdynamics.figures.framing import MARGIN, PROFILE, frame_size
from xdynamics.figures.marks import COLOURS, escaped_text, label_with_unit, typeset
from xdynamics.figures.plane import line_views, views
from xdynamics.shapes import Extent, Shapes

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

BAR = 1.0  # inches, of a scale of colours beside a map


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
        axes.set_ylabel(escaped_text(f"{self.name} ({self.units})"))
        return " (grey: at the start)"

    def move_to(self, time: float) -> list[Any]:
        """Draw the quantity at a time."""
        values = _values_at_time(self.times, self.values, time)
        self._line.set_data(np.arange(len(values)), values)
        return [self._line]


@dataclass
class Plate:
    """A quantity over two dimensions as a map, straight in time between recorded states.

    Attributes
    ----------
    name : str
    dims : pair of str
    shapes : Shapes
    units : str
    times : ndarray, shape (n,)
    values : ndarray, shape (n, across, up)
    """

    name: str
    dims: tuple[str, str]
    shapes: Shapes
    units: str
    times: Floats
    values: Floats
    _mesh: Any = None

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of a frame: square cells, and a scale of colours beside them."""
        width, height = frame_size(np.array([[0.0, float(size)] for size in self.values.shape[1:]]), [])
        return width + BAR, height

    def start(self, axes: Axes) -> str:
        """Draw the start with the scale of colours of the whole run."""
        edges = [np.arange(size + 1) - 0.5 for size in self.values.shape[1:]]
        self._mesh = axes.pcolormesh(*edges, self.values[0].T, **colours(self.values))
        axes.set_aspect("equal")
        axes.grid(visible=False)
        for axis, dim in zip((axes.xaxis, axes.yaxis), self.dims, strict=True):
            name_axis(axis, self.shapes.extent(dim), dim, is_named=True)
        colour_bar(self._mesh, label_with_unit(escaped_text(self.name), typeset(self.units)), axes)
        return f", {escaped_text(self.name)} over {self.dims[0]} and {self.dims[1]}"

    def move_to(self, time: float) -> list[Any]:
        """Draw the quantity at a time."""
        self._mesh.set_array(_values_at_time(self.times, self.values, time).T)
        return [self._mesh]


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
        and bool(model_of_record(run, None).pictured.plane)
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
    times = run.variables["time"].values
    for name, dim, elements in profiled_quantities(run, model_shapes(run)):
        return Profile(
            name,
            dim,
            model_shapes(run).extent(dim),
            _unit_of_elements(run, elements),
            times,
            _element_values(run, elements),
        )
    for name, dims, elements in recorded_fields(run):
        maps = _element_values(run, elements).reshape(len(times), *model_shapes(run).shape(dims))
        return Plate(name, dims, model_shapes(run), _unit_of_elements(run, elements), times, maps)
    return None


def _unit_of_elements(run: xr.Dataset, elements: list[str]) -> str:
    return str(run.variables[elements[0]].attrs["units"])


def _element_values(run: xr.Dataset, elements: list[str]) -> Floats:
    return np.stack([run.variables[element].values for element in elements], axis=-1)
