"""The work of forces of velocities alone: one that drives a motion which it should brake has a wrong sign somewhere."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.expressions import free_names
from xdynamics.model import Function, Model
from xdynamics.record.named_elements import column_in_si
from xdynamics.units import SECONDS

SEEN = 1e-6  # of all work of a force: less is due to the rule of trapezoids


def works_of_drag(run: xr.Dataset) -> Iterator[str]:
    """Report the work that a force of velocities alone did on the motion, where it did any, and in which direction."""
    if "force_source" not in run or run.sizes[schema.STEPS] < 2:
        return
    model = model_of_record(run, None)
    if model.shapes.dims or model.time_unit.text != SECONDS.text:
        return
    times = run["time"].values
    for name, coordinates in _velocity_forces(model).items():
        columns = {q: (schema.force(name, q), schema.velocity(q)) for q in coordinates}
        if not all(column in run for pair in columns.values() for column in pair):
            continue
        powers = [column_in_si(run, force) * column_in_si(run, velocity) for force, velocity in columns.values()]
        power = np.sum(powers, axis=0)
        pushing, all_of_it = np.maximum(power, 0.0), np.trapezoid(np.abs(power), times)
        if (work := np.trapezoid(pushing, times)) <= SEEN * all_of_it:
            continue
        speeds = column_in_si(run, schema.velocity(coordinates[0]))[power > 0.0]
        direction_note = f" where v_{coordinates[0]} {'<' if speeds.max() < 0.0 else '>'} 0"
        one_way = len(coordinates) == 1 and (speeds.max() < 0.0 or speeds.min() > 0.0)
        yield f"work      {name} did +{work:.3g} J of work on the motion{direction_note if one_way else ''}: drag would take it"


def _velocity_forces(model: Model) -> dict[str, list[str]]:
    """Return the forces that read velocities, and neither coordinates, states, drives nor time, with where they act."""
    position_names = {"t", *model.statement.coordinates, *model.statement.states, *model.drives}
    velocities, forces = {*map(schema.velocity, model.statement.coordinates)}, dict[str, list[str]]()
    for name, components in model.force_components.items():
        trees = [tree for tree in components.values() if not isinstance(tree, Function)]
        names_read = set().union(*(free_names(model.expanded(tree)) for tree in trees)) if trees else set()
        if len(trees) == len(components) and names_read & velocities and not names_read & position_names:
            forces[name] = [*components]
    return forces
