"""Measured tables that are given in Python: DataFrames, DataArrays, arrays by their headers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.sheet import shown, written


def tabled(owner: str, given: Any) -> str:
    """Write a table that was given in Python as CSV text, which the model keeps.

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
    if hasattr(given, "columns") and hasattr(given, "reset_index"):
        frame = given.reset_index() if given.index.name else given
        return written({str(name): frame[name] for name in frame.columns})
    if hasattr(given, "dims") and hasattr(given, "coords"):
        return written(_columns(owner, given))
    if isinstance(given, Mapping):
        return written({str(name): one for name, one in given.items()})
    raise InputError(f'table is {shown(str(given))}, needs the name of a CSV file, a DataFrame, a DataArray, or arrays by their headers: {{"t [s]": …, "{owner} [N]": …}}')  # fmt: skip


def _columns(owner: str, given: Any) -> dict[str, Any]:
    """Return the columns of a DataArray."""
    if len(given.dims) != 1:
        raise InputError(f"table has the dims {given.dims}, needs one, along which it was measured")
    dim = str(given.dims[0])
    coordinate = next((one for name, one in given.coords.items() if one.dims == (dim,)), None)
    if coordinate is None:
        raise InputError(f"table has no coordinate along '{dim}' that says where it was measured")
    for what, one in ((f"coordinate '{coordinate.name}'", coordinate), ("table", given)):
        if "units" not in one.attrs:
            raise InputError(f"{what} has no units; set its attribute 'units'")
    names = f"{coordinate.name} [{coordinate.attrs['units']}]", f"{given.name or owner} [{given.attrs['units']}]"
    return dict(zip(names, (coordinate.values, given.values), strict=True))
