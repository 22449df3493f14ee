"""Dimensions with their labels, relations with their links, and the dimensions of each name.

The argument of `take` is an expression of `index`, `size` and numbers: the element numbers that it gives are known
before a march.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from itertools import product
from math import prod
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, shortened_text
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError, display_text, first_names, internal_text
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.naming import DOT, join_element_name, split_element_name

_NUMBER = re.compile(r"-?[0-9]{1,12}")
_ELEMENT = re.compile(r"(\w+)\[([^\[\]]*)\]")  # as people write it, with whatever between its brackets
_COMPARED = 1000  # labels among which a like one is looked for
T = TypeVar("T")


@dataclass(frozen=True)
class Extent:
    """A dimension: the number of its elements, and their labels.

    Attributes
    ----------
    name : str
    size : int
    labels : tuple of str
        One for each element; empty if elements are numbered.
    """

    name: str
    size: int
    labels: tuple[str, ...] = ()

    def label(self, number: int) -> str:
        """Return the label of an element, or its number."""
        return self.labels[number] if self.labels else str(number)

    def number(self, entry: str | int) -> int:
        """Return the number of the element with a label or a number; a negative one counts from the end.

        Raises
        ------
        InputError
            If there is no such element.
        """
        if isinstance(entry, str) and entry in self._number_by_label:
            return self._number_by_label[entry]
        if isinstance(entry, int) and -self.size <= entry < self.size:
            return entry % self.size
        available_text = (
            f"the labels {first_names(self.labels)}" if self.labels else f"the elements 0 to {self.size - 1}"
        )
        close_labels = get_close_matches(str(entry), self.labels[:_COMPARED], n=1)
        meant = f"; did you mean {close_labels[0]}?" if close_labels else ""
        raise InputError(f"dimension '{self.name}' has no element {entry}; it has {available_text}{meant}")

    def number_of(self, label: str) -> int:
        """Return the number of the element that a text names: by its label, or by a number as `number` takes it.

        Raises
        ------
        InputError
            If there is no such element.
        """
        number = self.number_of_label(label)
        return self.number(int(label) if _NUMBER.fullmatch(label) else label) if number is None else number

    def number_of_label(self, label: str) -> int | None:
        """Return the number of the element that has a label, or its number as one; None if there is none."""
        if self.labels:
            return self._number_by_label.get(label)
        number = int(label) if label.isdecimal() and label.isascii() else self.size
        return number if number < self.size and str(number) == label else None

    @cached_property
    def _number_by_label(self) -> dict[str, int]:
        return {label: number for number, label in enumerate(self.labels)}


@dataclass(frozen=True, eq=False)
class Relation:
    """Links between elements of one dimension, or from one dimension to another.

    Attributes
    ----------
    name : str
    source, target : str
        The dimensions of first and second ends; the same one where elements are related among themselves.
    first, second : ndarray of int64, shape (links,)
        The elements at the ends of every link.
    of_every_two : bool
        Whether every two elements are linked once, in their order, as is known when links are made so.
    """

    name: str
    source: str
    target: str
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    of_every_two: bool = False

    @property
    def size(self) -> int:
        """How many links there are."""
        return len(self.first)

    @cached_property
    def extent(self) -> Extent:
        """The relation as a dimension, whose elements are its links."""
        return Extent(self.name, self.size)

    @cached_property
    def is_of_every_two(self) -> bool:
        """Whether every two elements of a dimension are linked once, in their order."""
        n = round((1 + math.sqrt(1 + 8 * self.size)) / 2)
        if self.source != self.target or n * (n - 1) // 2 != self.size or n < 3:
            return False
        if self.of_every_two:
            return True
        first, second = every_two(n)
        return bool((self.first == first).all() and (self.second == second).all())

    @cached_property
    def links_at_elements(self) -> tuple[dict[int, list[int]], dict[int, list[int]]]:
        """The links that begin, and those that end, at each element that has some."""
        ends: tuple[dict[int, list[int]], dict[int, list[int]]] = {}, {}
        for links, numbers in zip(ends, (self.first, self.second), strict=True):
            for link, number in enumerate(numbers.tolist()):
                links.setdefault(number, []).append(link)
        return ends

    def end(self, function: str, link: int) -> tuple[str, int]:
        """Return dimension and element of the `first` or `second` end of a link."""
        if function == "first":
            return self.source, int(self.first[link])
        return self.target, int(self.second[link])


@dataclass(frozen=True, eq=False)
class Shapes:
    """The dimensions and relations of a model, and the dimensions of its names.

    Attributes
    ----------
    extents : mapping of str to Extent
        In the order in which they are declared.
    relations : mapping of str to Relation
    dims : mapping of str to tuple of str
        Of every name that has some: coordinates, velocities, states, parameters, definitions, ….
    """

    extents: Mapping[str, Extent] = field(default_factory=dict)
    relations: Mapping[str, Relation] = field(default_factory=dict)
    dims: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def extent(self, dim: str) -> Extent:
        """Return a dimension, or a relation as one.

        Raises
        ------
        InputError
            If there is none of that name.
        """
        if dim in self.extents:
            return self.extents[dim]
        if dim in self.relations:
            return self.relations[dim].extent
        available_names = first_names((*self.relations, *self.extents))
        raise InputError(
            f"'{dim}' is no dimension or relation{f'; there are {available_names}' if available_names else ''}"
        )

    def ordered(self, dims: set[str]) -> tuple[str, ...]:
        """Return dimensions in the order of a record: relations first, each as declared."""
        return tuple(dim for dim in (*self.relations, *self.extents) if dim in dims)

    def shape(self, dims: tuple[str, ...]) -> tuple[int, ...]:
        """Return the lengths of dimensions."""
        return tuple(self.extent(dim).size for dim in dims)

    def index_combinations(self, dims: tuple[str, ...]) -> Iterator[dict[str, int]]:
        """Yield the numbers of every element by dimension, the last dimension fastest."""
        for numbers in product(*map(range, self.shape(dims))):
            yield dict(zip(dims, numbers, strict=True))

    def element_at(self, name: str, indices: Mapping[str, int], dims: tuple[str, ...] | None = None) -> str:
        """Return the name of a quantity's element at indices that include its dimensions."""
        element_dims = self.dims.get(name, ()) if dims is None else dims
        return join_element_name(name, (self.extent(dim).label(indices[dim]) for dim in element_dims))

    def parse_element(self, name: str) -> tuple[str, dict[str, int]]:
        """Return the quantity and the indices of an element as people write it; no indices for a quantity.

        Raises
        ------
        InputError
            If there is no such element.
        """
        quantity, labels = split_element_name(self.internal_name(name))
        dims = self.dims.get(quantity, ()) if labels else ()
        if labels and not dims:
            raise InputError(f"'{name}': '{quantity}' has no dimensions, and therefore no elements")
        return quantity, dict(zip(dims, numbers_of_labels(quantity, labels, [*map(self.extent, dims)]), strict=True))

    def dims_at_end(self, name: str, count: int) -> tuple[str, ...]:
        """Return the dimensions of a name in a record, like ``error_v_u``: of the longest name at its end that has so many."""
        words = name.split("_")
        ends = ("_".join(words[first:]) for first in range(len(words)))
        of_ends = (self.dims.get(end, ()) for end in ends)
        return next((dims for dims in of_ends if len(dims) == count), ())

    def internal_name(self, name: str, where: str = "") -> str:
        """Return a name as it is named inside: an element by its labels, of which any may be given as a number.

        Numbers from -1 down count from the end, as in ``u[-1]``. What names no element of a quantity with dimensions stays
        as it is, for the caller to refuse.

        Parameters
        ----------
        name : str
        where : str
            Words before the name in the message of what is not there, as ``atol names``.

        Raises
        ------
        InputError
            If a dimension has no such element, or there is not one entry for each.

        Examples
        --------
        >>> shapes = Shapes({"site": Extent("site", 9)}, {}, {"u": ("site",)})
        >>> [shapes.internal_name(name) for name in ("u[-1]", "maximum_v_u[3]", "u", "k")]
        ['u·8', 'maximum_v_u·3', 'u', 'k']
        """
        if not isinstance(name, str):
            return name
        match = _ELEMENT.fullmatch(name)
        if match is None:
            return internal_text(name)
        labels = [label.strip() for label in match[2].split(",")] if match[2].strip() else []
        dims = self.dims_at_end(match[1], len(labels))
        if not (dims := dims or self.dims.get(match[1], ())):
            return internal_text(name)
        extents = [self.extent(dim) for dim in dims]
        try:
            numbers = numbers_of_labels(match[1], labels, extents)
        except InputError as error:
            raise InputError(f"{where} '{name}': {error}".lstrip()) from None
        return join_element_name(
            match[1], (extent.label(number) for extent, number in zip(extents, numbers, strict=True))
        )

    def with_internal_names(self, entries: Mapping[str, T], where: str) -> dict[str, T]:
        """Return entries by names as they are named inside.

        Raises
        ------
        InputError
            If a dimension has no such element, or two names are those of one.
        """
        internal_entries: dict[str, T] = {}
        for name, entry in entries.items():
            internal_name = self.internal_name(name, where)
            if internal_name in internal_entries:
                raise InputError(f"{where} '{display_text(internal_name)}' twice; give it one value")
            internal_entries[internal_name] = entry
        return internal_entries

    def first(self, name: str) -> str:
        """Return the name of the first element of a quantity."""
        return self.element_at(name, dict.fromkeys(self.dims.get(name, ()), 0))

    def elements(self, name: str, dims: tuple[str, ...] | None = None) -> list[str]:
        """Return the names of all elements of a quantity, the last dimension fastest."""
        element_dims = self.dims.get(name, ()) if dims is None else dims
        return [*element_names(name, tuple(map(self.extent, element_dims)))]


