"""Observables of a run at any times inside it, with how far interpolation may have them off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary import kept_set
from xdynamics.evidence.sampling import sample
from xdynamics.expressions import Name, Node, free_names
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Function, Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated_many, motion, tables_of
from xdynamics.model.reactions import NORMAL, holds, reactions, way
from xdynamics.record.columns import state_name
from xdynamics.record.kinds import said_of_log
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


def observables_of(model: Model) -> tuple[str, ...]:
    """Name what can be observed at any time: coordinates, velocities, states, energies and declared observables."""
    layout = layout_of(model)
    return (*layout.used, *(name for name in layout.derived if name not in layout.gaps))


def comparable(model: Model) -> tuple[str, ...]:
    """Name what can be observed without an acceleration, which contacts change within a step."""
    layout = layout_of(model)
    accelerations = {*layout.accelerations} if reactions(model) else set()
    return tuple(
        one
        for one in observables_of(model)
        if one in layout.used or not free_names(layout.derived[one]) & accelerations
    )


def observe(
    run: xr.Dataset, model: Model, names: Sequence[str], times: Floats, rule: str = REINTEGRATE
) -> dict[str, tuple[Floats, Floats]]:
    """Return values of observables at times, and what the interpolation of the state is uncertain by, in recorded units.

    Raises
    ------
    InputError
        If a name is none of the model's, or a time is outside the run.
    """
    known = observables_of(model)
    for name in names:
        if name not in known:
            raise InputError(f"observable '{name}' is none of the model's; there are {', '.join(known)}")
    states = sample(run, times, rule=rule, functions=model.functions)
    found = {name: (states[name].values, states[schema.error(name)].values) for name in names if name in states}
    return found | _derived(run, model, [name for name in names if name not in states], states)


def _derived(run: xr.Dataset, model: Model, names: list[str], states: xr.Dataset) -> dict[str, tuple[Floats, Floats]]:
    """Evaluate energies and declared observables, and how much the error of each part of the state moves them."""
    layout = layout_of(model)
    trees = [layout.derived[name] for name in names]
    if changed := [name for name in names if name not in comparable(model)]:
        raise InputError(
            f"observable '{changed[0]}' reads accelerations, which contacts change; ask for what it is made of"
        )
    if not names:
        return {}
    rows, times = states["row"].values, states[schema.AT_TIME].values
    at = {one: states[one].values for one in layout.used}
    off = {one: states[schema.error(one)].values for one in layout.used}

    def evaluated(state: Mapping[str, Floats]) -> Floats:
        return np.stack(evaluated_on(run, model, trees, state, times, rows))

    values = evaluated(at)
    moved = (np.abs(evaluated(at | {one: at[one] + off[one]}) - values) for one in layout.used if off[one].any())
    errors = sum(moved, np.zeros(values.shape))
    units = np.array([[float(parse_unit(str(run[name].attrs["units"])).factor)] for name in names])
    return dict(zip(names, zip(values / units, errors / units, strict=True), strict=True))


def tree_of(model: Model, name: str) -> Node:
    """Return what a variable of the record is computed by: an energy, observable, force, acceleration, rate or reaction."""
    return layout_of(model).derived.get(name, Name(name))


@lru_cache(maxsize=512)
def rate_tree(model: Model, name: str) -> Node | None:
    """Return the time derivative of a variable of the record along the motion; none where contacts or Python are in it."""
    if name in model.coordinates:
        return model.rates[name]
    if reactions(model) or model.python_functions:
        return None
    if name in model.units:
        return model.rates[name]
    forces = {one.name: one.value for one in motion(model) if not isinstance(one.value, Function)}
    tree = layout_of(model).derived.get(name, forces.get(name))
    if tree is None or free_names(tree) & {one.name for one in motion(model)}:
        return None
    return model.rate_of(tree)


def evaluated_on(
    run: xr.Dataset, model: Model, trees: Sequence[Node], states: Mapping[str, Floats], times: Floats, rows: Rows
) -> list[Floats]:
    """Evaluate expressions on states inside steps: forces, accelerations and what contacts do there among them.

    Parameters
    ----------
    run : xarray.Dataset
        For regimes, and for what each contact and friction element does behind a row.
    model : Model
    trees : sequence of Node
        Without definitions left in them.
    states : mapping of str to ndarray, shape (k,)
        Coordinates, velocities and first-order states, in recorded units.
    times : ndarray, shape (k,), s
    rows : ndarray of int, shape (k,)
        Of `step`, from which each step goes.

    Returns
    -------
    list of ndarray, shape (k,)
        In SI units.
    """
    at: dict[str, Any] = {name: states[name] * float(unit.factor) for name, unit in model.units.items()} | {"t": times}
    at[REGIME_NUMBER] = run["regime"].values[rows].astype(float) if "regime" in run else np.zeros(rows.size)
    led_to = np.minimum(rows + 1, run.sizes[schema.STEPS] - 1)
    names = [name for one in reactions(model) for name in (state_name(one), one.name)]
    if missing := [name for name in names if name not in run.variables]:
        raise InputError(f"what is computed between rows needs {', '.join(missing)}; {said_of_log(run.attrs) or 'take the whole record'}")  # fmt: skip
    at |= modes_behind(model, {name: run[name].values for name in names}, rows, led_to)
    functions = kept_set(run.attrs.get("math_functions"))
    found = evaluated_many(model, trees, at, constants(model), tables_of(model), functions)
    return [np.array(np.broadcast_to(one, rows.shape)) for one in found]


def modes_behind(model: Model, columns: Mapping[str, Any], rows: Rows, led_to: Rows) -> dict[str, Floats]:
    """Return the numbers that say what each reaction does behind rows, as a march puts them behind the parameters.

    Parameters
    ----------
    model : Model
    columns : mapping of str to ndarray
        State and force of every contact and friction element.
    rows, led_to : ndarray of int, shape (k,)
        Of the columns: from which each step goes, and to which.
    """
    modes: dict[str, Floats] = {}
    for one in reactions(model):
        state, force = columns[state_name(one)][rows], columns[one.name]
        if one.sort == NORMAL:
            modes[holds(one)], modes[way(one)] = (state != schema.OPEN).astype(float), np.zeros(rows.size)
        else:
            modes[holds(one)] = (state == schema.STICKING).astype(float)
            modes[way(one)] = (state == schema.FORWARD).astype(float) - (state == schema.BACKWARD)
        # of what two corners hold together the first has all: a march lets the other go, and so its force is 0
        modes[holds(one)] *= (force[rows] != 0.0) | (force[led_to] != 0.0)
    return modes
