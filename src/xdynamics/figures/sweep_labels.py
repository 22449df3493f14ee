"""What is written on figures of sweeps: numbers with their units, and the settings of a part."""

from __future__ import annotations

import xarray as xr

from xdynamics.evidence.grid_axes import AXIS
from xdynamics.figures.marks import escaped_text, label_with_unit, typeset
from xdynamics.units import unit_suffix
from xdynamics.units.digits import short_number


def number_label(sweep: xr.Dataset, name: str) -> str:
    """Name a number with its unit."""
    units = str(sweep[name].attrs["units"])
    return escaped_text(label_with_unit(name, units))


def value_suffix(sweep: xr.Dataset, name: str) -> str:
    """Return what stands behind a value: its unit, typeset."""
    return unit_suffix(typeset(str(sweep[name].attrs["units"])))


def other_settings_note(part: xr.Dataset, shown_axes: list[str]) -> str:
    """Name the values of the other axes for a part of a sweep."""
    settings: list[str] = []
    for name, coordinate in part.coords.items():
        if AXIS in coordinate.attrs and not coordinate.dims and str(name) not in shown_axes:
            value, units = coordinate.values, str(coordinate.attrs["units"])
            text = short_number(float(value)) if coordinate.dtype.kind in "fi" else str(value)
            settings.append(
                text if coordinate.dtype.kind not in "fi" else f"{name} = {text}{'' if units == '1' else f' {units}'}"
            )
    return f", {', '.join(settings)}" if settings else ""
