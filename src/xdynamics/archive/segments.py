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
from xdynamics.archive.place import Given, Place, placed, real
from xdynamics.archive.seals import Seal
from xdynamics.archive.segment import Part, Segment
from xdynamics.archive.store import LockedError
from xdynamics.archive.stores import check_target, is_folder, store_of
from xdynamics.archive.temporary_files import fitting
from xdynamics.archive.writer import Writer
from xdynamics.faults import ArchiveError, InputError, ResumeWarning, warn
from xdynamics.march import March
from xdynamics.record import apart, identity
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
        self.archive, self.folder = archive, folder_of(archive)
        self.store = store_of(archive)
        self.march, self.failed = march, False
        self._started = self._last = time.monotonic()
        self._found: list[Segment] = []
        self._number, self._before = 1, ""  # of the next one, and the digest of the last
        self._kept: dict[str, int] = {}
        self._lock: ExitStack | None = None
        names = _names(self.folder)
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
    def _of(self) -> dict[str, str]:
        """The identity of the march: a run that is over sooner than its first segment is due needs none."""
        return identity(self.march)

    def __enter__(self) -> Segments:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        if self._lock is not None:
            with suppress(OSError, InputError):
                if is_folder(self.folder) and not _names(self.folder):  # the disk had no room for the first
                    _emptied(self.folder)
            self._lock.close()

    def _claim(self) -> None:
        self._lock = _locked(self.folder, self.archive)

    def __len__(self) -> int:
        return len(self._found)

    def _gather(self, names: list[Place]) -> None:
        """Take the segments up to the first that is not whole."""
        seals = {column.variable.name: Seal.of(column.variable) for column in record.columns(self.march)}
        for name in names:
            try:
                one = self._checked(name)
                one.check(seals)
            except ArchiveError as error:
                unit = unit_suffix(self.march.model.time_unit)
                where = f"goes on from t = {self._found[-1].said['t']:.9g}{unit}" if self._found else "starts anew"
                warn(f"segment '{name}' {error}: the run {where}", ResumeWarning)
                return
            self._found.append(one)
            self._number, self._before = self._number + 1, one.digest

    def _checked(self, name: Place) -> Segment:
        candidate = segment.read(name)
        if different := apart(candidate.said["of"], self._of):
            raise InputError(
                f"the segments of '{self.archive}' are of another run: {'; '.join(different)}; resume it as it was"
                f" begun, or remove them with `xdynamics discard {self.archive}`"
            )
        if name != self._name or candidate.said["before"] != self._before:
            raise ArchiveError("does not follow the one before it")
        return candidate

    def rows(self) -> Iterator[Part]:
        """Yield the rows of all segments, then let the march go on after them."""
        for kept in self._found:
            yield from kept.rows()
        if self._found:
            self.march.go_on_from(self._found[-1].memory())

    def go_on(self, writer: Writer) -> None:
        """Count what a writer holds as kept."""
        self._kept = writer.filled

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
        t = float(memory["now"]["t"][0]) * self.march.settings.scales.of(TIME)
        of = {"of": self._of, "before": self._before, "t": t, "digests": dict(digests)}
        try:
            if self._lock is None:
                self.store.new_folder(self.folder)
                self._claim()
            rows, values = writer.shapes_since(self._kept), writer.since(self._kept)
            self._before = segment.write(self._name, of, memory, rows, values)
            self._number += 1
        except (OSError, InputError) as error:
            self.failed = True
            # it was not there when this march began
            contested = isinstance(error, FileExistsError) and is_folder(self.folder)
            why = "another process marches into it too" if contested else getattr(error, "strerror", None) or error
            warn(f"no more segments of '{self.archive}' can be kept: {why}; the run goes on", ResumeWarning)
        self._kept, self._last = filled, time.monotonic()

    def remove(self) -> None:
        """Remove all segments: the archive is whole."""
        if self._lock is not None:
            _emptied(self.folder)

    @property
    def _name(self) -> Place:
        return self.folder / f"{self._number:06d}.segment"


def folder_of(archive: Place) -> Place:
    """Return where the segments of an archive are."""
    archive = real(archive)
    return archive.parent / fitting(archive.name, before=".", behind=".segments")


def has_segments(archive: Place) -> bool:
    """Whether an archive has segments."""
    return bool(_names(folder_of(archive)))


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
    place = placed(archive)
    check_target(place)
    folder = folder_of(place)
    names = _names(folder)
    if not is_folder(folder):
        raise InputError(f"'{archive}' has no segments: there is no '{folder}'")
    with _locked(folder, place):
        try:
            _emptied(folder)
        except OSError as error:
            raise ArchiveError(f"the segments in '{folder}' cannot be removed: {error.strerror or error}") from None
    return len(names)


def clear_rest(archive: Place) -> None:
    """Remove what a killed process left beside a whole archive; see `clear_segments`."""
    store_of(archive).clear(real(archive).parent)
    clear_segments(archive)


def clear_segments(archive: Place) -> None:
    """Remove remaining segments of a whole archive; those that cannot be removed, or are being written, stay."""
    folder = folder_of(archive)
    with suppress(OSError, InputError):
        if is_folder(folder):
            with _locked(folder, archive):
                _emptied(folder)


def _names(folder: Place) -> list[Any]:
    return _ending(folder, ".segment")


def _ending(folder: Place, suffix: str) -> list[Any]:
    return [place for place in store_of(folder).names(folder) if place.suffix == suffix]


def _emptied(folder: Place) -> None:
    """Remove segments, the last first, so that at any moment the remaining ones can be resumed from."""
    store = store_of(folder)
    store.clear(folder)
    for name in [*_ending(folder, ".part"), *reversed(_names(folder))]:  # the first are of versions before 0.3
        store.remove(name)
    store.remove(folder)


def _locked(folder: Place, archive: Place) -> ExitStack:
    """Claim a folder for this process, for as long as the stack is open; return it."""
    stack = ExitStack()
    try:
        stack.enter_context(store_of(folder).locked(folder))
    except LockedError as error:
        raise InputError(f"'{archive}' is being marched by another process; wait for it, or end it ({error})") from None
    return stack
