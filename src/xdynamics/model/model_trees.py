"""The trees that follow from a model's statement: forces of potentials, rates, units, dependences.

The sections of a model are read by the names of its file, and are never changed in place. Trees are of quantities along
their dimensions; those of the model of its elements, `Model.elements`, are of single numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, NoReturn, TypeVar

from xdynamics.expressions import Name, Node, derivative, derivatives, expand, free_names
from xdynamics.expressions.calculus import ONE, multiply, negative
from xdynamics.faults import InputError, ModelError, display_text, first_names
from xdynamics.model import toml
from xdynamics.model.body_sections import Body
from xdynamics.model.delays import (
    argument_before,
    delayed_rates,
    delays_of,
    slope_before,
    value_before,
    with_delayed_names,
)
from xdynamics.model.drive_arguments import lookup_argument
from xdynamics.model.joint_sections import Joint
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.parts import (
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
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import Discrepancy
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import expand_definitions
from xdynamics.units import Dimension, Quantity, Unit

Part = TypeVar("Part")
SHOWN = 6  # entries of a section that its repr has


class ReadOnlySection(Mapping[str, Part]):
    """A section of a model by the names of its file: ``u[0]``, ``r[Jupiter, x]``; any label may be given as a number.

    A model never changes: what follows from its numbers is kept beside it. `Model.replace` returns another one.

    Parameters
    ----------
    title : str
    entries : mapping of str to Part
        By the names that they have inside.
    shapes : Shapes

    Examples
    --------
    >>> from xdynamics.shapes import Extent
    >>> from xdynamics.units import parse_quantity
    >>> shapes = Shapes({"site": Extent("site", 2)}, {}, {"u": ("site",)})
    >>> start = ReadOnlySection("initial", {"u·0": parse_quantity("1 m"), "u·1": parse_quantity("2 m")}, shapes)
    >>> start
    <initial: u[0] = 1.0 m, u[1] = 2.0 m>
    >>> list(start), str(start["u[-1]"]), "u[2]" in start
    (['u[0]', 'u[1]'], '2.0 m', False)
    """

    def __init__(self, title: str, entries: Mapping[str, Part], shapes: Shapes) -> None:
        self._title, self._entries, self._shapes = title, entries, shapes

    def __getitem__(self, name: str) -> Part:
        try:
            return self._entries[self._shapes.internal_name(name)]
        except InputError as error:  # a dimension has no such element
            raise KeyError(str(error)) from None
        except KeyError:
            pass
        if dims := self._shapes.dims.get(name):
            raise KeyError(
                f"'{name}' is along {', '.join(dims)}; ask for an element, like '{display_text(self._shapes.first(name))}'"
            )
        raise KeyError(
            f"there is no '{name}' in the section {self._title}; there are {first_names([*islice(self, SHOWN + 1)])}"
        )

    def __iter__(self) -> Iterator[str]:
        return map(display_text, self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __or__(self, right: Mapping[str, Any]) -> dict[str, Any]:
        return {**self, **right}

    def __ror__(self, left: Mapping[str, Any]) -> dict[str, Any]:
        return {**left, **self}

    def __repr__(self) -> str:
        entry_texts = [self._entry_text(name) for name in islice(self, SHOWN)]
        return f"<{self._title}: {', '.join([*entry_texts, *(['…'] * (len(self) > SHOWN))]) or 'none'}>"

    def _entry_text(self, name: str) -> str:
        """Return an entry in words: a quantity, a parameter's value, or the unit of a moving quantity."""
        part: Any = self[name]
        if dims := getattr(part, "dims", ()):
            name = f"{name}({', '.join(dims)})"
        quantity = getattr(part, "quantity", part)
        return (
            f"{name} in {part.unit.text}"
            if not hasattr(quantity, "value")
            else f"{name} = {quantity}".removesuffix(" 1")
        )

    def _refuse(self, *_: Any, **__: Any) -> NoReturn:
        raise ModelError(
            f"{self._title} of a model cannot be changed in place; model.replace({self._title}={{…}}) returns another"
            " model with new values"
        )

    __setitem__ = __delitem__ = __ior__ = _refuse
    clear = pop = popitem = setdefault = update = _refuse


