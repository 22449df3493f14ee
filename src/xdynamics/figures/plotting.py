"""Which sheet is drawn of which record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics.figures import comparison, diagnosis, refinement, run
from xdynamics.figures.sheet import check_path, sheet, write
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

PAGES = {
    "comparison": (comparison.panels_of, comparison.foot_of),
    "diagnosis": (diagnosis.panels_of, diagnosis.foot_of),
    "refinement": (refinement.panels_of, refinement.foot_of),
}


def plot(record: xr.Dataset, path: str | Path | None = None) -> Figure:
    """Draw a run, or evidence: of a run every coordinate, velocity, force, energy and step; of evidence what it tells.

    Parameters
    ----------
    record : xarray.Dataset
        A run record, or what `refine`, `compare` or `diagnose` returns.
    path : str or Path, optional
        Where to write the figure: PNG, SVG or PDF by its ending.

    Raises
    ------
    InputError
        If there is nothing to draw, or the ending is another, or the folder does not exist.
    """
    if path is not None:
        check_path(Path(path))
    panels_of, foot_of = PAGES.get(str(record.attrs.get(EVIDENCE, "")), (run.panels_of, run.ending_of))
    figure = sheet(panels_of(record), str(record.attrs.get("title", "run")), foot_of(record))
    if path is not None:
        write(figure, Path(path))
    return figure
