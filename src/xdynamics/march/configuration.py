"""Settings of a march from keyword arguments, with units, and the model's `[run]` defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fractions import Fraction
from math import isfinite
from typing import Any

import numpy as np

from xdynamics import schema
from xdynamics.elementary import NAME
from xdynamics.faults import InputError
from xdynamics.keywords import (
    FULL,
    KEYWORDS,
    PACING,
    STATES,
    keyword_hint,
    merge_settings,
    read_log_columns,
    read_number,
)
from xdynamics.march.settings import EARLIEST_FIRST, ENDS, FILIPPOV, JUDGED, TIME_TOLERANCE, Pacing, Settings
from xdynamics.march.tolerances import OF_TERMS, Tolerances, least_rtol
from xdynamics.methods import METHODS, Method, method_named, method_of
from xdynamics.methods.scheme import (
    COMPENSATED,
    DOUBLE_DOUBLE,
    EMBEDDED,
    FLOAT64,
    NO_ESTIMATE,
    PLAIN,
    STEP_DOUBLING,
    updates,
)
from xdynamics.methods.steppers import DIFFERENCES, EXACT
from xdynamics.methods.taylor import DEFAULT_ORDER, LEAST_ORDER, MOST_ORDER, order_for
from xdynamics.model import Model, check_model
from xdynamics.model.constraints import beyond_trees
from xdynamics.model.motion import variables
from xdynamics.model.sliding import may_slide_along_switches
from xdynamics.model.switches import (
    LANDED_ON,
    LOCATED,
    LOCATED_EVERYWHERE,
    STEPPED_OVER,
    landed_on,
    landed_on_by_default,
    watched_switches,
)
from xdynamics.units import UNSCALED, Quantity, Scales, Unit, is_number, parse_quantity, time_in, unit_text

FORCE_SAMPLES = ("all", "none")
DEFAULT_RTOL = 1e-6
MOST_LOGGED = 1000  # numbers of a state of a model with dimensions up to which all columns are logged
THINNING = ("keep_every", "log")  # settings that leave rows or columns out of a record
RECORDING: dict[str, Any] = {
    "keep_every": 1,
    "log": FULL,
    "compress": False,
}  # settings that concern the record alone, and their values for a complete one


def settings_for(model: Model, **requested_settings: Any) -> Settings:
    """Join the requested settings with the model's `[run]` defaults, and check them.

    Raises
    ------
    InputError
        If a setting is missing or wrong; the message names it.
    """
    check_model(model)
    if unknown := [name for name in requested_settings if name not in KEYWORDS]:
        raise InputError(f"there is no setting '{unknown[0]}'; {keyword_hint(unknown[0], tuple(KEYWORDS))}")
    merged = _join_with_run(model.run, {k: v for k, v in requested_settings.items() if v is not None})
    for key in ("method", "until"):
        if merged.get(key) is None:
            raise InputError(f"model '{model.name}' has no {key} in its [run]; give {key}=…")
    if merged["force_samples"] not in FORCE_SAMPLES:
        raise InputError(f"force_samples is {merged['force_samples']!r}; there are {', '.join(FORCE_SAMPLES)}")
    jacobian = str(merged.get("jacobian", EXACT))
    method = method_named(str(merged["method"]), model, METHODS, by_differences=jacobian == DIFFERENCES)
    step, scales = _step_setting(model, merged.get("step")), Scales.parse(merged["scales"])
    tolerances = _tolerance_settings(model, merged, scales)
    if step is None and tolerances is None:
        if not method.estimate:
            raise InputError(f"model '{model.name}' has no step in its [run]; give step=…, or rtol=… for chosen steps")
        tolerances = Tolerances(DEFAULT_RTOL, {}, _own_units(model, scales))
    order = KEYWORDS["order"].read(merged["order"], model.time_unit) if merged.get("order") is not None else None
    method = _method_of_order(method, order, tolerances, least_rtol(str(merged.get("precision"))))
    if tolerances is None:
        _refuse_pacing([key for key in PACING if key in merged])
    read = {name: KEYWORDS[name].read(value, model.time_unit) for name, value in merged.items() if value is not None}
    settings = Settings(
        method,
        read["until"],
        step,
        tolerances,
        _pacing_settings(read),
        read.get("estimator") or _default_estimator(method, tolerances),
        read["force_samples"] == "all",
        scales,
        _jacobian_source(jacobian, method, model),
        read.get("summation") or _default_summation(method, model, read.get("precision")),
        _node_times(model, read.get("nodes")),
        _switch_treatment(model, read.get("switches")),
        _event_time_tolerance(model, read),
        read.get("math_functions", NAME),
        read.get("keep_every", 1),
        _logged_columns(model, read.get("log", _default_log(model))),
        read.get("compress", False),
        read.get("event_root_method", EARLIEST_FIRST),
        "order" in read,
        read.get("precision", FLOAT64),
        read.get("event_start", JUDGED),
        read.get("atol_floor", OF_TERMS),
        _sliding_rule(model, read),
    )
    settings.check(model)
    return settings


def _sliding_rule(model: Model, read: Mapping[str, Any]) -> str:
    """Return what becomes of a motion that switches drive back: of a model that cannot slide, it ends."""
    requested = str(read.get("sliding", FILIPPOV))
    slides = may_slide_along_switches(model, str(read.get("switches", LOCATED)))
    return requested if slides or requested != FILIPPOV else ENDS


def _refuse_pacing(paced: list[str]) -> None:
    """Refuse limits of step control where steps are given."""
    if paced:
        raise InputError(
            f"{', '.join(paced)} {'is' if len(paced) == 1 else 'are'} for chosen steps, and the steps are given; give"
            " rtol or atol too"
        )


def _jacobian_source(requested_source: str, method: Method, model: Model) -> str:
    """Return where derivatives come from: differences, too, where constraints couple too many coordinates for trees."""
    return DIFFERENCES if beyond_trees(model) and DIFFERENCES in method.stepper.jacobians else requested_source


def _logged_columns(model: Model, requested_log: Any) -> str | tuple[str, ...]:
    """Return the columns that are recorded, elements by their numbers from the front."""
    log = read_log_columns(requested_log)
    if isinstance(log, str):
        return log
    return (*dict.fromkeys(model.shapes.internal_name(name, "log names") for name in log),)


def _default_log(model: Model) -> str:
    """Return the default log: of a large model with dimensions its states alone."""
    large = (
        bool(model.shapes.dims)
        and 2 * len(model.elements.statement.coordinates) + len(model.elements.statement.states) > MOST_LOGGED
    )
    return STATES if large else FULL


def unthinned_settings_for(model: Model, **requested_settings: Any) -> Settings:
    """Return the settings of a march that needs all rows and columns, also those that the model file leaves out.

    Raises
    ------
    InputError
        If rows or columns are to be left out, or a setting is missing or wrong.
    """
    if left := [name for name in THINNING if requested_settings.get(name) is not None]:
        raise InputError(
            f"{' and '.join(left)} {'is' if len(left) == 1 else 'are'} of `simulate` and `xdynamics run`: here all rows"
            " and columns of a run are needed"
        )
    return replace(settings_for(model, **requested_settings), **RECORDING)


def with_run(model: Model, section: Mapping[str, Any]) -> Model:
    """Return a model with other defaults as its `[run]`."""
    return model.with_statement(replace(model.statement, run=dict(section)))


def rerun(model: Model, **requested_settings: Any) -> Model:
    """Return a model whose `[run]` has some other settings."""
    provided_settings = {name: value for name, value in requested_settings.items() if value is not None}
    return with_run(model, merge_settings(model.run, provided_settings)) if provided_settings else model


def _join_with_run(defaults: Mapping[str, Any], requested: dict[str, Any]) -> dict[str, Any]:
    """Merge requested settings into those of `[run]`, over the defaults of both."""
    requested = {key: _in_unit_of(defaults.get(key), value) for key, value in requested.items()}
    return {"force_samples": "all", "scales": None} | merge_settings(defaults, requested)


def _in_unit_of(default: Any, value: Any) -> Any:
    """Give a text without a unit, as from a command line, the unit of the model file's value."""
    if isinstance(value, str) and isinstance(default, str) and is_number(value) and not is_number(default):
        return f"{value} {unit_text(default)}".strip()
    return value


