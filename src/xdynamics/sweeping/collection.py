"""A sweep as a Dataset: axes with units, what is kept along them, and all that its members can be marched again from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.elementary import NAME, kept_set
from xdynamics.evidence.exhibit import about, exhibit
from xdynamics.faults import InputError
from xdynamics.march.settings import EARLIEST_FIRST, ROOT_METHODS
from xdynamics.model import Model
from xdynamics.record.provenance import root_method_of
from xdynamics.schema import AT, AT_TIME, EVIDENCE, OCCURRENCE, SWEEP
from xdynamics.sweeping.axes import INITIAL, PARAMETER, RTOL, STEP, TABLE, Axis, Column
from xdynamics.sweeping.grid import Grid
from xdynamics.sweeping.keeping import Keeping, keeping_of
from xdynamics.sweeping.members import Plan
from xdynamics.units import behind, parse_unit

if TYPE_CHECKING:
    import xarray as xr

AXES, ASKED, KEEP, OCCURRENCES, DIGEST = (
    "sweep_axes",
    "sweep_settings",
    "sweep_keep",
    "sweep_occurrences",
    "sweep_digest",
)
SHARED = "method", "step", "rtol", "until"  # settings that are told
NUMBER = "occurrence_number"
VARIES, WHAT, AXIS = "varies", "varies_what", "axis_of"  # attributes of values: the kind of thing, its name, its axis
_SAID = {
    "parameter": "parameter {0}", "initial": "initial value of {0}", "start": "time at which runs begin",
    "step": "step of the grid, or the first one", "rtol": "relative tolerance", "table": "table of drive {0}",
    "setting": "setting {0} of the march",
}  # fmt: skip


def collected(plan: Plan, arrays: Mapping[str, Any], unchanged: Mapping[str, Any] | None = None) -> xr.Dataset:
    """Put arrays of members into a Dataset along the axes.

    Raises
    ------
    InputError
        If a kept variable bears the name of an axis.
    """
    grid = plan.grid
    coordinates = _coordinates(grid)
    kept = {one.name: ((*grid.dims, *one.dims), arrays[one.name], one.attributes) for one in plan.variables if one.name in arrays}  # fmt: skip
    names = [one.name for one in plan.variables]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(
            f"'{twice[0]}' is a number of every sweep, and an observable that is kept; rename the observable"
        )
    if both := sorted({*kept} & {*coordinates, *grid.dims}):
        name = both[0]
        raise InputError(f"'{name}' is an axis and kept too; call the axis 'initial_{name}'")
    varying = {one.label for _, one in grid.columns}
    shared = {
        name: (
            (),
            part.quantity.value,
            about(part.quantity.unit.text, part.description or f"parameter {name}", "parameter"),
        )
        for name, part in grid.model.parameters.items()
        if name not in varying and name not in kept
    }
    times = plan.keeping.times
    more: dict[str, Any] = (
        {AT_TIME: ((AT,), times, about(grid.model.time_unit.text, "wanted time", "time"))} if times.size else {}
    )
    if any(OCCURRENCE in one.dims for one in plan.variables):
        begin, end = plan.keeping.occurrences
        more[NUMBER] = (
            (OCCURRENCE,),
            np.arange(begin + 1, end + 1),
            about("1", "which occurrence it is, from 1", "index"),
        )
    toml = {"model_toml": ((), grid.model.to_toml(), about("1", "the model that members share, as TOML", "model"))}
    said = ", ".join(grid.dims)
    found = exhibit(
        SWEEP,
        f"{grid.model.name}: a sweep over {said}",
        [],
        coordinates | kept | more | shared | toml,
        _attributes(plan),
        unchanged,
    )
    return found.set_coords([*coordinates])


def _coordinates(grid: Grid) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for axis in grid.axes:
        for one in axis.columns:
            said = about(one.unit.text, _meaning(grid.model, one), "axis") | {
                VARIES: one.kind,
                WHAT: one.name,
                AXIS: axis.dim,
            }
            if axis.design is not None:
                said |= {"design": axis.design.design, "seed": axis.design.seed}
            numbers = np.issubdtype(one.values.dtype, np.number)
            found[one.label] = ((axis.dim,), one.values if numbers else one.values.astype(str), said)
            if one.kind == TABLE:
                texts = np.array(one.tables)
                found[f"{one.label}_table"] = ((axis.dim,), texts, about("1", f"tables of drive {one.name}, as CSV", "table"))  # fmt: skip
    return found


def _meaning(model: Model, column: Column) -> str:
    """Say what varies, in the model's own words if it has some."""
    parts: dict[str, Mapping[str, Any]] = {PARAMETER: model.parameters, INITIAL: model.coordinates, TABLE: model.drives}
    told = getattr(parts.get(column.kind, {}).get(column.name), "description", "")
    said = _SAID[column.kind].format(column.name)
    return f"{said}: {told}" if told else said


