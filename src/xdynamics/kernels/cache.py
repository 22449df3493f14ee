"""Files that spare a compilation: written whole or not at all, believed only if their digest holds."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path

ENVIRONMENT = "XDYNAMICS_CACHE"
ROOM = 8_000_000  # bytes that are free where an engine is to be kept
_SEAL = "sealed"


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if chosen := os.environ.get(ENVIRONMENT):
        return _from_here(chosen)
    if kept := os.environ.get("XDG_CACHE_HOME"):
        return _from_here(kept) / "xdynamics"
    try:
        return Path.home() / ".cache" / "xdynamics"
    except RuntimeError:  # nobody's process: there is no home
        return Path(tempfile.gettempdir()) / "xdynamics"


@lru_cache
def _from_here(chosen: str) -> Path:
    """A path as it was meant when it was first asked for, wherever the process goes later."""
    return Path(chosen).absolute()


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
    except (OSError, ValueError):  # ValueError: bytes that are no text
        return None


@contextmanager
def filling(name: str) -> Iterator[Path | None]:
    """Give a new folder to write files to, and when they are written its name; it is whole or not there.

    Where nothing can be written, there is no folder: None.
    """
    part = _fresh(name)
    if part is None:
        yield None
        return
    try:
        yield part
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    try:
        (part / _SEAL).write_text(_seal_of(part))
        if sealed(name) is None:
            remove(name)  # what bears the name is damaged
        part.rename(folder() / name)
    except OSError:  # another process was first, or the disk is full: this process has what it compiled
        shutil.rmtree(part, ignore_errors=True)


def remove(name: str) -> None:
    """Remove what is damaged, be it a folder, a file or a link to nothing, so that a whole one can take its name."""
    place = folder() / name
    if place.is_symlink() or place.is_file():
        place.unlink(missing_ok=True)
    else:
        shutil.rmtree(place, ignore_errors=True)


def _fresh(name: str) -> Path | None:
    """Make a new folder with room for an engine, or find out now, not in the middle of a compilation, that there is none."""
    try:
        folder().mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=folder(), prefix=f"{name[:20]}-", suffix=".part"))
    except OSError:
        return None
    try:
        (part / "probe").write_bytes(bytes(ROOM))
        (part / "probe").unlink()
    except OSError:
        shutil.rmtree(part, ignore_errors=True)
        return None
    return part


def _seal_of(place: Path) -> str:
    files = sorted(one for one in place.rglob("*") if one.is_file() and one.name != _SEAL)
    lines = (f"{one.relative_to(place)} {hashlib.sha256(one.read_bytes()).hexdigest()}\n" for one in files)
    return "".join(lines)
