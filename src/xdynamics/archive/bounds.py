"""How much an archive says that it holds, against how much there is; and whether it is built as archives are."""

from __future__ import annotations

from collections import Counter
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.library import alone

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import netCDF4

SPARSE = 1000  # times what a file takes on its disk, which is more than any file system compresses a run
PACKED = 64  # bytes of compressed variables for one of the others, at most, in what is written here
MOST_PACKED = 100  # the same in what is read
LARGEST_CHUNK = 1 << 25  # bytes of a compressed one, which is unpacked in memory as a whole
_SMALL = 10_000_000  # bytes that are always read


@alone
def oversize(path: Path, file: netCDF4.Dataset) -> list[str]:
    """Name the variables for which a file has too few bytes; nothing of them is read.

    Of a variable that is compressed a byte of the file stands for `MOST_PACKED`; see `packed`. Of others for itself.
    """
    about = path.stat()
    if about.st_size > _SMALL and about.st_size > SPARSE * 512 * getattr(about, "st_blocks", about.st_size):
        return [f"the file says that it has {about.st_size} bytes, but almost none of them are on the disk"]
    faults, total, needed = [], 0, 0
    for name, one in file.variables.items():
        size, chunk = _bytes_of(one)
        filters = [*_filters(one)]
        least = -(-size // MOST_PACKED) if filters == ["zlib"] else size
        room = max(about.st_size, LARGEST_CHUNK) if filters == ["zlib"] else about.st_size
        total, needed = total + size, needed + least
        if least > about.st_size or chunk > room:
            faults.append(f"variable '{name}' declares {max(size, chunk)} bytes, and the file has {about.st_size}")
        elif filters and filters != ["zlib"]:
            faults.append(f"variable '{name}' is compressed ({', '.join(filters)}), which no variable of an archive is")
    if needed > about.st_size and not faults:
        faults.append(f"the variables declare {total} bytes, and the file has {about.st_size}")
    return faults


@alone
def declared(file: netCDF4.Dataset) -> int:
    """Return how many bytes the variables of a file have in memory."""
    return sum(_bytes_of(one)[0] for one in file.variables.values())


def packed(widths: Mapping[str, tuple[str, int]]) -> set[str]:
    """Choose which variables of a file are compressed: as many as its readers take, who bound what a byte may stand for.

    Flags are not, and the bytes of those that are not are at least a `PACKED`-th of all.

    Parameters
    ----------
    widths : mapping of str to (str, int)
        Of each the dimension along which it grows, and its bytes in a row of that.
    """
    chosen, plain, full = set(), dict.fromkeys((dim for dim, _ in widths.values()), 0), Counter[str]()
    for name, (dim, width) in sorted(widths.items(), key=lambda one: one[1][1]):
        if full[dim] + width <= PACKED * plain[dim]:
            full[dim] += width
            chosen.add(name)
        else:
            plain[dim] += width
    return chosen


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
