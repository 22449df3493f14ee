"""Segments of a march that streams into an archive: files beside the archive until the archive is complete.

The march runs in bounded memory, and its finished segments outlive the process. A segment is one finished stretch: its
identity, the march's memory at its end, its rows.

The first line is JSON: name, type and shape of every array, and for every variable the digest of all its rows so far.
The arrays of the memory follow, then a line with the sha256 of everything before it, then the rows.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from itertools import chain
from math import prod
from pathlib import Path
from types import TracebackType
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.folder_store import check_archive, check_target, is_folder, store_of, taking_name
from xdynamics.archive.seals import Seal
from xdynamics.archive.store import Given, LocalFile, LockedError, Place, location_of, resolve_links
from xdynamics.archive.target import fitting_name
from xdynamics.archive.writing import Writer, new_file
from xdynamics.faults import ArchiveError, InputError, ResumeWarning, warn
from xdynamics.march import LogBlock, March
from xdynamics.march.log import is_wide
from xdynamics.record import identity, provenance, word_differences
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import CLOSED_LINKS, EVENTS, SAMPLES, STEPS, TRIALS
from xdynamics.units import TIME, unit_suffix

Array = NDArray[Any]
Part = tuple[str, Array]
Shape = tuple[str, Any, tuple[int, ...]]  # name, type, shape of an array

MEMORY, ROWS = "memory", "rows"
_KIND = "xdynamics segment 1"
_MARK = b"\nsha256 "
_LONGEST_LINE = 1 << 26
_PIECE = 1 << 22  # bytes that are read at once


@dataclass(frozen=True)
class Segment:
    """A segment with complete header and memory: header content, start of the arrays, digest of both."""

    local_file: LocalFile
    header: Mapping[str, Any]
    first: int
    digest: str

    @property
    def path(self) -> Path:
        """The file on this machine."""
        return self.local_file.path

    def memory(self) -> dict[str, Array]:
        """Return the march's memory."""
        with self.path.open("rb") as file:
            file.seek(self.first)
            return {
                name: _array_from_bytes(file.read(_array_bytes(kind, shape)), kind, shape)
                for name, kind, shape in self.header[MEMORY]
            }

    def rows(self) -> Iterator[Part]:
        """Yield the rows of one variable after the other, some megabytes at a time."""
        with self.path.open("rb") as file:
            file.seek(_behind_head(self.header, self.first))
            for name, kind, (rows, *inner) in self.header[ROWS]:
                max_rows = max(1, _PIECE // _array_bytes(kind, inner))
                for start in range(
                    0, max(1, rows), max_rows
                ):  # an empty array is yielded too: its shape is in the digests
                    shape = (min(max_rows, rows - start), *inner)
                    yield name, _array_from_bytes(file.read(_array_bytes(kind, shape)), kind, shape)

    def check(self, seals: Mapping[str, Seal]) -> None:
        """Add its rows to digests of those before it, and compare.

        Raises
        ------
        ArchiveError
            Naming the first variable that differs.
        """
        for name, values in self.rows():
            if name not in seals or seals[name].dtype != values.dtype:
                raise ArchiveError(f"has a variable '{name}' that the run has not")
            seals[name].update(values)
        for name, seal in seals.items():
            if self.header["digests"].get(name) != seal.hexdigest():
                raise ArchiveError(f"differs from the digest of '{name}'")


def write_segment(
    location: Place,
    march_header: Mapping[str, Any],
    memory: Mapping[str, Array],
    rows: list[Shape],
    values: Iterable[Array],
) -> str:
    """Write a segment completely or not at all; return its digest."""
    shapes = [(name, array.dtype, array.shape) for name, array in memory.items()]
    header = {"kind": _KIND} | dict(march_header) | {MEMORY: _array_headers(shapes), ROWS: _array_headers(rows)}
    head = json.dumps(header).encode() + b"\n" + b"".join(array.tobytes() for array in memory.values())
    # rows need none of their own: the header has a digest of every variable up to the end of this segment
    digest = hashlib.sha256(head).hexdigest()
    with taking_name(location) as new, new.part.open("wb") as file:
        file.write(head + _MARK + digest.encode() + b"\n")
        for array in values:
            file.write(np.ascontiguousarray(array).data)
    return digest


def read_segment(location: Place) -> Segment:
    """Read the first line of a segment, and compare that and its memory with their digest.

    Raises
    ------
    ArchiveError
        With a predicate: what the segment is or does that no segment should.
    """
    store = store_of(location)
    if store.kind(location) is not None:
        raise ArchiveError("is no file")
    local_file = store.local_file(location)
    try:
        with local_file.path.open("rb") as file:
            header, first, digest = _read_segment_head(file)
            size = os.fstat(file.fileno()).st_size
        needed = _behind_head(header, first) + sum(_array_bytes(kind, shape) for _, kind, shape in header[ROWS])
    except OSError as error:
        raise ArchiveError(f"cannot be read: {error.strerror or error}") from None
    except ArchiveError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, MemoryError, OverflowError):
        raise ArchiveError("is damaged, or no segment of this version") from None
    if size != needed:
        raise ArchiveError(f"has {size} bytes and says {needed}")
    return Segment(local_file, header, first, digest)


