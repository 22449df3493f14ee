"""Sheets of Excel as text."""

from __future__ import annotations

import csv
import io
from typing import Any

from xdynamics.faults import InputError

MOST_ROWS, MOST_COLUMNS = 200_000, 256


def text_of_workbook(content: bytes) -> str:
    """Return the first sheet of a workbook that has two rows or more, as CSV.

    Formulas count by the values that were saved with them.

    Raises
    ------
    InputError
        If openpyxl is not installed, it is no workbook, or too large.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise InputError("it is a workbook, and openpyxl is not installed: pip install 'xdynamics[excel]'") from None
    try:
        book = load_workbook(io.BytesIO(content), read_only=True, data_only=True)
    except Exception:  # noqa: BLE001 - whatever openpyxl and zipfile say of a file that is no workbook
        raise InputError("it is no workbook of Excel (.xlsx)") from None
    for sheet in book.worksheets:
        rows = _sheet_rows(sheet)
        if len(rows) > 1:
            text, width = io.StringIO(), max(map(len, rows))
            csv.writer(text, lineterminator="\n").writerows(row + [""] * (width - len(row)) for row in rows)
            return text.getvalue()
    raise InputError("no sheet of the workbook has two rows or more")


def _sheet_rows(sheet: Any) -> list[list[str]]:
    """Return the rows of a sheet that are not empty, wherever they stand; a sheet that is too large is refused, not cut."""
    rows: list[list[str]] = []
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        cells = _row_cells(row)
        if len(cells) > MOST_COLUMNS:
            raise InputError(
                f"sheet '{sheet.title}' has {len(cells)} columns in row {number}, {MOST_COLUMNS} at most; save what is"
                " needed as CSV"
            )
        if cells:
            rows.append(cells)
        if len(rows) > MOST_ROWS:
            raise InputError(f"sheet '{sheet.title}' has over {MOST_ROWS} rows, the limit; save it as CSV")
    return rows


def _row_cells(row: tuple[Any, ...]) -> list[str]:
    cells = ["" if cell is None else repr(cell) if isinstance(cell, float) else str(cell) for cell in row]
    while cells and not cells[-1]:
        cells.pop()
    return cells
