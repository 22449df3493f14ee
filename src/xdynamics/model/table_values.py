"""Numbers of a quantity with dimensions from a table: rows in order or by labels, columns, their uncertainties beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, brief_repr, first_names
from xdynamics.model.csv_sheet import OF_UNCERTAINTIES, SKIPPING, Sheet, name_of_title, title
from xdynamics.model.csv_sheet import cell_excerpt as shown_cell
from xdynamics.model.kinds import Source
from xdynamics.model.uncertainty import SIZES
from xdynamics.shapes import Extent
from xdynamics.units import Unit


def from_table(
    entry: Mapping[str, Any], name: str, dims: tuple[str, ...], source: Source
) -> tuple[tuple[float, ...], Unit, tuple[float, ...]]:
    """Return columns of a table, one for each element along a second dimension, and the uncertainties that stand beside them.

    Returns
    -------
    numbers : tuple of float
        One for each element, the last dimension fastest.
    unit : Unit
    sizes : tuple of float
        Standard uncertainties in that unit, likewise, 0 of a column without; empty where none has one.

    Raises
    ------
    InputError
        Naming the table or the key, what it is and what was needed.
    """
    if not 1 <= len(dims) <= 2:
        raise InputError(f"a table has rows and columns, and '{name}' has the dimensions {', '.join(dims) or 'none'}")
    columns = entry.get("columns", [entry.get("column", name)])
    extents = [source.shapes.extent(dim) for dim in dims]
    if not isinstance(columns, list | tuple) or not all(isinstance(column, str) for column in columns):
        raise InputError(f"columns is {brief_repr(columns)}, needs a list of names of columns")
    if len(columns) != (extents[1].size if len(dims) > 1 else 1):
        needed = f"{extents[1].size}, one for each of '{dims[1]}': rows are of '{dims[0]}'" if len(dims) > 1 else "one"
        raise InputError(f"columns names {len(columns)}, needs {needed}")
    file = str(entry.get("table", f"{name}.csv"))
    sheet = Sheet.from_text(file, str(entry["csv"]) if "csv" in entry else source.access.read_table(file))
    doubted = _uncertain_columns(entry, sheet, columns)
    column_names = [*columns, *(f"u({name_of_title(column)})" for column in doubted)]
    read, units = columns_by_element(sheet, column_names, extents[0])
    unit = units[0]
    for column, column_unit in zip(column_names, units, strict=True):
        if column_unit.dimension != unit.dimension:
            raise InputError(
                f"table '{file}': column '{column}' is in '{column_unit.text}', the first in '{unit.text}'"
            )
    factors = [
        1.0 if column_unit.text == unit.text else float(column_unit.factor / unit.factor) for column_unit in units
    ]
    read = read * factors
    sizes = np.zeros((len(read), len(columns) if doubted else 0))
    for column_index, column in enumerate(doubted, len(columns)):
        sizes[:, columns.index(column)] = read[:, column_index]
    return tuple(read[:, : len(columns)].ravel().tolist()), unit, tuple(sizes.ravel().tolist())


def _uncertain_columns(entry: Mapping[str, Any], sheet: Sheet, columns: Sequence[str]) -> list[str]:
    """Return those of some columns beside which their standard uncertainties stand: ``u(k) [N/m]``.

    Raises
    ------
    InputError
        If the entry has uncertainties, too, or those of a column are common to its rows.
    """
    names = {name_of_title(cell.strip()) for cell in sheet.header}
    uncertain_columns, common = (
        [column for column in columns if f"{prefix}{name_of_title(column)})" in names] for prefix in OF_UNCERTAINTIES
    )
    if common:
        raise InputError(
            f"table '{sheet.name}' has a column 'u_common({common[0]})', which drives alone have; what is common to all"
            " elements is a parameter of its own, with its uncertainty, by which they are multiplied or shifted"
        )
    if uncertain_columns and (size_keys := [key for key in SIZES if key in entry]):
        raise InputError(
            f"has {size_keys[0]}, and table '{sheet.name}' has a column 'u({uncertain_columns[0]})'; leave one out"
        )
    return uncertain_columns


def columns_by_element(sheet: Sheet, columns: Sequence[str], extent: Extent) -> tuple[NDArray[np.float64], list[Unit]]:
    """Return columns of a table, a row for each element, matched by a column of labels where there is one.

    Raises
    ------
    InputError
        If a column is missing, or a label is unknown, twice or missing.
    """
    bare = [cell.strip() for cell in sheet.header]
    column_names = [name_of_title(cell) for cell in bare]
    places = []
    for column in columns:
        matches = [i for i, cell in enumerate(bare) if column in (cell, column_names[i])]
        if len(matches) != 1:
            count = "no column" if not matches else f"{len(matches)} columns"
            raise InputError(f"table '{sheet.name}' has {count} '{column}'; it is {sheet.layout_text}")
        places.append(matches[0])
    try:
        rows = sheet.columns(places)
    except InputError as error:
        faults = (fault.removesuffix(SKIPPING) for fault in error.faults)
        raise InputError(str(error), tuple(f"table '{sheet.name}', {fault}" for fault in faults)) from None
    units = [_column_unit(sheet, column_index) for column_index in places]
    if extent.name in column_names:
        rows = _rows_by_label(sheet, rows, column_names.index(extent.name), extent)
    elif len(rows) != extent.size:
        raise InputError(
            f"table '{sheet.name}' has {len(rows)} rows, and '{extent.name}' has {extent.size} elements; give a row for each"
        )
    return rows, units


def _column_unit(sheet: Sheet, column_index: int) -> Unit:
    """Return the unit of a column.

    Raises
    ------
    InputError
        If it has none that can be read.
    """
    try:
        return title(sheet.header[column_index]).unit
    except InputError as error:
        raise InputError(f"table '{sheet.name}', column {shown_cell(sheet.header[column_index])}: {error}") from None


def _rows_by_label(sheet: Sheet, rows: NDArray[np.float64], column: int, extent: Extent) -> NDArray[np.float64]:
    """Return rows in the order of elements, by their labels."""
    row_elements = sheet.elements(column, extent)
    if row_elements is not None and (np.bincount(row_elements, minlength=extent.size) == 1).all():
        return rows[np.argsort(row_elements)]
    places: dict[int, int] = {}
    for row, (line, cells) in enumerate(sheet.lines):
        label = cells[column].strip()
        try:
            number = extent.number(int(label) if not extent.labels and label.isdigit() else label)
        except InputError as error:
            raise InputError(f"table '{sheet.name}', line {line}: {error}") from None
        if number in places:
            raise InputError(f"table '{sheet.name}', line {line}: {shown_cell(label)} is there twice; leave one out")
        places[number] = row
    if missing := [extent.label(i) for i in range(extent.size) if i not in places]:
        raise InputError(
            f"table '{sheet.name}' has no row for {first_names(missing)} of '{extent.name}'; give a row for each"
        )
    return rows[[places[i] for i in range(extent.size)]]
