"""From the log of a march to columns: every variable of the record with its name, unit and meaning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import Node, dimension_of, text_of
from xdynamics.faults import InputError
from xdynamics.kernels import Layout
from xdynamics.march import Block, March, Tolerances
from xdynamics.march.certainty import LOOKS
from xdynamics.march.memory import numbers_at_end
from xdynamics.model import Function, Model
from xdynamics.model.detectors import GAP, GRIP, KINK, LIMIT, OCCASION, PULL, SLIP, SWITCH, function_dimension, labels
from xdynamics.model.reactions import DRY, NORMAL, Reaction, reaction_dimensions, reactions
from xdynamics.schema import EVENTS, SAMPLES, STEPS, Variable
from xdynamics.units import NONE, TIME, Dimension, Scales, Unit, spell

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A variable of the record and how its values are taken from a block of the log."""

    variable: Variable
    take: Callable[[Block], Array]


def columns(march: March) -> list[Column]:
    """Return every variable with a dimension, in the order of the record."""
    return _columns(_About(march.layout, march.settings.scales, march.settings.tolerances, march.settings.samples))


@dataclass(frozen=True)
class _About:
    """What the columns of a march depend on."""

    layout: Layout
    scales: Scales
    tolerances: Tolerances | None
    samples: bool

    @property
    def model(self) -> Model:
        return self.layout.model

    @cached_property
    def units(self) -> _Units:
        return _Units(self)


@lru_cache(maxsize=64)
def _columns(about: _About) -> list[Column]:
    return [*_steps(about), *_trials(about), *_events(about), *(_samples(about) if about.samples else [])]


def constants(march: March) -> list[tuple[Variable, Any]]:
    """Return every variable not along a march with its value: parameters, given steps, its memory, the model, the source."""
    found: list[tuple[Variable, Any]] = []
    if isinstance(march.settings.step, tuple):
        found.append((schema.GIVEN_STEP, np.array(march.settings.step)))
    for name, one in march.model.parameters.items():
        more: dict[str, Any] = {}
        if one.uncertainty is not None:
            more["uncertainty"] = float(one.uncertainty.unit.factor / one.quantity.unit.factor) * one.uncertainty.value
        long_name = one.description or f"parameter {name}"
        found.append(
            (Variable(name, (), "f8", one.quantity.unit.text, long_name, "parameter", more), one.quantity.value)
        )
    names, numbers = numbers_at_end(march.run)
    found.append((replace(schema.END_MEMORY, more={"names": names}), numbers))
    functions = "".join(
        f"\n\n# Python function {one.name}, sha256 {one.digest}\n{one.source}" for one in march.model.python_functions
    )
    texts = {"model_toml": march.model.to_toml(), "force_source": march.law.source + functions}
    return found + [(variable, texts[variable.name]) for variable in schema.TEXTS]


def factors(model: Model, scales: Scales) -> dict[str, float]:
    """Return the factor from a march's numbers to the record's, for every coordinate, velocity and state."""
    return {name: scales.of(unit.dimension) / float(unit.factor) for name, unit in model.units.items()}


def _row(index: int, factor: float) -> Callable[[Block], Array]:
    return lambda block: _times(block.log.rows[index, : block.rows], factor)


def _sample(index: int, factor: float) -> Callable[[Block], Array]:
    return lambda block: _times(block.log.samples[index, : block.samples], factor)


def _trial(name: str, dtype: str, factor: float = 1.0) -> Callable[[Block], Array]:
    return lambda block: _times(block.log.trials[name][: block.trials], factor).astype(dtype)


def _event(name: str, dtype: str, factor: float = 1.0) -> Callable[[Block], Array]:
    return lambda block: _times(block.log.events[name][: block.events], factor).astype(dtype)


def _times(values: Array, factor: float) -> Array:
    if factor == 1.0:
        return values
    scaled: Array = values * factor
    return scaled


