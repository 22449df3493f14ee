"""The arguments of `simulate` that a record was made with, recovered from its attributes.

A verb that is given a run before its march reads the settings of the future run.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.elementary import kept_set
from xdynamics.faults import InputError
from xdynamics.keywords import FULL, KEYWORDS
from xdynamics.march.control import FIRST_STEP, FORESEEN
from xdynamics.march.settings import ENDS, ONE_BY_ONE, ROOT_METHODS, WAITING
from xdynamics.march.tolerances import ATOL_FLOORS, NO_FLOOR
from xdynamics.methods.scheme import FLOAT64, PLAIN, STEP_DOUBLING
from xdynamics.model.switches import LOCATED, LOCATED_EVERYWHERE, STEPPED_OVER
from xdynamics.record.folding import is_chunked
from xdynamics.record.schemas import left_out_atols
from xdynamics.record.unfolding import unfold
from xdynamics.schema import EVIDENCE, RAGGED, STAGE
from xdynamics.units import SECONDS, Quantity, Scales, Unit, parse_unit
from xdynamics.units.unit import Rounded

if TYPE_CHECKING:
    import xarray as xr

EVERYWHERE = "everywhere"
SCALES = {"length": "m", "time": SECONDS.text, "mass": "kg"}  # units of the scales of nondimensional variables


def recorded_scales(run: xr.Dataset) -> Scales:
    """Return the scales of the nondimensional variables that a run was marched in."""
    recorded = {name: run.attrs.get(f"solver_{name}_scale") for name in SCALES}
    return Scales.parse(
        {name: f"{float(value)!r} {SCALES[name]}" for name, value in recorded.items() if value is not None} or None
    )


def recorded_arguments(run: xr.Dataset) -> dict[str, Any]:
    """Return the arguments of `simulate` that a record was made with."""
    recorded = run.attrs
    scales = {
        name: f"{float(recorded[f'solver_{name}_scale'])!r} {unit}"
        for name, unit in SCALES.items()
        if f"solver_{name}_scale" in recorded
    }
    arguments = {
        name: keyword.read(_plain_attribute(recorded[keyword.attribute]), SECONDS)
        for name, keyword in KEYWORDS.items()
        if keyword.attribute in recorded
    }
    arguments |= {
        "scales": scales or None,
        "summation": recorded.get("solver_summation", PLAIN),  # version 0.1 had no other
        "precision": precision_of(recorded),
        "switches": _switches_asked(recorded),
        "math_functions": kept_set(recorded.get("math_functions")),
        "event_root_method": root_method_of(recorded),
        "event_start": recorded.get("solver_event_start", WAITING),
        "sliding": recorded.get("solver_sliding", ENDS),
        "atol_floor": atol_floor_of(recorded) if "solver_atol_rule" in recorded else None,
        "keep_every": int(recorded[schema.KEEP_EVERY]) if schema.KEEP_EVERY in recorded else None,
        "log": _log_asked(recorded),
        "compress": True if schema.COMPRESSION in recorded else None,
    }
    if recorded.get(schema.ORDER_CHOICE) == schema.GIVEN:
        arguments["order"] = int(recorded["solver_order"])
    if "nodes" in arguments:
        arguments["nodes"] = np.atleast_1d(arguments["nodes"]).tolist()
    if schema.GIVEN_STEP.name in run:
        arguments["step"] = np.asarray(run[schema.GIVEN_STEP.name])
    elif "solver_step" in recorded:
        arguments["step"] = float(recorded["solver_step"])
    if "solver_rtol" in recorded:
        arguments |= _recorded_tolerances(run)
    arguments |= _exact_times(recorded, arguments)
    if recorded["solver_step_control"] == "adaptive":
        if recorded["solver_first_step_choice"] not in (
            FIRST_STEP,
            FORESEEN,
        ):  # given, or chosen by the rule of another version
            arguments["step"] = float(recorded["solver_first_step"])
        if _asked_longest(run):
            arguments["max_step"] = float(recorded["solver_max_step"])
    return arguments


def _plain_attribute(value: Any) -> Any:
    """Return an attribute as a plain value: a word, a number, a row of numbers."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _switches_asked(used: dict[str, Any]) -> str:
    """Return the treatment of switches that a record reports."""
    choice = str(used.get("solver_switches", STEPPED_OVER))  # records from before this setting stepped over them
    # version 0.2 did not record where it looked for them: it was everywhere
    everywhere = used.get("solver_switches_watched", EVERYWHERE) == EVERYWHERE
    return LOCATED_EVERYWHERE if choice == LOCATED and everywhere else choice


def root_method_of(used: Mapping[str, Any]) -> str:
    """Return how events of a record, or of the members of a sweep, were located; version 0.2 had one way."""
    words = {text: name for name, text in ROOT_METHODS.items()}
    return words.get(str(used.get("solver_event_root_method")), ONE_BY_ONE)


