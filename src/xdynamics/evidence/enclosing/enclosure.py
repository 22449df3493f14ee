"""Proven bounds of all motions of a model, over all its starts and all values of its constants.

The bounds are one Dataset, with a sentence that states what was proven.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.dynamics.recorded_steps import wanted_times
from xdynamics.elementary import NAME
from xdynamics.evidence.enclosing.tube import EventBounds, Tube, join_tubes, prove_tube, split_box, unproven
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset, stated_value
from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import Stage, requested_count
from xdynamics.faults import InputError
from xdynamics.kernels.layout import layout_of
from xdynamics.keywords import read_number
from xdynamics.model import Model, check_model
from xdynamics.record.column import ColumnContext
from xdynamics.record.flag_words import words_of_flag
from xdynamics.tubes import Flow, interval_problem_of
from xdynamics.tubes.boxes import Box, enclosed, multiply
from xdynamics.tubes.interval_problem import interval_names, unbounded
from xdynamics.units import UNSCALED, Unit, time_in, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

MODEL = "model_toml"
COMPLETED, NOT_PROVEN = "completed", "not_proven"


def enclosure_dataset(
    model: Model, tube: Tube, order: int, tolerance: float, occurrences: int | None = None
) -> xr.Dataset:
    """Return the evidence, with as many zeros of events as are to be listed."""
    axis, unit = (schema.AT, schema.AT_TIME) if tube.at_times else (schema.STEPS, "time"), model.time_unit.text
    long_name = "time at which bounds were asked for" if tube.at_times else "time after a step"
    variables: dict[str, Any] = {axis[1]: ((axis[0],), tube.times, attrs_of(unit, long_name, "time"))}
    variables |= dict(_bound_variables(model, tube, axis[0]))
    variables |= dict(_event_bound_variables(model, tube, occurrences))
    later = _proof_statements(model, tube)
    variables |= {name: ((), np.array(value), attributes) for name, (value, attributes) in later.items()}
    variables[MODEL] = ((), np.array(model.to_toml()), attrs_of("1", "the whole model as TOML", "model"))
    attributes = {name: value for name, (value, _) in later.items()} | {
        schema.PROVEN: 1,
        "solver_method": "Taylor series in intervals, carried as Lohner's set",
        "solver_order": order,
        "solver_rtol": tolerance,
        "precision": "intervals of float64, rounded outward",
        "math_functions": NAME,
        "model_digest": model.digest,
    }
    return evidence_dataset(
        schema.ENCLOSURE, f"Proven bounds of {model.name}", [], variables, attributes, shapes=model.shapes
    )


def _proof_statements(model: Model, tube: Tube) -> dict[str, tuple[Any, dict[str, Any]]]:
    """Return the variables and attributes that are known only after a proof."""
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
    """State the proven proposition in a sentence."""
    suffix, start = unit_suffix(model.time_unit), model.statement.initial["t"].si
    shown_intervals = interval_names(model)
    whose = (
        f"For every {', '.join(shown_intervals)} within its half_width, and all else as written"
        if shown_intervals
        else "As written"
    )
    text = (
        f"{whose}, the motion exists and is unique from t = {start!r}{suffix} to {tube.reached!r}{suffix}, and at every"
        f" time told here each quantity y lies between {' and '.join(schema.bounds_of('y'))}."
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
    state_units = {name: model.elements.units[name] for name in layout.used}
    units = ColumnContext(layout, UNSCALED, None, samples=False).units
    derived = {name: units.derived(block) for block in layout.computed.blocks for name in block.elements()}
    return state_units | {name: derived[name] for name in layout.derived}


def _bound_variables(model: Model, tube: Tube, dim: str) -> Iterator[tuple[str, Any]]:
    """Yield lower and upper bounds of every quantity, in its own unit."""
    for i, (name, unit) in enumerate(_bounded_units(model).items()):
        yield from _bound_pair(name, dim, _bounds_in_unit(tube.bounds[:, :, i], unit), unit.text, name)


def _bound_pair(name: str, dim: str, bounds: Box, unit: str, quantity_text: str) -> Iterator[tuple[str, Any]]:
    for key, side, values in zip(schema.bounds_of(name), ("lower", "upper"), bounds, strict=True):
        yield (key, ((dim,), values, attrs_of(unit, f"proven {side} bound of {quantity_text}", f"{side}_bound")))


def _event_bound_variables(model: Model, tube: Tube, occurrences: int | None) -> Iterator[tuple[str, Any]]:
    """Yield proven bounds of events in the order of their times; unproven occurrences are nan."""
    if not tube.events:
        return
    met = [(k, crossing) for k, event in enumerate(tube.events) for crossing in event.counted_crossings]
    met.sort(key=lambda pair: (pair[1].time[0], pair[1].time[1]))
    met = met[:occurrences]
    missing = 0 if occurrences is None else occurrences - len(met)
    names = [event.name for event in tube.events]
    times = _padded_intervals([crossing.time for _, crossing in met], missing)
    yield from _bound_pair("event_time", schema.EVENTS, times, model.time_unit.text, "the time of the event")
    detectors = np.array([k for k, _ in met] + [-1] * missing, np.int8)
    none = occurrences is not None  # proven, of those that are listed
    words = ({-1: "none"} if none else {}) | dict(enumerate(names))
    directions = ({0: "none"} if none else {}) | schema.EVENT_DIRECTIONS
    yield (
        "event_detector",
        ((schema.EVENTS,), detectors, attrs_of("1", "event", "flag") | schema.flag_attributes(words)),
    )
    rising = np.array([1 if crossing.rising else -1 for _, crossing in met] + [0] * missing, np.int8)
    yield (
        "event_direction",
        (
            (schema.EVENTS,),
            rising,
            attrs_of("1", "direction of the crossing", "flag") | schema.flag_attributes(directions),
        ),
    )
    for i, name in enumerate(layout_of(model).used):
        unit = model.elements.units[name]
        states = _padded_intervals([crossing.state[:, i] for _, crossing in met], missing)
        yield from _bound_pair(
            f"event_{name}", schema.EVENTS, _bounds_in_unit(states, unit), unit.text, f"{name} at the event"
        )


def _padded_intervals(intervals: list[Box], missing: int) -> Box:
    """Return the ends of intervals, then of as many that are not known."""
    return np.array([*intervals, *[np.full(2, np.nan)] * missing]).reshape(-1, 2).T


def _event_sentence(event: EventBounds, proven: float, suffix: str) -> str:
    """State how often every motion passes an event, and up to which time that is proven."""
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
    """Return the proposition, the last bounds, and the bounds of events as lines of text."""
    lines = [f"proven    {stated_value(enclosure, 'summary')}", f"ended     {stated_value(enclosure, 'outcome_text')}"]
    dim, time = (schema.AT, schema.AT_TIME) if schema.AT_TIME in enclosure.variables else (schema.STEPS, "time")
    unit = unit_suffix(str(enclosure[time].attrs["units"]))
    names = bounded_names(enclosure, dim)
    firsts = [enclosure[schema.bounds_of(name)[0]].values.reshape(enclosure.sizes[dim], -1)[:, 0] for name in names]
    if (known_rows := np.flatnonzero(~np.isnan(firsts).any(axis=0))).size:
        last = enclosure.isel({dim: int(known_rows[-1])})
        lines.append(f"bounds    at t = {float(last[time])!r}{unit}")
        lines += [f"  {name:<8}  {_interval_text(last, name)}" for name in names]
    for k in range(enclosure.sizes.get(schema.EVENTS, 0)):
        event = enclosure.isel({schema.EVENTS: k})
        if (word := words_of_flag(event["event_detector"])[0]) != "none":
            lines.append(f"event     {word}: t from {_interval_text(event, 'event_time')}")
    return [*lines, *(f"events    {text}" for text in (stated_value(enclosure, "events_text"),) if text)]


def bounded_names(enclosure: xr.Dataset, dim: str) -> list[str]:
    """Name the quantities with bounds along a dimension."""
    prefix, _ = schema.bounds_of("")
    return [
        str(name).removeprefix(prefix)
        for name, variable in enclosure.data_vars.items()
        if str(name).startswith(prefix) and dim in variable.dims
    ]


def _interval_text(row: xr.Dataset, name: str) -> str:
    """Write two bounds and how far they are apart, or of many this alone."""
    low, high = (row[bound] for bound in schema.bounds_of(name))
    width, unit = float((high - low).max()), unit_suffix(str(low.attrs["units"]))
    if low.ndim:
        return f"{low.size} of width {width:.2g}{unit}"
    return f"{float(low)!r} to {float(high)!r}{unit}, {width:.2g} wide"


SUMMARIES = {schema.ENCLOSURE: enclosure_lines}


DEFAULT_RTOL, LEAST_RTOL, LARGEST_RTOL = 1e-16, 1e-20, 1e-3
LEAST_ORDER, MOST_ORDER = 3, 60
MOST_STEPS = 100_000
MOST_PARTS = 10_000
Time = str | float


def enclose(
    model: Model,
    *,
    until: Time | None = None,
    at: Sequence[Time] | Time | None = None,
    rtol: float | None = None,
    order: int | None = None,
    max_steps: int | None = None,
    parts: int | None = None,
    occurrences: int | None = None,
    compute: bool = True,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Prove bounds of every motion of a model.

    Parameters
    ----------
    model : Model
        Smooth between the points of its tables, which are of time, and of first or second order. Values at the start and
        parameters with a `half_width` are intervals, all others the numbers that are written; pieces of tables are the
        polynomials of floats that runs look up. Events may record, switch, reset or stop.
    until : str or float
        Time up to which to prove; by default the last of `at`, else that of the model's `[run]`.
    at : times, optional
        Times at which bounds are wanted, like ``["1 s", "2 s"]`` or ``"0:10:101 s"``; by default those after each step.
    rtol : float
        What a step may add by truncation, relative to the largest values so far; by default 1e-16, a rounding.
    order : int
        Of the Taylor polynomials, from 3 to 60; by default ceil(1 - ln(rtol)/2), as for `taylor`: 20.
    max_steps : int
        Steps after which the proof ends; 100,000 by default.
    parts : int, optional
        Into how many parts to cut a wide set of starts and parameters, each cut being through the middle of what is widest
        beside its size: bounds of each part are proven, which are narrower, and joined. It needs `at`; 1 by default.
    occurrences : int, optional
        How many zeros of events to list, the first ones; where fewer are proven, the last are nan. By default all.
    compute : bool
        Whether to prove at once. If False, the Dataset has dask arrays, with one task for the whole proof. It needs `at`
        then, and of a model with events that record `occurrences`.
    progress : callable, optional
        Called with the fraction done, the time and the number of steps.

    Returns
    -------
    xarray.Dataset
        Along `step`, or `at` where times are given: `lower_y` and `upper_y` of every coordinate, velocity, state, energy and
        observable, and `time`, or `at_time`. Along `event`, in order: `lower_event_time` and `upper_event_time` of every
        zero that all motions pass, `event_detector`, `event_direction`, and `lower_event_y` and `upper_event_y`, which hold
        each motion at its own zero. The attribute `proven` is 1; `summary` says what was proven, `proven_until` up to which
        time. Where no further step can be proven, `outcome` is `not_proven`, `outcome_text` says why, and bounds at later
        times are nan; `events_text` says where a zero could not be told from none, as of a function that touches zero.

    Raises
    ------
    InputError
        If the model has what no bounds are proven of: impacts, forces in Python, tables of the motion; or a setting is wrong.

    Notes
    -----
    Every operation is rounded outward, and every step proves that the motions exist and are unique: Taylor polynomials whose
    remainder is taken over a box that no motion leaves (Corliss and Rihm 1996), their dependence on the start by their
    derivatives over the whole set (Lohner 1987), the set as the image of the starts and a box in a frame that turns with
    the flow (Mrozek and Zgliczynski 2000; Nedialkov, Jackson, Corliss 1999, doi:10.1016/S0096-3003(98)10083-8).

    An event acts where every motion is proven to pass it once, in an interval of times. By its end the set has grown by the
    length of the interval times the jump of the rates. Where it is not proven that all pass, as of a set of which some
    motions turn back before, where a function touches zero, or where two events may act in either order, the proof ends, and
    says why. Events of the same function act together.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> tube = enclose(model, at=["1 s"])
    >>> bool(tube.lower_x[0] < tube.upper_x[0]), float(tube.upper_x[0] - tube.lower_x[0]) < 1e-13
    (True, True)
    """
    request = enclosure_request(
        model, until=until, at=at, rtol=rtol, order=order, max_steps=max_steps, parts=parts, occurrences=occurrences
    )
    return request.computed(progress) if compute else request.stage().result(compute=False)


