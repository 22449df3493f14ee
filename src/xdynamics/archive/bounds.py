"""How much an archive says that it holds, against how much there is; and whether it is built as archives are."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.library import alone

if TYPE_CHECKING:
    from collections.abc import Iterator

    import netCDF4

SPARSE = 1000  # times what a file takes on its disk, which is more than any file system compresses a run
_SMALL = 10_000_000  # bytes that are always read


@alone
def oversize(path: Path, file: netCDF4.Dataset) -> list[str]:
    """Name the variables for which a file has too few bytes; nothing of them is read.

    Archives are not compressed: every byte of a variable is one of the file.
    """
    about = path.stat()
    if about.st_size > _SMALL and about.st_size > SPARSE * 512 * getattr(about, "st_blocks", about.st_size):
        return [f"the file says that it has {about.st_size} bytes, but almost none of them are on the disk"]
    faults, total = [], 0
    for name, one in file.variables.items():
        size, chunk = _bytes_of(one)
        total += size
        if max(size, chunk) > about.st_size:
            faults.append(f"variable '{name}' declares {max(size, chunk)} bytes, and the file has {about.st_size}")
        elif compression := ", ".join(_filters(one)):
            faults.append(f"variable '{name}' is compressed ({compression}), which no variable of an archive is")
    if total > about.st_size and not faults:
        faults.append(f"the variables declare {total} bytes, and the file has {about.st_size}")
    return faults


@alone
def foreign(file: netCDF4.Dataset) -> list[str]:
    """Name the dimensions that no variable has, which no archive has; other objects are those of the inventory."""
    used = {dim for one in file.variables.values() for dim in one.dimensions}
    return [f"dimension '{name}' is none of a run" for name in file.dimensions if name not in used]


def _bytes_of(variable: Any) -> tuple[int, int]:
    """Return the bytes of a variable, and of one of its chunks where it has any."""
    width = 16 if variable.dtype is str else variable.dtype.itemsize
    size = prod(variable.shape, start=width)
    chunks = variable.chunking()
    return size, prod(chunks, start=width) if size and isinstance(chunks, list | tuple) else 0


def _filters(variable: Any) -> Iterator[str]:
    found = variable.filters() or {}
    yield from (name for name, on in found.items() if on and name not in ("complevel", "shuffle"))
