"""Rows of a stored run: which chunks of a file hold them, and which rows a repeated step needs.

Variables along a dimension are read as they are stored: from memory, or from chunks of a file, each of which is read
once.

Elements of a quantity with dimensions are stored in one array. Where they are read as variables of their own, the first
read of a chunk also supplies the other elements of that chunk.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import links_of_rows, model_of_record
from xdynamics.evidence.observables import reaction_columns
from xdynamics.evidence.stage_tasks import remembered_megabytes
from xdynamics.kernels.layout import layout_of
from xdynamics.model import Model
from xdynamics.record import unfolding
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import INTEGRATED, STEP_NUMBER, STEPS

if TYPE_CHECKING:
    import xarray as xr

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class RowRange:
    """Consecutive rows of some columns, with the row before them and the row after them, where there are such.

    Attributes
    ----------
    first, count : int
        The first row of the part itself, and how many it has.
    rows_before : int
        How many rows of the columns lie before it: 0 or 1.
    columns : dict of str to ndarray, shape (rows_before + count + 0 or 1, ...)
    """

    first: int
    count: int
    rows_before: int
    columns: dict[str, Any]

    def own_rows(self, name: str) -> Any:
        """Return a column without the neighbours."""
        return self.columns[name][self.rows_before : self.rows_before + self.count]

    @property
    def row_numbers(self) -> Rows:
        """The numbers of all rows, neighbours included."""
        size = len(next(iter(self.columns.values())))
        return np.arange(self.first - self.rows_before, self.first - self.rows_before + size)


class StoredColumns:
    """Variables along one dimension.

    Parameters
    ----------
    run : xarray.Dataset
    dim : str
    cached_names : collection of str
        Variables whose chunks are kept once they were read, as long as there is room.
    room : float, bytes
        Of longer columns chunks are read again where they are needed again.
    lasting : collection of str
        Variables that are kept even so.
    """

    def __init__(
        self, run: xr.Dataset, dim: str, *, cached_names: Collection[str], room: float, lasting: Collection[str] = ()
    ) -> None:
        self.run = run
        self.size = int(run.sizes[dim])
        self._cached_names, self._room, self._lasting = cached_names, room, lasting
        self._columns: dict[str, _Column] = {}

    def parts(self, *names: str) -> Iterator[RowRange]:
        """Yield all rows of some columns in order, as they are stored."""
        columns = [self._column(name) for name in names]
        borders = np.unique(np.concatenate([column.borders for column in columns]))
        for begin, end in pairwise(borders.tolist()):
            low, high = max(begin - 1, 0), min(end + 1, self.size)
            self._read_missing_chunks(columns, low, high)
            values = {name: column.row_stretch(low, high) for name, column in zip(names, columns, strict=True)}
            yield RowRange(begin, end - begin, begin - low, values)
            for column in columns:
                # the last row is read once more, as the row before the next part
                self._forget_chunks(column, end - 1)
        for column in columns:
            self._forget_chunks(column, self.size)

    def values_at(self, name: str, rows: Any) -> Any:
        """Return values of a column in some rows, in any order."""
        column, rows = self._column(name), np.asarray(rows, np.int64)
        values = None
        chunks = np.searchsorted(column.borders, rows, side="right") - 1
        for chunk in np.unique(chunks).tolist():
            begin, end = column.borders[chunk : chunk + 2].tolist()
            self._read_missing_chunks([column], begin, end)
            part = column.row_stretch(begin, end)
            values = np.empty((*rows.shape, *part.shape[1:]), part.dtype) if values is None else values
            values[chunks == chunk] = part[rows[chunks == chunk] - begin]
            self._forget_chunks(column, end)
        return np.zeros((*rows.shape, *column.variable.shape[1:])) if values is None else values

    def _column(self, name: str) -> _Column:
        if name not in self._columns:
            self._columns[name] = _Column(name, unfolding.get_column(self.run, name))
        return self._columns[name]

    @cached_property
    def _elements_by_array(self) -> dict[str, list[str]]:
        """The cached variables that are elements of one stored array, by that array's name."""
        sources: dict[str, list[str]] = {}
        for name in self._cached_names:
            if (source := _source(self.run.variables[name])) is not None:
                sources.setdefault(source, []).append(name)
        return sources

    def _chunk_neighbours(self, column: _Column, chunk: int) -> Iterator[_Column]:
        """Yield the cached columns whose values lie in the same chunk of a file and are not read yet."""
        for name in self._elements_by_array.get(_source(column.variable) or "", ()) if self._room > 0 else ():
            neighbour = self._column(name)
            if chunk not in neighbour.read and np.array_equal(neighbour.borders, column.borders):
                yield neighbour

    def _read_missing_chunks(self, columns: Sequence[_Column], begin: int, end: int) -> None:
        """Read the chunks of some rows that are not in memory, all at once."""
        missing = [(column, chunk) for column in columns for chunk in column.missing_chunks(begin, end)]
        if not missing:
            return
        import dask.base

        queued = {(column.name, chunk) for column, chunk in missing}
        for column, chunk in [*missing]:
            chunk_neighbours = [
                (neighbour, chunk)
                for neighbour in self._chunk_neighbours(column, chunk)
                if (neighbour.name, chunk) not in queued
            ]
            queued |= {(neighbour.name, chunk) for neighbour, _ in chunk_neighbours}
            missing += chunk_neighbours
        compute: Any = dask.base.compute  # it is not typed
        blocks = compute(*(column.block(chunk) for column, chunk in missing))
        for (column, chunk), values in zip(missing, blocks, strict=True):
            column.read[chunk] = values
        for column, chunk in missing:
            if column not in columns:
                self._keep_chunk(column, chunk)

    def _forget_chunks(self, column: _Column, row: int) -> None:
        """Forget the chunks before a row, except cached ones."""
        for chunk in [
            chunk for chunk in column.read if column.borders[chunk + 1] <= row and chunk not in column.kept_chunks
        ]:
            self._keep_chunk(column, chunk)

    def _keep_chunk(self, column: _Column, chunk: int) -> None:
        """Keep a chunk that was read, or forget it where there is no room."""
        size = column.read[chunk].nbytes
        if column.name in self._lasting or (column.name in self._cached_names and size <= self._room):
            self._room -= size
            column.kept_chunks.add(chunk)
        else:
            del column.read[chunk]


