"""Numbers of a quantity with dimensions from tables: of a file, or of numpy, pandas and xarray in memory.

Rows of a table are taken in order or by labels; columns of uncertainties stand beside the columns of values.
DataFrames, DataArrays, and mappings of headers to arrays are written as the tables of a model file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, brief_repr, first_names
from xdynamics.model.csv_sheet import OF_UNCERTAINTIES, SKIPPING, Sheet, cell_excerpt, csv_text, name_of_title, title
from xdynamics.model.csv_sheet import cell_excerpt as shown_cell
from xdynamics.model.kinds import Source
from xdynamics.model.uncertainty import SIZES
from xdynamics.shapes import Extent, Shapes
from xdynamics.units import SECONDS, Unit, parse_unit


def table_text(owner: str, table: Any) -> str:
    """Write a table passed in Python as CSV text, which the model keeps.

    Parameters
    ----------
    owner : str
        The drive.
    table : DataFrame, DataArray, Dataset or mapping
        Columns by headers with units, ``{"t [s]": times, "pull [N]": values}``; or a DataArray along one dimension, with
        the attribute `units` on itself and on its coordinate; or a Dataset of several, with `u_pull` for the uncertainty
        of `pull`. Dates along it are counted from the first, in seconds.

    Raises
    ------
    InputError
        If it is none of these, or a unit is missing.
    """
    if hasattr(table, "to_frame") and not hasattr(table, "columns") and not hasattr(table, "dims"):
        table = table.to_frame()  # a Series of pandas
    if hasattr(table, "dims") and hasattr(table, "coords"):
        return csv_text(_columns_of_array(owner, table))
    if hasattr(table, "columns") or isinstance(table, Mapping):
        return csv_text(columns_of_frame(table))
    raise InputError(
        f"table is {cell_excerpt(str(table))}, needs the name of a CSV file, a DataFrame, a DataArray, or arrays by their"
        f' headers: {{"t [s]": …, "{owner} [N]": …}}'
    )


def columns_of_frame(table: Any) -> dict[str, Any]:
    """Return the columns of a DataFrame, its index among them if it has a name, or of a mapping; dates in seconds.

    Dates and time differences are counted from the first, ``time [s]``.
    """
    import numpy as np

    if hasattr(table, "reset_index"):
        table = table.reset_index() if table.index.name else table
    columns = {}
    for name in [*table.keys()]:
        values = np.asarray(table[name])
        if values.dtype.kind in "mM":
            columns[f"{name_of_title(str(name))} [{SECONDS.text}]"] = (values - values[0]) / np.timedelta64(10**9, "ns")
        else:
            columns[str(name)] = values
    return columns


def _columns_of_array(owner: str, table: Any) -> dict[str, Any]:
    """Return the columns of a DataArray, or of a Dataset: the coordinate, then the variables along it that have units."""
    is_dataset = hasattr(table, "data_vars")
    if hasattr(table, "pint"):  # pint-xarray is loaded: units that arrays carry become attributes
        table = table.pint.dequantify()
    if not is_dataset and len(table.dims) != 1:
        raise InputError(f"table has the dims {table.dims}, needs one, along which it was measured")
    arrays = (
        {str(name): array for name, array in table.data_vars.items()}
        if is_dataset
        else {str(table.name or owner): table}
    )
    arrays = {
        name: array
        for name, array in arrays.items()
        if len(array.dims) == 1 and (not is_dataset or "units" in array.attrs)
    }
    dims = {array.dims[0] for array in arrays.values()}
    if len(dims) != 1:
        raise InputError(
            f"the Dataset has {len(arrays)} variables with units along {len(dims)} dimensions, needs one dimension: set their"
            " attribute 'units', or give one as a DataArray"
        )
    dim = str(dims.pop())
    coordinate = next((array for name, array in table.coords.items() if array.dims == (dim,)), None)
    if coordinate is None:
        raise InputError(f"table has no coordinate along '{dim}' that says where it was measured")
    columns = {}
    for label, name, array in (
        (f"coordinate '{coordinate.name}'", str(coordinate.name), coordinate),
        *((f"variable '{name}'" if is_dataset else "table", name, array) for name, array in arrays.items()),
    ):
        stamped = stamps(array)
        if stamped is None and "units" not in array.attrs:
            raise InputError(f"{label} has no units; set its attribute 'units'")
        key = f"u({name[2:]})" if is_dataset and name.startswith("u_") and name[2:] in arrays else name
        columns[f"{key} [{array.attrs['units'] if stamped is None else SECONDS.text}]"] = (
            array.values if stamped is None else stamped[0]
        )
    return columns


def stamps(array: Any) -> tuple[Any, str] | None:
    """Return dates, times since a date, or time differences, in seconds, with the stamp that is zero; None if it is none.

    CF's time is a number with the unit ``seconds since 2024-05-01``, which xarray decodes (CF conventions 1.11, section
    4.4); a motion is counted from the first stamp.
    """
    import numpy as np

    values, second = np.asarray(array.values), np.timedelta64(10**9, "ns")
    if values.dtype.kind == "m":
        return values / second, ""
    if values.dtype.kind == "M":
        return (values - values[0]) / second, str(values[0])
    unit, since, date = str(array.attrs.get("units", "")).partition(" since ")
    if not since:
        return None
    factor = parse_unit(unit.strip())
    return np.array(
        [factor.to_si(float(value - values[0])) for value in values.tolist()]
    ), f"{values[0]} {unit} since {date}"


def is_array(value: Any) -> bool:
    """Whether a value is an array of numpy or xarray with dimensions."""
    return hasattr(value, "dtype") and getattr(value, "ndim", 0) > 0


def as_in_file(entry: Any, name: str, dims: tuple[str, ...] | None, shapes: Shapes) -> Any:
    """Return an entry with arrays as lists and tables as text; other entries are unchanged.

    Parameters
    ----------
    entry : object
        An array of xarray is turned to the order of `dims`, and its labelled elements to theirs; its unit is its
        attribute `units`.
    name : str
    dims : tuple of str or None
        Of the quantity, where they are declared elsewhere.
    shapes : Shapes

    Raises
    ------
    InputError
        If an array has other dimensions or labels, no unit or two, or numbers that are not real.
    """
    if is_array(entry):
        entry = {"value": entry}
    if not isinstance(entry, Mapping):
        return entry
    if "table" in entry and not isinstance(entry["table"], str) and "csv" not in entry:
        table = entry["table"]
        if not isinstance(table, Mapping) and not hasattr(table, "columns"):
            raise InputError(
                f"table is a {type(table).__name__}, needs the name of a CSV file, a DataFrame, or columns by name"
            )
        return {**entry, "table": f"{name}.csv", "csv": csv_text(columns_of_frame(table), {*shapes.extents})}
    arrays = {key: entry[key] for key in ("value", *SIZES) if is_array(entry.get(key))}
    for key, array in arrays.items():
        entry = {**entry, **_array_entry(key, array, entry, dims, shapes)}
    return entry


def _array_entry(key: str, array: Any, entry: Mapping[str, Any], dims: tuple[str, ...] | None, shapes: Shapes) -> Any:
    """Return the keys of a model file that state an array."""
    if array.dtype.kind not in "biufUO":
        raise InputError(f"{key} has numbers of the kind {array.dtype}, needs real ones")
    if not hasattr(array, "dims"):
        return {key: array.tolist()}
    array_dims = tuple(str(dim) for dim in array.dims)
    needed = tuple(entry.get("dims", array_dims)) if dims is None else dims
    if sorted(array_dims) != sorted(needed):
        raise InputError(
            f"{key} is a DataArray along {', '.join(array_dims)}, needs {', '.join(needed) or 'no dimensions'}; rename or reduce it"
        )
    if "units" not in array.attrs:
        raise InputError(f"{key} is a DataArray without units; set its attribute 'units', of pure numbers '1'")
    unit = str(array.attrs["units"])
    if key == "value" and "unit" in entry:
        raise InputError(f"unit is '{entry['unit']}', and the DataArray has units '{unit}'; leave one out")
    parse_unit(unit)
    ordered_array = array.transpose(*needed)
    numbers = np.asarray(ordered_array.values)
    for axis, dim in enumerate(needed):
        if dim in ordered_array.coords and shapes.extent(dim).labels:
            numbers = numbers.take(
                _label_positions(key, [str(label) for label in ordered_array[dim].values], shapes.extent(dim)), axis
            )
    if key == "value":
        return {key: numbers.tolist(), "unit": unit} | ({"dims": list(needed)} if dims is None else {})
    return {
        key: np.array([f"{number!r} {unit}" for number in numbers.ravel().tolist()]).reshape(numbers.shape).tolist()
    }


def _label_positions(key: str, labels: list[str], extent: Extent) -> list[int]:
    """Return where the elements of a dimension are among the labels of an array."""
    if missing := [label for label in extent.labels if labels.count(label) != 1]:
        raise InputError(
            f"{key} has the labels {first_names(labels)} along '{extent.name}', needs each of {first_names(extent.labels)} exactly once; '{missing[0]}' is not"
        )
    if len(labels) > extent.size:
        unknown_label = next(label for label in labels if label not in extent.labels)
        raise InputError(
            f"{key} has the label '{unknown_label}' along '{extent.name}', which has {first_names(extent.labels)}"
        )
    return [labels.index(label) for label in extent.labels]


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
    """Return columns with a column of standard uncertainties beside them: ``u(k) [N/m]``.

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