def _read_segment_head(file: IO[bytes]) -> tuple[dict[str, Any], int, str]:
    """Return the content of the first line, where the memory begins, and the digest of both."""
    line = file.readline(_LONGEST_LINE)
    header = json.loads(line)
    if header["kind"] != _KIND:
        raise ArchiveError("is of another version")
    size = sum(_array_bytes(kind, shape) for _, kind, shape in header[MEMORY])
    # the header is not trusted before its digest holds: never read more than there is
    if not 0 <= size <= os.fstat(file.fileno()).st_size:
        raise ArchiveError("is cut off")
    digest = hashlib.sha256(line + file.read(size)).hexdigest()
    if file.read(len(_MARK) + len(digest) + 1) != _MARK + digest.encode() + b"\n":
        raise ArchiveError("differs from its digest")
    return header, len(line), digest


def _behind_head(header: Mapping[str, Any], first: int) -> int:
    return first + sum(_array_bytes(kind, shape) for _, kind, shape in header[MEMORY]) + len(_MARK) + 64 + 1


def _array_headers(shapes: Iterable[Shape]) -> list[Any]:
    kinds = [(name, np.dtype(kind), shape) for name, kind, shape in shapes]
    return [(name, kind.descr if kind.names else kind.str, shape) for name, kind, shape in kinds]


def _array_dtype(described: Any) -> np.dtype[Any]:
    return np.dtype(described if isinstance(described, str) else [(name, kind) for name, kind in described])


def _array_bytes(described: Any, shape: Iterable[int]) -> int:
    return prod(shape) * _array_dtype(described).itemsize


def _array_from_bytes(content: bytes, described: Any, shape: Iterable[int]) -> Array:
    return np.frombuffer(content, _array_dtype(described)).reshape(tuple(shape))


EVERY = 10.0  # s between two segments: a run that is over sooner has none
SHARE = 0.01  # of a run's time, between two segments of one that lasts long


