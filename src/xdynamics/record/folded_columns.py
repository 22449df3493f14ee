"""Columns of elements as columns of quantities with dimensions: what a record holds is stacked as it leaves the log."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.march import LogBlock
from xdynamics.record.column import Column, LineOf
from xdynamics.record.element_attributes import attributes_of_element, attributes_of_whole
from xdynamics.record.element_names import Names, Whole
from xdynamics.record.folding import about_dimensions
from xdynamics.schema import (
    DETECTOR_DIMENSIONS,
    EVENTS,
    NOWHERE,
    Variable,
    at_event,
    flags,
)
from xdynamics.shapes import Extent, Shapes
from xdynamics.shapes.extents import number_of_element
from xdynamics.shapes.naming import DOT
from xdynamics.shapes.naming import parted as parted_name
from xdynamics.units import NUMBERS

Array = NDArray[Any]

DETECTOR = "event_detector"


def folded(columns: Sequence[Column], shapes: Shapes) -> list[Column]:
    """Make one column of the elements of each quantity."""
    if not shapes.dims:
        return [*columns]
    by_name = {column.variable.name: column for column in columns}
    wholes = Names(shapes).wholes(by_name)
    of_name = {name: whole for whole in wholes.values() for name in whole.members.values()}
    collected: dict[str, Column] = {}
    for name, column in by_name.items():
        whole = of_name.get(name)
        if whole is not None and whole.name not in collected:
            members = {number: by_name[member] for number, member in whole.members.items()}
            variables = {number: member.variable for number, member in members.items()}
            collected[whole.name] = Column(_variable(whole, variables), _take(whole, members))
        elif name == DETECTOR:
            collected |= {column.variable.name: column for column in _detector(column, shapes)}
        elif whole is None:
            collected[name] = _either(collected[name], column) if name in collected else column
    return [*collected.values()]


def parted(columns: Sequence[Column], shapes: Shapes) -> list[Column]:
    """Make columns of the elements of each quantity with dimensions, which were columns of them all."""
    collected: list[Column] = []
    for column in columns:
        own = _model_dims(column, shapes)
        collected += _elements(column, own, shapes) if own else [column]
    return collected


def _elements(column: Column, dims: tuple[str, ...], shapes: Shapes) -> Iterator[Column]:
    """Yield the columns of the elements of a quantity."""
    extents = tuple(map(shapes.extent, dims))
    for number, name in enumerate(shapes.elements(column.variable.name, dims)):
        yield _element(column, name, extents, number)


def _model_dims(column: Column, shapes: Shapes) -> tuple[str, ...]:
    return tuple(dim for dim in column.variable.dims if dim in shapes.extents or dim in shapes.relations)


def _element(column: Column, name: str, extents: tuple[Extent, ...], number: int) -> Column:
    """Return the column of one element of a quantity."""
    variable = column.variable
    more = attributes_of_element(variable.more, number, math.prod(extent.size for extent in extents))
    own = variable.dims[: len(variable.dims) - len(extents)]
    return Column(replace(variable, name=name, dims=own, more=more), _element_of(column, number))


def _element_of(column: Column, number: int) -> Callable[[LogBlock], Array]:
    """Take one element of a quantity."""
    if isinstance(column.take, LineOf):
        return column.take.element(number)

    def take(block: LogBlock) -> Array:
        values = column.take(block)
        return values.reshape(len(values), math.prod(values.shape[1:]))[:, number]  # of no row -1 would be anything

    return take


class NamedColumns(Mapping[str, Column]):
    """Columns by their names, also those of elements, which are made where they are asked for."""

    def __init__(self, columns: Iterable[Column], shapes: Shapes) -> None:
        self._columns = {column.variable.name: column for column in columns}
        self._shapes = shapes

    def __getitem__(self, name: str) -> Column:
        if name in self._columns or DOT not in name:
            return self._columns[name]
        whole = self._columns[parted_name(name)[0]]
        extents = tuple(self._shapes.extent(dim) for dim in _model_dims(whole, self._shapes))
        if (number := number_of_element(name, extents)) is None:
            raise KeyError(name)
        return _element(whole, name, extents, number)

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def folded_constants(entries: Iterable[tuple[Variable, Any]], shapes: Shapes) -> list[tuple[Variable, Any]]:
    """Make one parameter of its elements."""
    listed = [*entries]
    if not shapes.dims:
        return listed
    by_name = {variable.name: (variable, value) for variable, value in listed}
    wholes = Names(shapes).wholes(by_name)
    of_name = {name: whole for whole in wholes.values() for name in whole.members.values()}
    collected: dict[str, tuple[Variable, Any]] = {}
    for name, entry in by_name.items():
        whole = of_name.get(name)
        if whole is None:
            collected[name] = entry
        elif whole.name not in collected:
            members = {number: by_name[member] for number, member in whole.members.items()}
            variable = _variable(whole, {number: own for number, (own, _) in members.items()})
            values = {number: np.asarray(value) for number, (_, value) in members.items()}
            collected[whole.name] = variable, whole.stacked(values)
    return [*collected.values()]


def dimensions(shapes: Shapes) -> list[tuple[Variable, Any]]:
    """Return the labels of dimensions and the ends of relations."""
    dims = {*shapes.relations, *shapes.extents}
    types = {"U": "U", "i": "i4"}
    return [
        (
            Variable(
                name, own, types[values.dtype.kind], NUMBERS.text, about["long_name"], about["role"], _more(about)
            ),
            values,
        )
        for name, (own, values, about) in about_dimensions(shapes, dims).items()
    ]


def _more(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in attributes.items() if key not in ("units", "long_name", "role")}


def _variable(whole: Whole, elements: Mapping[int, Variable]) -> Variable:
    """Return the variable of a quantity from those of its elements."""
    first = next(iter(elements.values()))
    named = {number: (whole.members[number], element.attributes) for number, element in elements.items()}
    attributes = attributes_of_whole(named, whole.size)
    return Variable(
        whole.name,
        (*first.dims, *whole.dims),
        first.dtype,
        attributes["units"],
        attributes["long_name"],
        attributes["role"],
        _more(attributes) | whole.more,
    )


def _take(whole: Whole, members: Mapping[int, Column]) -> Callable[[LogBlock], Array]:
    """Take all elements: a view of the log, where they are there one after the other in the record's unit."""
    lines = [members[number].take for number in range(whole.size)] if len(members) == whole.size else []
    first = lines[0] if lines else None
    if isinstance(first, LineOf) and all(
        line == replace(first, index=first.index + number) for number, line in enumerate(lines)
    ):
        count = whole.size

        def view(block: LogBlock) -> Array:
            table = first.taken(block, slice(first.index, first.index + count))
            return table.T.reshape(-1, *whole.shape)

        return view
    return lambda block: whole.stacked({number: member.take(block) for number, member in members.items()})


