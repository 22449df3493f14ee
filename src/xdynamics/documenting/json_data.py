"""Records, evidence and models as JSON: one form for all of them, which `xdynamics help json` describes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from xdynamics.documenting.plain_text import COUNTED, check_can_be_linearised, equation_lines
from xdynamics.documenting.summary import summary_data
from xdynamics.evidence.modes import modes
from xdynamics.faults import InputError
from xdynamics.methods import METHODS
from xdynamics.model import Model
from xdynamics.record.folding import is_repeated_label
from xdynamics.record.schemas import is_whole
from xdynamics.schema import AT, DIGESTS, EVIDENCE, ORIGIN, STEPS

# kinds beside those of evidence
MODEL, RUN, PART, MODES = "model", "run", "part", "modes"
STATES, REPRODUCTION = "states", "reproduction"


def json_text(data: Any) -> str:
    """Write plain data as one line of JSON, each float with all its digits.

    JSON has no numbers that are not finite: nan is written ``null``, an infinity as the text ``"inf"`` or ``"-inf"``.

    Examples
    --------
    >>> json_text({"order": float("nan"), "limit": float("inf"), "h": 0.1})
    '{"order": null, "limit": "inf", "h": 0.1}'
    """
    return json.dumps(_json_value(data), allow_nan=False)


def plain_data_of(subject: xr.Dataset | Model | Mapping[str, Any]) -> dict[str, Any]:
    """Return the result of a verb as plain data.

    Parameters
    ----------
    subject : xarray.Dataset, Model or mapping
        Of a run outcome, end, events and parameters; of evidence every attribute and variable, a flag by its words; of a
        model its equations, start, time scales and methods; plain data as they are.
    """
    if isinstance(subject, Model):
        return _model_data(subject)
    return _record_data(subject) if isinstance(subject, xr.Dataset) else dict(subject)


def _record_data(record: xr.Dataset) -> dict[str, Any]:
    """Return the summary of a run, or all that evidence or a part of a run holds."""
    attributes = record.attrs
    if STEPS in record.dims and is_whole(attributes):
        parameters = {str(n): v for n, v in record.variables.items() if v.attrs.get("role") == "parameter"}
        parameter_data = {name: _variable_data(variable) for name, variable in parameters.items()}
        return {"kind": RUN} | summary_data(record) | {"parameters": parameter_data}
    kind = REPRODUCTION if "identical" in attributes else STATES if AT in record.dims else PART
    return _full_record_data(record, str(attributes.get(EVIDENCE, kind)))


def _full_record_data(record: xr.Dataset, kind: str) -> dict[str, Any]:
    """Return every attribute and variable of a Dataset."""
    attributes = record.attrs
    return {
        "kind": kind,
        "title": str(attributes.get("title", kind)),
        "sizes": {str(dim): size for dim, size in record.sizes.items()},
        "attributes": {
            str(key): value for key, value in attributes.items() if key not in ("title", EVIDENCE, ORIGIN, DIGESTS)
        },
        "variables": {
            name: _variable_data(variable)
            for name, variable in ((str(key), column) for key, column in record.variables.items())
            if not is_repeated_label(name, record)
        },
    }


def _model_data(model: Model) -> dict[str, Any]:
    """Return the result of `check` for a model."""
    elements = model.elements
    try:
        check_can_be_linearised(model)
        scales: dict[str, Any] = _full_record_data(modes(model), MODES)
    except InputError as error:
        scales = {"kind": MODES, "unknown": str(error)}
    return {
        "kind": MODEL,
        "title": model.name,
        "digest": model.digest,
        "counts": {kind: len(getattr(elements.statement, kind)) for kind in COUNTED},
        "equations": [" ".join(line.split()) for line in equation_lines(model)],
        "parameters": {
            name: {"value": part.quantity.value, "units": part.quantity.unit.text, "uncertainty": part.uncertainty}
            for name, part in elements.statement.parameters.items()
        },
        "initial": {
            name: {"value": part.value, "units": part.unit.text} for name, part in elements.statement.initial.items()
        },
        "methods": {
            name: {"order": method.order, "chooses_steps": bool(method.estimate), "refuses": method.refusals(model)}
            for name, method in METHODS.items()
        },
        "scales": scales,
    }


def _variable_data(variable: Any) -> dict[str, Any]:
    """Return a variable with its dimensions, unit, description and values."""
    attributes = variable.attrs
    values = np.asarray(variable.values)
    described = {"dims": [*map(str, variable.dims)], "units": str(attributes.get("units", "1"))}
    described |= {"long_name": str(attributes["long_name"])} if "long_name" in attributes else {}
    described |= {"uncertainty": attributes["uncertainty"]} if "uncertainty" in attributes else {}
    if "flag_meanings" not in attributes:
        return described | {"values": values.tolist()}
    words = dict(
        zip(np.atleast_1d(attributes["flag_values"]).tolist(), str(attributes["flag_meanings"]).split(), strict=True)
    )
    meanings = [words.get(value, value) for value in values.ravel().tolist()]
    return described | {"values": np.array(meanings, object).reshape(values.shape).tolist()}


def _json_value(data: Any) -> Any:
    """Return data of Python's own types alone, with numbers that are not finite in the form that JSON has for them."""
    if isinstance(data, Mapping):
        return {str(key): _json_value(value) for key, value in data.items()}
    if isinstance(data, np.ndarray):
        return _json_value(data.tolist())
    if isinstance(data, list | tuple):
        return [_json_value(value) for value in data]
    if isinstance(data, np.generic):
        return _json_value(data.item())
    if isinstance(data, float) and not math.isfinite(data):
        # RFC 8259, section 6: JSON has neither nan nor infinities
        return None if math.isnan(data) else "inf" if data > 0 else "-inf"
    return data
