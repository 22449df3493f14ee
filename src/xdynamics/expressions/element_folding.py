"""Expressions of many elements that differ in numbers alone, folded into one expression of the element's number.

A function that is written with arrays makes an expression of each element. Elements of one family have equal trees but
for numbers and for the elements that they read. Both become tables along a dimension, and tables become parameters and
``take(y, y_index, 3*index(terms) + 1)``. Sums and extremes are folded as soon as they are made, so that all pairs of
bodies are as many small trees and never one large tree.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.tree import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, children
from xdynamics.faults import InputError

FEWEST_TERMS = 4  # of a sum that is folded; fewer are written one after the other
FEW_FAMILIES = 4  # of elements, before a tree is looked for that all are cases of
MOST_FAMILIES = 64  # of elements whose trees differ; each has an expression that every element computes
MOST_INTERVALS = 8  # of elements of one family, that are told apart by their numbers
_TERMS = "terms"  # the dimensions of sums: terms_54_0 of 54 terms, whose own sums are along none

Table = NDArray[Any]


class IrregularError(InputError):
    """Elements whose expressions differ in more than numbers."""


@dataclass(frozen=True, eq=False)
class _ValueTable:
    """A table of numbers, or of a quantity's elements, that replaces a node which differs between elements.

    Attributes
    ----------
    values : ndarray
        An axis for each dimension.
    dims : tuple of str
    name : str
        Of the quantity whose elements these are; without one they are numbers.
    positions : tuple of int
        Which elements of the last dimension are meant, if not all.
    """

    values: Table
    dims: tuple[str, ...]
    name: str = ""
    positions: tuple[int, ...] = ()
    key: tuple[Any, ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", np.asarray(self.values))
        # arrays compare element by element and have no hash; bytes have one answer for both
        content = (self.values.tobytes(), self.values.shape, self.dims, self.name, self.positions)
        object.__setattr__(self, "key", content)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _ValueTable) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)


def folded_terms(function: str, terms: Sequence[Node]) -> Node | None:
    """Return a sum, or an extreme, of terms as one along a dimension; None where their trees differ, or they are few."""
    if len(terms) < FEWEST_TERMS:
        return None
    dim = f"{_TERMS}_{len(terms)}_{1 + max(_sum_depth(terms[0]), _sum_depth(terms[-1]))}"
    try:
        term = _merge_trees(terms, dim, (), {})
        tables = [table for table in _tables(term) if dim in table.dims]
        for table in tables:
            if table.name:  # of which elements follow no rule, the sum is written out
                _sequence(table.values[(0,) * (table.values.ndim - 1)], np.arange(len(terms)), len(terms))
    except IrregularError:
        return None
    reads_elements = any(table.name for table in tables)  # names are not folded: each is a quantity of its own
    return Along(function, (term,), (dim,)) if reads_elements else None


def _distinct_parts(node: Any) -> Iterator[Any]:
    # by identity: trees share their parts, and to hash one is to descend it
    seen, waiting = set[int](), [node]
    while waiting:
        part = waiting.pop()
        if id(part) not in seen:
            seen.add(id(part))
            yield part
            waiting += children(part)


def _tables(node: Any) -> list[_ValueTable]:
    return [part for part in _distinct_parts(node) if isinstance(part, _ValueTable)]


def _sum_depth(node: Node) -> int:
    """Return the greatest depth among the sums of a tree; -1 without one."""
    sums = (part for part in _distinct_parts(node) if isinstance(part, Along) and part.dims)
    return max((int(part.dims[0].rpartition("_")[2]) for part in sums if term_count(part.dims[0])), default=-1)


def term_count(dim: str) -> int:
    """Return how many terms the dimension of a sum has; 0 of another dimension."""
    return int(dim.split("_")[1]) if dim.startswith(f"{_TERMS}_") else 0


Known = dict[tuple[int, ...], Any]


def _merge_trees(nodes: Sequence[Any], dim: str, positions: tuple[int, ...], merged_by_id: Known) -> Any:
    """Return the tree of which others are cases, with tables along a dimension where they differ.

    Raises
    ------
    IrregularError
        If they differ in more than numbers.
    """
    first = nodes[0]
    if all(node is first for node in nodes):
        return first
    key = tuple(map(id, nodes))
    if key not in merged_by_id:  # with the nodes, which live as long: an id is free for another one afterwards
        merged_by_id[key] = nodes, _merge_different(nodes, dim, positions, merged_by_id)
    return merged_by_id[key][1]


def _merge_different(nodes: Sequence[Any], dim: str, positions: tuple[int, ...], merged_by_id: Known) -> Any:
    kinds = {type(node) for node in nodes}
    if kinds == {Element} and len({node.name for node in nodes}) == 1:
        return _table_of_row([node.entries[0] for node in nodes], np.int64, dim, nodes[0].name, positions)
    if kinds == {Number}:
        return _table_of_row([node.value for node in nodes], float, dim, "", positions)
    if all(_is_numeric(node) for node in nodes):
        return _stack_tables([_numbers_of(node) for node in nodes], dim, "", positions)
    words = ("operator", "function", "dims")
    is_uniform = len(kinds) == 1 and all(len({getattr(node, word, None) for node in nodes}) == 1 for word in words)
    model = nodes[0] if is_uniform else max((node for node in nodes if not _is_numeric(node)), key=_rank)
    if isinstance(model, Element) or (isinstance(model, _ValueTable) and model.name):
        return _merged_elements(nodes, model.name, dim, positions)
    same_form = nodes if is_uniform else [_in_form_of(node, model) for node in nodes]

    def part(take: Callable[[Any], Any]) -> Any:
        return _merge_trees([take(node) for node in same_form], dim, positions, merged_by_id)

    match model:
        case Name():
            if all(node == model for node in nodes):
                return model
        case Negative():
            return Negative(part(lambda node: node.operand))
        case Binary() | Compare():
            return type(model)(model.operator, part(lambda node: node.left), part(lambda node: node.right))
        case Call() | Along():
            columns = zip(*(node.arguments for node in same_form), strict=True)
            arguments = tuple(_merge_trees(column, dim, positions, merged_by_id) for column in columns)
            return replace(model, arguments=arguments)
    raise IrregularError("elements have expressions that differ in more than numbers")


def _table_of_row(values: list[Any], dtype: Any, dim: str, name: str, positions: tuple[int, ...]) -> _ValueTable:
    array = np.array(values, dtype)
    is_one = (array == array[0]).all()
    return _ValueTable(array[0], (), name) if is_one else _ValueTable(array, (dim,), name, positions)


def _rank(node: Any) -> int:
    """Return which of several trees others can be written like: a sum before a product, a product before one factor."""
    return (isinstance(node, Binary) and {"+": 3, "*": 2}.get(node.operator, 1)) or int(bool(children(node)))


def _is_numeric(node: Any) -> bool:
    return (
        isinstance(node, Number)
        or (isinstance(node, Negative) and isinstance(node.operand, Number))
        or (isinstance(node, _ValueTable) and not node.name)
    )


def _numbers_of(node: Any) -> _ValueTable:
    if isinstance(node, _ValueTable):
        return node
    value: float = -node.operand.value if isinstance(node, Negative) else node.value  # type: ignore[union-attr]
    return _ValueTable(np.asarray(value, float), ())


_FREE_ELEMENT = Element("", ())  # an element that is multiplied by zero: whichever


def _merged_elements(nodes: Sequence[Any], name: str, dim: str, positions: tuple[int, ...]) -> _ValueTable:
    tables: list[_ValueTable | None] = []
    for node in nodes:
        if node is _FREE_ELEMENT:
            tables.append(None)
        elif isinstance(node, Element) and node.name == name:
            tables.append(_ValueTable(np.asarray(node.entries[0], np.int64), (), name))
        elif isinstance(node, _ValueTable) and node.name == name:
            tables.append(node)
        else:
            raise IrregularError("elements are joined with expressions of others")
    if None in tables:
        tables = _fill_free_elements(tables, name)
    return _stack_tables(tables, dim, name, positions)  # type: ignore[arg-type]


def _fill_free_elements(tables: list[_ValueTable | None], name: str) -> list[_ValueTable | None]:
    """Return tables with elements that do not matter as they go on evenly from those that do."""
    places = [k for k, table in enumerate(tables) if table is not None]
    known = [tables[k] for k in places]
    if any(table is None or table.dims for table in known):
        return [known[0] if table is None else table for table in tables]
    values = [int(table.values) for table in known if table is not None]
    slope = (values[1] - values[0]) // (places[1] - places[0]) if len(places) > 1 else 0
    return [
        _ValueTable(np.asarray(values[0] + slope * (k - places[0]), np.int64), (), name) if table is None else table
        for k, table in enumerate(tables)
    ]


def _stack_tables(tables: Sequence[_ValueTable], dim: str, name: str, positions: tuple[int, ...]) -> _ValueTable:
    """Return tables as one with a further dimension, if they differ."""
    longest = max((table.dims for table in tables), key=len)
    if all(table == tables[0] for table in tables):
        return tables[0]
    model = next(table for table in tables if table.dims == longest)
    rows = []
    for table in tables:
        if not {*table.dims} <= {*longest} or list(table.dims) != [
            dim_name for dim_name in longest if dim_name in table.dims
        ]:
            raise IrregularError("elements are sums along different dimensions")
        shape = tuple(
            size if dim_name in table.dims else 1 for dim_name, size in zip(longest, model.values.shape, strict=True)
        )
        rows.append(np.broadcast_to(table.values.reshape(shape), model.values.shape))
    return _ValueTable(np.stack(rows, -1), (*longest, dim), name, positions)


def _in_form_of(node: Any, model: Any) -> Any:
    """Return a tree in the form of another one: a product that was left out because a factor is 0 or 1, say."""
    words = ("operator", "function", "dims")
    if type(node) is type(model) and all(getattr(node, word, None) == getattr(model, word, None) for word in words):
        return node
    if isinstance(model, Binary) and model.operator in "*+":
        is_sum, number_first = model.operator == "+", _is_numeric(model.left)
        number = float(_numbers_of(node).values) if _is_numeric(node) and not _numbers_of(node).dims else None
        second_factor = model.right if number_first else model.left
        sides = (Number(0.0), node) if is_sum and number is not None else (node, Number(0.0 if is_sum else 1.0))
        if number == 0.0 and not is_sum:
            reads_one = isinstance(second_factor, Element) or (
                isinstance(second_factor, _ValueTable) and second_factor.name
            )
            sides = (_FREE_ELEMENT if reads_one else second_factor, Number(0.0))
        return Binary(model.operator, *(sides[::-1] if number_first else sides))
    raise IrregularError("elements have expressions that differ in more than numbers")


def _families(nodes: Sequence[Node]) -> list[list[int]]:
    """Return elements by the shapes of their trees, which are alike but for numbers and for which elements they read."""
    shapes: dict[Any, int] = {}
    shape_numbers: dict[int, int] = {}

    def tree_shape(node: Any) -> int:
        if id(node) not in shape_numbers:
            if _is_numeric(node):
                content: tuple[Any, ...] = ("number",)
            elif isinstance(node, Element | _ValueTable):
                content = ("element", node.name)
            else:
                words = [getattr(node, word, None) for word in ("operator", "function", "dims", "name")]
                content = (type(node).__name__, *words, *map(tree_shape, children(node)))
            shape_numbers[id(node)] = shapes.setdefault(content, len(shapes))
        return shape_numbers[id(node)]

    members: dict[int, list[int]] = {}
    for k, node in enumerate(nodes):
        members.setdefault(tree_shape(node), []).append(k)
    return [*members.values()]


class Unfolding:
    """Tables of numbers and elements in a model's terms: parameters, and elements by number.

    Parameters
    ----------
    name : str
        The quantity whose elements are read, along ``<name>_index``.
    size : int

    Attributes
    ----------
    parameters : dict of str to (dims, ndarray)
    """

    def __init__(self, name: str, size: int) -> None:
        self.name, self.dim, self.size = name, f"{name}_index", size
        self.parameters: dict[str, tuple[tuple[str, ...], Table]] = {}

    def of_elements(self, nodes: Sequence[Node]) -> Node:
        """Return one expression of all elements: of each family its own, chosen by the element's number.

        Raises
        ------
        IrregularError
            If there are very many families, or which elements one reads follows no rule.
        """
        groups = _families(nodes)
        if len(groups) > FEW_FAMILIES:
            try:
                return self._of_groups(nodes, [[*range(len(nodes))]], FEW_FAMILIES)
            except IrregularError:
                pass
        return self._of_groups(nodes, groups, MOST_FAMILIES)

    def _of_groups(self, nodes: Sequence[Node], groups: list[list[int]], max_families: int) -> Node:
        families: list[tuple[Node, list[int]]] = []
        waiting = [*groups]
        while waiting:
            if len(families) + len(waiting) > max_families:
                raise IrregularError(
                    f"elements are of over {max_families} families, whose expressions differ in more than numbers"
                )
            members = waiting.pop(0)
            positions = () if len(members) == len(nodes) else tuple(members)
            tree = _merge_trees([nodes[k] for k in members], self.dim, positions, {})
            odd = [table for table in _tables(tree) if self.dim in table.dims and not self._follows_a_rule(table)]
            if odd:
                waiting += self._by_neighbours(odd, members)
            else:
                families.append((tree, members))
        return self._chosen([(self.of(tree), members) for tree, members in families])

    def _follows_a_rule(self, table: _ValueTable) -> bool:
        try:
            self._elements(table, ()) if table.name else None
        except IrregularError:
            return False
        return True

    def _by_neighbours(self, tables: list[_ValueTable], members: list[int]) -> list[list[int]]:
        """Return elements by where those are that they read, seen from each."""
        groups: dict[Any, list[int]] = {}
        for column, k in enumerate(members):
            groups.setdefault(tuple((table.values[..., column] - k).tobytes() for table in tables), []).append(k)
        if len(groups) == 1:
            raise IrregularError("which elements are read follows no rule of numbers along axes")
        return [*groups.values()]

    def _chosen(self, families: list[tuple[Node, list[int]]]) -> Node:
        kinds = np.zeros(self.size, np.int64)
        for number, (_, members) in enumerate(families):
            kinds[members] = number
        trees = [tree for tree, _ in families]
        begins = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist()]
        if len(begins) <= MOST_INTERVALS:
            return self._by_intervals(trees, kinds, begins)
        kind = self.of(_ValueTable(kinds.astype(float), (self.dim,)))
        tree = trees[-1]
        for number in range(len(trees) - 2, -1, -1):
            tree = Call("where", (Compare("<", kind, Number(number + 0.5)), trees[number], tree))
        return tree

    def _by_intervals(self, trees: list[Node], kinds: NDArray[np.int64], begins: list[int]) -> Node:
        tree: Node = trees[kinds[begins[-1]]]
        for begin, next_begin in reversed([*pairwise(begins)]):
            is_earlier = Compare("<", Along("index", (), (self.dim,)), Number(float(next_begin)))
            tree = Call("where", (is_earlier, trees[kinds[begin]], tree))
        return tree

    def of(self, node: Any, same: tuple[str, ...] = ()) -> Node:
        """Return a tree without tables; sums of `same` dimensions are along that of the quantity."""
        return self._of(node, same, {})

    def _of(self, node: Any, same: tuple[str, ...], unfolded_by_id: dict[int, Node]) -> Node:
        if id(node) not in unfolded_by_id:
            unfolded_by_id[id(node)] = self._unfolded(node, same, unfolded_by_id)
        return unfolded_by_id[id(node)]

    def _unfolded(self, node: Any, same: tuple[str, ...], unfolded_by_id: dict[int, Node]) -> Node:
        match node:
            case _ValueTable():
                return self._elements(node, same) if node.name else self._numbers(node, same)
            case Negative():
                return Negative(self._of(node.operand, same, unfolded_by_id))
            case Binary() | Compare():
                return type(node)(
                    node.operator, self._of(node.left, same, unfolded_by_id), self._of(node.right, same, unfolded_by_id)
                )
            case Call():
                return Call(node.function, tuple(self._of(part, same, unfolded_by_id) for part in node.arguments))
            case Along() if node.dims and term_count(node.dims[0]):
                dim = node.dims[0]
                if self._is_of_whole(node.arguments[0], dim):
                    return Along(node.function, (self.of(node.arguments[0], (*same, dim)),), (self.dim,))
                return Along(
                    node.function, tuple(self._of(part, same, unfolded_by_id) for part in node.arguments), node.dims
                )
        return node  # type: ignore[no-any-return]

    def _is_of_whole(self, term: Any, dim: str) -> bool:
        """Whether a sum goes over the quantity from its first element to its last, and needs no dimension of its own."""
        tables = [table for table in _tables(term) if dim in table.dims]
        read = [table for table in tables if table.name]
        outer_tables = [table for table in _tables(term) if self.dim in table.dims]
        return (
            term_count(dim) == self.size
            and bool(read)
            and not outer_tables
            and all(table.dims == (dim,) and np.array_equal(table.values, np.arange(self.size)) for table in read)
        )

    def _dims(self, dims: tuple[str, ...], same: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(self.dim if dim in same else dim for dim in dims)

    def _numbers(self, table: _ValueTable, same: tuple[str, ...]) -> Node:
        values, dims = self._full(table), table.dims
        for axis in range(values.ndim - 1, -1, -1):
            if (values == values.take([0], axis)).all():
                values, dims = values.take(0, axis), dims[:axis] + dims[axis + 1 :]
        if not dims:
            number = float(values)
            # a literal has no sign, as in parsed text: a minus is a node of its own
            return Negative(Number(-number)) if number < 0 else Number(number)
        content = (self._dims(dims, same), values)
        for word, (parameter_dims, parameter_values) in self.parameters.items():
            if parameter_dims == content[0] and np.array_equal(parameter_values, values):
                return Name(word)
        word = f"constant_{len(self.parameters)}"
        self.parameters[word] = content
        return Name(word)

    def _full(self, table: _ValueTable) -> Table:
        """Return numbers of all elements; those of others than are meant do not matter."""
        if not table.positions or self.dim not in table.dims:
            return table.values
        full = np.empty((*table.values.shape[:-1], self.size))
        full[...] = table.values[..., :1]
        full[..., list(table.positions)] = table.values
        return full

    def _elements(self, table: _ValueTable, same: tuple[str, ...]) -> Node:
        dims = self._dims(table.dims, same)
        if not dims:
            return Element(table.name, (int(table.values),))
        if dims == (self.dim,):
            positions = np.asarray(table.positions or range(self.size))
            offsets = {*(table.values - positions).tolist()}
            if offsets == {0}:
                return Name(table.name)
            if len(offsets) == 1:
                return Along("shift", (Name(table.name), Number(0.0)), (self.dim,), -offsets.pop())
        number = self._number(table, dims)
        return Along("take", (Name(table.name), number), (self.dim,))

    def _number(self, table: _ValueTable, dims: tuple[str, ...]) -> Node:
        """Return the number of an element as an expression of the numbers along dimensions: a sum of one for each.

        Raises
        ------
        IrregularError
            If there is none.
        """
        values = table.values.astype(np.int64)
        corner = int(values[(0,) * values.ndim])
        total = np.zeros_like(values)
        parts: list[Node] = []
        constant = lowest = highest = corner
        for axis, dim in enumerate(dims):
            line = np.moveaxis(values, axis, 0).reshape(values.shape[axis], -1)[:, 0] - corner
            total += line.reshape([-1 if k == axis else 1 for k in range(values.ndim)])
            is_cut = bool(table.positions) and axis == len(dims) - 1
            positions = np.asarray(table.positions) if is_cut else np.arange(len(line))
            sequence = _sequence(line, positions, self.size if dim == self.dim else len(line))
            parts += sequence.terms(Along("index", (), (dim,)))
            constant += sequence.start
            everywhere = sequence.at(np.arange(self.size if dim == self.dim else len(line)))
            lowest, highest = lowest + int(everywhere.min()), highest + int(everywhere.max())
        if not np.array_equal(total + corner, values):
            raise IrregularError("which elements are read follows no rule of numbers along axes")
        number = _sum(parts, constant)
        # elements of other families are computed too, and not chosen: theirs has to be an element, whichever
        is_inside = lowest >= 0 and highest < self.size
        return number if is_inside else Call("mod", (number, Number(float(self.size))))


@dataclass(frozen=True)
class _Sequence:
    """Integers as a constant plus multiples of functions of their position.

    Attributes
    ----------
    steps : tuple of (factor, divisor, modulus, shift)
        Each adds factor times mod(floor(position/divisor) + shift, modulus); a modulus of 0 goes on for ever.
    start : int
    """

    steps: tuple[tuple[int, int, int, int], ...]
    start: int

    def terms(self, position: Node) -> list[Node]:
        """Return the multiples as expressions."""
        terms = []
        for factor, divisor, modulus, shift in self.steps:
            node = position
            if divisor > 1:
                node = Call("floor", (Binary("/", node, Number(float(divisor))),))
            node = _sum([node], shift)
            if modulus:
                node = Call("mod", (node, Number(float(modulus))))
            terms.append(node if factor == 1 else Binary("*", Number(float(factor)), node))
        return terms

    def at(self, positions: Any) -> Any:
        """Return the numbers at positions."""
        values = np.full(positions.shape, self.start)
        for factor, divisor, modulus, shift in self.steps:
            number = positions // divisor + shift
            values = values + factor * (np.mod(number, modulus) if modulus else number)
        return values


def _sum(parts: Sequence[Node], constant: int) -> Node:
    """Return a sum of parts and of a number, which is left out if it is zero."""
    if not parts:
        return Number(float(constant))
    total = parts[0]
    for part in parts[1:]:
        total = Binary("+", total, part)
    if constant:
        total = Binary("+" if constant > 0 else "-", total, Number(float(abs(constant))))
    return total


def _sequence(values: Any, positions: Any, size: int) -> _Sequence:
    """Return integers as a function of their positions: linear, cyclic, in repeated blocks, or combined.

    Raises
    ------
    IrregularError
        If they are none of these.
    """
    if (values == values[0]).all():
        return _Sequence((), int(values[0]))
    for sequence in _candidates(values, positions, size):
        start = int(values[0] - sequence.at(positions)[0])
        fitted = _Sequence(sequence.steps, sequence.start + start)
        if np.array_equal(fitted.at(positions), values):
            return fitted
    raise IrregularError("which elements are read follows no rule of numbers along axes")


def _candidates(values: Any, positions: Any, size: int) -> Iterator[_Sequence]:
    """Yield rules that some of the numbers follow, the shortest first."""
    slope, remainder = divmod(int(values[1] - values[0]), int(positions[1] - positions[0]))
    if not remainder:
        yield _Sequence(((slope, 1, 0, 0),), 0)
    lengths = [length for length in range(2, size // 2 + 1) if size % length == 0]
    begin, n = int(positions[0]), len(positions)
    is_block = int(positions[-1]) - begin == n - 1
    for step in dict.fromkeys((slope, int(values[-1] - values[-2]))) if is_block else ():
        breaks = np.flatnonzero(np.diff(values) != step)
        if len(breaks) == 1 and step:
            yield _Sequence(((step, 1, n, n - 1 - int(breaks[0]) - begin),), 0)
    for length in lengths:
        blocks, offsets = positions // length, positions % length
        rise = _slope(values, blocks, offsets)
        if rise is None:
            continue
        steps = ((rise, length, 0, 0),) if rise else ()
        block_values = values - rise * blocks
        order = np.unique(offsets, return_index=True)[1]
        try:
            rest_of_block = _sequence(block_values[order], offsets[order], length)
        except IrregularError:
            continue
        yield _Sequence((*steps, *_repeat_in_blocks(rest_of_block.steps, length)), rest_of_block.start)


def _repeat_in_blocks(
    steps: tuple[tuple[int, int, int, int], ...], length: int
) -> tuple[tuple[int, int, int, int], ...]:
    """Return a rule of positions within blocks as a rule of all positions, which begins again in each block."""
    return tuple((factor, divisor, modulus or length // divisor, shift) for factor, divisor, modulus, shift in steps)


def _slope(values: Any, numbers: Any, fixed_numbers: Any) -> int | None:
    """Return how much values change with a number while another one stays; None if it does not change or they do not."""
    order = np.lexsort((numbers, fixed_numbers))
    same = np.flatnonzero(np.diff(fixed_numbers[order]) == 0)
    if not len(same):
        return None
    first, second = order[same[0]], order[same[0] + 1]
    slope, remainder = divmod(int(values[second] - values[first]), int(numbers[second] - numbers[first]))
    return None if remainder else slope