class _Units:
    """The unit that each quantity of a model is reported in, and the factor from internal numbers to it."""

    def __init__(self, about: _About) -> None:
        self.about = about
        self.scales = about.scales
        self.time = self.scales.of(TIME)
        self.known = dict(about.model.units)
        model = about.model
        known = model.dimensions
        for i, (name, one) in enumerate(model.coordinates.items()):
            self.known[schema.acceleration(name)] = one.unit.per_second(2)
            mass = dimension_of(model.mass[i][i], known)
            needed = spell(mass * known[name] / TIME**2, angle=known[name] == NONE)
            for term, parts in model.force_components.items():
                if name in parts:
                    self.known[schema.force(term, name)] = needed
        self.known |= {name: spell(one) for name, one in reaction_dimensions(model).items()}
        for name, state in model.states.items():
            self.known[schema.rate(name)] = state.unit.per_second()
        self.known |= {name: drive.table.value_unit for name, drive in model.drives.items()}

    def factor(self, unit: Unit) -> float:
        return self.scales.of(unit.dimension) / float(unit.factor)

    def derived(self, name: str) -> Unit:
        layout = self.about.layout
        if name in schema.ENERGIES:
            return spell(layout.energy_dimension or NONE)
        if name in layout.gaps:
            return spell(dimension_of(layout.gaps[name], self.about.model.dimensions))
        known = self.about.model.dimensions
        accelerations = {schema.acceleration(one): known[one] / TIME**2 for one in layout.coordinates}
        return spell(dimension_of(self.about.model.observables[name], known | accelerations))


def _steps(about: _About) -> list[Column]:
    units, layout, model = about.units, about.layout, about.model
    order = {name: index for index, name in enumerate(layout.row)}
    found = [Column(one, _row(order[one.name], units.time)) for one in schema.FIXED_STEPS[:2]]
    found.append(Column(schema.FIXED_STEPS[2], lambda block: block.log.flags[0, : block.rows]))
    regime = Variable(
        "regime",
        (STEPS,),
        "i1",
        "1",
        "regime of the force law",
        "flag",
        schema.flags(dict(enumerate(model.regimes)) or {0: schema.ONLY_REGIME}) | _forces_by_regime(model),
    )
    found.append(Column(regime, lambda block: block.log.flags[1, : block.rows]))

    def add(name: str, long_name: str, role: str, unit: Unit) -> None:
        tolerance = _tolerance(about, name, unit) if name in layout.used else {}
        variable = Variable(name, (STEPS,), "f8", unit.text, long_name, role, tolerance)
        found.append(Column(variable, _row(order[name], units.factor(unit))))

    for name, coordinate in model.coordinates.items():
        add(name, coordinate.description or f"coordinate {name}", "coordinate", units.known[name])
        add(schema.velocity(name), f"velocity of {name}", "velocity", units.known[schema.velocity(name)])
        add(
            schema.acceleration(name), f"acceleration of {name}", "acceleration", units.known[schema.acceleration(name)]
        )
    for name, state in model.states.items():
        add(name, state.description or f"state {name}", "state", units.known[name])
        add(schema.rate(name), f"rate of {name}", "rate", units.known[schema.rate(name)])
    for term, parts in model.force_components.items():
        words = model.forces[term].description or term
        for name in parts:
            force = schema.force(term, name)
            add(force, f"component of force {words} along {name}", "force", units.known[force])
    for name in layout.derived:
        role = "energy" if name in schema.ENERGIES else "gap" if name in layout.gaps else "observable"
        said = "gap of contact" if role == "gap" else "observable"
        owner = name.removeprefix(schema.contact_gap("")) if role == "gap" else name
        add(name, schema.ENERGIES.get(name, f"{said} {owner}"), role, units.derived(name))
    for k, one in enumerate(reactions(model)):
        what = "normal force of contact" if one.sort == NORMAL else "friction force of"
        add(one.name, f"{what} {one.owner}; 0 where it is open", "reaction", units.known[one.name])
        found.append(Column(_state_of(one), _flag(2 + k)))
    if layout.estimates and about.tolerances is not None:
        found.append(Column(schema.ERROR_NORM, _row(order["error_norm"], 1.0)))
    for name in layout.used if layout.estimates else ():
        add(
            schema.error(name), f"estimated local error of {name} in the step to this state", "error", units.known[name]
        )
    if layout.implicit:
        index = order["newton_iterations"]
        found.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return found


def state_name(one: Reaction) -> str:
    """Return the name of the variable that says what a contact, or its friction, does."""
    return schema.contact_state(one.owner) if one.sort == NORMAL else schema.friction_state(one.owner)


