"""Elements that a log names: variables of these alone, along dimensions of their own beside the model's.

A dimension has one size in a Dataset, and parameters, impulses of events and quantities that are logged whole have all of a
model's elements: what is logged of `u` for two sites of ten thousand is therefore along ``logged_site``, of size two, whose
labels say which sites these are. With nan for the rest a run of 200 rows took 55 MB in memory and as many in its file, for
three numbers a row; so it takes 0.5 MB.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, first_names
from xdynamics.march import March
from xdynamics.model.table_keys import suggestion
from xdynamics.record.column import Column
from xdynamics.record.element_attributes import quantity_names
from xdynamics.record.element_names import Names, QuantityElements, expand_quantities
from xdynamics.record.folded_columns import NamedColumns, fold_columns
from xdynamics.record.switches import shapes_with_switches
from xdynamics.schema import CLOSED_LINKS, SAMPLES, STEPS, logged_of
from xdynamics.shapes import NO_SHAPES, Extent, Shapes
from xdynamics.shapes.naming import DOT, display_text, split_element_name

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
        logged_of(dim): Extent(
            logged_of(dim), len(element_numbers), tuple(map(shapes.extent(dim).label, sorted(element_numbers)))
        )
        for dim, element_numbers in numbers.items()
    }
    for dim in extents.keys() & {*shapes.extents, *shapes.relations, *shapes.dims}:
        raise InputError(
            f"log names elements, which are recorded along '{dim}', and the model has that name already; give it another name"
        )
    return Shapes(extents, {}, {name: tuple(map(logged_of, quantity.dims)) for name, quantity in partly_logged.items()})


def march_shapes(march: March) -> tuple[Shapes, Shapes]:
    """Return the dimensions of a model, and those of the elements that a log names."""
    return march.model.shapes, shapes_of_log(march.settings.log, shapes_with_switches(march.layout.model))


def sizes_of(march: March) -> dict[str, int]:
    """Return the size of each of these dimensions."""
    return {
        dim: shapes.extent(dim).size for shapes in march_shapes(march) for dim in (*shapes.relations, *shapes.extents)
    }


def logged_numbers(name: str, size: int, march: March) -> NDArray[np.int64]:
    """Return which of the elements of a quantity are along the dimensions of its log: all, if none are named."""
    shapes, logged = march_shapes(march)
    if name not in logged.dims:
        return np.arange(size)
    dims = [dim.removeprefix(logged_of("")) for dim in logged.dims[name]]
    places = [
        [shapes.extent(dim).number_of_label(label) for label in logged.extents[logged_of(dim)].labels] for dim in dims
    ]
    return np.ravel_multi_index(np.ix_(*places), shapes.shape(tuple(dims))).ravel()


def logged_quantities(names: Sequence[str], march: March) -> dict[str, QuantityElements]:
    """Gather elements by their quantities as a record has them, without those that its log leaves out."""
    shapes, logged = march_shapes(march)
    quantities = Names(shapes).by_quantity(name for name in names if split_element_name(name)[0] not in logged.dims)
    return quantities | Names(logged).by_quantity(name for name in names if name in march.settings.log)


def fold_logged_columns(columns: Sequence[Column], log: Log, shapes: Shapes) -> list[Column]:
    """Make one column of each quantity, of which some elements are logged of these alone."""
    logged = shapes_of_log(log, shapes)
    if not logged.dims:
        return fold_columns(columns, shapes)
    single = {column.variable.name for column in columns if split_element_name(column.variable.name)[0] in logged.dims}
    fully_logged = fold_columns([column for column in columns if column.variable.name not in single], shapes)
    return [*fully_logged, *fold_columns([column for column in columns if column.variable.name in single], logged)]


def with_elements(available: Iterable[Column], log: Sequence[str], shapes: Shapes) -> list[Column]:
    """Return columns with the elements that a log names in the place of their quantity, unless it names that too."""
    elements_by_quantity: dict[str, list[str]] = {}
    for name in dict.fromkeys(log):
        if DOT in name:
            elements_by_quantity.setdefault(split_element_name(name)[0], []).append(name)
    collected: list[Column] = []
    for column in available:
        if (quantity := column.variable.name) in elements_by_quantity.keys() - {*log}:
            element_columns = NamedColumns([column], shapes)
            collected += [
                element_columns[name] for name in elements_by_quantity[quantity] if name in element_columns
            ] or [column]
        else:
            collected.append(column)
    return collected


def check_logged(log: Sequence[str], available: Sequence[Column], shapes: Shapes) -> tuple[str, ...]:
    """Return the names of a log, those of all elements in the place of quantities that have a column for each.

    Raises
    ------
    InputError
        If a name is no column of the log.
    """
    by_rows = [name for column in available if (name := column.variable.name) and is_by_rows(column)]
    names, known_names, quantities = expand_quantities(log, by_rows, shapes), {*by_rows}, quantity_names(by_rows)
    for name in names:
        quantity, labels = split_element_name(name)
        if name in known_names or (quantity in log and Names(shapes).by_quantity([name])):
            continue
        dims = next((column.variable.dims[1:] for column in available if column.variable.name == quantity), ())
        if labels and dims:
            shapes.internal_name(display_text(name), "log names")  # refuses what the model has not
            raise InputError(f"log names '{display_text(name)}': '{quantity}' is not recorded of it")
        meant = suggestion(display_text(name), quantities).partition("; there are")[0]
        raise InputError(
            f"log names '{display_text(name)}', which is no column of this run's log{meant}; there are {first_names(quantities)}"
        )
    return names


def is_by_rows(column: Column) -> bool:
    """Whether a column is one of those that a log may leave out."""
    return column.variable.dims[0] in (STEPS, SAMPLES, CLOSED_LINKS)
