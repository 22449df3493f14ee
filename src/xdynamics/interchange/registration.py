"""`run.dynamics` for every Dataset, from the moment that both xarray and this package are imported."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.interchange.accessor import Dynamics


def register() -> None:
    """Register the accessor with xarray; its implementation is imported on first use."""
    import xarray as xr

    if not hasattr(xr.Dataset, "dynamics"):
        register_as: Any = xr.register_dataset_accessor  # it has no types
        register_as("dynamics")(dynamics)


def dynamics(run: xr.Dataset) -> Dynamics:
    """Return the usual questions to a run."""
    from xdynamics.interchange.accessor import Dynamics

    return Dynamics(run)
