"""Columns of quantities with dimensions, stacked from the columns of their elements as these leave the log.

Elements that a log names become variables of these alone, along dimensions of their own beside the model's. A dimension
has one size in a Dataset, and parameters, impulses of events and fully logged quantities have all of a model's
elements. The variable of `u` for two sites of ten thousand is therefore along ``logged_site``, of size two, whose
labels name these sites. With nan for the rest a run of 200 rows took 55 MB in memory and as many in its file, for three
numbers a row; so it takes 0.5 MB.

Parameters of a model are variables of its record too.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.faults import InputError, first_names
from xdynamics.march import LogBlock, March
from xdynamics.model import Model
from xdynamics.model.elementwise import Elementwise, ParameterNumbers, parameter_numbers
from xdynamics.model.parts import Parameter
from xdynamics.model.table_keys import suggestion
from xdynamics.record.column import Column, LineOf, shapes_with_switches
from xdynamics.record.folding import (
    Names,
    QuantityElements,
    about_dimensions,
    attributes_of_element,
    attributes_of_quantity,
    names_as_words,
)
from xdynamics.shapes import NO_SHAPES, Extent, Shapes
from xdynamics.shapes.extents import number_of_element
from xdynamics.shapes.naming import DOT, display_text, split_element_name
from xdynamics.units import NUMBERS

Array = NDArray[Any]


def stacked_columns(columns: Sequence[Column], shapes: Shapes) -> list[Column]:
    """Stack the columns of each quantity's elements into one column; quantities may lack some elements."""
    by_name = {column.variable.name: column for column in columns}
    quantities = Names(shapes).by_quantity(by_name)
    stacked = {member for quantity in quantities.values() for member in quantity.members.values()}
    collected = [column for name, column in by_name.items() if name not in stacked]
    for quantity in quantities.values():
        members = {number: by_name[member] for number, member in quantity.members.items()}
        variable = _quantity_variable(quantity, {number: member.variable for number, member in members.items()})
        collected.append(Column(variable, partial(_take_stacked, quantity, members)))
    return collected


def _take_stacked(quantity: QuantityElements, members: Mapping[int, Column], block: LogBlock) -> Array:
    return quantity.stacked({number: member.take(block) for number, member in members.items()})


def split_columns(columns: Sequence[Column], shapes: Shapes) -> list[Column]:
    """Split the column of each quantity with dimensions into columns of its elements."""
    collected: list[Column] = []
    for column in columns:
        model_dims = _model_dims(column, shapes)
        collected += _element_columns(column, model_dims, shapes) if model_dims else [column]
    return collected


def _element_columns(column: Column, dims: tuple[str, ...], shapes: Shapes) -> Iterator[Column]:
    """Yield the columns of the elements of a quantity."""
    extents = tuple(map(shapes.extent, dims))
    for number, name in enumerate(shapes.elements(column.variable.name, dims)):
        yield _element_column(column, name, extents, number)


def _model_dims(column: Column, shapes: Shapes) -> tuple[str, ...]:
    return tuple(dim for dim in column.variable.dims if dim in shapes.extents or dim in shapes.relations)


def _element_column(column: Column, name: str, extents: tuple[Extent, ...], number: int) -> Column:
    """Return the column of one element of a quantity."""
    variable = column.variable
    more = attributes_of_element(variable.more, number, math.prod(extent.size for extent in extents))
    outer_dims = variable.dims[: len(variable.dims) - len(extents)]
    return Column(replace(variable, name=name, dims=outer_dims, more=more), _element_taker(column, number))


def _element_taker(column: Column, number: int) -> Callable[[LogBlock], Array]:
    """Return a function from a block to one element of a quantity, shape (rows,)."""
    if isinstance(column.take, LineOf):
        return column.take.element(number)

    def take_element(block: LogBlock) -> Array:
        values = column.take(block)
        return values.reshape(len(values), math.prod(values.shape[1:]))[:, number]  # of no row -1 would be anything

    return take_element


class NamedColumns(Mapping[str, Column]):
    """Columns by name; the column of an element is made on look-up."""

    def __init__(self, columns: Iterable[Column], shapes: Shapes) -> None:
        self._columns = {column.variable.name: column for column in columns}
        self._shapes = shapes

    def __getitem__(self, name: str) -> Column:
        if name in self._columns or DOT not in name:
            return self._columns[name]
        quantity_column = self._columns[split_element_name(name)[0]]
        extents = tuple(self._shapes.extent(dim) for dim in _model_dims(quantity_column, self._shapes))
        if (number := number_of_element(name, extents)) is None:
            raise KeyError(name)
        return _element_column(quantity_column, name, extents, number)

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)


