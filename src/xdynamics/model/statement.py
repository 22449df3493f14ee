"""The statement of a model: a model file, read and typed but not yet checked, with its closed forms.

A closed form states the expected motion of a run, and the bound within which the run should agree.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, get_args

from xdynamics.expressions import Call, Node, dimension_of, free_names
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.tree import DELAYED, every
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.body_sections import Body
from xdynamics.model.elementwise import Diagonal
from xdynamics.model.given_values import Values
from xdynamics.model.joint_sections import Joint
from xdynamics.model.kinds import Kind
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.links import Links, related
from xdynamics.model.parts import (
    NOBODY,
    Authorship,
    Constraint,
    Contact,
    Controller,
    Coordinate,
    Drive,
    Event,
    Fitted,
    Force,
    Friction,
    Function,
    Observable,
    Parameter,
    Pictured,
    Regime,
    State,
    Validation,
)
from xdynamics.model.uncertainty import Discrepancy
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.naming import quantity_name
from xdynamics.units import CALENDAR, CONSTANTS, SECONDS, Dimension, Quantity, Unit, parse_quantity, spell


@dataclass(frozen=True)
class Statement:
    """The sections of a model, each entry read."""

    name: str
    description: str
    coordinates: dict[str, Coordinate]
    parameters: dict[str, Parameter]
    mass: Sequence[tuple[Node, ...]]
    definitions: dict[str, Node] = field(default_factory=dict)
    forces: dict[str, Force] = field(default_factory=dict)
    drives: dict[str, Drive] = field(default_factory=dict)
    states: dict[str, State] = field(default_factory=dict)
    initial: dict[str, Quantity] = field(default_factory=dict)
    history: dict[str, Node] = field(default_factory=dict)  # what delayed values are before the start
    starts: dict[str, Parameter] = field(default_factory=dict)  # initial values with a spread or a description
    events: dict[str, Event] = field(default_factory=dict)
    contacts: dict[str, Contact] = field(default_factory=dict)
    frictions: dict[str, Friction] = field(default_factory=dict)
    constraints: dict[str, Constraint] = field(default_factory=dict)
    controllers: dict[str, Controller] = field(
        default_factory=dict
    )  # what they hold is among states and initial values
    regimes: dict[str, Regime] = field(default_factory=dict)
    regime: str = ""  # that the motion begins in
    consistent: bool = False  # whether values at the start are moved to where constraints hold
    observables: dict[str, Node] = field(default_factory=dict)
    observed: dict[str, Observable] = field(default_factory=dict)  # observables with a chosen unit or a description
    run: dict[str, Any] = field(default_factory=dict)
    validation: dict[str, Validation] = field(default_factory=dict)
    correlations: dict[tuple[str, str], float] = field(default_factory=dict)
    discrepancy: dict[str, Discrepancy] = field(default_factory=dict)
    time_unit: Unit = SECONDS
    shown_time: Unit | None = None  # that people read times in; they are recorded in seconds
    pictured: Pictured = field(default_factory=Pictured)  # what figures show
    fit: Fitted | None = None  # where the parameters come from
    about: Authorship = NOBODY  # who stands for it; in no text of the model, which is content of a record
    at_rest: Sequence[str] = ()  # velocities without an initial value: 0
    lagrangian: Lagrangian | None = None  # from which the mass and some forces are derived
    extents: dict[str, Extent] = field(default_factory=dict)  # dimensions
    relations: dict[str, Links] = field(default_factory=dict)
    arrays: dict[str, Values] = field(default_factory=dict)  # parameters with dimensions
    starting: dict[str, Values] = field(default_factory=dict)  # values at the start with dimensions, or by expressions
    bodies: dict[str, Body] = field(default_factory=dict)  # what they stand for is among coordinates, states and so on
    joints: dict[str, Joint] = field(default_factory=dict)  # what they stand for is among constraints and definitions
    assemblies: dict[str, Contact] = field(default_factory=dict)  # contacts of many links, each as it is of the first

    @cached_property
    def bare_shapes(self) -> Shapes:
        """Dimensions and relations with their links, without the quantities along them; a `ModelError` on faults."""
        ledger = Ledger(f"model '{self.name}'", ModelError)
        shapes = related(self.extents, self.relations, ledger)
        ledger.raise_faults()
        return shapes

    @cached_property
    def mass_entries(self) -> dict[tuple[int, int], Node]:
        """Every entry of the mass matrix that is not a literal zero, by row and column."""
        if isinstance(self.mass, Diagonal):
            return self.mass.entries
        return {
            (i, j): entry
            for i, row in enumerate(self.mass)
            for j, entry in enumerate(row)
            if entry is not ZERO and entry != ZERO
        }

    @cached_property
    def unit_constants(self) -> tuple[str, ...]:
        """Names of units that expressions may use as constants; of the calendar those that name nothing of the model's."""
        named_sections = (self.coordinates, self.parameters, self.definitions, self.drives, self.states, self.arrays)
        return (*CONSTANTS, *(name for name in CALENDAR if not any(name in section for section in named_sections)))

    @cached_property
    def calendar(self) -> tuple[str, ...]:
        """Years and months that expressions read: a law has constants for these alone."""
        calendar_names = self.unit_constants[len(CONSTANTS) :]
        if not calendar_names:
            return ()
        return tuple(name for name in calendar_names if name in self.names_read)

    @cached_property
    def names_read(self) -> frozenset[str]:
        """Every name that an expression or a function reads."""
        sections = {part.name: getattr(self, part.name) for part in fields(self)} | {"mass": self.mass_entries}
        read = {name for tree in trees_in(sections) for name in free_names(tree)}
        return frozenset(read.union(*(function.arguments for function in self.functions)))

    @cached_property
    def delayed(self) -> tuple[Call, ...]:
        """Every delayed value that an expression has, as it is written, each once."""
        sections = {part.name: getattr(self, part.name) for part in fields(self)} | {"mass": self.mass_entries}
        calls = (node for tree in trees_in(sections) for node in every(tree) if isinstance(node, Call))
        return tuple(dict.fromkeys(call for call in calls if call.function == DELAYED))

    @cached_property
    def functions(self) -> tuple[Function, ...]:
        """Everything written in Python, in the order written: force components, then event functions."""
        parts = [part for item in self.forces.values() for part in item.components.values()]
        parts += [item.function for item in self.events.values()]
        return tuple(item for item in parts if isinstance(item, Function))

    @cached_property
    def mass_is_full(self) -> bool:
        """Whether an entry off the diagonal is not a literal zero; of bodies with products of inertia, one of elements."""
        if any(body.has_products for body in self.bodies.values()):
            return True
        return not isinstance(self.mass, Diagonal) and any(i != j for i, j in self.mass_entries)