def _step_setting(model: Model, value: Any) -> float | tuple[float, ...] | None:
    if value is None or isinstance(value, str | int | float):
        return None if value is None else time_in(model.time_unit, value, "step")
    try:
        steps = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(
            f"step is {str(value)[:60]!r}, needs a time like '1 ms', seconds, or a row of seconds"
        ) from None
    if steps.ndim == 0:
        return float(steps)
    if steps.ndim > 1:
        raise InputError(f"step has the shape {steps.shape}, needs one row of seconds")
    return tuple(steps[steps != 0.0].tolist())  # the row after an event has no step


def _node_times(model: Model, values: Any) -> tuple[float, ...]:
    """Return the times to land on, ascending."""
    if values is None:
        return ()
    if isinstance(values, str | int | float) or np.ndim(values) != 1:
        raise InputError(f"nodes are {str(values)[:60]!r}, need a row of times, like ['1 s', '2.5 s']")
    return tuple(sorted({time_in(model.time_unit, time, "nodes") for time in values}))


def _tolerance_settings(model: Model, joined_settings: Mapping[str, Any], scales: Scales) -> Tolerances | None:
    rtol, atol = joined_settings.get("rtol"), joined_settings.get("atol")
    if rtol is None and atol is None:
        return None
    relative = DEFAULT_RTOL if rtol is None else read_number(rtol, "rtol")
    units = _own_units(model, scales)
    if atol is None:
        return Tolerances(relative, {}, units)
    if isinstance(atol, Mapping) and not atol:
        raise InputError("atol is an empty mapping, needs a number or at least one name")
    if not isinstance(atol, Mapping):
        return Tolerances(relative, {}, units, read_number(atol, "atol"))
    # an element's own tolerance counts before that of its block, whichever is written first
    blocks = model.shapes.dims
    named_inside = model.shapes.with_internal_names(atol, "atol names")
    atol = dict(sorted(named_inside.items(), key=lambda entry: entry[0] not in blocks))
    firsts = {name: model.shapes.first(name) if name in blocks else name for name in atol if name}
    for name, first in firsts.items():
        if first not in units:
            raise InputError(f"atol names {name!r}; there are {_tolerance_names(model)}")
    atol_by_name = {name: _absolute_tolerance(units[first], name, atol[name]) for name, first in firsts.items()}
    return Tolerances(relative, atol_by_name, units, read_number(atol[""], "atol") if "" in atol else None)


