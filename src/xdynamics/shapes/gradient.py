"""Derivatives of expressions with dimensions: gradients by the reverse mode, rates by the chain rule.

The rules are those of `expressions.calculus`; here are those of functions along dimensions. A derivative is an expression
with dimensions itself, as long as the one it is of, however many elements there are.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence, Set
from dataclasses import replace

from xdynamics.expressions import (
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
    shortened_text,
)
from xdynamics.expressions.calculus import ONE, ZERO, add, divide, multiply, negative, operation_derivative
from xdynamics.expressions.tree import children
from xdynamics.faults import InputError
from xdynamics.shapes.extents import Shapes
from xdynamics.shapes.trees import Parts, at_element, element_numbers, end_dimension


def gradient(tree: Node, names: Collection[str], shapes: Shapes) -> dict[str, Node]:
    """Return the derivatives by some quantities of an expression, summed over its dimensions.

    Parameters
    ----------
    tree : Node
        As `resolve_min_max` returns it, with definitions expanded; the force of a potential is the gradient of its negative.
    names : collection of str
        Quantities with or without dimensions.
    shapes : Shapes

    Returns
    -------
    dict of str to Node
        For each quantity that it depends on, the derivative by its elements. It has no other dimensions than the
        quantity; along one that it lacks it is the same for every element.

    Notes
    -----
    What follows from an expression that occurs several times is added first, in the order written: each part is
    differentiated once. At a kink the derivative is that of the branch taken; of equal elements in `min` and `max` the
    first is taken.

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> from xdynamics.shapes.extents import Extent, Shapes
    >>> shapes = Shapes({"site": Extent("site", 5)}, {}, {"u": ("site",)})
    >>> found = gradient(parse("sum(k*(u - roll(u, site, 1))**2/2, site)"), {"u"}, shapes)
    >>> text_of(found["u"])
    '-roll(2*(u - roll(u, site, 1))*(k*(1/2)), site, -1) + 2*(u - roll(u, site, 1))*(k*(1/2))'
    """
    parts = Parts(shapes)
    last = parts.number(tree)
    varying = parts.depending(names)
    adjoints: dict[int, list[Node]] = {last: [ONE]}
    contributions: dict[str, list[Node]] = {}
    for number in range(last, -1, -1):
        if number not in adjoints or not varying[number]:
            continue
        node, adjoint = parts.nodes[number], _merged_sum(reversed(adjoints.pop(number)))
        if isinstance(node, Name | Element):
            contributions.setdefault(node.name, []).append(_name_contribution(node, adjoint, shapes))
            continue
        for position, operand in enumerate(parts.operands[number]):
            if varying[operand]:
                contribution = _reduce_to_operand(
                    _operand_adjoint(node, position, adjoint, parts), number, operand, parts
                )
                adjoints.setdefault(operand, []).append(contribution)
    gradients = {name: _merged_sum(reversed(contributions[name])) for name in names if name in contributions}
    return {name: slope for name, slope in gradients.items() if slope != ZERO}


def derivative(tree: Node, rates: Mapping[str, Node], shapes: Shapes) -> Node:
    """Return the derivative of an expression by the chain rule.

    Parameters
    ----------
    tree : Node
        As `resolve_min_max` returns it, with definitions expanded.
    rates : mapping of str to Node
        The derivative of each quantity that varies, with its dimensions or fewer; one that is not listed is constant.
    shapes : Shapes

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> from xdynamics.shapes.extents import Extent, Shapes
    >>> shapes = Shapes({"site": Extent("site", 5)}, {}, {"u": ("site",), "v_u": ("site",)})
    >>> text_of(derivative(parse("sum(u**2, site)/2 - u[0]"), {"u": parse("v_u")}, shapes))
    'sum(2*u*v_u, site)/2 - v_u[0]'
    """
    match tree:
        case Name():
            return rates.get(tree.name, ZERO)
        case Element():
            return _element_rate(tree, rates.get(tree.name, ZERO), shapes)
        case Negative():
            return negative(derivative(tree.operand, rates, shapes))
        case Binary():
            first, links = chain(tree)
            rate = derivative(first, rates, shapes)
            for link in links:
                rate = operation_derivative(link, (rate, derivative(link.right, rates, shapes)))
            return rate
        case Call():
            return operation_derivative(tree, [derivative(argument, rates, shapes) for argument in tree.arguments])
        case Along():
            inner = [derivative(argument, rates, shapes) for argument in tree.arguments]
            return ZERO if all(rate == ZERO for rate in inner) else _rate_along(tree, inner, shapes)
    return ZERO


def _reduce_to_operand(tree: Node, number: int, operand: int, parts: Parts) -> Node:
    """Return a part's contribution to an operand of fewer dimensions: the sum over those it lacks."""
    node, dims = parts.nodes[number], set(parts.dims[number])
    if isinstance(node, Along):
        if node.function in ("first", "second"):
            return tree  # of the operand's dimensions already
        dims |= set(node.dims)
        if node.function == "onto":
            dims.discard(end_dimension(node, parts.shapes))
    return _sum_along_dims(
        tree, parts.shapes.ordered(dims - parts.dims[operand]), parts.dims_of_node(tree), parts.shapes
    )


