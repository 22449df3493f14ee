"""A sweep as a Dataset: axes with units, recorded variables, and all that marching its members again needs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.elementary import NAME, kept_set
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.grid_axes import (
    ASKED,
    AXES,
    AXIS,
    MEMBERS,
    OWN_DIGEST,
    VARIES,
    WHAT,
    sweep_axis_names,
    sweep_of,
)
from xdynamics.faults import InputError
from xdynamics.march.settings import EARLIEST_FIRST, ENDS, FILIPPOV, JUDGED, ROOT_METHODS, WAITING
from xdynamics.march.tolerances import ATOL_FLOORS, OF_TERMS
from xdynamics.model import Model
from xdynamics.model.sliding import may_slide_along_switches
from xdynamics.record.arguments import atol_floor_of, root_method_of
from xdynamics.record.folding import names_as_words
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import display_text, internal_text
from xdynamics.sweeping.axes import (
    INITIAL,
    MODEL_SECTIONS,
    PARAMETER,
    RTOL,
    SETTINGS,
    STEP,
    TABLE,
    Axis,
    AxisColumn,
    column_of,
)
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.sweeping.kept_quantities import Keeping, keeping_of
from xdynamics.sweeping.members import Plan
from xdynamics.units import parse_unit, unit_suffix
from xdynamics.units.unit import read_decimal

if TYPE_CHECKING:
    import xarray as xr

KEEP, OCCURRENCES, DIGEST = "sweep_keep", "sweep_occurrences", OWN_DIGEST
REPORTED_SETTINGS = "method", "step", "rtol", "until"  # settings that are reported
NUMBER = "occurrence_number"
COMMENT = "comment"
ONE_BY_ONE = (
    "members are marched one after the other, not side by side in vector code: the model has contacts or frictions of"
    " many elements"
)
DIGITS = "varies_by"  # the values as they were written, where that is with more digits than floats have
_KIND_DESCRIPTIONS = {
    "parameter": "parameter {0}",
    "initial": "initial value of {0}",
    "start": "time at which runs begin",
    "step": "step of the grid, or the first one",
    "rtol": "relative tolerance",
    "table": "table of drive {0}",
    "setting": "setting {0} of the march",
}


def sweep_dataset(plan: Plan, arrays: Mapping[str, Any], unchanged: Mapping[str, Any] | None = None) -> xr.Dataset:
    """Return the Dataset of a sweep from arrays of its members along the axes.

    Raises
    ------
    InputError
        If a kept variable has the name of an axis, or two of them have the same name.
    """
    grid = plan.grid
    coordinates = _coordinates(grid)
    member_variables = {
        variable.name: ((*grid.dims, *variable.dims), arrays[variable.name], variable.attributes)
        for variable in plan.variables
        if variable.name in arrays
    }
    names = [variable.name for variable in plan.variables]
    if repeated := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(
            f"'{repeated[0]}' is a number of every sweep, and an observable that is kept; rename the observable"
        )
    if clashes := sorted({*member_variables} & {*coordinates, *grid.dims}):
        name = clashes[0]
        raise InputError(f"'{name}' is an axis and kept too; call the axis 'initial_{name}'")
    varying = {name for _, variable in grid.columns if variable.kind in MODEL_SECTIONS for name in variable.names}
    times = plan.keeping.times
    used_names = {*coordinates, *grid.dims, *([schema.AT_TIME] if times.size else [])}
    shared = {
        schema.name_without_clash(used_names, name): (
            (),
            parameter.quantity.value,
            attrs_of(parameter.quantity.unit.text, parameter.description or f"parameter {name}", "parameter"),
        )
        for name, parameter in grid.model.elements.statement.parameters.items()
        if name not in varying and name not in member_variables
    }
    toml = {"model_toml": ((), grid.model.to_toml(), attrs_of("1", "the model that members share, as TOML", "model"))}
    axes = ", ".join(grid.dims)
    sweep = evidence_dataset(
        schema.SWEEP,
        f"{grid.model.name}: a sweep over {axes}",
        [],
        coordinates | member_variables | _numbers_along(plan) | shared | toml,
        _sweep_attributes(plan),
        unchanged,
        shapes=grid.model.shapes,
    )
    return sweep.set_coords([*coordinates])


def _numbers_along(plan: Plan) -> dict[str, Any]:
    """Return the times of a sweep's states, and the numbers of its occurrences, where it has some."""
    times, (begin, end) = plan.keeping.times, plan.keeping.occurrences
    variables: dict[str, Any] = {}
    if times.size:
        attributes = attrs_of(plan.grid.model.time_unit.text, "wanted time", "time")
        variables[schema.AT_TIME] = ((schema.AT,), times, attributes)
    if any(schema.OCCURRENCE in variable.dims for variable in plan.variables):
        attributes = attrs_of("1", "which occurrence it is, from 1", "index")
        variables[NUMBER] = ((schema.OCCURRENCE,), np.arange(begin + 1, end + 1), attributes)
    return variables


