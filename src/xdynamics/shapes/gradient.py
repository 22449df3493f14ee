"""Derivatives of expressions with dimensions: gradients by the reverse mode, rates by the chain rule.

The rules are those of `expressions.calculus`; here are those of functions along dimensions. A derivative is an expression
with dimensions itself, as long as the one it is of, however many elements there are.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence, Set
from dataclasses import replace

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, chain, shown
from xdynamics.expressions.calculus import ONE, ZERO, add, divide, multiply, negative, rate_of
from xdynamics.expressions.tree import children
from xdynamics.faults import InputError
from xdynamics.shapes.distinct_parts import Parts
from xdynamics.shapes.extents import Shapes
from xdynamics.shapes.trees import at, element_numbers, end_of


def gradient(tree: Node, names: Collection[str], shapes: Shapes) -> dict[str, Node]:
    """Return the derivatives by some quantities of an expression, summed over its dimensions.

    Parameters
    ----------
    tree : Node
        As `prepared` returns it, with definitions expanded; the force of a potential is the gradient of its negative.
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
    found: dict[str, list[Node]] = {}
    for number in range(last, -1, -1):
        if number not in adjoints or not varying[number]:
            continue
        node, adjoint = parts.nodes[number], _summed(reversed(adjoints.pop(number)))
        if isinstance(node, Name | Element):
            found.setdefault(node.name, []).append(_of_name(node, adjoint, shapes))
            continue
        for position, operand in enumerate(parts.operands[number]):
            if varying[operand]:
                given = _reduced(_given(node, position, adjoint, parts), number, operand, parts)
                adjoints.setdefault(operand, []).append(given)
    gradients = {name: _summed(reversed(found[name])) for name in names if name in found}
    return {name: slope for name, slope in gradients.items() if slope != ZERO}