def _tolerance_names(model: Model) -> str:
    """Return the names that may have a tolerance; of a block with one element as an example."""
    shaped = model.statement
    blocks = [*shaped.coordinates, *map(schema.velocity, shaped.coordinates), *shaped.states]
    examples = ((block, next(iter(model.shapes.elements(block)))) for block in blocks)
    return ", ".join(block if first == block else f"{block} and its elements, as {first}" for block, first in examples)


def _own_units(model: Model, scales: Scales) -> dict[str, Unit]:
    """Return the unit of a tolerance given without one: the variable's own, or that of the march's scales."""
    if scales == UNSCALED:
        return model.elements.units
    sizes = {name: model.elements.dimensions[name] for name in variables(model)}
    return {name: Unit("", dimension, Fraction(scales.si_factor(dimension))) for name, dimension in sizes.items()}


def _absolute_tolerance(unit: Unit, name: str, value: Any) -> float:
    """Read an absolute tolerance, SI; a number without a unit has the variable's own."""
    if not isinstance(value, str | Quantity):
        return _in_unit(unit, read_number(value, f"atol of '{name}'"))
    try:
        quantity = value if isinstance(value, Quantity) else parse_quantity(value)
    except InputError as error:
        raise InputError(f"atol of '{name}': {error}") from None
    if quantity.unit.text == "1":
        return _in_unit(unit, quantity.value)
    if quantity.unit.dimension != unit.dimension:
        raise InputError(f"atol of '{name}' is {value!r}, needs the unit '{unit.dimension}'")
    return quantity.si


def _in_unit(unit: Unit, value: float) -> float:
    return (
        unit.to_si(value) if isfinite(value) else value
    )  # values that are not finite are refused with the other faults


def _pacing_settings(read: Mapping[str, Any]) -> Pacing:
    return Pacing(**{key: read[key] for key in PACING if key in read})


def _default_estimator(method: Method, tolerances: Tolerances | None) -> str:
    """Return the default estimator."""
    if method.estimate:
        return EMBEDDED
    return NO_ESTIMATE if tolerances is None else STEP_DOUBLING


def _method_of_order(method: Method, order: int | None, tolerances: Tolerances | None, lowest_rtol: float) -> Method:
    """Return a method of the requested order, or of the order that its tolerance suits.

    Raises
    ------
    InputError
        If the method has one order, or none as low or as high.
    """
    if not method.has_orders:
        if order in (None, method.order):
            return method
        raise InputError(f"order is {order!r}, and '{method.name}' is of order {method.order}; order is for taylor")
    if order is None:
        # a tolerance that is out of range is refused with the other settings
        is_usable = tolerances is not None and lowest_rtol <= tolerances.rtol < 1
        order = order_for(tolerances.rtol) if tolerances is not None and is_usable else DEFAULT_ORDER
    if order < LEAST_ORDER:
        raise InputError(
            f"order is {order!r}, needs to be at least {LEAST_ORDER}: a step is chosen by the last two terms of the series,"
            " and a series of one is the method forward_euler"
        )
    if order > MOST_ORDER:
        raise InputError(
            f"order is {order!r}, needs to be at most {MOST_ORDER}: the last terms are rounding alone from"
            f" {order_for(lowest_rtol)} on, and longer series only let steps be longer"
        )
    return method_of(method.name, order)


def _event_time_tolerance(model: Model, read: Mapping[str, Any]) -> float:
    """Return the default time tolerance of events: 1 ps, or 1e-12 of a run shorter than a second."""
    if "time_tolerance" in read:
        return float(read["time_tolerance"])
    span = read["until"] - model.statement.initial["t"].si
    return TIME_TOLERANCE * (min(1.0, span) if span > 0.0 else 1.0)


def _switch_treatment(model: Model, choice: str | None) -> str:
    """Return how to treat hidden switches: located only if there are any, everywhere only if some are nested."""
    watched, tables = watched_switches(model), landed_on(model).values()
    if not choice:
        choice = LANDED_ON if landed_on_by_default(model) else LOCATED
    if choice == LANDED_ON and not tables:
        choice = LOCATED
    if choice == LOCATED_EVERYWHERE and not any(switch.nested for switch in watched):
        choice = LOCATED
    return STEPPED_OVER if choice == LOCATED and not watched else choice


def _default_summation(method: Method, model: Model, precision: str | None) -> str:
    """Return the default summation: compensated where rounding remains of the error, in long or tight runs."""
    if precision == DOUBLE_DOUBLE or (model.constraints and method.constrained_update):
        return PLAIN
    return COMPENSATED if (method.symplectic or method.stepper.compensates) and updates(method) else PLAIN
