"""Which sheet is drawn of which record."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics.figures import comparison, diagnosis, ledger, refinement, run
from xdynamics.figures.sheet import HEIGHT, check_path, sheet, write
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

PAGES = {"comparison": comparison, "diagnosis": diagnosis, "ledger": ledger, "refinement": refinement}


def plot(record: xr.Dataset, path: str | Path | None = None) -> Figure:
    """Draw a run, or evidence: of a run every coordinate, velocity, force, energy and step; of evidence what it tells.

    Parameters
    ----------
    record : xarray.Dataset
        A run record, or what `refine`, `compare`, `diagnose` or `validate` returns.
    path : str or Path, optional
        Where to write the figure: PNG, SVG or PDF by its ending.

    Raises
    ------
    InputError
        If there is nothing to draw, or the ending is another, or the folder does not exist.
    """
    if path is not None:
        check_path(Path(path))
    page = PAGES.get(str(record.attrs.get(EVIDENCE, "")), run)
    height = float(getattr(page, "HEIGHT", HEIGHT))
    figure = sheet(page.panels_of(record), str(record.attrs.get("title", "run")), page.foot_of(record), height)
    if path is not None:
        write(figure, Path(path))
    return figure
