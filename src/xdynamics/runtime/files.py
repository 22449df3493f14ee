"""Regular files: bounded reading and synchronised writing; any other object at a path is an error.

The memory that a process can have is read here too, and sizes are put into words.
"""

from __future__ import annotations

import codecs
import errno
import os
import re
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TypeVar

from xdynamics.faults import InputError

UNITS = {"B": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "TB": 10**12}
ROOM = 0.8  # of the free memory, which may be asked for


def free_memory() -> float:
    """Return the memory that this process can have, bytes: the system's available memory, or the process limit."""
    available = float("inf")
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        available = next(1024.0 * int(line.split()[1]) for line in lines if line.startswith("MemAvailable"))
    except (OSError, StopIteration, ValueError):  # no Linux: nothing is known
        pass
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        used = 4096.0 * int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        available = min(available, limit - used) if limit != resource.RLIM_INFINITY else available
    except (ImportError, OSError, ValueError):
        pass
    return max(available, 0.0)


def bound_memory(more: int) -> None:
    """Bound the memory of this process by what it has now and so many bytes more; it leaves no core dump."""
    import resource

    # a file that makes the reader crash must not fill the disk with core dumps
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        return  # a system that does not report the memory in use
    # RLIMIT_AS counts all address space, much of which the libraries have taken before any file is read
    limit = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))


def size_text(size: float) -> str:
    """Write a size in words.

    Examples
    --------
    >>> size_text(1.5e9), size_text(3.2e15), size_text(12.0)
    ('1.5 GB', '3200 TB', '12 B')
    """
    unit = next((name for name in reversed(UNITS) if size >= UNITS[name]), "B")
    return f"{float(f'{size / UNITS[unit]:.2g}'):g} {unit}"


Answer = TypeVar("Answer")

KINDS = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a pipe (FIFO)",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}
_PIECE = 1 << 20
_SECRET = re.compile(r"^([A-Za-z][A-Za-z0-9+.-]+:/+).*@")
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/")  # a path has one slash of an address left


def ask_path(path: Path, question: Callable[[Path], Answer]) -> Answer:
    """Answer a question about a path.

    Raises
    ------
    InputError
        If it is no path at all: it holds a null character, is too long, or its links go round in a circle.
    """
    if "\0" in str(path):
        raise InputError(f"{str(path)[:80]!r} is no path for a file: it holds a null character")
    try:
        return question(path)
    except (OSError, RuntimeError) as error:  # RuntimeError: a circle of links
        why = getattr(error, "strerror", None) or error
        raise InputError(f"'{str(path)[:80]}' is no path for a file: {why}") from None


def path_kind(path: Path) -> str | None:
    """Return the kind of a path's target: nothing (``""``), a regular file (None), or other words."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return ""
    return None if stat.S_ISREG(mode) else KINDS.get(stat.S_IFMT(mode), "no regular file")


def file_above(path: str | os.PathLike[str]) -> str:
    """Return in words which file stands where a path needs a folder; empty if none does.

    Examples
    --------
    >>> file_above("pyproject.toml/x/run.nc"), file_above("runs/run.nc")
    ("'pyproject.toml' is a file, no folder", '')
    """
    above = next((parent for parent in Path(path).parents if path_kind(parent) != ""), None)
    kind = KINDS[stat.S_IFDIR] if above is None else path_kind(above)
    return "" if kind == KINDS[stat.S_IFDIR] else f"'{above}' is {kind or 'a file'}, no folder"


def reason(error: OSError, path: str | os.PathLike[str]) -> str:
    """Return why the system does not read or write a path, in words."""
    if isinstance(error, IsADirectoryError):
        return "it is a directory; name a file in it"
    return (isinstance(error, NotADirectoryError) and file_above(path)) or error.strerror or str(error)


def read_bounded(path: Path, max_bytes: int, remedy: str = "") -> bytes:
    """Read a regular file completely.

    Parameters
    ----------
    path : Path
    max_bytes : int
        Bytes that it may have.
    remedy : str
        What is to be done with one that has more, for the message.

    Raises
    ------
    OSError
        If it cannot be read.
    InputError
        If it is no regular file, or has more than `max_bytes` bytes; of a pipe or a device nothing is read.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe would wait for its writer
    with os.fdopen(handle, "rb") as file:
        # of the open file: the path may lead to another one by now
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"it is {KINDS.get(stat.S_IFMT(status.st_mode), 'no regular file')}")
        if status.st_size > max_bytes:
            raise InputError(f"it has {status.st_size} bytes, over the limit of {max_bytes}{remedy}")
        content = bytearray()
        while piece := file.read(_PIECE):  # some files, like those of /proc, are longer than they say
            content += piece
            if len(content) > max_bytes:
                raise InputError(f"it has over {max_bytes} bytes, the limit{remedy}")
    return bytes(content)


