"""Figures of fits: measurements with the fitted model, and the residuals."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.figures.marks import COLOURS, escaped_text, label_time
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT_TIME
from xdynamics.units import unit_suffix
from xdynamics.units.digits import with_uncertainty

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RESIDUAL, MEASURED, DOUBT, OF_EVENTS = "residual_", "measured_", "measured_uncertainty_", "event_time_"
FEW = 100  # times, between which straight lines are seen


def panels_of(fit: xr.Dataset) -> list[Panel]:
    """Return the panels of each quantity and, beside it, of its residuals."""
    names = [str(name).removeprefix(RESIDUAL) for name in fit.data_vars if str(name).startswith(RESIDUAL)]
    return [
        draw
        for name in names
        for draw in (partial(_draw_fitted_values, fit, name), partial(_draw_residuals, fit, name))
    ]


def foot_of(fit: xr.Dataset) -> str:
    """Report the estimates and the data."""
    records = fit["parameter_record"].values.tolist() if "parameter_record" in fit else [""] * fit.sizes["parameter"]
    rows = zip(
        [
            f"{name} of {record_name}" if record_name else name
            for name, record_name in zip(fit["parameter_name"].values, records, strict=True)
        ],
        fit["estimate"].values,
        fit["standard_uncertainty"].values,
        fit["parameter_units"].values,
        strict=True,
    )
    estimates = ", ".join(
        f"{name} = {with_uncertainty(value, doubt)}{unit_suffix(unit)}" for name, value, doubt, unit in rows
    )
    caveat = "" if int(fit.attrs.get("adequate", 1)) else f"; not adequate: {fit.attrs['adequate_text']}"
    return f"{estimates}, at one standard uncertainty; {fit.attrs['data']}{caveat}"


def _draw_fitted_values(fit: xr.Dataset, name: str, axes: Axes) -> None:
    units = fit[name].attrs["units"]
    for record, rows in _rows_by_record(fit, name):
        abscissa, order = _abscissa(fit, name)[rows], np.argsort(_abscissa(fit, name)[rows], kind="stable")
        measured, computed = fit[f"{MEASURED}{name}"].values[rows], fit[name].values[rows]
        label = f"measured, {fit['record_name'].values[record]}" if "record_name" in fit else "measured"
        axes.plot(abscissa, measured, ".", markersize=4, color=COLOURS[1 + record % (len(COLOURS) - 1)], label=label)
        _draw_bands(fit, name, rows[order], axes, centre=fit[name].values, labels=not record)
        fitted = "fitted model" + ", straight between the times" * (
            abscissa.size < FEW and not name.startswith(OF_EVENTS)
        )
        axes.plot(abscissa[order], computed[order], color=COLOURS[0], linewidth=1.0, label=None if record else fitted)
    _label_across(fit, name, axes)
    axes.set(ylabel=escaped_text(f"{name} ({units})"))
    axes.set_title(escaped_text(name), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _draw_bands(fit: xr.Dataset, name: str, rows: Any, axes: Axes, *, centre: Any, labels: bool) -> None:
    """Draw where the fitted model is, and where one more measurement would be, with the fit's probability."""
    coverage, half = float(fit.attrs.get("coverage", np.nan)), float(fit.attrs.get("half_width", np.nan))
    for word, shade, band_name in (("predicted", 0.12, "one more measurement"), ("fitted", 0.3, "fitted model")):
        if f"{word}_uncertainty_{name}" in fit and np.isfinite(half):
            size = half * fit[f"{word}_uncertainty_{name}"].values[rows]
            middle, abscissa = centre[rows], _abscissa(fit, name)[rows]
            axes.fill_between(
                abscissa,
                middle - size,
                middle + size,
                color=COLOURS[0],
                alpha=shade,
                linewidth=0,
                label=f"{band_name}, {coverage:.0%}" if labels else None,
            )


def _draw_residuals(fit: xr.Dataset, name: str, axes: Axes) -> None:
    for record, rows in _rows_by_record(fit, name):
        abscissa, residuals = _abscissa(fit, name)[rows], fit[f"{RESIDUAL}{name}"].values[rows]
        colour = COLOURS[1 + record % (len(COLOURS) - 1)]
        order = np.argsort(abscissa, kind="stable")
        _draw_bands(fit, name, rows[order], axes, centre=np.zeros(fit[name].size), labels=False)
        if f"{DOUBT}{name}" in fit:
            doubts = fit[f"{DOUBT}{name}"].values[rows]
            axes.errorbar(abscissa, residuals, doubts, fmt=".", color=colour, markersize=3, linewidth=0.5)
        else:
            axes.plot(abscissa, residuals, ".", color=colour, markersize=3)
    axes.axhline(0.0, color=COLOURS[0], linewidth=1.0)
    _label_across(fit, name, axes)
    axes.set(ylabel=escaped_text(f"measured minus fitted ({fit[name].attrs['units']})"))
    axes.set_title(escaped_text(f"residuals of {name}"), loc="left", fontsize=10)


def _rows_by_record(fit: xr.Dataset, name: str) -> Iterator[tuple[int, Any]]:
    """Yield each record that has a quantity, and its rows."""
    is_finite = np.isfinite(fit[name].values)
    record_of_row = fit["at_record"].values if "at_record" in fit else np.zeros(is_finite.size, int)
    for record in np.unique(record_of_row[is_finite]).tolist():
        yield record, np.flatnonzero(is_finite & (record_of_row == record))


def _abscissa(fit: xr.Dataset, name: str) -> Any:
    """Return what a quantity is drawn over: the time; of event times, which occurrence it is."""
    return fit["at_occurrence"].values if name.startswith(OF_EVENTS) else fit[AT_TIME].values


def _label_across(fit: xr.Dataset, name: str, axes: Axes) -> None:
    if name.startswith(OF_EVENTS):
        axes.set_xlabel("occurrence")
    else:
        label_time(axes, fit[AT_TIME])


PAGE = Page(("fit",), panels_of, foot_of, most_panels=8)
