"""Texts of many members as numbers in a file: outcomes as flags, digests as bytes; readers get the texts.

A digest of 32 digits takes 16 bytes, an outcome one; in memory, as texts of one width, 128 and 80. The digest of such a
variable is that of its texts, so that an archive has the same content digest in whatever form it keeps them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.flag_words import own_attributes
from xdynamics.schema import FLAG_ATTRIBUTES, TEXT_FORM, flag_attributes

if TYPE_CHECKING:
    import xarray as xr


Array = NDArray[Any]


FLAGS, HEXADECIMAL = "flag_meanings", "hexadecimal"


NUMBERED = ("outcome", "digest")  # roles of the variables that are kept so


NO_WORD = -1  # of an empty text, which no flag can mean


MOST_WORDS, LONGEST_WORD = 64, 64


DIGITS = b"0123456789abcdef"


AT_ONCE = 1 << 16  # texts that are turned into bytes


def bytes_dim(name: str) -> str:
    """Name the dimension of the bytes of digests in a file."""
    return f"{name}_bytes"


def encoded_texts(role: Any, letters: Array) -> tuple[TextEncoding, Array] | None:
    """Return how texts are kept as numbers, and these; None if they stay letters: neither words nor digests, or a single text.

    Parameters
    ----------
    role : str
        Of the variable.
    letters : ndarray of S1
        Along the last dimension, as `seals.utf8_letters` gives them.
    """
    if role not in NUMBERED or letters.ndim < 2 or not letters.size:
        return None
    if role == "digest":
        values = _from_hexadecimal(np.ascontiguousarray(letters).view(np.uint8))
        return None if values is None else (TextEncoding(digits=letters.shape[-1]), values)
    width = letters.shape[-1]
    texts = np.ascontiguousarray(letters).view(f"S{width}")[..., 0]
    words = _flag_words(texts.ravel())
    if words is None:
        return None
    return TextEncoding(tuple(words)), _word_numbers(texts, words)


def _word_numbers(texts: Array, words: Sequence[bytes]) -> NDArray[np.int8]:
    values = np.full(texts.shape, NO_WORD, np.int8)
    for number, word in enumerate(words):
        values[texts == word] = number
    return values


def _flag_attributes(words: Sequence[bytes]) -> dict[str, Any]:
    return {TEXT_FORM: FLAGS, **flag_attributes(dict(enumerate(meaning.decode() for meaning in words)))}


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


@dataclass(frozen=True)
class TextEncoding:
    """How texts of one variable are kept: as numbers of words, as bytes of hexadecimal digits, or as texts.

    Attributes
    ----------
    words : tuple of bytes, optional
        Sorted; None unless the texts are words.
    digits : int
        Hexadecimal digits of each text; 0 unless they are such.
    """

    words: tuple[bytes, ...] | None = None
    digits: int = 0

    @classmethod
    def of_parts(cls, parts: Sequence[tuple[Form | None, bool]]) -> TextEncoding:
        """Return the encoding that all parts allow, from the form that each has, and whether it has texts that are not empty."""
        forms = [form for form, has_text in parts if form is not None or has_text]  # empty texts have every form
        if not forms or None in forms:
            return cls()
        if any(form.words is None for form in forms if form):
            widths = {form.width for form in forms if form and form.words is None}
            return cls(digits=widths.pop()) if len(widths) == 1 and len(forms) == len(parts) else cls()
        words = {bytes(word) for form in forms if form and form.words is not None for word in form.words} - {b""}
        return cls(tuple(sorted(words)) if len(words) <= MOST_WORDS else None)

    def dims(self, name: str) -> dict[str, int]:
        """Return the dimension of the bytes of each text, and its size, if there is one."""
        return {bytes_dim(name): self.digits // 2} if self.digits else {}

    @property
    def dtype(self) -> Any:
        """The type in which the texts are kept."""
        return np.dtype(np.uint8 if self.digits else np.int8 if self.words else object)

    @property
    def attributes(self) -> dict[str, Any]:
        """The meaning of the numbers."""
        return {TEXT_FORM: HEXADECIMAL} if self.digits else _flag_attributes(self.words) if self.words else {}

    def encode(self, texts: Array) -> Array:
        """Return texts, given as bytes, as they are kept."""
        if self.digits:
            codes = np.ascontiguousarray(texts).view(np.uint8).reshape(*texts.shape, -1)
            octets = _from_hexadecimal(codes)
            assert octets is not None  # noqa: S101 - each part has this form
            return octets
        if self.words:
            return _word_numbers(texts, self.words)
        return np.char.decode(texts, "utf-8").astype(object)


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
