"""Which sheet is drawn of which record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.faults import InputError
from xdynamics.figures import budget, comparison, diagnosis, fit, ledger, precision, refinement, run, several, sweep
from xdynamics.figures.sheet import HEIGHT, check_path, sheet, write
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

PAGES: dict[str, Any] = {
    "budget": budget,
    "certificate": budget,
    "comparison": comparison,
    "diagnosis": diagnosis,
    "fit": fit,
    "ledger": ledger,
    "precision": precision,
    "refinement": refinement,
    "sweep": sweep,
}


def plot(record: xr.Dataset | Mapping[str, xr.Dataset], path: str | Path | None = None) -> Figure:
    """Draw a run, or evidence: of a run every coordinate, velocity, force, energy and step; of evidence what it tells.

    Parameters
    ----------
    record : xarray.Dataset, or mapping of str to xarray.Dataset
        A run record, or what `refine`, `compare`, `diagnose`, `validate`, `sweep`, `error_budget` or `fit` returns; several
        refinements or diagnoses by name, to be drawn together.
    path : str or Path, optional
        Where to write the figure: PNG, SVG or PDF by its ending.

    Raises
    ------
    InputError
        If there is nothing to draw, or the ending is another, or the folder does not exist.
    """
    if path is not None:
        check_path(Path(path))
    if hasattr(record, "attrs"):
        kind = str(record.attrs.get(EVIDENCE, ""))
        if kind and kind not in PAGES:
            raise InputError(f"a {kind} has no figure; what it found is told by `xdynamics show`")
        page, title = PAGES.get(kind, run), str(record.attrs.get("title", "run"))
    else:
        page, title = several, f"{', '.join(record)}, side by side"
    panels = page.panels_of(record)
    height = page.height_of(len(panels)) if hasattr(page, "height_of") else float(getattr(page, "HEIGHT", HEIGHT))
    figure = sheet(panels, title, page.foot_of(record), height)
    if path is not None:
        write(figure, Path(path))
    return figure
