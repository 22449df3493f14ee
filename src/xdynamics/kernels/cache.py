"""Files that spare a compilation: the user's own, written whole or not at all, and believed by a keyed digest alone.

What is read here is executed. A folder or a file that anybody else owns or may write to is therefore no cache, whichever
variable named it, and that is decided on the descriptors that are read, so that nothing can be exchanged between the look
and the use. In front of every file stands the HMAC-SHA256 (RFC 2104) of its name and content under a secret of the user,
which lies beside the default folder and never in a folder that `$XDYNAMICS_CACHE` names: what somebody else prepared is
not believed even where the folder was once open.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from xdynamics.faults import escaped

ENVIRONMENT, LIMIT = "XDYNAMICS_CACHE", "XDYNAMICS_CACHE_LIMIT"
MOST_MEGABYTES = 256.0  # of all that is kept, where $XDYNAMICS_CACHE_LIMIT does not say
MOST_DAYS = 180.0  # since a file was last read or written
ROOM = 8_000_000  # bytes that are free where an engine is to be kept
LARGEST = 500_000_000  # bytes of a file that is read at all
ABANDONED = 3600.0  # seconds after which a part that nobody finished is nobody's
FRESH = 3600.0  # seconds for which a file that was read need not be marked as used again
_FORMAT = "keyed digest in front"
_PART = ".part"
_SEAL = hashlib.sha256().digest_size
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ADVISED: list[str] = []
# a pipe in the place of a file would wait for its writer for ever; a link may lead anywhere
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_BINARY"))
_POSIX = os.name == "posix"


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if chosen := os.environ.get(ENVIRONMENT):
        return _from_here(chosen)
    return _default()


def _default() -> Path:
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
    return hashlib.sha256("\0".join([_FORMAT, *parts]).encode()).hexdigest()


def read(name: str) -> bytes | None:
    """Return what a file holds; None where it is not there, not the user's own, or not what was written.

    The bytes that were compared with the digest are the bytes that are returned: no later look at the file.
    """
    try:
        with _opened(folder()) as place:
            whole = _content(place, name)
    except OSError:
        return None
    if whole is None:
        return None
    seal, content = whole[:_SEAL], whole[_SEAL:]
    try:
        return content if hmac.compare_digest(seal, _seal(name, content, create=False)) else None
    except OSError:
        return None


def write(name: str, content: bytes) -> None:
    """Keep a file with its digest in front; where that cannot be done it is said, once, and the process goes on."""
    try:
        sealed = _seal(name, content, create=True) + content
        with _opened(folder(), create=True) as place:
            part = f"{name[:20]}-{secrets.token_hex(8)}{_PART}"
            try:
                with os.fdopen(
                    os.open(part, _FLAGS | os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600, **_at(place)), "wb"
                ) as file:
                    file.write(sealed)
                _replace(place, part, name)
            except BaseException:
                with suppress(OSError):
                    os.unlink(part, **_at(place))
                raise
            _prune(place, name)
    except OSError as error:
        advise(_reason(error))


def obstacle() -> str:
    """Say why no engine could be kept, before the time is spent on one; nothing where it could."""
    try:
        _secret(create=True)
        with _opened(folder(), create=True), tempfile.NamedTemporaryFile(dir=folder(), suffix=_PART) as probe:
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
        "xdynamics: compiled code cannot be kept in '%s' (%s), so every process compiles it again; set %s to a folder of"
        " your own that nobody else can write to and that has room", escaped(str(folder())), reason, ENVIRONMENT,
    )  # fmt: skip


def _reason(error: OSError) -> str:
    return error.strerror or str(error)


@contextmanager
def _opened(place: Path, *, create: bool = False) -> Iterator[int]:
    """Hold a folder open that is the user's own and that nobody else can write to.

    Raises
    ------
    OSError
        Where there is none, or it is somebody else's.
    """
    if create:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _POSIX:
        yield -1
        return
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
    # among everybody's temporary files a link may be anybody's; a user's own link to a larger disk is meant
    held = os.open(place, flags | (os.O_NOFOLLOW if place.parent == Path(tempfile.gettempdir()) else 0))
    try:
        _check_own(os.fstat(held), "folder")
        yield held
    finally:
        os.close(held)


def _check_own(about: os.stat_result, what: str) -> None:
    if _POSIX and about.st_uid != _user():
        raise PermissionError(1, f"the {what} belongs to user {about.st_uid}, not to user {_user()}")
    if _POSIX and about.st_mode & _OTHERS:
        raise PermissionError(1, f"others may write to the {what}: take that from them by `chmod go-w`")


def _at(place: int) -> dict[str, int]:
    return {"dir_fd": place} if _POSIX else {}


def _content(place: int, name: str) -> bytes | None:
    """All bytes of a regular file of the user's own; its time of use is renewed, by which old files are told."""
    with os.fdopen(os.open(name if _POSIX else folder() / name, _FLAGS | os.O_RDONLY, **_at(place)), "rb") as file:
        about = os.fstat(file.fileno())
        if not stat.S_ISREG(about.st_mode) or about.st_size > LARGEST:
            return None
        _check_own(about, "file")
        whole = file.read()
        if _POSIX and time.time() - about.st_mtime > FRESH:
            with suppress(OSError):
                os.utime(file.fileno())
    return whole