@dataclass(frozen=True)
class EnclosureRequest:
    """The arguments of `enclose`, checked.

    Attributes
    ----------
    model : Model
    end : float, s
    times : tuple of float, s, optional
    order : int
    tolerance : float
    max_steps : int
        Steps.
    parts : int
        Of the set of starts.
    occurrences : int, optional
    """

    model: Model
    end: float
    times: tuple[float, ...] | None
    order: int
    tolerance: float
    max_steps: int
    parts: int
    occurrences: int | None

    def computed(self, progress: Progress | None = None) -> xr.Dataset:
        """Return the proven bounds of the motion as a Dataset."""
        flow = Flow(interval_problem_of(self.model), self.order, self.tolerance)
        tubes = [
            prove_tube(self.model, flow.with_starts(start), self.end, self.times, self.max_steps, progress)
            for start in split_box(flow.problem.start, self.parts)
        ]
        return enclosure_dataset(self.model, join_tubes(tubes), self.order, self.tolerance, self.occurrences)

    def task(self) -> Task:
        """Return the task that proves."""
        request_words = (self.end, self.times, self.order, self.tolerance, self.max_steps, self.parts, self.occurrences)
        return Task.of("enclosure", self.computed, (), self.model.digest, request_words)

    def stage(self) -> Stage:
        """Return the bounds before they are proven.

        Raises
        ------
        InputError
            If their number is not known, or no bounds are proven of the model.
        """
        interval_problem_of(self.model)
        if self.times is None:
            raise InputError(
                "how many steps a proof takes is not known in advance; give the times of bounds, like at=['1 s']"
            )
        tube = unproven(self.model, self.times)
        if tube.events and self.occurrences is None:
            raise InputError(
                f"how often '{tube.events[0].name}' is met is not known in advance; give the number to list, like occurrences=10"
            )
        template = partial(enclosure_dataset, self.model, tube, self.order, self.tolerance, self.occurrences)
        return Stage(self.task(), template, (schema.AT_TIME, MODEL))


