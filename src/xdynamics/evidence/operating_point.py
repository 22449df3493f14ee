"""The state about which a model is linearised: its initial one, or a row of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from xdynamics import record
from xdynamics.evidence.stages import is_lazy
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.model.linearisation import initial_state
from xdynamics.model.motion import variables
from xdynamics.record.partial_records import log_description
from xdynamics.schema import STEPS
from xdynamics.units import parse_unit


def operating_point(subject: Any, row: int | None) -> tuple[Model, dict[str, float]]:
    """Return the requested model and state.

    Raises
    ------
    InputError
        If it is neither a model nor a run record, or has no such row.
    """
    if isinstance(subject, Model):
        if row is not None:
            raise InputError(f"row is {row!r}, but a model has no rows; give a run record, or the state with at=…")
        return subject, initial_state(subject)
    if not isinstance(subject, xr.Dataset):
        raise InputError(f"modes needs a Model or a run record, got {str(subject)[:60]!r}")
    record.check(subject, values=not is_lazy(subject))
    model, row_index = model_and_row(subject, row)
    return model, {name: _recorded_number(subject, name, row_index) for name in ("t", *variables(model))}


def model_and_row(run: xr.Dataset, row: int | None) -> tuple[Model, int]:
    """Return the model of a record, and which row is asked for, without reading a row.

    Raises
    ------
    InputError
        If the Dataset is not a run record, or has no such row.
    """
    record.check_kind(run)
    rows = run.sizes[STEPS]
    row_index = 0 if row is None else row
    if not isinstance(row_index, int | np.integer) or not -rows <= row_index < rows:
        raise InputError(
            f"row {row_index!r} is not among the run's {rows}; needs 0 to {rows - 1}, or {-rows} to -1 from the end"
        )
    return Model.from_record(run["model_toml"].values.item()), int(row_index)


def _recorded_number(run: xr.Dataset, name: str, row: int) -> float:
    """Return one number of a record in SI units."""
    name = "time" if name == "t" else name
    if name not in run.variables:
        raise InputError(
            f"run record has no variable '{name}', which its model needs;"
            f" {log_description(run.attrs) or 'give the whole record'}"
        )
    variable = run.variables[name]
    return parse_unit(str(variable.attrs["units"])).to_si(float(variable[row].values))


def replacements(model: Model, replaced_values: Mapping[str, Any] | None) -> dict[str, float]:
    """Return the values that replace some of the state's, in SI units.

    Raises
    ------
    InputError
        If one has a wrong name or unit.
    """
    replaced = model.replace(initial=replaced_values) if replaced_values else model
    return {
        name: replaced.statement.initial[name].si for name in map(model.shapes.internal_name, replaced_values or ())
    }
