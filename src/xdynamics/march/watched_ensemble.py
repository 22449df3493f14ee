"""Many runs, each by a march of its own: those that may slide along switches that are not located, and those with a past."""

from __future__ import annotations

from contextlib import closing
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels import Law
from xdynamics.march.ensemble_part import EnsemblePart, copy_log_start
from xdynamics.march.runner import March
from xdynamics.march.settings import Settings
from xdynamics.model import Model

ROWS = 1 << 12  # of a log, of which two are filled in turn


def march_watched(
    model: Model, settings: Settings, law: Law, inputs: tuple[NDArray[Any], ...], *, logs: bool
) -> EnsemblePart:
    """March runs one after the other, each as if alone: those that slide along a switch are ended, delays have their past.

    Parameters
    ----------
    model : Model
    settings : Settings
    law : Law
    inputs : tuple of ndarray
        Plan, start, parameters and absolute tolerances of every run, in internal units; see `inputs_of_runs`.
    logs : bool
        Whether to keep every row, or only the last states and the events.
    """
    part = EnsemblePart.empty(len(inputs[0]), law, inputs[2])
    for k, (plan, start, parameters, atols) in enumerate(zip(*inputs, strict=True)):
        march = March(model, settings)
        run = march.run
        run.plan[0], run.p[:], run.atol[:] = plan, parameters, atols
        run.y[: start.size] = start
        with closing(march.blocks(ROWS)) as blocks:
            for block in blocks:
                if block.rows:
                    part.lasts[k] = block.log.rows[:, block.rows - 1]
                part.logs.append(copy_log_start(block.log, block.rows if logs else 0, block.events))
                part.logs[-1].closed[:1] -= block.log.base[0]["rows"]
        part.ends[k], part.largest[k] = run.now[0], run.largest[: part.largest.shape[1]]
        part.passed[k] = run.w[run.w.size - part.passed.shape[1] :]
    return part
