"""Detectors of a march: events, transitions of contacts and friction elements, switches in forces."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import lru_cache

from xdynamics.expressions import Binary, Call, Name, Node, derivative, dimension_of, free_names
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.model.constraints import Assignment
from xdynamics.model.delays import is_before
from xdynamics.model.model import Model
from xdynamics.model.motion import delayed_dimensions, motion
from xdynamics.model.parts import Contact, Event, Friction, Function
from xdynamics.model.reactions import NORMAL, TANGENT, Reaction, mode_number, reaction_dimensions, reactions
from xdynamics.model.regime_model import RegimeModel
from xdynamics.model.sliding import SlidingModel
from xdynamics.model.switches import LOCATED_EVERYWHERE, bounded_function, switch_side, where_it_decides
from xdynamics.units import NONE, Dimension, Quantity

# what a detector is for: an event of the model; a gap that closes, a contact that pulls, a contact that has settled;
# slip that stops, grip that is lost; a switch hidden in a force, which jumps or has a kink there; the gaps of many links,
# which `march.assembly` looks for; a periodic event; the share of a switch that the motion slides along
OCCASION, GAP, PULL, LIMIT, SLIP, GRIP, SWITCH, KINK, LINKS, PERIODIC, SHARE = range(11)


@dataclass(frozen=True)
class Detector:
    """One function whose zeros are located during a march.

    Attributes
    ----------
    name : str
        The event, contact or friction element that it belongs to.
    function : Node
        With definitions expanded; it may name reactions.
    watched : Node, optional
        For a switch inside a `where`: the function where the switch has an effect, and 1, which has no zero, elsewhere.
    role : int
    event : Event
        The event of the model, where the role is `OCCASION` or `PERIODIC`.
    reaction : int
        The number of the reaction that it watches, else -1.
    at_zero : int
        The side that zero belongs to, of a switch.
    sampled : bool
        Whether nothing is known of the function between the states where it is evaluated: one written in Python, or of
        delayed values.
    drive : str
        The drive, where the switch is the next point of a table.
    is_switch : bool
        Whether it is of a switch in a force, with a side.
    time_tolerance, position_tolerance : Quantity, optional
    """

    name: str
    function: Node
    role: int
    time_tolerance: Quantity | None = None
    direction: str = "either"
    event: Event = field(default_factory=lambda: Event(ZERO))
    reaction: int = -1
    at_zero: int = 0
    sampled: bool = False
    drive: str = ""
    position_tolerance: Quantity | None = None
    watched: Node | None = None
    is_switch: bool = False

    @property
    def looked_at(self) -> Node:
        """The expression whose zero is located."""
        return self.function if self.watched is None else self.watched


@lru_cache(maxsize=64)
def detectors(model: Model) -> tuple[Detector, ...]:
    """Return the detectors of a model: its events in their order, contacts, friction, and switches in its forces."""
    contacts_of_many = (
        Detector(name, ONE, LINKS, contact.time_tolerance, "falling", position_tolerance=contact.position_tolerance)
        for name, contact in model.assemblies.items()
    )
    return (*_event_detectors(model), *_reaction_detectors(model), *contacts_of_many, *_switch_detectors(model))


def _event_detectors(model: Model) -> Iterator[Detector]:
    slid = _slid_functions(model)
    for i, (name, event) in enumerate(model.elements.events.items()):
        if i in slid:
            yield Detector(name, slid[i], SHARE, event.time_tolerance, "falling")
            continue
        sampled = isinstance(event.function, Function) or reads_past(event.function, model)
        tree = (
            Name(python_value(name))
            if isinstance(event.function, Function)
            else model.elements.expanded(event.function)
        )
        position_tolerance, role = event.position_tolerance, OCCASION
        if event.every is not None:
            tree, role = ONE, PERIODIC
        yield Detector(
            name,
            tree,
            role,
            event.time_tolerance,
            event.direction,
            event,
            sampled=sampled,
            position_tolerance=position_tolerance,
        )


def _reaction_detectors(model: Model) -> Iterator[Detector]:
    parts: dict[str, Contact | Friction] = {**model.elements.contacts, **model.elements.frictions}
    for k, reaction in enumerate(reactions(model)):
        part = parts[reaction.owner]
        if reaction.sort == NORMAL:
            until = Binary("-", Name("t"), Name(mode_number(reaction)))
            watched = [(GAP, reaction.gap, "falling"), (PULL, Name(reaction.name), "falling"), (LIMIT, until, "rising")]
        else:
            grip_limit = (
                Binary("*", reaction.sticking_limit, Name(reactions(model)[reaction.normal].name))
                if reaction.sort == TANGENT
                else reaction.sticking_limit
            )
            grip = Binary("-", grip_limit, Call("abs", (Name(reaction.name),)))
            watched = [(SLIP, reaction.rate, "either"), (GRIP, grip, "falling")]
        for role, tree, direction in watched:
            tolerance = _gap_tolerance(part, role)
            yield Detector(
                reaction.owner,
                tree,
                role,
                part.time_tolerance,
                direction,
                reaction=k,
                position_tolerance=tolerance,
            )


def _switch_detectors(model: Model) -> Iterator[Detector]:
    """Yield the switches in forces, each watched where it has an effect."""
    if not isinstance(model, RegimeModel):
        return
    sides = {(switch.owner, switch.function): switch_side(i) for i, switch in enumerate(model.switches)}
    slid, first = _slid_functions(model), len(model.elements.events)
    for i, switch in enumerate(model.switches):
        if first + i in slid:
            yield Detector(switch.name, slid[first + i], SHARE, direction="falling", is_switch=True)
            continue
        role, watched = SWITCH if switch.jumps else KINK, bounded_function(model, switch.function)
        if switch.nested and model.located != LOCATED_EVERYWHERE:
            owner_sides = {function: name for (owner, function), name in sides.items() if owner == switch.owner}
            watched = where_it_decides(switch, owner_sides, watched, ONE)
        past = reads_past(switch.function, model)
        yield Detector(
            switch.name,
            switch.function,
            role,
            at_zero=switch.at_zero,
            sampled=past,
            drive=switch.drive,
            watched=None if watched is switch.function else watched,
            is_switch=True,
        )


def _slid_functions(model: Model) -> dict[int, Node]:
    """Return what is watched for the detectors of surfaces that a model slides along: the share at the first, else 1."""
    weights = model.weights if isinstance(model, SlidingModel) else {}
    functions: dict[int, Node] = {}
    for surface, weight in weights.items():
        (first, _), *others = surface.detectors(model)
        functions |= {first: Binary("*", weight, Binary("-", ONE, weight))} | dict.fromkeys([i for i, _ in others], ONE)
    return functions


def reads_past(tree: Node, model: Model) -> bool:
    """Whether an expression has delayed values, of which nothing is known between the states where it is evaluated."""
    return bool(model.delays) and any(is_before(name) for name in free_names(model.elements.expanded(tree)))


def _gap_tolerance(part: Contact | Friction, role: int) -> Quantity | None:
    """Return the position tolerance of a contact's gap; its other detectors have none."""
    return part.position_tolerance if role == GAP and isinstance(part, Contact) else None