def atol_floor_of(used: Mapping[str, Any]) -> str:
    """Return the floor of tolerances that follow of a record, or of the members of a sweep; older ones have none."""
    words = {text: name for name, text in ATOL_FLOORS.items()}
    return words.get(str(used.get(schema.ATOL_FLOOR_RULE)), NO_FLOOR)


def _exact_times(recorded: Mapping[Any, Any], arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Return times that are more than floats, of records whose numbers are sums of two."""
    exact = dict[str, Any]()
    for name, attribute in (("until", "solver_until"), ("step", "solver_step"), ("nodes", "solver_nodes")):
        if (recorded_rest := recorded.get(schema.rest_name(attribute))) is not None:
            values = [
                _float_with_rest(value, left)
                for value, left in zip(*map(np.atleast_1d, (arguments[name], recorded_rest)), strict=True)
            ]
            exact[name] = values if name == "nodes" else values[0]
    return exact


def _float_with_rest(value: float, remainder: float) -> float:
    """Return a float that knows its exact number, the sum of float and rest."""
    return Rounded.from_exact(Fraction(float(value)) + Fraction(float(remainder)), float(value))


def precision_of(used: Mapping[Any, Any]) -> str:
    """Return the kind of numbers of a record, the first word of its attribute `precision`."""
    return str(used.get("precision", FLOAT64)).partition(",")[0]


def _log_asked(used: Mapping[Any, Any]) -> str | list[str]:
    """Return the choice of log columns that a record was made with."""
    if schema.LOG not in used:
        return FULL
    return str(used.get(schema.LOGGED, "")).split() if used[schema.LOG] == schema.CHOSEN else str(used[schema.LOG])


def _asked_longest(run: xr.Dataset) -> bool:
    """Whether the caller gave a longest step."""
    if "solver_max_step_choice" in run.attrs:
        return str(run.attrs["solver_max_step_choice"]) == "given"
    # version 0.1 did not say
    span = float(run.attrs["solver_until"]) - float(run["time"][0]) if "time" in run.variables else np.nan
    return float(run.attrs["solver_max_step"]) != span


def _recorded_tolerances(run: xr.Dataset) -> dict[str, Any]:
    """Return the tolerances of a record's march; those that followed their variables are left to follow again."""
    rtol, rescaling = float(run.attrs["solver_rtol"]), 1.0
    if run.attrs["solver_estimator"] == STEP_DOUBLING and "solver_rtol_used" not in run.attrs:
        # version 0.1 judged by the given rtol: give the one that is rescaled to it
        order = int(run.attrs["solver_order"])
        rescaling = rtol ** (order / (order + 1)) / rtol
    variables_with_atol = {name: variable for name, variable in run.variables.items() if "atol_si" in variable.attrs}
    if any(
        np.ndim(candidate.attrs["atol_si"]) or schema.ATOL_FOLLOWING in candidate.attrs
        for candidate in variables_with_atol.values()
    ):
        variables_with_atol = dict(unfold(run).variables)  # not one number for all elements
    atol = {
        str(name): Quantity(
            rescaling * float(variable.attrs["atol_si"]), Unit("SI", parse_unit(variable.attrs["units"]).dimension)
        )
        for name, variable in variables_with_atol.items()
        if "atol_si" in variable.attrs and schema.ATOL_RULE not in variable.attrs
    }
    for name, (size, units) in left_out_atols(run.attrs).items():
        atol[name] = Quantity(rescaling * size, Unit("SI", parse_unit(units).dimension))
    return {"rtol": rescaling * rtol, "atol": atol or None}


def is_unmarched(run: Any) -> bool:
    """Whether a Dataset is what `simulate` or `ragged` returned with ``compute=False``, or made from that."""
    # not imported for this question, which takes over a second: without dask in memory nothing is lazy
    if "dask" not in sys.modules or STAGE not in (getattr(run, "encoding", None) or ()):
        return False
    return EVIDENCE not in run.attrs or (run.attrs[EVIDENCE] == RAGGED and any(map(is_chunked, run.variables.values())))


def march_argument(argument: Any) -> Any:
    """March a run that is still to be marched; return anything else as it is.

    Raises
    ------
    InputError
        If only a part of the run is left, or it was changed: there is no whole record of that.
    """
    if isinstance(argument, Mapping) and not hasattr(argument, "variables"):
        return {key: march_argument(value) for key, value in argument.items()}
    if not is_unmarched(argument):
        return argument
    run = argument.encoding[STAGE].computed(argument)
    if run is None:
        raise InputError(
            "this is a part of a run that is still to be computed, or was computed or changed by other means than these"
            " verbs; give them the run as simulate(…, compute=False) returned it, or run with compute=True"
        )
    return run


def marching(verb: Callable[..., Any]) -> Callable[..., Any]:
    """Let a verb take runs that are still to be marched; with ``compute=False`` it marches none itself."""

    @wraps(verb)
    def marching_call(*arguments: Any, **keywords: Any) -> Any:
        if "dask" not in sys.modules or keywords.get("compute") is False:
            return verb(*arguments, **keywords)
        return verb(*map(march_argument, arguments), **{key: march_argument(value) for key, value in keywords.items()})

    return marching_call
