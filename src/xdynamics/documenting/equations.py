"""A model as formulas and tables."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.documenting.document_blocks import Block, Formula, TextTable, Words
from xdynamics.expressions import Name, Node, latex, text_of
from xdynamics.model import Model
from xdynamics.model.given_values import Values
from xdynamics.model.parts import Function, Parameter
from xdynamics.model.statement import Statement
from xdynamics.model.whole import acting
from xdynamics.schema import velocity
from xdynamics.shapes.naming import spoken

MOST_LISTED = 30  # elements of one quantity that are listed one by one


def of_model(model: Model) -> Iterator[Block]:
    """Write the equations of motion, forces, definitions, events and numbers of a model."""
    if model.description:
        yield Words(model.description)
    stated = model.shaped
    yield from _dimensions(model)
    yield from _motion(model) if stated.lagrangian is None or not model.shapes.dims else _energies(model)
    yield from _forces(model)
    for name, definition in stated.definitions.items():
        yield Formula(f"{latex(Name(name))} = {latex(definition)}", f"definition{_along(model, name)}")
    for name, state in stated.states.items():
        about = state.description or f"rate of {name}"
        yield Formula(rf"{_dotted(name, 1)} = {latex(state.rate)}", f"{about}{_along(model, name)}")
    yield from _occasions(model)
    for name, observable in stated.observables.items():
        yield Formula(f"{latex(Name(name))} = {latex(observable)}", f"observable{_along(model, name)}")
    yield from _tables(model)


def _motion(model: Model) -> Iterator[Formula]:
    """Yield the equation of motion of each coordinate, along its dimensions."""
    stated = model.shaped
    components = acting(model) if model.shapes.dims else model.force_components
    for i, name in enumerate(stated.coordinates):
        terms = [
            f"{_inertia(stated, i, j)}{_dotted(other, 2)}"
            for j, other in enumerate(stated.coordinates)
            if (i, j) in stated.mass_entries
        ]
        forces = [rf"F_{{\mathrm{{{_words(term)}}}}}" for term, parts in components.items() if name in parts]
        right = " + ".join(forces) or "0"
        yield Formula(f"{' + '.join(terms)} = {right}", f"motion of {name}{_along(model, name)}")


def _energies(model: Model) -> Iterator[Block]:
    """Yield the energies that a model with dimensions is derived from."""
    lagrangian = model.shaped.lagrangian
    assert lagrangian is not None  # noqa: S101 - asked before
    yield Formula(f"T = {latex(lagrangian.kinetic)}", "kinetic energy")
    if lagrangian.potential is not None:
        yield Formula(f"V = {latex(lagrangian.potential)}", "potential energy")
    for name in model.shaped.coordinates:
        symbol, speed = _symbol(name), _symbol(velocity(name))
        yield Formula(
            rf"\frac{{d}}{{dt}}\frac{{\partial T}}{{\partial {speed}}} - \frac{{\partial T}}{{\partial {symbol}}}"
            rf" = -\frac{{\partial V}}{{\partial {symbol}}}",
            f"motion of {name}{_along(model, name)}, with the forces on it added on the right",
        )


def _dimensions(model: Model) -> Iterator[Block]:
    """Yield what a model's quantities are along, and which elements are linked."""
    shapes = model.shapes
    rows = []
    for name, extent in shapes.extents.items():
        rows.append([name, str(extent.size), ", ".join(extent.labels[:MOST_LISTED]) or f"0 to {extent.size - 1}"])
    for name, relation in shapes.relations.items():
        rows.append([name, str(len(relation.first)), f"links of {relation.source} and {relation.target}"])
    if rows:
        yield TextTable(["dimension", "elements", "what"], rows)


def _along(model: Model, name: str) -> str:
    dims = model.shapes.dims.get(name, ())
    return f", along {' and '.join(dims)}" if dims else ""


def _tables(model: Model) -> Iterator[Block]:
    """Yield drives and numbers."""
    if model.drives:
        yield TextTable(
            ["drive", "of", "points", "between them", "beyond", "what"],
            [
                [
                    name,
                    text_of(drive.argument),
                    f"{len(drive.table.argument)} in {drive.table.name}",
                    drive.interpolation,
                    drive.outside,
                    drive.description,
                ]
                for name, drive in model.drives.items()
            ],
        )
    yield TextTable(["number", "value", "standard uncertainty", "distribution", "what"], [*_numbers(model)])


