"""A march as one Dataset, the check that a Dataset is a run record, and the memory that a record needs."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from mmap import mmap
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.faults import InputError, numbered_lines
from xdynamics.kernels import Layout
from xdynamics.keywords import FULL
from xdynamics.march import LogBlock, March
from xdynamics.march.equation_solvers import solver_of
from xdynamics.march.log import map_pages
from xdynamics.methods.steppers import NOTHING
from xdynamics.record import provenance
from xdynamics.record.column import Column, LineOf
from xdynamics.record.conformity import faults_of
from xdynamics.record.folded_columns import sizes_of
from xdynamics.record.folding import check_elements, model_dimensions
from xdynamics.record.run_columns import columns, constants, followed_tolerances
from xdynamics.runtime.files import ROOM, UNITS, displayed_path, free_memory, size_text
from xdynamics.shapes.blocks import Block
from xdynamics.units import TIME, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

SMALL = 1e6  # bytes of a log that always fit, so that the free memory is not looked up


def bytes_of_row(layout: Layout, samples: int) -> int:
    """Return how many bytes a row of the log has, with its force samples."""
    return 8 * layout.row.size + layout.flags + samples * 8 * layout.sample.size


def bytes_of_rows(march: March, rows: float) -> float:
    """Return how many bytes so many rows of a march take."""
    return rows * bytes_of_row(march.layout, int(march.run.plan[0].samples))


def memory_asked(memory: str | float | None) -> float | None:
    """Read a size of memory: a number of bytes, or a text like ``"2 GB"``.

    Raises
    ------
    InputError
        If it is no positive size.

    Examples
    --------
    >>> memory_asked("2 GB"), memory_asked(1e6), memory_asked(None)
    (2000000000.0, 1000000.0, None)
    """
    if memory is None:
        return None
    match = re.fullmatch(r"\s*([0-9.eE+]+)\s*([kMGT]?B)?\s*", str(memory))
    try:
        size = float(match[1]) * UNITS[match[2] or "B"] if match and not isinstance(memory, bool) else 0.0
    except ValueError:
        size = 0.0
    if not 0.0 < size < float("inf"):
        raise InputError(f"memory is {memory!r}, needs a positive size like '2 GB', or a number of bytes")
    return size


def check_record_room(march: March, memory: str | float | None = None, path: Any = None) -> None:
    """Check before a march that its log will fit; rows of steps that are chosen, and of events, are judged as they come.

    Parameters
    ----------
    march : March
    memory : str or float, optional
        The most that a log kept in memory may take; by default four fifths of the free memory.
    path : str or Path, optional
        The file that the log is streamed to, in bounded memory.

    Raises
    ------
    InputError
        With the number of rows, the room that they take and the room that is available.
    """
    _check_march(march)
    allowed, rows = memory_asked(memory), march.expected_rows
    if rows is None:
        return
    kept_rows = rows / march.settings.keep_every
    needed = bytes_of_rows(march, kept_rows)
    need_text = f"the run makes {rows:.4g} rows, which take {size_text(needed)}"
    if march.settings.keep_every > 1:
        need_text = f"the run makes {rows:.4g} rows and keeps {kept_rows:.4g} of them, which take {size_text(needed)}"
    if path is not None:
        try:
            total, _, free = shutil.disk_usage(Path(path).absolute().parent)
        except (OSError, ValueError):  # no folder: refused by its name before anything is marched into it
            return
        if total and needed > free:  # of no size is a file system that keeps no files, like /proc, which says so itself
            raise InputError(
                f"{need_text}, and the disk of '{path}' has {size_text(free)} free; take a longer step or an earlier end"
            )
        return
    if allowed is None and needed < SMALL:
        return
    room = ROOM * free_memory() if allowed is None else allowed
    if needed > room:
        limit = f"{size_text(room)} of memory {'can be had' if allowed is None else 'were allowed'}"
        raise InputError(
            f"{need_text}, and {limit}; give path=… to stream them to a file, keep_every=n to keep one row in n, a longer"
            " step or an earlier end"
        )


def check_growth(march: March, bytes_taken: float, more: float, memory: str | float | None = None) -> None:
    """Check during a march that there is room for more of its record, whose rows could not be counted before.

    Parameters
    ----------
    march : March
    bytes_taken, more : float, bytes
        What its record takes so far, and what it will take beyond that.
    memory : str or float, optional
        The most that it may take; by default it may take four fifths of the memory that is left.

    Raises
    ------
    InputError
        With the time it has come to, its rows, the room that they take and the room that is available.
    """
    if memory is None and more < SMALL:
        return
    allowed = memory_asked(memory)
    room = ROOM * free_memory() if allowed is None else allowed
    if (more if allowed is None else bytes_taken + more) <= room:
        return
    limit = f"{size_text(room)} more can be had" if allowed is None else f"{size_text(room)} were allowed"
    rows, of_events, now = (
        int(march.now.rows),
        2 * march.event_pairs,
        march.now.t * march.settings.scales.si_factor(TIME),
    )
    reached = f"the run of '{march.model.name}' is at t = {now:.6g}{unit_suffix(march.model.time_unit)}"
    if 2 * of_events < rows:
        raise InputError(
            f"{reached} with {rows} rows, which take {size_text(bytes_taken)} of memory, and {limit}; give path=… to stream"
            " them to a file, keep_every=n to keep one row in n, larger tolerances or an earlier end"
        )
    raise InputError(
        f"{reached} with {rows} rows, {of_events} of them of events, which take {size_text(bytes_taken)} of memory, and"
        f" {limit}; each event has two rows of all elements: take one event for all of them, by max(…, dimension) or"
        " sum(…, dimension), name what is logged (log=['…']), or give path=… to stream them to a file"
    )


def sizes_of_march(march: March) -> dict[str, float]:
    """Return the bytes of a march's working arrays, by description, before any of them is allocated.

    The law is written first, which takes less than its arrays.
    """
    layout, law = march.layout, march.law
    sizes = {
        "states at both ends of a step": 16.0 * layout.record.size,
        "errors, tolerances and sizes": (28.0 if march.settings.adaptive else 2.0) * layout.used.size,
        "a row of the log": 8.0 * layout.row.size,
    }
    return sizes | solver_of(march.settings.method).sizes(law)


def _check_march(march: March) -> None:
    """Check that a march itself has room: its states and two rows of its log, then what its method needs beside them."""
    layout, room = march.layout, ROOM * free_memory()
    solves = march.settings.method.solver != NOTHING
    minimum_bytes = 8.0 * (2 * layout.record.size + layout.row.size)
    if minimum_bytes + 24.0 * solves * layout.used.size**2 < SMALL:
        return
    try:
        sizes = sizes_of_march(march) if minimum_bytes <= room else {}
    except MemoryError:
        sizes = {"what its method solves": room}
    needed = max(minimum_bytes, sum(sizes.values()))
    if needed > room:
        largest = max(sizes, key=sizes.__getitem__, default="")
        of_it = f", {size_text(sizes[largest])} of it {largest}," if largest else ""
        remedy = "fewer elements" + ", or a method that solves no equations" * solves
        raise InputError(
            f"a run of {layout.used.size} numbers by {march.settings.method.name} takes about {size_text(needed)}{of_it}"
            f" beside its record, and {size_text(room)} of memory can be had; take {remedy}"
        )


Array = NDArray[Any]

TIME_VARIABLE = "time"
WIDE = 1 << 16  # numbers of a row of a column from which it is half a megabyte
WIDEST = 1 << 19  # from which pages of its own are worth their faults: they leave no holes on the heap
KNOWN_BEFORE = ("parameter", "model", schema.LABEL, schema.LINK)  # roles of what is known before a march


def dataset(
    march: March, earlier_parts: Iterable[tuple[str, Array]] = (), memory: str | float | None = None
) -> xr.Dataset:
    """March and return the complete run in memory.

    Parameters
    ----------
    march : March
    earlier_parts : iterable of (str, ndarray)
        Rows that precede those of the march, taken before its first block is requested.
    memory : str or float, optional
        The most that they may take, as `check_growth` has it.

    Raises
    ------
    InputError
        If more rows come, of events or of steps that are chosen, than there is room for.
    """
    spec = columns(march)
    earlier_parts = [*earlier_parts]
    march.witnesses.elsewhere = not earlier_parts and _has_states(march, spec)
    gathered = _gather_columns(march, spec, earlier_parts, memory)
    tolerances = followed_tolerances(march)
    filled = [
        (_with_final_attributes(column.variable, tolerances), gathered.pop(column.variable.name).joined_rows())
        for column in spec
    ]
    if march.witnesses.elsewhere:
        values_by_name = {variable.name: values for variable, values in filled}
        columns_of = [[values_by_name[block.name] for block in blocks] for blocks in _judged_by(march)]
        march.witnesses.read_in(*columns_of)
    filled += [(variable, np.asarray(value)) for variable, value in constants(march)]
    return _assemble_dataset(filled, provenance.run_attributes(march))


def _has_states(march: March, spec: Sequence[Column]) -> bool:
    """Whether a record has every state of a march to the bit, and states are too large to be stored twice."""
    if not march.settings.keeps_states or march.layout.used.size < WIDE or march.layout.is_doubled:
        return False
    takes = {column.variable.name: column.take for column in spec}
    used = [takes.get(block.name) for block in chain(*_judged_by(march))]
    # a factor other than 1 would have rounded the states
    return all(isinstance(take, LineOf) and take.factor == 1.0 for take in used)


def _judged_by(march: March) -> tuple[Sequence[Block], Sequence[Block]]:
    """Return the states, and the estimated errors, by which a march is judged when it is over."""
    return march.layout.used.blocks, march.layout.errors.blocks[1:] if march.estimated else ()


def described(march: March, sizes: Mapping[str, int]) -> xr.Dataset:
    """Return the record of a march before it begins: zeros of given sizes stand for logged values.

    Variables along dimensions of no given size are left out, and attributes that are known after the march only.
    """
    known_sizes = {**sizes, schema.BOUNDS: 2, **sizes_of(march)}
    variables = [column.variable for column in columns(march)]
    filled = [
        (variable, np.zeros([known_sizes[dim] for dim in variable.dims], variable.dtype))
        for variable in variables
        if {*variable.dims} <= {*known_sizes}
    ]
    filled += [
        (variable, np.asarray(value))
        for variable, value in constants(march)
        if variable.role in KNOWN_BEFORE or variable.name == schema.GIVEN_STEP.name
    ]
    return _assemble_dataset(filled, provenance.settings_used(march))


def foreseen(march: March) -> xr.Dataset:
    """Return all variables that the record of a march will have, before it begins: a row of zeros of each, and no event."""
    sizes = (
        dict.fromkeys((schema.STEPS, schema.TRIALS, schema.SAMPLES), 1)
        | {schema.EVENTS: 0, schema.BOUNDS: 2}
        | sizes_of(march)
    )
    filled = [
        (column.variable, np.zeros([sizes.get(dim, 0) for dim in column.variable.dims], column.variable.dtype))
        for column in columns(march)
    ]
    return _assemble_dataset(
        [*filled, *((variable, np.asarray(value)) for variable, value in constants(march))],
        provenance.settings_used(march),
    )


def _assemble_dataset(filled: Sequence[tuple[schema.Variable, Array]], attributes: dict[str, Any]) -> xr.Dataset:
    """Return the variables of one march as a Dataset, without aligning, comparing or copying them.

    xarray's public constructors take each of some hundred variables apart several times, longer than a short march
    lasts; the result is the same, and dimensions of unequal number or sizes are refused here too.
    """
    import xarray as xr

    variables = {}
    for variable, data in sorted(filled, key=lambda pair: pair[0].name == TIME_VARIABLE):
        if len(variable.dims) != data.ndim:
            raise ValueError(f"'{variable.name}' has shape {data.shape} along {variable.dims}")
        made = variables[variable.name] = xr.Variable.__new__(xr.Variable)
        made._dims, made._data, made._attrs = variable.dims, data, variable.attributes  # noqa: SLF001
        made._encoding = {"_FillValue": None} if variable.name == schema.EVENT_BOUNDS else None  # noqa: SLF001
    coordinates: set[Any] = {
        variable.name for variable, _ in filled if schema.is_coordinate(variable.name, variable.role)
    }
    return xr.Dataset._construct_direct(variables, coordinates, attrs=attributes)  # noqa: SLF001


def _last_rows(march: March) -> Iterator[LogBlock]:
    """Yield the last row of an interrupted march, if it follows the recorded rows."""
    if (last_row := march.waiting_block()) is not None:
        yield last_row


def _with_final_attributes(variable: schema.Variable, tolerances: Mapping[str, Mapping[str, Any]]) -> schema.Variable:
    """Return a variable with the attributes that are known after the march."""
    extra = tolerances.get(variable.name)
    return replace(variable, more={**variable.more, **extra}) if extra else variable


def check(run: xr.Dataset, *, whole: bool = True, values: bool = True) -> None:
    """Check that a Dataset is a run record, or if not `whole`, that it can be a part of a run; see `faults_of`.

    Raises
    ------
    InputError
        With every fault.
    """
    check_dataset(run)
    faults = faults_of(run, is_full_run=whole, values=values)
    if faults:
        check_elements(run)
        if schema.EVIDENCE not in run.attrs:
            check_single(run)
        raise InputError(f"this is no run record:{numbered_lines(faults)}", tuple(faults))


def check_dataset(candidate: Any) -> None:
    """Refuse an argument that is no Dataset, such as the name of a file.

    Raises
    ------
    InputError
    """
    if isinstance(candidate, str | PathLike):
        raise InputError(f"'{displayed_path(candidate)}' is a path; open it first, with open_run")
    if not hasattr(candidate, "data_vars"):
        raise InputError(f"{str(candidate)[:60]!r} is no Dataset, as simulate and open_run return one")


def check_single(run: xr.Dataset) -> None:
    """Check that a record is of one run: where runs are concatenated, parameters gain a dimension.

    Raises
    ------
    InputError
        Naming the dimension of the runs.
    """
    single_run_dims = {
        *schema.DIMENSIONS,
        *(name for dim in model_dimensions(run) for name in (dim, schema.logged_of(dim))),
    }
    dims = {dim for variable in run.variables.values() if schema.STEPS in variable.dims for dim in variable.dims}
    if several := sorted(map(str, dims - single_run_dims)):
        raise InputError(
            f"these are several runs, along '{several[0]}'; give one at a time, as in [f(run) for run in runs], before they are"
            f" put together by xr.concat(…, '{several[0]}', coords='different', compat='equals'), which keeps the parameters"
            " of each"
        )


def chosen_times_remedy(states: Any) -> str:
    """Return the remedy where a Dataset has the states of a run at chosen times alone."""
    if f"{schema.AT}_time" not in getattr(states, "variables", ()):
        return ""
    return (
        "; these are a run's states at chosen times: leave times, or t_eval, out, and of the run that comes back"
        " run.dynamics.at([…]) gives them"
    )


def check_kind(run: Any) -> None:
    """Check that an object looks like a run record with all its elements, without reading its values.

    Raises
    ------
    InputError
        Naming what is missing.
    """
    check_dataset(run)
    needed = ("time", "row_kind", "step_size", "model_toml")
    missing = [name for name in needed if name not in getattr(run, "variables", ())]
    attributes = ("solver_method", "solver_estimator", "solver_interpolation")
    missing += [name for name in attributes if name not in getattr(run, "attrs", ())]
    if missing:
        raise InputError(f"this is no run record: it has no {', '.join(missing)}{chosen_times_remedy(run)}")
    check_single(run)
    if run["time"].dims != (schema.STEPS,) or not run["time"].size:
        raise InputError(
            f"the record has time along {run['time'].dims} of size {run['time'].size}, needs rows along '{schema.STEPS}'"
        )
    check_elements(run)


def _gather_columns(
    march: March, spec: Sequence[Column], earlier_parts: Iterable[tuple[str, Array]], memory: str | float | None
) -> dict[str, GatheredColumn]:
    """March, and return the values of all columns."""
    is_lent = march.settings.log != FULL
    # where rows are left out, how many are kept is known in the end
    rows = march.expected_rows if is_lent and not march.thinning else None
    gathered = {
        column.variable.name: GatheredColumn(rows if column.variable.dims[0] == schema.STEPS else None)
        for column in spec
    }
    for name, values in earlier_parts:
        gathered[name].add(values, is_lent=False)
    with closing(march.blocks()) as blocks:
        for block in chain(blocks, _last_rows(march)):
            parts = gathered.values()
            check_growth(
                march, sum(part.bytes_held for part in parts), sum(part.growth(block.rows) for part in parts), memory
            )
            for column in spec:
                gathered[column.variable.name].add(column.take(block), is_lent=is_lent)
    return gathered


class GatheredColumn:
    """The values of a column, piece by piece.

    Those of memory that is filled again are put at once where the record has them: joined in the end they would be there
    twice, and half of the time of a step of a large model would go into memory that the system makes ready.

    Parameters
    ----------
    expected : int, optional
        How many rows there will be, without those of events.
    """

    def __init__(self, expected: int | None) -> None:
        self.expected = expected
        self.pieces: list[Array] = []
        self.room: Array | None = None
        self._pages: mmap | None = None  # those of the room, where rows are many numbers
        self.filled = 0  # rows of it

    def add(self, values: Array, *, is_lent: bool) -> None:
        """Add the values of some rows, whose memory is filled again if it is lent."""
        if not is_lent or (self.expected is None and values[:1].size < WIDE):
            # lent memory is filled again by the next block; zeros without memory of their own stay what they are
            self.pieces.append(values.copy() if is_lent and values.flags.writeable else values)
            return
        room = self._make_room(values) if self.room is None else self.room
        rows = self.filled + len(values)
        if more := self._more_rows(room, len(values)):
            rows_made = len(room) + more
            # this reference, too, would keep the pages from moving; see `_enlarged`
            del room
            room = self._enlarged(rows_made, values)
        room[self.filled : rows] = values
        self.filled = rows

    @property
    def bytes_held(self) -> int:
        """Bytes that it takes."""
        return (
            sum(0 if _is_nothing(piece) else piece.nbytes for piece in self.pieces)
            if self.room is None
            else self.room.nbytes
        )

    def growth(self, rows: int) -> int:
        """Return how many bytes more it will take with so many rows to come: pieces are there twice when they are joined."""
        if self.room is None:
            return self.bytes_held if self.pieces else 0
        return self._more_rows(self.room, rows) * self.room[:1].nbytes

    def _more_rows(self, room: Array, rows: int) -> int:
        """Return how many rows are made for so many to come: of a million numbers as many, else a quarter more at least."""
        missing = self.filled + rows - len(room)
        return 0 if missing <= 0 else missing if room[:1].size >= WIDE else max(missing, len(room) // 4)

    def _make_room(self, values: Array) -> Array:
        """Make room for all rows that are expected, behind those that were there before."""
        earlier = sum(map(len, self.pieces))
        rows = earlier + (self.expected or len(values))
        # only Linux has mremap, by which pages grow without being copied
        if values[:1].size >= WIDEST and sys.platform == "linux":
            self._pages = map_pages(rows * values[:1].nbytes)
        self.room = np.empty((rows, *values.shape[1:]), values.dtype) if self._pages is None else self._on_pages(values)
        for piece in self.pieces:
            self.room[self.filled : self.filled + len(piece)] = piece
            self.filled += len(piece)
        return self.room

    def _enlarged(self, rows: int, values: Array) -> Array:
        """Make room for so many rows in all; of many numbers the system moves pages, which on a heap would leave holes."""
        assert self.room is not None  # noqa: S101 - it was begun
        if self._pages is None:
            self.room.resize((rows, *values.shape[1:]), refcheck=False)
        else:
            self.room = None  # pages do not move while an array stands on them
            self._pages.resize(rows * values[:1].nbytes)
            self.room = self._on_pages(values)
        return self.room

    def _on_pages(self, values: Array) -> Array:
        """Return an array of rows like others on all of the pages."""
        assert self._pages is not None  # noqa: S101 - there are some
        return np.frombuffer(self._pages, values.dtype).reshape(-1, *values.shape[1:])

    def joined_rows(self) -> Array:
        """Return all rows in the order of their blocks."""
        if self.room is not None:
            return self.room[: self.filled]
        if all(map(_is_nothing, self.pieces)):
            return np.zeros((sum(map(len, self.pieces)), *self.pieces[0].shape[1:]))
        return self.pieces[0] if len(self.pieces) == 1 else np.concatenate(self.pieces)


def _is_nothing(piece: Array) -> bool:
    """Whether a piece has zeros without memory of their own."""
    return not piece.flags.writeable and not any(piece.strides)
