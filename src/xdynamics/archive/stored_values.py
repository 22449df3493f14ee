"""Values as they are stored, and as readers get them: texts of many members, chunks by index, arrays read when used.

Texts of many members as numbers in a file: outcomes as flags, digests as bytes; readers get the texts.

A digest of 32 digits takes 16 bytes, an outcome one; in memory, as texts of one width, 128 and 80. The digest of such a
variable is that of its texts, so that an archive has the same content digest in whatever form it keeps them.

Elements of a stored variable by index: read in stretches of chunks, and chosen in memory.

The library looks up each number of a list by itself, at 60 microseconds each; a stretch it copies at memory's speed.

Values of archives as xarray asks for them: read when they are used, by one thread at a time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from xarray import Variable
from xarray.backends import BackendArray, NetCDF4DataStore
from xarray.core import indexing

from xdynamics.archive.netcdf_library import with_library_lock
from xdynamics.faults import ArchiveError
from xdynamics.record.flag_words import own_attributes
from xdynamics.schema import DIGEST, FLAG_ATTRIBUTES, TEXT_FORM, flag_attributes

if TYPE_CHECKING:
    import netCDF4
    import xarray as xr

Array = NDArray[Any]

FLAGS, HEXADECIMAL = "flag_meanings", "hexadecimal"
NUMBERED = ("outcome", "digest")  # roles of the variables that are kept so
NO_WORD = -1  # of an empty text, which no flag can mean
MOST_WORDS, LONGEST_WORD = 64, 64
DIGITS = b"0123456789abcdef"
AT_ONCE = 1 << 16  # texts that are turned into bytes


@dataclass(frozen=True)
class EncodedTexts:
    """Texts as a file keeps them.

    Attributes
    ----------
    values : ndarray of int8 or uint8
    dim : str
        Of the bytes of each, after the dimensions of the texts; empty if each is one number.
    attributes : dict
        The meaning of the numbers.
    """

    values: Array
    dim: str
    attributes: Mapping[str, Any]


def bytes_dim(name: str) -> str:
    """Name the dimension of the bytes of digests in a file."""
    return f"{name}_bytes"


def encoded_texts(name: str, role: Any, letters: Array) -> EncodedTexts | None:
    """Return texts as numbers; None if they stay letters: neither words nor digests, or a single text.

    Parameters
    ----------
    name : str
    role : str
        Of the variable.
    letters : ndarray of S1
        Along the last dimension, as `seals.letters` gives them.
    """
    if role not in NUMBERED or letters.ndim < 2 or not letters.size:
        return None
    if role == "digest":
        values = _from_hexadecimal(np.ascontiguousarray(letters).view(np.uint8))
        return None if values is None else EncodedTexts(values, bytes_dim(name), {TEXT_FORM: HEXADECIMAL})
    width = letters.shape[-1]
    texts = np.ascontiguousarray(letters).view(f"S{width}")[..., 0]
    words = _flag_words(texts.ravel())
    if words is None:
        return None
    values = np.full(texts.shape, NO_WORD, np.int8)
    for number, word in enumerate(words):
        values[texts == word] = number
    return EncodedTexts(
        values, "", {TEXT_FORM: FLAGS, **flag_attributes(dict(enumerate(meaning.decode() for meaning in words)))}
    )


def _flag_words(texts: Array) -> list[bytes] | None:
    """List the words among many texts, sorted; None where there are too many, or some that are no flag's meaning."""
    words: list[bytes] = []
    remaining = texts[texts != b""]
    while remaining.size:
        word = bytes(remaining[0])
        if len(words) == MOST_WORDS or not _is_word(word):
            return None
        words.append(word)
        remaining = remaining[remaining != word]
    return sorted(words) or None


def _is_word(word: bytes) -> bool:
    return len(word) <= LONGEST_WORD and word.isascii() and word.decode("ascii").isprintable() and b" " not in word


_VALUES = np.full(256, 255, np.uint8)
_VALUES[np.frombuffer(DIGITS, np.uint8)] = np.arange(16)
_PAIRS = np.frombuffer(
    b"".join(b"%02x" % byte for byte in range(256)), np.uint16
)  # of letters, as they stand in memory


