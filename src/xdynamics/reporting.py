"""The last stage of a pipeline: records into a folder, each with its figure and its summary in words."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics import archive
from xdynamics.archive.target import taking_name
from xdynamics.faults import InputError
from xdynamics.figures import plot
from xdynamics.files import made_folder
from xdynamics.summary import summary

if TYPE_CHECKING:
    import xarray as xr

PAGE = "report.md"


def report(folder: str | Path, **records: xr.Dataset | dict[str, xr.Dataset]) -> str:
    """Leave records in a folder: an archive each, a figure each, and one page of words.

    Parameters
    ----------
    folder : str or Path
        Made where it is not there.
    **records : xarray.Dataset, or dict of str to xarray.Dataset
        Runs and evidence by name; several by name are drawn together where they are refinements or diagnoses.

    Returns
    -------
    str
        The page, `report.md`: of each record title, figure, what it tells, and the digest of its archive.

    Raises
    ------
    InputError
        If a name is none for a file, or a record is neither run nor evidence.
    """
    if not records:
        raise InputError("report needs at least one record, like report('results', run=run)")
    for name, entry in records.items():
        several = entry.values() if isinstance(entry, dict) else [entry]
        if not several or not all(hasattr(record, "attrs") for record in several):
            raise InputError(f"'{name}' is {str(entry)[:40]!r}, needs a run, evidence, or several of them by name")
    target = made_folder(folder)
    words = "\n".join(line for name, entry in records.items() for line in _told(target, name, entry))
    with taking_name(target / PAGE) as new:
        new.part.write_text(words + "\n")
    return words


def _told(folder: Path, name: str, record: xr.Dataset | dict[str, xr.Dataset]) -> Iterator[str]:
    """Archive and draw one record, or several by name, and summarise them."""
    datasets = (
        {f"{name}_{key}": dataset for key, dataset in record.items()} if isinstance(record, dict) else {name: record}
    )
    yield from (f"## {name.replace('_', ' ')}", "")
    if figure := _drawn(folder, name, record):
        yield from (f"![{name}]({figure})", "")
    for key, dataset in datasets.items():
        path = archive.save(dataset, folder / f"{key}.nc")
        yield from ("```", *summary(dataset), f"archive   {path.name}, {archive.verify(path)}", "```", "")


def _drawn(folder: Path, name: str, record: xr.Dataset | dict[str, xr.Dataset]) -> str:
    """Draw a record, and return the figure's name; empty if there is nothing to draw."""
    try:
        plot(record, folder / f"{name}.png")
    except InputError:
        return ""
    return f"{name}.png"