def _detector(column: Column, shapes: Shapes) -> list[Column]:
    """Return which detector an event is of, and along each dimension of which element."""
    words = str(column.variable.more["flag_meanings"]).split()
    wholes = Names(shapes).wholes(words)
    places = {name: (whole, number) for whole in wholes.values() for number, name in whole.members.items()}
    if not places:
        return [column]
    kinds = [*dict.fromkeys(places[word][0].name if word in places else word for word in words)]
    dims = shapes.ordered({dim for whole in wholes.values() for dim in whole.dims})
    kind_of = np.array([kinds.index(places[word][0].name if word in places else word) for word in words], np.int8)
    number_of = {dim: np.full(len(words), NOWHERE, np.int32) for dim in dims}
    for i, word in enumerate(words):
        if word in places:
            whole, number = places[word]
            for dim, place in zip(whole.dims, np.unravel_index(number, whole.shape), strict=True):
                number_of[dim][i] = place
    along = "; ".join(f"{whole.name}: {' '.join(whole.dims)}" for whole in wholes.values())
    more = dict(column.variable.more) | flags(dict(enumerate(kinds))) | {DETECTOR_DIMENSIONS: along}
    collected = [_looked_up(column, replace(column.variable, dtype="i1", more=more), kind_of)]
    for dim in dims:
        collected.append(_looked_up(column, place_variable(dim, dim, dim, shapes.extent(dim)), number_of[dim]))
        if dim in shapes.relations:
            collected += _ends(
                column, shapes, dim, number_of[dim], single=sum(dim in shapes.relations for dim in dims) == 1
            )
    return collected


def _ends(column: Column, shapes: Shapes, dim: str, links: Array, *, single: bool) -> list[Column]:
    """Return the elements at both ends of the link of an event; named by the relation where there are several."""
    relation, collected = shapes.relations[dim], []
    for end, of, numbers in (("first", relation.source, relation.first), ("second", relation.target, relation.second)):
        places = np.where(links == NOWHERE, NOWHERE, numbers[links]) if len(numbers) else links
        name = end if single else f"{dim}_{end}"
        at = place_variable(name, dim, of, shapes.extent(of))
        collected.append(_looked_up(column, at, places.astype(np.int32)))
    return collected


def _either(one: Column, other: Column) -> Column:
    """Return a column of places that has those of two columns, each of which has none where the other has one."""

    def take(block: LogBlock) -> Array:
        places = one.take(block)
        return np.where(places == NOWHERE, other.take(block), places)

    return Column(one.variable, take)


def element_at(name: str, along: str, of: str) -> str:
    """Say which element it is: along a dimension or a relation itself, or at one end of a link.

    Examples
    --------
    >>> element_at("body", "body", "body"), element_at("first", "pair", "disc"), element_at("rod_second", "rod", "wall")
    ('body', 'first disc of the pair', 'second wall of the rod')
    """
    return name if along == of else f"{name.removeprefix(f'{along}_')} {of} of the {along}"


def place_variable(name: str, along: str, of: str, extent: Extent) -> Variable:
    """Return the variable for an element at which an event was, as a flag where elements have labels."""
    long_name = (
        f"{element_at(name, along, of)} at which the event was, counted from 0; {NOWHERE} where its detector has none"
    )
    if not extent.labels:
        return Variable(at_event(name), (EVENTS,), "i4", NUMBERS.text, long_name, "event")
    words = {NOWHERE: "none"} | dict(enumerate(extent.labels))
    return Variable(at_event(name), (EVENTS,), "i4", NUMBERS.text, long_name, "flag", flags(words, "i4"))


def _looked_up(column: Column, variable: Variable, table: Array) -> Column:
    """Return a column of what stands in a table for the numbers of another one."""
    return Column(variable, lambda block: table[column.take(block)])
