"""Members added to a folder that holds a sweep: which of them exist, and what was kept of those."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.faults import InputError, numbered
from xdynamics.record import model_words
from xdynamics.sweeping.axes import INITIAL, PARAMETER, Axis, AxisColumn, column_of, named_among
from xdynamics.sweeping.collection import DIGEST, plan_of
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.sweeping.labels import ALIKE
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
    places : tuple of ndarray of int
        For each dimension the index of every value in the existing sweep, `NONE` where it lacks the value.
    along : tuple of str
        The dimensions that the existing sweep has too.
    opens : callable
        Opens the catalogue, given its path.
    """

    catalogue: str
    dims: tuple[str, ...]
    places: tuple[Places, ...]
    along: tuple[str, ...]
    opens: Callable[[str], xr.Dataset]

    def there(self, block: Block) -> NDArray[np.bool_]:
        """Return which members of a block exist, in the block's shape."""
        present = np.ones((), bool)
        for places, part in zip(self.places, block, strict=True):
            present = present[..., None] & (places[part] != NONE)
        return present

    def take(self, plan: Plan, block: Block, arrays: dict[str, Values]) -> NDArray[np.bool_]:
        """Copy what was kept of existing members into the arrays of a block; return which members they are."""
        present = self.there(block)
        if present.any():
            indices = {
                dim: np.maximum(places[part], 0)
                for dim, places, part in zip(self.dims, self.places, block, strict=True)
            }
            with self.opens(self.catalogue) as existing:
                for variable in plan.variables:
                    lazy = existing[variable.name].isel({dim: indices[dim] for dim in self.along})
                    part = lazy.load(scheduler="synchronous")  # texts can only be transposed in memory
                    new_sizes = {dim: places.size for dim, places in indices.items() if dim not in self.along}
                    values = part.expand_dims(new_sizes).transpose(*self.dims, *variable.dims).values
                    arrays[variable.name][present] = values[present]
        return present


def additions(plan: Plan, there: xr.Dataset, catalogue: Place, opens: Callable[[str], xr.Dataset]) -> Additions:
    """Find out which members of a sweep a folder already holds, whose catalogue is opened so.

    Raises
    ------
    InputError
        If the existing sweep has another model or other settings, or is no part of this one; with every fault.
    """
    existing = plan_of(there, plan.grid.model.functions)
    faults = list(_conflicts(plan, existing))
    if not faults and existing.digest != there.attrs[DIGEST]:
        faults.append("it was marched by another version of xdynamics, or of its elementary functions")
    places = [] if faults else [_places(axis, existing.grid, faults) for axis in plan.grid.axes]
    if faults:
        where = f"'{catalogue.parent}' holds another sweep, '{there.attrs['title']}', to which this one does not add"
        raise InputError(f"{where}:{numbered(faults)}\nname another folder, or remove it", tuple(faults))
    along = tuple(dim for dim in plan.grid.dims if dim in existing.grid.dims)
    return Additions(str(catalogue.absolute()), plan.grid.dims, tuple(places), along, opens)


def _conflicts(plan: Plan, existing: Plan) -> Iterator[str]:
    """Describe every difference between the two sweeps that forbids adding members."""
    grid, old_grid = plan.grid, existing.grid
    if model_words(grid.model) != model_words(old_grid.model):
        yield f"its model is another: its digest is {old_grid.model.digest[:16]}…, here {grid.model.digest[:16]}…"
    varying = {entry.name for _, entry in grid.columns} | {entry.name for _, entry in old_grid.columns}
    for name in sorted({*grid.asked, *old_grid.asked} - varying):
        if grid.asked.get(name) != old_grid.asked.get(name):
            yield (
                f"setting '{name}' is {old_grid.asked.get(name, 'that of the model')} there, here"
                f" {grid.asked.get(name, 'that of the model')}"
            )
    if plan.keeping.words != existing.keeping.words:
        yield f"keep is {', '.join(existing.keeping.words)} there, here {', '.join(plan.keeping.words)}"
    if plan.keeping.times.tolist() != existing.keeping.times.tolist():
        yield f"times are {_few(existing.keeping.times)} there, here {_few(plan.keeping.times)}"
    if plan.keeping.occurrences != existing.keeping.occurrences:
        yield f"occurrences are {existing.keeping.occurrences} there, here {plan.keeping.occurrences}"
    for old_axis in old_grid.axes:
        dim = named_among(grid.dims, old_axis.dim)
        new_axis = next((entry for entry in grid.axes if entry.dim == dim), None)
        if new_axis is None:
            yield f"its axis '{old_axis.dim}' is none of this sweep; give it too"
        elif dim != old_axis.dim:
            yield f"its axis is '{old_axis.dim}', as versions before called what is '{dim}' here"
        elif {_kind(entry) for entry in new_axis.columns} != {_kind(entry) for entry in old_axis.columns}:
            yield (
                f"its axis '{old_axis.dim}' varies {', '.join(entry.label for entry in old_axis.columns)}, here"
                f" {', '.join(entry.label for entry in new_axis.columns)}"
            )


