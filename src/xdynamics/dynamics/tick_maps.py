"""What ticks of controllers do to a small change of a run: derivatives of what they set, at times that do not move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.saltation import FlowStates
from xdynamics.dynamics.variational import NotVariedError, TickMaps, Variations
from xdynamics.model import Model
from xdynamics.model.controllers import actions, controller_states, exact_time, start_values, tick_changes, ticks
from xdynamics.model.motion import variables
from xdynamics.model.whole_numbers import with_whole_numbers
from xdynamics.units.rounded import exact_value

IntArray = NDArray[np.int64]
Floats = NDArray[np.float64]
ROUNDED = 4.0 * 2.0**-52  # of a time, by which a row may differ from its tick where units are scaled


def with_ticks(variations: Variations) -> Variations:
    """Return variational equations that pass through the ticks of a run.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    model = variations.equations.model
    if not model.controllers:
        return variations
    rows, masks = tick_rows(variations, model)
    names, inputs = variables(model), variations.equations.inputs
    n, width = len(names), len(names) + len(inputs)
    units = np.broadcast_to(np.eye(width)[:, None], (width, rows.size, width))
    input_changes = dict(zip(names, units, strict=False)) | {"t": np.zeros((rows.size, width))}
    input_changes |= {name: units[n + i] for i, name in enumerate(inputs) if name in model.statement.parameters}
    flow_before = FlowStates(model, _states_before_ticks(variations, rows), input_changes)
    maps = np.moveaxis(units[:n], 0, 1).copy()
    for change in tick_changes(model.controllers):
        acts = (masks >> change.action) & 1 == 1
        if acts.any():
            maps[acts, names.index(change.target)] = flow_before.change(
                with_whole_numbers(model.expanded(change.value))
            )[acts]
    return replace(variations, ticks=TickMaps(rows, maps[..., :n], maps[..., n:]))


def tick_rows(variations: Variations, model: Model) -> tuple[IntArray, IntArray]:
    """Return the rows of a run that begin with what a tick has set, and the actions at each, as bits of a number.

    Raises
    ------
    NotVariedError
        If an event is met at a tick.
    """
    times = np.asarray(variations.run["time"], float)
    instants, masks = ticks(
        actions(model.controllers), exact_time(model.statement.initial["t"]), exact_value(float(times[-1]))
    )
    rows = np.searchsorted(times, instants + ROUNDED * np.abs(instants), side="right") - 1
    marked = np.abs(times[rows] - instants) <= ROUNDED * np.abs(instants)
    rows, masks = rows[marked], masks[marked]
    if (twice := rows[(rows > 0) & (times[rows - 1] == times[rows])]).size:
        raise NotVariedError(f"an event is met at the tick at t = {times[twice[0]]:.6g}")
    return rows, masks


def _states_before_ticks(variations: Variations, rows: IntArray) -> dict[str, Floats]:
    """Return the states just before ticks: of the row itself, but for what controllers held in the row before."""
    model = variations.equations.model
    state, earlier, first = (
        variations.row(rows),
        variations.row(np.maximum(rows - 1, 0)),
        start_values(model.controllers),
    )
    for name in controller_states(model.controllers, model.time_unit):
        state[name] = np.where(rows == 0, first[name].si, earlier[name])
    return state
