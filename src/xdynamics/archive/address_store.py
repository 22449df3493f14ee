"""What fsspec reaches by an address as a store: complete files, written under conditions.

A file is written on this machine first and uploaded complete: in one call, or in parts that become a file when all are
there. What must be new is created (``mode="create"``), and what replaces replaces the file that was there when the
writing began (``If-Match``): of two writers one is told. To be read, a file is downloaded to a temporary file, as
the netCDF library reads files: complete, as its seal covers every byte, none of which is believed before; of a large one
the structure, and each chunk when it is used, by digests of their own (`extents`).
"""

from __future__ import annotations

import secrets
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakValueDictionary, finalize

from xdynamics.archive.extents import FileExtent, PartialCopy, extents_of
from xdynamics.archive.filesystems import (
    PIECE,
    UNMARKED,
    RefusedError,
    answered,
    ask,
    ask_s3,
    download,
    fetch,
    filesystem,
    refusal_error,
    refusals_in_words,
    stamp_of,
    status_of,
)
from xdynamics.archive.leases import leased
from xdynamics.archive.seals import SEAL_LENGTH
from xdynamics.archive.store import FOLDER, OPEN, Address, LocalFile, NewFile, TakenError, check_writable
from xdynamics.archive.target import TemporaryFile, sweep_temporary_files
from xdynamics.faults import ArchiveError, InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

BUILDING, LOCK, WRITER = ".building", ".lock", "xdynamics-writer"
SINGLE = 1 << 26  # bytes up to which a file is uploaded in one call
MOST_PARTS = 9000  # S3 takes 10,000, so those of a very large file have to be larger
AT_ONCE = 16  # calls of a store at a time
ABANDONED = timedelta(days=1)  # after which the parts of an upload are those of a dead process
Entry = TypeVar("Entry")
Answer = TypeVar("Answer")


