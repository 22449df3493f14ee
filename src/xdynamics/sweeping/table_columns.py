"""Measured tables with several columns: each column is one table."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import doubts_of
from xdynamics.model.instruments import as_table
from xdynamics.runtime.files import decoded, read_bounded, reason

MAX_BYTES = 50_000_000  # bytes


def csv_text(path: Path) -> str:
    """Read a CSV file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return decoded(read_bounded(path, MAX_BYTES)).replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise InputError(f"table '{path}' cannot be read: {reason(error, path)}") from None
    except ValueError as error:
        raise InputError(f"table '{path}' cannot be read: {error}") from None


def has_many_columns(path: Path) -> bool:
    """Whether a table has more than one column besides its argument and uncertainties."""
    return len(_value_columns(_sheet(path))) > 1


def split_table(path: Path) -> dict[str, str]:
    """Split a wide table: CSV text with argument, value and perhaps its uncertainty, by the name in the header.

    Raises
    ------
    InputError
        If a name occurs twice, or a row has another number of cells.
    """
    sheet = _sheet(path)
    tables = {}
    for label, columns in _value_columns(sheet):
        sheet.columns(columns)  # raises if they cannot be read
        tables[label] = _csv_of_columns(
            [list(sheet.header), *(cells for _, cells in sheet.lines)], columns, sheet.decimal
        )
    return tables


def _csv_of_columns(rows: list[list[str]], columns: Sequence[int], decimal: str) -> str:
    """Write some columns as CSV; numbers stay the texts that they are, with decimal points."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([row[k].replace(decimal, ".") for k in columns] for row in rows)
    return text.getvalue()


def _sheet(path: Path) -> Sheet:
    return Sheet.from_text(str(path), as_table(path.name, csv_text(path)))


def _value_columns(sheet: Sheet) -> list[tuple[str, tuple[int, ...]]]:
    """Return the value columns by name, each with the indices of the argument, itself and its uncertainties."""
    names = [title.name for title in sheet.titles()]
    uncertainties = {names[column_index] for name in names for column_index in doubts_of(name, names).values()}
    return [
        (name, (0, k, *doubts_of(name, names).values()))
        for k, name in enumerate(names)
        if k and name not in uncertainties
    ]
