"""Which dimensions everything in a statement has, and whether every expression has those that it may have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from xdynamics.expressions import Node, free_names, shown
from xdynamics.faults import InputError, Ledger
from xdynamics.model.bodies import AXIS
from xdynamics.model.controllers import trees_of
from xdynamics.model.element_room import check_room
from xdynamics.model.elementwise import Elementwise, always
from xdynamics.model.parts import (
    Force,
    Function,
)
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import check_pairs
from xdynamics.reaction_names import joint_force, joint_torque
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.shapes import Shapes, dims_of
from xdynamics.shapes.naming import spoken
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
            check_room(dims[name], shapes)
    return _of_expressions(statement, replace(shapes, dims={name: own for name, own in dims.items() if own}), ledger)


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
    trees |= {name: ("constraint", part.condition) for name, part in statement.constraints.items()}
    for name, (kind, tree) in trees.items():
        if not isinstance(tree, Function):
            with ledger.entry(f"{kind} '{name}'"):
                dims[name] = dims_of(tree, shapes)
    for name in statement.joints:
        dims |= dict.fromkeys((joint_force(name), joint_torque(name)), (AXIS,))
    return replace(shapes, dims={name: own for name, own in dims.items() if own})


def check_shapes(statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    """Note every expression with a dimension that what it is for has not."""
    own = shapes.dims
    for name, values in statement.arrays.items():
        _check(f"parameter '{name}'", values.tree, values.dims, shapes, ledger, "add it to dims")
    for what, tree, allowed in _needed(statement, own):
        _check(what, tree, allowed, shapes, ledger)
    for name, drive in statement.drives.items():
        remedy = "give the drive dims, and its table a column for each element"
        _check(f"drive '{name}': argument", drive.argument, drive.dims, shapes, ledger, remedy)
    for name, event in statement.events.items():
        with ledger.entry(f"event '{name}'"):
            _check_targets(event.reset, shapes)
    with ledger.entry("correlations"):
        check_pairs(statement.correlations, shapes.inside)
    with ledger.entry("discrepancy"):
        shapes.all_inside(statement.discrepancy, "names")
    for name, form in statement.validation.items():
        with ledger.entry(f"validation '{name}'"):
            shapes.placed(form.quantity)
            detector, place = shapes.placed(form.event)
            if own.get(detector) and not place:
                one = spoken(shapes.first(detector))
                raise InputError(f"event '{detector}' is one of each {own[detector][0]}; name one, like '{one}'")
    for term, force in statement.forces.items():
        _check_force(term, force, statement, shapes, ledger)


def _check_targets(reset: Iterable[str], shapes: Shapes) -> None:
    """Refuse elements that are not there, and what is set twice, alone or as a part of the whole."""
    earlier: dict[str, dict[tuple[int, ...], str]] = {}
    for target in reset:
        quantity, place = shapes.placed(target)
        others, key = earlier.setdefault(quantity, {}), tuple(place.values())
        if () in others or key in others or (others and not key):
            other = others.get(key) or next(iter(others.values()))
            raise InputError(f"sets '{target}', and '{other}' too; give each element one value")
        others[key] = target


def check_link_tables(statement: Statement, ledger: Ledger) -> None:
    """Note names that expressions read, that nothing declares, and that are columns of a table of links."""
    if not any(links.csv for links in statement.relations.values()):
        return
    own = {"t", "pi", *statement.coordinates, *map(velocity, statement.coordinates), *statement.unit_constants}
    own |= {*statement.parameters, *statement.arrays, *statement.definitions, *statement.drives, *statement.states}
    missing = statement.names_read - own
    for name, links in statement.relations.items() if missing else ():
        for column in [column for column in links.columns if column in missing]:
            ledger.note(
                f"name '{column}' is not declared; table '{links.table}' of relation '{name}' has the columns"
                f' {", ".join(links.columns)}: write [parameters] {column} = {{ dims = ["{name}"], table = "{links.table}" }}'
            )


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
    yield from ((f"initial value of '{name}'", values.tree, values.dims) for name, values in statement.starting.items())
    for name, event in statement.events.items():
        for target, tree in event.reset.items():
            yield f"event '{name}' sets '{target}'", tree, {*own.get(target, ()), *own.get(name, ())}
    for name, form in statement.validation.items():
        yield f"validation '{name}'", form.expression, own.get(form.quantity, ())
    for name, controller in statement.controllers.items():
        yield from ((f"controller '{name}': '{target}'", tree, ()) for target, tree in trees_of(controller))
    for name, contact in statement.contacts.items():
        for key in ("restitution", "slip", "friction", "static"):
            yield f"contact '{name}': {key}", getattr(contact, key), own.get(name, ())
    for name, friction in statement.frictions.items():
        for key in ("kinetic", "static"):
            yield f"friction '{name}': {key}", getattr(friction, key), own.get(name, ())


def _check(
    what: str,
    tree: Node | Function | None,
    allowed: Iterable[str],
    shapes: Shapes,
    ledger: Ledger,
    remedy: str = "take an element",
) -> None:
    if tree is None or isinstance(tree, Function):
        return
    with ledger.entry(what):
        if extra := [dim for dim in dims_of(tree, shapes) if dim not in allowed]:
            raise InputError(
                f"'{shown(tree)}' has the dimension '{extra[0]}', and it needs {_named(allowed)}; reduce it, as in"
                f" sum(…, {extra[0]}), or {remedy}"
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
