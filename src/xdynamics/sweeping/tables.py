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
    """Whether a table has more than one column besides its argument."""
    return len(_rows(text_of(path), path)[0]) > 2


def narrow(path: Path) -> dict[str, str]:
    """Take a wide table apart: CSV text with argument and value for each further column, by the name in its header.

    Raises
    ------
    InputError
        If a name stands twice, or a row has another number of cells.
    """
    rows = _rows(text_of(path), path)
    header = rows[0]
    labels = [one.split("[")[0].strip() for one in header[1:]]
    if len({*labels}) < len(labels):
        raise InputError(f"table '{path}' has two columns of one name: {', '.join(labels)}")
    for number, row in enumerate(rows, 1):
        if len(row) != len(header):
            raise InputError(f"table '{path}' row {number} has {len(row)} cells, its header {len(header)}")
    return {label: "".join(f"{row[0]},{row[k]}\n" for row in rows) for k, label in enumerate(labels, 1)}


def _rows(text: str, path: Path) -> list[list[str]]:
    lines = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    if not lines:
        raise InputError(f"table '{path}' is empty; it needs a header like 'time [s],thrust [N]' and rows")
    return list(csv.reader(io.StringIO("\n".join(lines))))
