"""What rounding leaves of the numbers of a sweep: such as the height at a landing, noise about zero and no number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.evidence.grid_axes import member_number_names
from xdynamics.units import TIME, UNKNOWN_UNIT, Dimension, parse_unit

if TYPE_CHECKING:
    import xarray as xr

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
    """Return what rounding alone can leave of each number where it should be zero, in its unit; lazy where the sweep is.

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
