"""Members added to a folder with a sweep: which of them exist there, and their recorded values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.store import ZARR, Place
from xdynamics.faults import InputError, numbered_lines
from xdynamics.record import model_words
from xdynamics.sweeping.axes import INITIAL, PARAMETER, Axis, AxisColumn, column_of, matching_dim
from xdynamics.sweeping.collection import DIGEST, plan_of
from xdynamics.sweeping.grid import CONVERSION_RTOL, SweepGrid
from xdynamics.sweeping.members import Block, Plan, Values

if TYPE_CHECKING:
    import xarray as xr

NONE = -1
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Additions:
    """An existing sweep in a folder as a part of a larger one.

    Attributes
    ----------
    catalogue : str
        Path of its catalogue.
    dims : tuple of str
        Dimensions of the larger sweep, in order.
    old_indices : tuple of ndarray of int
        For each dimension the index of every value in the existing sweep, `NONE` where it lacks the value.
    shared_dims : tuple of str
        The dimensions that the existing sweep has too.
    opens : callable
        Opens the catalogue, given its path.
    """

    catalogue: str
    dims: tuple[str, ...]
    old_indices: tuple[Places, ...]
    shared_dims: tuple[str, ...]
    opens: Callable[[str], xr.Dataset]

    def existing_members(self, block: Block) -> NDArray[np.bool_]:
        """Return which members of a block exist, in the block's shape."""
        existing_mask = np.ones((), bool)
        for places, part in zip(self.old_indices, block, strict=True):
            existing_mask = existing_mask[..., None] & (places[part] != NONE)
        return existing_mask

    def copy_existing(self, plan: Plan, block: Block, arrays: dict[str, Values]) -> NDArray[np.bool_]:
        """Copy the recorded values of existing members into the arrays of a block; return the mask of these members."""
        existing_mask = self.existing_members(block)
        if existing_mask.any():
            indices = {
                # a member that is not there reads that of index 0, which the mask leaves out below
                dim: np.maximum(places[part], 0)
                for dim, places, part in zip(self.dims, self.old_indices, block, strict=True)
            }
            with self.opens(self.catalogue) as existing:
                if any(variable.name not in existing.variables for variable in plan.variables):
                    return np.zeros_like(existing_mask)  # of a version that did not tell it: they are computed anew
                for variable in plan.variables:
                    lazy = existing[variable.name].isel({dim: indices[dim] for dim in self.shared_dims})
                    part = lazy.load(scheduler="synchronous")  # texts can only be transposed in memory
                    new_sizes = {dim: places.size for dim, places in indices.items() if dim not in self.shared_dims}
                    values = part.expand_dims(new_sizes).transpose(*self.dims, *variable.dims).values
                    arrays[variable.name][existing_mask] = values[existing_mask]
        return existing_mask


def existing_additions(
    plan: Plan, stored_sweep: xr.Dataset, catalogue: Place, opens: Callable[[str], xr.Dataset]
) -> Additions:
    """Find out which members of a sweep a folder already holds, whose catalogue is opened so.

    Raises
    ------
    InputError
        If the existing sweep has another model or other settings, or is no part of this one; with every fault.
    """
    existing = plan_of(stored_sweep, plan.grid.model.functions)
    faults = list(_setting_conflicts(plan, existing))
    if not faults and existing.digest != stored_sweep.attrs[DIGEST]:
        faults.append("it was computed by another version of xdynamics, or of its elementary functions")
    places = [] if faults else [_indices_in_old_axis(axis, existing.grid, faults) for axis in plan.grid.axes]
    if faults:
        headline = f"'{catalogue if catalogue.suffix == ZARR else catalogue.parent}' holds another sweep, '{stored_sweep.attrs['title']}', to which this one does not add"
        raise InputError(f"{headline}:{numbered_lines(faults)}\nname another folder, or remove it", tuple(faults))
    shared_dims = tuple(dim for dim in plan.grid.dims if dim in existing.grid.dims)
    return Additions(str(catalogue.absolute()), plan.grid.dims, tuple(places), shared_dims, opens)


