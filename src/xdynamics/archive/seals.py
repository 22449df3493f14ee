"""Digests of runs and of files: a digest for each variable, and one over everything but circumstances.

The digest of a Dataset in memory equals that of its archive, without an archive being written.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.archive.netcdf_library import read_stored, with_library_lock
from xdynamics.archive.netcdf_library import stored_attributes as attributes_of
from xdynamics.archive.text_encoding import text_form
from xdynamics.record.flag_words import plain

if TYPE_CHECKING:
    pass

Array = NDArray[Any]

# rows of one stored chunk: a megabyte of floats for what grows by steps, little for what is rare
CHUNKS = {
    schema.STEPS: 131_072,
    schema.SAMPLES: 131_072,
    schema.CLOSED_LINKS: 131_072,
    schema.TRIALS: 4_096,
    schema.EVENTS: 512,
    schema.BOUNDS: 2,
}
OTHER_CHUNK = 4_096
_MOST_READ = 1 << 25  # bytes of a variable that are read at once
_TEXTS_AT_ONCE = 1 << 22  # bytes of texts in memory that become letters at once


MARK = b"\nxdynamics seal 1 "
_SEALED = re.compile(re.escape(MARK) + rb"[0-9a-f]{64}\n")
SEAL_LENGTH = len(MARK) + 64 + 1
_SEARCHED = 1 << 16  # bytes at the end of a file in which a misplaced seal is looked for
_PART = 1 << 22
_ASCII = 128


def seal_file(path: Path) -> str:
    """Append a digest of all bytes of a file, and return it; readers of HDF5 ignore bytes after its end."""
    digest = _file_digest(path, path.stat().st_size)
    with path.open("ab") as file:
        file.write(MARK + digest.encode() + b"\n")
    return digest


def bytes_digest(path: Path) -> str:
    """Return the digest of every byte of a file, its seal among them."""
    return _file_digest(path, path.stat().st_size)


@dataclass(frozen=True)
class Tail:
    """The seal at the end of a file.

    Attributes
    ----------
    digest : str
        The digest of every byte before the seal, where the seal holds; else empty.
    fault : str
        What is wrong with the seal; empty where it holds, or where nothing there looks like one.
    """

    digest: str = ""
    fault: str = ""


def tail_of(path: Path) -> Tail:
    """Compare a file with the seal at its end, and describe the damage of an incomplete seal."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - _SEARCHED))
        end = file.read(_SEARCHED)
    mark = end[-SEAL_LENGTH:]
    if _SEALED.fullmatch(mark):
        digest = _file_digest(path, size - SEAL_LENGTH)
        if digest == mark[len(MARK) : -1].decode():
            return Tail(digest)
        return Tail(fault="the bytes of the file differ from its seal")
    if (excess := len(end) - end.rfind(MARK) - SEAL_LENGTH) > 0 and MARK in end:
        return Tail(fault=f"{excess} bytes follow its seal" if excess > 1 else "a byte follows its seal")
    if MARK in end:
        return Tail(
            fault=(
                "its seal is hurt"
                if excess == 0
                else f"its seal is cut off: {-excess} of its {SEAL_LENGTH} bytes are missing"
            )
        )
    matching_bytes = sum(byte == expected for byte, expected in zip(mark, MARK, strict=False))
    return Tail(fault="its seal is hurt") if 2 * matching_bytes > len(MARK) else Tail()


def _file_digest(path: Path, size: int) -> str:
    """Return the sha256 of the sha256 of every 4 MiB, which all cores may compute at once."""

    def of_part(start: int) -> bytes:
        with path.open("rb") as file:
            file.seek(start)
            return hashlib.sha256(file.read(min(_PART, size - start))).digest()

    if size <= _PART:
        return hashlib.sha256(b"".join(map(of_part, range(0, size, _PART)))).hexdigest()
    with ThreadPoolExecutor() as pool:
        return hashlib.sha256(b"".join(pool.map(of_part, range(0, size, _PART)))).hexdigest()


