"""Places of files: a path of the file system, or the name of an object like ``s3://bucket/runs/one.nc``."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path, PurePosixPath

from xdynamics.faults import InputError

SCHEME = "s3://"
LONGEST = 1024  # bytes of an object's name
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


@dataclass(frozen=True)
class ObjectName:
    """The name of an object in a bucket, which behaves as the name of a file does; what is there, its store says.

    Attributes
    ----------
    bucket : str
    key : str
        Without a slash at either end; empty for the bucket itself.
    """

    bucket: str
    key: str

    def __str__(self) -> str:
        return f"{SCHEME}{self.bucket}/{self.key}".removesuffix("/")

    def __truediv__(self, name: str) -> ObjectName:
        return ObjectName(self.bucket, f"{self.key}/{name}" if self.key else name)

    @property
    def name(self) -> str:
        """What follows the last slash."""
        return PurePosixPath(self.key).name

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return PurePosixPath(self.key).stem

    @property
    def suffix(self) -> str:
        """The name's ending, like ``.nc``."""
        return PurePosixPath(self.key).suffix

    @property
    def parent(self) -> ObjectName:
        """What precedes the last slash, as a folder."""
        return ObjectName(self.bucket, self.key.rpartition("/")[0])

    def with_name(self, name: str) -> ObjectName:
        """Return another object of the same folder."""
        return self.parent / name

    def with_suffix(self, suffix: str) -> ObjectName:
        """Return the object with another ending."""
        return self.with_name(self.stem + suffix)

    def absolute(self) -> ObjectName:
        """Return itself: a name in a bucket depends on no current folder."""
        return self


Place = Path | ObjectName
Given = str | PathLike[str] | ObjectName  # what a user may give for a place
GIVEN = (str, PathLike, ObjectName)


def resolve_links(location: Place) -> Place:
    """Return the place that links lead to."""
    return Path(os.path.realpath(location)) if isinstance(location, Path) else location


def location_of(named_location: Given) -> Place:
    """Return the place that a text or a path names.

    Raises
    ------
    InputError
        If it is neither a text nor a path, an address of another kind, has credentials in it, or is no name of an object.
        Credentials are not repeated in the message.

    Examples
    --------
    >>> str(location_of("s3://bucket/runs/one.nc").with_suffix(".png"))
    's3://bucket/runs/one.png'
    """
    if isinstance(named_location, ObjectName | Path):
        text = str(named_location)
        if isinstance(named_location, Path) and text.startswith("s3:/"):
            raise InputError(f"{text[:80]!r} is a Path, which drops a slash of an address; give the address as a text")
        return named_location
    if not isinstance(named_location, str | PathLike):
        raise InputError(f"{type(named_location).__name__} is no name of a file; give a text or a Path")
    text = fspath(named_location)
    address = _ADDRESS.match(text)
    if address is None:
        return Path(text)
    if address[0] != SCHEME:
        raise InputError(
            f"addresses that begin with '{address[0]}' are unknown; there are folders, and '{SCHEME}bucket/name'"
        )
    bucket, _, key = text.removeprefix(SCHEME).partition("/")
    if (
        "@" in bucket
        or ("@" in key.partition("/")[0] and ":" in bucket)
        or re.search(r"[?&]X-Amz-", text, re.IGNORECASE)
    ):
        raise InputError(
            f"credentials stand in an address that begins with '{SCHEME}'; leave them out of it, and give them by the"
            " environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or ~/.aws"
        )
    if fault := _object_name_fault(bucket, key.rstrip("/")):
        raise InputError(f"'{text[:80]}' names no object: {fault}")
    return ObjectName(bucket, key.rstrip("/"))


def check_file_name(name: str) -> None:
    """Check that a text can name a file in a folder, and no other place.

    Raises
    ------
    InputError

    Examples
    --------
    >>> check_file_name("rocket_2")
    """
    if not name.strip(" ") or name.startswith(".") or not name.isprintable() or {"/", "\\"} & {*name}:
        raise InputError(
            f"{name[:60]!r} is no name of a file in the folder; use letters, digits, '-' and '_', and name other folders"
            " where the folder is given"
        )


def _object_name_fault(bucket: str, key: str) -> str:
    """Describe why a name cannot be one of an object; empty if it can."""
    if not _BUCKET.fullmatch(bucket):
        return f"the bucket is '{bucket[:70]}', needs 3 to 63 small letters, digits, dots or hyphens"
    parts = key.split("/") if key else []
    if odd := [part for part in parts if part in ("", ".", "..")]:
        return f"it has '{odd[0]}' between slashes, which other programs take for another folder"
    if not key.isprintable():
        return "it holds characters that cannot be shown"
    if len(key.encode()) > LONGEST:
        return f"it has {len(key.encode())} bytes, {LONGEST} are the most"
    return ""
