"""Members added to a folder that holds a sweep: which of them are there, and what was kept of those."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.faults import InputError, numbered
from xdynamics.sweeping.axes import INITIAL, PARAMETER, Axis, Column, column_of
from xdynamics.sweeping.collection import DIGEST, plan_of
from xdynamics.sweeping.grid import Grid
from xdynamics.sweeping.labels import ALIKE
from xdynamics.sweeping.members import Block, Plan, Values

if TYPE_CHECKING:
    import xarray as xr

NONE = -1
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Additions:
    """A sweep in a folder as a part of a larger one.

    Attributes
    ----------
    catalogue : str
        Its file.
    dims : tuple of str
        Of the larger sweep, in order.
    places : tuple of ndarray of int
        For each of them, where the smaller one has each value, `NONE` where it has not.
    along : tuple of str
        The dimensions that the smaller one has too.
    """

    catalogue: str
    dims: tuple[str, ...]
    places: tuple[Places, ...]
    along: tuple[str, ...]

    def there(self, block: Block) -> NDArray[np.bool_]:
        """Tell which members of a block are there, in the block's shape."""
        found = np.ones((), bool)
        for places, part in zip(self.places, block, strict=True):
            found = found[..., None] & (places[part] != NONE)
        return found

    def take(self, plan: Plan, block: Block, found: dict[str, Values]) -> NDArray[np.bool_]:
        """Put what was kept of members that are there into the arrays of a block; return which they are."""
        there = self.there(block)
        if there.any():
            which = {
                dim: np.maximum(places[part], 0)
                for dim, places, part in zip(self.dims, self.places, block, strict=True)
            }
            with archive.open_run(self.catalogue, check=False) as old:
                for one in plan.variables:
                    part = (
                        old[one.name].isel({dim: which[dim] for dim in self.along}).load()
                    )  # texts turn in memory alone
                    new = {dim: places.size for dim, places in which.items() if dim not in self.along}
                    values = part.expand_dims(new).transpose(*self.dims, *one.dims).values
                    found[one.name][there] = values[there]
        return there


def additions(plan: Plan, there: xr.Dataset, catalogue: Path) -> Additions:
    """Find out which members of a sweep are in a folder already.

    Raises
    ------
    InputError
        If what is there was marched by another model or other settings, or is none of the sweep; with every fault.
    """
    before = plan_of(there, plan.grid.model.functions)
    faults = list(_conflicts(plan, before))
    if not faults and before.digest != there.attrs[DIGEST]:
        faults.append("it was marched by another version of xdynamics, or of its elementary functions")
    places = [] if faults else [_places(axis, before.grid, faults) for axis in plan.grid.axes]
    if faults:
        where = f"'{catalogue.parent}' holds another sweep, '{there.attrs['title']}', to which this one does not add"
        raise InputError(f"{where}:{numbered(faults)}\nname another folder, or remove it", tuple(faults))
    along = tuple(dim for dim in plan.grid.dims if dim in before.grid.dims)
    return Additions(str(catalogue.absolute()), plan.grid.dims, tuple(places), along)


