"""What does not go with delayed values, and what to do about it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import expand, free_names, text_of
from xdynamics.faults import InputError
from xdynamics.march.past_arrays import delay_times
from xdynamics.methods.scheme import FLOAT64
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import drive_pieces
from xdynamics.units import unit_suffix


def check_alone(model: Model, settings: Any = None) -> None:
    """Check a model and settings for many runs at once: refuse delayed values, whose past is kept for one run alone.

    Raises
    ------
    InputError
    """
    if model.delays:
        raise InputError(
            f"the model '{model.name}' has delayed values, and many runs at once have no past of their own; simulate them one"
            " by one: simulate(model.replace(parameters={…}), …)"
        )
    if settings is not None:
        settings.check(model)
        model.require_functions()


def delay_faults(settings: Any, model: Model) -> list[str]:
    """List what settings ask for that a march with delayed values does not have."""
    if not model.delays:
        return []
    second = unit_suffix(model.time_unit)
    try:
        times = delay_times(model)
    except InputError as error:
        return [f"delays: {error}"]
    faults = [
        f"delay '{text_of(tree)}' is {float(time)!r}{second}, needs a positive time"
        for tree, time in zip(model.delays, times, strict=True)
        if not (np.isfinite(time) and time > 0.0)
    ]
    if faults:
        return faults
    return [
        *_long_step_faults(settings, float(times.min()), second),
        *_interpolation_faults(settings),
        *_state_change_faults(settings, model),
        *_short_table_faults(model, times, second),
    ]


def _long_step_faults(settings: Any, shortest: float, second: str) -> list[str]:
    """Refuse given steps beyond the shortest delay: they would read what they are about to find."""
    given_steps = settings.step if isinstance(settings.step, tuple) else (settings.step or 0.0,)
    longest = max((step for step in given_steps if isinstance(step, float | int)), default=0.0)
    if not longest > shortest * (1.0 + 1e-12):
        return []
    return [
        f"step is {longest!r}{second}, longer than the shortest delay of {shortest!r}{second}; take a step of at most that"
    ]


def _interpolation_faults(settings: Any) -> list[str]:
    """Refuse estimators by which steps are of a higher order than what they interpolate by."""
    method, scheme = settings.method, settings.scheme
    if scheme.order > scheme.interpolant.order + 1:
        estimated = f" with estimator = '{settings.estimator}'" if scheme.steps > 1 else ""
        left = f"errors of h**{scheme.interpolant.order + 1}, which would be all that is left of it"
        remedy = "take dop853 or dormand_prince with their embedded formulas, or a method of order 4 at most"
        subject = f"method '{method.name}'{estimated} is of order {scheme.order}"
        return [f"{subject}, and delayed values are interpolated with {left}; {remedy}"]
    return []


def _short_table_faults(model: Model, times: NDArray[np.float64], second: str) -> list[str]:
    """Refuse tables of time that end at their beginning, and do not reach back by their delays."""
    faults, start, tables = (
        [],
        model.statement.initial["t"].si,
        dict(zip(model.looked_up_at, drive_pieces(model), strict=True)),
    )
    for call in model.statement.delayed:
        delayed_tree, delay = (expand(part, model.definitions) for part in call.arguments)
        for name in sorted(free_names(delayed_tree) & {*model.drives}):
            first, earliest_time = float(tables[name][0][0]), start - float(times[model.delays.index(delay)])
            if model.drives[name].outside == "error" and model.looked_up_at[name] == CLOCK and first > earliest_time:
                faults.append(
                    f"the table of drive '{name}' begins at t = {first!r}{second}, and is read from t = {earliest_time!r}{second} on, by"
                    f" its delay '{text_of(delay)}'; begin it there, or give it outside = 'hold'"
                )
    return faults


def _state_change_faults(settings: Any, model: Model) -> list[str]:
    """Refuse what changes states behind steps, and numbers that are sums."""
    faults = []
    if model.constraints or model.bodies:
        owner = (
            f"constraint '{next(iter(model.constraints))}'"
            if model.constraints
            else f"body '{next(iter(model.bodies))}'"
        )
        faults.append(
            f"delayed values do not go with {owner}, by which states are moved after steps; write coordinates that need none"
        )
    if model.assemblies:
        faults.append(
            f"delayed values do not go with contact '{next(iter(model.assemblies))}' of many links; write single contacts"
        )
    if settings.precision != FLOAT64:
        faults.append(f"delayed values do not go with precision = {settings.precision!r}; take '{FLOAT64}'")
    return faults
