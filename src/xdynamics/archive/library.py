"""The netCDF4 library: the one place where files are opened with it for reading."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics.archive.source import check_source
from xdynamics.faults import ArchiveError

if TYPE_CHECKING:
    import netCDF4

# what the libraries raise on files that are damaged or of another kind
DAMAGE = (OSError, RuntimeError, ValueError, AttributeError, LookupError, TypeError, MemoryError, OverflowError)


@contextmanager
def opened(path: Path) -> Iterator[netCDF4.Dataset]:
    """Open a file to read; what the library makes of a damaged one is one error."""
    import netCDF4

    check_source(path)
    try:
        with netCDF4.Dataset(path, "r") as file:
            file.set_auto_maskandscale(False)
            yield file
    except DAMAGE as error:
        raise ArchiveError(f"'{path}' is damaged or no run archive: {error}") from None
