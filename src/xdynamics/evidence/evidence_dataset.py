"""A result of evidence as one Dataset: its kind, the runs behind it, gates, and every number with its unit.

A gate is a question that a record or a number has to pass, stored with its answer and the reason.

Residuals are divided by a scale common to all times, never by the expected value at one time, which may pass zero.

Events of one name in two runs are paired by their times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.record.folding import fold
from xdynamics.record.provenance import circumstances
from xdynamics.record.schemas import along_document
from xdynamics.record.unfolding import event_words
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
        For lazy variables, tests whether values are their result; see `archive.integrity.marched`.
    shapes : Shapes, optional
        Of the model: what is said of elements is put together, and told as people write them.
    """
    import xarray as xr

    # one time alone belongs to no dimension: a file would not name it as a coordinate of anything
    coordinates = [
        name for name in (schema.AT_TIME, "time", schema.STEP_NUMBER.name) if name in variables and variables[name][0]
    ]
    dataset_variables = {
        name: xr.Variable(dims, _as_array(values), attributes, fastpath=True)
        for name, (dims, values, attributes) in variables.items()
    }
    for name in schema.TEXT_NAMES:
        if name in dataset_variables and not dataset_variables[name].dims:
            names_and_dims = (
                (variable_name, *variable.dims)
                for variable_name, variable in dataset_variables.items()
                if variable_name not in schema.TEXT_NAMES
            )
            # dimensions of a sweep are its axes alone; of a model of schema 1 something else may be called so
            if kind != schema.SWEEP and not any(schema.DOCUMENT in names for names in names_and_dims):
                dataset_variables[name] = along_document(dataset_variables[name])
            coordinates.append(name)
    dataset = xr.Dataset(_with_display_texts(dataset_variables) if shapes.dims else dataset_variables).set_coords(
        coordinates
    )
    header = {
        "Conventions": schema.CONVENTIONS,
        "title": display_text(title),
        "source": f"{kind} by xdynamics",
        "schema_version": schema.SCHEMA_VERSION,
        schema.EVIDENCE: kind,
        schema.RUNS: " ".join(runs),
    }
    if shapes.dims:
        dataset, attributes = fold(dataset, shapes), _with_display_attributes(attributes)
        for variable in dataset.variables.values():
            variable.attrs["long_name"] = display_text(variable.attrs["long_name"])
        header |= {key: entry for key, entry in dataset.attrs.items() if key == schema.MODEL_DIMENSIONS}
    dataset.attrs = header | dict(attributes) | circumstances(f"{kind} made")
    return archive.marched(dataset, unchanged)


def _as_array(values: Any) -> Any:
    """Return numbers or texts as an array: of anything else xarray asks whether it is one of dask's, which it imports."""
    return np.asarray(values) if isinstance(values, np.generic | float | int | str | list) else values


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
    """Return an attribute, or the variable of that name if its value came after marching; None without either."""
    value = evidence.attrs.get(name)
    if value is None and name in evidence.variables:
        value = evidence[name].values[()]
    return None if value is None or str(value) in ("", "nan") else value


def relative_uncertainty(run: xr.Dataset, model: Model) -> float:
    """Return the part of a number that the tolerances and uncertain inputs of a run leave open."""
    inputs = [(parameter.quantity.value, parameter.uncertainty) for parameter in model.uncertain.values()]
    return known_part(float(run.attrs["solver_rtol"]) if "solver_rtol" in run.attrs else None, inputs)


GATE = "gate"
PASSED, FAILED, NOT_CHECKED = GATES = ("passed", "failed", "not_checked")


class Gate(NamedTuple):
    """A question, its verdict, one of `GATES`, and the reason."""

    name: str
    verdict: str
    reason: str


def gate_variables(gates: Sequence[tuple[str, str, str]], question: str) -> dict[str, Any]:
    """Return gates as variables of a Dataset; `question` states the question of all gates."""
    names, verdicts, reasons = zip(*gates, strict=True)
    return {
        "gate_name": ((GATE,), np.array(names), attrs_of("1", question, "name")),
        "gate_reason": ((GATE,), np.array(reasons), attrs_of("1", "what was looked at", "rule")),
        "gate_verdict": (
            (GATE,),
            np.array([GATES.index(verdict) for verdict in verdicts], np.int8),
            attrs_of("1", "what became of it", "flag") | schema.flag_attributes(dict(enumerate(GATES))),
        ),
    }