def _source(variable: xr.Variable) -> str | None:
    """Name the array of dask that a variable is an element of; None where it is none."""
    if variable.chunks is None:
        return None
    sources: set[str] = variable.data.dask.dependencies[variable.data.name]
    return next(iter(sources)) if len(sources) == 1 else None


# equal by identity: fields hold arrays, and columns are looked for in lists
@dataclass(eq=False)
class _Column:
    """A variable along `step`, and which of its chunks have been read."""

    name: str
    variable: xr.Variable
    read: dict[int, Any] = field(default_factory=dict)
    kept_chunks: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        sizes = self.variable.chunks[0] if self.variable.chunks else self.variable.shape[:1]
        # a chunk without rows would give two equal borders, and searches one of the wrong number
        self.borders = np.concatenate([[0], np.cumsum([size for size in sizes if size])]).astype(np.int64)
        self._places = [k for k, size in enumerate(sizes) if size]
        if not self.variable.chunks:
            self.read[0] = np.asarray(self.variable)
            self.kept_chunks.add(0)

    def missing_chunks(self, begin: int, end: int) -> list[int]:
        """List the chunks of some rows that have to be read."""
        return [chunk for chunk in self._chunks_of_rows(begin, end) if chunk not in self.read]

    def block(self, chunk: int) -> Any:
        """Return a chunk as a lazy array."""
        return self.variable.data.blocks[self._places[chunk]]

    def row_stretch(self, begin: int, end: int) -> Any:
        """Return consecutive rows, of chunks that have been read."""
        parts = [
            self.read[chunk][max(begin - low, 0) : end - low]
            for chunk in self._chunks_of_rows(begin, end)
            for low in self.borders[chunk : chunk + 1].tolist()
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _chunks_of_rows(self, begin: int, end: int) -> range:
        """Number the chunks in which rows are."""
        first, last = np.searchsorted(self.borders, [begin, end - 1], side="right").tolist()
        return range(first - 1, last)


Floats = NDArray[np.float64]
Functions = Any

KEPT_ROLES = (*INTEGRATED, "energy", "observable")  # columns that are looked at more than once


class Chunks(StoredColumns):
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
        self.model = model
        contacts = {name for by_element in (False, True) for name in reaction_columns(model, by_element=by_element)}
        needed = {"time", "step_size", "regime", "row_kind", STEP_NUMBER.name, *contacts, *model.elements.units}
        needed |= {block.name for block in layout_of(model).used.blocks}
        cached_names = [
            str(name)
            for name, variable in run.variables.items()
            if variable.dims[:1] == (STEPS,) and (name in needed or variable.attrs.get("role") in KEPT_ROLES)
        ]
        super().__init__(run, STEPS, cached_names=cached_names, room=remembered_megabytes() * 1e6, lasting=("time",))

    @classmethod
    def of(cls, run: xr.Dataset | Chunks, functions: Functions = None) -> Chunks:
        """Return the rows of a run; `Chunks` are returned unchanged."""
        return run if isinstance(run, Chunks) else cls(run, model_of_record(run, functions))

    @cached_property
    def is_stored(self) -> bool:
        """Whether there is anything to be read."""
        return any(variable.chunks is not None for variable in self.run.variables.values())

    @cached_property
    def _borders(self) -> list[int]:
        """The rows at which chunks of any cached column begin, and the number of rows at the end."""
        borders: list[int] = np.unique(
            np.concatenate([self._column(name).borders for name in self._cached_names])
        ).tolist()
        return borders

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield all rows in order, as they are stored, each time as `near` does."""
        for begin, end in pairwise(self._borders):
            yield self.nearby_record(np.arange(begin, end))

    def count(self, times: Floats, side: Literal["left", "right"]) -> Rows:
        """Count the rows before times, or up to and including them."""
        rows = np.zeros(times.shape, np.int64)
        for part in self.parts("time"):
            rows += np.searchsorted(part.own_rows("time"), times, side=side)
        return rows

    def nearby_record(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record in memory that repeats steps between some rows, and the positions of these rows in it.

        It has all columns that are kept, of these rows, of their neighbours, and of all rows at the same times. Of a
        run in memory it is the run.
        """
        import xarray as xr

        rows = np.asarray(rows, np.int64)
        if not self.is_stored:
            return self.run, rows
        needed_rows = self._with_neighbours(np.unique(rows))
        cached_variables = {name: self.run.variables[name] for name in self._cached_names}
        columns = {
            name: (cached_variable.dims, self.values_at(name, needed_rows), cached_variable.attrs)
            for name, cached_variable in cached_variables.items()
        }
        rowless_variables = {
            name: variable for name, variable in self.run.variables.items() if STEPS not in variable.dims
        }
        links = links_of_rows(self.run, columns[STEP_NUMBER.name][1]) if STEP_NUMBER.name in columns else {}
        return xr.Dataset(rowless_variables | links | columns, attrs=self.run.attrs), np.searchsorted(needed_rows, rows)

    def load_variables(self, run: xr.Dataset) -> xr.Dataset:
        """Return a record with its variables in memory; cached ones are not read again."""
        rows = np.arange(self.size)
        read = {
            name: (run.variables[name].dims, self.values_at(name, rows), run.variables[name].attrs)
            for name in self._cached_names
            if name in run.variables
        }
        return run.assign(read).compute()

    def _with_neighbours(self, rows: Rows) -> Rows:
        """Add neighbouring rows, and all rows at equal times, so that a time finds the same row as in the full run."""
        needed_rows = np.unique(np.clip(np.concatenate([rows - 1, rows, rows + 1]), 0, self.size - 1))
        while True:
            # rows at one time may go on for long: added until there are no more
            edges = np.unique(
                np.clip(np.concatenate([needed_rows - 1, needed_rows, needed_rows + 1]), 0, self.size - 1)
            )
            tied = edges[np.isin(self.values_at("time", edges), self.values_at("time", needed_rows))]
            if tied.size == needed_rows.size:
                return needed_rows
            needed_rows = tied


class Unread(Chunks):
    """The rows of a run that is not marched or not to be read yet: how many there are, and of which columns.

    Attributes
    ----------
    listed_count : int
        How many cycles and turns are to be described.
    """

    def __init__(self, run: xr.Dataset, model: Model, listed_count: int) -> None:
        super().__init__(run, model)
        self.listed_count = listed_count

    def parts(self, *names: str) -> Iterator[RowRange]:  # noqa: ARG002 - as of rows that can be read
        """Yield none."""
        yield from ()

    def stretches(self) -> Iterator[tuple[xr.Dataset, Rows]]:
        """Yield none."""
        yield from ()

    def values_at(self, name: str, rows: Any) -> Any:  # noqa: ARG002 - as of rows that can be read
        """Return zeros."""
        return np.zeros(np.shape(rows))

    def nearby_record(self, rows: Any) -> tuple[xr.Dataset, Rows]:
        """Return a record without rows."""
        import xarray as xr

        empty = {
            name: (variable.dims, np.zeros([0] * variable.ndim), variable.attrs)
            for name, variable in self.run.variables.items()
            if STEPS in variable.dims
        }
        eager_variables = {name: variable for name, variable in self.run.variables.items() if variable.chunks is None}
        return xr.Dataset(eager_variables | empty, attrs=self.run.attrs), np.asarray(rows, np.int64)


def with_roles(run: xr.Dataset, roles: tuple[str, ...]) -> list[str]:
    """Name the variables along `step` that have one of some roles."""
    return [
        str(name)
        for name in run.data_vars
        if (variable := run.variables[name]).attrs.get("role") in roles and variable.dims[:1] == (STEPS,)
    ]
