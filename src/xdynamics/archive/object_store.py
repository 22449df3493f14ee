"""A bucket as a store: whole objects, written under conditions.

What may only be new is put with ``If-None-Match: *``, what replaces with ``If-Match`` on what was there when its writing began.
A file is written on this machine first and uploaded whole; it is downloaded whole, to a temporary file, before it is
read: its seal is of every byte, none of which is believed before, and the netCDF library reads files.
"""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary, finalize

from xdynamics.archive.lease import leased
from xdynamics.archive.object_calls import ATTEMPTS, RefusedError, body_of, call, pieces_of, worded
from xdynamics.archive.object_upload import (
    LOCK,
    ObjectBatch,
    are_alive,
    at_once,
    head_of,
    lock_of,
    stamp_of,
    uploaded,
    uploads_of,
)
from xdynamics.archive.place import ObjectName
from xdynamics.archive.store import FOLDER, Held, LockedError, NewFile
from xdynamics.archive.temporary_files import TemporaryFile, sweep
from xdynamics.faults import ArchiveError, InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

AGAIN = 60.0  # s after which a folder is searched for uploads of dead processes again
BUILDING = ".building"


class ObjectStore:
    """Objects of buckets; see `Store`. A folder is what their names have in common up to a slash."""

    def __init__(self) -> None:
        self._copies: WeakValueDictionary[tuple[ObjectName, str], Held] = WeakValueDictionary()
        self._fetching = threading.Lock()
        self._cleared: dict[ObjectName, float] = {}

    def check_source(self, place: ObjectName) -> None:
        """Check that there is an object.

        Raises
        ------
        InputError
            If there is no object of that name.
        """
        kind = self.kind(place)
        if kind == "":
            raise InputError(f"'{place}' does not exist")
        if kind is not None:
            raise InputError(f"'{place}' is {kind}; name a file in it")

    def check_target(self, place: ObjectName, model: Model | None = None) -> None:  # noqa: ARG002 - models are of folders
        """Check that the name is free or an object's, and by an upload that is not finished that it may be written.

        Raises
        ------
        InputError
            If the name is a folder's.
        ArchiveError
            If the store refuses to write there.
        """
        if self.kind(place) == FOLDER:
            raise InputError(f"'{place}' is a directory; name a file in it, like '{place / 'run.nc'}'")
        with _telling(place, "cannot be written"):
            upload = call(place, "create_multipart_upload", Key=place.key)["UploadId"]
            call(place, "abort_multipart_upload", Key=place.key, UploadId=upload)

    def check_no_table(self, place: ObjectName, tables: list[str]) -> None:
        """Check nothing: tables are read from folders."""

    def kind(self, place: ObjectName) -> str | None:
        """Return whether there is an object (None), others whose names begin so (a directory), or nothing."""
        with _telling(place, "cannot be read"):
            if place.key and head_of(place) is not None:
                return None
            return FOLDER if self._is_folder(place) else ""

    def _is_folder(self, place: ObjectName) -> bool:
        with _telling(place, "cannot be read"):
            under = call(place, "list_objects_v2", Prefix=f"{place.key}/".lstrip("/"), MaxKeys=1)
        return bool(under.get("KeyCount")) or not place.key

    def stamp(self, place: ObjectName) -> str | None:
        """Return the ETag of an object."""
        with _telling(place, "cannot be read"):
            return stamp_of(head_of(place))

    def names(self, folder: ObjectName) -> list[ObjectName]:
        """List objects and folders."""
        keys: list[str] = []
        with _telling(folder, "cannot be listed"):
            for page in _pages(folder, Delimiter="/"):
                keys += [entry["Key"] for entry in page.get("Contents", [])]
                keys += [entry["Prefix"].rstrip("/") for entry in page.get("CommonPrefixes", [])]
        places = [ObjectName(folder.bucket, key) for key in sorted(keys)]
        return [place for place in places if not (place.name.startswith(".") and place.name.endswith(LOCK))]

    def content(self, place: ObjectName, most: int) -> bytes:
        """Read a small object.

        Raises
        ------
        InputError
            If it has more bytes than `most`.
        ArchiveError
            If it cannot be read.
        """
        with _telling(place, "cannot be read"):
            answer = call(place, "get_object", Key=place.key)
            if answer["ContentLength"] > most:
                raise InputError(f"it has {answer['ContentLength']} bytes, over the limit of {most}")
            return body_of(answer)

    def held(self, place: ObjectName, stamp: str | None = None) -> Held:
        """Download an object to a temporary file, which this process keeps as long as it is used.

        Parameters
        ----------
        place : ObjectName
        stamp : str, optional
            Of the version that is wanted.

        Raises
        ------
        ArchiveError
            If it cannot be read, is another version, or the disk of temporary files has no room for it.
        """
        with _telling(place, "cannot be read"):
            head = head_of(place)
        if head is None:
            raise InputError(f"'{place}' does not exist")
        found = str(stamp_of(head))
        if stamp is not None and found != stamp:
            raise ArchiveError(f"'{place}' is another file than the one that was opened; open it again")
        with self._fetching:
            held = self._copies.get((place, found))
            if held is None:
                part, copy = _downloaded(place, found, int(head["ContentLength"]))
                held = self._copies[place, found] = Held(part, place, partial(self.held, place, found), copy)
        return held

    def __reduce__(self) -> str:
        return "OBJECTS"  # one in each process

    def written_at(self, place: ObjectName) -> Path:
        """Return a path among temporary files."""
        return Path(tempfile.gettempdir()) / place.name

    @contextmanager
    def taking_name(self, place: ObjectName, batch: ObjectBatch | None = None) -> Iterator[NewFile[ObjectName]]:
        """Lend a local temporary file, and upload it whole in the end.

        Raises
        ------
        TakenError
            If another process wrote the object meanwhile.
        ArchiveError
            If it cannot be uploaded.
        """
        if time.monotonic() - self._cleared.get(place.parent, -AGAIN) >= AGAIN:
            self.clear(place.parent)
        if batch is not None:
            yield batch.add(_temporary(place), place)
            return
        before = self.stamp(place) if place.key else None
        if before is None and self._is_folder(place):
            raise InputError(f"'{place}' is a directory; name a file in it, like '{place / 'run.nc'}'")
        with _temporary(place) as part:
            new = NewFile(part.path, place)
            yield new
            try:
                uploaded(part.path, new.name, before if new.name == place else self.stamp(new.name))
            except InputError as error:
                if not new.keeps:
                    raise
                raise type(error)(f"{error}; the whole file is kept as '{_kept(part.path, new.name)}'") from None

    def check_each(self, places: Sequence[ObjectName]) -> None:
        """Check all targets, several at once."""
        at_once(self.check_target, places)

    def batch(self, places: Sequence[ObjectName]) -> ObjectBatch:
        """Return what uploads several files together, which are under conditions on what is there now."""
        return ObjectBatch(places, self.stamp)

    def check_empty(self, place: ObjectName) -> None:
        """Check that nothing is in a folder, but what a dead process left half-built.

        Raises
        ------
        InputError
            If something is in it.
        """
        names = self.names(place)
        if names and names[0].name != BUILDING:
            raise InputError(f"'{place}' holds '{names[0].name}' already; name a folder that is empty, or not there")

    @contextmanager
    def taking_folder(self, place: ObjectName) -> Iterator[Path]:
        """Lend a local folder, and upload its files under a mark that is removed last, by which a whole folder is known."""
        with self.locked(place):
            mark = place / BUILDING
            if self.stamp(mark) is not None:  # of a process that died
                self._remove_all(place, besides=place / LOCK)
            self.check_empty(place)
            with tempfile.TemporaryDirectory() as built:
                yield Path(built)
                with _telling(place, "cannot be written"):
                    call(mark, "put_object", Key=mark.key, Body=b"", IfNoneMatch="*")
                for file in sorted(Path(built).iterdir()):
                    uploaded(file, place / file.name, None)
            self.remove(mark)

    def made_folder(self, place: ObjectName) -> ObjectName:
        """Return a folder, which is there when something is in it.

        Raises
        ------
        InputError
            If the name is a file's.
        """
        if self.kind(place) is None:
            raise InputError(f"'{place}' is a file; name a folder")
        return place

    def new_folder(self, place: ObjectName) -> None:
        """Check that nothing is in a folder.

        Raises
        ------
        FileExistsError
            If something is in it.
        """
        if self.kind(place) != "":
            raise FileExistsError(f"'{place}' is there already")

    def locked(self, folder: ObjectName) -> AbstractContextManager[None]:
        """Lock a folder by an object in it."""
        return leased(folder / LOCK, folder)

    def remove(self, place: ObjectName) -> None:
        """Remove an object; an empty folder is none."""
        with _telling(place, "cannot be removed"):
            call(place, "delete_object", Key=place.key)

    def remove_folder(self, folder: ObjectName) -> None:
        """Remove all objects of a folder."""
        with suppress(InputError):
            self._remove_all(folder)

    def _remove_all(self, folder: ObjectName, besides: ObjectName | None = None) -> None:
        with _telling(folder, "cannot be removed"):
            for page in list(_pages(folder)):
                keys = [
                    {"Key": entry["Key"]}
                    for entry in page.get("Contents", [])
                    if besides is None or entry["Key"] != besides.key
                ]
                if keys:
                    call(folder, "delete_objects", Delete={"Objects": keys, "Quiet": True})

    def clear(self, folder: ObjectName) -> None:
        """Abort the uploads into a folder whose processes died: those of objects that nobody has locked."""
        self._cleared[folder] = time.monotonic()
        sweep(Path(tempfile.gettempdir()))
        with suppress(RefusedError):
            uploads = uploads_of(folder, f"{folder.key}/".lstrip("/"))
            for key, upload in uploads if uploads and not are_alive(folder) else ():
                place = ObjectName(folder.bucket, key)
                with suppress(LockedError), leased(lock_of(place), place):
                    call(folder, "abort_multipart_upload", Key=key, UploadId=upload)


