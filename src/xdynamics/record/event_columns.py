"""What the record says of events: when, which and how sure, what was there on either side, what an impact took."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Node, dimension_of, text_of
from xdynamics.faults import InputError
from xdynamics.march import Block
from xdynamics.march.events.certainty import LOOKS
from xdynamics.model import Function, Model
from xdynamics.model.detectors import GAP, GRIP, KINK, LIMIT, OCCASION, PULL, SLIP, SWITCH, function_dimension, labels
from xdynamics.model.parts import Contact, Friction
from xdynamics.record.column import About, Column, event_of, times
from xdynamics.schema import EVENTS, Variable
from xdynamics.units import Dimension, Unit, spell

Array = NDArray[Any]

TIME_LEAVES = "none, what the time tolerance leaves"


def event_columns(about: About) -> list[Column]:
    """Return every variable along the events."""
    units, model = about.units, about.model
    time = units.time

    def bounds(block: Block) -> Array:
        events = block.log.events[: block.events]
        return times(np.stack([events["left"], events["time"]], axis=1), time)

    parts = [_bracket(time), _left_over(about), event_of("interpolation", "f8", time)]

    def uncertainty(block: Block) -> Array:
        if not block.events:  # most blocks have none
            return np.zeros(0)
        # of a time between two floats nobody knows more than that
        least = np.spacing(np.abs(times(block.log.events["time"][: block.events], time))) / 2.0
        return np.maximum(sum(part(block) for part in parts), least)

    takes = (
        event_of("time", "f8", time),
        bounds,
        uncertainty,
        event_of("row_before", "i8"),
        event_of("row_after", "i8"),
        event_of("kind", "i1"),
        event_of("direction", "i1"),
    )
    found = [Column(variable, take) for variable, take in zip(schema.FIXED_EVENTS, takes, strict=True)]
    found += [Column(variable, take) for variable, take in zip(schema.EVENT_UNCERTAINTIES, parts, strict=True)]
    names = labels(about.layout.watched)
    owners = np.array([names.index(one.name) for one in about.layout.watched] or [0], np.int8)
    more = schema.flags(dict(enumerate(names)) or {0: "none"}) | _detectors(about)
    detector = Variable("event_detector", (EVENTS,), "i1", "1", "event function that passed zero", "flag", more)
    found.append(Column(detector, lambda block: owners[block.log.events["detector"][: block.events]]))
    found += _values(about)
    found += _positions(about)
    found += _observed(about, uncertainty)
    for i, name in enumerate(model.coordinates):
        impulse = _impulse_unit(model, i, name)
        found += [
            Column(Variable(f"event_impulse_{name}", (EVENTS,), "f8", impulse.text, f"contact impulse along {name}", "event", _laws(model)), _impulse(about, i, impulse)),
            Column(Variable(f"event_offset_{name}", (EVENTS,), "f8", units.known[name].text, f"shift of {name} at the event, by a reset or by contacts that come to rest; those of one time add up; 0 where none was", "event"), _offset(about, i, units.known[name])),
        ]  # fmt: skip
    if about.layout.reactions:
        energy = spell(
            _impulse_unit(model, 0, name := next(iter(model.coordinates))).dimension
            * model.dimensions[schema.velocity(name)]
        )
        said = "energy that the motion lost in the impact, or in bounces that were skipped, relative to a surface that moves"
        lost = Variable("event_energy_lost", (EVENTS,), "f8", energy.text, said, "event")
        found.append(Column(lost, _impulse(about, len(model.coordinates), energy)))
    return found


def _impulse(about: About, i: int, unit: Unit) -> Callable[[Block], Array]:
    """Impulses along a coordinate, or behind the last one the energy; none without contacts."""
    factor = about.units.factor(unit)
    return (lambda block: times(block.log.impulses[i, : block.events], factor)) if about.layout.reactions else _nothing


def _offset(about: About, i: int, unit: Unit) -> Callable[[Block], Array]:
    """Shifts of a coordinate; none where nothing sets one and there are no contacts."""
    layout, factor = about.layout, about.units.factor(unit)
    place = i - len(layout.coordinates)
    return (
        (lambda block: times(block.log.impulses[place, : block.events], factor))
        if layout.reactions or layout.resets
        else _nothing
    )


def _laws(model: Model) -> dict[str, str]:
    """Say by which law impacts are computed, and in which order."""
    if not model.contacts:
        return {}
    one = next(iter(model.contacts.values()))
    restitutions = "; ".join(f"{name}: {text_of(one.restitution)}" for name, one in model.contacts.items())
    return {"impact_law": one.law, "impact_order": " ".join(model.contacts), "restitution": restitutions}


def _bracket(factor: float) -> Callable[[Block], Array]:
    def take(block: Block) -> Array:
        events = block.log.events[: block.events]
        return times(events["time"] - events["left"], factor)

    return take


def _left_over(about: About) -> Callable[[Block], Array]:
    factor = about.units.time

    def take(block: Block) -> Array:
        if not block.events:
            return np.zeros(0)
        events = block.log.events[: block.events]
        residual, slope, kind = events["residual"], events["slope"], events["kind"]
        # a vanishing slope makes this part infinite, which is what a tangent crossing is worth
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.where(residual == 0.0, 0.0, np.abs(residual / slope))
        # where a function jumps its value says nothing; where it cannot be told from zero, for how long does
        left = np.where(np.isin(kind, [schema.JUMP, schema.POLE]), 0.0, left)
        return times(
            np.where(np.isin(kind, [schema.TOUCH, schema.CLUSTER, schema.REST]), events["murk"] / 2.0, left), factor
        )

    return take


def _detectors(about: About) -> dict[str, str]:
    """Say of every event its function, direction, action and tolerances; of contacts and friction their rules."""
    model = about.model
    parts: dict[str, Mapping[str, Any]] = {"": model.events, "contact_": model.contacts, "friction_": model.frictions}
    said: list[tuple[str, str, Callable[[Any], Any]]] = [
        ("", "functions", lambda one: _text(one.function)),
        ("", "directions", lambda one: one.direction),
        ("", "actions", lambda one: one.action),
        ("contact_", "gaps", lambda one: text_of(one.gap)),
        ("contact_", "laws", lambda one: one.law),
        ("contact_", "restitutions", lambda one: text_of(one.restitution)),
        ("contact_", "tangential_rules", _tangential),
        ("contact_", "rest_heights", lambda one: one.rest_height or "1e-9 of the largest gap so far"),
        ("friction_", "rules", _rule),
        *((kind, "time_tolerances", lambda one: one.time_tolerance or "solver_time_tolerance") for kind in parts),
        *(
            (kind, "position_tolerances", lambda one: one.position_tolerance or TIME_LEAVES)
            for kind in ("", "contact_")
        ),
    ]
    return {
        f"{kind}{what}": "; ".join(f"{name}: {text(one)}" for name, one in parts[kind].items())
        for kind, what, text in said
        if parts[kind]
    }


def _tangential(one: Contact) -> str:
    """Say what a contact does along its surface."""
    if one.slip is None or one.friction is None or one.static is None:
        return one.tangential
    return f"{one.tangential}, slip {text_of(one.slip)}, friction {text_of(one.friction)}, static {text_of(one.static)}"


def _rule(one: Friction) -> str:
    """Say what a friction element does."""
    return f"slip {text_of(one.slip)}, kinetic {text_of(one.kinetic)}, static {text_of(one.static)}"


def _text(function: Node | Function) -> str:
    if isinstance(function, Function):
        return f"{function.name}({', '.join(function.arguments)}) in Python, looked at {LOOKS} times a step, slopes by differences"
    return text_of(function)


# what is watched of a contact or friction element
_WATCHED = {
    OCCASION: "",
    GAP: " (gap)",
    PULL: " (normal force)",
    LIMIT: " (time to rest)",
    SLIP: " (slip)",
    SWITCH: "",
    KINK: "",
    GRIP: " (static friction less force)",
}


def _values(about: About) -> list[Column]:
    """Values of the event functions at the accepted states, and what they are uncertain by; several units are said in words."""
    model, scales = about.model, about.scales
    watched = about.layout.watched
    dimensions = [function_dimension(model, one) for one in watched]
    texts = [_unit_text(dimension) for dimension in dimensions]
    shared = set(texts)
    more: dict[str, Any] = {}
    if len(shared) > 1:
        named = (f"{one.name}{_WATCHED[one.role]} {text}" for one, text in zip(watched, texts, strict=True))
        more["comment"] = "SI unit by event: " + ", ".join(named)
    factors = np.array([scales.of(dimension) for dimension in dimensions] or [1.0])
    unit = shared.pop() if len(shared) == 1 else "1"

    def taken(name: str) -> Callable[[Block], Array]:
        def take(block: Block) -> Array:
            events = block.log.events[: block.events]
            found: Array = events[name] * factors[events["detector"]]
            return found

        return take

    said = "uncertainty of the event function at the accepted state: rounding, and of a model's own events the estimated error of the step"
    return [
        Column(Variable("event_residual", (EVENTS,), "f8", unit, "event function at the accepted state", "event", more), taken("residual")),
        Column(Variable("event_function_uncertainty", (EVENTS,), "f8", unit, said, "event", more), taken("uncertainty")),
        Column(Variable("event_substeps", (EVENTS,), "i4", "1", "steps that were re-integrated to find and locate it", "event"), event_of("substeps", "i4")),
    ]  # fmt: skip


def _positions(about: About) -> list[Column]:
    """Say of every event whether it is as near to its zero as was asked for, where that was asked for."""
    watched = about.layout.watched
    if all(one.position_tolerance is None for one in watched):
        return []
    scales, model = about.scales, about.model
    asked = np.array([np.inf if one.position_tolerance is None else one.position_tolerance.si / scales.of(function_dimension(model, one)) for one in watched])  # fmt: skip

    def take(block: Block) -> Array:
        events = block.log.events[: block.events]
        within = asked[events["detector"]]
        met = np.where(np.abs(events["residual"]) <= within, schema.NEAR, schema.FAR)
        return np.where(np.isinf(within), schema.UNASKED, met).astype("i1")

    said = "whether the accepted state is as near to the zero of the event function as its position tolerance asks for"
    more = schema.flags(dict(enumerate(schema.EVENT_POSITIONS)))
    return [Column(Variable("event_position", (EVENTS,), "i1", "1", said, "flag", more), take)]


def _observed(about: About, uncertainty: Callable[[Block], Array]) -> list[Column]:
    """Observables at the accepted states, and what not knowing the time better makes of them."""
    units, layout, found = about.units, about.layout, []
    rates, places = list(layout.followed), {name: i for i, name in enumerate(layout.row)}

    def value(place: int, factor: float) -> Callable[[Block], Array]:
        def take(block: Block) -> Array:
            rows = block.log.events["row_before"][: block.events] - int(block.log.base[0]["rows"])
            return times(block.log.rows[place, rows], factor)

        return take

    def doubt(place: int, factor: float) -> Callable[[Block], Array]:
        return lambda block: times(np.abs(block.log.rates[place, : block.events]), factor) * uncertainty(block)

    for name in about.model.observables if about.layout.watched else ():
        unit = units.derived(name)
        variable = Variable(
            f"event_{name}", (EVENTS,), "f8", unit.text, f"{name} at the state before the event", "event"
        )
        found.append(Column(variable, value(places[name], units.factor(unit))))
        if name in rates:
            said = f"uncertainty of {name} at the event by event_time_uncertainty"
            variable = Variable(f"event_{name}_uncertainty", (EVENTS,), "f8", unit.text, said, "event")
            found.append(Column(variable, doubt(rates.index(name), units.factor(unit) / units.time)))
    return found


def _unit_text(dimension: Dimension) -> str:
    try:
        return spell(dimension).text
    except InputError:
        return "1"


def _impulse_unit(model: Model, i: int, name: str) -> Unit:
    known = model.dimensions
    return spell(dimension_of(model.mass[i][i], known) * known[schema.velocity(name)])


def _nothing(block: Block) -> Array:
    return np.zeros(block.events)
