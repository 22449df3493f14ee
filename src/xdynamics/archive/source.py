"""What an archive is read from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from xdynamics.faults import InputError


def check_source(path: Path) -> None:
    """Refuse a path that no file can be read from; a directory, or none at all."""
    if asked(path, Path.is_dir):
        raise InputError(f"'{path}' is a directory; name a file in it")
    if not asked(path, Path.exists):
        raise InputError(f"'{path}' does not exist")


def asked(path: Path, question: Callable[[Path], bool]) -> bool:
    """Answer a question about a path; raise where it is no path at all."""
    if "\0" in str(path):
        raise InputError(f"{str(path)[:80]!r} is no path for a file: it holds a null character")
    try:
        return question(path)
    except OSError as error:
        raise InputError(f"'{str(path)[:80]}' is no path for a file: {error}") from None
