"""Observables of a run at any times inside it, with how far interpolation may have them off."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.evidence.sampling import sample
from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated, tables_of
from xdynamics.model.reactions import reactions
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]


def observables_of(model: Model) -> tuple[str, ...]:
    """Name what can be observed at any time: coordinates, velocities, states, energies and declared observables."""
    layout = layout_of(model)
    return (*layout.used, *(name for name in layout.derived if name not in layout.gaps))


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
    found = {}
    for name in names:
        if name in states:
            found[name] = states[name].values, states[schema.error(name)].values
        else:
            found[name] = _derived(run, model, name, states)
    return found


def _derived(run: xr.Dataset, model: Model, name: str, states: xr.Dataset) -> tuple[Floats, Floats]:
    """Evaluate an energy or a declared observable, and how much the error of each part of the state moves it."""
    tree, layout = layout_of(model).derived[name], layout_of(model)
    if reactions(model) and free_names(tree) & {*layout.accelerations}:
        raise InputError(f"observable '{name}' reads accelerations, which contacts change; ask for what it is made of")
    factors = {one: float(unit.factor) for one, unit in model.units.items()}
    rows = states["row"].values
    regimes = run["regime"].values[rows] if "regime" in run else np.zeros(rows.size)
    values, errors = np.empty(rows.size), np.empty(rows.size)
    for k in range(rows.size):
        at = {one: float(states[one].values[k]) * factors[one] for one in layout.used}
        off = {one: float(states[schema.error(one)].values[k]) * factors[one] for one in layout.used}
        fixed = {"t": float(states[schema.AT_TIME].values[k]), REGIME_NUMBER: float(regimes[k])}
        values[k] = _value(model, tree, at | fixed)
        moved = [abs(_value(model, tree, at | {one: at[one] + off[one]} | fixed) - values[k]) for one in at if off[one]]
        errors[k] = sum(moved)
    unit = float(parse_unit(str(run[name].attrs["units"])).factor)
    return values / unit, errors / unit


def _value(model: Model, tree: Node, state: Mapping[str, float]) -> float:
    """Evaluate one expression at one state, SI units."""
    return evaluate(tree, evaluated(model, state, constants(model), tables_of(model)))
