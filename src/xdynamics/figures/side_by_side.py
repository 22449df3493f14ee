"""What is drawn beside a run: other runs, and measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.archive import open_run
from xdynamics.archive.place import GIVEN, location_of
from xdynamics.evidence.comparing.measured import is_measured, read_measured_data
from xdynamics.faults import InputError
from xdynamics.figures.companions import Overlay, RunCompanion, run_labels
from xdynamics.figures.curves import plotted_lines
from xdynamics.figures.excerpt import excerpt_of
from xdynamics.model.drives import SKIP
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import STEPS
from xdynamics.units import parse_unit

Floats = NDArray[np.float64]


def overlay_of(
    run: xr.Dataset, sources: Sequence[Any], requested_names: Sequence[str] | None = None, names: Sequence[str] = ()
) -> Overlay:
    """Return other runs and measured data in the units of a run, named by what differs.

    Parameters
    ----------
    run : xarray.Dataset
    sources : sequence of Dataset, path or table
    requested_names : sequence of str, optional
        What is drawn.
    names : sequence of str
        Of the run and of each source, if they were given.

    Raises
    ------
    InputError
        If one has no variable in common with the run, or one of another kind of unit.
    """
    companions = [_companion_of(run, source, requested_names) for source in sources]
    if not companions:
        return Overlay()
    records = [run, *(companion.record for companion in companions if companion.record is not None)]
    labels = iter(run_labels(records) if len(records) > 1 else ["computed"])
    run_label = names[0] if names else next(labels)
    if names:
        return Overlay(
            run_label,
            tuple(replace(companion, label=name) for companion, name in zip(companions, names[1:], strict=True)),
        )
    return Overlay(
        run_label,
        tuple(
            companion if companion.record is None else replace(companion, label=next(labels))
            for companion in companions
        ),
    )


def _companion_of(run: xr.Dataset, source: Any, requested_names: Sequence[str] | None) -> RunCompanion:
    if isinstance(source, GIVEN) and location_of(source).suffix.lower() == ".nc":
        source = open_run(source)
    record = None if is_measured(source) else excerpt_of(source, requested_names)
    label, series = _measured_series(run, source) if record is None else _run_series(record)
    columns, factors = {}, {}
    for name, (times, values, doubts, units) in series.items():
        if name not in run or run.variables[name].dims != (STEPS,):
            continue
        run_unit, companion_unit = (parse_unit(text) for text in (str(run.variables[name].attrs["units"]), units))
        if run_unit.dimension != companion_unit.dimension:
            raise InputError(f"'{name}' of {label} is in '{units}', the run has it in '{run_unit.text}'")
        factors[name] = factor = float(companion_unit.factor / run_unit.factor)
        columns[name] = (times, values * factor, None if doubts is None else doubts * factor)
    if not columns:
        raise InputError(f"{label} has nothing that the run has; there are {', '.join(series) or 'none'}")
    return RunCompanion(label, columns, record, factors)


def _measured_series(run: xr.Dataset, source: Any) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    data = read_measured_data(source, [str(variable) for variable in run.data_vars], SKIP, time_unit_of(run))
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, (values, unit) in data.values.items():
        doubt, doubt_unit = data.uncertainties.get(name, (np.zeros(values.shape), unit))
        series[name] = data.times, values, doubt * float(doubt_unit.factor / unit.factor), unit.text
    return f"measured, {data.name}".replace("'", ""), series


def _run_series(companion_run: xr.Dataset) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, variable in companion_run.data_vars.items():
        if variable.dims == (STEPS,) and variable.dtype.kind == "f" and not is_chunked(variable.variable):
            times, (values,) = plotted_lines(companion_run, str(name), exact=name == "total_energy")
            series[str(name)] = times, values, None, str(variable.attrs.get("units", "1"))
    return str(companion_run.attrs.get("title", "other run")), series
