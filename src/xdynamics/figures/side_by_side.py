"""What is drawn beside a run: other runs, and measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.archive import open_run
from xdynamics.archive.place import GIVEN, placed
from xdynamics.evidence.comparing.measured import is_measured, measured
from xdynamics.faults import InputError
from xdynamics.figures.curves import drawn
from xdynamics.figures.excerpt import drawn_of
from xdynamics.model.drives import SKIP
from xdynamics.record.flag_words import time_unit
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import STEPS
from xdynamics.units import parse_unit

Floats = NDArray[np.float64]
Columns = Mapping[str, tuple[Floats, Floats, Floats | None]]


def beside_of(run: xr.Dataset, source: Any, wanted: Sequence[str] | None = None) -> tuple[str, Columns]:
    """Return the label and the columns of another run or of measured data, in the units of the run.

    Raises
    ------
    InputError
        If it has no variable in common with the run, or one of another kind of unit.
    """
    if isinstance(source, GIVEN) and placed(source).suffix.lower() == ".nc":
        source = open_run(source)
    label, series = _measured(run, source) if is_measured(source) else _of_run(drawn_of(source, wanted))
    columns = {}
    for name, (times, values, doubts, units) in series.items():
        if name not in run or run[name].dims != (STEPS,):
            continue
        own, theirs = (parse_unit(text) for text in (str(run[name].attrs["units"]), units))
        if own.dimension != theirs.dimension:
            raise InputError(f"'{name}' of {label} is in '{units}', the run has it in '{own.text}'")
        factor = float(theirs.factor / own.factor)
        columns[name] = (times, values * factor, None if doubts is None else doubts * factor)
    if not columns:
        raise InputError(f"{label} has nothing that the run has; there are {', '.join(series) or 'none'}")
    return label, columns


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
