"""Files that spare a compilation: written whole or not at all, and only bytes whose digest holds are ever used."""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import stat
import tempfile
import time
from functools import lru_cache
from pathlib import Path

from xdynamics.faults import escaped

ENVIRONMENT = "XDYNAMICS_CACHE"
ROOM = 8_000_000  # bytes that are free where an engine is to be kept
LARGEST = 500_000_000  # bytes of a file that is read at all
ABANDONED = 3600.0  # seconds after which a part that nobody finished is nobody's
_PART = ".part"
_ADVISED: list[str] = []


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if chosen := os.environ.get(ENVIRONMENT):
        return _from_here(chosen)
    if kept := os.environ.get("XDG_CACHE_HOME"):
        return _from_here(kept) / "xdynamics"
    try:
        return _from_here(str(Path.home())) / ".cache" / "xdynamics"
    except RuntimeError:  # nobody's process: there is no home
        return Path(tempfile.gettempdir()) / f"xdynamics-{_user()}"


@lru_cache
def _from_here(chosen: str) -> Path:
    """A path as it was meant when it was first asked for, wherever the process goes later."""
    return Path(chosen).absolute()


def digest(*parts: str) -> str:
    """sha256 of texts, each kept apart from the next."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def read(name: str) -> bytes | None:
    """Return what a file holds; None where it is not there, cannot be read or is not what was written.

    The bytes that were compared with the digest are the bytes that are returned: no later look at the file.
    """
    # a pipe in the place of a file would wait for its writer for ever
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        _check_owner(folder())
        with os.fdopen(os.open(folder() / name, flags), "rb") as file:
            about = os.fstat(file.fileno())
            if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST:
                return None
            whole = file.read()
    except OSError:
        return None
    seal, content = whole[:32], whole[32:]
    return content if hashlib.sha256(content).digest() == seal else None


def write(name: str, content: bytes) -> None:
    """Keep a file with its digest in front; where that cannot be done it is said, once, and the process goes on."""
    try:
        _make(folder())
        handle, part = tempfile.mkstemp(dir=folder(), prefix=f"{name[:20]}-", suffix=_PART)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(content).digest() + content)
            if (folder() / name).is_dir() and not (folder() / name).is_symlink():
                shutil.rmtree(folder() / name)  # nothing else makes way for a file
            Path(part).replace(folder() / name)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
        _sweep()
    except OSError as error:
        advise(_reason(error))


def obstacle() -> str:
    """Say why no engine could be kept, before the time is spent on one; nothing where it could."""
    try:
        _make(folder())
        with tempfile.NamedTemporaryFile(dir=folder(), suffix=_PART) as probe:
            probe.write(bytes(ROOM))
            probe.flush()
    except OSError as error:
        return _reason(error)
    return ""


def advise(reason: str) -> None:
    """Say once in a process that nothing can be kept, and what helps."""
    if _ADVISED:
        return
    _ADVISED.append(reason)
    logging.getLogger("xdynamics").warning(
        "xdynamics: compiled code cannot be kept in '%s' (%s), so every process compiles it again; set %s to a folder that"
        " can be written and has room", escaped(str(folder())), reason, ENVIRONMENT,
    )  # fmt: skip


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


def _make(place: Path) -> None:
    place.mkdir(parents=True, exist_ok=True)
    _check_owner(place)


def _check_owner(place: Path) -> None:
    """Refuse a folder among everybody's temporary ones that somebody else could have put there."""
    if place.parent != Path(tempfile.gettempdir()) or place.name != f"xdynamics-{_user()}":
        return
    about = place.lstat()
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != _user() or about.st_mode & 0o022:
        raise PermissionError(1, "it is not this user's own folder")


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0


def _sweep() -> None:
    """Remove the parts of processes that died while they wrote."""
    for part in folder().glob(f"*{_PART}"):
        if time.time() - part.lstat().st_mtime > ABANDONED:
            part.unlink(missing_ok=True) if not part.is_dir() else shutil.rmtree(part, ignore_errors=True)
