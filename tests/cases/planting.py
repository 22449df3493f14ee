"""Objects planted in archives, that netCDF follows or does not show: each by the HDF5 library, the seal made anew."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from ctypes import byref, c_char_p, c_int64, c_size_t, c_uint64, c_void_p
from pathlib import Path

from netCDF4 import _netCDF4

from xdynamics.archive.seals import MARK, seal_file

_LIBRARY = ctypes.CDLL(_netCDF4.__file__)
_LIBRARY.H5open()
for _name in (
    "H5Fopen",
    "H5Screate",
    "H5Screate_simple",
    "H5Pcreate",
    "H5Dcreate2",
    "H5Dopen2",
    "H5Acreate2",
    "H5Gcreate2",
    "H5Tcopy",
    "H5Tcreate",
    "H5Tvlen_create",
    "H5Dget_space",
):
    getattr(_LIBRARY, _name).restype = c_int64


def _constant(name: str) -> c_int64:
    return c_int64.in_dll(_LIBRARY, name)


def _do(name: str, *arguments: object) -> c_int64:
    """Call a function of the library: whole numbers are handles."""
    handles = [c_int64(argument) if isinstance(argument, int) else argument for argument in arguments]
    answer = int(getattr(_LIBRARY, name)(*handles))
    assert answer >= 0, name
    return c_int64(answer)


def _space(size: int = 8) -> c_int64:
    return _do("H5Screate_simple", 1, byref(c_uint64(size)), c_void_p())


def _dataset(root: c_int64, name: str, kind: str = "H5T_IEEE_F64LE_g", built: c_int64 | int = 0) -> c_int64:
    return _do("H5Dcreate2", root, name.encode(), _constant(kind), _space(), 0, built, 0)


def _built() -> c_int64:
    return _do("H5Pcreate", _constant("H5P_CLS_DATASET_CREATE_ID_g"))


def soft(root: c_int64, _away: Path) -> None:
    """Plant a link to another name in the file."""
    _do("H5Lcreate_soft", b"/x", root, b"planted", 0, 0)


def dangling(root: c_int64, _away: Path) -> None:
    """Plant a link to no name in the file."""
    _do("H5Lcreate_soft", b"/nowhere/at/all", root, b"planted", 0, 0)


def external(root: c_int64, away: Path) -> None:
    """Plant a link to an object in another file."""
    _do("H5Lcreate_external", os.fsencode(away), b"/x", root, b"planted", 0, 0)


def raw(root: c_int64, away: Path) -> None:
    """Plant values that stand in another file."""
    built = _built()
    _do("H5Pset_external", built, os.fsencode(away), c_int64(0), c_uint64(64))
    _dataset(root, "planted", built=built)


def virtual(root: c_int64, away: Path) -> None:
    """Plant a dataset that is made of one in another file."""
    built = _built()
    _do("H5Pset_virtual", built, _space(), c_char_p(os.fsencode(away)), c_char_p(b"/x"), _space())
    _dataset(root, "planted", built=built)


def references(root: c_int64, _away: Path) -> None:
    """Plant a dataset of references to objects."""
    _dataset(root, "planted", "H5T_STD_REF_OBJ_g")


def opaque(root: c_int64, _away: Path) -> None:
    """Plant bytes that are said to be nothing."""
    kind = _do("H5Tcreate", ctypes.c_int(5), c_size_t(16))
    _do("H5Dcreate2", root, b"planted", kind, _space(), 0, 0, 0)


def halves(root: c_int64, _away: Path) -> None:
    """Plant floats of two bytes, which netCDF shows as others."""
    kind = _do("H5Tcopy", _constant("H5T_IEEE_F32LE_g"))
    _do("H5Tset_fields", kind, c_size_t(15), c_size_t(10), c_size_t(5), c_size_t(0), c_size_t(10))
    _do("H5Tset_size", kind, c_size_t(2))
    _do("H5Dcreate2", root, b"planted", kind, _space(), 0, 0, 0)


def group(root: c_int64, _away: Path) -> None:
    """Plant a group."""
    _do("H5Gcreate2", root, b"planted", 0, 0, 0)


def circle(root: c_int64, _away: Path) -> None:
    """Give the file itself a name in itself."""
    _do("H5Lcreate_hard", root, b"/", root, b"planted", 0, 0)


def named_type(root: c_int64, _away: Path) -> None:
    """Plant a type with a name."""
    _do("H5Tcommit2", root, b"planted", _do("H5Tcopy", _constant("H5T_IEEE_F64LE_g")), 0, 0, 0)


def unshown(root: c_int64, _away: Path) -> None:
    """Plant an attribute of references, which netCDF does not show."""
    _do("H5Acreate2", root, b"planted", _constant("H5T_STD_REF_OBJ_g"), _space(), 0, 0)


def unshown_of_x(root: c_int64, _away: Path) -> None:
    """Plant such an attribute of a variable."""
    _do("H5Acreate2", _do("H5Dopen2", root, b"x", 0), b"planted", _constant("H5T_STD_REF_OBJ_g"), _space(), 0, 0)


def leading_away(root: c_int64, _away: Path) -> None:
    """Have a variable find its dimensions by references of a kind that may lead into other files."""
    x = _do("H5Dopen2", root, b"x", 0)
    _do("H5Adelete", x, b"DIMENSION_LIST")
    kind = _do("H5Tvlen_create", _constant("H5T_STD_REF_g"))
    _do("H5Acreate2", x, b"DIMENSION_LIST", kind, _space(1), 0, 0)


def filled_dimension(root: c_int64, _away: Path) -> None:
    """Write values into what is there for a dimension alone."""
    kept = _do("H5Dopen2", root, b"bound", 0)
    size = 64
    _do("H5Dwrite", kept, _constant("H5T_NATIVE_FLOAT_g"), 0, 0, 0, ctypes.create_string_buffer(size))


# what is planted, and what is said of it
PLANTS: dict[str, tuple[Callable[[c_int64, Path], None], str]] = {
    "soft link": (soft, "'planted' is a soft link; no archive has links"),
    "dangling link": (dangling, "'planted' is a soft link; no archive has links"),
    "external link": (external, "'planted' is an external link, which leads out of the file; no archive has links"),
    "external raw data": (raw, "variable 'planted' has its values in 1 other file"),
    "virtual dataset": (virtual, "variable 'planted' is a virtual dataset, whose values stand elsewhere"),
    "references": (references, "variable 'planted' holds references to objects, which no variable of an archive does"),
    "opaque bytes": (opaque, "variable 'planted' holds opaque bytes, which no variable of an archive does"),
    "half floats": (halves, "variable 'planted' differs from its digest"),
    "group": (group, "group 'planted' is none of a run"),
    "circle": (circle, "group 'planted' is none of a run"),
    "type": (named_type, "type 'planted' is none of a run"),
    "attribute of the file": (unshown, "attribute 'planted' is none that netCDF shows"),
    "attribute of a variable": (unshown_of_x, "attribute 'planted' of 'x' is none that netCDF shows"),
    "dimensions elsewhere": (
        leading_away,
        "attribute 'DIMENSION_LIST' of 'x' is none of netCDF's: it may lead out of the file",
    ),
    "values of a dimension": (filled_dimension, "object 'bound' is none that netCDF shows"),
}


def planted(path: Path, what: str, away: Path) -> str:
    """Plant something in an archive, seal it anew, and return what is to be said of it."""
    plant, said = PLANTS[what]
    content = path.read_bytes()
    path.write_bytes(content[: content.rindex(MARK)])
    root = _do("H5Fopen", os.fsencode(path), ctypes.c_uint(1), 0)
    try:
        plant(root, away)
    finally:
        assert _LIBRARY.H5Fflush(root, 1) >= 0
        ids = (c_int64 * 100)()
        for one in ids[: _LIBRARY.H5Fget_obj_ids(root, 0x1F & ~1 | 0x20, c_size_t(100), ids)]:
            _LIBRARY.H5Idec_ref(c_int64(one))
        assert _LIBRARY.H5Fclose(root) >= 0
    seal_file(path)
    return said