def every_two(n: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the ends of links between every two of n elements, of each with those after it, shape (n (n - 1)/2,).

    Examples
    --------
    >>> every_two(3)
    (array([0, 0, 1]), array([1, 2, 2]))
    """
    behind = np.arange(n - 1, -1, -1)  # of how many elements each is the first
    begins = np.cumsum(behind) - behind  # its links
    first = np.repeat(np.arange(n), behind)
    return first, np.arange(first.size) - np.repeat(begins - np.arange(1, n + 1), behind)


def element_name(name: str, number: int, extents: tuple[Extent, ...]) -> str:
    """Return the name of an element by its number, the last dimension fastest.

    Examples
    --------
    >>> element_name("r", 3, (Extent("body", 2), Extent("axis", 2, ("x", "y"))))
    'r·1·y'
    """
    labels = []
    for extent in reversed(extents):
        number, position = divmod(number, extent.size)
        labels.append(extent.label(position))
    return join_element_name(name, reversed(labels))


def element_names(name: str, extents: tuple[Extent, ...]) -> Iterator[str]:
    """Yield the names of all elements, the last dimension fastest."""
    labels = [extent.labels or [*map(str, range(extent.size))] for extent in extents]
    return map(DOT.join, product((name,), *labels))


def indices_of_element(name: str, extents: tuple[Extent, ...]) -> tuple[int, ...] | None:
    """Return the numbers along each dimension of the element that has a name; None if there is none."""
    labels = split_element_name(name)[1]
    if len(labels) != len(extents):
        return None
    numbers = tuple(extent.number_of_label(label) for extent, label in zip(extents, labels, strict=True))
    return None if None in numbers else numbers  # type: ignore[return-value]


def numbers_of_labels(quantity: str, labels: Sequence[str], extents: Sequence[Extent]) -> list[int]:
    """Return the indices of an element along its dimensions from labels, or from numbers in their stead.

    Raises
    ------
    InputError
        If there is not one entry for each dimension, or a dimension has no such element.
    """
    if len(labels) != len(extents):
        dims = ", ".join(extent.name for extent in extents)
        raise InputError(
            f"'{quantity}' needs an entry for each of its dimensions, {dims}, and {len(labels)} were given"
        )
    return [extent.number_of(label) for extent, label in zip(extents, labels, strict=True)]


def number_of_element(name: str, extents: tuple[Extent, ...]) -> int | None:
    """Return the number of the element that has a name, the last dimension fastest; None if there is none."""
    element_indices = indices_of_element(name, extents)
    if element_indices is None:
        return None
    number = 0
    for extent, index in zip(extents, element_indices, strict=True):
        number = number * extent.size + index
    return number


NO_SHAPES = Shapes()  # of a model without dimensions


IntArray = NDArray[np.int64]
MOST_CHECKED = (
    100_000  # numbers that are computed to check an expression; those of more are checked where they are used
)


def is_of_numbers(node: Node) -> bool:
    """Whether an expression is made of `index`, `size` and numbers alone."""
    return not any(
        isinstance(part, Name | Element) or (isinstance(part, Along) and part.function not in ("index", "size"))
        for part in every(node)
    )


def check_number_of_element(node: Along, dims: tuple[str, ...], shapes: Shapes) -> None:
    """Refuse the number of an element that changes along a motion, or is none of an element.

    Parameters
    ----------
    node : Along
        A `take`.
    dims : tuple of str
        Of the number.
    shapes : Shapes

    Raises
    ------
    InputError
        If it reads a quantity, or is beyond the last element.
    """
    if not is_of_numbers(number := node.arguments[1]):
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}): the number of the element is '{shortened_text(number)}', which may be"
            " written with index(dimension), size(dimension) and numbers alone"
        )
    shape = shapes.shape(dims)
    if prod(shape) <= MOST_CHECKED:
        taken_numbers(node, dict(zip(dims, np.ix_(*map(np.arange, shape)), strict=True)), shapes)


def with_index_names(node: Node, shapes: Shapes) -> Node:
    """Return an expression in which numbers of elements are names: ``index site``."""
    match node:
        case Along(function="index"):
            return Name(f"index {node.dims[0]}")
        case Along():
            return Number(float(shapes.extent(node.dims[0]).size))
        case Negative():
            return replace(node, operand=with_index_names(node.operand, shapes))
        case Binary() | Compare():
            return replace(node, left=with_index_names(node.left, shapes), right=with_index_names(node.right, shapes))
        case Call():
            return replace(node, arguments=tuple(with_index_names(argument, shapes) for argument in node.arguments))
    return node


def taken_numbers(node: Along, grid: Mapping[str, Any], shapes: Shapes) -> IntArray:
    """Return which elements `take` takes where the number along each dimension is known.

    Parameters
    ----------
    node : Along
        A `take`.
    grid : mapping of str to ndarray of int64
        Arrays that broadcast together.
    shapes : Shapes

    Raises
    ------
    InputError
        If a number is none of an element.
    """
    values = {f"index {dim}": np.asarray(numbers, float) for dim, numbers in grid.items()}
    return whole_numbers(node, evaluate_many(with_index_names(node.arguments[1], shapes), values), shapes)


def whole_numbers(node: Along, computed_numbers: Any, shapes: Shapes) -> IntArray:
    """Return computed element numbers as integers, refused unless they are whole and within the dimension.

    Raises
    ------
    InputError
        If one is none of an element.
    """
    numbers, size = np.asarray(computed_numbers, float), shapes.extent(node.dims[0]).size
    wrong = ~((numbers >= 0.0) & (numbers < size) & (numbers == np.floor(numbers)))
    if wrong.any():
        raise InputError(
            f"'{shortened_text(node)}' (column {node.column}) takes element {float(numbers[wrong].flat[0]):g} of '{node.dims[0]}',"
            f" needs whole numbers from 0 to {size - 1}; mod(number, size({node.dims[0]})) goes round"
        )
    return numbers.astype(np.int64)