def _coordinates(grid: SweepGrid) -> dict[str, Any]:
    coordinates: dict[str, Any] = {}
    for column in _shared_columns(grid):  # an axis, where sweeps are put together
        value = column.values[0]
        coordinates[column.label] = (
            (),
            value.item() if hasattr(value, "item") else str(value),
            _axis_attributes(grid, column),
        )
    for axis in grid.axes:
        for column in axis.columns:
            attributes = _axis_attributes(grid, column) | {AXIS: axis.dim}
            if column.digits:
                attributes[DIGITS] = " ".join(column.exact_texts)
            if axis.design is not None:
                attributes |= {"design": axis.design.design, "seed": axis.design.seed}
            is_numeric = np.issubdtype(column.values.dtype, np.number)
            coordinates[column.label] = (
                (axis.dim,),
                column.values if is_numeric else column.values.astype(str),
                attributes,
            )
            if column.kind == TABLE:
                texts = np.array(column.tables)
                coordinates[f"{column.label}_table"] = (
                    (axis.dim,),
                    texts,
                    attrs_of("1", f"tables of drive {column.name}, as CSV", "table"),
                )
    return coordinates


def _axis_attributes(grid: SweepGrid, column: AxisColumn) -> dict[str, Any]:
    return attrs_of(column.unit.text, _meaning(grid.model, column), "axis") | {
        VARIES: column.kind,
        WHAT: display_text(column.name),
    }


def _shared_columns(grid: SweepGrid) -> list[AxisColumn]:
    """Return the settings that all members share and that could vary, each with its one value."""
    shared_settings = _shared_settings(grid)
    used_names = {*grid.dims, *(column.label for _, column in grid.columns)}
    names = [name for name in REPORTED_SETTINGS if f"solver_{name}" in shared_settings]
    # rows and mappings, such as an absolute tolerance for each variable, can be no axis
    names += [
        name
        for name, value in grid.shared_settings.items()
        if name in SETTINGS and name not in REPORTED_SETTINGS and isinstance(value, str | int | float)
    ]
    values = [shared_settings.get(f"solver_{name}", grid.shared_settings.get(name)) for name in names]
    columns = [column_of(grid.model, name, [value]) for name, value in zip(names, values, strict=True)]
    return [column for column in columns if column.label not in used_names]


def _meaning(model: Model, column: AxisColumn) -> str:
    """Describe a varied quantity, with the model's own description if there is one."""
    elements = model.elements
    sections: dict[str, Mapping[str, Any]] = {
        PARAMETER: elements.statement.parameters,
        INITIAL: elements.statement.coordinates,
        TABLE: elements.drives,
    }
    description = getattr(sections.get(column.kind, {}).get(column.name), "description", "")
    meaning = _KIND_DESCRIPTIONS[column.kind].format(column.name)
    return display_text(f"{meaning}: {description}" if description else meaning)


def _sweep_attributes(plan: Plan) -> dict[str, Any]:
    keeping = plan.keeping
    return {
        "summary": plan.grid.model.description or f"Runs of {plan.grid.model.name}",
        **plan.grid.model.about.attributes,
        MEMBERS: plan.grid.size,
        AXES: names_as_words(plan.grid.dims),
        ASKED: json.dumps(plan.grid.shared_settings, sort_keys=True),
        **_shared_settings(plan.grid),
        **({COMMENT: ONE_BY_ONE} if plan.grid.model.assemblies else {}),
        KEEP: names_as_words(keeping.words),
        OCCURRENCES: np.array(keeping.occurrences),
        "math_functions": plan.grid.math_functions,
        "solver_event_root_method": ROOT_METHODS[plan.grid.event_root_method],
        "solver_event_start": plan.grid.event_start,
        **({"solver_sliding": rule} if (rule := plan.grid.sliding) else {}),
        **({schema.ATOL_FLOOR_RULE: rule} if (rule := ATOL_FLOORS[plan.grid.atol_floor]) else {}),
        "model_digest": plan.grid.model.digest,
        DIGEST: plan.digest,
    }


def _shared_settings(grid: SweepGrid) -> dict[str, Any]:
    """Return the settings that all members share, under the names of a record's attributes."""
    varying = {column.name for _, column in grid.columns}
    settings = grid.settings_of((0,) * len(grid.shape))
    attributes: dict[str, Any] = {} if "method" in varying else {"solver_method": settings.method.name}
    if settings.adaptive and settings.tolerances is not None and not varying & {STEP, RTOL}:
        attributes["solver_rtol"] = settings.tolerances.rtol
    if isinstance(settings.step, float) and not settings.adaptive and not varying & {STEP, RTOL}:
        attributes |= {"solver_step": settings.step, "solver_step_units": grid.model.time_unit.text}
    return (
        attributes
        if "until" in varying
        else attributes | {"solver_until": settings.until, "solver_until_units": grid.model.time_unit.text}
    )


