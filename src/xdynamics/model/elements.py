"""A model's elements: what a statement with dimensions is as one of single numbers, and which name has which dimensions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Node, free_names, shown
from xdynamics.expressions.calculus import ZERO, negative
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.arrays import Values, unit_of
from xdynamics.model.drives import Table
from xdynamics.model.elementwise import Elementwise, Numbers, always
from xdynamics.model.lagrangian import Lagrangian
from xdynamics.model.lazy_trees import Diagonal, ForceOfPotential
from xdynamics.model.parts import (
    MOST_REACTIONS,
    Contact,
    Drive,
    Event,
    Force,
    Friction,
    Function,
    Observable,
    Parameter,
    State,
    Validation,
)
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import Spread
from xdynamics.runtime.free_memory import ROOM, free_memory, size_text
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes, at, dims_of, gradient, written
from xdynamics.shapes.blocks import Blocks
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.naming import DOT, parted
from xdynamics.shapes.trees import expanded, total
from xdynamics.units import Dimension, Quantity, Unit, constant

NUMBERS_OF_ELEMENT = 30  # at least, of a coordinate in a march
FEW_ELEMENTS = 100_000  # which always fit
Place = Mapping[str, int]
Part = TypeVar("Part")


def declared_shapes(statement: Statement, ledger: Ledger) -> Shapes:
    """Return the dimensions of everything that a statement declares; what cannot be is noted."""
    shapes = statement.bare_shapes
    dims: dict[str, tuple[str, ...]] = {}
    for name, part in statement.coordinates.items():
        dims |= dict.fromkeys((name, velocity(name), acceleration(name)), part.dims)
    for name, state in statement.states.items():
        dims |= dict.fromkeys((name, rate(name)), state.dims)
    dims |= {name: values.dims for name, values in statement.arrays.items()}
    dims |= {name: drive.dims for name, drive in statement.drives.items()}
    for name in (*statement.coordinates, *statement.states, *statement.arrays):
        with ledger.entry(f"'{name}'"):
            check_room(dims[name], shapes)
    return _of_expressions(statement, replace(shapes, dims={name: own for name, own in dims.items() if own}), ledger)


def check_room(dims: tuple[str, ...], shapes: Shapes) -> None:
    """Refuse a quantity whose elements could not be marched in the memory that can be had, before they are made.

    Raises
    ------
    InputError
        With the number of elements, what they take, and what there is.
    """
    size = math.prod(shapes.extent(dim).size for dim in dims)
    needed = NUMBERS_OF_ELEMENT * 8.0 * size
    if size > FEW_ELEMENTS and needed > (room := ROOM * free_memory()):
        raise InputError(
            f"has {size} elements along {', '.join(dims)}, which take {size_text(needed)} to march, and"
            f" {size_text(room)} of memory can be had; take fewer"
        )


def _of_expressions(statement: Statement, shapes: Shapes, ledger: Ledger) -> Shapes:
    """Add the dimensions of what has those of its expression: definitions, observables, events, contacts, friction."""
    dims = dict(shapes.dims)
    shapes = replace(shapes, dims=dims)
    waiting = dict(statement.definitions)
    while waiting:
        ready = [name for name, tree in waiting.items() if not free_names(tree) & waiting.keys()]
        for name in ready or list(waiting):  # circular ones are found with the units
            with ledger.entry(f"definition '{name}'"):
                dims[name] = dims_of(waiting[name], shapes)
            del waiting[name]
    trees: dict[str, tuple[str, Node | Function]] = {
        name: ("observable", tree) for name, tree in statement.observables.items()
    }
    trees |= {name: ("event", event.function) for name, event in statement.events.items()}
    trees |= {name: ("contact", contact.gap) for name, contact in statement.contacts.items()}
    trees |= {name: ("friction", friction.slip) for name, friction in statement.frictions.items()}
    for name, (kind, tree) in trees.items():
        if not isinstance(tree, Function):
            with ledger.entry(f"{kind} '{name}'"):
                dims[name] = dims_of(tree, shapes)
    return replace(shapes, dims={name: own for name, own in dims.items() if own})


def check_shapes(statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    """Note every expression with a dimension that what it is for has not."""
    own = shapes.dims
    for what, tree, allowed in _needed(statement, own):
        _check(what, tree, allowed, shapes, ledger)
    for term, force in statement.forces.items():
        _check_force(term, force, statement, shapes, ledger)


def _needed(
    statement: Statement, own: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, Node | None, Iterable[str]]]:
    """Yield what expressions are for, and the dimensions that they may have."""
    names = [*statement.coordinates]
    for (i, j), entry in statement.mass_entries.items() if statement.mass else ():
        what = f"mass of '{names[i]}'" if i == j else f"mass entry ({i + 1}, {j + 1})"
        yield what, entry, dict.fromkeys((*own.get(names[i], ()), *own.get(names[j], ())))
    for name, state in statement.states.items():
        yield f"rate of state '{name}'", state.rate, state.dims
    for name, start in statement.starting.items():
        yield f"initial value of '{name}'", start.tree, start.dims
    for name, event in statement.events.items():
        for target, tree in event.reset.items():
            yield f"event '{name}' sets '{target}'", tree, {*own.get(target, ()), *own.get(name, ())}
    for name, contact in statement.contacts.items():
        for key in ("restitution", "slip", "friction", "static"):
            yield f"contact '{name}': {key}", getattr(contact, key), own.get(name, ())
    for name, friction in statement.frictions.items():
        for key in ("kinetic", "static"):
            yield f"friction '{name}': {key}", getattr(friction, key), own.get(name, ())


def _check(what: str, tree: Node | Function | None, allowed: Iterable[str], shapes: Shapes, ledger: Ledger) -> None:
    if tree is None or isinstance(tree, Function):
        return
    with ledger.entry(what):
        if extra := [dim for dim in dims_of(tree, shapes) if dim not in allowed]:
            raise InputError(
                f"'{shown(tree)}' has the dimension '{extra[0]}', and it needs {_named(allowed)}; reduce it, as in"
                f" sum(…, {extra[0]}), or take an element"
            )


def dimensions_of(dimensions: Mapping[str, Dimension], shapes: Shapes) -> dict[str, Dimension]:
    """Return the physical dimension of every element from those of the quantities."""
    return Elementwise(shapes, {name: always(dimension) for name, dimension in dimensions.items()})


def _check_force(term: str, force: Force, statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    relation = shapes.relations.get(force.over)
    if force.over and relation is None:
        ledger.note(
            f"force '{term}' is over '{force.over}', which is no relation; there are: {_named(shapes.relations)}"
        )
        return
    if force.potential is not None:
        with ledger.entry(f"potential of '{term}'"):
            dims = dims_of(force.potential, shapes)
            if force.over and force.over not in dims:
                raise InputError(f"has the dimensions {_named(dims)}, and the force is over '{force.over}'")
            if relation is not None and (ends := [dim for dim in (relation.source, relation.target) if dim in dims]):
                raise InputError(
                    f"has the dimension '{ends[0]}' beside '{force.over}'; take a value at an end of each link,"
                    f" first(…, {force.over}) or second(…, {force.over})"
                )
    for name, tree in force.components.items():
        if name not in statement.coordinates:
            continue
        allowed = shapes.dims.get(name, ())
        if relation is not None:
            if not {relation.source, relation.target} & {*allowed}:
                ledger.note(
                    f"force '{term}' over '{force.over}' acts on '{name}', which has the dimensions {_named(allowed)} and"
                    f" no elements of '{relation.source}'"
                )
            allowed = (force.over, *(dim for dim in allowed if dim not in (relation.source, relation.target)))
        _check(f"force '{term}' of '{name}'", tree, allowed, shapes, ledger)


def _named(dims: Iterable[str]) -> str:
    return ", ".join(dims) or "none"


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
            drives={
                element: drive for name, drive in old.drives.items() for element, drive in self._drive(name, drive)
            },
            states=self._each({name: partial(self._state, part) for name, part in old.states.items()}),
            events={
                element: event for name, event in old.events.items() for element, event in self._event(name, event)
            },
            contacts={}
            if self._many
            else {element: part for name, part in old.contacts.items() for element, part in self._contact(name, part)},
            assemblies={name: next(self._contact(name, part))[1] for name, part in old.contacts.items()}
            if self._many
            else {},
            frictions={
                element: part for name, part in old.frictions.items() for element, part in self._friction(name, part)
            },
            observables=trees(old.observables),
            observed=self._each({name: partial(self._observable, part) for name, part in old.observed.items()}),
            validation={
                element: form
                for name, form in old.validation.items()
                for element, form in self._closed_form(name, form)
            },
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

    def _observable(self, part: Observable, place: Place) -> Observable:
        return replace(part, expression=self._at(part.expression, place))

    def _parameters(self) -> dict[str, Parameter]:
        makers: dict[str, Callable[[Place], Parameter]] = {
            name: always(part) for name, part in self.statement.parameters.items()
        }
        for name, values in self.statement.arrays.items():
            makers[name] = partial(self._parameter, values, *self._numbers(values))
        return self._each(makers)

    def _parameter(self, values: Values, numbers: tuple[float, ...], unit: Unit, place: Place) -> Parameter:
        i = int(np.ravel_multi_index([*place.values()], self.shapes.shape(values.dims)))
        return Parameter(Quantity(numbers[i], unit), values.spread(i), values.description)

    def _numbers(self, values: Values) -> tuple[tuple[float, ...], Unit]:
        """Return the numbers of a parameter with dimensions; those of an expression in SI units."""
        if values.tree is None:
            assert values.unit is not None  # noqa: S101 - numbers have a unit
            return values.numbers, values.unit
        numbers = evaluate_elements(values.tree, values.dims, _constants(self.statement.unit_constants), self.shapes)
        return tuple(numbers.ravel().tolist()), unit_of(values)

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
        return tuple(tuple(self._between(old.mass[i][j], here, there) for j, there in places) for i, here in places)

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
            return dict(gradient(negative(tree), self.statement.coordinates, self.shapes))
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
            yield name, drive
            return
        table = drive.table
        extent = self.shapes.extent(drive.dims[0])
        for i, element in enumerate(self._names(name)):
            column = Table.parse(
                table.name, table.text, extent.label(i) if extent.labels else f"{name}_{i}", table.gaps
            )
            yield element, replace(drive, table=column, dims=())

    def _event(self, name: str, event: Event) -> Iterator[tuple[str, Event]]:
        for element, place in self._placed(name):
            function = event.function
            if not isinstance(function, Function):
                function = at(function, place, self.shapes)
            reset = {
                self.shapes.element(target, inner): at(tree, inner, self.shapes)
                for target, tree in event.reset.items()
                for inner in self._beside(target, place)
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

    def _friction(self, name: str, friction: Friction) -> Iterator[tuple[str, Friction]]:
        for element, place in self._placed(name):
            yield element, replace(friction, **self._at_keys(friction, ("slip", "kinetic", "static"), place))

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
            return Numbers(np.reshape(values.numbers, shape), values.unit)
        unit = self._units()[name]
        numbers = self._evaluated(values.tree, values.dims, self._known(values.tree, parameters))
        return Numbers(numbers / float(unit.factor), unit)

    def _known(self, tree: Node, parameters: Mapping[str, Parameter]) -> dict[str, Any]:
        """Return the values that an expression may read, in SI units: parameters and constants."""
        known: dict[str, Any] = _constants(self.statement.unit_constants)
        for name in free_names(tree):
            if dims := self.shapes.dims.get(name, ()):
                if name in self.statement.arrays:
                    numbers = [parameters[element].quantity.si for element in self._names(name)]
                    known[name] = np.array(numbers).reshape(self.shapes.shape(dims))
            elif name in parameters:
                known[name] = parameters[name].quantity.si
        return known

    def read_at_start(self) -> frozenset[str]:
        """Return the parameters that values at the start follow."""
        trees = [at(value.tree, place, self.shapes) for value, place in self._expressions()]
        return frozenset(set[str]().union(*map(free_names, trees)) - {*self.statement.unit_constants, "pi"})

    def varied(self, parameters: Mapping[str, Any], known: Mapping[str, float]) -> dict[str, Any]:
        """Return values at the start, in SI units, for arrays of parameters that some of them follow.

        Every number has the bits that the model with those parameters has.
        """
        values: dict[str, Any] = _constants(self.statement.unit_constants) | dict(known) | dict(parameters)
        size = len(next(iter(parameters.values())))
        starts = {}
        for name, value in self.statement.starting.items():
            for element, place in self._placed(name) if value.tree is not None else ():
                assert value.tree is not None  # noqa: S101 - checked above
                tree = at(value.tree, place, self.shapes)
                if free_names(tree) & parameters.keys():
                    unit = self._units()[name]
                    numbers = np.broadcast_to(evaluate_many(tree, values) / float(unit.factor), size)
                    starts[element] = np.array([unit.to_si(number) for number in numbers.tolist()])
        return starts

    def _expressions(self) -> Iterator[tuple[Any, Place]]:
        """Yield values at the start that are expressions, with the place of each element."""
        for name, values in self.statement.starting.items():
            if values.tree is not None:
                for _, place in self._placed(name):
                    yield values, place

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


def _constants(unit_constants: Iterable[str]) -> dict[str, float]:
    return {name: float(constant(name).factor) for name in unit_constants} | {"pi": math.pi}


def of_elements(sections: Mapping[str, Any]) -> bool:
    """Whether new entries of a model are those of single elements, as ``m·Sun``."""
    return any(
        DOT in written(str(name)) for entries in sections.values() if isinstance(entries, Mapping) for name in entries
    )


def following(declared: Statement, elements: Statement, old: Statement, shapes: Shapes) -> Statement:
    """Return a statement of elements in which values at the start follow the parameters that their expressions read.

    Parameters
    ----------
    declared : Statement
        With the expressions.
    elements, old : Statement
        As it is now, and as it was: a value at the start that was changed itself stays.
    shapes : Shapes
    """
    if elements.parameters is old.parameters or not any(values.tree for values in declared.starting.values()):
        return elements
    start = Elements(gathered(declared, old, shapes), shapes).started(elements.parameters)
    same = {name: quantity for name, quantity in start.items() if elements.initial[name] == old.initial[name]}
    return replace(elements, initial=elements.initial | same)


def in_units_of(statement: Statement, old: Statement) -> Statement:
    """Return a statement of elements in the units of another one: all elements of a quantity have one unit."""
    parameters = {
        name: replace(part, quantity=part.quantity.into(unit))
        for name, part in statement.parameters.items()
        if name in old.parameters and (unit := old.parameters[name].quantity.unit) != part.quantity.unit
    }
    initial = {
        name: quantity.into(unit)
        for name, quantity in statement.initial.items()
        if name in old.initial and (unit := old.initial[name].unit) != quantity.unit
    }
    if not (parameters or initial):
        return statement
    return replace(statement, parameters=statement.parameters | parameters, initial=statement.initial | initial)


def gathered(declared: Statement, elements: Statement, shapes: Shapes) -> Statement:
    """Return a statement with dimensions and the numbers of its elements."""
    arrays, starting = {}, {}
    for name, values in declared.arrays.items():
        if values.tree is None and _is_as_read(elements.parameters, name):
            arrays[name] = values
            continue
        parts = [elements.parameters[element] for element in shapes.elements(name)]
        numbers = tuple(part.quantity for part in parts)
        arrays[name] = _filled(values, numbers, tuple(part.spread for part in parts))
    start = Elements(declared, shapes).started(elements.parameters) if not _is_as_read(elements.initial) else {}
    for name, values in declared.starting.items():
        if _is_as_read(elements.initial, name) and not (start and values.tree):
            starting[name] = values
            continue
        names = shapes.elements(name)
        spreads = tuple(elements.starts[name].spread if name in elements.starts else None for name in names)
        numbers = tuple(elements.initial[name] for name in names)
        changed = values.tree is None or any(start[name] != elements.initial[name] for name in names)
        starting[name] = _filled(values, numbers, spreads) if changed else values
    return replace(
        declared,
        arrays=arrays,
        starting=starting,
        parameters={name: elements.parameters[name] for name in declared.parameters},
        initial={name: elements.initial.get(name, quantity) for name, quantity in declared.initial.items()},
        name=elements.name,
        description=elements.description,
        fit=elements.fit,
    )


def _is_as_read(parts: Mapping[str, Any], name: str = "") -> bool:
    """Whether no element of a quantity, or of any, has another value than the statement had it first."""
    return isinstance(parts, Elementwise) and (name not in parts.changed if name else not parts.changed)


def _filled(values: Values, quantities: tuple[Quantity, ...], spreads: tuple[Spread | None, ...]) -> Values:
    """Return the same quantity with numbers of its elements."""
    if values.tree is not None and values.unit is None and not values.dims:
        return replace(values, tree=None, numbers=(quantities[0].value,), unit=quantities[0].unit)
    one = spreads[:1] if len(set(spreads)) == 1 else spreads
    numbers = tuple(quantity.value for quantity in quantities)
    return replace(values, tree=None, numbers=numbers, unit=quantities[0].unit, spreads=() if one == (None,) else one)