class AddressStore:
    """Files that fsspec reaches; see `Store`. A folder is a common beginning of names, up to a slash."""

    def __init__(self) -> None:
        self._copies: WeakValueDictionary[tuple[Address, str], LocalFile] = WeakValueDictionary()
        self._fetching = threading.Lock()

    def __reduce__(self) -> str:
        return "ADDRESSES"  # one in each process

    def check_source(self, location: Address) -> None:
        """Check that there is a file.

        Raises
        ------
        InputError
            If there is no file of that name.
        """
        kind = self.kind(location)
        if kind == "":
            raise InputError(f"'{location}' does not exist")
        if kind is not None:
            raise InputError(f"'{location}' is {kind}; name a file in it")

    def check_target(self, location: Address, model: Model | None = None) -> None:  # noqa: ARG002 - models are of folders
        """Check that the name is free or a file's, and in a bucket by an upload that is not finished that it may be written.

        Raises
        ------
        InputError
            If the name is a folder's, or addresses of this kind are only read.
        ArchiveError
            If the store refuses to write there.
        """
        check_writable(location)
        if self.kind(location) == FOLDER:
            raise InputError(f"'{location}' is a directory; name a file in it, like '{location / 'run.nc'}'")
        if location.scheme == "s3":
            with refusals_in_words(location, "cannot be written"):
                upload = ask_s3(location, "create_multipart_upload", Key=location.key)["UploadId"]
                ask_s3(location, "abort_multipart_upload", Key=location.key, UploadId=upload)

    def check_no_table(self, location: Address, tables: list[str]) -> None:
        """Check nothing: tables are read from folders."""

    def check_each(self, locations: Sequence[Address]) -> None:
        """Check all targets, several at once."""
        call_concurrently(self.check_target, locations)

    def kind(self, location: Address) -> str | None:
        """Return whether there is a file (None), others whose names begin so (a directory), or nothing."""
        with refusals_in_words(location, "cannot be read"):
            status = status_of(location)
        if status is None:
            return ""
        return None if status["type"] == "file" else FOLDER

    def stamp(self, location: Address) -> str | None:
        """Return the ETag of an object, or what else tells versions apart."""
        with refusals_in_words(location, "cannot be read"):
            return stamp_of(status_of(location))

    def names(self, folder: Address) -> list[Address]:
        """List files and folders."""
        with refusals_in_words(folder, "cannot be listed"):
            try:
                listed = ask(folder, "ls", detail=False)
            except RefusedError as error:
                if error.code == "NoSuchBucket" or not error.is_absent:
                    raise
                listed = []
        # a file lists itself, and a bucket may hold an object of the folder's own name and a slash
        own = {folder.name, ""} if folder.key else {""}
        found = {
            str(path).rstrip("/").rpartition("/")[2] for path in listed if not str(path).endswith(f"/{folder.key}/")
        }
        names = sorted(found - own) if len(found) > 1 or folder.name not in found else []
        return [folder / name for name in names if not (name.startswith(".") and name.endswith(LOCK))]

    def content(self, location: Address, max_bytes: int) -> bytes:
        """Read a small file.

        Raises
        ------
        InputError
            If it has more bytes than `max_bytes`.
        ArchiveError
            If it cannot be read.
        """
        with refusals_in_words(location, "cannot be read"):
            size = int(_known_status(location)["size"])
            if size > max_bytes:
                raise InputError(f"it has {size} bytes, over the limit of {max_bytes}")
            content: bytes = ask(location, "cat_file")
        return content

    def local_file(self, location: Address, *, whole: bool = True, stamp: str | None = None) -> LocalFile:
        """Download a file to a temporary one, which this process keeps as long as it is used.

        Parameters
        ----------
        location : Address
        whole : bool
            Whether all of it is needed now. Else the values of a large archive come when they are read, if its server has
            parts of files.
        stamp : str, optional
            Of the version that is wanted.

        Raises
        ------
        ArchiveError
            If it cannot be read, is another version, or the disk of temporary files has no room for it.
        """
        with refusals_in_words(location, "cannot be read"):
            status = _known_status(location)
        size, current = int(status["size"]), str(stamp_of(status))
        if stamp is not None and current != stamp:
            raise ArchiveError(f"'{location}' is another file than the one that was opened; open it again")
        # a thread that wants the same version waits here and finds the copy, instead of downloading it again
        with self._fetching:
            local_copy = None if current.startswith(UNMARKED) else self._copies.get((location, current))
            if local_copy is None or (whole and local_copy.partial is not None):
                path, copy, chunks = _download_copy(location, size, whole=whole)
                if self.stamp(location) != current:
                    raise ArchiveError(f"'{location}' was replaced while it was read; open it again")
                again = partial(self.local_file, location, whole=whole, stamp=current)
                local_copy = self._copies[location, current] = LocalFile(path, location, again, copy, chunks)
        return local_copy

    def written_at(self, location: Address) -> Path:
        """Return a path among temporary files."""
        return Path(tempfile.gettempdir()) / location.name

    @contextmanager
    def taking_name(self, location: Address, batch: UploadBatch | None = None) -> Iterator[NewFile[Address]]:
        """Lend a local temporary file, and upload it complete in the end.

        Raises
        ------
        TakenError
            If another process wrote the file meanwhile.
        ArchiveError
            If it cannot be uploaded.
        """
        if batch is not None:
            yield batch.add(_temporary_copy(location), location)
            return
        check_writable(location)
        with refusals_in_words(location, "cannot be read"):
            status = status_of(location)
        if status is not None and status["type"] != "file":
            raise InputError(f"'{location}' is a directory; name a file in it, like '{location / 'run.nc'}'")
        with _temporary_copy(location) as part:
            new = NewFile(part.path, location)
            yield new
            previous_stamp = stamp_of(status) if new.name == location else self.stamp(new.name)
            try:
                upload_file(part.path, new.name, previous_stamp)
            except InputError as error:
                if not new.keeps:
                    raise
                kept = _keep_upload_file(part.path, new.name)
                raise type(error)(f"{error}; the whole file is kept as '{kept}'") from None

    def batch(self, locations: Sequence[Address]) -> UploadBatch:
        """Return the batch that uploads several files together, each under a condition on the present one."""
        return UploadBatch(locations, self.stamp)

    def check_empty(self, location: Address) -> None:
        """Check that a folder has no files except those that a dead process left half-built.

        Raises
        ------
        InputError
            If something is in it.
        """
        names = self.names(location)
        if names and names[0].name != BUILDING:
            raise InputError(f"'{location}' holds '{names[0].name}' already; name a folder that is empty, or not there")

    @contextmanager
    def taking_folder(self, location: Address) -> Iterator[Path]:
        """Lend a local folder, and upload its files under a mark whose removal, last, makes the folder complete."""
        check_writable(location)
        with self.locked(location):
            mark = location / BUILDING
            if self.stamp(mark) is not None:  # of a process that died
                self._remove_all(location, besides=location / LOCK)
            self.check_empty(location)
            with tempfile.TemporaryDirectory() as built:
                yield Path(built)
                with refusals_in_words(location, "cannot be written"):
                    ask(mark, "pipe_file", b"", mode="create")
                _upload_folder(Path(built), location)
            self.remove(mark)

    @contextmanager
    def filled_folder(self, location: Address) -> Iterator[Path]:
        """Lend a temporary folder, whose files are uploaded in the end."""
        with tempfile.TemporaryDirectory() as built:
            yield Path(built)
            _upload_folder(Path(built), location)

    def made_folder(self, location: Address) -> Address:
        """Return a folder, which is there when something is in it.

        Raises
        ------
        InputError
            If the name is a file's.
        """
        check_writable(location)
        if self.kind(location) is None:
            raise InputError(f"'{location}' is a file; name a folder")
        return location

    def new_folder(self, location: Address) -> None:
        """Check that nothing is in a folder.

        Raises
        ------
        FileExistsError
            If something is in it.
        """
        if self.kind(location) != "":
            raise FileExistsError(f"'{location}' is there already")

    def locked(self, folder: Address) -> AbstractContextManager[None]:
        """Lock a folder by a file in it."""
        return leased(folder / LOCK, folder)

    def move(self, names: Sequence[str], folder: Address, target: Address) -> None:
        """Copy files in their store, several at once, and remove them in their former folder."""

        def move_one(name: str) -> None:
            with refusals_in_words(target / name, "cannot be written"), _absent_passed_over():
                ask(folder / name, "copy", str(target / name))
                ask(folder / name, "rm_file")

        call_concurrently(move_one, names)

    def remove(self, location: Address) -> None:
        """Remove a file; an empty folder is none."""
        if location.scheme == "memory" and self.kind(location) is not None:
            return
        with refusals_in_words(location, "cannot be removed"), _absent_passed_over():
            ask(location, "rm_file")

    def remove_folder(self, folder: Address) -> None:
        """Remove all files of a folder."""
        with suppress(InputError):
            self._remove_all(folder)

    def _remove_all(self, folder: Address, besides: Address | None = None) -> None:
        with refusals_in_words(folder, "cannot be removed"), _absent_passed_over():
            files = filesystem(folder.scheme)
            kept = files._strip_protocol(str(besides))  # noqa: SLF001 - as `find` names files
            if removed := [path for path in ask(folder, "find") if path != kept]:
                answered(files.rm, removed)

    def clear(self, folder: Address) -> None:
        """Remove temporary files of dead processes here, and in a bucket the parts of abandoned uploads into a folder."""
        sweep_temporary_files(Path(tempfile.gettempdir()))
        if folder.scheme == "s3":
            with suppress(RefusedError):
                _abort_uploads(folder, f"{folder.key}/".lstrip("/"), before=datetime.now(UTC) - ABANDONED)


