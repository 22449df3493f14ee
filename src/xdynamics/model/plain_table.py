"""Columns of a large table of one form, read at once: every line with the same number of cells, without quotes and gaps."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.shapes import Extent

LEAST = 1 << 12  # characters from which a table is large
_UNUSUAL = ('"', "#", "%", "//", "\n\n")  # quotes, comments, empty lines
_BLANK = re.compile(r"^[^\S\n]*$", re.MULTILINE)
_END = ord("\n")
_LONGEST = 40  # characters of a label


class PlainTable:
    """The lines of a table below its header, all of them of the same number of cells.

    Parameters
    ----------
    content : bytes
        Lines as `from_text` finds them.
    separator : str
    rows : int
        How many lines there are.
    """

    def __init__(self, content: bytes, separator: str, rows: int) -> None:
        self.content, self.separator, self.rows = content, separator, rows

    @classmethod
    def from_text(cls, text: str, separator: str, columns: int) -> PlainTable | None:
        """Return a table; None if it is small, or its lines are not all of one form, and are to be read one by one."""
        if len(text) < LEAST or not text.isascii() or any(mark in text for mark in _UNUSUAL):
            return None
        if separator != "," and "," in text:  # which may be decimal marks
            return None
        text = text.rstrip("\n")
        if (columns == 1 or separator == "\t") and _BLANK.search(text):
            return None
        content = f"{text}\n".encode()
        letters = np.frombuffer(content, np.uint8)
        ends = np.flatnonzero((letters == _END) | (letters == ord(separator)))
        rows, remainder = divmod(ends.size, columns)
        if remainder:
            return None
        is_last = (letters[ends] == _END).reshape(rows, columns)
        longest = int(np.diff(ends[columns - 1 :: columns], prepend=-1).max())
        is_one = is_last[:, -1].all() and not is_last[:, :-1].any() and longest <= csv.field_size_limit()
        return cls(content, separator, rows) if is_one else None

    def columns(self, places: Sequence[int], kind: Any = float) -> NDArray[Any] | None:
        """Return columns as numbers, or as texts of a length, shape (rows, columns); None if a cell is none of that kind."""
        try:
            lines = io.BytesIO(self.content)
            table_columns = np.loadtxt(lines, kind, comments=None, delimiter=self.separator, usecols=places, ndmin=2)
        except ValueError:
            return None
        return table_columns if len(table_columns) == self.rows else None

    def elements(self, column: int, extent: Extent) -> NDArray[np.int64] | None:
        """Return the elements that a column names, by their numbers, or by their labels where they have some."""
        if not extent.labels:
            numbers = None if b"+" in self.content else self.columns([column], np.int64)
            are_elements = numbers is not None and numbers.min() >= 0 and numbers.max() < extent.size
            return numbers[:, 0] if numbers is not None and are_elements else None
        texts = self.columns([column], f"S{_LONGEST + 1}")  # a longer one is no label
        labels, which = (None, None) if texts is None else np.unique(np.char.strip(texts[:, 0]), return_inverse=True)
        if labels is None or which is None or labels.size > extent.size:
            return None
        places = {label.encode(): number for number, label in enumerate(extent.labels)}
        label_numbers = np.array([places.get(label, -1) for label in labels.tolist()], np.int64)
        return label_numbers[which] if label_numbers.min() >= 0 else None