class Segments:
    """The segments of one march; each names the digest of the one before it.

    Parameters
    ----------
    archive : Path, or name of an object
        The file that the march streams into.
    march : March
    resume : bool
        Whether to go on from existing segments.

    Raises
    ------
    InputError
        If there are segments without `resume`, they are of another run, or another process writes them.
    """

    def __init__(self, archive: Place, march: March, *, resume: bool) -> None:
        self.archive, self.folder = archive, segments_folder(archive)
        self.store = store_of(archive)
        self.march, self.failed = march, False
        self._started = self._last = time.monotonic()
        self._whole_segments: list[Segment] = []
        self._number, self._last_digest = 1, ""  # of the next one, and the digest of the last
        self._written_rows: dict[str, int] = {}
        self._lock: ExitStack | None = None
        names = _segment_names(self.folder)
        if names and not resume:
            raise InputError(
                f"'{archive}' has segments of a run that is not finished, in '{self.folder}': go on with it by"
                f" resume (--resume), or remove them with `xdynamics discard {archive}`"
            )
        if is_folder(self.folder):
            self._claim()
            self._gather(names)
        elif resume:
            warn(f"there are no segments of '{archive}' to go on from: it is computed from its start", ResumeWarning)

    @cached_property
    def _march_identity(self) -> dict[str, str]:
        """The identity of the march: a run that is over sooner than its first segment is due needs none."""
        return identity(self.march)

    def __enter__(self) -> Segments:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        if self._lock is not None:
            with suppress(OSError, InputError):
                if is_folder(self.folder) and not _segment_names(self.folder):  # the disk had no room for the first
                    _remove_segments(self.folder)
            self._lock.close()

    def _claim(self) -> None:
        self._lock = _lock_segments(self.folder, self.archive)

    def __len__(self) -> int:
        return len(self._whole_segments)

    def _gather(self, names: list[Place]) -> None:
        """Collect the segments up to the first incomplete one."""
        seals = {column.variable.name: Seal.for_variable(column.variable) for column in record.columns(self.march)}
        for name in names:
            try:
                whole_segment = self._check_segment(name)
                whole_segment.check(seals)
            except ArchiveError as error:
                unit = unit_suffix(self.march.model.time_unit)
                where = (
                    f"goes on from t = {self._whole_segments[-1].header['t']:.9g}{unit}"
                    if self._whole_segments
                    else "starts anew"
                )
                warn(f"segment '{name}' {error}: the run {where}", ResumeWarning)
                return
            self._whole_segments.append(whole_segment)
            self._number, self._last_digest = self._number + 1, whole_segment.digest

    def _check_segment(self, name: Place) -> Segment:
        candidate = read_segment(name)
        if different := word_differences(candidate.header["of"], self._march_identity):
            raise InputError(
                f"the segments of '{self.archive}' are of another run: {'; '.join(different)}; resume it as it was"
                f" begun, or remove them with `xdynamics discard {self.archive}`"
            )
        if name != self._next_location or candidate.header["before"] != self._last_digest:
            raise ArchiveError("does not follow the one before it")
        return candidate

    def rows(self) -> Iterator[Part]:
        """Yield the rows of all segments, then let the march go on after them."""
        for whole_segment in self._whole_segments:
            yield from whole_segment.rows()
        if self._whole_segments:
            self.march.go_on_from(self._whole_segments[-1].memory())

    def go_on(self, writer: Writer) -> None:
        """Count the rows of a writer as stored."""
        self._written_rows = writer.filled

    @property
    def patience(self) -> float:
        """Seconds after which rows are to be handed over, so that they are stored in time."""
        return EVERY

    @property
    def due(self) -> bool:
        """Whether it is time for another segment."""
        now = time.monotonic()
        return not self.failed and now - self._last >= max(EVERY, SHARE * (now - self._started))

    def keep(self, writer: Writer, memory: Mapping[str, NDArray[Any]], digests: Mapping[str, str]) -> None:
        """Write a segment with the rows that the writer was given since the one before, and digests of all so far.

        A disk without room for it does not end the run: it goes on without.
        """
        if self.failed:  # rows would be missing
            return
        filled = writer.filled
        t = float(memory["now"]["t"][0]) * self.march.settings.scales.si_factor(TIME)
        segment_header = {"of": self._march_identity, "before": self._last_digest, "t": t, "digests": dict(digests)}
        try:
            if self._lock is None:
                self.store.new_folder(self.folder)
                self._claim()
            rows, values = writer.shapes_since(self._written_rows), writer.since(self._written_rows)
            self._last_digest = write_segment(self._next_location, segment_header, memory, rows, values)
            self._number += 1
        except (OSError, InputError) as error:
            self.failed = True
            # it was not there when this march began
            contested = isinstance(error, FileExistsError) and is_folder(self.folder)
            why = "another process writes into it too" if contested else getattr(error, "strerror", None) or error
            warn(f"no more segments of '{self.archive}' can be kept: {why}; the run goes on", ResumeWarning)
        self._written_rows, self._last = filled, time.monotonic()

    def remove(self) -> None:
        """Remove all segments, once the archive is complete."""
        if self._lock is not None:
            _remove_segments(self.folder)

    @property
    def _next_location(self) -> Place:
        return self.folder / f"{self._number:06d}.segment"


