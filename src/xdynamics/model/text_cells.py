"""Lines of a text file as cells: numbers, titles with units, words that are units."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import SEPARATORS, cell_excerpt, number_in_cell, title
from xdynamics.units import parse_unit


@dataclass(frozen=True)
class Cells:
    """A table in cells: titles, rows of texts, and what kind of file they are from."""

    kind: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self, name: str) -> str:
        """Write it as CSV, with a comment that says where it is from."""
        buffer = io.StringIO()
        rows = csv.writer(buffer, lineterminator="\n")
        rows.writerow(self.header)
        rows.writerows(self.rows)
        return f"# {name}, {self.kind}\n{buffer.getvalue()}"


def cells_of(line: str) -> list[str]:
    """Split a line by the separator that it has; by spaces where it has none.

    Raises
    ------
    InputError
        If a cell is longer than the limit.
    """
    separator = next((separator for separator in SEPARATORS if separator in line), "")
    try:
        cells = next(csv.reader([line], delimiter=separator)) if separator else line.split()
    except csv.Error:
        raise InputError(
            f"a cell of the line {cell_excerpt(line)} has over {csv.field_size_limit()} characters, the limit"
        ) from None
    return [cell.strip() for cell in cells]


def number_cells(line: str, decimal: str) -> list[str]:
    """Return the cells of a line of numbers with decimal points, without empty ones at its end; none if it is no such line."""
    cells = cells_of(line)
    while cells and not cells[-1]:
        cells.pop()
    comma = decimal == "," or (not decimal and ";" in line) or (not decimal and "\t" in line and "." not in line)
    cells = [cell.replace(",", ".") if comma else cell for cell in cells]
    good = any(cells) and all(not cell or number_in_cell(cell) is not None for cell in cells)
    return cells if good else []


def first_numbers(lines: Sequence[str], decimal: str) -> int:
    """Return the number of the first line of numbers that another one with as many cells follows."""
    for k in range(min(len(lines) - 1, 200)):
        cells, next_cells = number_cells(lines[k], decimal), number_cells(lines[k + 1], decimal)
        if cells and len(cells) == len(next_cells):
            return k
    return -1


def is_table(line: str) -> bool:
    """Whether a line is a header with a unit in it already."""
    return any(has_unit(cell) for cell in cells_of(line))


def has_unit(cell: str) -> bool:
    """Whether a cell is a title with a unit."""
    try:
        title(cell)
    except InputError:
        return False
    return True


def unit_word(cell: str) -> str:
    """Return the unit that a cell is, as a symbol or a word, ``(ms)``, ``Volt``; empty if it is none."""
    bare = cell.strip().strip("()[]").strip()
    for word in (bare, re.sub("s$", "", bare.lower()) if len(bare) > 2 else bare):
        try:
            return parse_unit(word).text if word else ""
        except InputError:
            continue
    return ""