def folded_constants(
    entries: Iterable[tuple[schema.Variable, Any]], shapes: Shapes
) -> list[tuple[schema.Variable, Any]]:
    """Fold the parameters of a quantity's elements into one parameter with dimensions."""
    all_entries = [*entries]
    if not shapes.dims:
        return all_entries
    by_name = {variable.name: (variable, value) for variable, value in all_entries}
    quantities = Names(shapes).by_quantity(by_name)
    of_name = {name: quantity for quantity in quantities.values() for name in quantity.members.values()}
    collected: dict[str, tuple[schema.Variable, Any]] = {}
    for name, entry in by_name.items():
        quantity = of_name.get(name)
        if quantity is None:
            collected[name] = entry
        elif quantity.name not in collected:
            members = {number: by_name[member] for number, member in quantity.members.items()}
            variable = _quantity_variable(
                quantity, {number: element_variable for number, (element_variable, _) in members.items()}
            )
            values = {number: np.asarray(value) for number, (_, value) in members.items()}
            collected[quantity.name] = variable, quantity.stacked(values)
    return [*collected.values()]


def dimension_variables(shapes: Shapes) -> list[tuple[schema.Variable, Any]]:
    """Return the labels of dimensions and the ends of relations."""
    dims = {*shapes.relations, *shapes.extents}
    types = {"U": "U", "i": "i4"}
    return [
        (
            schema.Variable(
                name,
                variable_dims,
                types[values.dtype.kind],
                NUMBERS.text,
                about["long_name"],
                about["role"],
                _more(about),
            ),
            values,
        )
        for name, (variable_dims, values, about) in about_dimensions(shapes, dims).items()
    ]


def _more(attributes: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in attributes.items() if key not in ("units", "long_name", "role")}


def _quantity_variable(quantity: QuantityElements, elements: Mapping[int, schema.Variable]) -> schema.Variable:
    """Return the variable of a quantity from those of its elements."""
    first = next(iter(elements.values()))
    attributes_by_number = {
        number: (quantity.members[number], element.attributes) for number, element in elements.items()
    }
    attributes = attributes_of_quantity(attributes_by_number, quantity.size)
    return schema.Variable(
        quantity.name,
        (*first.dims, *quantity.dims),
        first.dtype,
        attributes["units"],
        attributes["long_name"],
        attributes["role"],
        _more(attributes) | quantity.more,
    )


def detector_columns(column: Column, shapes: Shapes) -> list[Column]:
    """Return which detector an event is of, and along each dimension of which element."""
    words = str(column.variable.more["flag_meanings"]).split()
    quantities = Names(shapes).by_quantity(words)
    places = {name: (quantity, number) for quantity in quantities.values() for number, name in quantity.members.items()}
    if not places:
        return [column]
    kinds = [*dict.fromkeys(places[word][0].name if word in places else word for word in words)]
    dims = shapes.ordered({dim for quantity in quantities.values() for dim in quantity.dims})
    kind_of = np.array([kinds.index(places[word][0].name if word in places else word) for word in words], np.int8)
    number_of = {dim: np.full(len(words), schema.NOWHERE, np.int32) for dim in dims}
    for i, word in enumerate(words):
        if word in places:
            quantity, number = places[word]
            for dim, index in zip(quantity.dims, np.unravel_index(number, quantity.shape), strict=True):
                number_of[dim][i] = index
    detector_dims = "; ".join(f"{quantity.name}: {' '.join(quantity.dims)}" for quantity in quantities.values())
    more = (
        dict(column.variable.more)
        | schema.flag_attributes(dict(enumerate(kinds)))
        | {schema.DETECTOR_DIMENSIONS: detector_dims}
    )
    collected = [_table_column(column, replace(column.variable, dtype="i1", more=more), kind_of)]
    for dim in dims:
        collected.append(_table_column(column, place_variable(dim, dim, dim, shapes.extent(dim)), number_of[dim]))
        if dim in shapes.relations:
            collected += _end_columns(
                column, shapes, dim, number_of[dim], single=sum(dim in shapes.relations for dim in dims) == 1
            )
    return collected


def _end_columns(column: Column, shapes: Shapes, dim: str, links: Array, *, single: bool) -> list[Column]:
    """Return the elements at both ends of the link of an event; named by the relation where there are several."""
    relation, collected = shapes.relations[dim], []
    for end, target_dim, numbers in (
        ("first", relation.source, relation.first),
        ("second", relation.target, relation.second),
    ):
        # a relation without links has nothing to index, and every place is NOWHERE already
        places = np.where(links == schema.NOWHERE, schema.NOWHERE, numbers[links]) if len(numbers) else links
        name = end if single else f"{dim}_{end}"
        end_variable = place_variable(name, dim, target_dim, shapes.extent(target_dim))
        collected.append(_table_column(column, end_variable, places.astype(np.int32)))
    return collected


