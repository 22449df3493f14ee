"""Uploads of complete files: one under a condition, or several that take their names together."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from xdynamics.archive.object_calls import RefusedError, call_store, client, leased, refusal_error
from xdynamics.archive.store import LockedError, NewFile, ObjectName, TakenError
from xdynamics.archive.target import TemporaryFile
from xdynamics.faults import InputError

SINGLE = 1 << 26  # bytes up to which a file is uploaded in one call
MOST_PARTS = 9000
AT_ONCE = 16  # calls of a store at a time
LOCK, WRITER, BATCH = ".lock", "xdynamics-writer", ".batch-"
Entry = TypeVar("Entry")
Answer = TypeVar("Answer")


def upload_file(part: Path, location: ObjectName, previous_stamp: str | None) -> None:
    """Upload a file under the condition that the object has not changed since it was stamped.

    An answer that was lost is looked for: each upload bears a mark of its own.

    Raises
    ------
    TakenError
        If another process was faster.
    ArchiveError
        If the store refuses, or does not answer.
    """
    upload = Upload(part, location, previous_stamp)
    with upload.understood():
        if part.stat().st_size <= SINGLE:
            call_store(location, "put_object", Body=part.read_bytes(), **upload.about, **upload.condition)
            return
        with leased(lock_of(location), location):
            for key, upload_id in uploads_of(location, location.key):  # of dead processes, as the lock is held here
                if key == location.key:
                    call_store(location, "abort_multipart_upload", Key=key, UploadId=upload_id)
            try:
                upload.send()
                upload.complete()
            except BaseException:
                upload.abort()
                raise


class Upload:
    """A file on its way to a store, part by part: there is nothing to be seen of it before it is complete.

    Attributes
    ----------
    part : Path
    place : ObjectName
    before : str, optional
        What was there when its writing began.
    """

    def __init__(self, part: Path, location: ObjectName, previous_stamp: str | None) -> None:
        self.part, self.location, self.previous_stamp = part, location, previous_stamp
        self._mark, self._id, self._parts = secrets.token_hex(16), "", list[dict[str, Any]]()

    @property
    def about(self) -> dict[str, Any]:
        """The object's name, and the mark of this upload."""
        return {"Key": self.location.key, "Metadata": {WRITER: self._mark}}

    @property
    def condition(self) -> dict[str, str]:
        """The condition that the object has not changed since it was stamped, or still does not exist."""
        return {"IfNoneMatch": "*"} if self.previous_stamp is None else {"IfMatch": self.previous_stamp}

    def send(self) -> None:
        """Send all parts."""
        self._id = str(call_store(self.location, "create_multipart_upload", **self.about)["UploadId"])
        # S3 takes 10,000 parts at most, so those of a very large file have to be larger
        size = max(SINGLE, -(-self.part.stat().st_size // MOST_PARTS))
        about = {"Key": self.location.key, "UploadId": self._id}
        with self.part.open("rb") as file:
            while content := file.read(size):
                number = len(self._parts) + 1
                answer = call_store(self.location, "upload_part", PartNumber=number, Body=content, **about)
                self._parts.append({"PartNumber": number, "ETag": answer["ETag"]})

    def complete(self) -> None:
        """Give the object its name, if the former object is still there unchanged.

        Raises
        ------
        TakenError
            If another process wrote or removed the object meanwhile.
        ArchiveError
            If the store refuses to write.
        """
        if self.previous_stamp != stamp_of(
            head_of(self.location)
        ):  # some stores know the conditions of a whole object only
            raise RefusedError("PreconditionFailed", "")
        done = {"Key": self.location.key, "UploadId": self._id, "MultipartUpload": {"Parts": self._parts}}
        call_store(self.location, "complete_multipart_upload", **done, **self.condition)

    def abort(self) -> None:
        """Discard the uploaded parts."""
        if self._id:
            with suppress(RefusedError):
                call_store(self.location, "abort_multipart_upload", Key=self.location.key, UploadId=self._id)

    @contextmanager
    def understood(self) -> Iterator[None]:
        """Raise a store's refusals in words, unless the object was written and only the answer was lost.

        Raises
        ------
        TakenError
            If another process wrote or removed the object meanwhile.
        ArchiveError
            If the store refuses to write.
        """
        try:
            yield
        except RefusedError as error:
            with suppress(RefusedError):
                if (head_of(self.location) or {}).get("Metadata", {}).get(WRITER) == self._mark:
                    return
            if error.is_taken or error.code == "NoSuchUpload" or (self.previous_stamp is not None and error.is_absent):
                raise TakenError(
                    f"'{self.location}' was {'removed' if error.is_absent else 'written'} by another process meanwhile, and is"
                    " left as it is; name another file, or call again to replace it"
                ) from None
            raise refusal_error(self.location, "cannot be written", error) from None


class ObjectBatch:
    """Files that take their names together: all are sent, several at once, and only then completed one and all.

    Before the first is complete nothing is to be seen of any, and if one cannot be sent none is. A store completes each by
    itself: if one of them fails then, the others have their names.

    Parameters
    ----------
    locations : sequence of ObjectName
    stamp : callable
        Returns what is under a name.
    """

    def __init__(self, locations: Sequence[ObjectName], stamp: Callable[[ObjectName], str | None]) -> None:
        self._stamp, self._parts, self._files = stamp, ExitStack(), list[NewFile[ObjectName]]()
        self._before: Mapping[ObjectName, str | None] = dict(
            zip(locations, call_concurrently(stamp, locations), strict=True)
        )

    def __enter__(self) -> ObjectBatch:
        return self

    def __exit__(self, *_error: object) -> None:
        self._parts.close()

    def add(self, part: AbstractContextManager[TemporaryFile], location: ObjectName) -> NewFile[ObjectName]:
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
        uploads = [Upload(new.part, new.name, self._stamp_before(new.name)) for new in self._files]
        with ExitStack() as locks:
            for folder in dict.fromkeys(upload.location.parent for upload in uploads):
                # by this lock `clear` of another process knows that these uploads are of a living one
                locks.enter_context(leased(folder / f"{BATCH}{secrets.token_hex(8)}{LOCK}", folder))
            self._step_all_uploads(uploads, Upload.send, "none of {1} files has its name, nothing is changed")
            outcome_text = "{0} of {1} files have their names, under the others nothing is changed"
            self._step_all_uploads(uploads, Upload.complete, outcome_text)
        self._files.clear()

    def _stamp_before(self, name: ObjectName) -> str | None:
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
    client()  # made once, not in each thread
    with ThreadPoolExecutor(min(AT_ONCE, len(entries))) as pool:
        return [*pool.map(function, entries)]


def are_alive(folder: ObjectName) -> bool:
    """Whether a process is uploading several files into a folder; the locks of those that died are removed."""
    prefix = (folder / BATCH).key
    locks = call_store(folder, "list_objects_v2", Prefix=prefix).get("Contents") or []
    alive = False
    for entry in locks:
        try:
            # a lock that can be taken is of a dead process, and is removed as this block ends
            with leased(ObjectName(folder.bucket, str(entry["Key"])), folder):
                pass
        except LockedError:
            alive = True
    return alive


def lock_of(location: ObjectName) -> ObjectName:
    """Name the lock of an object."""
    return location.with_name(f".{location.name}{LOCK}")


def uploads_of(location: ObjectName, prefix: str) -> list[tuple[str, str]]:
    """List the unfinished uploads of objects whose names begin so."""
    uploads = call_store(location, "list_multipart_uploads", Prefix=prefix).get("Uploads") or []
    return [(str(entry["Key"]), str(entry["UploadId"])) for entry in uploads]


def stamp_of(head: dict[str, Any] | None) -> str | None:
    """Return the stamp that distinguishes versions of an object under one name."""
    return None if head is None else str(head["ETag"])


def head_of(location: ObjectName) -> dict[str, Any] | None:
    """Return the store's description of an object; None if it does not exist."""
    try:
        return call_store(location, "head_object", Key=location.key)
    except RefusedError as error:
        if error.is_absent:
            return None
        raise
