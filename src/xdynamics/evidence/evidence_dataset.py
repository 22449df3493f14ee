"""A piece of evidence as one Dataset: its kind, the runs it is made from, and every number with its unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive
from xdynamics.record.circumstances import circumstances
from xdynamics.record.folding import fold
from xdynamics.record.schemas import along_document
from xdynamics.schema import (
    AT_TIME,
    CONVENTIONS,
    DOCUMENT,
    EVIDENCE,
    MODEL_DIMENSIONS,
    RUNS,
    SCHEMA_VERSION,
    STEP_NUMBER,
    SWEEP,
    TEXT_NAMES,
)
from xdynamics.shapes import NO_SHAPES, Shapes
from xdynamics.shapes.naming import display_text
from xdynamics.units.digits import known_part

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.model import Model


def evidence_dataset(
    kind: str,
    title: str,
    runs: Sequence[str],
    variables: Mapping[str, Any],
    attributes: Mapping[str, Any],
    unchanged: Mapping[str, Any] | None = None,
    *,
    shapes: Shapes = NO_SHAPES,
) -> xr.Dataset:
    """Assemble a Dataset of evidence, ready to be saved.

    Parameters
    ----------
    kind : str
        What it is, in one word: ``refinement``, ``comparison`` …
    title : str
    runs : sequence of str
        Content digests of the runs that it is made from.
    variables : mapping of str to (dims, values, attributes)
        Each with `units`, `long_name` and `role`.
    attributes : mapping
        Further attributes of the Dataset.
    unchanged : mapping, optional
        For lazy variables, tests whether values are their result; see `archive.marched`.
    shapes : Shapes, optional
        Of the model: what is said of elements is put together, and told as people write them.
    """
    import xarray as xr

    # one time alone belongs to no dimension: a file would not name it as a coordinate of anything
    coordinates = [name for name in (AT_TIME, "time", STEP_NUMBER.name) if name in variables and variables[name][0]]
    dataset_variables = {name: xr.Variable(*variable) for name, variable in variables.items()}
    for name in TEXT_NAMES:
        if name in dataset_variables and not dataset_variables[name].dims:
            names_and_dims = (
                (variable_name, *variable.dims)
                for variable_name, variable in dataset_variables.items()
                if variable_name not in TEXT_NAMES
            )
            # dimensions of a sweep are its axes alone; of a model of schema 1 something else may be called so
            if kind != SWEEP and not any(DOCUMENT in names for names in names_and_dims):
                dataset_variables[name] = along_document(dataset_variables[name])
            coordinates.append(name)
    dataset = xr.Dataset(_with_display_texts(dataset_variables) if shapes.dims else dataset_variables).set_coords(
        coordinates
    )
    header = {
        "Conventions": CONVENTIONS,
        "title": display_text(title),
        "source": f"{kind} by xdynamics",
        "schema_version": SCHEMA_VERSION,
        EVIDENCE: kind,
        RUNS: " ".join(runs),
    }
    if shapes.dims:
        dataset, attributes = fold(dataset, shapes), _with_display_attributes(attributes)
        for variable in dataset.variables.values():
            variable.attrs["long_name"] = display_text(variable.attrs["long_name"])
        header |= {key: entry for key, entry in dataset.attrs.items() if key == MODEL_DIMENSIONS}
    dataset.attrs = header | dict(attributes) | circumstances(f"{kind} made")
    return archive.marched(dataset, unchanged)


def _with_display_texts(variables: dict[str, xr.Variable]) -> dict[str, xr.Variable]:
    """Return variables whose texts name elements as people write them."""
    texts = {
        name: variable.copy(
            data=np.array([display_text(text) for text in variable.values.ravel().tolist()]).reshape(variable.shape)
        )
        for name, variable in variables.items()
        if variable.dtype.kind == "U" and variable.chunks is None and name != "model_toml"
    }
    return variables | texts


def _with_display_attributes(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: display_text(entry) if isinstance(entry, str) else entry for key, entry in attributes.items()}


def attrs_of(units: str, long_name: str, role: str) -> dict[str, Any]:
    """Return the attributes of a variable."""
    return {"units": units, "long_name": long_name, "role": role}


def stated_value(evidence: xr.Dataset, name: str) -> Any:
    """Return what is stated as an attribute, or as a variable where it was known after marching only; None if it is not."""
    value = evidence.attrs.get(name)
    if value is None and name in evidence.variables:
        value = evidence[name].values[()]
    return None if value is None or str(value) in ("", "nan") else value


def relative_uncertainty(run: xr.Dataset, model: Model) -> float:
    """Return the part of a number that the tolerances and uncertain inputs of a run leave open."""
    inputs = [(parameter.quantity.value, parameter.uncertainty) for parameter in model.uncertain.values()]
    return known_part(float(run.attrs["solver_rtol"]) if "solver_rtol" in run.attrs else None, inputs)
