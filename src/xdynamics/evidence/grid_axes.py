"""What the attributes of a sweep say of its axes, and which numbers are kept along them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from xdynamics.shapes.naming import spoken, written

if TYPE_CHECKING:
    import xarray as xr

AXES, ASKED = "sweep_axes", "sweep_settings"
VARIES, WHAT, AXIS = "varies", "varies_what", "axis_of"  # attributes of axis values: kind, name, axis


def axes_said(sweep: xr.Dataset) -> list[str]:
    """Name the axes of a sweep, in order."""
    return [spoken(written(dim)) for dim in str(sweep.attrs[AXES]).split()]


def numbers(sweep: xr.Dataset) -> list[str]:
    """Name the numbers kept of members, without their rules and uncertainties."""
    axes = {*axes_said(sweep)}
    return [
        str(name)
        for name, variable in sweep.data_vars.items()
        if variable.dtype.kind in "fi"
        and axes & {*map(str, variable.dims)}
        and not str(name).startswith("run_")
        and AXIS not in variable.attrs
        and variable.attrs.get("role") not in ("flag", "error")
    ]