def with_axes(sweep: xr.Dataset) -> xr.Dataset:
    """Make axis values, and settings that could be some, coordinates; a file keeps only those named like a dimension."""
    axis_names = [
        name for name, variable in sweep.variables.items() if VARIES in variable.attrs and name not in sweep.coords
    ]
    return sweep.set_coords([*axis_names, *(f"{name}_table" for name in axis_names if f"{name}_table" in sweep)])


def settings_text(sweep: xr.Dataset) -> str:
    """Describe the settings that all members of a sweep share."""
    recorded = {
        name: (
            f"{sweep.attrs[key]:g}{unit_suffix(str(sweep.attrs.get(f'{key}_units', '1')))}"
            if name != "method"
            else sweep.attrs[key]
        )
        for name in REPORTED_SETTINGS
        if (key := f"solver_{name}") in sweep.attrs
    }
    requested_settings = json.loads(str(sweep.attrs[ASKED]))
    text = ", ".join(
        f"{name} {value}"
        for name, value in (
            recorded | {key: setting for key, setting in requested_settings.items() if key not in REPORTED_SETTINGS}
        ).items()
    )
    return text or "settings of the model's own"


def plan_of(sweep: xr.Dataset, functions: Mapping[str, Any] | None = None) -> Plan:
    """Reconstruct the plan that a sweep, or a part of one, was marched from.

    Raises
    ------
    InputError
        If the Dataset is no sweep, or sweeps of several models were put together.
    """
    sweep = sweep_of(sweep)
    texts = {text for text in np.ravel(sweep["model_toml"].values).tolist() if isinstance(text, str)}
    if len(texts) != 1:
        raise InputError(f"the sweep is of {len(texts)} models; sweeps of one model alone can be put together")
    model = Model.from_record(texts.pop(), functions=functions)
    keeping = keeping_of(str(sweep.attrs[KEEP]).split(), None, tuple(map(int, sweep.attrs[OCCURRENCES])))
    if (
        schema.AT_TIME in sweep.variables and sweep[schema.AT_TIME].attrs.get("role") != "parameter"
    ):  # of a model of schema 1
        keeping = Keeping(keeping.words, np.atleast_1d(sweep[schema.AT_TIME].values).astype(float), keeping.occurrences)
    requested_settings = json.loads(sweep.attrs[ASKED])
    if (math_set := kept_set(sweep.attrs.get("math_functions"))) != NAME:  # the default when the sweep was marched
        requested_settings["math_functions"] = math_set
    if (root_method := root_method_of(sweep.attrs)) != EARLIEST_FIRST:  # likewise
        requested_settings["event_root_method"] = root_method
    if (start := str(sweep.attrs.get("solver_event_start", WAITING))) != JUDGED:  # likewise
        requested_settings["event_start"] = start
    if may_slide_along_switches(model) and (rule := str(sweep.attrs.get("solver_sliding", ENDS))) != FILIPPOV:
        requested_settings["sliding"] = rule
    if (floor := atol_floor_of(sweep.attrs)) != OF_TERMS:  # likewise
        requested_settings["atol_floor"] = floor
    return Plan(
        SweepGrid(
            model, tuple(axis_of(model.shapes, sweep, dim) for dim in sweep_axis_names(sweep)), requested_settings
        ),
        keeping,
    )


def axis_of(shapes: Shapes, sweep: xr.Dataset, dim: str) -> Axis:
    """Reconstruct an axis; in a part of a sweep without that dimension it has the one remaining value.

    Raises
    ------
    InputError
        If the sweep has no values of it, or they vary along another dimension.
    """
    columns = []
    for name in sweep.variables:
        variable = sweep[name]
        if variable.attrs.get(AXIS) != dim:
            continue
        if variable.dims not in ((), (dim,)) or not variable.size:
            axis_fault = f"varies along {', '.join(map(str, variable.dims))}" if variable.size else "has no values"
            raise InputError(
                f"'{name}' {axis_fault}, and is of the axis '{dim}' of a sweep; take parts of it by isel or sel, with slices"
            )
        values, kind = np.atleast_1d(variable.values), str(variable.attrs[VARIES])
        tables = tuple(map(str, np.atleast_1d(sweep[f"{name}_table"].values))) if kind == TABLE else ()
        converted = values if np.issubdtype(values.dtype, np.number) else values.astype(object)
        quantity_name, unit = internal_text(str(variable.attrs[WHAT])), parse_unit(variable.attrs["units"])
        elements = tuple(shapes.elements(quantity_name)) if quantity_name in shapes.dims else ()
        exact_numbers = {number: number for number in map(read_decimal, str(variable.attrs.get(DIGITS, "")).split())}
        digits = tuple(exact_numbers.get(value, value) for value in values.tolist()) if exact_numbers else ()
        columns.append(AxisColumn(quantity_name, kind, converted, unit, str(name), tables, elements, digits))
    if not columns:
        raise InputError(f"the sweep has no values of its axis '{dim}'; take them along")
    return Axis(dim, tuple(columns))