def _numbers(model: Model) -> Iterator[list[str]]:
    """Yield a row for each number; for many of one quantity, or where an expression gives them, one for all."""
    stated = model.shaped
    for names, values, when in (
        ([*stated.parameters, *stated.arrays], stated.arrays, ""),
        ([*stated.initial, *stated.starting], stated.starting, " at the start"),
    ):
        for name in dict.fromkeys(names):
            own = values.get(name)
            if own is not None and (own.tree is not None or len(own.numbers) > MOST_LISTED):
                yield _whole(f"{name}{when}{_along(model, name)}", own)
                continue
            parts = {}
            for element in model.shapes.elements(name):
                part = model.statement.parameters[element] if not when else model.starts.get(element)
                parts[element] = part or Parameter(model.statement.initial[element])
            first, *others = parts.values()
            if others and all(part == first for part in others):
                yield _number(f"{name}{when}{_along(model, name)}, {len(parts)} alike", first)
                continue
            for element, part in parts.items():
                yield _number(f"{spoken(element)}{when}", part)


def _whole(name: str, values: Values) -> list[str]:
    """Return the row of all numbers of a quantity."""
    if values.tree is not None:
        return [name, text_of(values.tree), "", "", values.description]
    unit = "" if values.unit is None else f" {values.unit.text}".removesuffix(" 1")
    about = f"{len(values.numbers)} values from {min(values.numbers):.6g} to {max(values.numbers):.6g}{unit}"
    return [name, about, "", "", values.description]


def _forces(model: Model) -> Iterator[Formula]:
    stated = model.shaped
    for term, force in stated.forces.items():
        description = f"{term}: {force.description}" if force.description else term
        over = f", summed over {force.over}" if force.over else ""
        if force.potential is not None:
            yield Formula(
                rf"V_{{\mathrm{{{_words(term)}}}}} = {latex(force.potential)}", f"potential of {description}{over}"
            )
        for name, part in force.components.items():
            body = (
                rf"\mathrm{{{_words(part.name)}}}({', '.join(_symbol(argument) for argument in part.arguments)})"
                if isinstance(part, Function)
                else latex(part)
            )
            on = f", on {name}" if len(model.statement.coordinates) > 1 else ""
            on += f", of each link of {force.over}" if force.over else ""
            yield Formula(rf"F_{{\mathrm{{{_words(term)}}}}} = {body}", f"{description}{on}")


def _occasions(model: Model) -> Iterator[Formula]:
    stated = model.shaped
    for name, event in stated.events.items():
        body = (
            rf"\mathrm{{{_words(event.function.name)}}}"
            if isinstance(event.function, Function)
            else latex(event.function)
        )
        if event.every is not None:
            first, period = (str(part).replace(" ", r"\ ") for part in (event.phase or event.every, event.every))
            yield Formula(
                rf"t = t_0 + \mathrm{{{first}}} + k \cdot \mathrm{{{period}}}",
                f"event {name}, periodic: {event.action}",
            )
            continue
        yield Formula(f"{body} = 0", f"event {name}, {event.direction}: {event.action}{_along(model, name)}")
    for name, contact in stated.contacts.items():
        about = f"contact {name}, restitution {_short(contact.restitution)}{_along(model, name)}"
        yield Formula(rf"{latex(contact.gap)} \geq 0", about)
    for name, constraint in stated.constraints.items():
        about = (
            f"constraint {name}{_along(model, name)}, kept by the force constraint_force_{name} along its derivative"
        )
        yield Formula(f"{latex(constraint.condition)} = 0", about)
    for name, friction in stated.frictions.items():
        yield Formula(
            rf"\left|F\right| \leq {latex(friction.kinetic)}", f"friction {name}, slipping with {_short(friction.slip)}"
        )


def _short(node: Node | None) -> str:
    return "none" if node is None else text_of(node)


def _inertia(stated: Statement, i: int, j: int) -> str:
    entry = latex(stated.mass_entries[i, j])
    return rf"\left({entry}\right)\," if " + " in entry or " - " in entry else rf"{entry}\,"


def _dotted(name: str, times: int) -> str:
    return rf"\{'d' * times}ot{{{_symbol(name)}}}"


def _symbol(name: str) -> str:
    return latex(Name(name))


def _words(name: str) -> str:
    return name.replace("_", r"\ ")


def _number(name: str, parameter: Parameter) -> list[str]:
    spread = parameter.spread
    size = "" if spread is None else f"{parameter.uncertainty:.3g} {parameter.quantity.unit.text}".removesuffix(" 1")
    return [
        name,
        str(parameter.quantity).removesuffix(" 1"),
        size,
        "" if spread is None else spread.distribution,
        parameter.description,
    ]