def derivative(tree: Node, rates: Mapping[str, Node], shapes: Shapes) -> Node:
    """Return the derivative of an expression by the chain rule.

    Parameters
    ----------
    tree : Node
        As `prepared` returns it, with definitions expanded.
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
                rate = rate_of(link, (rate, derivative(link.right, rates, shapes)))
            return rate
        case Call():
            return rate_of(tree, [derivative(argument, rates, shapes) for argument in tree.arguments])
        case Along():
            inner = [derivative(argument, rates, shapes) for argument in tree.arguments]
            return ZERO if all(rate == ZERO for rate in inner) else _rate_along(tree, inner, shapes)
    return ZERO


def _reduced(tree: Node, number: int, operand: int, parts: Parts) -> Node:
    """Return what a part gives to an operand of fewer dimensions: the sum over those that it lacks."""
    node, dims = parts.nodes[number], set(parts.dims[number])
    if isinstance(node, Along):
        if node.function in ("first", "second"):
            return tree  # of the operand's dimensions already
        dims |= set(node.dims)
        if node.function == "onto":
            dims.discard(end_of(node, parts.shapes))
    return _total(tree, parts.shapes.ordered(dims - parts.dims[operand]), parts.of(tree), parts.shapes)


def _summed(terms: Iterable[Node]) -> Node:
    """Add terms in their order; what links of one relation give to elements is one term."""
    result: list[Node] = []
    for term in terms:
        match = next((i for i, other in enumerate(result) if _joins(other, term)), None)
        if match is None:
            result.append(term)
            continue
        before = result[match]
        assert isinstance(before, Along) and isinstance(term, Along)  # noqa: S101, PT018 - they join
        result[match] = replace(before, arguments=tuple(map(add, before.arguments, term.arguments)))
    total: Node = ZERO
    for term in result:
        total = add(total, term)
    return total


def _joins(one: Node, other: Node) -> bool:
    both = isinstance(one, Along) and isinstance(other, Along)
    return both and one.function == other.function == "onto" and one.dims == other.dims  # type: ignore[union-attr]


def _of_name(node: Name | Element, adjoint: Node, shapes: Shapes) -> Node:
    """Return what a name, or one element of it, gives to the gradient by the whole."""
    if isinstance(node, Element):
        for dim, number in reversed(element_numbers(node, shapes).items()):
            here = Compare("==", Along("index", (), (dim,)), Number(float(number)))
            adjoint = Call("where", (here, adjoint, ZERO))
    return adjoint


def _total(tree: Node, dims: tuple[str, ...], own: Set[str], shapes: Shapes) -> Node:
    """Sum along dimensions; along one that the expression lacks it has the same value as often as there are elements."""
    times = math.prod(shapes.shape(tuple(dim for dim in dims if dim not in own)))
    present = tuple(dim for dim in dims if dim in own)
    return multiply(Number(float(times)), Along("sum", (tree,), present) if present and tree != ZERO else tree)


# ------------------------------------------------------------------------------------------------------- reverse mode


def _given(node: Node, position: int, adjoint: Node, parts: Parts) -> Node:
    """Return what an operation gives to the adjoint of one of its operands."""
    if isinstance(node, Along):
        return _given_along(node, position, adjoint, parts)
    assert isinstance(node, Negative | Binary | Call)  # noqa: S101 - others have no operands that vary
    return rate_of(node, [adjoint if other == position else ZERO for other in range(len(children(node)))])


def _given_along(node: Along, position: int, adjoint: Node, parts: Parts) -> Node:
    shapes, a, dims = parts.shapes, node.arguments[position], node.dims
    if node.function in ("roll", "shift") and isinstance(adjoint, Negative):
        return negative(_given_along(node, position, adjoint.operand, parts))
    match node.function:
        case "mean":
            return divide(adjoint, Number(float(math.prod(shapes.shape(dims)))))
        case "min" | "max":
            return Call("where", (_chosen(node, shapes), adjoint, ZERO))
        case "norm":
            return multiply(_over(adjoint, node), a)
        case "dot":
            return multiply(adjoint, node.arguments[1 - position])
        case "cross":
            other = node.arguments[1 - position]
            return _crossed(node, (other, adjoint) if position == 0 else (adjoint, other), parts)
        case "first" | "second":
            ends = (adjoint, ZERO) if node.function == "first" else (ZERO, adjoint)
            return Along("onto", ends, dims)
        case "onto":
            end = ("first", "second")[position]
            return _along_if(replace(node, function=end, arguments=(adjoint,)), parts.of(adjoint), shapes)
        case "roll":
            return _along_if(replace(node, arguments=(adjoint,), places=-node.places), parts.of(adjoint), shapes)
        case "shift":
            return _given_by_shift(node, position, adjoint, parts)
        case "take":
            return _given_by_take(node, adjoint, parts)
    return adjoint  # of a sum


def _given_by_shift(node: Along, position: int, adjoint: Node, parts: Parts) -> Node:
    if position == 1:
        return Call("where", (_beyond(node, parts.shapes), adjoint, ZERO)) if node.places else ZERO
    if node.dims[0] not in parts.of(adjoint):  # the same everywhere, but for elements that are shifted out
        back = replace(node, places=-node.places)
        return Call("where", (_beyond(back, parts.shapes), ZERO, adjoint)) if node.places else adjoint
    return replace(node, arguments=(adjoint, ZERO), places=-node.places)


def _given_by_take(node: Along, adjoint: Node, parts: Parts) -> Node:
    """Return what the elements that are taken give; of others nothing."""
    number, dim = node.arguments[1], node.dims[0]
    if dim in parts.of(number):
        raise InputError(
            f"'{shown(node)}' (column {node.column}) is in a potential, and its force cannot be derived through take by an"
            f" index of '{dim}' itself; use shift or roll, or write the force out"
        )
    return Call("where", (Compare("==", Along("index", (), (dim,)), number), adjoint, ZERO))


def _over(left: Node, right: Node) -> Node:
    """Divide; what is a quotient already is divided once, by a product."""
    if isinstance(left, Negative):
        return negative(_over(left.operand, right))
    if isinstance(left, Binary) and left.operator == "/":
        return divide(left.left, multiply(left.right, right))
    return divide(left, right)


def _crossed(node: Along, factors: tuple[Node, Node], parts: Parts) -> Node:
    """Return a cross product; two vectors that are the same in every direction are parallel."""
    varies = any(node.dims[0] in parts.of(factor) for factor in factors)
    return replace(node, arguments=factors) if varies and ZERO not in factors else ZERO


def _beyond(node: Along, shapes: Shapes) -> Node:
    """Return where a shift fills: before the first element, or after the last."""
    index = Along("index", (), node.dims)
    if node.places > 0:
        return Compare("<", index, Number(float(node.places)))
    return Compare(">=", index, Number(float(max(0, shapes.extent(node.dims[0]).size + node.places))))


def _chosen(node: Along, shapes: Shapes) -> Node:
    """Return where the least or greatest element is, the first of equal ones."""
    number: Node = ZERO
    for dim in node.dims:
        size = Number(float(shapes.extent(dim).size))
        number = add(multiply(number, size), Along("index", (), (dim,)))
    beyond = Number(float(math.prod(shapes.shape(node.dims))))
    here = Call("where", (Compare("==", node.arguments[0], node), number, beyond))
    return Compare("==", number, Along("min", (here,), node.dims))


def _along_if(node: Along, own: Set[str], shapes: Shapes) -> Node:
    """Return a function that moves values along a dimension; a value that is the same everywhere stays."""
    dim = node.dims[0]
    if node.function in ("first", "second"):
        relation = shapes.relations[dim]
        dim = relation.source if node.function == "first" else relation.target
    return node if dim in own else node.arguments[0]


# ------------------------------------------------------------------------------------------------------- forward mode


def _element_rate(node: Element, rate: Node, shapes: Shapes) -> Node:
    """Return the rate of one element."""
    if isinstance(rate, Name) and rate.name in shapes.dims:
        return replace(node, name=rate.name)
    return at(rate, element_numbers(node, shapes), shapes)


def _rate_along(node: Along, inner: Sequence[Node], shapes: Shapes) -> Node:
    """Return the rate of a function along dimensions from those of its values."""
    parts, dims = Parts(shapes), node.dims
    own = [parts.of(rate) for rate in inner]
    match node.function:
        case "sum":
            return _total(inner[0], dims, own[0], shapes)
        case "mean":
            count = Number(float(math.prod(shapes.shape(dims))))
            return divide(_total(inner[0], dims, own[0], shapes), count)
        case "norm":
            product = multiply(node.arguments[0], inner[0])
            return divide(_total(product, dims, parts.of(product), shapes), node)
        case "min" | "max":
            return Along("sum", (Call("where", (_chosen(node, shapes), inner[0], ZERO)),), dims)
        case "dot":
            product = add(*(multiply(part, other) for part, other in _pairs(node, inner)))
            return _total(product, dims, parts.of(product), shapes)
        case "cross":
            return add(*(_crossed(node, pair, parts) for pair in _pairs(node, inner)))
        case "shift":
            moved = replace(node, arguments=tuple(inner))
            return moved if dims[0] in own[0] else Call("where", (_beyond(node, shapes), inner[1], inner[0]))
        case "onto":
            return replace(node, arguments=tuple(inner))
        case "take":
            return replace(node, arguments=(inner[0], node.arguments[1])) if dims[0] in own[0] else inner[0]
    return _along_if(replace(node, arguments=tuple(inner)), own[0], shapes)


def _pairs(node: Along, inner: Sequence[Node]) -> tuple[tuple[Node, Node], tuple[Node, Node]]:
    """Return the factors of the two terms of a product's rate."""
    (a, b), (rate_a, rate_b) = node.arguments, inner
    return (rate_a, b), (a, rate_b)
