"""Make executed notebooks of the lessons, which are scripts of cells.

python pipelines/lessons/notebooks.py [folder [lesson …]]
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[1]  # where models are found
LESSONS = ("methods", "contacts", "bodies", "chaos", "uncertainty", "fitting", "tables")  # in the order of a course
CELL = re.compile(r"^# %%(?: \[(markdown)\])?[^\n]*\n", re.MULTILINE)
LONGEST = 600  # seconds of a cell


def cells(text: str) -> list[tuple[str, str]]:
    """Return the kind and the source of each cell of a script in percent format."""
    parts = CELL.split(text)[1:]
    found = []
    for kind, source in zip(parts[::2], parts[1::2], strict=True):
        body = re.sub(r"^# ?", "", source, flags=re.MULTILINE) if kind else source
        found.append((kind or "code", body.strip()))
    return found


def notebook(name: str) -> Any:
    """Return the executed notebook of a lesson."""
    import nbformat
    from nbclient import NotebookClient

    book = nbformat.v4.new_notebook(
        metadata={"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    )
    make = {"code": nbformat.v4.new_code_cell, "markdown": nbformat.v4.new_markdown_cell}
    book.cells = [make[kind](source) for kind, source in cells((HERE / f"{name}.py").read_text(encoding="utf-8"))]
    NotebookClient(book, timeout=LONGEST, kernel_name="python3", resources={"metadata": {"path": ROOT}}).execute()
    return book


def main(folder: str = "notebooks", *names: str) -> list[str]:
    """Write lessons, all of them if none is named, and return the names of their files."""
    import nbformat

    if unknown := sorted({*names} - {*LESSONS}):
        sys.exit(f"there is no lesson {', '.join(unknown)}; there are {', '.join(LESSONS)}")
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    files = []
    for name in names or LESSONS:
        file = target / f"{name}.ipynb"
        nbformat.write(notebook(name), file)
        files.append(str(file))
    return files


if __name__ == "__main__":
    print(*main(*sys.argv[1:]), sep="\n")
