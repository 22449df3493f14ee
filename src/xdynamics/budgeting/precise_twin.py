"""Rounding by the twin of a run: the same steps with numbers of 31 digits, whose number differs by rounding alone."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.budgeting.measurand import TIME, Measurand
from xdynamics.evidence.runs import march_model
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
    twin_settings = _twin_settings(run, measurand)
    with suppress(InputError):  # what a twin cannot have; the settings of the run itself are in order
        settings_for(measurand.model, **twin_settings)
        twin = march_model(measurand.model, **{"force_samples": "none"} | twin_settings)
        return abs(value - target.in_run(twin, measurand.model)[0])
    return None


def _twin_settings(run: xr.Dataset, measurand: Measurand) -> dict[str, Any]:
    """Return the settings of the twin: the run's own, with steps that are given where they were chosen."""
    settings = settings_for(measurand.model, **measurand.settings)
    twin_settings = measurand.settings | {"precision": DOUBLE_DOUBLE, "summation": PLAIN, "estimator": NO_ESTIMATE}
    if not settings.adaptive:
        return twin_settings
    steps, end_time = run["step_size"].values[run["step_size"].values > 0.0], float(run["time"][-1])
    if end_time < settings.until:  # stopped by an event, which the twin may meet a little later
        steps = np.append(steps, [steps.max(), settings.until - end_time])
    fixed_settings = {name: value for name, value in twin_settings.items() if name not in CHOOSING}
    order = {"order": settings.method.order} if settings.method.has_orders else {}
    return fixed_settings | {"step": steps} | order