def _conflicts(plan: Plan, before: Plan) -> Iterator[str]:
    """Say what the two sweeps do not share."""
    now, then = plan.grid, before.grid
    if now.model.digest != then.model.digest:
        yield f"its model is another: its digest is {then.model.digest[:16]}…, here {now.model.digest[:16]}…"
    own = {one.name for _, one in now.columns} | {one.name for _, one in then.columns}
    for name in sorted({*now.asked, *then.asked} - own):
        if now.asked.get(name) != then.asked.get(name):
            yield f"setting '{name}' is {then.asked.get(name, 'that of the model')} there, here {now.asked.get(name, 'that of the model')}"  # fmt: skip
    if plan.keeping.words != before.keeping.words:
        yield f"keep is {', '.join(before.keeping.words)} there, here {', '.join(plan.keeping.words)}"
    if plan.keeping.times.tolist() != before.keeping.times.tolist():
        yield f"times are {_few(before.keeping.times)} there, here {_few(plan.keeping.times)}"
    if plan.keeping.occurrences != before.keeping.occurrences:
        yield f"occurrences are {before.keeping.occurrences} there, here {plan.keeping.occurrences}"
    for axis in then.axes:
        mine = next((one for one in now.axes if one.dim == axis.dim), None)
        if mine is None:
            yield f"its axis '{axis.dim}' is none of this sweep; give it too"
        elif {_kind(one) for one in mine.columns} != {_kind(one) for one in axis.columns}:
            yield f"its axis '{axis.dim}' varies {', '.join(one.label for one in axis.columns)}, here {', '.join(one.label for one in mine.columns)}"  # fmt: skip


def _few(times: Values) -> str:
    return f"{', '.join(f'{one:g}' for one in times[:4])}{' …' if times.size > 4 else ''}" if times.size else "none"


def _kind(column: Column) -> tuple[str, str]:
    return column.kind, column.name


def _places(axis: Axis, before: Grid, faults: list[str]) -> Places:
    """Find where a sweep has the values of an axis; note those that it has and the axis has not."""
    then = next((one for one in before.axes if one.dim == axis.dim), None)
    if then is None:
        rows = {_row([_shared(before, one) for one in axis.columns]): 0}
        found = np.array([rows.get(one, NONE) for one in _rows(axis.columns)])
        if (found == NONE).all():
            faults.append(f"what it has for '{axis.dim}' is none of the values here; give it too")
        return found
    columns = [next(one for one in then.columns if _kind(one) == _kind(mine)) for mine in axis.columns]
    rows = {row: i for i, row in enumerate(_rows(columns))}
    found = np.array([rows.get(one, NONE) for one in _rows(axis.columns)])
    left = np.setdiff1d(np.arange(then.size), found)
    lost = [i for i in left.tolist() if not _alike(axis.columns, columns, i)]
    if lost:
        said = ", ".join(f"{one.label} = {one.values[lost[0]]}" for one in columns)
        faults.append(f"it has {said}{f' and {len(lost) - 1} more values' if len(lost) > 1 else ''}, which this sweep has not; give them too")  # fmt: skip
    return found


def _rows(columns: Sequence[Column]) -> list[tuple[Any, ...]]:
    """Return the values along an axis, numbers in SI units: a table with its text."""
    return [_row(row) for row in zip(*(_values(one) for one in columns), strict=True)]


def _row(values: Sequence[Any]) -> tuple[Any, ...]:
    return tuple(values)


def _values(column: Column) -> list[Any]:
    if column.tables:
        return list(zip(map(str, column.values), column.tables, strict=True))
    return [str(one) for one in column.values] if column.values.dtype == object else column.si.tolist()


def _shared(grid: Grid, column: Column) -> Any:
    """Return the value of something that does not vary in a sweep; None where it is the model's own setting."""
    if column.kind == PARAMETER:
        return grid.model.parameters[column.name].quantity.si
    if column.kind == INITIAL:
        return grid.model.initial[column.name].si
    if column.name not in grid.asked or column.tables:
        return None
    return _values(column_of(grid.model, column.name, [grid.asked[column.name]]))[0]


def _alike(new: Sequence[Column], old: Sequence[Column], i: int) -> bool:
    """Whether a value is there but for rounding: that of a finer axis say, which is marched anew."""
    close = np.ones(len(new[0].values), bool)
    for mine, then in zip(new, old, strict=True):
        if mine.values.dtype == object or then.values.dtype == object:
            close &= np.array([one == _values(then)[i] for one in _values(mine)])
        else:
            close &= np.abs(mine.si - then.si[i]) <= ALIKE * np.maximum(np.abs(mine.si), abs(then.si[i]))
    return bool(close.any())
