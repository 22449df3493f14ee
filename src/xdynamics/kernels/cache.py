"""Files that spare a compilation: written whole or not at all, believed only if their digest holds."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ENVIRONMENT = "XDYNAMICS_CACHE"
ROOM = 8_000_000  # bytes that are free where an engine is to be kept
_SEAL = "sealed"


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if chosen := os.environ.get(ENVIRONMENT):
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "xdynamics"


def digest(*parts: str) -> str:
    """sha256 of texts, each kept apart from the next."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read(name: str) -> bytes | None:
    """Return what a file holds; None where it is not there, cannot be read or is not what was written."""
    try:
        whole = (folder() / name).read_bytes()
    except OSError:
        return None
    seal, content = whole[:32], whole[32:]
    return content if hashlib.sha256(content).digest() == seal else None


def write(name: str, content: bytes) -> None:
    """Keep a file with its digest in front; a folder that cannot be written costs a compilation each time, no more."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=folder(), suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
            Path(part).replace(folder() / name)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
    except OSError:
        return


def sealed(name: str) -> Path | None:
    """Return a folder of files that are all as they were written; None where it is not there or damaged."""
    place = folder() / name
    try:
        seal = (place / _SEAL).read_text()
        return place if seal == _seal_of(place) else None
    except OSError:
        return None


@contextmanager
def filling(name: str) -> Iterator[Path | None]:
    """Give a new folder to write files to, and when they are written its name; it is whole or not there.

    Where nothing can be written, there is no folder: None.
    """
    try:
        folder().mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=folder(), prefix=f"{name[:20]}-", suffix=".part"))
        _probe(part)
    except OSError:
        yield None
        return
    yield part
    try:
        (part / _SEAL).write_text(_seal_of(part))
        if sealed(name) is None:
            remove(name)  # what bears the name is damaged
        part.rename(folder() / name)
    except OSError:  # another process was first, or the disk is full: this process has what it compiled
        shutil.rmtree(part, ignore_errors=True)


def remove(name: str) -> None:
    """Remove a folder that is damaged, so that a whole one can take its name."""
    shutil.rmtree(folder() / name, ignore_errors=True)


def _probe(place: Path) -> None:
    """Raise now, not in the middle of a compilation, where the disk has no room for an engine."""
    (place / "probe").write_bytes(bytes(ROOM))
    (place / "probe").unlink()


def _seal_of(place: Path) -> str:
    files = sorted(one for one in place.rglob("*") if one.is_file() and one.name != _SEAL)
    lines = (f"{one.relative_to(place)} {hashlib.sha256(one.read_bytes()).hexdigest()}\n" for one in files)
    return "".join(lines)
