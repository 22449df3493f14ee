"""What a film shows as its time goes on: bodies, or a quantity along a dimension or two."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.figures.bodies_scene import BodiesScene
from xdynamics.figures.boundaries import boundaries_of, disc_radii
from xdynamics.figures.element_scenes import Plate, Profile
from xdynamics.figures.fields import recorded_fields
from xdynamics.figures.lattice import model_shapes, profiled_quantities
from xdynamics.figures.mechanism import mechanism_of
from xdynamics.figures.plane import line_views, views
from xdynamics.figures.scenery import fastenings_of
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
