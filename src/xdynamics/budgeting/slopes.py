"""Slopes of one number by every uncertain input, from the variational equations of its run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.budgeting.measurand import TIME, Target
from xdynamics.dynamics.constrained_changes import followed_start
from xdynamics.dynamics.path import NO_MAP, steps_over_impacts
from xdynamics.dynamics.saltation import FlowStates, SimultaneousEvents
from xdynamics.dynamics.tick_maps import with_ticks
from xdynamics.dynamics.variational import (
    LARGEST,
    Equations,
    NotVariedError,
    Variations,
    first_contact_rows,
    gauss,
    refuse_delays,
)
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import variables
from xdynamics.record.flag_words import words_of_flag
from xdynamics.record.named_rows import rows_named

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

NEAR = 1e-9  # of a value at the start: what digits of it leave


def variational_slopes(run: xr.Dataset, model: Model, target: Target, inputs: Sequence[str]) -> dict[str, float]:
    """Return the slope of a number by uncertain inputs, both in their own units.

    Raises
    ------
    NotVariedError
        If the variational equations do not cover the run, its contacts or its forces.
    """
    changes = _integrate_changes(run, model, target, tuple(inputs))
    factor = float(target.units(run).factor)
    units = [float(model.uncertain[name].quantity.unit.factor) for name in inputs]
    if not np.isfinite(changes).all():
        raise NotVariedError("the equations have no finite solution")
    return {name: float(change) * unit / factor for name, change, unit in zip(inputs, changes, units, strict=True)}


def _integrate_changes(run: xr.Dataset, model: Model, target: Target, inputs: tuple[str, ...]) -> Floats:
    """Integrate along the run, from event to event, to the number; return its slopes in SI units."""
    if target.extreme is not None:
        raise NotVariedError("an extreme is where the run has it")
    _check_points(model, inputs)
    path = with_ticks(Variations(run, _variational_equations(run, model, inputs), int(run.attrs["solver_order"])))
    change, row, occurrences, first_touches = (
        path.from_start(_initial_changes(path, inputs)),
        0,
        0,
        first_contact_rows(run),
    )
    for row_before, row_after, names in _event_instants(run):
        if target.at is not None and float(run["time"][row_before]) > target.at:
            break
        _check_open(first_touches, row_before)
        change = path.carried_change(change, row, row_before)
        met = SimultaneousEvents(path, np.array([row_before]), np.array([row_after]), names, change[None])
        occurrences += names.count(target.event)
        if target.event in names and occurrences >= target.occurrence:
            return _changes_at_event(met, target)
        change, row = met.changes_after()[0], row_after
    assert target.at is not None  # noqa: S101 - a number at an event was found in the run before
    last = int(np.searchsorted(run["time"].values, target.at, side="right")) - 1
    _check_open(first_touches, last)
    change = path.carried_change(change, row, last, target.at)
    return _quantity_changes(_changes_at_time(path, last, target.at, change), target)


def _check_points(model: Model, inputs: Sequence[str]) -> None:
    """Refuse tables that jump at points whose times the inputs move."""
    if not (point_inputs := sorted(model.read_by_points.intersection(inputs))):
        return
    for name, drive in model.drives.items():
        if drive.argument != CLOCK and (drive.interpolation == "previous" or drive.outside == "zero"):
            raise NotVariedError(f"'{name}' jumps at times that follow '{point_inputs[0]}'")


def _check_open(first_touches: Mapping[str, int], row: int) -> None:
    """Refuse contacts that are not open up to a row."""
    if closed_contacts := [name for name, first in first_touches.items() if first <= row]:
        raise NotVariedError(f"'{closed_contacts[0]}' is not open all the time")


def _variational_equations(run: xr.Dataset, model: Model, inputs: tuple[str, ...]) -> Equations:
    """Return the variational equations of a model; refuse models without them, or with too many."""
    if model.frictions:
        raise NotVariedError("friction elements slip or stick all the time")
    if model.assemblies:
        raise NotVariedError("impacts of many links have no map of states")
    if steps_over_impacts(run, model):
        raise NotVariedError(f"{run.attrs['solver_method']} locates no impacts")
    refuse_delays(model)
    if model.python_functions:
        raise NotVariedError("a force or event is written in Python")
    if model.constraints and (model.contacts or any(event.reset for event in model.events.values())):
        raise NotVariedError("constraints answer to impacts and resets, of which there is no map of states")
    equations = Equations(model, inputs)
    if equations.size * len(gauss(int(run.attrs["solver_order"]) // 2 + 2)[0]) > LARGEST:
        raise NotVariedError(f"{equations.size} variables are too many")
    return equations


def _initial_changes(path: Variations, inputs: tuple[str, ...]) -> Floats:
    """Return the initial change: 1 for a variable whose initial value is the input, or what an expression of it has."""
    model = path.equations.model
    names, followed = variables(model), model.slopes_at_start(inputs)
    change = np.array(
        [
            [
                float(name == input_name and input_name in model.starts) + followed.get((name, input_name), 0.0)
                for input_name in inputs
            ]
            for name in names
        ]
    )
    return _follow_constraints(path, inputs, change) if model.constraints else change


def _follow_constraints(path: Variations, inputs: tuple[str, ...], change: Floats) -> Floats:
    """Return the initial change as it is where the start follows constraints."""
    model = path.equations.model
    state = {name: float(value[0]) for name, value in path.row(np.zeros(1, np.int64)).items()}
    if any(abs(state[name] - model.statement.initial[name].si) > NEAR * abs(state[name]) for name in variables(model)):
        raise NotVariedError("the start is moved to where constraints hold")
    followed = followed_start(model, inputs, state, change)
    if followed is None:
        raise NotVariedError("an input moves the start from where constraints hold; see [initial] consistent")
    return followed


def _event_instants(run: xr.Dataset) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Yield the rows on both sides of every instant with events, and the names of the events."""
    if not run.sizes.get("event", 0):
        return
    detectors, kinds = (words_of_flag(run[name]) for name in ("event_detector", "event_kind"))
    rows = [rows_named(run, name).tolist() for name in ("event_row_before", "event_row_after")]
    groups: dict[tuple[int, int], list[str]] = {}
    for row_before, row_after, name, kind in zip(*rows, detectors, kinds, strict=True):
        groups.setdefault((row_before, row_after), []).append(name)
        if kind in NO_MAP:
            groups[row_before, row_after].append(f"{kind} of {name}")
    for (row_before, row_after), names in groups.items():
        yield row_before, row_after, tuple(names)


def _changes_at_event(met: SimultaneousEvents, target: Target) -> Floats:
    """Return the slopes of a number at an event."""
    time = met.time_of(target.event)
    if target.quantity == TIME:
        return np.asarray(time[0])
    return _quantity_changes(
        met.flow_before_event(time) if target.side == "before" else met.flow_after_event(time), target
    )


def _changes_at_time(path: Variations, last: int, time: float, change: Floats) -> FlowStates:
    """Return the state at a time and its changes."""
    row = np.array([last])
    flow = SimultaneousEvents(path, row, row, (), change[None]).flow_before_event(np.zeros((1, change.shape[1])))
    state = path.states(np.array([time]), np.array([last]))
    return FlowStates(flow.model, state, flow.changes)


def _quantity_changes(flow: FlowStates, target: Target) -> Floats:
    """Return the change of a coordinate, velocity, state, energy or observable."""
    if target.quantity in flow.changes:
        return np.asarray(flow.changes[target.quantity][0])
    derived = layout_of(flow.model).derived
    if target.quantity not in derived:
        raise InputError(f"quantity is {target.quantity!r}")
    return np.asarray(flow.change(derived[target.quantity])[0])
