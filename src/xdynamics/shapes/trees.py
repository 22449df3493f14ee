"""Trees of expressions with dimensions: how dimensions combine, and the trees at single elements.

`Parts` gives the distinct parts of such expressions, each once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from functools import reduce
from typing import Any

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
    expand,
    free_names,
    shortened_text,
)
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import children, every
from xdynamics.faults import InputError
from xdynamics.shapes.extents import Shapes, check_number_of_element, whole_numbers

REDUCTIONS = ("sum", "mean", "min", "max", "norm", "dot")
ENDS = ("first", "second")
OF_CROSS = 3  # elements along the dimension of a cross product


def resolve_min_max(node: Node, shapes: Shapes) -> Node:
    """Return an expression with `min` and `max` along dimensions distinguished from those of several values.

    Raises
    ------
    InputError
        If values stand beside dimensions in one of them.
    """
    match node:
        case Negative():
            return replace(node, operand=resolve_min_max(node.operand, shapes))
        case Binary():
            first, links = chain(node)
            tree = resolve_min_max(first, shapes)
            for link in links:
                tree = Binary(link.operator, tree, resolve_min_max(link.right, shapes), link.column)
            return tree
        case Compare():
            return replace(node, left=resolve_min_max(node.left, shapes), right=resolve_min_max(node.right, shapes))
        case Call():
            values = [argument for argument in node.arguments if not _is_dimension(argument, shapes)]
            if len(values) < len(node.arguments) and node.function in ("min", "max"):
                return _min_max_along(node, values, shapes)
            return replace(node, arguments=tuple(resolve_min_max(argument, shapes) for argument in node.arguments))
        case Along():
            return replace(node, arguments=tuple(resolve_min_max(argument, shapes) for argument in node.arguments))
    return node


def _is_dimension(node: Node, shapes: Shapes) -> bool:
    is_dim_name = isinstance(node, Name) and node.name in (*shapes.extents, *shapes.relations)
    return is_dim_name and node.name not in shapes.dims  # type: ignore[union-attr]


def _min_max_along(node: Call, values: list[Node], shapes: Shapes) -> Along:
    dims = tuple(
        argument.name for argument in node.arguments[1:] if isinstance(argument, Name) and argument not in values
    )
    if len(values) != 1 or node.arguments[0] is not values[0]:
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}) mixes values and dimensions; write {node.function}(a, dimension) to"
            f" reduce, or {node.function}(a, b) to compare"
        )
    return Along(node.function, (resolve_min_max(values[0], shapes),), dims, 0, node.column)


def expand_definitions(node: Node, definitions: Mapping[str, Node], shapes: Shapes) -> Node:
    """Return an expression with definitions substituted; one element of a definition is picked from all of them.

    Raises
    ------
    InputError
        As `expressions.expand`.
    """
    trees = {name: _picked(tree, definitions, shapes) for name, tree in definitions.items()}
    return expand(_picked(node, definitions, shapes), trees)


def _picked(node: Node, definitions: Mapping[str, Node], shapes: Shapes) -> Node:
    """Return an expression in which single elements are of nothing that is defined."""
    if not any(isinstance(node, Element) and node.name in definitions for node in every(node)):
        return node
    match node:
        case Element():
            tree: Node = Name(node.name, node.column)
            for dim, number in element_numbers(node, shapes).items():
                tree = Call("where", (Compare("==", Along("index", (), (dim,)), Number(float(number))), tree, ZERO))
            return Along("sum", (tree,), shapes.dims[node.name])
        case Negative():
            return replace(node, operand=_picked(node.operand, definitions, shapes))
        case Binary():
            first, links = chain(node)
            tree = _picked(first, definitions, shapes)
            for link in links:
                tree = Binary(link.operator, tree, _picked(link.right, definitions, shapes), link.column)
            return tree
        case Compare():
            left, right = (_picked(side, definitions, shapes) for side in (node.left, node.right))
            return replace(node, left=left, right=right)
        case Call() | Along():
            return replace(node, arguments=tuple(_picked(argument, definitions, shapes) for argument in node.arguments))
    return node


def dims_of(node: Node, shapes: Shapes) -> tuple[str, ...]:
    """Return the dimensions of an expression, in the order of a record.

    Parameters
    ----------
    node : Node
        As `resolve_min_max` returns it.
    shapes : Shapes

    Raises
    ------
    InputError
        Naming the part, the dimension that is missing or too many, and the remedy.
    """
    return shapes.ordered(_tree_dims(node, shapes))


def _tree_dims(node: Node, shapes: Shapes) -> set[str]:
    match node:
        case Name():
            if _is_dimension(node, shapes):
                raise InputError(
                    f"'{node.name}' (column {node.column}) is a dimension, not a value; index({node.name}) is the number"
                    f" of an element, size({node.name}) how many there are"
                )
            return set(shapes.dims.get(node.name, ()))
        case Element():
            element_numbers(node, shapes)
            return set()
        case Binary():
            first, links = chain(node)
            return _tree_dims(first, shapes).union(*(_tree_dims(link.right, shapes) for link in links))
        case Along():
            return dims_along(node, [_tree_dims(argument, shapes) for argument in node.arguments], shapes)
    return set[str]().union(*(_tree_dims(child, shapes) for child in children(node)))


def dims_along(node: Along, inner: Sequence[Set[str]], shapes: Shapes) -> set[str]:
    """Return the dimensions of a function along dimensions from those of its values, which are checked.

    Raises
    ------
    InputError
        If the values lack such a dimension, or a cross product's has not three elements.
    """
    for dim in node.dims:
        try:
            shapes.extent(dim)
        except InputError as error:
            raise InputError(f"{_column_label(node)}: {error}") from None
    if twice := [dim for dim in node.dims if node.dims.count(dim) > 1]:
        raise InputError(f"{_column_label(node)} goes along '{twice[0]}' twice; name it once")
    dims = set[str]().union(*inner)
    if node.function == "size":
        return set()
    if node.function == "index":
        return {node.dims[0]}
    if node.function in ENDS:
        return _dims_of_end(node, dims, shapes)
    if node.function == "onto":
        return dims - set(node.dims) | {end_dimension(node, shapes)}
    value_dims = dims if node.function not in ("shift", "take") else set(inner[0])
    for dim in node.dims:
        if dim not in value_dims:
            dims_text = ", ".join(shapes.ordered(value_dims)) or "none"
            raise InputError(
                f"{_column_label(node)} goes along '{dim}', and '{shortened_text(node.arguments[0])}' has the dimensions: {dims_text};"
                f" {'leave it out' if dims_text == 'none' else 'take one of these'}"
            )
    if node.function == "take":
        check_number_of_element(node, shapes.ordered(set(inner[1])), shapes)
        return set(inner[0]) - {node.dims[0]} | set(inner[1])
    if node.function == "cross" and (size := shapes.extent(node.dims[0]).size) != OF_CROSS:
        raise InputError(
            f"{_column_label(node)} goes along '{node.dims[0]}' of {size} elements, and needs 3{_in_plane(node, size)}"
        )
    return dims - set(node.dims) if node.function in REDUCTIONS else dims


def _in_plane(node: Along, size: int) -> str:
    """Return how to write the single component of a vector product of vectors in a plane."""
    if size != len(node.arguments):
        return ""
    (x, y), (u, v) = ([f"take({shortened_text(part)}, {node.dims[0]}, {i})" for i in (0, 1)] for part in node.arguments)
    return f"; in a plane write {x}*{v} - {y}*{u}"


def _dims_of_end(node: Along, dims: set[str], shapes: Shapes) -> set[str]:
    """Return the dimensions of a value at one end of every link."""
    name = node.dims[0]
    if name not in shapes.relations:
        relation_names = ", ".join(shapes.relations) or "none"
        raise InputError(f"{_column_label(node)}: '{name}' is no relation; there are: {relation_names}")
    relation = shapes.relations[name]
    end = relation.source if node.function == "first" else relation.target
    if name in dims or end not in dims:
        dims_text = ", ".join(shapes.ordered(dims)) or "none"
        fault = "is along the relation already" if name in dims else f"needs a value along '{end}'"
        raise InputError(
            f"{_column_label(node)} {fault}: '{shortened_text(node.arguments[0])}' has the dimensions: {dims_text}"
        )
    return dims - {end} | {name}


def _column_label(node: Along) -> str:
    return f"'{shortened_text(node)}' (column {node.column})"


def end_dimension(node: Along, shapes: Shapes) -> str:
    """Return the dimension of the elements at whose ends links are summed."""
    relation = shapes.relations[node.dims[0]]
    return relation.target if node.arguments[0] == ZERO else relation.source


def element_numbers(node: Element, shapes: Shapes) -> dict[str, int]:
    """Return the indices of an element that is written in brackets.

    Raises
    ------
    InputError
        If there is not one entry for each dimension, or an entry is no element of it.
    """
    dims = shapes.dims.get(node.name, ())
    if len(node.entries) != len(dims):
        dims_text = (
            f"the dimensions {', '.join(dims)}; write an entry for each"
            if dims
            else "no dimensions, and therefore no elements"
        )
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}): '{node.name}' has {dims_text}{_along_the_others(node, dims, shapes)}"
        )
    extents = [shapes.extent(dim) for dim in dims]
    for entry, extent in zip(node.entries, extents, strict=True):
        elsewhere = [candidate.name for candidate in extents if entry in candidate.labels]
        if elsewhere and extent.name not in elsewhere:
            raise InputError(
                f"'{shortened_text(node)}' (column {node.column}): {entry} is an element of '{elsewhere[0]}', but stands where"
                f" one is expected of '{extent.name}'; in brackets the dimensions are {', '.join(dims)}, in this order"
            )
    return {extent.name: extent.number(entry) for entry, extent in zip(node.entries, extents, strict=True)}


def _along_the_others(node: Element, dims: Sequence[str], shapes: Shapes) -> str:
    """Return how to write a component of many vectors, where its label alone was given; else an empty text."""
    labels = shapes.extent(dims[-1]).labels if len(dims) > 1 else ()
    if len(node.entries) != 1 or node.entries[0] not in labels:
        return ""
    unit = ", ".join("1" if label == node.entries[0] else "0" for label in labels)
    return (
        f", or for all along {' and '.join(dims[:-1])} dot({node.name}, e, {dims[-1]}), where"
        f' [parameters] e = {{ dims = ["{dims[-1]}"], value = [{unit}] }}'
    )


def at_element(node: Node, indices: Mapping[str, int], shapes: Shapes) -> Node:
    """Return an expression at one element, as an expression of single elements.

    Parameters
    ----------
    node : Node
        As `resolve_min_max` returns it, with dimensions that `dims_of` checked.
    indices : mapping of str to int
        The number of the element along each of its dimensions, perhaps among others.
    shapes : Shapes

    Notes
    -----
    Sums are ascending, one addition after the other. Of `where` with a condition on numbers of elements alone stays what
    it chooses.
    """
    match node:
        case Name():
            return Name(shapes.element_at(node.name, indices), node.column) if node.name in shapes.dims else node
        case Element():
            return Name(shapes.element_at(node.name, element_numbers(node, shapes)), node.column)
        case Negative():
            return replace(node, operand=at_element(node.operand, indices, shapes))
        case Binary():
            first, links = chain(node)
            tree = at_element(first, indices, shapes)
            for link in links:
                tree = Binary(link.operator, tree, at_element(link.right, indices, shapes), link.column)
            return tree
        case Compare():
            return replace(
                node, left=at_element(node.left, indices, shapes), right=at_element(node.right, indices, shapes)
            )
        case Call():
            if node.function == "where" and not free_names(condition := at_element(node.arguments[0], indices, shapes)):
                return at_element(node.arguments[1 if evaluate(condition, {}) else 2], indices, shapes)
            return replace(node, arguments=tuple(at_element(argument, indices, shapes) for argument in node.arguments))
        case Along():
            return _at_along(node, indices, shapes)
    return node


def _at_along(node: Along, indices: Mapping[str, int], shapes: Shapes) -> Node:
    match node.function:
        case "index":
            return Number(float(indices[node.dims[0]]), node.column)
        case "size":
            return Number(float(shapes.extent(node.dims[0]).size), node.column)
        case "first" | "second":
            relation = shapes.relations[node.dims[0]]
            dim, number = relation.end(node.function, indices[relation.name])
            return at_element(node.arguments[0], {**indices, dim: number}, shapes)
        case "shift" | "roll":
            return _shifted_element(node, indices, shapes)
        case "take":
            computed_number = evaluate(at_element(node.arguments[1], indices, shapes), {})
            number = int(whole_numbers(node, computed_number, shapes))
            return at_element(node.arguments[0], {**indices, node.dims[0]: number}, shapes)
        case "cross":
            return _cross_product_element(node, indices, shapes)
        case "onto":
            return _link_sum_at_end(node, indices, shapes)
    return _reduced_element(node, indices, shapes)


def _shifted_element(node: Along, indices: Mapping[str, int], shapes: Shapes) -> Node:
    """Return the value some places before."""
    dim, size = node.dims[0], shapes.extent(node.dims[0]).size
    number = indices[dim] - node.places
    if node.function == "shift" and not 0 <= number < size:
        return at_element(node.arguments[1], indices, shapes)
    return at_element(node.arguments[0], {**indices, dim: number % size}, shapes)


def _cross_product_element(node: Along, indices: Mapping[str, int], shapes: Shapes) -> Node:
    """Return an element of a cross product."""
    dim = node.dims[0]
    next_, last = (indices[dim] + 1) % OF_CROSS, (indices[dim] + 2) % OF_CROSS
    a, b = node.arguments
    plus, minus = (
        Binary("*", at_element(a, {**indices, dim: i}, shapes), at_element(b, {**indices, dim: j}, shapes))
        for i, j in ((next_, last), (last, next_))
    )
    return Binary("-", plus, minus)


def _link_sum_at_end(node: Along, indices: Mapping[str, int], shapes: Shapes) -> Node:
    """Return the sum of link values at an element, in the order of links."""
    relation, element = shapes.relations[node.dims[0]], indices[end_dimension(node, shapes)]
    ends = [
        (argument, links.get(element, ()))
        for argument, links in zip(node.arguments, relation.links_at_elements, strict=True)
    ]
    terms = sorted(
        (link, end) for end, (end_argument, links) in enumerate(ends) if end_argument != ZERO for link in links
    )
    return sum_terms([at_element(node.arguments[end], {**indices, relation.name: link}, shapes) for link, end in terms])


def _reduced_element(node: Along, indices: Mapping[str, int], shapes: Shapes) -> Node:
    """Return a value reduced along dimensions, the last of them fastest."""
    reduced_indices = [{**indices, **inner} for inner in shapes.index_combinations(node.dims)]
    terms = [tuple(at_element(argument, inner, shapes) for argument in node.arguments) for inner in reduced_indices]
    match node.function:
        case "min" | "max":
            return Call(node.function, tuple(term for (term,) in terms)) if len(terms) > 1 else terms[0][0]
        case "dot":
            return sum_terms([Binary("*", a, b) for a, b in terms])
        case "norm":
            return Call("sqrt", (sum_terms([Binary("**", term, Number(2.0)) for (term,) in terms]),))
        case "mean":
            return Binary("/", sum_terms([term for (term,) in terms]), Number(float(len(terms))))
    return sum_terms([term for (term,) in terms])


def sum_terms(terms: list[Node]) -> Node:
    """Add terms, ascending; none are zero."""
    return reduce(lambda left, right: Binary("+", left, right), terms) if terms else ZERO


class Parts:
    """The distinct parts of expressions, each numbered after those that it is made of, with their dimensions."""

    def __init__(self, shapes: Shapes) -> None:
        self.nodes: list[Node] = []
        self.operands: list[tuple[int, ...]] = []
        self.dims: list[Set[str]] = []
        self.shapes = shapes
        self._number_by_key: dict[Any, int] = {}
        self._seen: dict[int, tuple[int, Node]] = {}  # numbers of nodes, which live as long as this

    def number(self, node: Node) -> int:
        """Return the number of an expression, after entering its parts."""
        waiting: list[Binary] = []
        while isinstance(node, Binary) and id(node) not in self._seen:  # a sum may have any length
            waiting.append(node)
            node = node.left
        number = self._seen[id(node)][0] if id(node) in self._seen else self._enter_part(node, children(node))
        for link in reversed(waiting):
            number = self._enter_part(link, (link.right,), number)
        return number

    def _enter_part(self, node: Node, inner: Iterable[Node], *left_operands: int) -> int:
        operands = (*left_operands, *map(self.number, inner))
        key = (_heading(node), operands)
        if key not in self._number_by_key:
            self._number_by_key[key] = len(self.nodes)
            self.nodes.append(node)
            self.operands.append(operands)
            self.dims.append(self._node_dims(node, [self.dims[operand] for operand in operands]))
        self._seen[id(node)] = self._number_by_key[key], node
        return self._number_by_key[key]

    def _node_dims(self, node: Node, inner: list[Set[str]]) -> Set[str]:
        if isinstance(node, Along):
            return dims_along(node, inner, self.shapes)
        return set(self.shapes.dims.get(node.name, ())) if isinstance(node, Name) else set[str]().union(*inner)

    def depending(self, names: Collection[str]) -> list[bool]:
        """Return of every part whether it depends on some names."""
        dependent: list[bool] = []
        for node, operands in zip(self.nodes, self.operands, strict=True):
            is_named = isinstance(node, Name | Element) and node.name in names
            dependent.append(
                is_named or (not isinstance(node, Compare) and any(dependent[operand] for operand in operands))
            )
        return dependent

    def dims_of_node(self, node: Node) -> Set[str]:
        """Return the dimensions of an expression."""
        return self.dims[self.number(node)]


def _heading(node: Node) -> object:
    """Return the key that distinguishes a node from others with equal operands."""
    match node:
        case Number():
            return repr(node.value)
        case Name():
            return Name, node.name
        case Element():
            return Element, node.name, node.entries
        case Binary() | Compare():
            return type(node), node.operator
        case Call():
            return Call, node.function
        case Along():
            return node.function, node.dims, node.places
    return type(node)
