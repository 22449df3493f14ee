"""The structure of an HDF5 file, checked before its data are read: declared sizes and every object in the file.

A file may declare more data than it can hold, or be built otherwise than archives are. The objects of a file are listed
without following any link: netCDF follows links, and does not show all objects.

The functions are those of the HDF5 library that the netCDF4 package has loaded, so that no second library, nor a second
reading of the format, can see another file than it does.
"""

from __future__ import annotations

import ctypes
import os
from collections import Counter
from ctypes import POINTER, c_char_p, c_int, c_int64, c_uint, c_uint64, c_void_p
from dataclasses import dataclass, field
from functools import lru_cache
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.netcdf_library import openings, with_library_lock

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import netCDF4

SPARSE = 1000  # times what a file takes on its disk, which is more than any file system compresses a run
PACKED = 64  # at most, bytes of compressed variables for one of the others, in files written here
MOST_PACKED = 100  # the same in files that are read
LARGEST_CHUNK = 1 << 25  # bytes of a compressed one, which is unpacked in memory as a whole
_SMALL = 10_000_000  # bytes that are always read


@with_library_lock
def size_faults(path: Path, file: netCDF4.Dataset, *, is_partial: bool = False) -> list[str]:
    """List the faults of variables for which a file has too few bytes; no values are read.

    A byte of the file stands for up to `MOST_PACKED` bytes of a compressed variable, see `variables_to_compress`, and for one of others.
    """
    status = path.stat()
    # st_blocks counts units of 512 bytes, whatever the block size of the file system
    if (
        not is_partial
        and status.st_size > _SMALL
        and status.st_size > SPARSE * 512 * getattr(status, "st_blocks", status.st_size)
    ):
        return [f"the file says that it has {status.st_size} bytes, but almost none of them are on the disk"]
    faults, total, needed = [], 0, 0
    for name, variable in file.variables.items():
        size, chunk = _bytes_of(variable)
        filters = [*_filters(variable)]
        minimum_bytes = -(-size // MOST_PACKED) if filters == ["zlib"] else size
        # a compressed chunk may be larger than the file that holds it: what bounds it is the memory it is unpacked in
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
    # narrow columns first: they are the cheapest to leave plain, and plain bytes are what the bound is a multiple of
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


SIGNATURE = b"\x89HDF\r\n\x1a\n"
# attributes by which netCDF keeps dimensions, and which it does not show
INTERNAL = frozenset(
    {"CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Coordinates", "_Netcdf4Dimid", "_NCProperties"}
)
FOLLOWED = "DIMENSION_LIST"  # the internal one that is followed when a file is opened
NON_COORDINATE = "_nc4_non_coord_"  # before the name of a variable with a dimension's name that is not along it
LINKS = {1: "a soft link", 64: "an external link, which leads out of the file"}  # H5L_type_t; 0 is an object's own name
GROUP, TYPE, DATASET = 2, 3, 5  # H5I_type_t
ROWS = 9  # H5T_class_t, as these but for whole numbers, floats and letters:
CLASSES = {
    4: "bits",
    5: "opaque bytes",
    6: "compounds",
    7: "references to objects",
    8: "words of a list",
    ROWS: "rows of any length",
    10: "arrays",
}
VIRTUAL = 3  # H5D_layout_t
_Id = c_int64
_Noted = ctypes.CFUNCTYPE(c_int, c_int64, c_char_p, POINTER(c_int), c_void_p)
_FUNCTIONS: dict[str, tuple[Any, list[Any]]] = {
    "H5Eset_auto2": (c_int, [_Id, c_void_p, c_void_p]),
    "H5Fopen": (_Id, [c_char_p, c_uint, _Id]),
    "H5Fclose": (c_int, [_Id]),
    "H5Literate": (c_int, [_Id, c_int, c_int, c_void_p, _Noted, c_void_p]),
    "H5Literate2": (c_int, [_Id, c_int, c_int, c_void_p, _Noted, c_void_p]),  # its name since HDF5 1.12
    "H5Oopen": (_Id, [_Id, c_char_p, _Id]),
    "H5Oclose": (c_int, [_Id]),
    "H5Iget_type": (c_int, [_Id]),
    "H5Dget_create_plist": (_Id, [_Id]),
    "H5Dget_type": (_Id, [_Id]),
    "H5Dget_storage_size": (c_uint64, [_Id]),
    "H5Pget_layout": (c_int, [_Id]),
    "H5Pget_external_count": (c_int, [_Id]),
    "H5Pclose": (c_int, [_Id]),
    "H5Aiterate2": (c_int, [_Id, c_int, c_int, c_void_p, _Noted, c_void_p]),
    "H5Aopen": (_Id, [_Id, c_char_p, _Id]),
    "H5Aget_type": (_Id, [_Id]),
    "H5Aclose": (c_int, [_Id]),
    "H5Tget_class": (c_int, [_Id]),
    "H5Tget_super": (_Id, [_Id]),
    "H5Tequal": (c_int, [_Id, _Id]),
    "H5Tclose": (c_int, [_Id]),
}


@dataclass
class Inventory:
    """The objects of a file.

    Attributes
    ----------
    attributes : dict of str to set of str
        Names of the attributes of every dataset, and of the file itself under the empty name.
    filled : set of str
        Datasets that hold values.
    faults : list of str
        What no archive has, and what must not be followed: links, values in other files, references, groups, types.
    """

    attributes: dict[str, set[str]] = field(default_factory=dict)
    filled: set[str] = field(default_factory=set)
    faults: list[str] = field(default_factory=list)

    def unshown_objects(self, shown_attributes: dict[str, set[str]], dimensions: set[str]) -> list[str]:
        """List the objects and attributes that netCDF does not show.

        Parameters
        ----------
        shown_attributes : dict of str to set of str
            Names of the attributes of every variable that netCDF shows, and of the file itself under the empty name.
        dimensions : set of str
            Names of dimensions, of which each may have a dataset without values.
        """
        faults = []
        for stored, names in self.attributes.items():
            name = stored.removeprefix(NON_COORDINATE)
            if name not in shown_attributes and (stored not in dimensions or stored in self.filled):
                faults.append(f"object '{stored}' is none that netCDF shows")
                continue
            owner = f" of '{name}'" if name else ""
            unseen = sorted(names - INTERNAL - shown_attributes.get(name, set()))
            faults += [f"attribute '{attribute}'{owner} is none that netCDF shows" for attribute in unseen]
        return faults


@with_library_lock
def inventory(path: Path) -> Inventory:
    """List the objects of a file; no values are read, and no other file is opened.

    Raises
    ------
    OSError
        If it is no HDF5 file, or one whose objects cannot be listed.
    ArchiveError
        If the library still has the file open as it was before it was overwritten.
    """
    with path.open("rb") as file:
        if file.read(len(SIGNATURE)) != SIGNATURE:
            raise OSError("it does not begin as an HDF5 file does")
    openings.opening_of(path)  # refuses one that was overwritten while the library has it open
    objects = Inventory()
    # the zeros are H5F_ACC_RDONLY and H5P_DEFAULT
    with library_handle("H5Fopen", os.fsencode(path.absolute()), 0, 0, close="H5Fclose") as root:
        objects.attributes[""] = _attribute_names(root, "", objects.faults)
        links = "H5Literate2" if hasattr(loaded_library(), "H5Literate2") else "H5Literate"
        for name, kind in _iterated_names(links, root):  # the first number reported of a link is its kind
            if kind:
                objects.faults.append(
                    f"'{name}' is {LINKS.get(kind, 'a link of a foreign kind')}; no archive has links"
                )
                continue
            with library_handle(
                "H5Oopen", root, name.encode("utf-8", "surrogateescape"), 0, close="H5Oclose"
            ) as handle:
                _note_object(objects, name, handle)
    return objects


def _note_object(objects: Inventory, name: str, handle: int) -> None:
    """Record an object under its name: a dataset, or a fault."""
    kind = loaded_library().H5Iget_type(handle)
    if kind != DATASET:
        kind_name = {GROUP: "group", TYPE: "type"}.get(kind, "object")
        objects.faults.append(f"{kind_name} '{name}' is none of a run")
        return
    with library_handle("H5Dget_create_plist", handle, close="H5Pclose") as built:
        if loaded_library().H5Pget_layout(built) == VIRTUAL:
            objects.faults.append(f"variable '{name}' is a virtual dataset, whose values stand elsewhere")
            return
        if count := loaded_library().H5Pget_external_count(built):
            objects.faults.append(f"variable '{name}' has its values in {count} other file{'s' if count > 1 else ''}")
            return
    with library_handle("H5Dget_type", handle, close="H5Tclose") as values:
        if class_name := CLASSES.get(loaded_library().H5Tget_class(values)):
            objects.faults.append(f"variable '{name}' holds {class_name}, which no variable of an archive does")
    if loaded_library().H5Dget_storage_size(handle):
        objects.filled.add(name)
    objects.attributes[name] = _attribute_names(handle, name, objects.faults)


def _iterated_names(function: str, handle: int) -> list[tuple[str, int]]:
    """Return the names that a function of the library iterates over, and the first number that it reports of each."""
    entries: list[tuple[str, int]] = []
    broken: list[BaseException] = []

    def note_entry(_handle: int, name: bytes, numbers: Any, _data: int) -> int:
        try:
            entries.append((name.decode("utf-8", "surrogateescape"), numbers[0]))
        except BaseException as error:  # noqa: BLE001 - Ctrl-C, too, would be lost in a function that C calls
            broken.append(error)
            # a negative number ends the iteration and makes the library call
            # fail; the exception is raised again behind it
            return -1
        return 0

    try:
        # by H5_INDEX_NAME (0) in H5_ITER_NATIVE (2), the order that is fastest for the file at hand
        _call_library(function, handle, 0, 2, None, _Noted(note_entry), None)
    except OSError:
        if broken:
            raise broken[0] from None
        raise
    return entries


def _attribute_names(handle: int, name: str, faults: list[str]) -> set[str]:
    """Return the names of an object's attributes; its references to dimensions must stay within the file."""
    names = {attribute for attribute, _ in _iterated_names("H5Aiterate2", handle)}
    if FOLLOWED in names and not _is_within(handle):
        faults.append(f"attribute '{FOLLOWED}' of '{name}' is none of netCDF's: it may lead out of the file")
    return names


def _is_within(handle: int) -> bool:
    """Whether the references to an object's dimensions are rows of addresses in the file itself."""
    library = loaded_library()
    with (
        library_handle("H5Aopen", handle, FOLLOWED.encode(), 0, close="H5Aclose") as attribute,
        library_handle("H5Aget_type", attribute, close="H5Tclose") as rows,
    ):
        if library.H5Tget_class(rows) != ROWS:
            return False
        # H5T_STD_REF_OBJ is an address in the file itself; the newer H5T_STD_REF may name another file
        with library_handle("H5Tget_super", rows, close="H5Tclose") as base_type:
            return bool(library.H5Tequal(base_type, c_int64.in_dll(library, "H5T_STD_REF_OBJ_g")) > 0)


class library_handle:  # noqa: N801 - used as a statement, some hundred times a file
    """Lends a handle that a function of the library opens."""

    __slots__ = ("close", "handle")

    def __init__(self, name: str, *arguments: Any, close: str) -> None:
        self.handle, self.close = _call_library(name, *arguments), close

    def __enter__(self) -> int:
        return self.handle

    def __exit__(self, *_: object) -> None:
        getattr(loaded_library(), self.close)(self.handle)


def _call_library(name: str, *arguments: Any) -> int:
    """Call a function of the library; raise OSError if it returns a negative number."""
    answer = int(getattr(loaded_library(), name)(*arguments))
    if answer < 0:
        raise OSError(f"its objects cannot be listed ({name} of HDF5 says no more)")
    return answer


@lru_cache
def loaded_library() -> ctypes.CDLL:
    """Return the HDF5 library: symbols that the extension lacks come from libraries that it was linked with."""
    from netCDF4 import _netCDF4

    library = ctypes.CDLL(_netCDF4.__file__)
    for name, (result, arguments) in _FUNCTIONS.items():
        if hasattr(library, name):
            function = getattr(library, name)
            # ctypes assumes C ints, which would cut off half of a 64-bit identifier
            function.restype, function.argtypes = result, arguments
    # type constants like H5T_STD_REF_OBJ_g hold no identifier before this call
    library.H5open()
    library.H5Eset_auto2(0, None, None)  # it would print its errors
    return library
