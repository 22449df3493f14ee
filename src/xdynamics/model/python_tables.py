"""Measured tables passed in Python: DataFrames, DataArrays, mappings of headers to arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import cell_excerpt, csv_text, name_of_title
from xdynamics.units import SECONDS, parse_unit


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