ROLE = "scaled"


def scale_of(expected: Any, computed: Any) -> Any:
    """Return the largest absolute expected value along the first axis; where that is 0, the largest computed one.

    Examples
    --------
    >>> float(scale_of(np.array([0.0, -2.0]), np.array([0.1, -2.2]))), float(scale_of(np.zeros(2), np.array([0.0, 1e-3])))
    (2.0, 0.001)
    """
    largest = np.abs(expected).max(axis=0)
    return np.where(largest > 0.0, largest, np.abs(computed).max(axis=0))


def divide_by_scale(residual: Any, scale: Any) -> Any:
    """Return residuals over their scale; 0 where both are 0."""
    return residual / np.where(scale > 0.0, scale, 1.0)


def root_mean_square(numbers: Any) -> Any:
    """Return the root mean square along the first axis; each element has the bits that it has alone."""
    contiguous_squares = np.ascontiguousarray(np.moveaxis(np.asarray(numbers) ** 2, 0, -1))  # where NumPy sums pairwise
    return np.sqrt(np.mean(contiguous_squares, axis=-1))


def scaled_variables(
    kind: str,
    name: str,
    residual: Any,
    scale: Any,
    dims: Sequence[str],
    units: str,
    scale_text: str,
    norms: Sequence[str] = (),
) -> dict[str, Any]:
    """Return a residual over its scale, and the scale, ready for a Dataset.

    Parameters
    ----------
    kind : str
        Name of the residual: `residual`, `difference`.
    name : str
        Name of the quantity.
    residual : array
    scale : number, or array
        What `scale_of` returned.
    dims : sequence of str
        Of the residual; the scale and the norms have all but the first.
    units : str
        Of the scale.
    scale_text : str
        What the scale is, in words.
    norms : sequence of str
        Norms of the residual to add without a dimension: `rms`, `largest`.
    """
    key = f"{kind}_{name}"
    rule = {"scale_rule": f"{scale_text}; never its value at one time, which may pass zero"}
    variables = {
        schema.scaled_name(key): (
            tuple(dims),
            divide_by_scale(residual, scale),
            attrs_of("1", f"{key} over {schema.scale_name(kind, name)}", ROLE) | rule,
        ),
        schema.scale_name(kind, name): (
            tuple(dims)[1:],
            scale,
            attrs_of(units, f"scale of {key}: {scale_text}", "scale") | rule,
        ),
    }
    sizes: dict[str, Callable[[Any], Any]] = {
        "rms": root_mean_square,
        "largest": lambda off: np.max(np.abs(off), axis=0),
    }
    return variables | {
        schema.scaled_name(f"{norm}_{key}"): (
            tuple(dims)[1:],
            divide_by_scale(sizes[norm](residual), scale),
            attrs_of("1", f"{norm}_{key} over {schema.scale_name(kind, name)}", ROLE) | rule,
        )
        for norm in norms
    }


Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

LOOKED_AT = 1000  # events that decide the offset: the cost must not grow with the square of their number


def event_rows_by_name(run: xr.Dataset) -> dict[str, Rows]:
    """Return the rows of the events of each name, in order; empty for a record without events or their columns."""
    if not {"event_detector", "event_time", "event_time_uncertainty"} <= set(run.variables):
        return {}
    names = np.array(event_words(run))
    return {str(name): np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}


def match_times(first: Floats, second: Floats) -> tuple[Rows, Rows]:
    """Pair the times of two ascending sequences one by one; the longer is shifted so that both are closest.

    Returns
    -------
    tuple of ndarray of int
        Indices into the first and into the second sequence, ascending; times without a partner are left out.

    Examples
    --------
    >>> [places.tolist() for places in match_times(np.array([1.0, 2.0, 3.0]), np.array([2.1, 3.1]))]
    [[1, 2], [0, 1]]
    >>> [places.tolist() for places in match_times(np.array([1.0, 2.0, 2.5]), np.array([1.2, 2.4]))]
    [[0, 1], [0, 1]]
    """
    if len(first) < len(second):
        theirs, mine = match_times(second, first)
        return mine, theirs
    n, head = len(second), second[:LOOKED_AT]
    distances = [
        float(np.mean(np.abs(first[k : k + len(head)] - head))) if n else 0.0 for k in range(len(first) - n + 1)
    ]
    offset = int(np.argmin(distances))
    return np.arange(offset, offset + n), np.arange(n)
