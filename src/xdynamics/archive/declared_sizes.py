"""Whether an archive declares more data than its file can hold, and whether it is built as archives are."""

from __future__ import annotations

from collections import Counter
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.netcdf_library import with_library_lock

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import netCDF4

SPARSE = 1000  # times what a file takes on its disk, which is more than any file system compresses a run
PACKED = 64  # at most, bytes of compressed variables for one of the others, in files written here
MOST_PACKED = 100  # the same in files that are read
LARGEST_CHUNK = 1 << 25  # bytes of a compressed one, which is unpacked in memory as a whole
_SMALL = 10_000_000  # bytes that are always read


@with_library_lock
def size_faults(path: Path, file: netCDF4.Dataset) -> list[str]:
    """List the faults of variables for which a file has too few bytes; no values are read.

    A byte of the file stands for up to `MOST_PACKED` bytes of a compressed variable, see `variables_to_compress`, and for one of others.
    """
    status = path.stat()
    if status.st_size > _SMALL and status.st_size > SPARSE * 512 * getattr(status, "st_blocks", status.st_size):
        return [f"the file says that it has {status.st_size} bytes, but almost none of them are on the disk"]
    faults, total, needed = [], 0, 0
    for name, variable in file.variables.items():
        size, chunk = _bytes_of(variable)
        filters = [*_filters(variable)]
        minimum_bytes = -(-size // MOST_PACKED) if filters == ["zlib"] else size
        room = max(status.st_size, LARGEST_CHUNK) if filters == ["zlib"] else status.st_size
        total, needed = total + size, needed + minimum_bytes
        if minimum_bytes > status.st_size or chunk > room:
            faults.append(f"variable '{name}' declares {max(size, chunk)} bytes, and the file has {status.st_size}")
        elif filters and filters != ["zlib"]:
            faults.append(f"variable '{name}' is compressed ({', '.join(filters)}), which no variable of an archive is")
    if needed > status.st_size and not faults:
        faults.append(f"the variables declare {total} bytes, and the file has {status.st_size}")
    return faults


@with_library_lock
def declared_bytes(file: netCDF4.Dataset) -> int:
    """Return how many bytes the variables of a file have in memory."""
    return sum(_bytes_of(variable)[0] for variable in file.variables.values())


def variables_to_compress(widths: Mapping[str, tuple[str, int]]) -> set[str]:
    """Choose the variables of a file to compress: as many as its readers accept, which bound the compression ratio.

    Flags stay uncompressed, and compressed bytes are at most `PACKED` times those of the others.

    Parameters
    ----------
    widths : mapping of str to (str, int)
        For each variable the dimension along which it grows, and its bytes per row of that.
    """
    compressed_names, plain, full = set(), dict.fromkeys((dim for dim, _ in widths.values()), 0), Counter[str]()
    for name, (dim, width) in sorted(widths.items(), key=lambda item: item[1][1]):
        if full[dim] + width <= PACKED * plain[dim]:
            full[dim] += width
            compressed_names.add(name)
        else:
            plain[dim] += width
    return compressed_names


@with_library_lock
def unused_dimensions(file: netCDF4.Dataset) -> list[str]:
    """List the dimensions that no variable has, as in no archive; other objects are those of the inventory."""
    used = {dim for variable in file.variables.values() for dim in variable.dimensions}
    return [f"dimension '{name}' is none of a run" for name in file.dimensions if name not in used]


def _bytes_of(variable: Any) -> tuple[int, int]:
    """Return the bytes of a variable, and of one of its chunks where it has any."""
    width = 16 if variable.dtype is str else variable.dtype.itemsize
    size = prod(variable.shape, start=width)
    chunks = variable.chunking()
    return size, prod(chunks, start=width) if size and isinstance(chunks, list | tuple) else 0


def _filters(variable: Any) -> Iterator[str]:
    filters = variable.filters() or {}
    yield from (name for name, on in filters.items() if on and name not in ("complevel", "shuffle"))
