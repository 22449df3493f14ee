"""The unit that people read long times in: hours, days, years; what is recorded stays in seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xdynamics.units import SECONDS

if TYPE_CHECKING:
    import xarray as xr

# units of time in which many seconds are written, the longest first: Julian years, days, hours
LONG_UNITS = (("years", 31_557_600.0), ("days", 86_400.0), (HOURS := "hours", 3600.0))
FEWEST_WHOLE = 5.0  # of a unit that a run lasts for it to be written so


def long_unit(time: xr.DataArray) -> tuple[str, float]:
    """Return the unit that times are written in, and how long it lasts in the unit recorded.

    Examples
    --------
    >>> import xarray as xr
    >>> time = xr.DataArray([0.0, 3e9], dims="step", attrs={"units": "s"})
    >>> long_unit(time)
    ('years', 31557600.0)
    """
    units = str(time.attrs.get("units", SECONDS.text))
    latest = float(np.nanmax(np.abs(time.values))) if time.size else 0.0
    if units == SECONDS.text:
        for name, size in LONG_UNITS:
            if latest >= FEWEST_WHOLE * size:
                return name, size
    return units, 1.0
