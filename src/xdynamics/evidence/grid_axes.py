"""The axes of a sweep: which numbers run along them, and how far rounding alone separates these numbers.

Axes are read from a sweep, or from several sweeps put together.

The rounding floor of a number, such as the height at a landing, is the size below which its differences are noise.
"""

from __future__ import annotations

import json
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.text_encoding import with_texts
from xdynamics.elementary.bounds import EPS
from xdynamics.faults import InputError
from xdynamics.schema import EVIDENCE, SWEEP
from xdynamics.shapes.naming import display_text, internal_text
from xdynamics.units import TIME, UNKNOWN_UNIT, Dimension, parse_unit

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
    """Return a sweep in this package's own form, whether opened here, by xarray, or concatenated.

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
    """Name the recorded numbers of members, without their rules and uncertainties."""
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


END_TIME = "end_time"
PARAMETER = "parameter"  # a role
MOST_RATES = 2  # of an acceleration the way, in the span
ROUNDINGS = 16.0  # spacings of the sizes passed on the way, which landing on zero leaves


def vanishing(sweep: xr.Dataset) -> list[str]:
    """Name the numbers that are zero to rounding in all members, and not exactly zero in one at least."""
    floors = rounding_floors(sweep)
    return [
        name
        for name, floor in floors.items()
        if sweep[name].dtype.kind == "f" and 0.0 < float(_largest_size(sweep.variables[name])) <= float(floor)
    ]


def rounding_floors(sweep: xr.Dataset) -> dict[str, xr.Variable]:
    """Return the size that rounding alone may give each number, in its unit; lazy where the sweep is.

    That is some spacings of what else has its dimension at most, be it recorded, an axis or a parameter, or of the way that
    a rate of it, or a rate of that, leads until the end.
    """
    names = [name for name in member_number_names(sweep) if _has_known_unit(sweep.variables[name])]
    input_names = [name for name in map(str, sweep.variables) if name not in names and _is_given(sweep, name)]
    sizes = {name: _size_and_dimension(sweep, name) for name in (*names, *input_names)}
    span = sizes[END_TIME][0] if END_TIME in sizes else 0.0
    scales_by_dimension: dict[Dimension, xr.Variable] = {}
    for size, dimension in sizes.values():
        for n in range(MOST_RATES + 1):
            scale_dimension, scale = dimension * TIME**n, size * span**n
            scales_by_dimension[scale_dimension] = (
                _larger(scales_by_dimension[scale_dimension], scale)
                if scale_dimension in scales_by_dimension
                else scale
            )
    return {
        name: ROUNDINGS
        * EPS
        * scales_by_dimension[sizes[name][1]]
        / float(parse_unit(str(sweep[name].attrs["units"])).factor)
        for name in names
    }


def _larger(left: xr.Variable, right: xr.Variable) -> xr.Variable:
    larger: xr.Variable = left + (right - left) * (right > left)
    return larger


def _is_given(sweep: xr.Dataset, name: str) -> bool:
    """Whether a variable is an axis of numbers or a parameter."""
    variable = sweep.variables[name]
    is_axis = variable.dims == (name,)
    return (
        variable.dtype.kind == "f"
        and _has_known_unit(variable)
        and (is_axis or variable.attrs.get("role") == PARAMETER)
    )


def _has_known_unit(variable: xr.Variable) -> bool:
    """Whether a variable has a unit, which values that were edited have no more."""
    return bool(variable.attrs.get("units", UNKNOWN_UNIT) != UNKNOWN_UNIT)


def _largest_size(variable: xr.Variable) -> xr.Variable:
    """Return the largest size of the finite values of a variable."""
    sizes: Any = abs(variable.astype(float))
    largest: xr.Variable = sizes.where(sizes < np.inf, 0.0).max()
    return largest


def _size_and_dimension(sweep: xr.Dataset, name: str) -> tuple[xr.Variable, Dimension]:
    """Return the largest size of a number, SI, and its dimension."""
    unit = parse_unit(str(sweep[name].attrs["units"]))
    return _largest_size(sweep.variables[name]) * float(unit.factor), unit.dimension