def _few(times: Values) -> str:
    return f"{', '.join(f'{time:g}' for time in times[:4])}{' …' if times.size > 4 else ''}" if times.size else "none"


def _kind(column: AxisColumn) -> tuple[str, str]:
    return column.kind, column.name


def _places(axis: Axis, old_grid: SweepGrid, faults: list[str]) -> Places:
    """Find the values of an axis in an existing sweep; note a fault for values of the sweep that the axis lacks."""
    old_axis = next((entry for entry in old_grid.axes if entry.dim == axis.dim), None)
    if old_axis is None:
        rows = {_row([_shared(old_grid, entry) for entry in axis.columns]): 0}
        places = np.array([rows.get(entry, NONE) for entry in _rows(axis.columns)])
        if (places == NONE).all():
            faults.append(f"what it has for '{axis.dim}' is none of the values here; give it too")
        return places
    columns = [next(entry for entry in old_axis.columns if _kind(entry) == _kind(column)) for column in axis.columns]
    rows = {row: i for i, row in enumerate(_rows(columns))}
    places = np.array([rows.get(entry, NONE) for entry in _rows(axis.columns)])
    remaining = np.setdiff1d(np.arange(old_axis.size), places)
    missing = [i for i in remaining.tolist() if not _alike(axis.columns, columns, i)]
    if missing:
        first_missing = ", ".join(f"{entry.label} = {entry.values[missing[0]]}" for entry in columns)
        faults.append(
            f"it has {first_missing}{f' and {len(missing) - 1} more values' if len(missing) > 1 else ''}, which this"
            " sweep has not; give them too"
        )
    return places


def _rows(columns: Sequence[AxisColumn]) -> list[tuple[Any, ...]]:
    """Return the values along an axis: numbers in SI units, tables with their text."""
    return [_row(row) for row in zip(*(_values(column) for column in columns), strict=True)]


def _row(values: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(values)


def _values(column: AxisColumn) -> list[Any]:
    if column.tables:
        return list(zip(map(str, column.values), column.tables, strict=True))
    return [str(value) for value in column.values] if column.values.dtype == object else column.si.tolist()


def _shared(grid: SweepGrid, column: AxisColumn) -> Any:
    """Return the value that all members of a sweep share; None where it is the model's own setting."""
    if column.kind == PARAMETER:
        return _common({grid.model.statement.parameters[name].quantity.si for name in column.names})
    if column.kind == INITIAL:
        return _common({grid.model.statement.initial[name].si for name in column.names})
    if column.name not in grid.asked or column.tables:
        return None
    return _values(column_of(grid.model, column.name, [grid.asked[column.name]]))[0]


def _common(values: set[float]) -> float | None:
    """Return the value that all elements of a quantity have; None if they have several."""
    return values.pop() if len(values) == 1 else None


def _alike(new: Sequence[AxisColumn], old: Sequence[AxisColumn], i: int) -> bool:
    """Whether an old value is present up to rounding, as on a finer axis; such a member is marched again."""
    close = np.ones(len(new[0].values), bool)
    for new_column, old_column in zip(new, old, strict=True):
        if new_column.values.dtype == object or old_column.values.dtype == object:
            close &= np.array([value == _values(old_column)[i] for value in _values(new_column)])
        else:
            close &= np.abs(new_column.si - old_column.si[i]) <= ALIKE * np.maximum(
                np.abs(new_column.si), abs(old_column.si[i])
            )
    return bool(close.any())
