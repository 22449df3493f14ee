"""A model's elements: statements with dimensions as statements of single numbers, and dimensions of names.

Every expression is checked to have dimensions that the entry it stands in may have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from xdynamics.expressions import Along, Node, free_names, shortened_text
from xdynamics.expressions.calculus import ZERO, negative
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.body_sections import AXIS, products_of_inertia, torques_of_potential
from xdynamics.model.controllers import trees_of, with_trees
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import Table
from xdynamics.model.element_numbers import ElementIndices, ElementNumbers
from xdynamics.model.elementwise import Diagonal, Elementwise, ForceOfPotential, always
from xdynamics.model.entries import columns_of_drive
from xdynamics.model.given_values import check_element_memory
from xdynamics.model.lagrangian import Lagrangian
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
from xdynamics.model.uncertainty import check_pairs
from xdynamics.reaction_names import joint_force, joint_torque
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes, at_element, dims_of, gradient
from xdynamics.shapes.naming import display_text
from xdynamics.shapes.trees import expand_definitions, sum_terms
from xdynamics.units import Dimension


def declared_shapes(statement: Statement, ledger: Ledger) -> Shapes:
    """Return the dimensions of all that a statement declares; faults are noted."""
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
            check_element_memory(dims[name], shapes)
    return _with_expression_dims(
        statement, replace(shapes, dims={name: name_dims for name, name_dims in dims.items() if name_dims}), ledger
    )


def _with_expression_dims(statement: Statement, shapes: Shapes, ledger: Ledger) -> Shapes:
    """Add the dimensions that follow from expressions: definitions, observables, events, contacts, friction."""
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
    trees |= {name: ("constraint", part.condition) for name, part in statement.constraints.items()}
    for name, (kind, tree) in trees.items():
        if not isinstance(tree, Function):
            with ledger.entry(f"{kind} '{name}'"):
                dims[name] = dims_of(tree, shapes)
    for name in statement.joints:
        dims |= dict.fromkeys((joint_force(name), joint_torque(name)), (AXIS,))
    return replace(shapes, dims={name: name_dims for name, name_dims in dims.items() if name_dims})


def check_shapes(statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    """Note every expression with a dimension that its entry does not have."""
    dims_by_name = shapes.dims
    for name, values in statement.arrays.items():
        _check_tree_dims(f"parameter '{name}'", values.tree, values.dims, shapes, ledger, "add it to dims")
    for label, tree, allowed in _expected_dims(statement, dims_by_name):
        _check_tree_dims(label, tree, allowed, shapes, ledger)
    for name, drive in statement.drives.items():
        remedy = "give the drive dims, and its table a column for each element"
        _check_tree_dims(f"drive '{name}': argument", drive.argument, drive.dims, shapes, ledger, remedy)
    for name, event in statement.events.items():
        with ledger.entry(f"event '{name}'"):
            _check_targets(event.reset, shapes)
    with ledger.entry("correlations"):
        check_pairs(statement.correlations, shapes.internal_name)
    with ledger.entry("discrepancy"):
        shapes.with_internal_names(statement.discrepancy, "names")
    for name, form in statement.validation.items():
        with ledger.entry(f"validation '{name}'"):
            shapes.parse_element(form.quantity)
            detector, indices = shapes.parse_element(form.event)
            if dims_by_name.get(detector) and not indices:
                example = display_text(shapes.first(detector))
                raise InputError(
                    f"event '{detector}' is one of each {dims_by_name[detector][0]}; name one, like '{example}'"
                )
    for term, force in statement.forces.items():
        _check_force(term, force, statement, shapes, ledger)


def _check_targets(reset: Iterable[str], shapes: Shapes) -> None:
    """Refuse resets of missing elements, and of elements that are set twice, alone or with their quantity."""
    earlier: dict[str, dict[tuple[int, ...], str]] = {}
    for target in reset:
        quantity, indices = shapes.parse_element(target)
        set_targets, key = earlier.setdefault(quantity, {}), tuple(indices.values())
        if () in set_targets or key in set_targets or (set_targets and not key):
            clashing_target = set_targets.get(key) or next(iter(set_targets.values()))
            raise InputError(f"sets '{target}', and '{clashing_target}' too; give each element one value")
        set_targets[key] = target


def check_link_tables(statement: Statement, ledger: Ledger) -> None:
    """Note names that expressions read, that nothing declares, and that are columns of a table of links."""
    if not any(links.csv for links in statement.relations.values()):
        return
    declared_names = {
        "t",
        "pi",
        *statement.coordinates,
        *map(velocity, statement.coordinates),
        *statement.unit_constants,
    }
    declared_names |= {
        *statement.parameters,
        *statement.arrays,
        *statement.definitions,
        *statement.drives,
        *statement.states,
    }
    missing = statement.names_read - declared_names
    for name, links in statement.relations.items() if missing else ():
        for column in [column for column in links.table_columns if column in missing]:
            ledger.note(
                f"name '{column}' is not declared; table '{links.table}' of relation '{name}' has the columns"
                f' {", ".join(links.table_columns)}: write [parameters] {column} = {{ dims = ["{name}"], table = "{links.table}" }}'
            )


def _expected_dims(
    statement: Statement, dims_by_name: Mapping[str, tuple[str, ...]]
) -> Iterator[tuple[str, Node | None, Iterable[str]]]:
    """Yield expressions with their descriptions, and the dimensions that they may have."""
    names = [*statement.coordinates]
    for (i, j), entry in statement.mass_entries.items() if statement.mass else ():
        label = f"mass of '{names[i]}'" if i == j else f"mass entry ({i + 1}, {j + 1})"
        yield label, entry, dict.fromkeys((*dims_by_name.get(names[i], ()), *dims_by_name.get(names[j], ())))
    for name, state in statement.states.items():
        yield f"rate of state '{name}'", state.rate, state.dims
    yield from ((f"initial value of '{name}'", values.tree, values.dims) for name, values in statement.starting.items())
    for name, event in statement.events.items():
        for target, tree in event.reset.items():
            yield f"event '{name}' sets '{target}'", tree, {*dims_by_name.get(target, ()), *dims_by_name.get(name, ())}
    for name, form in statement.validation.items():
        yield f"validation '{name}'", form.expression, dims_by_name.get(form.quantity, ())
    for name, controller in statement.controllers.items():
        yield from ((f"controller '{name}': '{target}'", tree, ()) for target, tree in trees_of(controller))
    for name, contact in statement.contacts.items():
        for key in ("restitution", "slip", "friction", "static"):
            yield f"contact '{name}': {key}", getattr(contact, key), dims_by_name.get(name, ())
    for name, friction in statement.frictions.items():
        for key in ("kinetic", "static"):
            yield f"friction '{name}': {key}", getattr(friction, key), dims_by_name.get(name, ())


def _check_tree_dims(
    label: str,
    tree: Node | Function | None,
    allowed: Iterable[str],
    shapes: Shapes,
    ledger: Ledger,
    remedy: str = "take an element",
) -> None:
    if tree is None or isinstance(tree, Function):
        return
    with ledger.entry(label):
        if extra := [dim for dim in dims_of(tree, shapes) if dim not in allowed]:
            raise InputError(
                f"'{shortened_text(tree)}' has the dimension '{extra[0]}', and it needs {_list_dims(allowed)}; reduce it, as in"
                f" sum(…, {extra[0]}), or {remedy}"
            )


def dimensions_of(dimensions: Mapping[str, Dimension], shapes: Shapes) -> dict[str, Dimension]:
    """Return the physical dimension of every element from those of the quantities."""
    return Elementwise(shapes, {name: always(dimension) for name, dimension in dimensions.items()})


def _check_force(term: str, force: Force, statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    relation = shapes.relations.get(force.over)
    if force.over and relation is None:
        ledger.note(
            f"force '{term}' is over '{force.over}', which is no relation; there are: {_list_dims(shapes.relations)}"
        )
        return
    if force.potential is not None:
        with ledger.entry(f"potential of '{term}'"):
            dims = dims_of(force.potential, shapes)
            if force.over and force.over not in dims:
                raise InputError(f"has the dimensions {_list_dims(dims)}, and the force is over '{force.over}'")
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
                    f"force '{term}' over '{force.over}' acts on '{name}', which has the dimensions {_list_dims(allowed)} and"
                    f" no elements of '{relation.source}'"
                )
            allowed = (force.over, *(dim for dim in allowed if dim not in (relation.source, relation.target)))
        _check_tree_dims(f"force '{term}' of '{name}'", tree, allowed, shapes, ledger)


def _list_dims(dims: Iterable[str]) -> str:
    return ", ".join(dims) or "none"


Part = TypeVar("Part")


class Elements(ElementNumbers):
    """Makes the statement of single numbers of one with dimensions."""

    def element_statement(self) -> Statement:
        """Return the statement of the elements.

        Raises
        ------
        ModelError
            With every fault of values at the start that are expressions.
        """
        old, trees = self.statement, self._element_trees
        parameters = self.element_parameters()
        new = replace(
            old,
            coordinates=self._elementwise(
                {name: always(replace(part, dims=())) for name, part in old.coordinates.items()}
            ),
            parameters=parameters,
            mass=self._mass_matrix(),
            definitions=trees(old.definitions),
            forces=self._element_forces(),
            drives=_by_element(self._element_drives, old.drives),
            states=self._elementwise({name: partial(self._state_at, part) for name, part in old.states.items()}),
            events=_by_element(self._element_events, old.events),
            contacts={} if self._many else _by_element(self._element_contacts, old.contacts),
            assemblies={name: next(self._element_contacts(name, part))[1] for name, part in old.contacts.items()}
            if self._many
            else {},
            frictions=_by_element(partial(self._element_parts, ("slip", "kinetic", "static")), old.frictions),
            constraints=_by_element(partial(self._element_parts, ("holds", "rolls")), old.constraints),
            controllers={name: self._controller_of_elements(part) for name, part in old.controllers.items()},
            observables=trees(old.observables),
            observed=self._elementwise(
                {name: partial(self._observable_at, part) for name, part in old.observed.items()}
            ),
            validation=self._validation(),
            correlations={
                (self.shapes.internal_name(a), self.shapes.internal_name(b)): value
                for (a, b), value in old.correlations.items()
            },
            discrepancy={
                element: part
                for name, part in old.discrepancy.items()
                for element in self._element_names(self.shapes.internal_name(name))
            },
            pictured=replace(
                old.pictured,
                plane=tuple(pair for pair in old.pictured.plane for pair in self._plane_pairs(*pair)),
                wrap=tuple(element for name in old.pictured.wrap for element in self._element_names(name)),
            ),
            lagrangian=self._lagrangian(),
            extents={},
            relations={},
            arrays={},
            starting={},
        )
        return replace(new, **self.start_sections(parameters))

    @property
    def _many(self) -> bool:
        """Whether contacts have more links than are written out."""
        sizes = (math.prod(self.shapes.shape(self.shapes.dims.get(name, ()))) for name in self.statement.contacts)
        doubled = (2 if part.slip else 1 for part in self.statement.contacts.values())
        return sum(map(math.prod, zip(sizes, doubled, strict=True))) > MOST_REACTIONS

    def _element_trees(self, trees: Mapping[str, Node]) -> dict[str, Node]:
        return self._elementwise({name: partial(self._tree_at, tree) for name, tree in trees.items()})

    def _tree_at(self, tree: Node, indices: ElementIndices) -> Node:
        return at_element(tree, indices, self.shapes)

    def _state_at(self, part: State, indices: ElementIndices) -> State:
        acting = {term: self._tree_at(tree, indices) for term, tree in part.acting.items()}
        return replace(part, rate=self._tree_at(part.rate, indices), acting=acting, dims=())

    def _controller_of_elements(self, part: Controller) -> Controller:
        return with_trees(part, lambda tree: self._tree_at(tree, {}))

    def _observable_at(self, part: Observable, indices: ElementIndices) -> Observable:
        return replace(part, expression=self._tree_at(part.expression, indices))

    def _mass_matrix(self) -> Sequence[tuple[Node, ...]]:
        old, names = self.statement, [*self.statement.coordinates]
        if not old.mass:
            return ()
        if not old.mass_is_full:
            entries = Elementwise(
                self.shapes, {name: partial(self._tree_at, old.mass[i][i]) for i, name in enumerate(names)}
            )
            return Diagonal(entries.names, entries)
        places = [(i, indices) for i, name in enumerate(names) for _, indices in self._indexed_elements(name)]
        products = products_of_inertia(old.bodies)

        def mass_entry(i: int, j: int, row_indices: ElementIndices, column_indices: ElementIndices) -> Node:
            product = (
                products.get((names[i], row_indices[AXIS], column_indices[AXIS]))
                if i == j and AXIS in row_indices
                else None
            )
            if product is not None:
                return self._mass_between(product, {**row_indices, AXIS: 0}, {**column_indices, AXIS: 0})
            return self._mass_between(old.mass[i][j], row_indices, column_indices)

        return tuple(
            tuple(mass_entry(i, j, row_indices, column_indices) for j, column_indices in places)
            for i, row_indices in places
        )

    def _mass_between(self, entry: Node, row_indices: ElementIndices, column_indices: ElementIndices) -> Node:
        """Return the mass between two elements of one or two quantities; 0 where they differ in a dimension of both."""
        both = {**row_indices, **column_indices}
        if entry == ZERO or any(both[dim] != number for dim, number in row_indices.items()):
            return ZERO
        return at_element(entry, both, self.shapes)

    def _element_forces(self) -> dict[str, Force]:
        ledger, forces = Ledger(f"model '{self.statement.name}'", ModelError), dict[str, Force]()
        for name, force in self.statement.forces.items():
            with ledger.entry(f"force '{name}'"):
                forces[name] = self._element_force(force)
        ledger.raise_faults()
        return forces

    def _element_force(self, force: Force) -> Force:
        """Return a force term of the elements; a potential keeps its gradient with dimensions, which is that of each."""
        components = self._elementwise(
            {
                name: always(tree) if isinstance(tree, Function) else partial(self._tree_at, tree)
                for name, tree in self.force_by_coordinate(force).items()
            }
        )
        if force.potential is None:
            return replace(force, components=components, over="")
        return ForceOfPotential(force, partial(self._sum_over_dims, force.potential), components)

    def _sum_over_dims(self, tree: Node) -> Node:
        """Return the sum of an expression over its dimensions."""
        dims = dims_of(tree, self.shapes)
        return sum_terms([at_element(tree, indices, self.shapes) for indices in self.shapes.index_combinations(dims)])

    def force_by_coordinate(self, force: Force) -> dict[str, Node | Function]:
        """Return a force term by coordinate, with dimensions; of a potential, its negative gradient."""
        if force.potential is not None:
            tree = expand_definitions(force.potential, self.statement.definitions, self.shapes)
            gradients = dict[str, Node | Function](gradient(negative(tree), self.statement.coordinates, self.shapes))
            return gradients | torques_of_potential(tree, self.statement.bodies, self.shapes)
        return {
            name: self._link_force_on_ends(name, tree, force.over)
            if force.over and not isinstance(tree, Function)
            else tree
            for name, tree in force.components.items()
        }

    def _link_force_on_ends(self, name: str, tree: Node, relation_name: str) -> Node:
        """Return the force of links on elements of a coordinate: at first ends, and reversed at second ends."""
        relation, dims = self.shapes.relations[relation_name], self.shapes.dims[name]
        first = tree if relation.source in dims else ZERO
        return Along("onto", (first, negative(tree) if relation.target in dims else ZERO), (relation_name,))

    def _element_drives(self, name: str, drive: Drive) -> Iterator[tuple[str, Drive]]:
        if not drive.dims:
            yield name, replace(drive, argument=self._tree_at(drive.argument, {}))
            return
        table, columns = drive.table, columns_of_drive(name, drive.dims, self.shapes)
        sheet = Sheet.from_text(table.name, table.text)
        for column, (element, indices) in zip(columns, self._indexed_elements(name), strict=True):
            element_table = replace(
                Table.from_sheet(sheet, table.text, column, table.gaps, table.duplicates), value_unit=table.value_unit
            )
            yield element, replace(drive, argument=self._tree_at(drive.argument, indices), table=element_table, dims=())

    def _element_events(self, name: str, event: Event) -> Iterator[tuple[str, Event]]:
        for element, indices in self._indexed_elements(name):
            function = event.function
            if not isinstance(function, Function):
                function = at_element(function, indices, self.shapes)
            reset = {
                self.shapes.element_at(quantity, {**inner, **fixed}): at_element(tree, inner, self.shapes)
                for (quantity, fixed), tree in (
                    (self.shapes.parse_element(key), tree) for key, tree in event.reset.items()
                )
                for inner in ([indices] if fixed else self._target_indices(quantity, indices))
            }
            yield element, replace(event, function=function, reset=reset)

    def _target_indices(self, target: str, indices: ElementIndices) -> Iterator[ElementIndices]:
        """Yield the indices of a reset's target: all elements along dimensions that the event does not have."""
        further = tuple(dim for dim in self.shapes.dims.get(target, ()) if dim not in indices)
        for inner in self.shapes.index_combinations(further):
            yield {**indices, **inner}

    def _element_contacts(self, name: str, contact: Contact) -> Iterator[tuple[str, Contact]]:
        keys = ("gap", "restitution", "slip", "friction", "static")
        for element, indices in self._indexed_elements(name):
            yield element, replace(contact, **self._trees_at_keys(contact, keys, indices))

    def _element_parts(self, keys: tuple[str, ...], name: str, part: Any) -> Iterator[tuple[str, Any]]:
        for element, indices in self._indexed_elements(name):
            yield element, replace(part, **self._trees_at_keys(part, keys, indices))

    def _validation(self) -> dict[str, Validation]:
        """Return the closed forms of the elements of each quantity, which are named as it is and its elements are."""
        forms = self.statement.validation
        dims = {name: self.shapes.dims.get(form.quantity, ()) for name, form in forms.items()}
        form_shapes = replace(self.shapes, dims=dims)
        return Elementwise(form_shapes, {name: partial(self._closed_form, form) for name, form in forms.items()})

    def _closed_form(self, form: Validation, indices: ElementIndices) -> Validation:
        """Return the closed form of an element of its quantity."""
        element = self.shapes.element_at(self.shapes.internal_name(form.quantity), indices)
        event = self.shapes.internal_name(form.event)
        return replace(form, quantity=element, expression=self._tree_at(form.expression, indices), event=event)

    def _trees_at_keys(self, part: Any, keys: tuple[str, ...], indices: ElementIndices) -> dict[str, Any]:
        trees = {key: getattr(part, key) for key in keys}
        return {key: at_element(tree, indices, self.shapes) for key, tree in trees.items() if tree is not None}

    def _plane_pairs(self, across: Node, up: Node) -> Iterator[tuple[Node, Node]]:
        dims = self.shapes.ordered({*dims_of(across, self.shapes), *dims_of(up, self.shapes)})
        for indices in self.shapes.index_combinations(dims):
            yield at_element(across, indices, self.shapes), at_element(up, indices, self.shapes)

    def _lagrangian(self) -> Lagrangian | None:
        energies = self.statement.lagrangian
        if energies is None:
            return None
        potential = None if energies.potential is None else self._sum_over_dims(energies.potential)
        return Lagrangian(self._sum_over_dims(energies.kinetic), potential)


def with_element_numbers(elements: Statement, statement: Statement, shapes: Shapes) -> Statement:
    """Return a statement of elements with the numbers of another statement, whose trees are the same."""
    numbers = Elements(statement, shapes)
    parameters = numbers.element_parameters()
    return replace(elements, parameters=parameters, **numbers.start_sections(parameters))


def _by_element(make: Callable[[str, Part], Iterator[tuple[str, Part]]], parts: Mapping[str, Part]) -> dict[str, Part]:
    """Return the parts that `make` yields for every element of every part."""
    return {element: made for name, part in parts.items() for element, made in make(name, part)}
