"""Numbers of a sweep that are what rounding leaves of zero, such as the height at a landing: noise, and no map."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.evidence.grid_axes import numbers
from xdynamics.units import TIME, UNKNOWN_UNIT, Dimension, parse_unit

if TYPE_CHECKING:
    import xarray as xr

END_TIME = "end_time"
PARAMETER = "parameter"  # a role
MOST_RATES = 2  # of an acceleration the way, in the span
ROUNDINGS = 16.0  # spacings of the sizes passed on the way, which landing on zero leaves


def vanishing(sweep: xr.Dataset) -> list[str]:
    """Name the numbers that are zero to rounding in all members, and not exactly zero in one at least.

    They are some spacings of what else has their dimension at most, be it recorded, an axis or a parameter, or of the way
    that a rate of theirs, or a rate of that, leads until the end.
    """
    sizes = {name: _size(sweep, name) for name in numbers(sweep) if _has_unit(sweep.variables[name])}
    span = sizes[END_TIME][0] if END_TIME in sizes else 0.0
    given = {
        name: _size(sweep, name) for name in map(str, sweep.variables) if name not in sizes and _is_given(sweep, name)
    }
    ways = [
        (size * span**n, of * TIME**n) for size, of in (*sizes.values(), *given.values()) for n in range(MOST_RATES + 1)
    ]
    return [
        name
        for name, (size, dimension) in sizes.items()
        if sweep[name].dtype.kind == "f"
        and 0.0 < size <= ROUNDINGS * EPS * max(way for way, of in ways if of == dimension)
    ]


def _is_given(sweep: xr.Dataset, name: str) -> bool:
    """Whether a variable is an axis of numbers or a parameter."""
    variable = sweep.variables[name]
    is_axis = variable.dims == (name,)
    return variable.dtype.kind == "f" and _has_unit(variable) and (is_axis or variable.attrs.get("role") == PARAMETER)


def _has_unit(variable: xr.Variable) -> bool:
    """Whether a variable has a unit, which values that were edited have no more."""
    return bool(variable.attrs.get("units", UNKNOWN_UNIT) != UNKNOWN_UNIT)


def _size(sweep: xr.Dataset, name: str) -> tuple[float, Dimension]:
    """Return the largest size of a number, SI, and its dimension."""
    unit = parse_unit(str(sweep[name].attrs["units"]))
    values = np.asarray(sweep[name].values, float)
    most = max(
        np.nanmax(values, initial=0.0, where=np.isfinite(values)),
        -np.nanmin(values, initial=0.0, where=np.isfinite(values)),
    )
    return float(most) * float(unit.factor), unit.dimension