def enclosure_request(
    model: Model,
    *,
    until: Any = None,
    at: Any = None,
    rtol: Any = None,
    order: Any = None,
    max_steps: Any = None,
    parts: Any = None,
    occurrences: Any = None,
) -> EnclosureRequest:
    """Read and check the arguments of `enclose`.

    Raises
    ------
    InputError
        If one is wrong.
    """
    check_model(model)
    tolerance = _checked_tolerance(rtol)
    degree, step_limit = _taylor_order(order, tolerance), _max_steps(max_steps)
    start, times = model.statement.initial["t"].si, None if at is None else _bound_times(at, model)
    end = _proof_end(until, times, model)
    for time in times or ():
        if not start <= time <= end:
            suffix = unit_suffix(model.time_unit)
            raise InputError(
                f"at has {time!r}{suffix}, and the enclosure goes from {start!r}{suffix} to {end!r}{suffix}"
            )
    count = _part_count(parts, has_times=times is not None)
    listed_count = requested_count(occurrences, "occurrences")
    return EnclosureRequest(
        model, end, None if times is None else tuple(times), degree, tolerance, step_limit, count, listed_count
    )


def _checked_tolerance(rtol: Any) -> float:
    tolerance = DEFAULT_RTOL if rtol is None else read_number(rtol, "rtol")
    if not LEAST_RTOL <= tolerance <= LARGEST_RTOL:
        raise InputError(f"rtol is {rtol!r}, needs a number from {LEAST_RTOL:g} to {LARGEST_RTOL:g}")
    return tolerance


