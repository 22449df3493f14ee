"""The unit that people read long times in: hours, days, years; what is recorded stays in seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xdynamics.schema import SHOWN_IN
from xdynamics.units import SECONDS, parse_unit

if TYPE_CHECKING:
    import xarray as xr

# units of time in which many seconds are written, the longest first: Julian years, days, hours
LONG_UNITS = (("years", 31_557_600.0), ("days", 86_400.0), (HOURS := "hours", 3600.0))
FEWEST_WHOLE = 5.0  # of a unit that a run lasts for it to be written so


def long_unit(time: xr.DataArray) -> tuple[str, float]:
    """Return the unit that times are written in, and how long it lasts in the unit recorded: what the model says, or long ones.

    Examples
    --------
    >>> import xarray as xr
    >>> time = xr.DataArray([0.0, 3e9], dims="step", attrs={"units": "s"})
    >>> long_unit(time)
    ('years', 31557600.0)
    """
    units = str(time.attrs.get("units", SECONDS.text))
    if shown := time.attrs.get(SHOWN_IN):
        return str(shown), float(parse_unit(str(shown)).factor)
    latest = float(np.nanmax(np.abs(time.values))) if time.size else 0.0
    if units == SECONDS.text:
        for name, size in LONG_UNITS:
            if latest >= FEWEST_WHOLE * size:
                return name, size
    return units, 1.0


def in_long_unit(time: xr.DataArray, value: float) -> str:
    """Return one of the times in the unit that people read, in brackets; nothing where it is the one recorded."""
    name, size = long_unit(time)
    return "" if size == 1.0 else f" ({value / size:.6g} {name})"
