"""A model's elements: what a statement with dimensions is as one of single numbers, and which name has which dimensions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Node, derivatives, free_names, shown
from xdynamics.expressions.calculus import ONE, ZERO, negative
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.bodies import AXIS, products_of_inertia, torques_of_potential
from xdynamics.model.controllers import each_tree
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import Table
from xdynamics.model.elementwise import Elementwise, Numbers, ParameterNumbers, always, finite, in_si
from xdynamics.model.entries import columns_of_drive
from xdynamics.model.given_values import Values, unit_of
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.lazy_trees import Diagonal, ForceOfPotential
from xdynamics.model.parts import (
    MOST_REACTIONS,
    Contact,
    Controller,
    Drive,
    Event,
    Force,
    Function,
    Observable,
    Parameter,
    State,
    Validation,
)
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, at, dims_of, gradient, written
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.naming import DOT, parted
from xdynamics.shapes.trees import expanded, total
from xdynamics.units import Quantity, Unit, constant

Place = Mapping[str, int]
Part = TypeVar("Part")


class Elements:
    """Makes the statement of single numbers of one with dimensions."""

    def __init__(self, statement: Statement, shapes: Shapes) -> None:
        self.statement, self.shapes = statement, shapes

    def whole(self) -> Statement:
        """Return the statement of the elements.

        Raises
        ------
        ModelError
            With every fault of values at the start that are expressions.
        """
        old, trees = self.statement, self._trees
        parameters = self._parameters()
        forces = {name: self._force(force) for name, force in old.forces.items()}
        new = replace(
            old,
            coordinates=self._each({name: always(replace(part, dims=())) for name, part in old.coordinates.items()}),
            parameters=parameters,
            mass=self._mass(),
            definitions=trees(old.definitions),
            forces=forces,
            drives=_by_element(self._drive, old.drives),
            states=self._each({name: partial(self._state, part) for name, part in old.states.items()}),
            events=_by_element(self._event, old.events),
            contacts={} if self._many else _by_element(self._contact, old.contacts),
            assemblies={name: next(self._contact(name, part))[1] for name, part in old.contacts.items()}
            if self._many
            else {},
            frictions=_by_element(partial(self._of_keys, ("slip", "kinetic", "static")), old.frictions),
            constraints=_by_element(partial(self._of_keys, ("holds", "rolls")), old.constraints),
            controllers={name: self._controller(part) for name, part in old.controllers.items()},
            observables=trees(old.observables),
            observed=self._each({name: partial(self._observable, part) for name, part in old.observed.items()}),
            validation=_by_element(self._closed_form, old.validation),
            correlations={(written(a), written(b)): value for (a, b), value in old.correlations.items()},
            discrepancy={
                element: part for name, part in old.discrepancy.items() for element in self._names(written(name))
            },
            pictured=replace(
                old.pictured,
                plane=tuple(pair for pair in old.pictured.plane for pair in self._pairs(*pair)),
                wrap=tuple(element for name in old.pictured.wrap for element in self._names(name)),
            ),
            run=self._run(),
            lagrangian=self._lagrangian(),
            extents={},
            relations={},
            arrays={},
            starting={},
        )
        return replace(new, **self._start(parameters))

    @property
    def _many(self) -> bool:
        """Whether contacts have more links than are written out."""
        sizes = (math.prod(self.shapes.shape(self.shapes.dims.get(name, ()))) for name in self.statement.contacts)
        doubled = (2 if part.slip else 1 for part in self.statement.contacts.values())
        return sum(map(math.prod, zip(sizes, doubled, strict=True))) > MOST_REACTIONS

    def _names(self, name: str) -> list[str]:
        return self.shapes.elements(name)

    def _placed(self, name: str) -> Iterator[tuple[str, Place]]:
        """Yield the elements of a quantity with their places."""
        for place in self.shapes.places(self.shapes.dims.get(name, ())):
            yield self.shapes.element(name, place), place

    def _trees(self, trees: Mapping[str, Node]) -> dict[str, Node]:
        return self._each({name: partial(self._at, tree) for name, tree in trees.items()})

    def _each(self, makers: Mapping[str, Callable[[Place], Part]]) -> dict[str, Part]:
        """Return what makers make for every element, where it is asked for."""
        return Elementwise(self.shapes, makers)

    def _at(self, tree: Node, place: Place) -> Node:
        return at(tree, place, self.shapes)

    def _state(self, part: State, place: Place) -> State:
        return replace(part, rate=self._at(part.rate, place), dims=())

    def _controller(self, part: Controller) -> Controller:
        return each_tree(part, lambda tree: self._at(tree, {}))

    def _observable(self, part: Observable, place: Place) -> Observable:
        return replace(part, expression=self._at(part.expression, place))

    def _parameters(self) -> dict[str, Parameter]:
        makers: dict[str, Callable[[Place], Parameter]] = {
            name: always(part) for name, part in self.statement.parameters.items()
        }
        for name, values in self.statement.arrays.items():
            makers[name] = ParameterNumbers(*self.numbers(values), values)
        return self._each(makers)

    def numbers(self, values: Values) -> tuple[Any, tuple[int, ...], Unit]:
        """Return a number for each element, with their shape and unit; no expression may read parameters."""
        shape = self.shapes.shape(values.dims)
        if values.tree is None:
            every = values.numbers * math.prod(shape) if len(values.numbers) == 1 else values.numbers
            return every, shape, unit_of(values)
        constants = _constants(self.statement.unit_constants)
        numbers = evaluate_elements(values.tree, values.dims, constants, self.shapes).ravel()
        return finite(numbers, values.tree), shape, unit_of(values)

    def _mass(self) -> Sequence[tuple[Node, ...]]:
        old, names = self.statement, [*self.statement.coordinates]
        if not old.mass:
            return ()
        if not old.mass_is_full:
            entries = Elementwise(
                self.shapes, {name: partial(self._at, old.mass[i][i]) for i, name in enumerate(names)}
            )
            return Diagonal(entries.names, entries)
        places = [(i, place) for i, name in enumerate(names) for _, place in self._placed(name)]
        products = products_of_inertia(old.bodies)

        def entry(i: int, j: int, here: Place, there: Place) -> Node:
            product = products.get((names[i], here[AXIS], there[AXIS])) if i == j and AXIS in here else None
            if product is not None:
                return self._between(product, {**here, AXIS: 0}, {**there, AXIS: 0})
            return self._between(old.mass[i][j], here, there)

        return tuple(tuple(entry(i, j, here, there) for j, there in places) for i, here in places)

    def _between(self, entry: Node, here: Place, there: Place) -> Node:
        """Return the mass between two elements of one or two quantities; 0 where they differ in a dimension of both."""
        both = {**here, **there}
        if entry == ZERO or any(both[dim] != number for dim, number in here.items()):
            return ZERO
        return at(entry, both, self.shapes)

    def _force(self, force: Force) -> Force:
        """Return a force term of the elements; a potential keeps its gradient with dimensions, which is that of each."""
        components = self._each(
            {
                name: always(tree) if isinstance(tree, Function) else partial(self._at, tree)
                for name, tree in self.acting(force).items()
            }
        )
        if force.potential is None:
            return replace(force, components=components, over="")
        return ForceOfPotential(force, partial(self._summed, force.potential), components)

    def _summed(self, tree: Node) -> Node:
        """Return the sum of an expression over its dimensions."""
        dims = dims_of(tree, self.shapes)
        return total([at(tree, place, self.shapes) for place in self.shapes.places(dims)])

    def acting(self, force: Force) -> dict[str, Node | Function]:
        """Return what a force term is for every coordinate, with dimensions; of a potential, its negative gradient."""
        if force.potential is not None:
            tree = expanded(force.potential, self.statement.definitions, self.shapes)
            found = dict[str, Node | Function](gradient(negative(tree), self.statement.coordinates, self.shapes))
            return found | torques_of_potential(tree, self.statement.bodies, self.shapes)
        return {
            name: self._onto(name, tree, force.over) if force.over and not isinstance(tree, Function) else tree
            for name, tree in force.components.items()
        }

    def _onto(self, name: str, tree: Node, over: str) -> Node:
        """Return what links give to elements of a coordinate: a force to first ends, its opposite to second ones."""
        relation, dims = self.shapes.relations[over], self.shapes.dims[name]
        first = tree if relation.source in dims else ZERO
        return Along("onto", (first, negative(tree) if relation.target in dims else ZERO), (over,))

    def _drive(self, name: str, drive: Drive) -> Iterator[tuple[str, Drive]]:
        drive = replace(drive, argument=self._at(drive.argument, {}))
        if not drive.dims:
            yield name, drive
            return
        table, columns = drive.table, columns_of_drive(name, drive.dims, self.shapes)
        sheet = Sheet.of(table.name, table.text)
        for column, element in zip(columns, self._names(name), strict=True):
            yield element, replace(drive, table=Table.of(sheet, table.text, column, table.gaps), dims=())

    def _event(self, name: str, event: Event) -> Iterator[tuple[str, Event]]:
        for element, place in self._placed(name):
            function = event.function
            if not isinstance(function, Function):
                function = at(function, place, self.shapes)
            reset = {
                self.shapes.element(quantity, {**inner, **fixed}): at(tree, inner, self.shapes)
                for (quantity, fixed), tree in ((self.shapes.placed(key), tree) for key, tree in event.reset.items())
                for inner in ([place] if fixed else self._beside(quantity, place))
            }
            yield element, replace(event, function=function, reset=reset)

    def _beside(self, target: str, place: Place) -> Iterator[Place]:
        """Yield the places of a target that go with a place: along its further dimensions all of them."""
        further = tuple(dim for dim in self.shapes.dims.get(target, ()) if dim not in place)
        for inner in self.shapes.places(further):
            yield {**place, **inner}

    def _contact(self, name: str, contact: Contact) -> Iterator[tuple[str, Contact]]:
        keys = ("gap", "restitution", "slip", "friction", "static")
        for element, place in self._placed(name):
            yield element, replace(contact, **self._at_keys(contact, keys, place))

    def _of_keys(self, keys: tuple[str, ...], name: str, part: Any) -> Iterator[tuple[str, Any]]:
        for element, place in self._placed(name):
            yield element, replace(part, **self._at_keys(part, keys, place))

    def _closed_form(self, name: str, form: Validation) -> Iterator[tuple[str, Validation]]:
        """Yield the closed form of each element of its quantity."""
        quantity = written(form.quantity)
        for place in self.shapes.places(self.shapes.dims.get(quantity, ())):
            element = self.shapes.element(quantity, place)
            tree = at(form.expression, place, self.shapes)
            label = name if element == quantity else DOT.join([name, *parted(element)[1]])
            yield label, replace(form, quantity=element, expression=tree, event=written(form.event))

    def _at_keys(self, part: Any, keys: tuple[str, ...], place: Place) -> dict[str, Any]:
        trees = {key: getattr(part, key) for key in keys}
        return {key: at(tree, place, self.shapes) for key, tree in trees.items() if tree is not None}

    def _pairs(self, across: Node, up: Node) -> Iterator[tuple[Node, Node]]:
        dims = self.shapes.ordered({*dims_of(across, self.shapes), *dims_of(up, self.shapes)})
        for place in self.shapes.places(dims):
            yield at(across, place, self.shapes), at(up, place, self.shapes)

    def _lagrangian(self) -> Lagrangian | None:
        energies = self.statement.lagrangian
        if energies is None:
            return None
        potential = None if energies.potential is None else self._summed(energies.potential)
        return Lagrangian(self._summed(energies.kinetic), potential)

    def _run(self) -> dict[str, Any]:
        """Return the settings; tolerances of a whole are those of its elements."""
        run = dict(self.statement.run)
        if isinstance(run.get("atol"), Mapping):
            run["atol"] = {
                element: value for name, value in run["atol"].items() for element in self._names(written(str(name)))
            }
        return run

    def _start(self, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
        """Return values at the start."""
        old, ledger = self.statement, Ledger(f"model '{self.statement.name}'", ModelError)
        initial: dict[str, Callable[[Place], Quantity]] = {
            name: always(quantity) for name, quantity in old.initial.items()
        }
        starts = dict(old.starts)
        for name, values in old.starting.items():
            with ledger.entry(f"initial value of '{name}'"):
                made = initial[name] = self._started(name, values, parameters)
                if values.spreads or values.description:
                    for i, (element, place) in enumerate(self._placed(name)):
                        if (spread := values.spread(i)) or values.description:
                            starts[element] = Parameter(made(place), spread, values.description)
        ledger.raise_faults()
        order = ["t", *(word for q in old.coordinates for word in (q, velocity(q))), *old.states]
        ranked = {name: initial[name] for name in order if name in initial}
        at_rest = Blocks.of("velocity", old.at_rest, self.shapes)
        return {"initial": self._each(ranked | initial), "starts": starts, "at_rest": at_rest}

    def started(self, parameters: Mapping[str, Parameter]) -> dict[str, Quantity]:
        """Return every value at the start that is an array or an expression, by element."""
        return {
            element: made(place)
            for name, values in self.statement.starting.items()
            for made in (self._started(name, values, parameters),)
            for element, place in self._placed(name)
        }

    def _started(self, name: str, values: Values, parameters: Mapping[str, Parameter]) -> Numbers:
        """Return what makes the values of a quantity at the start."""
        shape = self.shapes.shape(self.shapes.dims.get(name, ()))
        if values.tree is None:
            assert values.unit is not None  # noqa: S101 - numbers have a unit
            one = values.numbers[0] if len(values.numbers) == 1 else np.reshape(values.numbers, shape)
            return Numbers(np.broadcast_to(one, shape), values.unit)
        unit = self._units()[name]
        numbers = self._evaluated(values.tree, values.dims, self._known(values.tree, parameters))
        numbers = numbers / float(unit.factor)
        # of one number for a million elements there is one
        return Numbers(numbers if dims_of(values.tree, self.shapes) else np.broadcast_to(numbers.flat[0], shape), unit)

    def _known(self, tree: Node, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
        """Return the values that an expression may read, in SI units: parameters and constants."""
        known: dict[str, Any] = _constants(self.statement.unit_constants)
        for name in free_names(tree):
            if dims := self.shapes.dims.get(name, ()):
                if name in self.statement.arrays:
                    known[name] = in_si(parameters, Blocks.of("", [name], self.shapes)).reshape(self.shapes.shape(dims))
            elif name in parameters:
                known[name] = parameters[name].quantity.si
        return known

    def read_at_start(self) -> frozenset[str]:
        """Return the parameters that values at the start follow."""
        read = (name for _, _, tree in self._expressions() for name in free_names(tree))
        return frozenset(read) - {*self.statement.unit_constants, "pi"}

    def slopes(self, numbers: Mapping[str, Parameter], by: Iterable[str]) -> dict[tuple[str, str], float]:
        """Return the derivatives of values at the start by parameters, where they are not zero, in SI units."""
        return {
            (element, word): evaluate(rate, self._known(rate, numbers))
            for _, element, tree in self._expressions()
            for word, rate in derivatives(tree, {word: {word: ONE} for word in by}).items()
        }

    def varied(self, parameters: Mapping[str, Any], known: Mapping[str, float]) -> dict[str, Any]:
        """Return values at the start, in SI units, for arrays of parameters that some of them follow.

        Every number has the bits that the model with those parameters has.
        """
        values: dict[str, Any] = _constants(self.statement.unit_constants) | dict(known) | dict(parameters)
        starts = {}
        for name, element, tree in self._expressions():
            if free_names(tree) & parameters.keys():
                unit = self._units()[name]
                numbers = np.broadcast_to(
                    evaluate_many(tree, values) / float(unit.factor), len(next(iter(parameters.values())))
                )
                starts[element] = np.array([unit.to_si(number) for number in numbers.tolist()])
        return starts

    def _expressions(self) -> Iterator[tuple[str, str, Node]]:
        """Yield the quantity, the element and the expression of each value at the start that is one."""
        for name, values in self.statement.starting.items():
            if values.tree is not None:
                for element, place in self._placed(name):
                    yield name, element, at(values.tree, place, self.shapes)

    def _units(self) -> dict[str, Unit]:
        time, old = self.statement.time_unit, self.statement
        units = {name: part.unit for name, part in (old.coordinates | old.states).items()}
        return units | {velocity(name): part.unit.per(time) for name, part in old.coordinates.items()}

    def _evaluated(self, tree: Node, dims: tuple[str, ...], known: Mapping[str, Any]) -> NDArray[np.float64]:
        if missing := sorted(free_names(tree) - known.keys()):
            raise InputError(
                f"'{shown(tree)}' reads '{missing[0]}'; a value at the start is of parameters and index(…)"
            )
        return evaluate_elements(tree, dims, known, self.shapes)


def _by_element(make: Callable[[str, Part], Iterator[tuple[str, Part]]], parts: Mapping[str, Part]) -> dict[str, Part]:
    """Return what is made for every element of every part."""
    return {element: made for name, part in parts.items() for element, made in make(name, part)}


def _constants(unit_constants: Iterable[str]) -> dict[str, float]:
    return {name: float(constant(name).factor) for name in unit_constants} | {"pi": math.pi}
