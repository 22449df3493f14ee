"""Figures of fits: what was measured with what the fitted model comes to, and what is left."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import COLOURS, timed, words
from xdynamics.figures.sheet import Panel
from xdynamics.schema import AT_TIME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESIDUAL, MEASURED, DOUBT = "residual_", "measured_", "measured_uncertainty_"
MOST_PANELS = 8


def panels_of(found: xr.Dataset) -> list[Panel]:
    """Return what draws each quantity, and beside it its residuals."""
    names = [str(name).removeprefix(RESIDUAL) for name in found.data_vars if str(name).startswith(RESIDUAL)]
    return [draw for name in names for draw in (partial(_values, found, name), partial(_residuals, found, name))]


def foot_of(found: xr.Dataset) -> str:
    """Say what was found."""
    parts = zip(found["parameter_name"].values, found["estimate"].values, found["standard_uncertainty"].values, found["parameter_units"].values, strict=True)  # fmt: skip
    said = ", ".join(f"{name} = {value:.6g} ± {doubt:.2g}{'' if unit == '1' else f' {unit}'}" for name, value, doubt, unit in parts)  # fmt: skip
    against = "" if int(found.attrs.get("adequate", 1)) else f"; not adequate: {found.attrs['adequate_text']}"
    return f"{said}, at one standard uncertainty; {found.attrs['data']}{against}"


def _values(found: xr.Dataset, name: str, axes: Axes) -> None:
    time, units = found[AT_TIME].values, found[name].attrs["units"]
    order = np.argsort(time, kind="stable")
    axes.plot(time, found[f"{MEASURED}{name}"].values, ".", color=COLOURS[1], markersize=3, label="measured")
    axes.plot(time[order], found[name].values[order], color=COLOURS[0], linewidth=1.0, label="fitted model")
    axes.set(xlabel=timed(found[AT_TIME]), ylabel=words(f"{name} ({units})"))
    axes.set_title(words(name), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _residuals(found: xr.Dataset, name: str, axes: Axes) -> None:
    time, left = found[AT_TIME].values, found[f"{RESIDUAL}{name}"].values
    if f"{DOUBT}{name}" in found:
        axes.errorbar(
            time, left, found[f"{DOUBT}{name}"].values, fmt=".", color=COLOURS[1], markersize=3, linewidth=0.5
        )
    else:
        axes.plot(time, left, ".", color=COLOURS[1], markersize=3)
    axes.axhline(0.0, color=COLOURS[0], linewidth=1.0)
    axes.set(xlabel=timed(found[AT_TIME]), ylabel=words(f"measured minus fitted ({found[name].attrs['units']})"))
    axes.set_title(words(f"residuals of {name}"), loc="left", fontsize=10)