def _setting_conflicts(plan: Plan, existing: Plan) -> Iterator[str]:
    """Describe every difference between the two sweeps that forbids adding members."""
    grid, old_grid = plan.grid, existing.grid
    if model_words(grid.model) != model_words(old_grid.model):
        yield f"its model is another: its digest is {old_grid.model.digest[:16]}…, here {grid.model.digest[:16]}…"
    varying = {entry.name for _, entry in grid.columns} | {entry.name for _, entry in old_grid.columns}
    for name in sorted({*grid.shared_settings, *old_grid.shared_settings} - varying):
        if grid.shared_settings.get(name) != old_grid.shared_settings.get(name):
            yield (
                f"setting '{name}' is {old_grid.shared_settings.get(name, 'that of the model')} there, here"
                f" {grid.shared_settings.get(name, 'that of the model')}"
            )
    if plan.keeping.words != existing.keeping.words:
        yield f"keep is {', '.join(existing.keeping.words)} there, here {', '.join(plan.keeping.words)}"
    if plan.keeping.times.tolist() != existing.keeping.times.tolist():
        yield f"times are {_times_text(existing.keeping.times)} there, here {_times_text(plan.keeping.times)}"
    if plan.keeping.occurrences != existing.keeping.occurrences:
        yield f"occurrences are {existing.keeping.occurrences} there, here {plan.keeping.occurrences}"
    for old_axis in old_grid.axes:
        dim = matching_dim(grid.dims, old_axis.dim)
        new_axis = next((entry for entry in grid.axes if entry.dim == dim), None)
        if new_axis is None:
            yield f"its axis '{old_axis.dim}' is none of this sweep; give it too"
        elif dim != old_axis.dim:
            yield f"its axis is '{old_axis.dim}', as versions before called what is '{dim}' here"
        elif {_column_key(entry) for entry in new_axis.columns} != {_column_key(entry) for entry in old_axis.columns}:
            yield (
                f"its axis '{old_axis.dim}' varies {', '.join(entry.label for entry in old_axis.columns)}, here"
                f" {', '.join(entry.label for entry in new_axis.columns)}"
            )


def _times_text(times: Values) -> str:
    return f"{', '.join(f'{time:g}' for time in times[:4])}{' …' if times.size > 4 else ''}" if times.size else "none"


def _column_key(column: AxisColumn) -> tuple[str, str]:
    return column.kind, column.name


def _indices_in_old_axis(axis: Axis, old_grid: SweepGrid, faults: list[str]) -> Places:
    """Find the values of an axis in an existing sweep; note a fault for values of the sweep that the axis lacks."""
    old_axis = next((entry for entry in old_grid.axes if entry.dim == axis.dim), None)
    if old_axis is None:
        rows = {_value_key([_value_of_all_members(old_grid, entry) for entry in axis.columns]): 0}
        places = np.array([rows.get(entry, NONE) for entry in _axis_keys(axis.columns)])
        if (places == NONE).all():
            faults.append(f"what it has for '{axis.dim}' is none of the values here; give it too")
        return places
    columns = [
        next(entry for entry in old_axis.columns if _column_key(entry) == _column_key(column))
        for column in axis.columns
    ]
    rows = {row: i for i, row in enumerate(_axis_keys(columns))}
    places = np.array([rows.get(entry, NONE) for entry in _axis_keys(axis.columns)])
    remaining = np.setdiff1d(np.arange(old_axis.size), places)
    missing = [i for i in remaining.tolist() if not _has_close_value(axis.columns, columns, i)]
    if missing:
        first_missing = ", ".join(f"{entry.label} = {entry.values[missing[0]]}" for entry in columns)
        faults.append(
            f"it has {first_missing}{f' and {len(missing) - 1} more values' if len(missing) > 1 else ''}, which this"
            " sweep has not; give them too"
        )
    return places


def _axis_keys(columns: Sequence[AxisColumn]) -> list[tuple[Any, ...]]:
    """Return the values along an axis: numbers in SI units, tables with their text."""
    return [_value_key(row) for row in zip(*(_comparable_values(column) for column in columns), strict=True)]


def _value_key(values: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(values)


def _comparable_values(column: AxisColumn) -> list[Any]:
    if column.tables:
        return list(zip(map(str, column.values), column.tables, strict=True))
    return [str(value) for value in column.values] if column.values.dtype == object else column.si.tolist()


def _value_of_all_members(grid: SweepGrid, column: AxisColumn) -> Any:
    """Return the value that all members of a sweep share; None where it is the model's own setting."""
    if column.kind == PARAMETER:
        return _single_value({grid.model.elements.statement.parameters[name].quantity.si for name in column.names})
    if column.kind == INITIAL:
        return _single_value({grid.model.elements.statement.initial[name].si for name in column.names})
    if column.name not in grid.shared_settings or column.tables:
        return None
    return _comparable_values(column_of(grid.model, column.name, [grid.shared_settings[column.name]]))[0]


def _single_value(values: set[float]) -> float | None:
    """Return the value that all elements of a quantity have; None if they have several."""
    return values.pop() if len(values) == 1 else None


def _has_close_value(new: Sequence[AxisColumn], old: Sequence[AxisColumn], i: int) -> bool:
    """Whether an old value is present up to rounding, as on a finer axis; such a member is marched again."""
    close = np.ones(len(new[0].values), bool)
    for new_column, old_column in zip(new, old, strict=True):
        if new_column.values.dtype == object or old_column.values.dtype == object:
            close &= np.array([value == _comparable_values(old_column)[i] for value in _comparable_values(new_column)])
        else:
            close &= np.abs(new_column.si - old_column.si[i]) <= CONVERSION_RTOL * np.maximum(
                np.abs(new_column.si), abs(old_column.si[i])
            )
    return bool(close.any())