def _replace(place: int, part: str, name: str) -> None:
    """Put a finished part where its file belongs."""
    if not _POSIX:
        (folder() / part).replace(folder() / name)
        return
    with suppress(FileNotFoundError):
        if stat.S_ISDIR(os.stat(name, dir_fd=place, follow_symlinks=False).st_mode):
            shutil.rmtree(name, dir_fd=place)  # nothing else makes way for a file
    os.replace(part, name, src_dir_fd=place, dst_dir_fd=place)


def _seal(name: str, content: bytes, *, create: bool) -> bytes:
    return hmac.digest(_secret(create=create), name.encode() + b"\0" + content, "sha256")


def _secret(*, create: bool) -> bytes:
    """Return the user's secret, from a file of mode 600 beside the default folder.

    Raises
    ------
    OSError
        Where there is none, or others may read or write it.
    """
    path = _default().with_name(f"{_default().name}.secret")
    try:
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    except FileNotFoundError:
        if not create:
            raise
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _found_secret(path)
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    with os.fdopen(handle, "rb") as file:
        about = os.fstat(file.fileno())
        _check_own(about, f"secret '{path}'")
        if not stat.S_ISREG(about.st_mode) or (_POSIX and about.st_mode & 0o077):
            raise PermissionError(1, f"others may read '{path}': remove it, and a new secret is made")
        secret = file.read()
    if len(secret) != _SEAL:
        raise OSError(22, f"'{path}' holds no secret: remove it, and a new one is made")
    return secret


def _found_secret(path: Path) -> None:
    """Make a secret; of several processes that do so at once the first one's stays."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}-", suffix=_PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(secrets.token_bytes(_SEAL))
        try:
            os.link(part, path, follow_symlinks=False)
        except FileExistsError:
            pass
        except OSError:  # a file system without links: the last one's stays
            Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _prune(place: int, written: str) -> None:
    """Remove what is old, the least used beyond the limit, and the parts of processes that died while they wrote."""
    now, kept = time.time(), []
    with os.scandir(place if _POSIX else folder()) as entries:
        found = list(entries)
    for entry in found:
        try:
            about = entry.stat(follow_symlinks=False)
        except FileNotFoundError:  # another process has removed it since
            continue
        age = now - about.st_mtime
        if entry.name.endswith(_PART) and age > ABANDONED:
            _remove(place, entry)
        elif stat.S_ISREG(about.st_mode) and entry.name != written and not entry.name.endswith(_PART):
            kept.append((age, about.st_size, entry))
    total = 0
    for age, size, entry in sorted(kept, key=lambda row: (row[0], row[2].name)):
        total += size
        if total > 1e6 * most_megabytes() or age > 86400.0 * MOST_DAYS:
            _remove(place, entry)


def _remove(place: int, entry: os.DirEntry[str]) -> None:
    with suppress(OSError):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.name if _POSIX else entry.path, dir_fd=place if _POSIX else None)
        else:
            os.unlink(entry.name if _POSIX else entry.path, **_at(place))


def most_megabytes() -> float:
    """Return how much may be kept: $XDYNAMICS_CACHE_LIMIT in MB; a text that is no number of them counts as none."""
    try:
        limit = float(os.environ.get(LIMIT, MOST_MEGABYTES))
    except ValueError:
        return MOST_MEGABYTES
    return limit if limit >= 0.0 else MOST_MEGABYTES