def segments_folder(archive: Place) -> Place:
    """Return where the segments of an archive are."""
    archive = resolve_links(archive)
    return archive.parent / fitting_name(archive.name, prefix=".", suffix=".segments")


def has_segments(archive: Place) -> bool:
    """Whether an archive has segments."""
    return bool(_segment_names(segments_folder(archive)))


def discard(archive: Given) -> int:
    """Remove the segments of a run that was not finished; the archive itself, if there is one, stays.

    Parameters
    ----------
    archive : str or Path
        The file that the run was to be written to.

    Returns
    -------
    int
        How many there were.

    Raises
    ------
    InputError
        If there are none, or a process is writing them.
    """
    location = location_of(archive)
    check_target(location)
    folder = segments_folder(location)
    names = _segment_names(folder)
    if not is_folder(folder):
        raise InputError(f"'{archive}' has no segments: there is no '{folder}'")
    with _lock_segments(folder, location):
        try:
            _remove_segments(folder)
        except OSError as error:
            raise ArchiveError(f"the segments in '{folder}' cannot be removed: {error.strerror or error}") from None
    return len(names)


def clear_rest(archive: Place) -> None:
    """Remove files that a killed process left beside a complete archive; see `clear_segments`."""
    store_of(archive).clear(resolve_links(archive).parent)
    clear_segments(archive)


def clear_segments(archive: Place) -> None:
    """Remove segments beside a complete archive; those that cannot be removed, or are being written, stay."""
    folder = segments_folder(archive)
    with suppress(OSError, InputError):
        if is_folder(folder):
            with _lock_segments(folder, archive):
                _remove_segments(folder)


def _segment_names(folder: Place) -> list[Any]:
    return _files_with_suffix(folder, ".segment")


def _files_with_suffix(folder: Place, suffix: str) -> list[Any]:
    return [location for location in store_of(folder).names(folder) if location.suffix == suffix]


def _remove_segments(folder: Place) -> None:
    """Remove segments, the last first, so that at any moment the remaining ones can be resumed from."""
    store = store_of(folder)
    store.clear(folder)
    for name in [
        *_files_with_suffix(folder, ".part"),
        *reversed(_segment_names(folder)),
    ]:  # the first are of versions before 0.3
        store.remove(name)
    store.remove(folder)


def _lock_segments(folder: Place, archive: Place) -> ExitStack:
    """Claim a folder for this process, for as long as the stack is open; return it."""
    stack = ExitStack()
    try:
        stack.enter_context(store_of(folder).locked(folder))
    except LockedError as error:
        raise InputError(
            f"'{archive}' is being computed by another process; wait for it, or end it ({error})"
        ) from None
    return stack


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
        # only now: the segments are all there is of the run until the archive has its name
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
            # taken before the wait, so that this overlaps with the writing of the block before
            parts = [(column.variable.name, column.take(block)) for column in spec]
            _await_writes(pending)
            pending = [pool.submit(writer.write, parts)]
            # hashed here while the other thread writes the same arrays: sha256 gives up the interpreter lock
            writer.hash(parts)
            # memory and digests are taken now: the march and the hashing go on while the segment is written
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
    """Write variables without rows, each released before attributes are computed."""
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