def _attributes(plan: Plan) -> dict[str, Any]:
    keeping = plan.keeping
    return {
        "summary": plan.grid.model.description or f"Runs of {plan.grid.model.name}",
        "sweep_members": plan.grid.size,
        AXES: " ".join(plan.grid.dims),
        ASKED: json.dumps(plan.grid.asked, sort_keys=True),
        **_shared_settings(plan.grid),
        KEEP: " ".join(keeping.words),
        OCCURRENCES: np.array(keeping.occurrences),
        "math_functions": plan.grid.math_functions,
        "solver_event_root_method": ROOT_METHODS[plan.grid.event_root_method],
        "model_digest": plan.grid.model.digest,
        DIGEST: plan.digest,
    }


def _shared_settings(grid: Grid) -> dict[str, Any]:
    """Return what all members are marched with, as attributes of a record call it."""
    varying = {one.name for _, one in grid.columns}
    settings = grid.settings_of((0,) * len(grid.shape))
    found: dict[str, Any] = {} if "method" in varying else {"solver_method": settings.method.name}
    if settings.adaptive and settings.tolerances is not None and not varying & {STEP, RTOL}:
        found["solver_rtol"] = settings.tolerances.rtol
    if isinstance(settings.step, float) and not settings.adaptive and not varying & {STEP, RTOL}:
        found |= {"solver_step": settings.step, "solver_step_units": grid.model.time_unit.text}
    return (
        found
        if "until" in varying
        else found | {"solver_until": settings.until, "solver_until_units": grid.model.time_unit.text}
    )


def with_axes(sweep: xr.Dataset) -> xr.Dataset:
    """Have the values of axes as coordinates, of which a file keeps those alone that bear the name of a dimension."""
    mine = [name for name, one in sweep.variables.items() if AXIS in one.attrs and name not in sweep.coords]
    return sweep.set_coords([*mine, *(f"{name}_table" for name in mine if f"{name}_table" in sweep)])


def settings_said(sweep: xr.Dataset) -> str:
    """Say which settings all members of a sweep share."""
    used = {name: f"{sweep.attrs[key]:g}{behind(str(sweep.attrs.get(f'{key}_units', '1')))}" if name != "method" else sweep.attrs[key] for name in SHARED if (key := f"solver_{name}") in sweep.attrs}  # fmt: skip
    asked = json.loads(str(sweep.attrs[ASKED]))
    said = ", ".join(
        f"{name} {value}"
        for name, value in (used | {key: one for key, one in asked.items() if key not in SHARED}).items()
    )
    return said or "settings of the model's own"


def check_sweep(sweep: Any) -> None:
    """Refuse what is no sweep.

    Raises
    ------
    InputError
    """
    if getattr(sweep, "attrs", {}).get(EVIDENCE) != SWEEP or "model_toml" not in sweep:
        raise InputError(f"{type(sweep).__name__} is no sweep; give what sweep or open_sweep returned")


def plan_of(sweep: xr.Dataset, functions: Mapping[str, Any] | None = None) -> Plan:
    """Read again what a sweep, or a part of one, was marched from.

    Raises
    ------
    InputError
        If the Dataset is no sweep.
    """
    check_sweep(sweep)
    texts = {one for one in np.ravel(sweep["model_toml"].values).tolist() if isinstance(one, str)}
    if len(texts) != 1:
        raise InputError(f"the sweep is of {len(texts)} models; sweeps of one model alone can be put together")
    model = Model.from_text(texts.pop(), functions=functions)
    keeping = keeping_of(str(sweep.attrs[KEEP]).split(), None, tuple(map(int, sweep.attrs[OCCURRENCES])))
    if AT_TIME in sweep.variables:
        keeping = Keeping(keeping.words, np.atleast_1d(sweep[AT_TIME].values).astype(float), keeping.occurrences)
    asked = json.loads(sweep.attrs[ASKED])
    if (kept := kept_set(sweep.attrs.get("math_functions"))) != NAME:  # nobody asked for the set of that time
        asked["math_functions"] = kept
    if (located := root_method_of(sweep.attrs)) != EARLIEST_FIRST:  # nor for the search of that time
        asked["event_root_method"] = located
    return Plan(Grid(model, tuple(_axis(sweep, dim) for dim in str(sweep.attrs[AXES]).split()), asked), keeping)


def _axis(sweep: xr.Dataset, dim: str) -> Axis:
    """Read an axis again; where a part of a sweep is without it, with the one value that is left."""
    columns = []
    for name in sweep.variables:
        one = sweep[name]
        if one.attrs.get(AXIS) != dim:
            continue
        if one.dims not in ((), (dim,)) or not one.size:
            along = f"varies along {', '.join(map(str, one.dims))}" if one.size else "has no values"
            raise InputError(f"'{name}' {along}, and is of the axis '{dim}' of a sweep; take parts of it by isel or sel, with slices")  # fmt: skip
        values, kind = np.atleast_1d(one.values), str(one.attrs[VARIES])
        tables = tuple(map(str, np.atleast_1d(sweep[f"{name}_table"].values))) if kind == TABLE else ()
        known = values if np.issubdtype(values.dtype, np.number) else values.astype(object)
        columns.append(Column(str(one.attrs[WHAT]), kind, known, parse_unit(one.attrs["units"]), str(name), tables))
    if not columns:
        raise InputError(f"the sweep has no values of its axis '{dim}'; take them along")
    return Axis(dim, tuple(columns))