def _taylor_order(order: Any, tolerance: float) -> int:
    if order is None:
        return int(np.ceil(1.0 - np.log(tolerance) / 2.0))
    if (
        isinstance(order, bool)
        or not read_number(order, "order").is_integer()
        or not LEAST_ORDER <= order <= MOST_ORDER
    ):
        raise InputError(f"order is {order!r}, needs a whole number from {LEAST_ORDER} to {MOST_ORDER}")
    return int(order)


def _max_steps(steps: Any) -> int:
    if steps is None:
        return MOST_STEPS
    if isinstance(steps, bool) or not read_number(steps, "max_steps").is_integer() or steps < 1:
        raise InputError(f"max_steps is {steps!r}, needs a positive whole number")
    return int(steps)


def _part_count(parts: Any, *, has_times: bool) -> int:
    if parts is None:
        return 1
    if isinstance(parts, bool) or not read_number(parts, "parts").is_integer() or not 1 <= parts <= MOST_PARTS:
        raise InputError(f"parts is {parts!r}, needs a whole number from 1 to {MOST_PARTS}")
    if parts > 1 and not has_times:
        raise InputError("parts are joined at times that all of them have; give them, like at=['1 s']")
    return int(parts)


def _bound_times(requested_times: Any, model: Model) -> list[float]:
    """Read times; each keeps the decimal digits that it was written with."""
    if isinstance(requested_times, str) and ":" not in requested_times:
        requested_times = requested_times.split(",")
    if (
        isinstance(requested_times, list | tuple)
        and requested_times
        and all(isinstance(time, str) for time in requested_times)
    ):
        return [time_in(model.time_unit, time, "at") for time in requested_times]
    return [float(time) for time in wanted_times(requested_times, model.time_unit)]


def _proof_end(until: Any, times: list[float] | None, model: Model) -> float:
    """Return up to which time to prove."""
    start = model.statement.initial["t"].si
    if until is None and not times:
        until = model.run.get("until")
    if until is None and not times:
        raise InputError(f"model '{model.name}' has no until in its [run]; give until=… or at=…")
    end = max(times or ()) if until is None else time_in(model.time_unit, until, "until")
    if not start < end < np.inf and not (until is None and end == start):
        suffix = unit_suffix(model.time_unit)
        raise InputError(f"until is {end!r}{suffix}, needs a finite time after the start, {start!r}{suffix}")
    return end
