"""A run as a tree of plain tables: a view of the flat record, from which alone a run is reproduced."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.archive import without_stale_units
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.faults import InputError
from xdynamics.record.flag_words import without_bounds
from xdynamics.record.named_rows import rows_named
from xdynamics.record.run_dataset import check_single

if TYPE_CHECKING:
    from collections.abc import Collection

    import xarray as xr
    from numpy.typing import NDArray

# the node of each dimension of a record, and what its events are shown with on either side
NODES = {
    schema.STEPS: "steps",
    schema.TRIALS: "trials",
    schema.EVENTS: "events",
    schema.SAMPLES: "samples",
    schema.CLOSED_LINKS: "closed",
}
ON_SIDES = (*schema.KINEMATIC, "energy", "observable")
ENDS = ("lower", "upper")


def tree(run: xr.Dataset) -> xr.DataTree:
    """Return a run as a tree.

    Parameters
    ----------
    run : xarray.Dataset
        In memory or opened, lazy or not, or a part of one.

    Returns
    -------
    xarray.DataTree
        ``/`` has the parameters, the texts and the attributes; ``/steps``, ``/trials``, ``/events``, ``/samples`` and
        ``/closed`` have what lies along their dimension: the names are those of the record. In ``/events`` every
        coordinate, velocity, acceleration, state, energy and observable y stands as ``before_y`` and ``after_y`` beside
        the ends of the bracket, ``event_time_bounds_lower`` and ``…_upper``; of a row that a selection has not, nan.
    """
    check_single(run)
    return tree_nodes(without_stale_units(run))


def tree_nodes(run: xr.Dataset) -> xr.DataTree:
    """Return the tree of a run whose units hold; see `tree`."""
    import xarray as xr

    variables_by_dim: dict[str, dict[Any, Any]] = {dim: {} for dim in NODES if dim in run.dims}
    root = {}
    for name, variable in run.variables.items():
        dim = next((dim for dim in variable.dims if dim in variables_by_dim), None)
        if dim is None:
            root[name] = variable
        elif name == schema.EVENT_BOUNDS:
            unit = str(run["event_time"].attrs["units"])
            for k, end in enumerate(ENDS):
                described = attrs_of(unit, f"{end} end of the bracket of the event's time", "event")
                variables_by_dim[schema.EVENTS][f"{schema.EVENT_BOUNDS}_{end}"] = xr.Variable(
                    (schema.EVENTS,), variable.isel({schema.BOUNDS: k}).data, described, fastpath=True
                )
        else:
            variables_by_dim[str(dim)][name] = variable.copy(deep=False)
            variables_by_dim[str(dim)][name].attrs = without_bounds(variable.attrs)
    if {schema.STEPS, schema.EVENTS} <= {*variables_by_dim}:
        for side in ("before", "after"):
            variables_by_dim[schema.EVENTS] |= states_on_side(run, side, rows_named(run, f"event_row_{side}"))
    nodes = {f"/{NODES[dim]}": _node_table(variables, run) for dim, variables in variables_by_dim.items()}
    root_table = xr.Dataset(root, attrs=run.attrs).set_coords([name for name in root if name in run.coords])
    return xr.DataTree.from_dict({"/": root_table, **nodes})


def tree_node(nodes: xr.DataTree, group: str) -> xr.Dataset:
    """Return the table of a node.

    Raises
    ------
    InputError
        Naming the nodes that there are.
    """
    if group.strip("/") not in nodes.children:
        raise InputError(f"the record has no group '{group}'; there are {', '.join(nodes.children)}")
    return nodes[group.strip("/")].to_dataset()


def _node_table(variables: dict[Any, Any], run: xr.Dataset) -> xr.Dataset:
    import xarray as xr

    made = xr.Dataset(variables)
    return made.set_coords([name for name in variables if name in run.coords])


def states_on_side(
    run: xr.Dataset, side: str, places: NDArray[np.int64], roles: Collection[str] = ON_SIDES
) -> dict[str, xr.Variable]:
    """Return the states in the rows ``before`` or ``after`` some events, along `event`, named as ``before_y``.

    Parameters
    ----------
    run : xarray.Dataset
    side : {"before", "after"}
    places : ndarray of int
        Of these rows in the record; what is at -1 is nan.
    roles : collection of str
        Of the variables that are wanted.
    """
    import xarray as xr

    states, missing = {}, places < 0
    for name, variable in run.variables.items():
        if variable.dims[:1] == (schema.STEPS,) and variable.attrs.get("role") in roles:
            # a copy, as nan is written into it; 0 in the place of -1, which would be the last row
            values = np.array(variable.isel({schema.STEPS: np.maximum(places, 0)}).values)
            values[missing] = np.nan
            described = attrs_of(str(variable.attrs["units"]), f"{name} {side} the event", str(variable.attrs["role"]))
            states[f"{side}_{name}"] = xr.Variable(
                (schema.EVENTS, *variable.dims[1:]), values, described, fastpath=True
            )
    return states
