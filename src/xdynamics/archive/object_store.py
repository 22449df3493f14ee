"""A bucket as a store: complete objects, written under conditions.

An object that must be new is put with ``If-None-Match: *``. A replacement is put with ``If-Match`` on the object that
was there when the writing began. A file is written on this machine first and uploaded complete. To be read, an object
is downloaded complete to a temporary file: its seal covers every byte, none of which is believed before the seal is
checked, and the netCDF library reads files.
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

from xdynamics.archive.object_calls import ATTEMPTS, RefusedError, body_of, call_store, leased, pieces_of, refusal_error
from xdynamics.archive.object_upload import (
    LOCK,
    ObjectBatch,
    are_alive,
    call_concurrently,
    head_of,
    lock_of,
    stamp_of,
    upload_file,
    uploads_of,
)
from xdynamics.archive.store import FOLDER, LocalFile, LockedError, NewFile, ObjectName
from xdynamics.archive.target import TemporaryFile, sweep_temporary_files
from xdynamics.faults import ArchiveError, InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

AGAIN = 60.0  # s after which a folder is searched for uploads of dead processes again
BUILDING = ".building"


class ObjectStore:
    """Objects of buckets; see `Store`. A folder is a common beginning of names, up to a slash."""

    def __init__(self) -> None:
        self._copies: WeakValueDictionary[tuple[ObjectName, str], LocalFile] = WeakValueDictionary()
        self._fetching = threading.Lock()
        self._cleared: dict[ObjectName, float] = {}

    def check_source(self, location: ObjectName) -> None:
        """Check that there is an object.

        Raises
        ------
        InputError
            If there is no object of that name.
        """
        kind = self.kind(location)
        if kind == "":
            raise InputError(f"'{location}' does not exist")
        if kind is not None:
            raise InputError(f"'{location}' is {kind}; name a file in it")

    def check_target(self, location: ObjectName, model: Model | None = None) -> None:  # noqa: ARG002 - models are of folders
        """Check that the name is free or an object's, and by an upload that is not finished that it may be written.

        Raises
        ------
        InputError
            If the name is a folder's.
        ArchiveError
            If the store refuses to write there.
        """
        if self.kind(location) == FOLDER:
            raise InputError(f"'{location}' is a directory; name a file in it, like '{location / 'run.nc'}'")
        with _errors_in_words(location, "cannot be written"):
            upload = call_store(location, "create_multipart_upload", Key=location.key)["UploadId"]
            call_store(location, "abort_multipart_upload", Key=location.key, UploadId=upload)

    def check_no_table(self, location: ObjectName, tables: list[str]) -> None:
        """Check nothing: tables are read from folders."""

    def kind(self, location: ObjectName) -> str | None:
        """Return whether there is an object (None), others whose names begin so (a directory), or nothing."""
        with _errors_in_words(location, "cannot be read"):
            if location.key and head_of(location) is not None:
                return None
            return FOLDER if self._is_folder(location) else ""

    def _is_folder(self, location: ObjectName) -> bool:
        with _errors_in_words(location, "cannot be read"):
            under = call_store(location, "list_objects_v2", Prefix=f"{location.key}/".lstrip("/"), MaxKeys=1)
        return bool(under.get("KeyCount")) or not location.key

    def stamp(self, location: ObjectName) -> str | None:
        """Return the ETag of an object."""
        with _errors_in_words(location, "cannot be read"):
            return stamp_of(head_of(location))

    def names(self, folder: ObjectName) -> list[ObjectName]:
        """List objects and folders."""
        keys: list[str] = []
        with _errors_in_words(folder, "cannot be listed"):
            for page in _listing_pages(folder, Delimiter="/"):
                keys += [entry["Key"] for entry in page.get("Contents", [])]
                keys += [entry["Prefix"].rstrip("/") for entry in page.get("CommonPrefixes", [])]
        locations = [ObjectName(folder.bucket, key) for key in sorted(keys)]
        return [
            location for location in locations if not (location.name.startswith(".") and location.name.endswith(LOCK))
        ]

    def content(self, location: ObjectName, max_bytes: int) -> bytes:
        """Read a small object.

        Raises
        ------
        InputError
            If it has more bytes than `max_bytes`.
        ArchiveError
            If it cannot be read.
        """
        with _errors_in_words(location, "cannot be read"):
            answer = call_store(location, "get_object", Key=location.key)
            if answer["ContentLength"] > max_bytes:
                raise InputError(f"it has {answer['ContentLength']} bytes, over the limit of {max_bytes}")
            return body_of(answer)

    def local_file(self, location: ObjectName, stamp: str | None = None) -> LocalFile:
        """Download an object to a temporary file, which this process keeps as long as it is used.

        Parameters
        ----------
        location : ObjectName
        stamp : str, optional
            Of the version that is wanted.

        Raises
        ------
        ArchiveError
            If it cannot be read, is another version, or the disk of temporary files has no room for it.
        """
        with _errors_in_words(location, "cannot be read"):
            head = head_of(location)
        if head is None:
            raise InputError(f"'{location}' does not exist")
        etag = str(stamp_of(head))
        if stamp is not None and etag != stamp:
            raise ArchiveError(f"'{location}' is another file than the one that was opened; open it again")
        # a thread that wants the same version waits here and finds the copy, instead of downloading it again
        with self._fetching:
            local_copy = self._copies.get((location, etag))
            if local_copy is None:
                part, copy = _download_object(location, etag, int(head["ContentLength"]))
                local_copy = self._copies[location, etag] = LocalFile(
                    part, location, partial(self.local_file, location, etag), copy
                )
        return local_copy

    def __reduce__(self) -> str:
        return "OBJECTS"  # one in each process

    def written_at(self, location: ObjectName) -> Path:
        """Return a path among temporary files."""
        return Path(tempfile.gettempdir()) / location.name

    @contextmanager
    def taking_name(self, location: ObjectName, batch: ObjectBatch | None = None) -> Iterator[NewFile[ObjectName]]:
        """Lend a local temporary file, and upload it complete in the end.

        Raises
        ------
        TakenError
            If another process wrote the object meanwhile.
        ArchiveError
            If it cannot be uploaded.
        """
        if time.monotonic() - self._cleared.get(location.parent, -AGAIN) >= AGAIN:
            self.clear(location.parent)
        if batch is not None:
            yield batch.add(_temporary_copy(location), location)
            return
        previous_stamp = self.stamp(location) if location.key else None
        if previous_stamp is None and self._is_folder(location):
            raise InputError(f"'{location}' is a directory; name a file in it, like '{location / 'run.nc'}'")
        with _temporary_copy(location) as part:
            new = NewFile(part.path, location)
            yield new
            try:
                upload_file(part.path, new.name, previous_stamp if new.name == location else self.stamp(new.name))
            except InputError as error:
                if not new.keeps:
                    raise
                raise type(error)(
                    f"{error}; the whole file is kept as '{_keep_upload_file(part.path, new.name)}'"
                ) from None

    def check_each(self, locations: Sequence[ObjectName]) -> None:
        """Check all targets, several at once."""
        call_concurrently(self.check_target, locations)

    def batch(self, locations: Sequence[ObjectName]) -> ObjectBatch:
        """Return the batch that uploads several files together, each under a condition on the present object."""
        return ObjectBatch(locations, self.stamp)

    def check_empty(self, location: ObjectName) -> None:
        """Check that a folder has no objects except those that a dead process left half-built.

        Raises
        ------
        InputError
            If something is in it.
        """
        names = self.names(location)
        if names and names[0].name != BUILDING:
            raise InputError(f"'{location}' holds '{names[0].name}' already; name a folder that is empty, or not there")

    @contextmanager
    def taking_folder(self, location: ObjectName) -> Iterator[Path]:
        """Lend a local folder, and upload its files under a mark whose removal, last, makes the folder complete."""
        with self.locked(location):
            mark = location / BUILDING
            if self.stamp(mark) is not None:  # of a process that died
                self._remove_all(location, besides=location / LOCK)
            self.check_empty(location)
            with tempfile.TemporaryDirectory() as built:
                yield Path(built)
                with _errors_in_words(location, "cannot be written"):
                    call_store(mark, "put_object", Key=mark.key, Body=b"", IfNoneMatch="*")
                for file in sorted(Path(built).iterdir()):
                    upload_file(file, location / file.name, None)
            self.remove(mark)

    def made_folder(self, location: ObjectName) -> ObjectName:
        """Return a folder, which is there when something is in it.

        Raises
        ------
        InputError
            If the name is a file's.
        """
        if self.kind(location) is None:
            raise InputError(f"'{location}' is a file; name a folder")
        return location

    def new_folder(self, location: ObjectName) -> None:
        """Check that nothing is in a folder.

        Raises
        ------
        FileExistsError
            If something is in it.
        """
        if self.kind(location) != "":
            raise FileExistsError(f"'{location}' is there already")

    def locked(self, folder: ObjectName) -> AbstractContextManager[None]:
        """Lock a folder by an object in it."""
        return leased(folder / LOCK, folder)

    def remove(self, location: ObjectName) -> None:
        """Remove an object; an empty folder is none."""
        with _errors_in_words(location, "cannot be removed"):
            call_store(location, "delete_object", Key=location.key)

    def remove_folder(self, folder: ObjectName) -> None:
        """Remove all objects of a folder."""
        with suppress(InputError):
            self._remove_all(folder)

    def _remove_all(self, folder: ObjectName, besides: ObjectName | None = None) -> None:
        with _errors_in_words(folder, "cannot be removed"):
            for page in list(_listing_pages(folder)):
                keys = [
                    {"Key": entry["Key"]}
                    for entry in page.get("Contents", [])
                    if besides is None or entry["Key"] != besides.key
                ]
                if keys:
                    call_store(folder, "delete_objects", Delete={"Objects": keys, "Quiet": True})

    def clear(self, folder: ObjectName) -> None:
        """Abort the uploads into a folder whose processes died: those of objects that nobody has locked."""
        self._cleared[folder] = time.monotonic()
        sweep_temporary_files(Path(tempfile.gettempdir()))
        with suppress(RefusedError):
            uploads = uploads_of(folder, f"{folder.key}/".lstrip("/"))
            for key, upload in uploads if uploads and not are_alive(folder) else ():
                location = ObjectName(folder.bucket, key)
                with suppress(LockedError), leased(lock_of(location), location):
                    call_store(folder, "abort_multipart_upload", Key=key, UploadId=upload)


def _listing_pages(folder: ObjectName, **how: str) -> Iterator[dict[str, Any]]:
    """List a folder, a thousand names at a time."""
    more: dict[str, str] = {}
    while True:
        prefix = f"{folder.key}/" if folder.key else ""
        page = call_store(folder, "list_objects_v2", Prefix=prefix, **how, **more)
        yield page
        if not page.get("IsTruncated"):
            return
        more = {"ContinuationToken": page["NextContinuationToken"]}


@contextmanager
def _errors_in_words(location: ObjectName, failure: str) -> Iterator[None]:
    """Raise a store's refusals as errors in words."""
    try:
        yield
    except RefusedError as error:
        if error.is_absent and failure == "cannot be read":
            raise InputError(f"'{location}' does not exist") from None
        raise refusal_error(location, failure, error) from None


