"""The segments of a march that streams into an archive: kept beside it until the archive is whole."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any

from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive import segment
from xdynamics.archive.place import Given, Place, location_of, resolve_links
from xdynamics.archive.seals import Seal
from xdynamics.archive.segment import Part, Segment
from xdynamics.archive.store import LockedError
from xdynamics.archive.stores import check_target, is_folder, store_of
from xdynamics.archive.temporary_files import fitting_name
from xdynamics.archive.writer import Writer
from xdynamics.faults import ArchiveError, InputError, ResumeWarning, warn
from xdynamics.march import March
from xdynamics.record import identity, word_differences
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.units import TIME, unit_suffix

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
            warn(f"there are no segments of '{archive}' to go on from: it is marched from its start", ResumeWarning)

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
        """Take the segments up to the first that is not whole."""
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
        candidate = segment.read_segment(name)
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
        """Count what a writer holds as kept."""
        self._written_rows = writer.filled

    @property
    def patience(self) -> float:
        """Seconds after which rows are to be handed over, so that they can be kept in time."""
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
            self._last_digest = segment.write_segment(self._next_location, segment_header, memory, rows, values)
            self._number += 1
        except (OSError, InputError) as error:
            self.failed = True
            # it was not there when this march began
            contested = isinstance(error, FileExistsError) and is_folder(self.folder)
            why = "another process marches into it too" if contested else getattr(error, "strerror", None) or error
            warn(f"no more segments of '{self.archive}' can be kept: {why}; the run goes on", ResumeWarning)
        self._written_rows, self._last = filled, time.monotonic()

    def remove(self) -> None:
        """Remove all segments: the archive is whole."""
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
    """Remove what a killed process left beside a whole archive; see `clear_segments`."""
    store_of(archive).clear(resolve_links(archive).parent)
    clear_segments(archive)


def clear_segments(archive: Place) -> None:
    """Remove remaining segments of a whole archive; those that cannot be removed, or are being written, stay."""
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
        raise InputError(f"'{archive}' is being marched by another process; wait for it, or end it ({error})") from None
    return stack