def _merged_sum(terms: Iterable[Node]) -> Node:
    """Add terms in their order; contributions of one relation's links are merged into one term."""
    merged_terms: list[Node] = []
    for term in terms:
        match = next((i for i, earlier_term in enumerate(merged_terms) if _joins(earlier_term, term)), None)
        if match is None:
            merged_terms.append(term)
            continue
        joined_term = merged_terms[match]
        assert isinstance(joined_term, Along) and isinstance(term, Along)  # noqa: S101, PT018 - they join
        merged_terms[match] = replace(joined_term, arguments=tuple(map(add, joined_term.arguments, term.arguments)))
    total: Node = ZERO
    for term in merged_terms:
        total = add(total, term)
    return total


def _joins(left: Node, right: Node) -> bool:
    both = isinstance(left, Along) and isinstance(right, Along)
    return both and left.function == right.function == "onto" and left.dims == right.dims  # type: ignore[union-attr]


def _name_contribution(node: Name | Element, adjoint: Node, shapes: Shapes) -> Node:
    """Return the adjoint of a name, or of one of its elements, as a term of the name's gradient."""
    if isinstance(node, Element):
        for dim, number in reversed(element_numbers(node, shapes).items()):
            is_element = Compare("==", Along("index", (), (dim,)), Number(float(number)))
            adjoint = Call("where", (is_element, adjoint, ZERO))
    return adjoint


def _sum_along_dims(tree: Node, dims: tuple[str, ...], tree_dims: Set[str], shapes: Shapes) -> Node:
    """Sum along dimensions; along a dimension that the expression lacks, multiply by its size."""
    repeats = math.prod(shapes.shape(tuple(dim for dim in dims if dim not in tree_dims)))
    present = tuple(dim for dim in dims if dim in tree_dims)
    return multiply(Number(float(repeats)), Along("sum", (tree,), present) if present and tree != ZERO else tree)


# ------------------------------------------------------------------------------------------------------- reverse mode


def _operand_adjoint(node: Node, position: int, adjoint: Node, parts: Parts) -> Node:
    """Return an operation's contribution to the adjoint of one of its operands."""
    if isinstance(node, Along):
        return _adjoint_along(node, position, adjoint, parts)
    assert isinstance(node, Negative | Binary | Call)  # noqa: S101 - others have no operands that vary
    return operation_derivative(node, [adjoint if index == position else ZERO for index in range(len(children(node)))])


def _adjoint_along(node: Along, position: int, adjoint: Node, parts: Parts) -> Node:
    shapes, a, dims = parts.shapes, node.arguments[position], node.dims
    if node.function in ("roll", "shift") and isinstance(adjoint, Negative):
        return negative(_adjoint_along(node, position, adjoint.operand, parts))
    match node.function:
        case "mean":
            return divide(adjoint, Number(float(math.prod(shapes.shape(dims)))))
        case "min" | "max":
            return Call("where", (_extremum_condition(node, shapes), adjoint, ZERO))
        case "norm":
            return multiply(_divide_once(adjoint, node), a)
        case "dot":
            return multiply(adjoint, node.arguments[1 - position])
        case "cross":
            cofactor = node.arguments[1 - position]
            return _cross_product(node, (cofactor, adjoint) if position == 0 else (adjoint, cofactor), parts)
        case "first" | "second":
            ends = (adjoint, ZERO) if node.function == "first" else (ZERO, adjoint)
            return Along("onto", ends, dims)
        case "onto":
            end = ("first", "second")[position]
            return _move_if_along(
                replace(node, function=end, arguments=(adjoint,)), parts.dims_of_node(adjoint), shapes
            )
        case "roll":
            return _move_if_along(
                replace(node, arguments=(adjoint,), places=-node.places), parts.dims_of_node(adjoint), shapes
            )
        case "shift":
            return _adjoint_by_shift(node, position, adjoint, parts)
        case "take":
            return _adjoint_by_take(node, adjoint, parts)
    return adjoint  # of a sum


def _adjoint_by_shift(node: Along, position: int, adjoint: Node, parts: Parts) -> Node:
    if position == 1:
        return Call("where", (_fill_condition(node, parts.shapes), adjoint, ZERO)) if node.places else ZERO
    if node.dims[0] not in parts.dims_of_node(adjoint):  # the same everywhere, but for elements that are shifted out
        reverse_shift = replace(node, places=-node.places)
        return Call("where", (_fill_condition(reverse_shift, parts.shapes), ZERO, adjoint)) if node.places else adjoint
    return replace(node, arguments=(adjoint, ZERO), places=-node.places)