def is_inside(path: Path, folder: Path) -> bool:
    """Whether no link on the way from a folder to a file in it leads elsewhere."""
    return os.path.realpath(path) == os.path.join(os.path.realpath(folder), os.path.relpath(path, folder))  # noqa: PTH118 - of a text


def check_no_address(path: str | Path) -> None:
    """Refuse an address in place of a local file, and repeat no more than its scheme, as the rest may be secret.

    Raises
    ------
    InputError
    """
    if address := _ADDRESS.match(str(path)):
        raise InputError(f"it is an address, '{address[1]}://…', and only a file of this machine can be read here")


def displayed_path(path: str | os.PathLike[str]) -> str:
    """Return a path for a message: without the part before an ``@`` of an address, which may be a secret.

    Examples
    --------
    >>> displayed_path("runs/one.nc"), displayed_path("s3://key:secret@bucket/one.nc")
    ('runs/one.nc', 's3://…@bucket/one.nc')
    """
    return _SECRET.sub(r"\1…@", os.fspath(path))


def decoded(content: bytes) -> str:
    """Return a text in UTF-8, with or without its mark, or in UTF-16 with it, with lines that end by newlines.

    Raises
    ------
    ValueError
        If it is no such text.
    """
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    return content.decode("utf-16" if wide else "utf-8-sig").replace("\r\n", "\n").replace("\r", "\n")


def make_folder(folder: str | Path) -> Path:
    """Return a folder, made if it does not exist.

    Raises
    ------
    InputError
        If it cannot be made.
    """
    path = Path(folder)
    kind = ask_path(path, path_kind)
    if kind not in ("", KINDS[stat.S_IFDIR]):
        raise InputError(f"'{folder}' is {kind or 'a file'}; name a folder")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder '{folder}' cannot be made: {reason(error, path)}; name another") from None
    return path


@contextmanager
def synced(path: Path) -> Iterator[int]:
    """Lend a descriptor of a file or folder, and force the changes of the `with` block to the disk."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        yield handle
        os.fsync(handle)
    finally:
        os.close(handle)


def write_new(path: Path, content: bytes, mode: int = 0o666) -> None:
    """Write a new file completely under a free name, and force it to the disk; a failure leaves no file.

    It has no name before it is whole, so that neither a kill nor a disk that is full leaves a part of it; where the system
    has no files without names, a kill may.

    Raises
    ------
    FileExistsError
        If there is something under the name.
    OSError
        If it cannot be written.
    """
    # the folder is synchronised as the block ends: before that the name is not on the disk
    with synced(path.parent) as folder:
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path))
        try:
            handle = os.open(path.parent, os.O_WRONLY | os.O_CLOEXEC | os.O_TMPFILE, mode)
        except (OSError, AttributeError):  # a file system, or a system, without them
            _write_exclusive(path, content, mode)
            return
        with os.fdopen(handle, "wb") as file:
            _write_synced(file, content)
            # of a file descriptor, which a folder's beside it has linkat follow
            os.link(f"/proc/self/fd/{handle}", path.name, dst_dir_fd=folder, follow_symlinks=True)


def _write_exclusive(path: Path, content: bytes, mode: int) -> None:
    handle = os.open(path, os.O_WRONLY | os.O_CLOEXEC | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(handle, "wb") as file:
            _write_synced(file, content)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _write_synced(file: IO[bytes], content: bytes) -> None:
    file.write(content)
    file.flush()
    # `flush` hands Python's buffer to the system, whose own pages only fsync(2) forces to the disk
    os.fsync(file.fileno())


def megabytes(variable: str, default: float) -> float:
    """Return how many MB an environment variable allows, or the default if it is not set or no size."""
    try:
        limit = float(os.environ.get(variable, default))
    except ValueError:
        return default
    return limit if limit >= 0.0 else default
