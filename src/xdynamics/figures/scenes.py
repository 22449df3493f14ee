"""What a film shows as its time goes on: bodies, or a quantity along a dimension or two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of
from xdynamics.figures.bodies_scene import Bodies
from xdynamics.figures.boundaries import boundaries, radii_of
from xdynamics.figures.element_scenes import Plate, Profile
from xdynamics.figures.fields import whole_fields
from xdynamics.figures.lattice import profiled, shapes_of
from xdynamics.figures.mechanism import mechanism_of
from xdynamics.figures.plane import along_a_line, views
from xdynamics.figures.scenery import fastenings
from xdynamics.figures.two_views import two_views_of

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]


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
    """Return the scene of a run's plane, of bodies that turn, or of a quantity along one dimension or two; None without any."""
    shown = views(run)
    in_space = bool(shown and shown[0]) and shown[0][0].is_space and bool(model_of(run, None).pictured.plane)
    if not in_space and (mechanism := mechanism_of(run, trail)) is not None:
        return mechanism
    if (both := two_views_of(run, shown, trail)) is not None:
        return both
    if (shown := shown or along_a_line(run)) and shown[0]:
        view = shown[0]
        radii = radii_of(run, view)
        return Bodies(view, run["time"], trail, fastenings(run, view), boundaries(run, view, radii), radii)
    if shown:
        return None
    times = run.variables["time"].values
    for name, dim, elements in profiled(run, shapes_of(run)):
        return Profile(name, dim, shapes_of(run).extent(dim), _unit(run, elements), times, _values(run, elements))
    for name, dims, elements in whole_fields(run):
        maps = _values(run, elements).reshape(len(times), *shapes_of(run).shape(dims))
        return Plate(name, dims, shapes_of(run), _unit(run, elements), times, maps)
    return None


def _unit(run: xr.Dataset, elements: list[str]) -> str:
    return str(run.variables[elements[0]].attrs["units"])


def _values(run: xr.Dataset, elements: list[str]) -> Floats:
    return np.stack([run.variables[element].values for element in elements], axis=-1)