def _from_hexadecimal(codes: Array) -> Array | None:
    """Return lower-case hexadecimal digits as bytes; None where there are others, or not two for each byte."""
    if codes.shape[-1] % 2:
        return None
    flat = codes.reshape(-1, codes.shape[-1])
    octets = np.empty((len(flat), codes.shape[-1] // 2), np.uint8)
    for start in range(0, len(flat), AT_ONCE):
        digits = _VALUES[flat[start : start + AT_ONCE]]
        # 255 stands for every letter that is no digit, so one maximum finds them all
        if digits.max() >= len(DIGITS):
            return None
        octets[start : start + AT_ONCE] = (digits[:, ::2] << 4) | digits[:, 1::2]
    return octets.reshape(*codes.shape[:-1], -1)


@dataclass(frozen=True)
class Form:
    """How a variable of an open file keeps texts as numbers.

    Attributes
    ----------
    words : ndarray of S, shape (n,)
        Of flags: the words by their numbers, an empty one last; of digests nothing.
    width : int
        Letters of the longest text.
    """

    words: Array | None
    width: int

    @property
    def further(self) -> int:
        """How many dimensions the numbers have after those of the texts."""
        return int(self.words is None)

    def letters(self, numbers: Array) -> Array:
        """Return the texts of numbers as letters along a further dimension.

        Raises
        ------
        ValueError
            If a number stands for no word.
        """
        if self.words is None:
            pairs = _PAIRS[np.asarray(numbers)]
            return np.ascontiguousarray(pairs).view("S1").reshape(*numbers.shape[:-1], self.width)
        if numbers.size and not (numbers.min() >= NO_WORD and numbers.max() < len(self.words) - 1):
            raise ValueError("a flag of it has no meaning")
        # with a further dimension one number is an array too, whose words have this width
        return np.take(self.words, numbers[..., None]).view("S1").reshape(*numbers.shape, self.width)

    def texts(self, numbers: Array) -> Array:
        """Return the texts of numbers."""
        letters = self.letters(numbers)
        codes = np.ascontiguousarray(letters.view(np.uint8).astype(np.uint32))
        return codes.view(f"U{self.width}")[..., 0]


def text_form(attributes: Mapping[str, Any], dtype: Any, dims: tuple[str, ...], shape: tuple[int, ...]) -> Form | None:
    """Return how a variable keeps texts as numbers; None where it keeps none.

    Raises
    ------
    ValueError
        If it declares a form that it does not have.
    """
    form = attributes.get(TEXT_FORM)
    if form is None:
        return None
    flagged = FLAG_ATTRIBUTES[0] in attributes or FLAG_ATTRIBUTES[1] in attributes
    if form == HEXADECIMAL and dtype == np.uint8 and len(dims) > 1 and 0 < shape[-1] <= LONGEST_WORD and not flagged:
        return Form(None, 2 * shape[-1])
    words = str(attributes.get("flag_meanings", "")).encode().split(b" ")
    numbers = np.atleast_1d(attributes.get("flag_values", -1)).tolist()
    sound = 0 < len(words) <= MOST_WORDS and all(map(_is_word, words)) and numbers == [*range(len(words))]
    if form != FLAGS or dtype != np.int8 or not dims or not sound or b"" in words:
        raise ValueError(f"it is no text in the form '{form}'")
    # the empty text is last, where `NO_WORD`, -1, finds it
    return Form(np.array([*words, b""]), max(map(len, words)))


def with_texts(data: xr.Dataset) -> xr.Dataset:
    """Return a Dataset that another reader opened, or a part of it, with the texts that its file keeps as numbers.

    Raises
    ------
    ValueError
        If a variable declares a form that it does not have.
    """
    numbered = {
        name: candidate
        for name, candidate in data.variables.items()
        if TEXT_FORM in candidate.attrs and candidate.dtype.kind in "iu"
    }
    texts = {}
    for name, variable in numbered.items():
        rows = variable.values[np.newaxis]  # a part may be a single text
        form = text_form(variable.attrs, rows.dtype, ("members", *map(str, variable.dims)), rows.shape)
        if form is not None:
            dims = variable.dims[: variable.ndim - form.further]
            texts[name] = (dims, form.texts(rows)[0], own_attributes(variable.attrs))
    return data.assign(texts) if texts else data


LARGEST = 1 << 25  # bytes of a stretch
UNCHUNKED = 1 << 16  # elements that are taken for a chunk where a variable has none


def read_elements(variable: netCDF4.Variable[Any], key: tuple[Any, ...]) -> Any:
    """Return ``variable[key]``, where each list in the key selects along its own dimension."""
    axis = next((axis for axis, index in enumerate(key) if isinstance(index, np.ndarray)), None)
    if axis is None:
        return variable[key]

    def read_stretch(first: int, last: int) -> Array:
        return np.asarray(read_elements(variable, (*key[:axis], slice(first, last), *key[axis + 1 :])))

    rows = _nonnegative_indices(key[axis], variable.shape[axis])
    if not rows.size:
        return read_stretch(0, 0)
    # a number in the place of a list or slice removes its dimension
    leading_slices: tuple[Any, ...] = (slice(None),) * (
        axis - sum(isinstance(index, int | np.integer) for index in key[:axis])
    )
    elements = None
    for batch_indices in _rows_by_stretch(rows, *_stretch_sizes(variable, axis)):
        batch = rows[batch_indices]
        first = int(batch.min())
        part = read_stretch(first, int(batch.max()) + 1)[(*leading_slices, batch - first)]
        if elements is None:
            shape = part.shape
            elements = np.empty(
                (*shape[: len(leading_slices)], rows.size, *shape[len(leading_slices) + 1 :]), part.dtype
            )
        elements[(*leading_slices, batch_indices)] = part
    return elements


def _nonnegative_indices(rows: Array, length: int) -> NDArray[np.int64]:
    """Return non-negative indices of elements; negative ones count from the end."""
    positions = np.where(rows < 0, rows + length, rows).astype(np.int64)
    outside = np.flatnonzero((positions < 0) | (positions >= length))
    if outside.size:
        raise IndexError(f"index {rows[outside[0]]} is out of bounds for a dimension of {length}")
    return positions


def _stretch_sizes(variable: netCDF4.Variable[Any], axis: int) -> tuple[int, int]:
    """Return how many elements along a dimension are stored together, and how many of such parts make a stretch."""
    chunks = variable.chunking()
    part = int(chunks[axis]) if isinstance(chunks, list | tuple) else UNCHUNKED
    elements_per_row = prod(variable.shape[:axis] + variable.shape[axis + 1 :])
    width = np.dtype(variable.dtype).itemsize if variable.dtype is not str else 1
    return part, max(1, LARGEST // max(1, part * elements_per_row * width))


def _rows_by_stretch(rows: NDArray[np.int64], part: int, max_parts: int) -> Iterator[NDArray[np.int64]]:
    """Yield which of the rows are read in one stretch: those of neighbouring parts, so many at most."""
    order = np.argsort(rows, kind="stable")
    parts, starts = np.unique(rows[order] // part, return_index=True)
    starts_stretch = np.concatenate([[True], np.diff(parts) > 1])
    begins = np.flatnonzero(starts_stretch)
    index_in_stretch = np.arange(parts.size) - begins[np.cumsum(starts_stretch) - 1]
    yield from np.split(order, starts[(index_in_stretch % max_parts == 0)][1:])


class VariableStore(NetCDF4DataStore):
    """xarray's own reading of variables and how they are stored; their values are read here."""

    __slots__ = ()

    def open_store_variable(self, name: str, var: Any) -> Variable:
        """Return a variable without reading its values."""
        variable = super().open_store_variable(name, var)
        values = StoredValues(self._manager, name, variable.shape, variable.dtype)
        if variable.dtype == "S1":  # letters of a record are UTF-8, whether another program says so or not
            variable.attrs["_Encoding"] = "utf-8"
        form = text_form(variable.attrs, variable.dtype, variable.dims, variable.shape)
        if form is None:
            return Variable(variable.dims, indexing.LazilyIndexedArray(values), variable.attrs, variable.encoding)
        texts = indexing.LazilyIndexedArray(Texts(values, form))
        attributes = own_attributes(variable.attrs) | {DIGEST: variable.attrs.get(DIGEST, "")}
        return Variable(variable.dims[: len(texts.shape)], texts, attributes)


class StoredValues(BackendArray):
    """The values of one variable."""

    def __init__(self, lent: Any, name: str, shape: tuple[int, ...], dtype: Any) -> None:
        self.lent, self.name, self.shape, self.dtype = lent, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    @with_library_lock
    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        variable = self.lent.acquire().variables[self.name]
        variable.set_auto_maskandscale(False)
        variable.set_auto_chartostring(False)
        try:
            values = read_elements(variable, key)
        except (OSError, RuntimeError) as error:  # a damaged file that was opened unchecked, or a lost disk
            raise ArchiveError(f"variable '{self.name}' of '{self.lent.location}' cannot be read: {error}") from None
        finally:
            # also after an error: a file that was overwritten is a better reason than what the library says of it
            self.lent.check_unchanged()
        if self.dtype == "S1":
            self._check_text(values)
        return values

    def _check_text(self, letters: Any) -> None:
        """Check that bytes are text to xarray, which decodes a row of them at a time."""
        width = letters.shape[-1] if letters.ndim else 1
        for row in letters.reshape(-1, width or 1):
            try:
                row.tobytes().decode()
            except UnicodeDecodeError as error:
                raise ArchiveError(
                    f"variable '{self.name}' of '{self.lent.location}' is no text in UTF-8: {error.reason} at {error.start}"
                ) from None


class Texts(BackendArray):
    """The texts of one variable that are numbers in the file."""

    def __init__(self, numbers: StoredValues, form: Form) -> None:
        self.numbers, self.form, self.dtype = numbers, form, np.dtype(f"U{form.width}")
        self.shape: tuple[int, ...] = numbers.shape[: len(numbers.shape) - form.further]

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        stored_key = indexing.OuterIndexer((*key, *(slice(None),) * self.form.further))
        try:
            return self.form.texts(np.asarray(self.numbers[stored_key]))
        except ValueError as error:  # of a file that was opened unchecked
            raise ArchiveError(f"texts of '{self.numbers.name}' cannot be read: {error}") from None