def element_at(name: str, dim: str, target_dim: str) -> str:
    """Describe an element in words: along a dimension or a relation itself, or at one end of a link.

    Examples
    --------
    >>> element_at("body", "body", "body"), element_at("first", "pair", "disc"), element_at("rod_second", "rod", "wall")
    ('body', 'first disc of the pair', 'second wall of the rod')
    """
    return name if dim == target_dim else f"{name.removeprefix(f'{dim}_')} {target_dim} of the {dim}"


def place_variable(name: str, dim: str, target_dim: str, extent: Extent) -> schema.Variable:
    """Return the variable for an element at which an event was, as a flag where elements have labels."""
    long_name = f"{element_at(name, dim, target_dim)} at which the event was, counted from 0; {schema.NOWHERE} where its detector has none"
    if not extent.labels:
        return schema.Variable(schema.at_event(name), (schema.EVENTS,), "i4", NUMBERS.text, long_name, "event")
    words = {schema.NOWHERE: "none"} | dict(enumerate(extent.labels))
    return schema.Variable(
        schema.at_event(name),
        (schema.EVENTS,),
        "i4",
        NUMBERS.text,
        long_name,
        "flag",
        schema.flag_attributes(words, "i4"),
    )


def _table_column(column: Column, variable: schema.Variable, table: Array) -> Column:
    """Return a column that looks up the numbers of another column in a table."""
    return Column(variable, lambda block: table[column.take(block)])


Log = str | tuple[str, ...]


def shapes_of_log(log: Log, shapes: Shapes) -> Shapes:
    """Return the dimensions of quantities of which a log names some elements, and not all: the union along each.

    Raises
    ------
    InputError
        If a name of the model is that of such a dimension.

    Examples
    --------
    >>> shapes = Shapes({"site": Extent("site", 9)}, {}, {"u": ("site",)})
    >>> shapes_of_log(("u·3", "u·7"), shapes).extents["logged_site"].labels
    ('3', '7')
    """
    if isinstance(log, str) or not any(DOT in name for name in log):
        return NO_SHAPES
    quantities = Names(shapes).by_quantity(name for name in log if DOT in name)
    partly_logged = {
        name: quantity
        for name, quantity in quantities.items()
        if name not in log and len(quantity.members) < quantity.size
    }
    numbers: dict[str, set[int]] = {}
    for quantity in partly_logged.values():
        for dim, places in zip(quantity.dims, np.unravel_index([*quantity.members], quantity.shape), strict=True):
            numbers.setdefault(dim, set()).update(places.tolist())
    extents = {
        schema.logged_of(dim): Extent(
            schema.logged_of(dim), len(element_numbers), tuple(map(shapes.extent(dim).label, sorted(element_numbers)))
        )
        for dim, element_numbers in numbers.items()
    }
    for dim in extents.keys() & {*shapes.extents, *shapes.relations, *shapes.dims}:
        raise InputError(
            f"log names elements, which are recorded along '{dim}', and the model has that name already; give it another name"
        )
    return Shapes(
        extents, {}, {name: tuple(map(schema.logged_of, quantity.dims)) for name, quantity in partly_logged.items()}
    )


def march_shapes(march: March) -> tuple[Shapes, Shapes]:
    """Return the dimensions of a model, and those of the elements that a log names."""
    return march.model.shapes, shapes_of_log(march.settings.log, shapes_with_switches(march.layout.model))


def sizes_of(march: March) -> dict[str, int]:
    """Return the size of each dimension of a march, those of its log included."""
    return {
        dim: shapes.extent(dim).size for shapes in march_shapes(march) for dim in (*shapes.relations, *shapes.extents)
    }


def logged_numbers(name: str, size: int, march: March) -> NDArray[np.int64]:
    """Return which of the elements of a quantity are along the dimensions of its log: all, if none are named."""
    shapes, logged = march_shapes(march)
    if name not in logged.dims:
        return np.arange(size)
    dims = [dim.removeprefix(schema.logged_of("")) for dim in logged.dims[name]]
    places = [
        [shapes.extent(dim).number_of_label(label) for label in logged.extents[schema.logged_of(dim)].labels]
        for dim in dims
    ]
    return np.ravel_multi_index(np.ix_(*places), shapes.shape(tuple(dims))).ravel()


