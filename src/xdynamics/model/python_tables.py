"""Measured tables passed in Python: DataFrames, DataArrays, mappings of headers to arrays."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import shown, written


def tabled(owner: str, table: Any) -> str:
    """Write a table passed in Python as CSV text, which the model keeps.

    Parameters
    ----------
    owner : str
        The drive.
    given : DataFrame, DataArray or mapping
        Columns by headers with units, ``{"t [s]": times, "pull [N]": values}``; or a DataArray along one dimension, with
        the attribute `units` on itself and on its coordinate.

    Raises
    ------
    InputError
        If it is none of these, or a unit is missing.
    """
    if hasattr(table, "columns") and hasattr(table, "reset_index"):
        frame = table.reset_index() if table.index.name else table
        return written({str(name): frame[name] for name in frame.columns})
    if hasattr(table, "dims") and hasattr(table, "coords"):
        return written(_columns(owner, table))
    if isinstance(table, Mapping):
        return written({str(name): column for name, column in table.items()})
    raise InputError(
        f"table is {shown(str(table))}, needs the name of a CSV file, a DataFrame, a DataArray, or arrays by their"
        f' headers: {{"t [s]": …, "{owner} [N]": …}}'
    )


def _columns(owner: str, table: Any) -> dict[str, Any]:
    """Return the columns of a DataArray."""
    if len(table.dims) != 1:
        raise InputError(f"table has the dims {table.dims}, needs one, along which it was measured")
    dim = str(table.dims[0])
    coordinate = next((array for name, array in table.coords.items() if array.dims == (dim,)), None)
    if coordinate is None:
        raise InputError(f"table has no coordinate along '{dim}' that says where it was measured")
    for what, array in ((f"coordinate '{coordinate.name}'", coordinate), ("table", table)):
        if "units" not in array.attrs:
            raise InputError(f"{what} has no units; set its attribute 'units'")
    names = f"{coordinate.name} [{coordinate.attrs['units']}]", f"{table.name or owner} [{table.attrs['units']}]"
    return dict(zip(names, (coordinate.values, table.values), strict=True))