class Seal:
    """The digest of one variable: name, dims, type, bytes in order, shape."""

    def __init__(self, name: str, dims: tuple[str, ...], dtype: np.dtype[Any]) -> None:
        self.dims = dims
        self.is_text = dtype.kind in "UOT"
        self.dtype = dtype if self.is_text else np.dtype(dtype).newbyteorder("<")
        label = "text" if self.is_text else self.dtype.str.replace("|", "<")
        self._sha = hashlib.sha256(json.dumps([name, list(dims), label]).encode())
        self._rows = 0
        self._inner: tuple[int, ...] | None = () if not dims else None

    @classmethod
    def for_variable(cls, variable: schema.Variable) -> Seal:
        """Return the digest of a variable of the record, before its first value."""
        return cls(variable.name, variable.dims, np.dtype(variable.dtype))

    def update(self, values: Array) -> None:
        """Add the next values."""
        if self.is_text:
            values = utf8_letters(values)
        if self.dims:
            self._rows += values.shape[0]
            self._inner = values.shape[1:]
        self._sha.update(np.ascontiguousarray(values, dtype="S1" if self.is_text else self.dtype).data)

    def hexdigest(self) -> str:
        """Return the digest of everything added so far."""
        # a copy: segments of a march state digests of what there is so far, and more rows follow
        sealed = self._sha.copy()
        # the shape comes last: how many rows there will be is not known when the first are hashed
        sealed.update(json.dumps([self._rows, *(self._inner or ())]).encode())
        return sealed.hexdigest()


