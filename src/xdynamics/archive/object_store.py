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
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary, finalize

from xdynamics.archive.lease import leased
from xdynamics.archive.object_calls import ATTEMPTS, RefusedError, body_of, call, pieces_of, worded
from xdynamics.archive.place import ObjectName
from xdynamics.archive.store import FOLDER, Held, LockedError, NewFile, TakenError
from xdynamics.archive.temporary_files import TemporaryFile, sweep
from xdynamics.faults import ArchiveError, InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

SINGLE = 1 << 26  # bytes up to which a file is uploaded in one call
MOST_PARTS = 9000
AGAIN = 60.0  # s after which a folder is searched for uploads of dead processes again
BUILDING, LOCK, WRITER = ".building", ".lock", "xdynamics-writer"


class ObjectStore:
    """Objects of buckets; see `Store`. A folder is what their names have in common up to a slash."""

    def __init__(self) -> None:
        self._copies: WeakValueDictionary[tuple[ObjectName, str], Held] = WeakValueDictionary()
        self._fetching = threading.Lock()
        self._cleared: dict[ObjectName, float] = {}

    def check_source(self, place: ObjectName) -> None:
        """Check that there is an object."""
        kind = self.kind(place)
        if kind == "":
            raise InputError(f"'{place}' does not exist")
        if kind is not None:
            raise InputError(f"'{place}' is {kind}; name a file in it")

    def check_target(self, place: ObjectName, model: Model | None = None) -> None:  # noqa: ARG002 - models are of folders
        """Check that the name is free or an object's, and by an upload that is not finished that it may be written."""
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
            if place.key and _head(place) is not None:
                return None
            return FOLDER if self._is_folder(place) else ""

    def _is_folder(self, place: ObjectName) -> bool:
        with _telling(place, "cannot be read"):
            under = call(place, "list_objects_v2", Prefix=f"{place.key}/".lstrip("/"), MaxKeys=1)
        return bool(under.get("KeyCount")) or not place.key

    def stamp(self, place: ObjectName) -> str | None:
        """Return the ETag of an object."""
        with _telling(place, "cannot be read"):
            return _stamp_of(_head(place))

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
        """Read a small object."""
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
            head = _head(place)
        if head is None:
            raise InputError(f"'{place}' does not exist")
        found = str(_stamp_of(head))
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
    def taking_name(self, place: ObjectName, batch: Any = None) -> Iterator[NewFile[ObjectName]]:  # noqa: ARG002 - each by itself
        """Lend a local temporary file, and upload it whole in the end.

        Raises
        ------
        TakenError
            If another process wrote the object meanwhile.
        ArchiveError
            If it cannot be uploaded.
        """
        before = self.stamp(place) if place.key else None
        if before is None and self._is_folder(place):
            raise InputError(f"'{place}' is a directory; name a file in it, like '{place / 'run.nc'}'")
        if time.monotonic() - self._cleared.get(place.parent, -AGAIN) >= AGAIN:
            self.clear(place.parent)
        with _temporary(place) as part:
            new = NewFile(part.path, place)
            yield new
            try:
                _upload(part.path, new.name, before if new.name == place else self.stamp(new.name))
            except InputError as error:
                if not new.keeps:
                    raise
                raise type(error)(f"{error}; the whole file is kept as '{_kept(part.path, new.name)}'") from None

    def check_empty(self, place: ObjectName) -> None:
        """Check that nothing is in a folder, but what a dead process left half-built."""
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
                    _upload(file, place / file.name, None)
            self.remove(mark)

    def made_folder(self, place: ObjectName) -> ObjectName:
        """Return a folder, which is there when something is in it."""
        if self.kind(place) is None:
            raise InputError(f"'{place}' is a file; name a folder")
        return place

    def new_folder(self, place: ObjectName) -> None:
        """Check that nothing is in a folder."""
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
            for key, upload in _uploads(folder, f"{folder.key}/".lstrip("/")):
                place = ObjectName(folder.bucket, key)
                with suppress(LockedError), leased(_lock_of(place), place):
                    call(folder, "abort_multipart_upload", Key=key, UploadId=upload)


def _lock_of(place: ObjectName) -> ObjectName:
    return place.with_name(f".{place.name}{LOCK}")


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


def _uploads(place: ObjectName, prefix: str) -> list[tuple[str, str]]:
    """List the unfinished uploads of objects whose names begin so."""
    uploads = call(place, "list_multipart_uploads", Prefix=prefix).get("Uploads") or []
    return [(str(entry["Key"]), str(entry["UploadId"])) for entry in uploads]


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


def _upload(part: Path, place: ObjectName, before: str | None) -> None:
    """Upload a file under the condition that what is there is what was there before.

    An answer that was lost is looked for: each upload bears a mark of its own.

    Raises
    ------
    TakenError
        If another process was faster.
    ArchiveError
        If the store refuses, or does not answer.
    """
    mark = secrets.token_hex(16)
    about = {"Key": place.key, "Metadata": {WRITER: mark}}
    condition = {"IfNoneMatch": "*"} if before is None else {"IfMatch": before}
    try:
        if part.stat().st_size <= SINGLE:
            call(place, "put_object", Body=part.read_bytes(), **about, **condition)
        else:
            with leased(_lock_of(place), place):
                _upload_parts(part, place, about, condition, before)
    except RefusedError as error:
        with suppress(RefusedError):
            if (_head(place) or {}).get("Metadata", {}).get(WRITER) == mark:
                return
        if error.is_taken or (before is not None and error.is_absent):
            raise TakenError(
                f"'{place}' was {'removed' if error.is_absent else 'written'} by another process meanwhile, and is left as"
                " it is; name another file, or call again to replace it"
            ) from None
        raise worded(place, "cannot be written", error) from None


def _upload_parts(
    part: Path, place: ObjectName, about: dict[str, Any], condition: dict[str, str], before: str | None
) -> None:
    """Upload a large file part by part; other uploads of the object are of dead processes, as its lock is held here."""
    for key, upload in _uploads(place, place.key):
        if key == place.key:
            call(place, "abort_multipart_upload", Key=key, UploadId=upload)
    upload = str(call(place, "create_multipart_upload", **about)["UploadId"])
    try:
        size = max(SINGLE, -(-part.stat().st_size // MOST_PARTS))
        parts: list[dict[str, Any]] = []
        with part.open("rb") as file:
            while content := file.read(size):
                number = len(parts) + 1
                answer = call(place, "upload_part", Key=place.key, UploadId=upload, PartNumber=number, Body=content)
                parts.append({"PartNumber": number, "ETag": answer["ETag"]})
        _check_stamp(place, before)  # some stores know the conditions of a whole object only
        done = {"Key": place.key, "UploadId": upload, "MultipartUpload": {"Parts": parts}}
        call(place, "complete_multipart_upload", **done, **condition)
    except BaseException:
        with suppress(RefusedError):
            call(place, "abort_multipart_upload", Key=place.key, UploadId=upload)
        raise


def _check_stamp(place: ObjectName, stamp: str | None) -> None:
    if stamp != _stamp_of(_head(place)):
        raise RefusedError("PreconditionFailed", "")


def _stamp_of(head: dict[str, Any] | None) -> str | None:
    return None if head is None else str(head["ETag"])


def _head(place: ObjectName) -> dict[str, Any] | None:
    """Ask what is under a name; None if there is nothing."""
    try:
        return call(place, "head_object", Key=place.key)
    except RefusedError as error:
        if error.is_absent:
            return None
        raise


OBJECTS = ObjectStore()