BY_NAME = ("coordinates", "states", "parameters", "initial")  # sections by the names of the file; see `ReadOnlySection`


class ModelTrees:
    """The sections of a statement with the trees derived from them; every name of a section is an attribute."""

    statement: Statement
    name: str
    description: str
    mass: Sequence[tuple[Node, ...]]
    definitions: dict[str, Node]
    forces: dict[str, Force]
    drives: dict[str, Drive]
    history: dict[str, Node]
    starts: dict[str, Parameter]
    events: dict[str, Event]
    contacts: dict[str, Contact]
    frictions: dict[str, Friction]
    constraints: dict[str, Constraint]
    consistent: bool
    assemblies: dict[str, Contact]
    bodies: dict[str, Body]
    joints: dict[str, Joint]
    regimes: dict[str, Regime]
    regime: str
    observables: dict[str, Node]
    observed: dict[str, Observable]
    controllers: dict[str, Controller]
    run: dict[str, Any]
    validation: dict[str, Validation]
    correlations: dict[tuple[str, str], float]
    discrepancy: dict[str, Discrepancy]
    time_unit: Unit
    pictured: Pictured
    fit: Fitted | None
    about: Authorship
    lagrangian: Lagrangian | None
    dimensions: dict[str, Dimension]
    shapes: Shapes
    _element_statement: Statement  # of single numbers; the statement itself where nothing has dimensions
    _element_dimensions: dict[str, Dimension]

    @cached_property
    def coordinates(self) -> Mapping[str, Coordinate]:
        """The coordinates, each with its unit and its dimensions."""
        return ReadOnlySection("coordinates", self.statement.coordinates, self.shapes)

    @cached_property
    def states(self) -> Mapping[str, State]:
        """The first-order states, each with its unit and its dimensions."""
        return ReadOnlySection("states", self.statement.states, self.shapes)

    @cached_property
    def parameters(self) -> Mapping[str, Parameter]:
        """The parameters, those with dimensions by element: ``m[Sun]``."""
        return ReadOnlySection("parameters", self._element_statement.parameters, self.shapes)

    @cached_property
    def initial(self) -> Mapping[str, Quantity]:
        """Time, coordinates, velocities and states at the start, those with dimensions by element: ``r[Sun, x]``."""
        return ReadOnlySection("initial", self._element_statement.initial, self.shapes)

    @property
    def functions(self) -> dict[str, Callable[..., float]]:
        """The Python functions that are available, by name."""
        return {function.name: function.callable for function in self.python_functions if function.callable is not None}

    def require_functions(self) -> None:
        """Refuse to march without the Python functions that forces and events call.

        Raises
        ------
        ModelError
            Naming those that are not available.
        """
        missing = [function.name for function in self.python_functions if function.callable is None]
        if missing:
            raise ModelError(
                f"the model calls the Python functions {', '.join(missing)}; hand them over as functions={{name:"
                " function}"
            )

    @property
    def python_functions(self) -> list[Function]:
        """Everything written in Python: force components and event functions."""
        return list({function.name: function for function in self.statement.functions}.values())

    @property
    def python_forces(self) -> list[Function]:
        """Every force component written in Python."""
        components = [component for force in self.statement.forces.values() for component in force.components.values()]
        return list({component.name: component for component in components if isinstance(component, Function)}.values())

    @cached_property
    def form(self) -> str:
        """The model as TOML without numbers of parameters, tables and the start: the source of compiled programs."""
        statement = self.statement
        parameters = {
            name: replace(entry, quantity=Quantity(0.0, entry.quantity.unit), spread=None)
            for name, entry in statement.parameters.items()
        }
        initial = {name: Quantity(0.0, entry.unit) for name, entry in statement.initial.items()}
        drives = {
            name: replace(drive, table=drive.table.form, description="") for name, drive in statement.drives.items()
        }
        stripped = replace(
            statement,
            name="",
            description="",
            parameters=parameters,
            drives=drives,
            arrays={name: values.form for name, values in statement.arrays.items()},
            initial=initial,
            starting={},
            starts={},
            observed={name: Observable(tree) for name, tree in statement.observables.items()},
            run={},
            validation={},
            correlations={},
            discrepancy={},
            pictured=Pictured(),
            fit=None,
            at_rest=(),
        )
        return toml.model_toml(stripped)

    @cached_property
    def units(self) -> dict[str, Unit]:
        """The unit of every coordinate, velocity and first-order state: as declared; of a velocity, that per time."""
        statement = self.statement
        coordinate_units = {name: part.unit for name, part in statement.coordinates.items()}
        velocity_units = {velocity(name): unit.per(self.time_unit) for name, unit in coordinate_units.items()}
        return coordinate_units | velocity_units | {name: part.unit for name, part in statement.states.items()}

    @cached_property
    def force_components(self) -> Mapping[str, Mapping[str, Node | Function]]:
        """The components of every force term; those of a potential are derived: -dV/dq."""
        return {term: self._derived_components(force) for term, force in self.forces.items()}

    @cached_property
    def uncertain(self) -> dict[str, Parameter]:
        """The inputs with an uncertainty by element: parameters, then values at the start."""
        return {
            name: parameter
            for name, parameter in (self._element_statement.parameters | self._element_statement.starts).items()
            if parameter.uncertainty > 0
        }

    @property
    def mass_is_full(self) -> bool:
        """Whether an entry off the diagonal is not a literal zero."""
        return self.statement.mass_is_full

    def expanded(self, node: Node) -> Node:
        """Return an expression with every definition substituted, and with names for delayed values."""
        if self.shapes.dims:
            return expand_definitions(node, self.definitions, self.shapes)
        tree = expand(node, self.definitions)
        return with_delayed_names(tree, self.delays, self.moving | {*self.drives}) if self.delays else tree

    @cached_property
    def delays(self) -> tuple[Node, ...]:
        """The different delays, with definitions expanded."""
        return delays_of(self.statement)

    @cached_property
    def moving(self) -> frozenset[str]:
        """The names of coordinates, velocities and states."""
        return frozenset(self.units)

    def reads(self, node: Node | Function) -> set[str]:
        """Return the names that an expression depends on, also through definitions and drives."""
        names = set(node.arguments) if isinstance(node, Function) else free_names(self.expanded(node))
        drive_arguments = {
            read
            for name in names
            if name in self.drives
            for read in free_names(self.expanded(self.drives[name].argument))
        }
        in_definitions = {
            name for definition in names if definition in self.definitions for name in self.reads(Name(definition))
        }
        return names | drive_arguments | in_definitions

    def rate_of(self, node: Node) -> Node:
        """Return an expression's time derivative along the motion, with `a_q`, `rate_x` and `_slope_d` as names."""
        return derivative(self.expanded(node), self.rates)

    @cached_property
    def looked_up_at(self) -> dict[str, Node]:
        """The argument of each drive's table: t where the argument is linear in time, else its expression."""
        moving = {*self.units, *self.drives} if self.drives else set[str]()
        return {name: lookup_argument(self.expanded(drive.argument), moving) for name, drive in self.drives.items()}

    @cached_property
    def rates(self) -> dict[str, Node]:
        """The time derivative along the motion of every name that varies."""
        rates: dict[str, Node] = {"t": ONE}
        for name in self.statement.coordinates:
            rates |= {name: Name(velocity(name)), velocity(name): Name(acceleration(name))}
        rates |= {name: Name(rate(name)) for name in self.statement.states}
        for name in self.drives:
            rates[name] = multiply(Name(f"_slope_{name}"), derivative(self.looked_up_at[name], rates))
        for delay in range(len(self.delays)):
            rates |= delayed_rates(delay, self.statement.coordinates, self.statement.states)
            for name in self.drives:
                past_value, past_argument = (
                    value_before(delay, name),
                    argument_before(self.looked_up_at[name], self.moving, delay),
                )
                rates[past_value] = multiply(Name(slope_before(past_value)), derivative(past_argument, rates))
        return rates

    def _derived_components(self, force: Force) -> Mapping[str, Node | Function]:
        if force.components or force.potential is None:
            return force.components
        rates: dict[str, dict[str, Node]] = {name: {name: ONE} for name in self.statement.coordinates}
        gradient = derivatives(self.expanded(force.potential), rates)
        return {name: negative(gradient[name]) for name in self.statement.coordinates if name in gradient}
