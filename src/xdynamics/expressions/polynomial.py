"""Expressions as polynomials in one of their names."""

from __future__ import annotations

from functools import reduce

from xdynamics.expressions.calculus import ONE, ZERO, add, divide, multiply, negative
from xdynamics.expressions.tree import Binary, Name, Negative, Node, exponent_of, free_names, text_of


def polynomial_coefficients(node: Node, name: str) -> tuple[Node, ...]:
    """Return the coefficients of a polynomial in a name, that of its zeroth power first.

    Raises
    ------
    ValueError
        If it is none: the name stands in a function, in a divisor, or under a power that is not whole.

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> [text_of(part) for part in polynomial_coefficients(parse("a + s*(b + (1 - s)*c)"), "s")]
    ['a', 'b + c', '-c']
    """
    if name not in free_names(node):
        return (node,)
    match node:
        case Name():
            return ZERO, ONE
        case Negative():
            return tuple(map(negative, polynomial_coefficients(node.operand, name)))
        case Binary(operator="+" | "-" | "*" | "/", left=left, right=right):
            parts = polynomial_coefficients(left, name), polynomial_coefficients(right, name)
            if node.operator == "/" and len(parts[1]) == 1:
                return tuple(divide(part, right) for part in parts[0])
            if node.operator == "*":
                return _coefficient_product(*parts)
            if node.operator != "/":
                return _coefficient_sum(parts[0], parts[1] if node.operator == "+" else tuple(map(negative, parts[1])))
        case Binary(operator="**", left=left, right=right):
            exponent = exponent_of(right)
            if exponent is not None and exponent.denominator == 1 and exponent > 0:
                return reduce(_coefficient_product, [polynomial_coefficients(left, name)] * int(exponent))
    raise ValueError(f"'{text_of(node)}' is no polynomial in {name}")


def _coefficient_sum(left: tuple[Node, ...], right: tuple[Node, ...]) -> tuple[Node, ...]:
    length = max(len(left), len(right))
    padded = ((*part, *[ZERO] * (length - len(part))) for part in (left, right))
    return tuple(map(add, *padded))


def _coefficient_product(left: tuple[Node, ...], right: tuple[Node, ...]) -> tuple[Node, ...]:
    terms: list[Node] = [ZERO] * (len(left) + len(right) - 1)
    for i, factor in enumerate(left):
        for j, right_factor in enumerate(right):
            terms[i + j] = add(terms[i + j], multiply(factor, right_factor))
    return tuple(terms)
