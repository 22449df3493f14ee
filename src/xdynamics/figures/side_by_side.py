"""What is drawn beside a run: other runs, and measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.archive import open_run
from xdynamics.archive.place import GIVEN, placed
from xdynamics.evidence.comparing.measured import is_measured, measured
from xdynamics.faults import InputError
from xdynamics.figures.companions import Beside, BesideRun, labels_of
from xdynamics.figures.curves import drawn
from xdynamics.figures.excerpt import drawn_of
from xdynamics.model.drives import SKIP
from xdynamics.record.flag_words import time_unit
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import STEPS
from xdynamics.units import parse_unit

Floats = NDArray[np.float64]


def beside_of(
    run: xr.Dataset, sources: Sequence[Any], wanted: Sequence[str] | None = None, names: Sequence[str] = ()
) -> Beside:
    """Return other runs and measured data in the units of a run, named by what differs.

    Parameters
    ----------
    run : xarray.Dataset
    sources : sequence of Dataset, path or table
    wanted : sequence of str, optional
        What is drawn.
    names : sequence of str
        Of the run and of each source, if they were given.

    Raises
    ------
    InputError
        If one has no variable in common with the run, or one of another kind of unit.
    """
    companions = [_companion(run, source, wanted) for source in sources]
    if not companions:
        return Beside()
    records = [run, *(each.record for each in companions if each.record is not None)]
    labels = iter(labels_of(records) if len(records) > 1 else ["computed"])
    own = names[0] if names else next(labels)
    if names:
        return Beside(own, tuple(replace(each, label=name) for each, name in zip(companions, names[1:], strict=True)))
    return Beside(own, tuple(each if each.record is None else replace(each, label=next(labels)) for each in companions))


def _companion(run: xr.Dataset, source: Any, wanted: Sequence[str] | None) -> BesideRun:
    if isinstance(source, GIVEN) and placed(source).suffix.lower() == ".nc":
        source = open_run(source)
    record = None if is_measured(source) else drawn_of(source, wanted)
    label, series = _measured(run, source) if record is None else _of_run(record)
    columns, factors = {}, {}
    for name, (times, values, doubts, units) in series.items():
        if name not in run or run.variables[name].dims != (STEPS,):
            continue
        own, theirs = (parse_unit(text) for text in (str(run.variables[name].attrs["units"]), units))
        if own.dimension != theirs.dimension:
            raise InputError(f"'{name}' of {label} is in '{units}', the run has it in '{own.text}'")
        factors[name] = factor = float(theirs.factor / own.factor)
        columns[name] = (times, values * factor, None if doubts is None else doubts * factor)
    if not columns:
        raise InputError(f"{label} has nothing that the run has; there are {', '.join(series) or 'none'}")
    return BesideRun(label, columns, record, factors)


def _measured(run: xr.Dataset, source: Any) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    data = measured(source, [str(variable) for variable in run.data_vars], SKIP, time_unit(run))
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, (values, unit) in data.values.items():
        doubt, own = data.uncertainties.get(name, (np.zeros(values.shape), unit))
        series[name] = data.times, values, doubt * float(own.factor / unit.factor), unit.text
    return f"measured, {data.name}".replace("'", ""), series


def _of_run(other: xr.Dataset) -> tuple[str, dict[str, tuple[Floats, Floats, Floats | None, str]]]:
    series: dict[str, tuple[Floats, Floats, Floats | None, str]] = {}
    for name, variable in other.data_vars.items():
        if variable.dims == (STEPS,) and variable.dtype.kind == "f" and not is_chunked(variable.variable):
            times, (values,) = drawn(other, str(name), exact=name == "total_energy")
            series[str(name)] = times, values, None, str(variable.attrs.get("units", "1"))
    return str(other.attrs.get("title", "other run")), series
