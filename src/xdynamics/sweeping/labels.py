"""Finding members by their values along the axes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.faults import InputError
from xdynamics.sweeping.axes import Axis, AxisColumn, matching_dim
from xdynamics.sweeping.axis_values import axis_numbers
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.units import Scale

CONVERSION_RTOL = 1e-12  # relative difference of values that were converted between units


def indices_of_labels(grid: SweepGrid, labels: Mapping[str, Any]) -> list[int]:
    """Find the index along every axis of a member given by its values.

    Raises
    ------
    InputError
        If an axis has no such value (the nearest is named), there is no such axis, or the value of one is missing.
    """
    labels = {matching_dim(grid.dims, name): label for name, label in labels.items()}
    unknown = [name for name in labels if name not in grid.dims]
    if unknown:
        raise InputError(f"the sweep has no axis '{unknown[0]}'; there are {', '.join(grid.dims)}")
    indices = []
    for axis in grid.axes:
        if axis.size == 1 and axis.dim not in labels:
            indices.append(0)
        elif axis.dim not in labels:
            raise InputError(f"a member needs a value of every axis, and of '{axis.dim}' there is none")
        else:
            indices.append(index_on_axis(axis, labels[axis.dim]))
    return indices


def index_on_axis(axis: Axis, label: Any) -> int:
    """Find a value on one axis; an axis along which several columns vary takes the number of the member.

    Raises
    ------
    InputError
        If the axis has no such value.
    """
    matching = [column for column in axis.columns if column.label == axis.dim]
    return _index_in_column(matching[0], label) if matching else _member_number(axis.dim, axis.size, label)


def _index_in_column(column: AxisColumn, label: Any) -> int:
    if column.values.dtype == object:
        words = [str(value) for value in column.values]
        if str(label) not in words:
            raise InputError(f"axis '{column.label}' has no {str(label)!r}; there are {', '.join(words)}")
        return words.index(str(label))
    try:
        values, unit = axis_numbers(label, Scale(column.unit))
    except InputError as error:
        raise InputError(f"{column.label} {error}") from None
    if len(values) != 1:
        raise InputError(f"{column.label} is {label!r}, needs one value")
    target_si, values_si = unit.to_si(float(values[0])), column.si
    i = int(np.argmin(np.abs(values_si - target_si)))
    if abs(values_si[i] - target_si) > CONVERSION_RTOL * max(abs(values_si[i]), abs(target_si)):
        raise InputError(
            f"axis '{column.label}' has no {label!r}; the nearest is {float(column.values[i])!r} {column.unit.text}"
        )
    return i


def _member_number(dim: str, size: int, label: Any) -> int:
    if isinstance(label, bool) or not isinstance(label, int | np.integer) or not 0 <= label < size:
        raise InputError(f"{dim} is {label!r}, needs the number of a member, from 0 to {size - 1}")
    return int(label)