def _pages(folder: ObjectName, **how: str) -> Iterator[dict[str, Any]]:
    """List a folder, a thousand names at a time."""
    more: dict[str, str] = {}
    while True:
        prefix = f"{folder.key}/" if folder.key else ""
        page = call(folder, "list_objects_v2", Prefix=prefix, **how, **more)
        yield page
        if not page.get("IsTruncated"):
            return
        more = {"ContinuationToken": page["NextContinuationToken"]}


@contextmanager
def _telling(place: ObjectName, what: str) -> Iterator[None]:
    """Put what the store refuses into words."""
    try:
        yield
    except RefusedError as error:
        if error.is_absent and what == "cannot be read":
            raise InputError(f"'{place}' does not exist") from None
        raise worded(place, what, error) from None


@contextmanager
def _temporary(place: ObjectName) -> Iterator[TemporaryFile]:
    """Make a temporary file on this machine."""
    folder = Path(tempfile.gettempdir())
    try:
        with TemporaryFile.beside(folder / (place.name or place.bucket), 0o600) as part:
            yield part
    except OSError as error:
        raise ArchiveError(
            f"'{place}' needs a temporary file in '{folder}', which cannot be written: {error.strerror or error}; name"
            " another folder by TMPDIR"
        ) from error


def _kept(part: Path, name: ObjectName) -> Path:
    """Give a temporary file a name under which it stays."""
    stays = part.with_name(f"xdynamics-{secrets.token_hex(4)}-{name.name}")
    part.rename(stays)
    return stays