_NODES = get_args(Node)


def trees_in(part: Any) -> Iterator[Node]:
    """Yield every expression that a part of a statement holds."""
    if isinstance(part, _NODES):
        yield part
    elif isinstance(part, Mapping):
        for value in part.values():
            yield from trees_in(value)
    elif isinstance(part, (tuple, list)):
        for value in part:
            if type(value) is not float:  # of which a table may have a million
                yield from trees_in(value)
    elif is_dataclass(part):
        for part_field in fields(part):
            yield from trees_in(getattr(part, part_field.name))


ROUNDING, ORDER, BAND, UNSCALED = "rounding", "order", "band", "unscaled"
_FROM_ORDER = re.compile(r"rounding from order ([1-9]\d?)")
WORDS = f"'{ROUNDING}', '{ROUNDING} from order 2', '{ORDER}', '{BAND}', '{UNSCALED}'"


def _read_bound(entry: Any, *_: Any) -> str | Quantity:
    """Read a bound: a quantity, or a word for how it is derived."""
    if isinstance(entry, str) and (entry in (ROUNDING, ORDER, BAND, UNSCALED) or _FROM_ORDER.fullmatch(entry)):
        return entry
    try:
        quantity = parse_quantity(entry)
    except InputError:
        raise InputError(f"bound is {entry!r}, needs a quantity like '1 mm', or one of {WORDS}") from None
    if not quantity.value > 0.0:
        raise InputError(f"bound is {entry!r}, needs a positive one")
    return quantity


BOUND = Kind(f"quantity, {WORDS}".replace("'", '"'), _read_bound, lambda bound, _: str(bound))


def exact_from(bound: str) -> int:
    """Return the order from which methods have rounding errors only; 0 if all methods do."""
    match = _FROM_ORDER.fullmatch(bound)
    return int(match[1]) if match else 0


def check_validation(statement: Statement, dimensions: dict[str, Dimension], ledger: Ledger) -> None:
    """Note faults in names and dimensions of closed forms, which may read time, parameters and unit names.

    Of a statement with dimensions each is checked once, for all elements of its quantity.
    """
    moving = {
        *statement.coordinates,
        *statement.states,
        *statement.drives,
        *(f"v_{name}" for name in statement.coordinates),
    }
    event_names = {*statement.events, *statement.contacts, *statement.frictions}
    for name, form in statement.validation.items():
        with ledger.entry(f"validation '{name}'"):
            dimension = dimension_of(form.expression, dimensions)
            if computed := sorted(free_names(form.expression) & moving):
                raise InputError(
                    f"reads '{computed[0]}', which is what is computed; a closed form is of t and parameters"
                )
            quantity, event = (quantity_name(word) for word in (form.quantity, form.event))
            if event and event not in event_names:
                raise InputError(
                    f"event '{form.event}' is none of the model's; there are {', '.join(sorted(event_names)) or 'none'}"
                )
            needed = (
                statement.time_unit.dimension
                if quantity == "t" and event
                else dimensions.get(quantity)
                if quantity in moving
                else None
            )
            if needed is not None and dimension != needed:
                raise InputError(f"has units '{dimension}', needs '{needed}' of '{form.quantity}'")
            if isinstance(form.bound, Quantity) and form.bound.unit.dimension != dimension:
                raise InputError(
                    f"bound '{form.bound}' has units '{form.bound.unit.dimension}', needs '{spell(dimension).text}'"
                )
