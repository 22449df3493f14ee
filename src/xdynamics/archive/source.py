"""The checks of a path that an archive is to be read from."""

from __future__ import annotations

from pathlib import Path

from xdynamics.faults import InputError
from xdynamics.runtime.files import ask_path, file_above, path_kind


def check_source(path: Path) -> None:
    """Check that an archive can be read from a path, without opening it.

    Raises
    ------
    InputError
        If it is a directory, a pipe, a socket or a device, does not exist, or is no path, for the system or the library.
    """
    check_no_backslash(path)
    kind = ask_path(path, path_kind)
    if kind == "":
        above = file_above(path)
        raise InputError(f"'{path}' does not exist{above and f': {above}'}")
    if kind is not None:
        raise InputError(f"'{path}' is {kind}; name a file{' in it' if kind == 'a directory' else ''}")


def check_no_backslash(path: Path) -> None:
    """Check a path for a name that the netCDF library would take for another.

    Raises
    ------
    InputError
        If there is a backslash in it.
    """
    if "\\" in str(ask_path(path, Path.absolute)):
        raise InputError(
            f"'{path}' has a backslash in its whole name, which the netCDF library takes for the end of a folder's"
            " name; name another file"
        )
