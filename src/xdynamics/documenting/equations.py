"""A model as formulas and tables."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.documenting.blocks import Block, Formula, TextTable, Words
from xdynamics.expressions import Name, latex
from xdynamics.model import Model
from xdynamics.model.parts import Function, Parameter


def of_model(model: Model) -> Iterator[Block]:
    """Write the equations of motion, forces, definitions, events and numbers of a model."""
    if model.description:
        yield Words(model.description)
    for i, name in enumerate(model.coordinates):
        terms = [
            f"{_inertia(model, i, j)}{_dotted(other, 2)}"
            for j, other in enumerate(model.coordinates)
            if (i, j) in model.statement.mass_entries
        ]
        acting = [
            rf"F_{{\mathrm{{{_words(term)}}}}}"
            for term, components in model.force_components.items()
            if name in components
        ]
        yield Formula(f"{' + '.join(terms)} = {' + '.join(acting) or '0'}", f"motion of {name}")
    yield from _forces(model)
    for name, definition in model.definitions.items():
        yield Formula(f"{latex(Name(name))} = {latex(definition)}", "definition")
    for name, state in model.states.items():
        yield Formula(rf"{_dotted(name, 1)} = {latex(state.rate)}", state.description or f"rate of {name}")
    yield from _occasions(model)
    for name, observable in model.observables.items():
        yield Formula(f"{latex(Name(name))} = {latex(observable)}", "observable")
    if model.drives:
        yield TextTable(
            ["drive", "of", "points", "between them", "beyond", "what"],
            [
                [
                    name,
                    drive.argument,
                    f"{len(drive.table.argument)} in {drive.table.name}",
                    drive.interpolation,
                    drive.outside,
                    drive.description,
                ]
                for name, drive in model.drives.items()
            ],
        )
    numbers = [(name, parameter) for name, parameter in model.parameters.items()]
    numbers += [
        (f"{name} at the start", model.starts.get(name, Parameter(quantity)))
        for name, quantity in model.initial.items()
    ]
    yield TextTable(
        ["number", "value", "standard uncertainty", "distribution", "what"],
        [_number(name, number) for name, number in numbers],
    )


def _forces(model: Model) -> Iterator[Formula]:
    for term, force in model.forces.items():
        description = f"{term}: {force.description}" if force.description else term
        if force.potential is not None:
            yield Formula(rf"V_{{\mathrm{{{_words(term)}}}}} = {latex(force.potential)}", f"potential of {description}")
        for name, part in force.components.items():
            body = (
                rf"\mathrm{{{_words(part.name)}}}({', '.join(_symbol(argument) for argument in part.arguments)})"
                if isinstance(part, Function)
                else latex(part)
            )
            on = f", on {name}" if len(model.coordinates) > 1 else ""
            yield Formula(rf"F_{{\mathrm{{{_words(term)}}}}} = {body}", f"{description}{on}")


def _occasions(model: Model) -> Iterator[Formula]:
    for name, event in model.events.items():
        body = (
            rf"\mathrm{{{_words(event.function.name)}}}"
            if isinstance(event.function, Function)
            else latex(event.function)
        )
        yield Formula(f"{body} = 0", f"event {name}, {event.direction}: {event.action}")
    for name, contact in (model.contacts | {name: model.shaped.contacts[name] for name in model.assemblies}).items():
        yield Formula(rf"{latex(contact.gap)} \geq 0", f"contact {name}, restitution {_short(contact.restitution)}")
    for name, friction in model.frictions.items():
        yield Formula(
            rf"\left|F\right| \leq {latex(friction.kinetic)}", f"friction {name}, slipping with {_short(friction.slip)}"
        )


def _short(node: object) -> str:
    from xdynamics.expressions import text_of

    return "none" if node is None else text_of(node)  # type: ignore[arg-type]


def _inertia(model: Model, i: int, j: int) -> str:
    entry = latex(model.statement.mass_entries[i, j])
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
