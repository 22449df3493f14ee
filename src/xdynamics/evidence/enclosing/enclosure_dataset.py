"""Proven bounds as one Dataset, with what was proven in a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.elementary import NAME
from xdynamics.evidence.enclosing.tube import EventBounds, Tube
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset, stated_value
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.record.column import About
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import AT, AT_TIME, ENCLOSURE, EVENT_DIRECTIONS, EVENTS, PROVEN, STEPS, bounds_of, flag_attributes
from xdynamics.tubes.boxes import Box, enclosed, multiply
from xdynamics.tubes.interval_problem import interval_names, unbounded
from xdynamics.units import UNSCALED, Unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

MODEL = "model_toml"
COMPLETED, NOT_PROVEN = "completed", "not_proven"


def enclosure_dataset(
    model: Model, tube: Tube, order: int, tolerance: float, occurrences: int | None = None
) -> xr.Dataset:
    """Return the evidence, with as many zeros of events as are to be listed."""
    axis, unit = (AT, AT_TIME) if tube.at_times else (STEPS, "time"), model.time_unit.text
    long_name = "time at which bounds were asked for" if tube.at_times else "time after a step"
    variables: dict[str, Any] = {axis[1]: ((axis[0],), tube.times, attrs_of(unit, long_name, "time"))}
    variables |= dict(_bound_variables(model, tube, axis[0]))
    variables |= dict(_event_bound_variables(model, tube, occurrences))
    later = _proof_statements(model, tube)
    variables |= {name: ((), np.array(value), attributes) for name, (value, attributes) in later.items()}
    variables[MODEL] = ((), np.array(model.to_toml()), attrs_of("1", "the whole model as TOML", "model"))
    attributes = {name: value for name, (value, _) in later.items()} | {
        PROVEN: 1,
        "solver_method": "Taylor series in intervals, carried as Lohner's set",
        "solver_order": order,
        "solver_rtol": tolerance,
        "precision": "intervals of float64, rounded outward",
        "math_functions": NAME,
        "model_digest": model.digest,
    }
    return evidence_dataset(ENCLOSURE, f"Proven bounds of {model.name}", [], variables, attributes, shapes=model.shapes)


def _proof_statements(model: Model, tube: Tube) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Return what is known of a proof only once it is made: variables, and attributes too."""
    suffix = unit_suffix(model.time_unit)
    where = f"up to t = {tube.reached!r}{suffix}, before the first motion stops at '{tube.stopped}'"
    ended = (
        f"no bounds are proven after t = {tube.reached!r}{suffix}: {tube.reason}"
        if tube.reason
        else f"proven {where if tube.stopped else f'to the end, t = {tube.reached!r}{suffix}'}, in {tube.steps} steps{_parts_text(tube)}"
    )
    statements: dict[str, tuple[Any, dict[str, Any]]] = {
        "summary": (proposition(model, tube), attrs_of("1", "what is proven", "rule")),
        "proven_until": (tube.reached, attrs_of(model.time_unit.text, "time up to which it is proven", "time")),
        "outcome": (NOT_PROVEN if tube.reason else COMPLETED, attrs_of("1", "outcome of the proof", "outcome")),
        "outcome_text": (ended, attrs_of("1", "why it went no further", "outcome")),
        "solver_steps": (tube.steps, attrs_of("1", "steps of the proof", "count")),
        "solver_parts": (tube.parts, attrs_of("1", "parts that the set was cut into", "count")),
    }
    if tube.events:
        proven = tube.reached if tube.reason else np.inf
        event_text = " ".join(_event_sentence(event, proven, suffix) for event in tube.events)
        statements["events_text"] = event_text, attrs_of("1", "what is known of zeros of events", "rule")
    return statements


def _parts_text(tube: Tube) -> str:
    return f" of {tube.parts} parts of the set" if tube.parts > 1 else ""


def proposition(model: Model, tube: Tube) -> str:
    """Say what is proven."""
    suffix, start = unit_suffix(model.time_unit), model.statement.initial["t"].si
    shown_intervals = interval_names(model)
    whose = (
        f"For every {', '.join(shown_intervals)} within its half_width, and all else as written"
        if shown_intervals
        else "As written"
    )
    text = (
        f"{whose}, the motion exists and is unique from t = {start!r}{suffix} to {tube.reached!r}{suffix}, and at every"
        f" time told here each quantity y lies between {' and '.join(bounds_of('y'))}."
    )
    if ignored := unbounded(model):
        text += f" Standard uncertainties, of {', '.join(ignored)}, are no bounds: the values alone count."
    if tube.changes:
        text += f" On the way events change every motion {tube.changes} times."
    if model.drives:
        text += " Times are floats here, and tables the polynomials of floats that runs look up."
    return text


def _bounded_units(model: Model) -> dict[str, Unit]:
    """Return the unit of everything that is bounded, in its order."""
    layout = layout_of(model)
    state_units = {name: model.units[name] for name in layout.used}
    units = About(layout, UNSCALED, None, samples=False).units
    derived = {name: units.derived(block) for block in layout.computed.blocks for name in block.elements()}
    return state_units | {name: derived[name] for name in layout.derived}


def _bound_variables(model: Model, tube: Tube, dim: str) -> Iterator[tuple[str, Any]]:
    """Yield lower and upper bounds of every quantity, in its own unit."""
    for i, (name, unit) in enumerate(_bounded_units(model).items()):
        yield from _bound_pair(name, dim, _bounds_in_unit(tube.bounds[:, :, i], unit), unit.text, name)


