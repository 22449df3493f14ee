"""Which dimensions everything in a statement has, and whether every expression has those that it may have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from xdynamics.expressions import Node, free_names, shortened_text
from xdynamics.faults import InputError, Ledger
from xdynamics.model.bodies import AXIS
from xdynamics.model.controllers import trees_of
from xdynamics.model.element_room import check_element_memory
from xdynamics.model.elementwise import Elementwise, always
from xdynamics.model.parts import Force, Function
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import check_pairs
from xdynamics.reaction_names import joint_force, joint_torque
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes, dims_of
from xdynamics.shapes.naming import display_text
from xdynamics.units import Dimension


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
            check_element_memory(dims[name], shapes)
    return _with_expression_dims(
        statement, replace(shapes, dims={name: name_dims for name, name_dims in dims.items() if name_dims}), ledger
    )


def _with_expression_dims(statement: Statement, shapes: Shapes, ledger: Ledger) -> Shapes:
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
    trees |= {name: ("constraint", part.condition) for name, part in statement.constraints.items()}
    for name, (kind, tree) in trees.items():
        if not isinstance(tree, Function):
            with ledger.entry(f"{kind} '{name}'"):
                dims[name] = dims_of(tree, shapes)
    for name in statement.joints:
        dims |= dict.fromkeys((joint_force(name), joint_torque(name)), (AXIS,))
    return replace(shapes, dims={name: name_dims for name, name_dims in dims.items() if name_dims})


def check_shapes(statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    """Note every expression with a dimension that what it is for has not."""
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
    """Refuse elements that are not there, and what is set twice, alone or as a part of the whole."""
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
    """Yield what expressions are for, and the dimensions that they may have."""
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
