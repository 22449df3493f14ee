"""A model's elements: what a statement with dimensions is as one of single numbers, and which name has which dimensions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from xdynamics.expressions import Along, Node
from xdynamics.expressions.calculus import ZERO, negative
from xdynamics.faults import Ledger, ModelError
from xdynamics.model.bodies import AXIS, products_of_inertia, torques_of_potential
from xdynamics.model.controllers import each_tree
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import Table
from xdynamics.model.element_numbers import ElementNumbers, Place
from xdynamics.model.elementwise import Elementwise, always
from xdynamics.model.entries import columns_of_drive
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
    State,
    Validation,
)
from xdynamics.model.statement import Statement
from xdynamics.shapes import at, dims_of, gradient
from xdynamics.shapes.trees import expanded, total

Part = TypeVar("Part")


class Elements(ElementNumbers):
    """Makes the statement of single numbers of one with dimensions."""

    def whole(self) -> Statement:
        """Return the statement of the elements.

        Raises
        ------
        ModelError
            With every fault of values at the start that are expressions.
        """
        old, trees = self.statement, self._trees
        parameters = self._parameters()
        new = replace(
            old,
            coordinates=self._each({name: always(replace(part, dims=())) for name, part in old.coordinates.items()}),
            parameters=parameters,
            mass=self._mass(),
            definitions=trees(old.definitions),
            forces=self._forces(),
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
            validation=self._validation(),
            correlations={
                (self.shapes.inside(a), self.shapes.inside(b)): value for (a, b), value in old.correlations.items()
            },
            discrepancy={
                element: part
                for name, part in old.discrepancy.items()
                for element in self._names(self.shapes.inside(name))
            },
            pictured=replace(
                old.pictured,
                plane=tuple(pair for pair in old.pictured.plane for pair in self._pairs(*pair)),
                wrap=tuple(element for name in old.pictured.wrap for element in self._names(name)),
            ),
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

    def _trees(self, trees: Mapping[str, Node]) -> dict[str, Node]:
        return self._each({name: partial(self._at, tree) for name, tree in trees.items()})

    def _at(self, tree: Node, place: Place) -> Node:
        return at(tree, place, self.shapes)

    def _state(self, part: State, place: Place) -> State:
        return replace(part, rate=self._at(part.rate, place), dims=())

    def _controller(self, part: Controller) -> Controller:
        return each_tree(part, lambda tree: self._at(tree, {}))

    def _observable(self, part: Observable, place: Place) -> Observable:
        return replace(part, expression=self._at(part.expression, place))

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

    def _forces(self) -> dict[str, Force]:
        ledger, forces = Ledger(f"model '{self.statement.name}'", ModelError), dict[str, Force]()
        for name, force in self.statement.forces.items():
            with ledger.entry(f"force '{name}'"):
                forces[name] = self._force(force)
        ledger.raise_faults()
        return forces

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
        if not drive.dims:
            yield name, replace(drive, argument=self._at(drive.argument, {}))
            return
        table, columns = drive.table, columns_of_drive(name, drive.dims, self.shapes)
        sheet = Sheet.of(table.name, table.text)
        for column, (element, place) in zip(columns, self._placed(name), strict=True):
            own = replace(Table.of(sheet, table.text, column, table.gaps), value_unit=table.value_unit)
            yield element, replace(drive, argument=self._at(drive.argument, place), table=own, dims=())

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

    def _validation(self) -> dict[str, Validation]:
        """Return the closed forms of the elements of each quantity, which are named as it is and its elements are."""
        forms = self.statement.validation
        dims = {name: self.shapes.dims.get(form.quantity, ()) for name, form in forms.items()}
        own = replace(self.shapes, dims=dims)
        return Elementwise(own, {name: partial(self._closed_form, form) for name, form in forms.items()})

    def _closed_form(self, form: Validation, place: Place) -> Validation:
        """Return the closed form of an element of its quantity."""
        element = self.shapes.element(self.shapes.inside(form.quantity), place)
        event = self.shapes.inside(form.event)
        return replace(form, quantity=element, expression=self._at(form.expression, place), event=event)

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


def _by_element(make: Callable[[str, Part], Iterator[tuple[str, Part]]], parts: Mapping[str, Part]) -> dict[str, Part]:
    """Return what is made for every element of every part."""
    return {element: made for name, part in parts.items() for element, made in make(name, part)}
