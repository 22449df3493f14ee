"""A march straight into a file, in bounded memory; finished parts of it outlive the process."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing
from itertools import chain
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Given, Place, location_of
from xdynamics.archive.segments import Segments
from xdynamics.archive.stores import check_archive
from xdynamics.archive.writer import Writer
from xdynamics.archive.writing import new_file
from xdynamics.march import LogBlock, March
from xdynamics.march.log import is_wide
from xdynamics.record import provenance
from xdynamics.schema import CLOSED_LINKS, EVENTS, SAMPLES, STEPS, TRIALS

Array = NDArray[Any]
Part = tuple[str, Array]

BLOCK_ROWS = 131_072
ROWS_AT_EVENTS = 4096  # a short run has no more of them
BLOCK_NUMBERS = 32_000_000  # of a block, which has fewer rows where there are many columns
WIDE_NUMBERS = 4_000_000  # the same where columns have many elements, so that they are fewer


def stream(march: March, path: Given, *, earlier_parts: Iterable[Part] = (), resume: bool = False) -> Place:
    """March straight into a file, and return where it is; see `stream_to_writer`."""
    return stream_to_writer(march, path, earlier_parts=earlier_parts, resume=resume).path


def stream_to_writer(
    march: March, path: Given, *, earlier_parts: Iterable[Part] = (), resume: bool = False, read_back: bool = True
) -> Writer:
    """March straight into a file, in bounded memory; one block is written while the next is marched.

    Every ten seconds or so the rows since are kept in a segment beside the file, with the march's memory.

    Parameters
    ----------
    march : March
    path : str or Path
    earlier_parts : iterable of (str, ndarray)
        Rows that precede those of the march, which goes on after them once they are all taken.
    resume : bool
        Whether to go on from existing segments; the rows before are in them.
    read_back : bool
        Whether the values are read again before the file takes its name; see `new_file`.

    Raises
    ------
    InputError
        If there are segments without `resume`, or they are of another run.
    ArchiveError
        If the file cannot be written; the final name is untouched, and the segments stay.
    """
    location = location_of(path)
    check_archive(location, march.model)
    with Segments(location, march, resume=resume) as segments:
        with new_file(location, keeps=True, read_back=read_back) as writer:
            _write_all_rows(writer, march, segments, segments.rows() if len(segments) else earlier_parts)
            _write_constants(writer, march)
            for name, attributes in record.followed_tolerances(march).items():
                writer.describe(name, attributes)
            writer.finish(provenance.run_attributes(march))
        if not march.unfinished:
            segments.remove()
    return writer


def _write_all_rows(writer: Writer, march: March, segments: Segments, earlier_parts: Iterable[Part]) -> None:
    """Write all rows: those before, then block by block those of the march."""
    spec, rows = record.columns(march), iter(earlier_parts)
    first = next(rows, None)
    if first:
        _define_columns(writer, spec, march, {})
        for name, values in chain([first], rows):
            writer.append(name, values)
        if len(segments):
            segments.go_on(writer)
    pending: list[Future[None]] = []
    rows_of_block = _rows_per_block(march)
    with ThreadPoolExecutor(1) as pool, closing(march.blocks(rows_of_block, segments.patience)) as blocks:
        for block in blocks:
            if not writer.filled:
                sizes = _block_sizes(block) if march.is_over and not march.waits else {}
                _define_columns(writer, spec, march, sizes)
            parts = [(column.variable.name, column.take(block)) for column in spec]
            _await_writes(pending)
            pending = [pool.submit(writer.write, parts)]
            writer.hash(parts)
            if segments.due and march.unfinished:
                pending.append(pool.submit(segments.keep, writer, march.memory(), writer.digests()))
            if rows_of_block == 1:  # the next one is marched into the same
                _await_writes(pending)
        _await_writes(pending)
    if march.unfinished:
        segments.keep(writer, march.memory(), writer.digests())
    if (remaining_rows := march.waiting_block()) is not None:  # the end of an interrupted march
        for column in spec:
            writer.append(column.variable.name, column.take(remaining_rows))


def _write_constants(writer: Writer, march: March) -> None:
    """Write what has no rows: none of it is held while the attributes are found."""
    for variable, value in record.constants(march):
        dtype = np.dtype(object) if variable.dtype == "U" else np.dtype(variable.dtype)
        sizes = dict(zip(variable.dims, np.shape(value), strict=True))
        writer.define(variable.name, variable.dims, dtype, variable.attributes, sizes)
        writer.append(variable.name, np.asarray(value, dtype=dtype))


def _define_columns(writer: Writer, spec: Sequence[record.Column], march: March, sizes: Mapping[str, int]) -> None:
    elements = record.sizes_of(march)
    sizes = {**sizes, **elements}
    if march.settings.compress:
        widths = {
            variable.name: prod(elements.get(dim, 1) for dim in variable.dims)
            for variable in (column.variable for column in spec)
        }
        writer.pack(
            {
                variable.name: (variable.dims[0], np.dtype(variable.dtype).itemsize * widths[variable.name])
                for variable in (column.variable for column in spec)
            }
        )
    for column in spec:
        column_variable = column.variable
        writer.define(
            column_variable.name,
            column_variable.dims,
            np.dtype(column_variable.dtype),
            column_variable.attributes,
            sizes,
        )


def _rows_per_block(march: March) -> int:
    """Return the rows of a block: a short run fits into one, so that its chunks are no larger than it is."""
    expected = march.expected_rows or BLOCK_ROWS
    numbers = WIDE_NUMBERS if is_wide(march.layout) else BLOCK_NUMBERS
    max_rows = max(1, numbers // march.layout.row.size)
    return min(BLOCK_ROWS, max_rows, expected + ROWS_AT_EVENTS * bool(march.layout.watched))


def _block_sizes(block: LogBlock) -> dict[str, int]:
    """Return the sizes of a run that one block holds."""
    sizes = {STEPS: block.rows, TRIALS: block.trials, EVENTS: block.events, SAMPLES: block.samples}
    sizes |= {CLOSED_LINKS: block.log.closed_rows.shape[1]}
    return {dim: size for dim, size in sizes.items() if size}


def _await_writes(pending: list[Future[None]]) -> None:
    for future in pending:
        future.result()