@contextmanager
def _temporary_copy(location: ObjectName) -> Iterator[TemporaryFile]:
    """Make a temporary file on this machine."""
    folder = Path(tempfile.gettempdir())
    try:
        with TemporaryFile.create_beside(folder / (location.name or location.bucket), 0o600) as part:
            yield part
    except OSError as error:
        raise ArchiveError(
            f"'{location}' needs a temporary file in '{folder}', which cannot be written: {error.strerror or error}; name"
            " another folder by TMPDIR"
        ) from error


def _keep_upload_file(part: Path, name: ObjectName) -> Path:
    """Give a temporary file a name under which it stays."""
    stays = part.with_name(f"xdynamics-{secrets.token_hex(4)}-{name.name}")
    part.rename(stays)
    return stays


class _Copy:
    """Removes a downloaded file when nothing uses it any more, at the latest when the process ends."""

    def __init__(self, stack: ExitStack) -> None:
        finalize(self, stack.close)


def _download_object(location: ObjectName, stamp: str, size: int) -> tuple[Path, _Copy]:
    """Download one version of an object; where the connection is lost, from there on."""
    folder = Path(tempfile.gettempdir())
    sweep_temporary_files(folder)
    if size > (free := shutil.disk_usage(folder).free):
        raise ArchiveError(
            f"'{location}' has {size} bytes, and the disk of temporary files, '{folder}', {free} free; name another by TMPDIR"
        )
    with ExitStack() as stack:
        part = stack.enter_context(_temporary_copy(location))
        with part.path.open("wb") as file, _errors_in_words(location, "cannot be read"):
            for attempt in range(ATTEMPTS):
                try:
                    _download_rest(file, location, stamp, size)
                    break
                except RefusedError as error:
                    # with words it is the store's own answer, which would be the same
                    # again; without any the connection was lost
                    if error.is_taken or error.words or attempt + 1 == ATTEMPTS:
                        raise
        return part.path, _Copy(stack.pop_all())


def _download_rest(file: Any, location: ObjectName, stamp: str, size: int) -> None:
    """Download the bytes that a file does not have yet."""
    done = file.tell()
    if done == size:
        return
    # under the condition: the rest has to be of the same version as what is here already
    answer = call_store(location, "get_object", Key=location.key, IfMatch=stamp, Range=f"bytes={done}-")
    for piece in pieces_of(answer):
        file.write(piece)
    if file.tell() != size:
        raise RefusedError("IncompleteRead", "")


OBJECTS = ObjectStore()
