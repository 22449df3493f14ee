"""The model of an archived run with the settings of that run, so that it is marched again with something changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from xdynamics.faults import InputError
from xdynamics.keywords import IN_FILES, KEYWORDS, STEP, TIME
from xdynamics.march.configuration import settings_for, with_run
from xdynamics.model import Model, check_model
from xdynamics.model.parts import Authorship
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.partial_records import is_run, kind_description
from xdynamics.units import NUMBERS, SECONDS, Quantity, coherent

if TYPE_CHECKING:
    import xarray as xr

ALWAYS = ("method", "until", "step", "rtol", "atol")  # the others are said where they are not what follows from these


def model_of_run(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None = None) -> Model:
    """Return the model of a run, with the settings that it was marched with as its `[run]`.

    Parameters
    ----------
    run : xarray.Dataset
        A run, or a part of one.
    functions : mapping of str to callable, optional
        The Python functions that its forces call.

    Raises
    ------
    InputError
        If it is no run, its model was left out, or its steps were given one by one, which a `[run]` does not say.
    ModelError
        If a function is missing or another one.
    """
    if "model_toml" not in run.variables:
        raise InputError("the record has no model_toml, from which its model is read; take the whole one")
    if not is_run(run.attrs):
        raise InputError(f"this is {kind_description(run.attrs)}; give a run")
    model = Model.from_record(
        run["model_toml"].values.item(), functions=functions, about=Authorship.from_attributes(run.attrs)
    )
    return with_run(model, _run_section(run, with_run(model, {})))


def changed_model(model: Model | xr.Dataset, **numbers: Mapping[str, Any] | None) -> Model:
    """Return a model, or that of a run, with other numbers in some of its sections.

    Raises
    ------
    InputError
        If it is neither.
    ModelError
        If an entry does not exist, or cannot be so.
    """
    if not isinstance(model, Model) and hasattr(model, "data_vars"):
        return changed_model(model_of_run(model), **numbers)
    check_model(model)
    changed = {title: entries for title, entries in numbers.items() if entries}
    return cast("Model", model.replace(**changed) if changed else model)


def _run_section(run: xr.Dataset, bare_model: Model) -> dict[str, Any]:
    """Return the settings of a record as a model file has them, without those that follow from the others."""
    recorded_settings = {
        name: value for name, value in recorded_arguments(run).items() if name in IN_FILES and value is not None
    }
    if isinstance(recorded_settings.get("step"), np.ndarray):
        raise InputError(
            "the steps of this run were given one by one, and a [run] has one step; march its model by"
            " simulate(Model.from_record(run.model_toml.item()), step=run.given_step_size, …)"
        )
    section = {name: _file_value(name, value, bare_model) for name, value in recorded_settings.items()}
    full_settings = settings_for(bare_model, **section)
    for name in [name for name in section if name not in ALWAYS]:
        fewer_settings = {other_name: value for other_name, value in section.items() if other_name != name}
        if settings_for(bare_model, **fewer_settings) == full_settings:
            section = fewer_settings
    return section


def _file_value(name: str, value: Any, model: Model) -> Any:
    """Return a setting as it stands in a file."""
    if KEYWORDS[name].kind in (TIME, STEP):
        return float(value) if model.time_unit == NUMBERS else str(Quantity(float(value), SECONDS))
    if name == "atol" and isinstance(value, Mapping):
        return {key: f"{size.value!r} {coherent(model.units[key]).text}" for key, size in value.items()}
    return [*value] if isinstance(value, tuple) else value