def logged_column(column: Column, log: Sequence[str], model_shapes: Shapes, logged: Shapes) -> Column:
    """Return a column with those elements alone that a log names, where it does not name the quantity.

    Along each dimension they are all that any of its names has; what no name says is missing.
    """
    variable, name = column.variable, column.variable.name
    if name not in logged.dims:
        return column
    dims, numbers = logged.dims[name], dict[int, int]()
    quantity = Names(logged).by_quantity(entry for entry in log if split_element_name(entry)[0] == name)[name]
    model_dims = [dim.removeprefix(schema.logged_of("")) for dim in dims]
    extents = tuple(map(model_shapes.extent, model_dims))
    for number, member in quantity.members.items():
        number_of_model = number_of_element(member, extents)
        assert number_of_model is not None  # noqa: S101 - `check_logged` refuses what the model has not
        numbers[number] = number_of_model
    size = math.prod(extent.size for extent in extents)
    attributes = attributes_of_quantity(
        {
            number: (quantity.members[number], attributes_of_element(variable.more, whole_number, size))
            for number, whole_number in numbers.items()
        },
        quantity.size,
    )
    outer_dims = tuple(dim for dim in variable.dims if dim not in model_dims)

    def take_logged(block: LogBlock) -> Array:
        values = column.take(block).reshape(-1, size)
        return quantity.stacked({number: values[:, whole_number] for number, whole_number in numbers.items()})

    return Column(replace(variable, dims=(*outer_dims, *dims), more=attributes | quantity.more), take_logged)


def check_logged(log: Sequence[str], available: Sequence[Column], shapes: Shapes) -> None:
    """Check that every name of a log is a column that the log may have.

    Raises
    ------
    InputError
        If a name is no column of the log.
    """
    by_rows = {name: column for column in available if (name := column.variable.name) and is_by_rows(column)}
    for name in log:
        quantity, labels = split_element_name(name)
        if name in by_rows or (quantity in by_rows and _has_element(by_rows[quantity], name, shapes)):
            continue
        if labels and any(c.variable.name == quantity and c.variable.dims[1:] for c in available):
            shapes.internal_name(display_text(name), "log names")  # refuses what the model has not
            raise InputError(f"log names '{display_text(name)}': '{quantity}' is not recorded of it")
        meant = suggestion(display_text(name), tuple(by_rows)).partition("; there are")[0]
        raise InputError(
            f"log names '{display_text(name)}', which is no column of this run's log{meant}; there are {first_names(by_rows)}"
        )


def _has_element(column: Column, name: str, shapes: Shapes) -> bool:
    """Whether a column has an element: of a quantity that some elements lack those are listed."""
    listed = str(column.variable.more.get(schema.ELEMENTS, "")).split()
    known = Names(shapes).by_quantity([name]).keys() == {column.variable.name}
    return known and (not listed or names_as_words([name]) in listed)


def is_by_rows(column: Column) -> bool:
    """Whether a column is one of those that a log may leave out."""
    return column.variable.dims[0] in (schema.STEPS, schema.SAMPLES, schema.CLOSED_LINKS)


def parameter_variables(model: Model) -> list[tuple[schema.Variable, Any]]:
    """Return the parameters with their values."""
    entries: list[tuple[schema.Variable, Any]] = []
    for name, parameter in _parameters_by_block(model.elements.statement.parameters):
        if isinstance(parameter, ParameterNumbers):
            unit, long_name = parameter.unit.text, parameter.declared_values.description or f"parameter {name}"
            dims = model.shapes.dims[name]
            entries.append((schema.Variable(name, dims, "f8", unit, long_name, "parameter", {}), parameter.values))
            continue
        extra = _uncertainty_attributes(parameter)
        long_name = parameter.description or f"parameter {name}"
        entries.append(
            (
                schema.Variable(name, (), "f8", parameter.quantity.unit.text, long_name, "parameter", extra),
                parameter.quantity.value,
            )
        )
    return folded_constants(entries, model.shapes)


def _uncertainty_attributes(parameter: Parameter) -> dict[str, Any]:
    """Return the attributes that say how uncertain a parameter is, in its own unit, and by which distribution."""
    spread = parameter.spread
    if spread is None:
        return {}
    attributes = {
        "uncertainty": parameter.uncertainty,
        "uncertainty_kind": "standard",
        "uncertainty_units": parameter.quantity.unit.text,
        "uncertainty_distribution": spread.distribution,
        "uncertainty_half_width": parameter.half_width,
        "uncertainty_degrees_of_freedom": spread.degrees_of_freedom,
    }
    return {name: value for name, value in attributes.items() if value is not None}


def _parameters_by_block(parameters: Mapping[str, Parameter]) -> Iterator[tuple[str, Parameter | ParameterNumbers]]:
    """Yield parameters by name: a quantity with dimensions at once, unless its elements have distributions."""
    if not isinstance(parameters, Elementwise):
        yield from parameters.items()
        return
    for block in parameters.names.blocks:
        made = parameter_numbers(parameters, block.name)
        if made is None or any(made.declared_values.spreads):
            yield from ((name, parameters[name]) for name in block.elements())
        else:
            yield block.name, made
