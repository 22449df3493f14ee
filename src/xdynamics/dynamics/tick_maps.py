"""What ticks of controllers do to a small change of a run: derivatives of what they set, at times that do not move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.saltation import FlowStates
from xdynamics.dynamics.variational import NotVariedError, TickMaps, Variations
from xdynamics.model import Model
from xdynamics.model.controllers import actions, changes, exact_time, held, starts, ticks
from xdynamics.model.motion import variables
from xdynamics.model.whole_numbers import with_whole_numbers
from xdynamics.units.rounded import exact_value

Whole = NDArray[np.int64]
Floats = NDArray[np.float64]
ROUNDED = 4.0 * 2.0**-52  # of a time, by which a row may differ from its tick where units are scaled


def with_ticks(along: Variations) -> Variations:
    """Return variational equations that pass through the ticks of a run.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    model = along.equations.model
    if not model.controllers:
        return along
    rows, masks = tick_rows(along, model)
    names, inputs = variables(model), along.equations.inputs
    n, width = len(names), len(names) + len(inputs)
    units = np.broadcast_to(np.eye(width)[:, None], (width, rows.size, width))
    own = dict(zip(names, units, strict=False)) | {"t": np.zeros((rows.size, width))}
    own |= {name: units[n + i] for i, name in enumerate(inputs) if name in model.statement.parameters}
    before = FlowStates(model, _before(along, rows), own)
    maps = np.moveaxis(units[:n], 0, 1).copy()
    for change in changes(model.controllers):
        acts = (masks >> change.action) & 1 == 1
        if acts.any():
            maps[acts, names.index(change.target)] = before.change(with_whole_numbers(model.expanded(change.value)))[
                acts
            ]
    return replace(along, ticks=TickMaps(rows, maps[..., :n], maps[..., n:]))


def tick_rows(along: Variations, model: Model) -> tuple[Whole, Whole]:
    """Return the rows of a run that begin with what a tick has set, and the actions at each, as bits of a number.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    times = np.asarray(along.run["time"], float)
    instants, masks = ticks(
        actions(model.controllers), exact_time(model.statement.initial["t"]), exact_value(float(times[-1]))
    )
    rows = np.searchsorted(times, instants + ROUNDED * np.abs(instants), side="right") - 1
    marked = np.abs(times[rows] - instants) <= ROUNDED * np.abs(instants)
    rows, masks = rows[marked], masks[marked]
    if (twice := rows[(rows > 0) & (times[rows - 1] == times[rows])]).size:
        raise NotVariedError(f"an event is met at the tick at t = {times[twice[0]]:.6g}")
    return rows, masks


def _before(along: Variations, rows: Whole) -> dict[str, Floats]:
    """Return the states just before ticks: of the row itself, but for what controllers held in the row before."""
    model = along.equations.model
    state, earlier, first = along.row(rows), along.row(np.maximum(rows - 1, 0)), starts(model.controllers)
    for name in held(model.controllers, model.time_unit):
        state[name] = np.where(rows == 0, first[name].si, earlier[name])
    return state
