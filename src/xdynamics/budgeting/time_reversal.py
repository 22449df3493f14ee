"""Rounding by time reversal: a symmetric method undoes its own steps, except for rounding."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from xdynamics.budgeting.measurand import Measurand
from xdynamics.evidence.runs import march_model
from xdynamics.methods import METHODS
from xdynamics.model import Model, Trait, traits_of
from xdynamics.model.parts import Function
from xdynamics.record.named_elements import get_column
from xdynamics.schema import velocity

if TYPE_CHECKING:
    import xarray as xr


def reversal_distance(run: xr.Dataset, measurand: Measurand) -> float | None:
    """March a run back to its start; return how far a coordinate or velocity ends from it, in its unit.

    None for runs that are not reversible: another method, chosen or given steps, forces that depend on velocity or
    time, first-order states, events, contacts, friction; also for other quantities (Hairer, Lubich, Wanner, section
    V.1).
    """
    model, target = measurand.model, measurand.target
    velocities = {velocity(name) for name in model.statement.coordinates}
    if (
        target.at is None
        or target.quantity not in {*model.statement.coordinates, *velocities}
        or not _is_reversible(run, model)
    ):
        return None
    time, step = run["time"].values, float(run["step_size"][1]) if run.sizes["step"] > 1 else 0.0
    whole_steps = np.flatnonzero((time <= target.at) & np.isin(run["step_size"].values, [0.0, step]))
    if len(whole_steps) < 2:
        return None
    reversed_start = {
        name: f"{_reversed_value(run, name, int(whole_steps[-1]), velocities)!r} {get_column(run, name).attrs['units']}"
        for name in (*model.statement.coordinates, *velocities)
    }
    until = {"until": float(time[whole_steps[-1]]), "force_samples": "none"}
    reversed_run = march_model(model.replace(initial=reversed_start), **measurand.settings | until)
    return abs(
        _reversed_value(reversed_run, target.quantity, -1, velocities) - float(get_column(run, target.quantity)[0])
    )


def _reversed_value(run: xr.Dataset, name: str, row: int, velocities: set[str]) -> float:
    value = float(get_column(run, name)[row])
    return -value if name in velocities else value


def _is_reversible(run: xr.Dataset, model: Model) -> bool:
    """Return whether a run of equal steps is undone by the same steps with the velocities reversed."""
    irreversible_parts = (
        model.statement.states,
        model.events,
        model.contacts,
        model.assemblies,
        model.frictions,
        model.regimes,
    )
    if (
        any(irreversible_parts)
        or model.delays
        or not METHODS[run.attrs["solver_method"]].symmetric
        or run.sizes.get("event", 0)
    ):
        return False
    terms = [tree for components in model.force_components.values() for tree in components.values()]
    trees = [*terms, *model.statement.mass_entries.values()]
    reads_time = any("t" in model.reads(tree) or isinstance(tree, Function) for tree in trees)
    is_fixed_step = run.attrs["solver_step_control"] == "fixed"
    return is_fixed_step and not reads_time and Trait.VELOCITY_DEPENDENT not in traits_of(model)
