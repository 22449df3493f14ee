"""Which files a model may take its tables from, and how such a file is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path, PureWindowsPath

from xdynamics.faults import InputError
from xdynamics.model.workbook import text_of_workbook
from xdynamics.runtime.files import check_no_address, decoded, displayed_path, read_bounded, reason

LARGEST_TABLE = 50_000_000  # bytes
WORKBOOK = ".xlsx"

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
            return text_of_workbook(content) if path.suffix.lower() == WORKBOOK else decoded(content)
        except InputError as error:
            why = str(error)
        except FileNotFoundError:
            folder = str(self.folder.absolute())
            raise InputError(
                f"table {displayed_path(name)!r} is not in {displayed_path(folder)!r}; put it there, or write its name as seen from there"
            ) from None
        except (OSError, ValueError) as error:  # ValueError: bytes that are not text, or a name with a null
            why = reason(error, path) if isinstance(error, OSError) else "it is no UTF-8 text (save it so, as CSV)"
        raise InputError(f"table {str(self.folder / name)!r} cannot be read: {why}")

    def _below(self, name: str) -> Path:
        """Resolve the links of a name, which must stay below the folder."""
        remedy = (
            f"move it there, or allow every file with tables='{ANYWHERE}' (on the command line: --tables {ANYWHERE})"
        )
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
