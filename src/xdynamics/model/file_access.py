"""The files that a model may take its tables from, and the limits under which such files are read.

Sheets of Excel are read as text, netCDF, Parquet, HDF5 and MATLAB's files by a process of their own. The text of a model is checked before it is parsed: parsing a small file can take
gigabytes.
"""

from __future__ import annotations

import csv
import io
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from typing import Any

from xdynamics.faults import InputError
from xdynamics.runtime.files import check_no_address, decoded, displayed_path, read_bounded, reason
from xdynamics.units.unit import read_decimal

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
        _check_unpacked(content)
        # data_only gives what formulas came to, not their text
        book = load_workbook(io.BytesIO(content), read_only=True, data_only=True)
    except InputError:
        raise
    except Exception:  # noqa: BLE001 - whatever openpyxl and zipfile say of a file that is no workbook
        raise InputError("it is no workbook of Excel (.xlsx)") from None
    for sheet in book.worksheets:
        try:
            rows = _sheet_rows(sheet)
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 - a text that is missing, a number that is none, XML that is cut off
            raise InputError(
                f"sheet '{sheet.title}' of the workbook is damaged ({type(error).__name__}: {error})"
            ) from None
        if len(rows) > 1:
            text, width = io.StringIO(), max(map(len, rows))
            csv.writer(text, lineterminator="\n").writerows(row + [""] * (width - len(row)) for row in rows)
            return text.getvalue()
    raise InputError("no sheet of the workbook has two rows or more")


def _text_by_library(path: Path) -> str:
    """Return a table that a library reads, as CSV, by a process whose time and memory are bounded.

    Raises
    ------
    InputError
        If it holds no table, or the process ended without one.
    """
    program = f"import sys; sys.path[:] = {sys.path!r}; from xdynamics.interchange.table_files import main; main(*sys.argv[1:])"
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter, and our own program
            [sys.executable, "-c", program, str(path.absolute()), path.stem],
            capture_output=True,
            timeout=PATIENCE,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise InputError(f"it was not read within {PATIENCE:g} s; save what is needed as CSV") from None
    said = done.stdout.decode(errors="replace")
    if done.returncode == REFUSED:
        raise InputError(said)
    if done.returncode:
        raise InputError("reading it takes too much time or memory, or it is damaged; save what is needed as CSV")
    return said


def _check_unpacked(content: bytes) -> None:
    """Refuse a workbook whose parts are too large when they are unpacked, which its headers need not say, or one row of them."""
    left = LARGEST_UNPACKED
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for part in archive.infolist():
            tags = 0
            with archive.open(part) as unpacked:
                while left >= 0 and (block := unpacked.read(1 << 20)):
                    left -= len(block)
                    for begins, piece in enumerate(_ROW.split(block)):
                        tags = piece.count(b"<") + (0 if begins else tags)
                        if tags > MOST_TAGS and part.filename.startswith("xl/worksheets/"):
                            raise InputError(
                                f"it is a workbook with over {MOST_TAGS} entries in a row, at '{part.filename}'"
                            )
            if left < 0:
                raise InputError(
                    f"it is a workbook of over {LARGEST_UNPACKED} bytes unpacked, at '{part.filename}', and that is the limit; save"
                    " its sheet as CSV"
                )


def _sheet_rows(sheet: Any) -> list[list[str]]:
    """Return the rows of a sheet that are not empty, wherever they stand; a sheet that is too large is refused, not cut."""
    rows: list[list[str]] = []
    for number, row in enumerate(sheet.iter_rows(values_only=True), start=1):
        if number > LAST_ROW:
            raise InputError(f"sheet '{sheet.title}' has over {LAST_ROW} rows, more than Excel has")
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