def python_value(event: str) -> str:
    """Name the value of an event function that is written in Python."""
    return f"_python_{event}"


def python_values(model: Model) -> dict[str, Function]:
    """Return the event functions written in Python, by the names of their values."""
    functions = {python_value(name): entry.function for name, entry in model.elements.events.items()}
    return {name: entry for name, entry in functions.items() if isinstance(entry, Function)}


def labels(watched: Iterable[Detector]) -> tuple[str, ...]:
    """Return the names used in `event_detector`: of events, contacts, friction elements, switches."""
    return tuple(dict.fromkeys(detector.name for detector in watched))


def function_dimension(model: Model, detector: Detector) -> Dimension:
    """Return the dimension of a detector's function."""
    if detector.role == LIMIT:
        return model.time_unit.dimension
    if detector.drive:
        return NONE
    if isinstance(detector.event.function, Function):
        return detector.event.unit.dimension if detector.event.unit else NONE
    if detector.role == LINKS:
        return dimension_of(model.assemblies[detector.name].gap, model.elements.dimensions)
    return dimension_of(detector.function, _known_dimensions(model))


@lru_cache(maxsize=8)
def _known_dimensions(model: Model) -> Mapping[str, Dimension]:
    """Return the dimensions of all names in functions of detectors, merged once for many detectors."""
    return model.elements.dimensions | reaction_dimensions(model) | delayed_dimensions(model)


@lru_cache(maxsize=64)
def differentiated_reactions(model: Model) -> tuple[Assignment, ...]:
    """Return the assignments of the motion up to the reactions, each followed by its time derivative along the motion.

    The time derivative of ``x`` is named ``_rate_of_x``.
    """
    if not reactions(model):
        return ()
    last = max(
        i
        for i, assignment in enumerate(motion(model.elements))
        if assignment.name in {reaction.name for reaction in reactions(model)}
    )
    rates, assignments = dict(model.elements.rates), []
    for assignment in motion(model.elements)[: last + 1]:
        assert not isinstance(assignment.value, Function)  # noqa: S101 - a model with both is refused
        assignments.append(assignment)
        if (rate := derivative(assignment.value, rates)) != ZERO:
            rates[assignment.name] = Name(f"_rate_of_{assignment.name}")
            assignments.append(Assignment(f"_rate_of_{assignment.name}", rate))
    return tuple(assignments)


def function_rate(model: Model, detector: Detector) -> Node:
    """Return the time derivative of a detector's function along the motion; see `differentiated_reactions`."""
    rates: dict[str, Node] = {
        assignment.name.removeprefix("_rate_of_"): Name(assignment.name)
        for assignment in differentiated_reactions(model)
        if assignment.name.startswith("_rate_of_")
    }
    return derivative(detector.looked_at, ChainMap(rates, model.elements.rates))


def argument_motion(model: Model, drive: str) -> tuple[Node, Node, Node]:
    """Return the argument of a drive, its rate, and the derivatives that set it in motion from rest.

    Of an argument that reads velocities the last is the rate again: how accelerations change is not known.
    """
    elements = model.elements
    argument = elements.looked_up_at[drive]
    rate = derivative(argument, elements.rates)
    unknown = {name for name, rate_tree in elements.rates.items() for name in free_names(rate_tree)} - {*elements.rates}
    return argument, rate, rate if free_names(rate) & unknown else derivative(rate, elements.rates)


def function_bend(model: Model, detector: Detector) -> Node:
    """Return the second time derivative of a gap along the motion."""
    return derivative(function_rate(model, detector), model.elements.rates)


__all__ = [
    "GAP",
    "GRIP",
    "KINK",
    "LIMIT",
    "OCCASION",
    "PERIODIC",
    "PULL",
    "SLIP",
    "SWITCH",
    "Detector",
    "Reaction",
    "argument_motion",
    "detectors",
    "differentiated_reactions",
    "function_bend",
    "function_dimension",
    "function_rate",
    "labels",
    "python_values",
]
