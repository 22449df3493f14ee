"""Figures of several pieces of evidence of one kind: a line each, in the panels that all have."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.faults import InputError
from xdynamics.figures import diagnosis, refinement
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, time_axis_label
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.flag_words import in_prose, words_of_flag
from xdynamics.schema import CYCLE, EVIDENCE, LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Several = Mapping[str, xr.Dataset]

MARKERS = "os^Dv<>P"


def panels_of(records: Several) -> list[Panel]:
    """Return a panel for each number that all have: its differences in refinements, its values per cycle in diagnoses.

    Raises
    ------
    InputError
        If they are not all refinements of one thing, or all diagnoses, or share no number.
    """
    kinds = {str(record.attrs.get(EVIDENCE, "run")) for record in records.values()}
    varied = {str(record.attrs.get("varied", "")) for record in records.values()}
    if kinds not in ({"refinement"}, {"diagnosis"}) or len(varied) > 1:
        raise InputError(
            "several records are drawn together if all are refinements of one thing or all diagnoses; these are"
            f" {', '.join(sorted(kinds))}"
        )
    first = next(iter(records.values()))
    if kinds == {"diagnosis"}:
        names = [
            name
            for name in diagnosis.SHOWN
            if all(name in record and record[name].notnull().any() for record in records.values())
        ]
        panels: list[Panel] = [partial(_draw_cycles_of_records, records, name) for name in names]
    else:
        names = [
            str(name) for name in first.data_vars if all(f"difference_{name}" in record for record in records.values())
        ]
        names = [
            name for name in names if any(refinement.is_informative(record, name) for record in records.values())
        ] or names
        panels = [partial(_draw_study_differences, records, name) for name in names]
    if not panels:
        raise InputError("there is nothing to draw together: no number is in all of the records")
    return panels


def foot_of(records: Several) -> str:
    """Describe what is drawn."""
    if all("varied" in record.attrs for record in records.values()):
        return "difference of each level to the next finer one, at the first place; in brackets the last observed order"
    if not all("energy_band" in record for record in records.values()):
        return ""
    energies = [
        f"{name} {float(record['energy_band']):.3g} {record['energy_band'].attrs['units']}"
        for name, record in records.items()
    ]
    return f"energy bands: {', '.join(energies)}"


def _draw_study_differences(records: Several, name: str, axes: Axes) -> None:
    units = varied = ""
    for k, (label, study) in enumerate(records.items()):
        varied = str(study.attrs["varied"])
        place_dim = next((dim for dim in study[name].dims if dim != LEVEL), None)
        selection = {place_dim: 0} if place_dim else {}
        difference = study[f"difference_{name}"].isel(selection)
        change, units = np.abs(difference.values), str(difference.attrs["units"])
        is_nonzero = change > 0.0
        if f"order_{name}" in study and study.sizes[LEVEL] > 2:
            order = float(study[f"order_{name}"].isel(selection)[-2])
            verdict = in_prose(words_of_flag(study[f"verdict_{name}"].isel(selection))[0])
            label = f"{label} ({order:.2f}, {verdict})" if np.isfinite(order) else f"{label} ({verdict})"  # noqa: PLW2901
        axes.plot(
            study[varied].values[is_nonzero],
            change[is_nonzero],
            f"{MARKERS[k % len(MARKERS)]}-",
            color=COLOURS[k % len(COLOURS)],
            markersize=4,
            linewidth=1.0,
            label=escaped_text(label),
        )
        axes.set(xlabel=escaped_text(time_axis_label(study[varied], varied)))
    axes.set_yscale("log")
    refinement.log_steps(axes, np.unique(np.concatenate([record[varied].values for record in records.values()])))
    axes.set(ylabel=escaped_text(f"|difference| ({units})"))
    axes.set_title(escaped_text(name), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.8, edgecolor="none")


def _draw_cycles_of_records(records: Several, name: str, axes: Axes) -> None:
    units = ""
    for k, (label, record) in enumerate(records.items()):
        units = str(record[name].attrs["units"])
        axes.plot(
            record["cycle_time"].values,
            record[name].values,
            f"{MARKERS[k % len(MARKERS)]}-",
            color=COLOURS[k % len(COLOURS)],
            markersize=3.5,
            linewidth=1.0,
            label=escaped_text(label),
        )
    low, high = axes.get_ylim()
    size = max(abs(low), abs(high))
    if high - low < diagnosis.STEADY * size:  # keeps values that are nearly equal from being drawn far apart
        axes.set_ylim(low - diagnosis.STEADY * size, high + diagnosis.STEADY * size)
        axes.ticklabel_format(axis="y", useOffset=False)
    first = next(iter(records.values()))
    label_time(axes, first["cycle_time"], f"time at the end of the {CYCLE}")
    axes.set(ylabel=escaped_text(f"{name} ({units})"))
    axes.set_title(escaped_text(name.replace("_", " ")), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


PAGE = Page((), panels_of, foot_of, most_panels=refinement.PAGE.most_panels)
