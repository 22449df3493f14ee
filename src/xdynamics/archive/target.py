"""What an archive may be written to, and how a new file takes its name."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from xdynamics.archive.source import asked
from xdynamics.faults import ArchiveError, InputError


def check_target(path: Path) -> None:
    """Refuse a path that no file can be written to.

    Raises
    ------
    InputError
        If it is a directory, its folder does not exist, or it is no path at all.
    """
    if asked(path, Path.is_dir):
        raise InputError(f"'{path}' is a directory; name a file in it, like '{path / 'run.nc'}'")
    if not asked(path.parent, Path.is_dir):
        raise InputError(f"'{path}' cannot be written: the folder '{path.parent}' does not exist")


@contextmanager
def taking_name(path: Path, check: Callable[[Path], None]) -> Iterator[Path]:
    """Lend a temporary name for a new file in the same folder; once it is filled and checked, it takes its own."""
    check_target(path)
    temporary = None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        os.close(handle)
        temporary = Path(name)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        yield temporary
        check(temporary)
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    except (OSError, RuntimeError) as error:
        raise ArchiveError(
            f"'{path}' cannot be written: {_cause(path.parent, error)}; nothing is changed there"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _cause(folder: Path, error: Exception) -> str:
    """Say why a write failed; the netCDF library itself guesses."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0" * 1_000_000)
            probe.flush()
    except OSError as why:
        return why.strerror or str(why)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return f"{error} (disk full, file-size limit or lost device)"


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