def _state_of(one: Reaction) -> Variable:
    """Return the variable that says what a contact or friction does."""
    words: tuple[str, ...] = schema.FRICTION_STATES
    name = state_name(one)
    said = f"what the friction of {one.owner} does; forward is along positive slip"
    if one.sort == NORMAL:
        words = schema.CONTACT_STATES
        said = f"what contact {one.owner} does; bounces are skipped while it is settling"
    elif one.sort == DRY:
        words = ("", *words[1:])  # a friction element is never open
    meanings = {i: word for i, word in enumerate(words) if word}
    return Variable(name, (STEPS,), "i1", "1", said, "flag", schema.flags(meanings))


def _flag(index: int) -> Callable[[Block], Array]:
    return lambda block: block.log.flags[index, : block.rows]


def _tolerance(about: _About, name: str, unit: Unit) -> dict[str, float]:
    """Say the absolute tolerance of a variable, in its unit and, exactly, in SI."""
    asked = about.tolerances
    if asked is None:
        return {}
    return {"atol": asked.of(name) / float(unit.factor), "atol_si": asked.of(name)}


def _forces_by_regime(model: Model) -> dict[str, str]:
    """Say of every regime which forces act in it."""
    acting = "; ".join(f"{name}: {' '.join(one.forces)}" for name, one in model.regimes.items())
    return {"forces": acting} if acting else {}


def _trials(about: _About) -> list[Column]:
    time = about.units.time
    takes = (
        _trial("time", "f8", time), _trial("step", "i8"), _trial("step_size", "f8", time), _trial("error_norm", "f8"),
        _trial("reason", "i1"),
    )  # fmt: skip
    return [Column(variable, take) for variable, take in zip(schema.FIXED_TRIALS, takes, strict=True)]


def _events(about: _About) -> list[Column]:
    units, model = about.units, about.model
    time = units.time

    def bounds(block: Block) -> Array:
        events = block.log.events[: block.events]
        return _times(np.stack([events["left"], events["time"]], axis=1), time)

    parts = [_bracket(time), _left_over(about), _event("interpolation", "f8", time)]

    def uncertainty(block: Block) -> Array:
        # of a time between two floats nobody knows more than that
        least = np.spacing(np.abs(_times(block.log.events["time"][: block.events], time))) / 2.0
        return np.maximum(sum(part(block) for part in parts), least)

    takes = (
        _event("time", "f8", time),
        bounds,
        uncertainty,
        _event("row_before", "i8"),
        _event("row_after", "i8"),
        _event("kind", "i1"),
        _event("direction", "i1"),
    )
    found = [Column(variable, take) for variable, take in zip(schema.FIXED_EVENTS, takes, strict=True)]
    found += [Column(variable, take) for variable, take in zip(schema.EVENT_UNCERTAINTIES, parts, strict=True)]
    names = labels(about.layout.watched)
    owners = np.array([names.index(one.name) for one in about.layout.watched] or [0], np.int8)
    more = schema.flags(dict(enumerate(names)) or {0: "none"}) | _detectors(about)
    detector = Variable("event_detector", (EVENTS,), "i1", "1", "event function that passed zero", "flag", more)
    found.append(Column(detector, lambda block: owners[block.log.events["detector"][: block.events]]))
    found += _values(about)
    found += _observed(about, uncertainty)
    for i, name in enumerate(model.coordinates):
        impulse = _impulse_unit(model, i, name)
        found += [
            Column(Variable(f"event_impulse_{name}", (EVENTS,), "f8", impulse.text, f"contact impulse along {name}", "event", _laws(model)), _impulse(about, i, impulse)),
            Column(Variable(f"event_offset_{name}", (EVENTS,), "f8", units.known[name].text, f"offset put on {name} at the event", "event"), _nothing),
        ]  # fmt: skip
    if about.layout.reactions:
        energy = spell(
            _impulse_unit(model, 0, name := next(iter(model.coordinates))).dimension
            * model.dimensions[schema.velocity(name)]
        )
        said = "energy that an impact took, or the bounces that were skipped; seen from what is struck"
        lost = Variable("event_energy_lost", (EVENTS,), "f8", energy.text, said, "event")
        found.append(Column(lost, _impulse(about, len(model.coordinates), energy)))
    return found


