"""Columns of a record stacked, for functions of many of them at once: in memory, or chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.march import Settings
from xdynamics.methods.scheme import DOUBLE_DOUBLE
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.record.run_columns import state_name
from xdynamics.schema import STEPS
from xdynamics.shapes.blocks import Block

Floats = NDArray[np.float64]


def blockwise(
    function: Callable[[Floats, Floats, Any], Floats],
    where: Floats,
    columns: list[Any],
    height: int,
    later: Callable[[], Any],
) -> Any:
    """Apply a function lazily to stacked columns, and to what is the same for all of them."""
    import dask.array

    da: Any = dask.array  # its functions are not typed

    data = [da.asarray(column.transpose(STEPS, ...).data) for column in columns]
    parts = da.concatenate([part.reshape(len(part), -1).T for part in data]).rechunk({0: -1})
    places = da.from_array(where, chunks=(len(where), parts.chunks[1]))
    return da.map_blocks(
        function, places, parts, dtype=float, chunks=((height,), parts.chunks[1]), meta=np.empty((0, 0)), links=later()
    )


def stack_columns(columns: list[Any]) -> Floats:
    """Return the numbers of some variables along `step`, a row for each of their elements."""
    parts = [np.asarray(column.transpose(STEPS, ...)) for column in columns]
    return np.concatenate([flattened_rows(part).T for part in parts])


def step_columns(
    model: Model,
    settings: Settings,
    rows: NDArray[np.int64],
    following: NDArray[np.int64],
    names: Sequence[str] | None = None,
) -> list[tuple[str, NDArray[np.int64]]]:
    """Return the columns that `states_within` repeats steps from, each with its rows: of the start or of the end.

    `names` are those of the record's variables of the state, if they are not of elements.
    """
    used = tuple(settings.layout(model).used if names is None else names)
    columns_with_rows = [("step_size", following)]
    columns_with_rows += [(name, rows) for name in ("regime", "row_kind", *map(state_name, reactions(model)), *used)]
    if settings.precision == DOUBLE_DOUBLE:
        return columns_with_rows + [(name, rows) for name in (*map(schema.rest_name, used), schema.REST_TIME.name)]
    # iterations that continue from those of the step before do not reproduce its end to the bit
    return (
        columns_with_rows + [(name, following) for name in used]
        if settings.method.stepper.has_memory
        else columns_with_rows
    )


def values_along(numbers: Any, first: int, quantity: Block) -> Any:
    """Return the rows of a quantity as its values, its dimensions last."""
    rows = numbers[first : first + quantity.size]
    return rows.T.reshape(-1, *quantity.shape) if quantity.dims else rows[0] if len(rows) else rows