def slabs(variable: Any) -> Iterator[Array]:
    """Yield a variable's values along its first dimension, a chunk at a time; one is computed at a time.

    Texts are yielded at once, all as wide as the longest.
    """
    if not variable.dims or variable.dtype.kind in "UOT":
        yield np.asarray(variable.values)
        return
    rows = max(1, CHUNKS.get(variable.dims[0], OTHER_CHUNK) * 8 // max(1, prod(variable.shape[1:])))
    for start in range(0, max(1, variable.shape[0]), rows):
        yield np.asarray(variable[start : start + rows].values)


def stored_slabs(variable: Any) -> Iterator[Array]:
    """Yield a variable's values as `slabs` does; of many texts the letters, which take a quarter of their memory."""
    if not variable.dims or variable.dtype.kind not in "UOT":
        yield from slabs(variable)
        return
    size, row = variable.shape[0], prod(variable.shape[1:], start=variable.dtype.itemsize)
    rows = max(1, _TEXTS_AT_ONCE // max(1, row))
    parts = [utf8_letters(np.asarray(variable[start : start + rows].values)) for start in range(0, max(1, size), rows)]
    text_letters = np.zeros((*variable.shape, max(part.shape[-1] for part in parts)), "S1")
    for k, part in enumerate(parts):
        text_letters[k * rows : k * rows + len(part), ..., : part.shape[-1]] = part
    yield text_letters


def utf8_letters(text: Array) -> Array:
    """Return texts, as they are in memory or in a file, as single bytes of UTF-8 along a further dimension."""
    if text.dtype.kind == "S":
        return text
    if not text.ndim:
        return np.frombuffer(str(text[()]).encode(), dtype="S1")
    text = np.ascontiguousarray(text.astype(str, copy=False))
    # numpy keeps each letter of a text in four bytes
    codes = text.view(np.uint32).reshape(*text.shape, -1)
    if text.size and codes.max(initial=0) < _ASCII:  # the usual case: no letter takes more than a byte
        longest = max(1, int(np.flatnonzero(codes.reshape(-1, codes.shape[-1]).any(axis=0)).max(initial=0)) + 1)
        return np.ascontiguousarray(codes[..., :longest].astype(np.uint8)).view("S1")
    encoded = np.char.encode(text, "utf-8")
    return np.ascontiguousarray(encoded).view("S1").reshape(*text.shape, encoded.dtype.itemsize)


def letters_of(name: str) -> str:
    """Name the dimension of a text's letters in a file."""
    return f"{name}_characters"


def stored_digest(variable: Any, name: str = "", *, single: bool = False) -> str:
    """Return the digest of an open netCDF variable by its values: texts as letters or strings have equal digests.

    Numbers are read a chunk at a time.

    Parameters
    ----------
    variable : netCDF4.Variable
    name : str
        What the record calls it, where the file has another name for it.
    single : bool
        Whether it is the only text along its dimension, which the record does not have.
    """
    own_name, dims, shape, dtype = _describe_stored(variable)
    name = name or own_name
    if dtype is str:
        seal = Seal(name, dims[single:], np.dtype(object))
        texts = np.asarray(read_stored(variable, ...), object)
        seal.update(utf8_letters(np.asarray(texts[0] if single else texts)))
        return seal.hexdigest()
    attributes = attributes_of(variable) if dtype in (np.int8, np.uint8) else {}  # numbers that may stand for texts
    is_text, form = dtype == "S1", text_form(attributes, dtype, dims, shape)
    further = form.further if form else int(is_text)
    seal = Seal(name, dims[single : len(dims) - further], np.dtype(object) if is_text or form else dtype)
    if is_text or not dims:
        values = np.asarray(read_stored(variable, ...))
        seal.update(_trimmed(values[0] if single else values) if is_text else values)
        return seal.hexdigest()
    width = max(1, prod(shape[1:], start=dtype.itemsize)) * (form.width if form else 1)
    rows = max(1, min(CHUNKS.get(dims[0], OTHER_CHUNK) * 8, _MOST_READ // width))
    for start in range(0, max(1, shape[0]), rows):
        slab = np.asarray(read_stored(variable, slice(start, start + rows)))
        seal.update(form.letters(slab) if form else slab)
    return seal.hexdigest()


def _trimmed(letters: Array) -> Array:
    """Return letters without the padding that other programs append to the longest text."""
    if not letters.size:
        return letters
    filled = np.flatnonzero((letters != b"").reshape(-1, letters.shape[-1]).any(axis=0))
    min_width = int(letters.ndim > 1)
    return letters[..., : max(min_width, int(filled.max(initial=-1)) + 1)]


@with_library_lock
def _describe_stored(variable: Any) -> tuple[str, tuple[str, ...], tuple[int, ...], Any]:
    variable.set_auto_chartostring(False)
    return variable.name, variable.dimensions, variable.shape, variable.dtype


def digest_lines(digests: Mapping[str, str]) -> str:
    """Write the digests of variables as a file keeps them."""
    return "\n".join(f"{name} {digest}" for name, digest in digests.items())


def digests_in(attributes: Mapping[Any, Any]) -> dict[str, str]:
    """Return the digests of variables from a file's attribute of digests; none for the former schema."""
    # from the right: a digest has no blank, and a name may have some
    lines = [line.rpartition(" ") for line in str(attributes.get(schema.DIGESTS, "")).splitlines()]
    return {name: digest for name, _, digest in lines}


def root_digest(digests: Mapping[str, str], attributes: Mapping[str, Mapping[str, Any]], run: Mapping[Any, Any]) -> str:
    """Return the content digest, from variables' digests and attributes; circumstances and notes are left out."""
    content = {
        "variables": {
            name: [digests[name], plain(attrs)]
            for name, attrs in attributes.items()
            if not _is_circumstance(name, attrs)
        },
        "attributes": plain(schema.content_of(run)),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def volatile_digest(
    digests: Mapping[str, str], attributes: Mapping[str, Mapping[str, Any]], run: Mapping[Any, Any]
) -> str:
    """Return the digest of the circumstances: date, versions, machine, and variables that depend on them."""
    content = plain(
        {
            key: value
            for key, value in run.items()
            if key in schema.VOLATILE and key not in (schema.VOLATILE_DIGEST, schema.DIGESTS)
        }
    )
    for name, attrs in attributes.items():
        if _is_circumstance(name, attrs):
            content[f"variable {name}"] = [digests[name], plain(attrs)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _is_circumstance(name: str, attributes: Mapping[str, Any]) -> bool:
    """Whether a variable depends on circumstances; catalogues of 0.2 had theirs in the content digest."""
    return name == schema.RUN_SEAL and attributes.get("role") == schema.CIRCUMSTANCE
