"""Motion along a switch that is not located, as where there are too many: it passes to and fro in almost every step."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Layout
from xdynamics.march.outcomes import RUNNING, SLIDING_MODE
from xdynamics.march.run import Run
from xdynamics.model import Model
from xdynamics.model.motion import REGIME_NUMBER, constants, evaluated_many, tables_of
from xdynamics.model.switches import MOST_SWITCHES, Switch, switches
from xdynamics.units import TIME, Scales

STEPS = 64  # the last ones
OFTEN = 0.75  # of them: error control takes several steps for each passage of a motion that only oscillates


def unlocated(model: Model) -> tuple[Switch, ...]:
    """Return the switches at which a force jumps, if there are more than are located."""
    hidden = switches(model)
    return tuple(switch for switch in hidden if switch.jumps) if len(hidden) > MOST_SWITCHES else ()


def end_if_sliding(run: Run, model: Model, layout: Layout, scales: Scales, rows: NDArray[np.float64]) -> Switch | None:
    """End a march that passes a switch in almost every step: it would fill any memory on its way along the switch.

    Parameters
    ----------
    run : Run
    model : Model
    layout : Layout
    scales : Scales
    rows : ndarray, shape (m, k)
        Its last rows, of which time, step size and state come first.

    Returns
    -------
    Switch or None
        The switch, if there is one.
    """
    hidden = unlocated(model)
    if not run.plan[0].adaptive or run.now[0].status != RUNNING or not hidden or rows.shape[1] <= STEPS:
        return None
    last = rows[:, -STEPS - 1 :]
    state: dict[str, Any] = {"t": last[0] * scales.of(TIME), REGIME_NUMBER: float(run.now[0].regime)}
    factors = layout.sizes(scales).tolist()
    state |= {
        name: row * factor for name, row, factor in zip(layout.used, last[2 : 2 + len(factors)], factors, strict=True)
    }
    wanted = [model.expanded(switch.function) for switch in hidden]
    values = evaluated_many(model, wanted, state, constants(model), tables_of(model))
    for switch, numbers in zip(hidden, values, strict=True):
        side = np.broadcast_to(np.asarray(numbers) > 0.0, STEPS + 1)
        if np.count_nonzero(side[1:] != side[:-1]) >= OFTEN * STEPS:
            run.now[0].status = SLIDING_MODE
            return switch
    return None
