"""Values for elements passed in Python: arrays of numpy and xarray, DataFrames; as a model file would say them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.faults import InputError, first_names
from xdynamics.model.csv_sheet import csv_text
from xdynamics.model.python_tables import columns_of_frame
from xdynamics.model.uncertainty import SIZES
from xdynamics.shapes import Extent, Shapes
from xdynamics.units import parse_unit


def is_array(value: Any) -> bool:
    """Whether a value is an array of numpy or xarray with dimensions."""
    return hasattr(value, "dtype") and getattr(value, "ndim", 0) > 0


def as_in_file(entry: Any, name: str, dims: tuple[str, ...] | None, shapes: Shapes) -> Any:
    """Return an entry with lists in the place of arrays, and text in that of a table; others as they are.

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
    """Return what stands in a file for one key with an array."""
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
