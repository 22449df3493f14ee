"""Columns of the events: when, which and how certain, the values there, and the effects of impacts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Node, dimension_of, text_of
from xdynamics.faults import InputError
from xdynamics.march import LogBlock
from xdynamics.march.events.zero_tests import LOOKS
from xdynamics.model import Function
from xdynamics.model.detectors import (
    GAP,
    GRIP,
    KINK,
    LIMIT,
    LINKS,
    OCCASION,
    PERIODIC,
    PULL,
    SLIP,
    SWITCH,
    function_dimension,
    labels,
)
from xdynamics.model.elementwise import own_mass
from xdynamics.model.parts import Contact, Event, Friction
from xdynamics.record.column import (
    Column,
    ColumnContext,
    multiply_values,
    shapes_with_switches,
    take_event_field,
    take_row_numbers,
)
from xdynamics.record.folded_columns import detector_columns
from xdynamics.record.folding import quantity_of
from xdynamics.record.link_columns import assembly_columns, impact_laws
from xdynamics.schema import ELEMENT_NAME, EVENTS, Variable
from xdynamics.shapes.blocks import Block as Quantity
from xdynamics.units import Dimension, Unit, spell

Array = NDArray[Any]

MOST_FLAGS = 127  # that a byte can number
NO_DETECTOR = "none"  # the only word of a model without events
TIME_LEAVES = "none, what the time tolerance leaves"


def event_columns(about: ColumnContext) -> list[Column]:
    """Return every variable along the events."""
    time = about.units.time

    def take_bounds(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        return multiply_values(np.stack([events["left"], events["time"]], axis=1), time)

    parts = [_bracket_taker(time), _residual_taker(about), take_event_field("interpolation", "f8", time)]

    def take_uncertainty(block: LogBlock) -> Array:
        if not block.events:  # most blocks have none
            return np.zeros(0)
        # no time is known better than half the spacing of floats
        half_spacing = np.spacing(np.abs(multiply_values(block.log.events["time"][: block.events], time))) / 2.0
        return np.maximum(sum(part(block) for part in parts), half_spacing)

    takes = (
        take_event_field("time", "f8", time),
        take_bounds,
        take_uncertainty,
        take_row_numbers("events", "row_before"),
        take_row_numbers("events", "row_after"),
        take_event_field("kind", "i1"),
        take_event_field("direction", "i1"),
    )
    fixed = map(schema.with_kinds_of_sliding, schema.FIXED_EVENTS) if about.layout.shares else schema.FIXED_EVENTS
    collected = [Column(variable, take) for variable, take in zip(fixed, takes, strict=True)]
    collected += [Column(variable, take) for variable, take in zip(schema.EVENT_UNCERTAINTIES, parts, strict=True)]
    if about.layout.is_doubled:
        collected.append(Column(schema.REST_EVENT_TIME, take_event_field("rest", "f8", time)))
    collected += detector_columns(_detector_column(about), shapes_with_switches(about.model))
    collected += _function_columns(about)
    collected += _position_columns(about)
    collected += _observable_columns(about, take_uncertainty)
    return _without_repeats([*collected, *_impact_columns(about), *assembly_columns(about)])


def _without_repeats(columns: list[Column]) -> list[Column]:
    """Return columns each once: of elements at which an event was, be it located by a detector or by links of many."""
    collected: dict[str, Column] = {}
    for column in columns:
        name = column.variable.name
        collected[name] = _combined_places(collected[name], column) if name in collected else column
    return [*collected.values()]


def _combined_places(first_column: Column, second_column: Column) -> Column:
    """Return a column of places that has those of two columns, each of which has none where the other has one."""

    def take_places(block: LogBlock) -> Array:
        places = first_column.take(block)
        return np.where(places == schema.NOWHERE, second_column.take(block), places)

    return Column(first_column.variable, take_places)


def _detector_column(about: ColumnContext) -> Column:
    """Return which event function passed zero, with the rule of each."""
    names = labels(about.layout.watched)
    number, dtype = {name: i for i, name in enumerate(names)}, "i1" if len(names) <= MOST_FLAGS else "i4"
    owners = np.array([number[watched.name] for watched in about.layout.watched] or [0], dtype)
    extra = schema.flag_attributes(dict(enumerate(names)) or {0: NO_DETECTOR}, dtype) | _detector_attributes(about)
    detector = Variable("event_detector", (EVENTS,), dtype, "1", "event function that passed zero", "flag", extra)
    return Column(detector, lambda block: owners[block.log.events["detector"][: block.events]])


def _impact_columns(about: ColumnContext) -> list[Column]:
    """Return impulses, shifts of coordinates, and the energy that impacts took."""
    model, collected = about.model, list[Column]()
    if model.assemblies and not about.layout.resets:
        return collected
    for coordinate in about.layout.coordinates.blocks:
        name, unit, impulse = coordinate.name, about.units.known[coordinate.name], _impulse_unit(about, coordinate)
        long_name = (
            f"shift of {name} at the event, by a reset or by contacts that come to rest; those of one time add up; 0 where"
            " none was"
        )
        dims = (EVENTS, *coordinate.dims)
        collected += [
            Column(
                Variable(
                    f"event_impulse_{name}",
                    dims,
                    "f8",
                    impulse.text,
                    f"contact impulse along {name}",
                    "event",
                    impact_laws(model),
                ),
                _impulse_taker(about, coordinate, impulse),
            ),
            Column(
                Variable(f"event_offset_{name}", dims, "f8", unit.text, long_name, "event"),
                _offset_taker(about, coordinate, unit),
            ),
        ]
    if about.layout.reactions:
        first = about.layout.coordinates.blocks[0]
        energy = spell(_impulse_unit(about, first).dimension * model.elements.dimensions[schema.velocity(first.first)])
        long_name = (
            "energy that the motion lost in the impact, or in bounces that were skipped, relative to a surface that"
            " moves"
        )
        lost = Variable("event_energy_lost", (EVENTS,), "f8", energy.text, long_name, "event")
        collected.append(
            Column(lost, _impact_line_taker(about.layout.coordinates.size, (), about.units.factor(energy)))
        )
    return collected


def _impulse_taker(about: ColumnContext, coordinate: Quantity, unit: Unit) -> Callable[[LogBlock], Array]:
    """Return a function from a block to impulses along a coordinate; zeros without contacts."""
    if not about.layout.reactions:
        return _zero_taker(coordinate.shape)
    return _impact_line_taker(
        about.layout.coordinates.offset_of(coordinate.name), coordinate.shape, about.units.factor(unit)
    )


def _offset_taker(about: ColumnContext, coordinate: Quantity, unit: Unit) -> Callable[[LogBlock], Array]:
    """Return a function from a block to shifts of a coordinate; zeros without resets of it and without contacts."""
    layout = about.layout
    if not (layout.reactions or layout.resets):
        return _zero_taker(coordinate.shape)
    first = layout.coordinates.offset_of(coordinate.name) + (layout.coordinates.size + 1 if layout.reactions else 0)
    return _impact_line_taker(first, coordinate.shape, about.units.factor(unit))


def _impact_line_taker(first: int, shape: tuple[int, ...], factor: float) -> Callable[[LogBlock], Array]:
    """Return a function from a block to the effect of events on a coordinate, shape (events, *shape)."""

    def take_lines(block: LogBlock) -> Array:
        lines = block.log.impulses[first : first + math.prod(shape), : block.events]
        return multiply_values(lines.T.reshape(-1, *shape), factor)

    return take_lines


def _bracket_taker(factor: float) -> Callable[[LogBlock], Array]:
    def take_bracket(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        return multiply_values(events["time"] - events["left"], factor)

    return take_bracket


def _residual_taker(about: ColumnContext) -> Callable[[LogBlock], Array]:
    factor = about.units.time

    def take_residual_part(block: LogBlock) -> Array:
        if not block.events:
            return np.zeros(0)
        events = block.log.events[: block.events]
        residual, slope, kind = events["residual"], events["slope"], events["kind"]
        # a vanishing slope makes this part infinite, as it should be for a tangent crossing
        with np.errstate(divide="ignore", invalid="ignore"):
            # 0/0 would be nan, and a zero that was met exactly leaves nothing
            left = np.where(residual == 0.0, 0.0, np.abs(residual / slope))
        # where a function jumps its value is no measure; where it is indistinguishable from zero, the duration of that is
        left = np.where(np.isin(kind, [schema.JUMP, schema.POLE]), 0.0, left)
        return multiply_values(
            np.where(np.isin(kind, [schema.TOUCH, schema.CLUSTER, schema.REST]), events["murk"] / 2.0, left), factor
        )

    return take_residual_part


def _detector_attributes(about: ColumnContext) -> dict[str, str]:
    """Describe every event by its function, direction, action and tolerances, contacts and friction by their rules."""
    shaped = about.model.statement
    elements: dict[str, Mapping[str, Any]] = {
        "": shaped.events,
        "contact_": shaped.contacts,
        "friction_": shaped.frictions,
    }
    entries: list[tuple[str, str, Callable[[Any], Any]]] = [
        ("", "functions", _search_words),
        ("", "directions", lambda element: element.direction),
        ("", "actions", lambda element: element.action),
        ("contact_", "gaps", lambda element: text_of(element.gap)),
        ("contact_", "laws", lambda element: element.law),
        ("contact_", "restitutions", lambda element: text_of(element.restitution)),
        ("contact_", "tangential_rules", _tangential),
        ("contact_", "rest_heights", lambda element: element.rest_height or "1e-9 of the largest gap so far"),
        ("friction_", "rules", _friction_rule),
        *((kind, "time_tolerances", _time_tolerance_words) for kind in elements),
        *(
            (kind, "position_tolerances", lambda element: element.position_tolerance or TIME_LEAVES)
            for kind in ("", "contact_")
        ),
    ]
    return {
        f"{kind}{attribute_word}": "; ".join(f"{name}: {text(element)}" for name, element in elements[kind].items())
        for kind, attribute_word, text in entries
        if elements[kind]
    }


def _tangential(contact: Contact) -> str:
    """Describe how a contact acts along its surface."""
    if contact.slip is None or contact.friction is None or contact.static is None:
        return contact.tangential
    return (
        f"{contact.tangential}, slip {text_of(contact.slip)}, friction {text_of(contact.friction)}, static"
        f" {text_of(contact.static)}"
    )


def _friction_rule(friction: Friction) -> str:
    """Describe the rule of a friction element."""
    return f"slip {text_of(friction.slip)}, kinetic {text_of(friction.kinetic)}, static {text_of(friction.static)}"


def _time_tolerance_words(element: Event | Contact | Friction) -> str:
    """Return how well an event is located in time; a periodic one is not searched for."""
    if isinstance(element, Event) and element.every is not None:
        return "none: a node"
    return str(element.time_tolerance or "solver_time_tolerance")


def _search_words(event: Event) -> str:
    """Return whose zeros are located, or the period of a periodic event, in words."""
    if event.every is None:
        return _function_text(event.function)
    return f"every {event.every}" + (f" from {event.phase} after the start" if event.phase else "")


def _function_text(function: Node | Function) -> str:
    if isinstance(function, Function):
        return (
            f"{function.name}({', '.join(function.arguments)}) in Python, looked at {LOOKS} times a step, slopes by"
            " differences"
        )
    return text_of(function)


# what is watched of a contact or friction element
_WATCHED = {
    OCCASION: "",
    PERIODIC: "",
    GAP: " (gap)",
    LINKS: " (gap)",
    PULL: " (normal force)",
    LIMIT: " (time to rest)",
    SLIP: " (slip)",
    SWITCH: "",
    KINK: "",
    GRIP: " (static friction less force)",
}


def _function_columns(about: ColumnContext) -> list[Column]:
    """Return the event functions at the accepted states with their uncertainties; several units are listed in a comment."""
    model, scales = about.model, about.scales
    watched = about.layout.watched
    dimensions = [function_dimension(model, detector) for detector in watched]
    texts = [_unit_text(dimension) for dimension in dimensions]
    shared = set(texts)
    extra: dict[str, Any] = {}
    if len(shared) > 1:
        units_by_event = dict.fromkeys(
            f"{quantity_of(detector.name)}{_WATCHED[detector.role]} {text}"
            for detector, text in zip(watched, texts, strict=True)
        )
        extra["comment"] = "SI unit by event: " + ", ".join(units_by_event)
    factors = np.array([scales.si_factor(dimension) for dimension in dimensions] or [1.0])
    unit = shared.pop() if len(shared) == 1 else "1"

    def field_taker(name: str) -> Callable[[LogBlock], Array]:
        def take_field(block: LogBlock) -> Array:
            events = block.log.events[: block.events]
            values: Array = events[name] * factors[events["detector"]]
            return values

        return take_field

    long_name = (
        "uncertainty of the event function at the accepted state: rounding, and of a model's own events the estimated"
        " error of the step"
    )
    return [
        Column(
            Variable("event_residual", (EVENTS,), "f8", unit, "event function at the accepted state", "event", extra),
            field_taker("residual"),
        ),
        Column(
            Variable("event_function_uncertainty", (EVENTS,), "f8", unit, long_name, "event", extra),
            field_taker("uncertainty"),
        ),
        Column(
            Variable(
                "event_substeps", (EVENTS,), "i4", "1", "steps that were re-integrated to find and locate it", "event"
            ),
            take_event_field("substeps", "i4"),
        ),
    ]


def _position_columns(about: ColumnContext) -> list[Column]:
    """Return, for every event with a position tolerance, whether it is met."""
    watched = about.layout.watched
    if all(detector.position_tolerance is None for detector in watched):
        return []
    scales, model = about.scales, about.model
    tolerances = np.array(
        [
            (
                np.inf
                if detector.position_tolerance is None
                else detector.position_tolerance.si / scales.si_factor(function_dimension(model, detector))
            )
            for detector in watched
        ]
    )

    def take_positions(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        tolerance = tolerances[events["detector"]]
        position = np.where(np.abs(events["residual"]) <= tolerance, schema.NEAR, schema.FAR)
        return np.where(np.isinf(tolerance), schema.UNASKED, position).astype("i1")

    long_name = (
        "whether the accepted state is as near to the zero of the event function as its position tolerance asks for"
    )
    extra = schema.flag_attributes(dict(enumerate(schema.EVENT_POSITIONS)))
    return [Column(Variable("event_position", (EVENTS,), "i1", "1", long_name, "flag", extra), take_positions)]


def _observable_columns(about: ColumnContext, uncertainty: Callable[[LogBlock], Array]) -> list[Column]:
    """Return the observables at the accepted states, and their uncertainty due to that of the event's time."""
    units, layout, collected = about.units, about.layout, []
    rates = {block.name for block in layout.followed.blocks}

    def take_values(lines: slice, shape: tuple[int, ...], factor: float, block: LogBlock) -> Array:
        # events name rows of the whole march, and the block begins at its base
        rows = block.log.events["row_before"][: block.events] - int(block.log.base[0]["rows"])
        return multiply_values(block.log.rows[lines, rows].T.reshape(-1, *shape), factor)

    def take_doubts(lines: slice, shape: tuple[int, ...], factor: float, block: LogBlock) -> Array:
        slopes = np.abs(block.log.rates[lines, : block.events]).T.reshape(-1, *shape)
        return multiply_values(slopes, factor) * uncertainty(block).reshape(-1, *[1] * len(shape))

    other_columns = {
        *schema.ENERGIES,
        *layout.rate_terms,
        *layout.gaps,
        *layout.constraint_outputs,
        *layout.shares,
    }
    observed = (
        [quantity for quantity in layout.computed.blocks if quantity.first not in other_columns]
        if layout.watched
        else []
    )
    for quantity in observed:
        name, shape, unit, dims = quantity.name, quantity.shape, units.derived(quantity), (EVENTS, *quantity.dims)
        long_name = f"{name} at the state before the event"
        first = layout.row.offset_of(name)
        take = partial(take_values, slice(first, first + quantity.size), shape, units.factor(unit))
        collected.append(Column(Variable(f"event_{name}", dims, "f8", unit.text, long_name, "event"), take))
        if name in rates:
            long_name = f"uncertainty of {name} at the event by event_time_uncertainty"
            more = {ELEMENT_NAME: f"event_{name}{{}}_uncertainty"} if quantity.dims else {}
            variable = Variable(f"event_{name}_uncertainty", dims, "f8", unit.text, long_name, "event", more)
            first = layout.followed.offset_of(name)
            lines = slice(first, first + quantity.size)
            collected.append(Column(variable, partial(take_doubts, lines, shape, units.factor(unit) / units.time)))
    return collected


def _unit_text(dimension: Dimension) -> str:
    try:
        return spell(dimension).text
    except InputError:
        return "1"


def _impulse_unit(about: ColumnContext, coordinate: Quantity) -> Unit:
    """Return the unit of an impulse along a coordinate."""
    model, first_index = about.model, about.layout.coordinates.offset_of(coordinate.name)
    mass = dimension_of(own_mass(model.elements.mass, first_index), model.elements.dimensions)
    return spell(mass * model.elements.dimensions[schema.velocity(coordinate.first)])


def _zero_taker(shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Return a function from a block to zeros that are broadcast, since many elements would fill as much as states."""
    return lambda block: np.broadcast_to(0.0, (block.events, *shape))