LARGEST_TABLE = 50_000_000  # bytes
LARGEST_UNPACKED = 50_000_000  # bytes of all parts of a workbook, of which openpyxl makes objects ten times as large
LAST_ROW = 1 << 20  # of a sheet of Excel
MOST_TAGS = 8 << 14  # of a row: cells of all columns that Excel has, with what is in them
_ROW = re.compile(rb"<(?:[A-Za-z0-9_]+:)?row\b")
WORKBOOK = ".xlsx"
NETCDF, HDF5 = (".nc", ".nc4", ".cdf", ".netcdf"), (".h5", ".hdf5")
BY_LIBRARIES = (*NETCDF, *HDF5, ".parquet", ".feather", ".mat")  # which are read by a process of their own
ZARR_METADATA = ("zarr.json", ".zgroup")
OF_MANY_LAYOUTS = (".json", ".jsonl", ".ndjson")
MOST_ROWS_READ, REFUSED, PATIENCE = 2_000_000, 3, 120.0  # rows; exit code of what is no table; s

# a file's own folder and below; any file; no file, as the tables are part of the text
BELOW, ANYWHERE, EMBEDDED = "below", "anywhere", "embedded"
ACCESSES = (BELOW, ANYWHERE)


@dataclass(frozen=True)
class FileAccess:
    """Where the tables of a model are looked for, and which files are allowed.

    Attributes
    ----------
    folder : Path
        What the names of tables are relative to.
    tables : {"below", "anywhere", "embedded"}
        A model file from somebody else must not give access to the reader's other files: the contents of a table are
        stored in the archive, and parts of them appear in errors.
    """

    folder: Path
    tables: str

    def read_table(self, name: str) -> str:
        """Return the text of a table.

        Raises
        ------
        InputError
            If the file is out of reach (it is then not opened) or cannot be read.
        """
        if self.tables == EMBEDDED:
            raise InputError(
                f"table {displayed_path(name)!r} is not in the text; a model from a text takes no files: give its rows as `csv`, or"
                " read a model file with Model.from_toml"
            )
        try:
            check_no_address(name)
            check_no_address(self.folder)
        except InputError as error:
            raise InputError(f"a table cannot be read: {error}") from None
        path = self.folder / name
        if self.tables == BELOW:
            path = self._below(name)
        try:
            content = read_bounded(path, LARGEST_TABLE, "; leave out rows, or columns that are not read")
            _refuse_many_layouts(path)
            if path.suffix.lower() in BY_LIBRARIES:
                return _text_by_library(path)
            return text_of_workbook(content) if path.suffix.lower() == WORKBOOK else _text_of_table(content)
        except InputError as error:
            why = str(error)
        except FileNotFoundError:
            folder = str(self.folder.absolute())
            raise InputError(
                f"table {displayed_path(name)!r} is not in {displayed_path(folder)!r}; put it there, or write its name as seen from there"
            ) from None
        except (OSError, ValueError) as error:  # ValueError: bytes that are not text, or a name with a null
            why = reason(error, path) if isinstance(error, OSError) else "it is no UTF-8 text (save it so, as CSV)"
            if any((path / metadata).is_file() for metadata in ZARR_METADATA):
                why = f'it is a Zarr store; save it as netCDF, or give it in Python: xarray.open_zarr("{path.name}")'
        raise InputError(f"table {str(self.folder / name)!r} cannot be read: {why}")

    def _below(self, name: str) -> Path:
        """Resolve the links of a name, which must stay below the folder."""
        remedy = (
            f"move it there, or allow every file with tables='{ANYWHERE}' (on the command line: --tables {ANYWHERE})"
        )
        # checked as on Windows too, wherever it is read: a backslash is part of a name elsewhere
        spellings = (Path(name), PureWindowsPath(name))
        if any(spelling.is_absolute() or spelling.drive or ".." in spelling.parts for spelling in spellings):
            raise InputError(
                f"table {name!r} is out of reach: a model file takes tables from its own folder and below; {remedy}"
            )
        try:
            folder = self.folder.resolve()
            path = (folder / name).resolve()
        except (OSError, RuntimeError, ValueError):  # RuntimeError: a loop of links
            raise InputError(f"table {name!r} cannot be read: it is no path for a file") from None
        if not path.is_relative_to(folder):
            raise InputError(
                f"table {name!r} is out of reach: a link leads out of the model file's own folder; {remedy}"
            )
        return path