def _impulse(about: _About, i: int, unit: Unit) -> Callable[[Block], Array]:
    """Impulses along a coordinate, or behind the last one the energy; none without contacts."""
    factor = about.units.factor(unit)
    return (lambda block: _times(block.log.impulses[i, : block.events], factor)) if about.layout.reactions else _nothing


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
        return _times(events["time"] - events["left"], factor)

    return take


def _left_over(about: _About) -> Callable[[Block], Array]:
    factor = about.units.time

    def take(block: Block) -> Array:
        events = block.log.events[: block.events]
        residual, slope, kind = events["residual"], events["slope"], events["kind"]
        # a vanishing slope makes this part infinite, which is what a tangent crossing is worth
        with np.errstate(divide="ignore", invalid="ignore"):
            left = np.where(residual == 0.0, 0.0, np.abs(residual / slope))
        # where a function jumps its value says nothing; where it cannot be told from zero, for how long does
        left = np.where(np.isin(kind, [schema.JUMP, schema.POLE]), 0.0, left)
        return _times(
            np.where(np.isin(kind, [schema.TOUCH, schema.CLUSTER, schema.REST]), events["murk"] / 2.0, left), factor
        )

    return take


def _detectors(about: _About) -> dict[str, str]:
    """Say of every event its function, direction, action and time tolerance."""
    events = about.model.events.items()
    return (
        {
            "functions": "; ".join(f"{name}: {_text(one.function)}" for name, one in events),
            "directions": "; ".join(f"{name}: {one.direction}" for name, one in events),
            "actions": "; ".join(f"{name}: {one.action}" for name, one in events),
            "time_tolerances": "; ".join(f"{name}: {one.time_tolerance}" for name, one in events),
        }
        if events
        else {}
    )


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


def _values(about: _About) -> list[Column]:
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

    said = "uncertainty of the event function at the accepted state: rounding, and the estimated error of the step"
    return [
        Column(Variable("event_residual", (EVENTS,), "f8", unit, "event function at the accepted state", "event", more), taken("residual")),
        Column(Variable("event_function_uncertainty", (EVENTS,), "f8", unit, said, "event", more), taken("uncertainty")),
        Column(Variable("event_substeps", (EVENTS,), "i4", "1", "steps that were re-integrated to find and locate it", "event"), _event("substeps", "i4")),
    ]  # fmt: skip


def _observed(about: _About, uncertainty: Callable[[Block], Array]) -> list[Column]:
    """Observables at the accepted states, and what not knowing the time better makes of them."""
    units, layout, found = about.units, about.layout, []
    rates, places = list(layout.followed), {name: i for i, name in enumerate(layout.row)}

    def value(place: int, factor: float) -> Callable[[Block], Array]:
        def take(block: Block) -> Array:
            rows = block.log.events["row_before"][: block.events] - int(block.log.base[0]["rows"])
            return _times(block.log.rows[place, rows], factor)

        return take

    def doubt(place: int, factor: float) -> Callable[[Block], Array]:
        return lambda block: _times(np.abs(block.log.rates[place, : block.events]), factor) * uncertainty(block)

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


def _samples(about: _About) -> list[Column]:
    units, layout = about.units, about.layout
    order = {name: index for index, name in enumerate(layout.sample)}
    time, step, stage = schema.FIXED_SAMPLES
    found = [
        Column(time, _sample(0, units.time)),
        Column(step, lambda block: block.log.samples[1, : block.samples].astype("i8")),
        Column(stage, lambda block: block.log.samples[2, : block.samples].astype("i1")),
    ]
    for name in (*layout.used, *layout.forces, *layout.reactions, *layout.drives):
        unit = units.known[name]
        what = (
            "given by"
            if name in (*layout.forces, *layout.reactions)
            else "looked up in"
            if name in layout.drives
            else "used in"
        )
        variable = Variable(
            schema.sampled(name), (SAMPLES,), "f8", unit.text, f"{name} {what} the force evaluation", "sample"
        )
        found.append(Column(variable, _sample(order[name], units.factor(unit))))
    return found
