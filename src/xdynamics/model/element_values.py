"""Statements with dimensions and those of their elements, where numbers change: each follows the other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from xdynamics.model.element_numbers import ElementNumbers
from xdynamics.model.elementwise import Elementwise
from xdynamics.model.given_values import Values
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import Spread
from xdynamics.shapes import Shapes, internal_text
from xdynamics.shapes.naming import DOT
from xdynamics.units import Quantity
from xdynamics.units.rounded import decimal_text


def replaces_elements(sections: Mapping[str, Any]) -> bool:
    """Whether new entries of a model are those of single elements, as ``m·Sun``."""
    return any(
        DOT in internal_text(str(name))
        for entries in sections.values()
        if isinstance(entries, Mapping)
        for name in entries
    )


def follow_parameters(declared: Statement, elements: Statement, old: Statement, shapes: Shapes) -> Statement:
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
    start = ElementNumbers(gather_elements(declared, old, shapes), shapes).values_at_start(elements.parameters)
    same = {name: quantity for name, quantity in start.items() if elements.initial[name] == old.initial[name]}
    return replace(elements, initial=elements.initial | same)


def converted_like(statement: Statement, old: Statement) -> Statement:
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


def gather_elements(declared: Statement, elements: Statement, shapes: Shapes) -> Statement:
    """Return a statement with dimensions and the numbers of its elements."""
    arrays, starting = {}, {}
    for name, values in declared.arrays.items():
        if _is_as_read(elements.parameters, name):
            arrays[name] = values
            continue
        parts = [elements.parameters[element] for element in shapes.elements(name)]
        filled = _fill_values(values, tuple(part.quantity for part in parts), tuple(part.spread for part in parts))
        arrays[name] = values if _values_agree(filled, number_per_element(name, values, declared, shapes)) else filled
    start = (
        ElementNumbers(declared, shapes).values_at_start(elements.parameters)
        if not _is_as_read(elements.initial)
        else {}
    )
    for name, values in declared.starting.items():
        if _is_as_read(elements.initial, name) and not (start and values.tree):
            starting[name] = values
            continue
        names = shapes.elements(name)
        spreads = tuple(elements.starts[name].spread if name in elements.starts else None for name in names)
        numbers = tuple(elements.initial[name] for name in names)
        filled = _fill_values(values, numbers, spreads)
        if values.tree is None:
            same = _values_agree(filled, number_per_element(name, values, declared, shapes))
        else:
            same = all(start[name] == elements.initial[name] for name in names)
        starting[name] = values if same else filled
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


def number_per_element(name: str, values: Values, statement: Statement, shapes: Shapes) -> Values:
    """Return values with a number for each element: of their expression of constants, or of the one that all have."""
    numbers, _, unit = ElementNumbers(statement, shapes).element_values(values, name)
    return replace(values, tree=None, numbers=tuple(numbers if values.tree is None else numbers.tolist()), unit=unit)


def explicit_values(statement: Statement, shapes: Shapes) -> Statement:
    """Return a statement with a number for each element, however they are given; expressions of parameters stay."""
    arrays = {name: number_per_element(name, values, statement, shapes) for name, values in statement.arrays.items()}
    starting = {
        name: values if values.tree else number_per_element(name, values, statement, shapes)
        for name, values in statement.starting.items()
    }
    return replace(statement, arrays=arrays, starting=starting)


def _is_as_read(parts: Mapping[str, Any], name: str = "") -> bool:
    """Whether no element of a quantity, or of any, has another value than the statement had it first."""
    return isinstance(parts, Elementwise) and (name not in parts.changed if name else not parts.changed)


def _values_agree(first: Values, second: Values) -> bool:
    """Whether values agree in all digits that are known of them."""
    return first == second and [*map(decimal_text, first.numbers)] == [*map(decimal_text, second.numbers)]


def _fill_values(values: Values, quantities: tuple[Quantity, ...], spreads: tuple[Spread | None, ...]) -> Values:
    """Return the same quantity with numbers of its elements."""
    if values.tree is not None and values.unit is None and not values.dims:
        return replace(values, tree=None, numbers=(quantities[0].value,), unit=quantities[0].unit)
    shared_spreads = spreads[:1] if len(set(spreads)) == 1 else spreads
    numbers = tuple(quantity.value for quantity in quantities)
    return replace(
        values,
        tree=None,
        numbers=numbers,
        unit=quantities[0].unit,
        spreads=() if shared_spreads == (None,) else shared_spreads,
    )