ADDRESSES = AddressStore()


def _known_status(location: Address) -> dict[str, Any]:
    """Return the status of a file of known size."""
    status = status_of(location)
    if status is None:
        raise InputError(f"'{location}' does not exist")
    if not isinstance(status.get("size"), int):
        raise ArchiveError(f"'{location}' cannot be read: its server does not say how many bytes it has; download it")
    return status


@contextmanager
def _absent_passed_over() -> Iterator[None]:
    try:
        yield
    except RefusedError as error:
        if not error.is_absent or error.code == "NoSuchBucket":
            raise


def _upload_folder(folder: Path, location: Address) -> None:
    """Upload the files of a folder of this machine, several at once, where none of them is."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    names = [location / file.relative_to(folder).as_posix() for file in files]
    call_concurrently(lambda pair: upload_file(*pair, None), [*zip(files, names, strict=True)])


def upload_file(part: Path, location: Address, previous_stamp: str | None) -> None:
    """Upload a file under the condition that what stands under the name has not changed since it was stamped.

    Raises
    ------
    TakenError
        If another process was faster.
    ArchiveError
        If the store refuses, or does not answer.
    """
    upload = Upload(part, location, previous_stamp)
    with upload.understood():
        try:
            upload.send()
            upload.complete()
        except BaseException:
            upload.abort()
            raise


class Upload:
    """A file on its way to a store: nothing is to be seen of it before it is complete.

    Parameters
    ----------
    part : Path
    location : Address
    previous_stamp : str, optional
        Of what was there when its writing began.
    alone : bool
        Whether a small file may be sent in the call that completes it.
    """

    def __init__(self, part: Path, location: Address, previous_stamp: str | None, *, alone: bool = True) -> None:
        self.part, self.location, self.previous_stamp = part, location, previous_stamp
        size = part.stat().st_size
        self._in_parts = location.scheme == "s3" and size > 0 and (not alone or size > SINGLE)
        self._block = max(SINGLE, -(-size // MOST_PARTS))
        self._mark, self._file = secrets.token_hex(16), None

    def send(self) -> None:
        """Send the parts of a file that is completed afterwards; an earlier upload of the same name is given up."""
        if self._in_parts:
            _abort_uploads(self.location, self.location.key, exactly=True)
            self._file = self._sent()

    def complete(self) -> None:
        """Give the file its name, if what stands there is still unchanged.

        Raises
        ------
        RefusedError
            If it is not, or the store refuses to write.
        """
        if self._file is None and self.location.scheme == "s3" and self.part.stat().st_size:
            self._sent()
            return
        with _putting if self._file is None else nullcontext():  # memory is that of this process
            # some stores know the conditions of a whole object only
            if self.previous_stamp != stamp_of(status_of(self.location)):
                raise RefusedError("PreconditionFailed", "")
            if self._file is None:
                self._put()
            else:
                answered(self._file.commit)
                self._file = None

    def _sent(self) -> Any:
        """Send the file to S3; in parts it has its name when it is committed, else when this returns."""
        from s3fs import S3File

        condition = {} if self.previous_stamp is None else {"IfMatch": self.previous_stamp}
        file = S3File(
            filesystem("s3"),
            str(self.location),
            "wb" if condition else "xb",
            block_size=self._block,
            autocommit=not self._in_parts,
            s3_additional_kwargs=condition | {"Metadata": {WRITER: self._mark}},
        )
        try:
            with self.part.open("rb") as content:
                answered(shutil.copyfileobj, content, file, PIECE)
            answered(file.close)
        except BaseException:
            with suppress(RefusedError):
                answered(file.discard)
            file.closed = True  # else the finaliser would send what there is
            raise
        return file

    def _put(self) -> None:
        mode = "create" if self.previous_stamp is None else "overwrite"
        if self.location.scheme == "gs":
            if mode == "overwrite":
                raise InputError(
                    f"'{self.location}' is there, and objects of Google's store are not replaced under a condition, which"
                    " keeps two writers from each other's files; name another object, or remove this one first"
                )
            answered(filesystem("gs").put_file, str(self.part), str(self.location), mode=mode)
            return
        ask(self.location, "pipe_file", self.part.read_bytes(), mode=mode)

    def abort(self) -> None:
        """Discard the parts that were sent."""
        if self._file is not None:
            with suppress(RefusedError):
                answered(self._file.discard)
            self._file = None

    @contextmanager
    def understood(self) -> Iterator[None]:
        """Raise a store's refusals in words, unless the file was written and only the answer was lost.

        Raises
        ------
        TakenError
            If another process wrote or removed the file meanwhile.
        ArchiveError
            If the store refuses to write.
        """
        try:
            yield
        except RefusedError as error:
            with suppress(RefusedError):
                if self.location.scheme == "s3" and ask(self.location, "metadata").get(WRITER) == self._mark:
                    return
            if error.is_taken or error.code == "NoSuchUpload" or (self.previous_stamp is not None and error.is_absent):
                raise TakenError(
                    f"'{self.location}' was {'removed' if error.is_absent else 'written'} by another process meanwhile, and is"
                    " left as it is; name another file, or call again to replace it"
                ) from None
            raise refusal_error(self.location, "cannot be written", error) from None


_putting = threading.Lock()


def _abort_uploads(location: Address, prefix: str, *, exactly: bool = False, before: datetime | None = None) -> None:
    """Give up unfinished uploads of names that begin with a text, or are it, or of those that began before a moment."""
    for entry in ask_s3(location, "list_multipart_uploads", Prefix=prefix).get("Uploads") or []:
        if (not exactly or entry["Key"] == prefix) and (before is None or entry["Initiated"] < before):
            ask_s3(location, "abort_multipart_upload", Key=entry["Key"], UploadId=entry["UploadId"])


class UploadBatch:
    """Files that take their names together: all are sent, several at once, and only then completed one and all.

    Before the first is complete nothing is to be seen of any, and if one cannot be sent none is. A store completes each by
    itself: if one of them fails then, the others have their names.

    Parameters
    ----------
    locations : sequence of Address
    stamp : callable
        Returns what is under a name.
    """

    def __init__(self, locations: Sequence[Address], stamp: Callable[[Address], str | None]) -> None:
        self._stamp, self._parts, self._files = stamp, ExitStack(), list[NewFile[Address]]()
        self._before: Mapping[Address, str | None] = dict(
            zip(locations, call_concurrently(stamp, locations), strict=True)
        )

    def __enter__(self) -> UploadBatch:
        return self

    def __exit__(self, *_error: object) -> None:
        self._parts.close()

    def add(self, part: AbstractContextManager[TemporaryFile], location: Address) -> NewFile[Address]:
        """Add a temporary file, which is written, then uploaded, and removed when the batch is over."""
        self._files.append(NewFile(self._parts.enter_context(part).path, location))
        return self._files[-1]

    def take_names(self) -> None:
        """Upload all files.

        Raises
        ------
        InputError
            If that fails; it says how many files have their names.
        """
        uploads = [Upload(new.part, new.name, self._stamp_before(new.name), alone=False) for new in self._files]
        self._step_all_uploads(uploads, Upload.send, "none of {1} files has its name, nothing is changed")
        outcome_text = "{0} of {1} files have their names, under the others nothing is changed"
        self._step_all_uploads(uploads, Upload.complete, outcome_text)
        self._files.clear()

    def _stamp_before(self, name: Address) -> str | None:
        return self._before[name] if name in self._before else self._stamp(name)

    def _step_all_uploads(self, uploads: Sequence[Upload], step: Callable[[Upload], None], outcome_text: str) -> None:
        """Run a step of all uploads; if one fails, discard incomplete ones and raise all faults."""
        faults: list[InputError | None] = [None] * len(uploads)
        done = False
        try:
            faults = call_concurrently(partial(_upload_fault, step), uploads)
            done = not any(faults)
        finally:
            if not done:
                call_concurrently(Upload.abort, uploads)
        for fault in faults:
            if fault is not None:
                raise type(fault)(f"{fault}; {outcome_text.format(faults.count(None), len(faults))}")


def _upload_fault(step: Callable[[Upload], None], upload: Upload) -> InputError | None:
    """Run a step of an upload; return why it failed."""
    try:
        with upload.understood():
            step(upload)
    except InputError as error:
        return error
    return None


def call_concurrently(function: Callable[[Entry], Answer], entries: Sequence[Entry]) -> list[Answer]:
    """Call a function for several entries at once, as each call waits for a store; return the results in order."""
    if len(entries) < 2:
        return [*map(function, entries)]
    with ThreadPoolExecutor(min(AT_ONCE, len(entries))) as pool:
        return [*pool.map(function, entries)]


@contextmanager
def _temporary_copy(location: Address) -> Iterator[TemporaryFile]:
    """Make a temporary file on this machine."""
    folder = Path(tempfile.gettempdir())
    try:
        with TemporaryFile.create_beside(folder / (location.name or location.root), 0o600) as part:
            yield part
    except OSError as error:
        raise ArchiveError(
            f"'{location}' needs a temporary file in '{folder}', which cannot be written: {error.strerror or error}; name"
            " another folder by TMPDIR"
        ) from error


def _keep_upload_file(part: Path, name: Address) -> Path:
    """Give a temporary file a name under which it stays."""
    stays = part.with_name(f"xdynamics-{secrets.token_hex(4)}-{name.name}")
    part.rename(stays)
    return stays


class _Copy:
    """Removes a downloaded file when nothing uses it any more, at the latest when the process ends."""

    def __init__(self, stack: ExitStack) -> None:
        finalize(self, stack.close)


def _download_copy(location: Address, size: int, *, whole: bool) -> tuple[Path, _Copy, PartialCopy | None]:
    """Download a file to a temporary one; its structure alone, if it need not be whole and tells where that is."""
    folder = Path(tempfile.gettempdir())
    sweep_temporary_files(folder)
    extents = [] if whole else _extents(location, size)
    if not extents and size > (free := shutil.disk_usage(folder).free):
        raise ArchiveError(
            f"'{location}' has {size} bytes, and the disk of temporary files, '{folder}', {free} free; name another by TMPDIR"
        )
    with ExitStack() as stack:
        path = stack.enter_context(_temporary_copy(location)).path
        with refusals_in_words(location, "cannot be read"):
            chunks = PartialCopy(path, location, partial(_fetch_part, location), extents, size) if extents else None
            if chunks is None:
                download(location, path, size)
        return path, _Copy(stack.pop_all()), chunks


def _fetch_part(location: Address, start: int, end: int) -> bytes:
    with refusals_in_words(location, "cannot be read"):
        return fetch(location, start, end)


def _extents(location: Address, size: int) -> list[FileExtent]:
    """Return where values and structure of a large archive are; none if it does not tell, or its server has no parts."""
    if location.scheme in ("memory", OPEN):
        return []
    try:
        return extents_of(partial(fetch, location), size - SEAL_LENGTH)
    except RefusedError:  # another refusal than that of parts is told by the download
        return []
    except ArchiveError as error:
        raise ArchiveError(f"'{location}' is damaged: {error}") from None
