"""Rounding by the twin of a run: the same steps with numbers of 31 digits, whose number differs by rounding alone."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting.measurand import TIME, Measurand
from xdynamics.evidence.runs import march
from xdynamics.faults import InputError
from xdynamics.keywords import PACING
from xdynamics.march.configuration import settings_for
from xdynamics.methods.scheme import DOUBLE_DOUBLE, NO_ESTIMATE
from xdynamics.methods.summation import PLAIN

if TYPE_CHECKING:
    import xarray as xr

CHOOSING = ("rtol", "atol", "order", *PACING)  # settings by which steps are chosen, which the twin takes as they are


def twin_distance(run: xr.Dataset, measurand: Measurand, value: float) -> float | None:
    """March a run again with 31 digits by its own steps; return how far its number is from the twin's, in its unit.

    None where there is no twin, as of implicit methods, contacts and forces in Python, and for what is computed in
    floats in the twin too: energies, observables, forces, and extremes inside steps.
    """
    target = measurand.target
    if target.extreme is not None or target.quantity not in (*measurand.model.units, TIME):
        return None
    asked = _settings(run, measurand)
    with suppress(InputError):  # what a twin cannot have; the settings of the run itself are in order
        settings_for(measurand.model, **asked)
        twin = march(measurand.model, **{"force_samples": "none"} | asked)
        return abs(value - target.in_run(twin, measurand.model)[0])
    return None


def _settings(run: xr.Dataset, measurand: Measurand) -> dict[str, Any]:
    """Return the settings of the twin: the run's own, with steps that are given where they were chosen."""
    settings = settings_for(measurand.model, **measurand.settings)
    asked = measurand.settings | {"precision": DOUBLE_DOUBLE, "summation": PLAIN, "estimator": NO_ESTIMATE}
    if not settings.adaptive:
        return asked
    steps, reached = run["step_size"].values[run["step_size"].values > 0.0], float(run["time"][-1])
    if reached < settings.until:  # stopped by an event, which the twin may meet a little later
        steps = np.append(steps, [steps.max(), settings.until - reached])
    kept = {name: value for name, value in asked.items() if name not in CHOOSING}
    order = {"order": settings.method.order} if settings.method.has_orders else {}
    return kept | {"step": steps} | order