def _refuse_many_layouts(path: Path) -> None:
    if path.suffix.lower() in OF_MANY_LAYOUTS:
        raise InputError(
            "it is JSON, of which each program writes another; save it as CSV, or give it in Python:"
            f' pandas.read_json("{path.name}").set_index("t [s]")'
        )


MOST_ENTRIES = 10_000  # keys and headers of a text, or entries of a section; a thousand bodies have some 6,000
LARGEST = 20_000_000  # characters
MOST_VALUES = 500_000  # of lists
LARGEST_RECORDED, MOST_RECORDED = 70_000_000, 2_000_000  # of the text of a record, which has its tables in it
DEEPEST_KEY = 8  # names that dots join

# strings and comments, which may contain anything; one that is not closed ends with its line or the file;
# quantifiers are possessive (`++`): a backtracking one keeps every position it might return to
_TEXTS = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5}|\Z)|\'\'\'.*?(?:\'{3,5}|\Z)|"(?:[^"\\\n]++|\\.)*+"?|\'[^\'\n]*\'?|#[^\n]*',
    re.DOTALL,
)
_DEEP = re.compile(rf"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){{{DEEPEST_KEY}}}")
_SIZES = "; so many numbers belong into a table"
_OF_RECORDS = "; the model_toml of a record is read by Model.from_record"


def parse_model_text(text: str, *, recorded: bool = False) -> dict[str, Any]:
    """Parse TOML, unless it exceeds the limits of a model, or of a record's.

    Raises
    ------
    InputError
        Naming the limit.
    tomllib.TOMLDecodeError, RecursionError, ValueError
        If the text is not TOML.
    """
    check_text(text, recorded=recorded)
    return tomllib.loads(text, parse_float=read_decimal)


def check_text(text: str, *, recorded: bool = False) -> None:
    """Refuse TOML text larger than any model needs.

    Raises
    ------
    InputError
        Naming the limit, with the line where that helps.
    """
    largest, most_values = (LARGEST_RECORDED, MOST_RECORDED) if recorded else (LARGEST, MOST_VALUES)
    remedy = "" if recorded else _OF_RECORDS
    if len(text) > largest:
        raise InputError(f"it has {len(text)} characters, over the limit of {largest}{_SIZES}{remedy}")
    bare = _TEXTS.sub(lambda match: "" if match[0][0] == "#" else "s" + "\n" * match[0].count("\n"), text)
    entries = bare.count("=") + bare.count("\n[")
    if entries > MOST_ENTRIES:
        raise InputError(f"it has {entries} entries, over the limit of {MOST_ENTRIES}{_SIZES}")
    values = bare.count(",")
    if values > most_values:
        raise InputError(
            f"its lists have {values} values, over the limit of {most_values}; put them into tables{remedy}"
        )
    if match := _DEEP.search(bare):
        line = bare.count("\n", 0, match.start()) + 1
        raise InputError(f"line {line}: a key has over {DEEPEST_KEY} names that dots join, the limit")


def excess(entries: Mapping[str, Any]) -> str:
    """Return the message that a section has too many entries, from a file or from Python; empty if it has not."""
    return (
        f"has {len(entries)} entries, over the limit of {MOST_ENTRIES}{_SIZES}" if len(entries) > MOST_ENTRIES else ""
    )


def _text_of_table(content: bytes) -> str:
    """Return the text of a table: in UTF-8 or UTF-16, else in Windows-1252, which spreadsheets write, and it then says so.

    Raises
    ------
    ValueError
        If it is no text.
    """
    try:
        return decoded(content)
    except UnicodeDecodeError:
        if b"\0" in content:
            raise
    text = decoded(content.decode("cp1252").encode())
    return f"{text.rstrip()}\n# read as Windows-1252, as it is no UTF-8\n"
