"""Figures of fits: measurements with the fitted model, and the residuals."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import COLOURS, timed, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT_TIME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESIDUAL, MEASURED, DOUBT = "residual_", "measured_", "measured_uncertainty_"


def panels_of(fit: xr.Dataset) -> list[Panel]:
    """Return the panels of each quantity and, beside it, of its residuals."""
    names = [str(name).removeprefix(RESIDUAL) for name in fit.data_vars if str(name).startswith(RESIDUAL)]
    return [draw for name in names for draw in (partial(_values, fit, name), partial(_residuals, fit, name))]


def foot_of(fit: xr.Dataset) -> str:
    """Report the estimates and the data."""
    rows = zip(
        fit["parameter_name"].values,
        fit["estimate"].values,
        fit["standard_uncertainty"].values,
        fit["parameter_units"].values,
        strict=True,
    )
    estimates = ", ".join(
        f"{name} = {value:.6g} ± {doubt:.2g}{'' if unit == '1' else f' {unit}'}" for name, value, doubt, unit in rows
    )
    caveat = "" if int(fit.attrs.get("adequate", 1)) else f"; not adequate: {fit.attrs['adequate_text']}"
    return f"{estimates}, at one standard uncertainty; {fit.attrs['data']}{caveat}"


def _values(fit: xr.Dataset, name: str, axes: Axes) -> None:
    time, units = fit[AT_TIME].values, fit[name].attrs["units"]
    order = np.argsort(time, kind="stable")
    axes.plot(time, fit[f"{MEASURED}{name}"].values, ".", color=COLOURS[1], markersize=3, label="measured")
    axes.plot(time[order], fit[name].values[order], color=COLOURS[0], linewidth=1.0, label="fitted model")
    axes.set(xlabel=timed(fit[AT_TIME]), ylabel=words(f"{name} ({units})"))
    axes.set_title(words(name), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _residuals(fit: xr.Dataset, name: str, axes: Axes) -> None:
    time, residuals = fit[AT_TIME].values, fit[f"{RESIDUAL}{name}"].values
    if f"{DOUBT}{name}" in fit:
        axes.errorbar(
            time, residuals, fit[f"{DOUBT}{name}"].values, fmt=".", color=COLOURS[1], markersize=3, linewidth=0.5
        )
    else:
        axes.plot(time, residuals, ".", color=COLOURS[1], markersize=3)
    axes.axhline(0.0, color=COLOURS[0], linewidth=1.0)
    axes.set(xlabel=timed(fit[AT_TIME]), ylabel=words(f"measured minus fitted ({fit[name].attrs['units']})"))
    axes.set_title(words(f"residuals of {name}"), loc="left", fontsize=10)


PAGE = Page(("fit",), panels_of, foot_of, most_panels=8)
