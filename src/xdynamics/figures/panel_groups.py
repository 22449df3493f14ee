"""Which variables of a run share a panel, and which are not worth one."""

from __future__ import annotations

import numpy as np
import xarray as xr

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.elementary.rounding_margins import EPS
from xdynamics.expressions import free_names
from xdynamics.figures.lattice import FEWEST_ELEMENTS
from xdynamics.figures.line_panels import MOST_LINES
from xdynamics.figures.roles import with_role
from xdynamics.schema import STEPS
from xdynamics.shapes import split_element_name

ROUNDINGS = 16.0  # spacings of the largest force, which the balance of forces at a contact may leave


def groups_by_unit(run: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group variables that share an axis: those of one unit, and elements of one quantity for themselves.

    Of many elements those along each axis (the few labels of a last dimension) are a group.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for name in names:
        quantity, labels = split_element_name(name)
        groups.setdefault((run.variables[name].attrs["units"], quantity if labels else ""), []).append(name)
    return [part for group in groups.values() for part in _by_axis(group)]


def _by_axis(names: list[str]) -> list[list[str]]:
    """Part many elements by the last of several dimensions, where that has few and each part is still a map."""
    parts: dict[str, list[str]] = {}
    for name in names:
        labels = split_element_name(name)[1]
        parts.setdefault(labels[-1] if len(labels) > 1 else "", []).append(name)
    is_many = min(map(len, parts.values())) > MOST_LINES
    return [*parts.values()] if is_many and len(parts) < FEWEST_ELEMENTS else [names]


def drives_by_unit(run: xr.Dataset) -> list[list[str]]:
    """Group the drives of a run's model by unit."""
    if "model_toml" not in run:
        return []
    model = model_of_record(run, None)
    groups: dict[str, list[str]] = {}
    for name, drive in model.drives.items():
        if (free_names(model.looked_up_at[name]) & {*model.units}).issubset(run.variables):
            groups.setdefault(drive.table.value_unit.text, []).append(name)
    return list(groups.values())


def are_rounding_errors(run: xr.Dataset, names: list[str]) -> bool:
    """Whether reactions of one unit are nothing but what rounding leaves of the forces that they balance."""
    units = run.variables[names[0]].attrs["units"]
    forces = [name for name in with_role(run, "force") if run.variables[name].attrs["units"] == units]
    largest = max((_largest_magnitude(run, name) for name in forces), default=0.0)
    return max(_largest_magnitude(run, name) for name in names) <= ROUNDINGS * EPS * largest


def _largest_magnitude(run: xr.Dataset, name: str) -> float:
    values = run.variables[name].values
    return float(np.nanmax(np.abs(values), initial=0.0)) if run.variables[name].dims[:1] == (STEPS,) else 0.0
