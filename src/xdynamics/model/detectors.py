"""Everything that a march watches for: the events of a model, and what its contacts and friction elements may do."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache

from xdynamics.expressions import Binary, Call, Name, Node, derivative, dimension_of
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.model.mass import Assignment
from xdynamics.model.model import Model
from xdynamics.model.motion import motion
from xdynamics.model.parts import Contact, Event, Friction, Function
from xdynamics.model.reactions import NORMAL, TANGENT, Reaction, reaction_dimensions, reactions, way
from xdynamics.model.switches import SidedEverywhere, side, watched_by, where_it_decides
from xdynamics.units import NONE, Dimension, Quantity

# what a detector is for: an event of the model; a gap that closes, a contact that pulls, one that has settled; a slip
# that comes to rest, a grip that is lost; a switch hidden in a force, which jumps there, or bends
OCCASION, GAP, PULL, LIMIT, SLIP, GRIP, SWITCH, KINK = range(8)


@dataclass(frozen=True)
class Detector:
    """One function whose zero is watched for.

    Attributes
    ----------
    name : str
        The event, contact or friction element that it belongs to.
    function : Node
        Without definitions; it may name reactions.
    watched : Node, optional
        Of a switch that decides something in places alone: the function there, and elsewhere 1, which has no zero.
    role : int
    event : Event
        What the model says, of an occasion.
    reaction : int
        The number of the reaction that it watches, else -1.
    at_zero : int
        Of a switch, the side that zero belongs to.
    sampled : bool
        Whether nothing is known of the function between the places where it is looked at: one in Python.
    drive : str
        Of a switch that is a table's next point, the drive.
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

    @property
    def looked_at(self) -> Node:
        """What is looked at for a zero."""
        return self.function if self.watched is None else self.watched


@lru_cache(maxsize=64)
def detectors(model: Model) -> tuple[Detector, ...]:
    """Return what a model watches for: its events in their order, contacts, friction, and the switches in its forces."""
    found = []
    for name, event in model.events.items():
        sampled = isinstance(event.function, Function)
        tree = Name(python_value(name)) if isinstance(event.function, Function) else model.expanded(event.function)
        place = event.position_tolerance
        found.append(Detector(name, tree, OCCASION, event.time_tolerance, event.direction, event, sampled=sampled, position_tolerance=place))  # fmt: skip
    for k, one in enumerate(reactions(model)):
        part = model.frictions[one.owner] if one.owner in model.frictions else model.contacts[one.owner]
        if one.sort == NORMAL:
            until = Binary("-", Name("t"), Name(way(one)))
            watched = [(GAP, one.gap, "falling"), (PULL, Name(one.name), "falling"), (LIMIT, until, "rising")]
        else:
            held = Binary("*", one.most, Name(reactions(model)[one.normal].name)) if one.sort == TANGENT else one.most
            grip = Binary("-", held, Call("abs", (Name(one.name),)))
            watched = [(SLIP, one.rate, "either"), (GRIP, grip, "falling")]
        found += [
            Detector(one.owner, tree, role, part.time_tolerance, to, reaction=k, position_tolerance=_place(part, role))
            for role, tree, to in watched
        ]
    return (*found, *_switching(model))


def _switching(model: Model) -> Iterator[Detector]:
    """Yield the switches in forces, each looked for where it decides something."""
    sides = {(each.owner, each.function): side(i) for i, each in enumerate(watched_by(model))}
    for each in watched_by(model):
        role, watched = SWITCH if each.jumps else KINK, None
        if each.nested and not isinstance(model, SidedEverywhere):
            own = {function: name for (owner, function), name in sides.items() if owner == each.owner}
            watched = where_it_decides(each, own, each.function, ONE)
        yield Detector(each.name, each.function, role, at_zero=each.at_zero, drive=each.drive, watched=watched)


def _place(part: Contact | Friction, role: int) -> Quantity | None:
    """Return how near to zero a gap is to be; of what else is watched of a contact nothing is asked."""
    return part.position_tolerance if role == GAP and isinstance(part, Contact) else None


def python_value(event: str) -> str:
    """Name the value of an event function that is written in Python."""
    return f"_python_{event}"


def python_values(model: Model) -> dict[str, Function]:
    """Return the event functions that are written in Python, by the names of their values."""
    found = {python_value(name): one.function for name, one in model.events.items()}
    return {name: one for name, one in found.items() if isinstance(one, Function)}


def labels(watched: Iterable[Detector]) -> tuple[str, ...]:
    """Return the names that stand in `event_detector`: of events, contacts, friction elements, switches."""
    return tuple(dict.fromkeys(one.name for one in watched))


def function_dimension(model: Model, detector: Detector) -> Dimension:
    """Return the dimension of a detector's function."""
    if detector.role == LIMIT:
        return model.time_unit.dimension
    if detector.drive:
        return NONE
    if detector.sampled:
        return detector.event.unit.dimension if detector.event.unit else NONE
    return dimension_of(detector.function, model.dimensions | reaction_dimensions(model))


@lru_cache(maxsize=64)
def followed(model: Model) -> tuple[Assignment, ...]:
    """Return what of the motion leads to the reactions, and how fast all of it changes along the motion.

    The time derivative of ``x`` is named ``_rate_of_x``.
    """
    if not reactions(model):
        return ()
    last = max(i for i, one in enumerate(motion(model)) if one.name in {this.name for this in reactions(model)})
    known, found = dict(model.rates), []
    for one in motion(model)[: last + 1]:
        assert not isinstance(one.value, Function)  # noqa: S101 - a model with both is refused
        found.append(one)
        if (rate := derivative(one.value, known)) != ZERO:
            known[one.name] = Name(f"_rate_of_{one.name}")
            found.append(Assignment(f"_rate_of_{one.name}", rate))
    return tuple(found)


def function_rate(model: Model, detector: Detector) -> Node:
    """Return the time derivative of a detector's function along the motion; see `followed`."""
    known = {one.name.removeprefix("_rate_of_"): Name(one.name) for one in followed(model) if one.name.startswith("_rate_of_")}  # fmt: skip
    return derivative(detector.looked_at, {**known, **model.rates})


def function_bend(model: Model, detector: Detector) -> Node:
    """Return the second time derivative of a gap along the motion."""
    return derivative(function_rate(model, detector), model.rates)


__all__ = ["GAP", "GRIP", "KINK", "LIMIT", "OCCASION", "PULL", "SLIP", "SWITCH", "Detector", "Reaction", "detectors", "followed", "function_bend", "function_dimension", "function_rate", "labels", "python_values"]  # fmt: skip
