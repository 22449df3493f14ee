"""Measured tables with several columns: each column is one table."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from xdynamics.faults import InputError
from xdynamics.files import decoded, read_bounded

LARGEST = 50_000_000  # bytes


def text_of(path: Path) -> str:
    """Read a CSV file.

    Raises
    ------
    InputError
        If it cannot be read.
    """
    try:
        return decoded(read_bounded(path, LARGEST)).replace("\r\n", "\n").replace("\r", "\n")
    except OSError as error:
        raise InputError(f"table '{path}' cannot be read: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"table '{path}' cannot be read: {error}") from None


def is_wide(path: Path) -> bool:
    """Whether a table has more than one column besides its argument and uncertainties."""
    return len(_labels(_rows(text_of(path), path)[0])) > 1


def narrow(path: Path) -> dict[str, str]:
    """Take a wide table apart: CSV text with argument, value and perhaps its uncertainty, by the name in the header.

    Raises
    ------
    InputError
        If a name stands twice, or a row has another number of cells.
    """
    rows = _rows(text_of(path), path)
    header = rows[0]
    labels = _labels(header)
    names = [name for name, _ in labels]
    if len({*names}) < len(names):
        raise InputError(f"table '{path}' has two columns of one name: {', '.join(names)}")
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise InputError(f"table '{path}' row {number} has {len(row)} cells, its header {len(header)}")
    return {label: _written([[row[k] for k in (0, *columns)] for row in rows]) for label, columns in labels}


def _labels(header: list[str]) -> list[tuple[str, tuple[int, ...]]]:
    """Name the value columns, each with its place and that of its uncertainties, ``u(name)``, if it has some."""
    names = [one.split("[")[0].strip() for one in header]
    doubts = {f"u({name})" for name in names}
    return [
        (name, (k, names.index(f"u({name})")) if f"u({name})" in names else (k,))
        for k, name in enumerate(names)
        if k and name not in doubts
    ]


def _written(rows: list[list[str]]) -> str:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()


def _rows(text: str, path: Path) -> list[list[str]]:
    lines = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"table '{path}' is empty; it needs a header like 'time [s],thrust [N]' and rows")
    return list(csv.reader(io.StringIO("\n".join(lines))))
