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

from xdynamics.faults import InputError, few
from xdynamics.march import March
from xdynamics.model.table_keys import near
from xdynamics.record.column import Column
from xdynamics.record.element_attributes import of_wholes
from xdynamics.record.element_names import Names, Whole, expanded
from xdynamics.record.folded_columns import NamedColumns, folded
from xdynamics.record.switches import shapes_with_switches
from xdynamics.schema import CLOSED_LINKS, SAMPLES, STEPS, logged_of
from xdynamics.shapes import NO_SHAPES, Extent, Shapes
from xdynamics.shapes.naming import DOT, parted, spoken

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
    wholes = Names(shapes).wholes(name for name in log if DOT in name)
    some = {name: whole for name, whole in wholes.items() if name not in log and len(whole.members) < whole.size}
    numbers: dict[str, set[int]] = {}
    for whole in some.values():
        for dim, places in zip(whole.dims, np.unravel_index([*whole.members], whole.shape), strict=True):
            numbers.setdefault(dim, set()).update(places.tolist())
    extents = {
        logged_of(dim): Extent(logged_of(dim), len(own), tuple(map(shapes.extent(dim).label, sorted(own))))
        for dim, own in numbers.items()
    }
    for dim in extents.keys() & {*shapes.extents, *shapes.relations, *shapes.dims}:
        raise InputError(
            f"log names elements, which are recorded along '{dim}', and the model has that name already; give it another name"
        )
    return Shapes(extents, {}, {name: tuple(map(logged_of, whole.dims)) for name, whole in some.items()})


def shapes_of(march: March) -> tuple[Shapes, Shapes]:
    """Return the dimensions of a model, and those of the elements that a log names."""
    return march.model.shapes, shapes_of_log(march.settings.log, shapes_with_switches(march.layout.model))


def sizes_of(march: March) -> dict[str, int]:
    """Return the size of each of these dimensions."""
    return {dim: shapes.extent(dim).size for shapes in shapes_of(march) for dim in (*shapes.relations, *shapes.extents)}


def logged_numbers(name: str, size: int, march: March) -> NDArray[np.int64]:
    """Return which of the elements of a quantity are along the dimensions of its log: all, if none are named."""
    shapes, logged = shapes_of(march)
    if name not in logged.dims:
        return np.arange(size)
    dims = [dim.removeprefix(logged_of("")) for dim in logged.dims[name]]
    places = [[shapes.extent(dim).find(label) for label in logged.extents[logged_of(dim)].labels] for dim in dims]
    return np.ravel_multi_index(np.ix_(*places), shapes.shape(tuple(dims))).ravel()


def wholes_of(names: Sequence[str], march: March) -> dict[str, Whole]:
    """Gather elements by their quantities as a record has them, without those that its log leaves out."""
    shapes, logged = shapes_of(march)
    wholes = Names(shapes).wholes(name for name in names if parted(name)[0] not in logged.dims)
    return wholes | Names(logged).wholes(name for name in names if name in march.settings.log)


def folded_log(columns: Sequence[Column], log: Log, shapes: Shapes) -> list[Column]:
    """Make one column of each quantity, of which some elements are logged of these alone."""
    logged = shapes_of_log(log, shapes)
    if not logged.dims:
        return folded(columns, shapes)
    single = {column.variable.name for column in columns if parted(column.variable.name)[0] in logged.dims}
    others = folded([column for column in columns if column.variable.name not in single], shapes)
    return [*others, *folded([column for column in columns if column.variable.name in single], logged)]


def with_elements(available: Iterable[Column], log: Sequence[str], shapes: Shapes) -> list[Column]:
    """Return columns with the elements that a log names in the place of their quantity, unless it names that too."""
    named: dict[str, list[str]] = {}
    for name in dict.fromkeys(log):
        if DOT in name:
            named.setdefault(parted(name)[0], []).append(name)
    collected: list[Column] = []
    for column in available:
        if (whole := column.variable.name) in named.keys() - {*log}:
            own = NamedColumns([column], shapes)
            collected += [own[name] for name in named[whole] if name in own] or [column]
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
    names, known, quantities = expanded(log, by_rows, shapes), {*by_rows}, of_wholes(by_rows)
    for name in names:
        whole, labels = parted(name)
        if name in known or (whole in log and Names(shapes).wholes([name])):
            continue
        dims = next((column.variable.dims[1:] for column in available if column.variable.name == whole), ())
        if labels and dims:
            shapes.inside(spoken(name), "log names")  # refuses what the model has not
            raise InputError(f"log names '{spoken(name)}': '{whole}' is not recorded of it")
        meant = near(spoken(name), quantities).partition("; there are")[0]
        raise InputError(
            f"log names '{spoken(name)}', which is no column of this run's log{meant}; there are {few(quantities)}"
        )
    return names


def is_by_rows(column: Column) -> bool:
    """Whether a column is one of those that a log may leave out."""
    return column.variable.dims[0] in (STEPS, SAMPLES, CLOSED_LINKS)