def _adjoint_by_take(node: Along, adjoint: Node, parts: Parts) -> Node:
    """Return the adjoint by the elements that are taken; zero for others."""
    number, dim = node.arguments[1], node.dims[0]
    if dim in parts.dims_of_node(number):
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}) is in a potential, and its force cannot be derived through take by an"
            f" index of '{dim}' itself; use shift or roll, or write the force out"
        )
    return Call("where", (Compare("==", Along("index", (), (dim,)), number), adjoint, ZERO))


def _divide_once(left: Node, right: Node) -> Node:
    """Divide; the quotient of a quotient is one division by a product."""
    if isinstance(left, Negative):
        return negative(_divide_once(left.operand, right))
    if isinstance(left, Binary) and left.operator == "/":
        return divide(left.left, multiply(left.right, right))
    return divide(left, right)


def _cross_product(node: Along, factors: tuple[Node, Node], parts: Parts) -> Node:
    """Return a cross product; zero where both vectors are constant along the dimension, hence parallel."""
    varies = any(node.dims[0] in parts.dims_of_node(factor) for factor in factors)
    return replace(node, arguments=factors) if varies and ZERO not in factors else ZERO


def _fill_condition(node: Along, shapes: Shapes) -> Node:
    """Return where a shift fills: before the first element, or after the last."""
    index = Along("index", (), node.dims)
    if node.places > 0:
        return Compare("<", index, Number(float(node.places)))
    return Compare(">=", index, Number(float(max(0, shapes.extent(node.dims[0]).size + node.places))))


def _extremum_condition(node: Along, shapes: Shapes) -> Node:
    """Return where the least or greatest element is, the first of equal ones."""
    number: Node = ZERO
    for dim in node.dims:
        size = Number(float(shapes.extent(dim).size))
        number = add(multiply(number, size), Along("index", (), (dim,)))
    beyond = Number(float(math.prod(shapes.shape(node.dims))))
    candidate_number = Call("where", (Compare("==", node.arguments[0], node), number, beyond))
    return Compare("==", number, Along("min", (candidate_number,), node.dims))


def _move_if_along(node: Along, tree_dims: Set[str], shapes: Shapes) -> Node:
    """Return a function that moves values along a dimension; a value constant along it stays."""
    dim = node.dims[0]
    if node.function in ("first", "second"):
        relation = shapes.relations[dim]
        dim = relation.source if node.function == "first" else relation.target
    return node if dim in tree_dims else node.arguments[0]


# ------------------------------------------------------------------------------------------------------- forward mode


def _element_rate(node: Element, rate: Node, shapes: Shapes) -> Node:
    """Return the rate of one element."""
    if isinstance(rate, Name) and rate.name in shapes.dims:
        return replace(node, name=rate.name)
    return at_element(rate, element_numbers(node, shapes), shapes)


def _rate_along(node: Along, inner: Sequence[Node], shapes: Shapes) -> Node:
    """Return the rate of a function along dimensions from those of its values."""
    parts, dims = Parts(shapes), node.dims
    rate_dims = [parts.dims_of_node(rate) for rate in inner]
    match node.function:
        case "sum":
            return _sum_along_dims(inner[0], dims, rate_dims[0], shapes)
        case "mean":
            count = Number(float(math.prod(shapes.shape(dims))))
            return divide(_sum_along_dims(inner[0], dims, rate_dims[0], shapes), count)
        case "norm":
            product = multiply(node.arguments[0], inner[0])
            return divide(_sum_along_dims(product, dims, parts.dims_of_node(product), shapes), node)
        case "min" | "max":
            return Along("sum", (Call("where", (_extremum_condition(node, shapes), inner[0], ZERO)),), dims)
        case "dot":
            product = add(*(multiply(part, factor) for part, factor in _product_rate_factors(node, inner)))
            return _sum_along_dims(product, dims, parts.dims_of_node(product), shapes)
        case "cross":
            return add(*(_cross_product(node, pair, parts) for pair in _product_rate_factors(node, inner)))
        case "shift":
            shifted = replace(node, arguments=tuple(inner))
            return (
                shifted
                if dims[0] in rate_dims[0]
                else Call("where", (_fill_condition(node, shapes), inner[1], inner[0]))
            )
        case "onto":
            return replace(node, arguments=tuple(inner))
        case "take":
            return replace(node, arguments=(inner[0], node.arguments[1])) if dims[0] in rate_dims[0] else inner[0]
    return _move_if_along(replace(node, arguments=tuple(inner)), rate_dims[0], shapes)


def _product_rate_factors(node: Along, inner: Sequence[Node]) -> tuple[tuple[Node, Node], tuple[Node, Node]]:
    """Return the factors of the two terms of a product's rate."""
    (a, b), (rate_a, rate_b) = node.arguments, inner
    return (rate_a, b), (a, rate_b)