def _bound_pair(name: str, dim: str, bounds: Box, unit: str, quantity_text: str) -> Iterator[tuple[str, Any]]:
    for key, side, values in zip(bounds_of(name), ("lower", "upper"), bounds, strict=True):
        yield (key, ((dim,), values, attrs_of(unit, f"proven {side} bound of {quantity_text}", f"{side}_bound")))


def _event_bound_variables(model: Model, tube: Tube, occurrences: int | None) -> Iterator[tuple[str, Any]]:
    """Yield what is proven of events, in the order of their times; of those that are listed and not proven nan."""
    if not tube.events:
        return
    met = [(k, crossing) for k, event in enumerate(tube.events) for crossing in event.counted_crossings]
    met.sort(key=lambda pair: (pair[1].time[0], pair[1].time[1]))
    met = met[:occurrences]
    missing = 0 if occurrences is None else occurrences - len(met)
    names = [event.name for event in tube.events]
    times = _padded_intervals([crossing.time for _, crossing in met], missing)
    yield from _bound_pair("event_time", EVENTS, times, model.time_unit.text, "the time of the event")
    detectors = np.array([k for k, _ in met] + [-1] * missing, np.int8)
    none = occurrences is not None  # proven, of those that are listed
    words = ({-1: "none"} if none else {}) | dict(enumerate(names))
    directions = ({0: "none"} if none else {}) | EVENT_DIRECTIONS
    yield "event_detector", ((EVENTS,), detectors, attrs_of("1", "event", "flag") | flag_attributes(words))
    rising = np.array([1 if crossing.rising else -1 for _, crossing in met] + [0] * missing, np.int8)
    yield (
        "event_direction",
        ((EVENTS,), rising, attrs_of("1", "direction of the crossing", "flag") | flag_attributes(directions)),
    )
    for i, name in enumerate(layout_of(model).used):
        unit = model.units[name]
        states = _padded_intervals([crossing.state[:, i] for _, crossing in met], missing)
        yield from _bound_pair(
            f"event_{name}", EVENTS, _bounds_in_unit(states, unit), unit.text, f"{name} at the event"
        )


def _padded_intervals(intervals: list[Box], missing: int) -> Box:
    """Return the ends of intervals, then of as many that are not known."""
    return np.array([*intervals, *[np.full(2, np.nan)] * missing]).reshape(-1, 2).T


def _event_sentence(event: EventBounds, proven: float, suffix: str) -> str:
    """Say what is known of the zeros of an event up to a time."""
    crossings = event.crossings
    text = f"Every motion passes '{event.name}' {len(event.counted_crossings)} times in its direction"
    if crossings.unknown_from < np.inf:
        text += f" before t = {crossings.unknown_from!r}{suffix}, after which a zero could not be told from none"
    elif proven < np.inf:
        text += f" up to t = {proven!r}{suffix}"
    if (until := crossings.begun_until) > -np.inf:
        text += f"; it may be zero at the start, or pass zero before t = {until!r}{suffix}, which is not counted"
    return text + "."


def _bounds_in_unit(bounds: Box, unit: Unit) -> Box:
    """Return bounds in SI units in another unit, rounded outward."""
    return bounds if unit.factor == 1 else multiply(bounds, enclosed(1 / Fraction(unit.factor))[:, None])


def enclosure_lines(enclosure: xr.Dataset) -> list[str]:
    """Say what is proven, the last bounds, and those of events."""
    lines = [f"proven    {stated_value(enclosure, 'summary')}", f"ended     {stated_value(enclosure, 'outcome_text')}"]
    dim, time = (AT, AT_TIME) if AT_TIME in enclosure.variables else (STEPS, "time")
    unit = unit_suffix(str(enclosure[time].attrs["units"]))
    names = bounded_names(enclosure, dim)
    firsts = [enclosure[bounds_of(name)[0]].values.reshape(enclosure.sizes[dim], -1)[:, 0] for name in names]
    if (known_rows := np.flatnonzero(~np.isnan(firsts).any(axis=0))).size:
        last = enclosure.isel({dim: int(known_rows[-1])})
        lines.append(f"bounds    at t = {float(last[time])!r}{unit}")
        lines += [f"  {name:<8}  {_interval_text(last, name)}" for name in names]
    for k in range(enclosure.sizes.get(EVENTS, 0)):
        event = enclosure.isel({EVENTS: k})
        if (word := words_of_flag(event["event_detector"])[0]) != "none":
            lines.append(f"event     {word}: t from {_interval_text(event, 'event_time')}")
    return [*lines, *(f"events    {text}" for text in (stated_value(enclosure, "events_text"),) if text)]


def bounded_names(enclosure: xr.Dataset, dim: str) -> list[str]:
    """Name what has bounds along a dimension."""
    prefix, _ = bounds_of("")
    return [
        str(name).removeprefix(prefix)
        for name, variable in enclosure.data_vars.items()
        if str(name).startswith(prefix) and dim in variable.dims
    ]


def _interval_text(row: xr.Dataset, name: str) -> str:
    """Write two bounds and how far they are apart, or of many this alone."""
    low, high = (row[bound] for bound in bounds_of(name))
    width, unit = float((high - low).max()), unit_suffix(str(low.attrs["units"]))
    if low.ndim:
        return f"{low.size} of width {width:.2g}{unit}"
    return f"{float(low)!r} to {float(high)!r}{unit}, {width:.2g} wide"


SUMMARIES = {ENCLOSURE: enclosure_lines}