class _Copy:
    """Removes a downloaded file when nothing uses it any more, at the latest when the process ends."""

    def __init__(self, stack: ExitStack) -> None:
        finalize(self, stack.close)


def _downloaded(place: ObjectName, stamp: str, size: int) -> tuple[Path, _Copy]:
    """Download one version of an object; where the connection is lost, from there on."""
    folder = Path(tempfile.gettempdir())
    sweep(folder)
    if size > (free := shutil.disk_usage(folder).free):
        raise ArchiveError(
            f"'{place}' has {size} bytes, and the disk of temporary files, '{folder}', {free} free; name another by TMPDIR"
        )
    with ExitStack() as stack:
        part = stack.enter_context(_temporary(place))
        with part.path.open("wb") as file, _telling(place, "cannot be read"):
            for attempt in range(ATTEMPTS):
                try:
                    _fill(file, place, stamp, size)
                    break
                except RefusedError as error:
                    if error.is_taken or error.words or attempt + 1 == ATTEMPTS:
                        raise
        return part.path, _Copy(stack.pop_all())


def _fill(file: Any, place: ObjectName, stamp: str, size: int) -> None:
    """Download what a file does not have yet."""
    done = file.tell()
    if done == size:
        return
    answer = call(place, "get_object", Key=place.key, IfMatch=stamp, Range=f"bytes={done}-")
    for piece in pieces_of(answer):
        file.write(piece)
    if file.tell() != size:
        raise RefusedError("IncompleteRead", "")


OBJECTS = ObjectStore()
