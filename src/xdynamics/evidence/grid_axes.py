"""What a sweep says of its axes, and which numbers are kept along them; of sweeps put together, too."""

from __future__ import annotations

import json
from math import prod
from typing import TYPE_CHECKING, Any

from xdynamics.archive.text_encoding import with_texts
from xdynamics.faults import InputError
from xdynamics.schema import EVIDENCE, SWEEP
from xdynamics.shapes.naming import display_text, internal_text

if TYPE_CHECKING:
    import xarray as xr

AXES, ASKED = "sweep_axes", "sweep_settings"
VARIES, WHAT, AXIS = "varies", "varies_what", "axis_of"  # attributes of axis values: kind, name, axis
MEMBERS, OWN_DIGEST = "sweep_members", "sweep_digest"
NO_NUMBERS = ("flag", "error", "parameter")  # roles of variables along axes that are no numbers of members


def is_sweep(data: Any) -> bool:
    """Whether something is a sweep."""
    attributes = getattr(data, "attrs", {})
    return hasattr(data, "variables") and attributes.get(EVIDENCE) == SWEEP and AXES in attributes


def sweep_of(data: Any) -> xr.Dataset:
    """Return a sweep as this package reads it, whoever opened or put it together.

    Texts that plain xarray leaves as numbers are texts. Where sweeps were put together along a setting that each of them
    has one value of, ``xr.concat([one, other], "solver_rtol")``, that is an axis like any other.

    Raises
    ------
    InputError
        If it is not a Dataset of a sweep.
    """
    if not is_sweep(data) or "model_toml" not in data:
        raise InputError(f"{type(data).__name__} is no sweep; give what sweep or open_sweep returned")
    sweep: xr.Dataset = with_texts(data)
    joined_axes = {
        name: str(variable.dims[0])
        for name, variable in sweep.variables.items()
        if VARIES in variable.attrs and AXIS not in variable.attrs and len(variable.dims) == 1
    }
    if not joined_axes:
        return sweep
    sweep = sweep.copy()
    for name, dim in joined_axes.items():
        sweep[name].attrs[AXIS] = dim
    varied = {str(sweep[name].attrs[WHAT]) for name in joined_axes}
    every = dict.fromkeys([*sweep_axis_names(sweep), *joined_axes.values()])
    dims = [*(dim for dim in every if dim not in sweep.dims), *(str(dim) for dim in sweep.dims if dim in every)]
    shared_settings = {name: value for name, value in json.loads(str(sweep.attrs[ASKED])).items() if name not in varied}
    of_one = {OWN_DIGEST, *(f"solver_{name}{end}" for name in varied for end in ("", "_units"))}
    kept_attributes = {key: value for key, value in sweep.attrs.items() if key not in of_one}
    members = prod(sweep.sizes.get(dim, 1) for dim in dims)
    axis_attributes = {AXES: " ".join(dims), ASKED: json.dumps(shared_settings, sort_keys=True), MEMBERS: members}
    sweep.attrs = kept_attributes | axis_attributes
    return sweep


def sweep_axis_names(sweep: xr.Dataset) -> list[str]:
    """Name the axes of a sweep, in order."""
    return [display_text(internal_text(dim)) for dim in str(sweep.attrs[AXES]).split()]


def member_number_names(sweep: xr.Dataset) -> list[str]:
    """Name the numbers kept of members, without their rules and uncertainties."""
    axes = {*sweep_axis_names(sweep)}
    return [
        str(name)
        for name, variable in sweep.data_vars.items()
        if variable.dtype.kind in "fi"
        and axes & {*map(str, variable.dims)}
        and not str(name).startswith("run_")
        and AXIS not in variable.attrs
        and variable.attrs.get("role") not in NO_NUMBERS
    ]
