"""A run's rows as they are stored: in memory, or in chunks of a file, each of which is read once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.shortened_steps import model_of
from xdynamics.evidence.memory import most_megabytes
from xdynamics.model import Model
from xdynamics.model.reactions import reactions
from xdynamics.record.columns import state_name
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import STEPS

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Functions = Any

KEPT_ROLES = ("coordinate", "velocity", "state", "energy", "observable")  # columns that are looked at more than once


@dataclass(frozen=True)
class Part:
    """Consecutive rows of some columns, with the row before them and the row after them, where there are such.

    Attributes
    ----------
    first, count : int
        The first row of the part itself, and how many it has.
    before : int
        How many rows of the columns lie before it: 0 or 1.
    columns : dict of str to ndarray, shape (before + count + 0 or 1,)
    """

    first: int
    count: int
    before: int
    columns: dict[str, Any]

    def own(self, name: str) -> Any:
        """Return a column without the neighbours."""
        return self.columns[name][self.before : self.before + self.count]

    @property
    def numbers(self) -> Rows:
        """The numbers of all rows, neighbours included."""
        size = len(next(iter(self.columns.values())))
        return np.arange(self.first - self.before, self.first - self.before + size)


class Chunks:
    """The rows of a run record.

    Times are kept; and what steps need to be repeated, energies and observables as long as there is room: as many MB as
    results of stages may take ($XDYNAMICS_REMEMBERED_LIMIT). Of longer runs chunks are read again where they are needed
    again.

    Parameters
    ----------
    run : xarray.Dataset
    model : Model
    """

    def __init__(self, run: xr.Dataset, model: Model) -> None:
        self.run, self.model = run, model
        self.size = int(run.sizes[STEPS])
        self._columns: dict[str, _Column] = {}
        self._room = most_megabytes() * 1e6
        words = {state_name(reaction) for reaction in reactions(model)} | {
            reaction.name for reaction in reactions(model)
        }
        needed = {"time", "step_size", "regime", "row_kind", *words, *model.units}
        self._kept = [
            str(name)
            for name, variable in run.variables.items()
            if variable.dims == (STEPS,) and (name in needed or variable.attrs.get("role") in KEPT_ROLES)
        ]

    @classmethod
    def of(cls, run: xr.Dataset | Chunks, functions: Functions = None) -> Chunks:
        """Return the rows of a run; what is that already, as it is."""
        return run if isinstance(run, Chunks) else cls(run, model_of(run, functions))

    @cached_property
    def is_stored(self) -> bool:
        """Whether there is anything to be read."""
        return any(variable.chunks is not None for variable in self.run.variables.values())

    def parts(self, *names: str) -> Iterator[Part]:
        """Yield all rows of some columns in order, as they are stored."""
        columns = [self._column(name) for name in names]
        borders = np.unique(np.concatenate([column.borders for column in columns]))
        for begin, end in pairwise(borders.tolist()):
            low, high = max(begin - 1, 0), min(end + 1, self.size)
            self._read(columns, low, high)
            values = {name: column.stretch(low, high) for name, column in zip(names, columns, strict=True)}
            yield Part(begin, end - begin, begin - low, values)
            for name, column in zip(names, columns, strict=True):
                self._forget(name, column, end - 1)
        for name, column in zip(names, columns, strict=True):
            self._forget(name, column, self.size)

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield all rows in order, as they are stored, each time as `near` does."""
        borders = np.unique(np.concatenate([self._column(name).borders for name in self._kept]))
        for begin, end in pairwise(borders.tolist()):
            yield self.near(np.arange(begin, end))

    def at(self, name: str, rows: Any) -> Any:
        """Return values of a column in some rows, in any order."""
        column, rows = self._column(name), np.asarray(rows, np.int64)
        values = None
        chunks = np.searchsorted(column.borders, rows, side="right") - 1
        for chunk in np.unique(chunks).tolist():
            begin, end = column.borders[chunk : chunk + 2].tolist()
            self._read([column], begin, end)
            part = column.stretch(begin, end)
            values = np.empty(rows.shape, part.dtype) if values is None else values
            values[chunks == chunk] = part[rows[chunks == chunk] - begin]
            self._forget(name, column, end)
        return np.zeros(rows.shape) if values is None else values

    def count(self, times: Floats, side: Literal["left", "right"]) -> Rows:
        """Count the rows before times, or up to and including them."""
        rows = np.zeros(times.shape, np.int64)
        for part in self.parts("time"):
            rows += np.searchsorted(part.own("time"), times, side=side)
        return rows

    def near(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record in memory in which steps from and to some rows can be repeated, and where these rows are in it.

        It has all columns that are kept, of these rows, of their neighbours, and of all rows at the same times. Of a
        run in memory it is the run.
        """
        import xarray as xr

        rows = np.asarray(rows, np.int64)
        if not self.is_stored:
            return self.run, rows
        wanted = self._with_neighbours(np.unique(rows))
        columns = {name: (STEPS, self.at(name, wanted), self.run[name].attrs) for name in self._kept}
        others = {name: variable for name, variable in self.run.variables.items() if STEPS not in variable.dims}
        return xr.Dataset(others | columns, attrs=self.run.attrs), np.searchsorted(wanted, rows)

    def _with_neighbours(self, rows: Rows) -> Rows:
        """Add the rows before and after, and all at the same times: which of them a time belongs to is then decided alike."""
        wanted = np.unique(np.clip(np.concatenate([rows - 1, rows, rows + 1]), 0, self.size - 1))
        while True:
            edges = np.unique(np.clip(np.concatenate([wanted - 1, wanted, wanted + 1]), 0, self.size - 1))
            tied = edges[np.isin(self.at("time", edges), self.at("time", wanted))]
            if tied.size == wanted.size:
                return wanted
            wanted = tied

    def _column(self, name: str) -> _Column:
        if name not in self._columns:
            self._columns[name] = _Column(self.run[name].variable)
        return self._columns[name]

    def _read(self, columns: Sequence[_Column], begin: int, end: int) -> None:
        """Read what is missing of some rows, all chunks at once."""
        missing = [(column, chunk) for column in columns for chunk in column.missing(begin, end)]
        if not missing:
            return
        import dask.base

        compute: Any = dask.base.compute  # it is not typed
        for (column, chunk), values in zip(
            missing, compute(*(column.block(chunk) for column, chunk in missing)), strict=True
        ):
            column.read[chunk] = values

    def _forget(self, name: str, column: _Column, row: int) -> None:
        """Forget the chunks before a row, but for those that are kept."""
        for chunk in [chunk for chunk in column.read if column.borders[chunk + 1] <= row and chunk not in column.kept]:
            size = column.read[chunk].nbytes
            if name == "time" or (name in self._kept and size <= self._room):
                self._room -= size
                column.kept.add(chunk)
            else:
                del column.read[chunk]


class Unread(Chunks):
    """The rows of a run that is not marched or not to be read yet: how many there are, and of which columns.

    Attributes
    ----------
    listed : int
        How many cycles and turns are to be described.
    """

    def __init__(self, run: xr.Dataset, model: Model, listed: int) -> None:
        super().__init__(run, model)
        self.listed = listed

    def parts(self, *names: str) -> Iterator[Part]:  # noqa: ARG002 - as of rows that can be read
        """Yield none."""
        yield from ()

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield none."""
        yield from ()

    def at(self, name: str, rows: Any) -> Any:  # noqa: ARG002 - as of rows that can be read
        """Return zeros."""
        return np.zeros(np.shape(rows))

    def near(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record without rows."""
        import xarray as xr

        empty = {
            name: (variable.dims, np.zeros([0] * variable.ndim), variable.attrs)
            for name, variable in self.run.variables.items()
            if STEPS in variable.dims
        }
        others = {name: variable for name, variable in self.run.variables.items() if variable.chunks is None}
        return xr.Dataset(others | empty, attrs=self.run.attrs), np.asarray(rows, np.int64)


@dataclass
class _Column:
    """A variable along `step`, and which of its chunks have been read."""

    variable: xr.Variable
    read: dict[int, Any] = field(default_factory=dict)
    kept: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        sizes = self.variable.chunks[0] if self.variable.chunks else self.variable.shape
        self.borders = np.concatenate([[0], np.cumsum([size for size in sizes if size])]).astype(np.int64)
        self._places = [k for k, size in enumerate(sizes) if size]
        if not self.variable.chunks:
            self.read[0] = np.asarray(self.variable)
            self.kept.add(0)

    def missing(self, begin: int, end: int) -> list[int]:
        """List the chunks of some rows that have to be read."""
        return [chunk for chunk in self._of(begin, end) if chunk not in self.read]

    def block(self, chunk: int) -> Any:
        """Return a chunk as a lazy array."""
        return self.variable.data.blocks[self._places[chunk]]

    def stretch(self, begin: int, end: int) -> Any:
        """Return consecutive rows, of chunks that have been read."""
        parts = [
            self.read[chunk][max(begin - low, 0) : end - low]
            for chunk in self._of(begin, end)
            for low in self.borders[chunk : chunk + 1].tolist()
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _of(self, begin: int, end: int) -> range:
        """Number the chunks in which rows are."""
        first, last = np.searchsorted(self.borders, [begin, end - 1], side="right").tolist()
        return range(first - 1, last)


def with_roles(run: xr.Dataset, roles: tuple[str, ...]) -> list[str]:
    """Name the variables along `step` that have one of some roles."""
    return [
        str(name)
        for name in run.data_vars
        if (variable := run.variables[name]).attrs.get("role") in roles and variable.dims == (STEPS,)
    ]
