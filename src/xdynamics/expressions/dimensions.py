"""The dimension of an expression, from the dimensions of its names."""

from __future__ import annotations

from collections.abc import Mapping

from xdynamics.expressions.tree import (
    DELAYED,
    Along,
    Binary,
    Call,
    Compare,
    Element,
    Name,
    Negative,
    Node,
    Number,
    chain,
    exponent_of,
    shortened_text,
)
from xdynamics.faults import InputError
from xdynamics.units import NONE, TIME, Dimension, coherent, constant_of, parse_unit

_KEEPS = ("abs", "min", "max", "hypot", "mod")  # of the same dimension as their arguments


class UnequalUnitsError(InputError):
    """Numbers of different units are added, compared or chosen between."""


def dimension_of(node: Node, names: Mapping[str, Dimension]) -> Dimension:
    """Return the dimension of an expression, checking every part of it.

    Parameters
    ----------
    node : Node
    names : mapping of str to Dimension
        Every name that the expression may use.

    Raises
    ------
    InputError
        If a name is unknown, terms that are added or compared differ in dimension, or a function needs a pure number;
        with the column and both units.
    """
    dimension = _checked_dimension(node, names)
    return NONE if dimension is None else dimension


def _checked_dimension(node: Node, names: Mapping[str, Dimension]) -> Dimension | None:
    """Return the dimension; None for a literal zero, which has every unit."""
    match node:
        case Number():
            return None if node.value == 0 else NONE
        case Name() | Element():
            if node.name not in names:
                raise InputError(
                    f"name '{node.name}' (column {node.column}) is not declared{_near_names(node.name, names)}"
                )
            return names[node.name]
        case Negative():
            return _checked_dimension(node.operand, names)
        case Binary():
            return _chain_dimension(node, names)
        case Compare():
            _agreed((node.left, node.right), names, f"'{node.operator}'")
            return NONE
        case Call():
            return _call_dimension(node, names)
        case Along():
            return _reduction_dimension(node, names)


def _chain_dimension(node: Binary, names: Mapping[str, Dimension]) -> Dimension | None:
    first, links = chain(node)
    dimension = _checked_dimension(first, names)
    for link in links:
        dimension = _link_dimension(link, dimension, names)
    return dimension


def _link_dimension(node: Binary, left: Dimension | None, names: Mapping[str, Dimension]) -> Dimension | None:
    """Return the dimension of a binary node from that of its left operand."""
    if node.operator == "**":
        return None if left is None else left ** (exponent_of(node.right) or 0)
    right = _checked_dimension(node.right, names)
    if node.operator in "+-":
        return _common_dimension((node.left, left), (node.right, right), f"'{node.operator}'")
    pair = left or NONE, right or NONE  # in a product, zero is a pure number like any other
    return pair[0] * pair[1] if node.operator == "*" else pair[0] / pair[1]


def _call_dimension(node: Call, names: Mapping[str, Dimension]) -> Dimension | None:
    label = f"'{node.function}'"
    if node.function == DELAYED:
        delayed_value, delay_node = node.arguments
        # models without units have a time that is a pure number
        if (delay := _checked_dimension(delay_node, names)) != names.get("t", TIME):
            raise InputError(
                f"the delay '{shortened_text(delay_node)}' is in '{delay}', needs '{names.get('t', TIME)}' (column {delay_node.column})"
            )
        return _checked_dimension(delayed_value, names)
    if node.function == "where":
        _checked_dimension(node.arguments[0], names)
        return _agreed(node.arguments[1:], names, label)
    if node.function in _KEEPS:
        return _agreed(node.arguments, names, label)
    if node.function == "atan2":
        _agreed(node.arguments, names, label)
        return NONE
    inner = _checked_dimension(node.arguments[0], names)
    if node.function == "sign":
        return NONE
    if node.function == "sqrt":
        return None if inner is None else inner ** (exponent_of(Number(0.5)) or 0)
    if inner not in (None, NONE):
        argument = shortened_text(node.arguments[0])
        remedy = f"; a frequency times it is one, like w*({argument}) with w in rad s-1" if inner == TIME else ""
        raise InputError(f"{label} needs a pure number, got '{argument}' in '{inner}' (column {node.column}){remedy}")
    return NONE


def _reduction_dimension(node: Along, names: Mapping[str, Dimension]) -> Dimension | None:
    """Return the dimension of a function along dimensions: that of its value, of a product, or of a number."""
    if node.function in ("index", "size"):
        return NONE
    if node.function in ("dot", "cross"):
        left, right = (_checked_dimension(argument, names) or NONE for argument in node.arguments)
        return left * right
    values = node.arguments[:1] if node.function == "take" else node.arguments
    return _agreed(values, names, f"'{node.function}'")


def _agreed(nodes: tuple[Node, ...], names: Mapping[str, Dimension], label: str) -> Dimension | None:
    """Return the dimension that all of `nodes` share."""
    agreed = nodes[0], _checked_dimension(nodes[0], names)
    for node in nodes[1:]:
        current = node, _checked_dimension(node, names)
        dimension = _common_dimension(agreed, current, label)
        agreed = agreed if agreed[1] is not None else (node, dimension)
    return agreed[1]


def _common_dimension(
    first: tuple[Node, Dimension | None], second: tuple[Node, Dimension | None], label: str
) -> Dimension | None:
    """Return the dimension that two expressions share."""
    (a, dim_a), (b, dim_b) = first, second
    if dim_a is None or dim_b is None:
        return dim_b if dim_a is None else dim_a
    if dim_a != dim_b:
        raise UnequalUnitsError(
            f"{label} joins '{shortened_text(a)}' in '{dim_a}' with '{shortened_text(b)}' in '{dim_b}' (column {b.column})"
        )
    return dim_a


MOST_COMPARED = 1_000  # names compared to find the one that was meant


_IN_CELSIUS, _IN_FAHRENHEIT = "20 °C is 293.15*kelvin", "68 °F is 293.15*kelvin"
TEMPERATURES = dict.fromkeys(("celsius", "Celsius", "degC", "deg_C", "centigrade"), _IN_CELSIUS) | dict.fromkeys(
    ("fahrenheit", "Fahrenheit", "degF", "deg_F"), _IN_FAHRENHEIT
)


def _near_names(name: str, names: Mapping[str, Dimension]) -> str:
    # imported for a message alone
    from difflib import get_close_matches

    stems = (name.removesuffix("_dot"), name.removesuffix("dot"), name.removesuffix("_prime"), name.removeprefix("d"))
    rates = [f"v_{stem}" for stem in stems if stem != name and f"v_{stem}" in names]  # as models write them
    if name in TEMPERATURES:
        return f"; a temperature is written in kelvin: {TEMPERATURES[name]}"
    near = rates or get_close_matches(name, [*names][:MOST_COMPARED], n=1)
    meant = f"; did you mean '{near[0]}'?" if near else ""
    try:
        unit = parse_unit(name)
        unit_product = constant_of(name) or f"{float(unit.factor)!r}*{constant_of(coherent(unit).text)}"
    except InputError:  # no unit, or one of a product, as the litre
        return meant
    return f"{meant}; as a unit it is written {unit_product}"
