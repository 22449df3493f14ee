"""Which sheet is drawn of which record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from xdynamics.archive import check_states, without_stale_units
from xdynamics.archive.place import GIVEN, Given, placed
from xdynamics.evidence.grid_axes import is_sweep, sweep_of
from xdynamics.evidence.stages import computed
from xdynamics.faults import InputError
from xdynamics.figures import (
    budget,
    budget_grid,
    comparison,
    diagnosis,
    differences,
    enclosure,
    fit,
    ledger,
    logs,
    modes,
    overlay,
    precision,
    refinement,
    run,
    sweep,
)
from xdynamics.figures.excerpt import drawn_of
from xdynamics.figures.sheet import DPI, Panel, check_path, lit, on_axes, sheet, write
from xdynamics.figures.transients import Transient
from xdynamics.record import of_elements
from xdynamics.record.folding import model_dimensions
from xdynamics.record.partial_records import with_article
from xdynamics.record.run_dataset import check_dataset
from xdynamics.record.unfolding import unfold
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.figures.picture import Picture

PAGES = {
    kind: module.PAGE
    for module in (
        budget,
        budget_grid,
        comparison,
        diagnosis,
        differences,
        enclosure,
        fit,
        ledger,
        logs,
        modes,
        precision,
        refinement,
        sweep,
    )
    for kind in module.PAGE.kinds
}


@of_elements
def plot(
    record: xr.Dataset | Sequence[xr.Dataset] | Mapping[str, xr.Dataset],
    path: Given | None = None,
    *,
    only: str | Sequence[str] | None = None,
    beside: Any = (),
    panels: str = run.FEW,
    transient: int | str | None = None,
    size: tuple[float, float] | None = None,
    dpi: int = DPI,
    dark: bool = False,
    ax: Any = None,
) -> Picture:
    """Draw a run (its motion, energy, what drives or touches, with the events) or the findings of evidence.

    Parameters
    ----------
    record : xarray.Dataset, sequence of these, or mapping of str to these
        A run record, or several, drawn over one another and named by what differs or as the mapping says; or what `refine`, `compare`, `diagnose`, `validate`, `sweep`, `contrast`, `precision`, `modes`, `error_budget`, `fit` or `enclose` returns; several
        refinements or diagnoses by name, to be drawn together. Lazy stages are computed, all of them at once; of a run in chunks
        the columns that are drawn are read, each chunk once: of a long one the least and the greatest value of each
        stretch are kept, and what is at events.
    path : str or Path, optional
        Where to write the figure: PNG, SVG or PDF by its ending; HTML for a page that is interactive, which needs plotly.
    only : str or sequence of str, optional
        Of a run: panels (plane, trajectory, velocity, state, profile, contact, drive, phase, section, energy, steps, errors, events) or
        variables that are drawn alone; forces, accelerations and observables are drawn where they are named.
    beside : Dataset, path or sequence of these, optional
        Of a run: other runs and measured data, drawn over the same variables. Of proven bounds: runs, drawn inside them.
    panels : {"few", "all"}
        Of a run: the four at most that one looks at first, or all, with those of steps, errors, and how events were located.
    transient : int or str, optional
        Of a sweep that keeps occurrences (a bifurcation diagram), or of a run's Poincaré section: what is left out, as a number of
        occurrences or periods, or up to a time like ``"200 s"``.
    size : pair of float, inches, optional
    dpi : int
        Dots per inch, for PNG.
    dark : bool
        Whether to draw on a dark background.
    ax : matplotlib.axes.Axes, optional
        Axes of a figure of your own, to draw the first panel on; of a run `only` says which one that is.

    Returns
    -------
    matplotlib.figure.Figure
        That of `ax`, or a new one. As a cell's last line a picture; its ``interactive()`` can be zoomed and asked for values, and needs plotly.

    Raises
    ------
    InputError
        If there is nothing to draw, the file's ending is unknown, or its folder does not exist.
    """
    _check_axes(ax, path, size)
    if path is not None:
        check_path(placed(path))
    wanted = [only] if isinstance(only, str) else only
    others = (
        [beside] if isinstance(beside, GIVEN) or hasattr(beside, "attrs") or hasattr(beside, "columns") else [*beside]
    )
    given, others, names = _first_of(record, others)
    given, *others = [_as_drawn(each) if hasattr(each, "attrs") else each for each in (given, *others)]
    given = _computed(given, wanted)
    if hasattr(given, "attrs"):
        kind = str(given.attrs.get(EVIDENCE, ""))
        if kind and kind not in PAGES:
            raise InputError(f"there is no figure of {with_article(kind)}; `xdynamics show` prints what it found")
        page, title = PAGES.get(kind, run.PAGE), str(given.attrs.get("title", "run"))
        if page is run.PAGE and others:
            title = title.removesuffix(f", by {given.attrs.get('solver_method')}")
    else:
        page, title = overlay.PAGE, f"{', '.join(given)}, side by side"
    if page is not run.PAGE and (only is not None or panels != run.FEW or (others and page is not enclosure.PAGE)):
        raise InputError("only, panels and beside are for figures of a run, beside for those of proven bounds too")
    if panels not in run.AMOUNTS:
        raise InputError(f"panels is {panels!r}; there are {', '.join(run.AMOUNTS)}")
    _check(size, dpi)
    drawn, rest = _panels(page, given, transient, others, {"only": wanted, "amount": panels, "names": names})
    foot = "; ".join(filter(None, (page.foot_of(given), rest)))
    if not drawn:
        raise InputError(f"'{title}' has nothing that is drawn of it; give it whole, as it was made")
    if ax is not None:
        with lit(dark=dark):
            on_axes(ax, drawn[0])
        return cast("Picture", ax.figure)
    if len(drawn) > page.most_panels:
        foot = f"the first {page.most_panels} of {len(drawn)} panels; {foot}"
        drawn = drawn[: page.most_panels]
    with lit(dark=dark):
        figure = sheet(drawn, title, foot, page.height_of(len(drawn)), size)
        if path is not None:
            write(figure, placed(path), dpi)
    return figure


def _as_drawn(record: xr.Dataset) -> xr.Dataset:
    """Return a record by its elements, without units that edits made wrong; a run whose motion was edited is refused."""
    if is_sweep(record):
        record = sweep_of(record)
    if not record.attrs.get(EVIDENCE):
        check_states(record)
    record = without_stale_units(record)
    return unfold(record) if model_dimensions(record) else record


def _left_out(page: Any, transient: int | str) -> dict[str, Any]:
    if page not in (run.PAGE, sweep.PAGE):
        raise InputError("transient is for figures of sweeps that keep occurrences of events, and of sections of runs")
    return {"transient": Transient.of(transient)}


def _first_of(record: Any, beside: list[Any]) -> tuple[Any, list[Any], list[str]]:
    """Part several runs into the first one and those beside it, with the names that they were given."""
    if hasattr(record, "attrs"):
        return record, beside, []
    if isinstance(record, str) or not isinstance(record, Sequence | Mapping):
        check_dataset(record)
    names = [str(name) for name in record] if isinstance(record, Mapping) else []
    several = [*record.values()] if isinstance(record, Mapping) else [*record]
    if not several:
        raise InputError("plot got no record, needs one at least")
    if any(not hasattr(each, "attrs") for each in several):
        raise InputError(f"plot got {', '.join(type(each).__name__ for each in several)}, needs Datasets")
    if any(each.attrs.get(EVIDENCE) for each in several):
        kinds = dict.fromkeys(str(each.attrs.get(EVIDENCE, "run")) for each in several)
        if not names:
            raise InputError(f"several of {', '.join(kinds)} are drawn together by names, {{'name': record, …}}")
        return record, beside, []
    return several[0], [*several[1:], *beside], names if len(several) > 1 and not beside else []


def _computed(record: Any, wanted: Sequence[str] | None) -> Any:
    """Compute lazy evidence, once for all panels; of a run in chunks what is drawn, so that no chunk is read twice."""
    if not hasattr(record, "attrs"):
        return dict(zip(record, computed(*record.values()), strict=True))
    if record.attrs.get(EVIDENCE):
        return computed(record)[0]
    return drawn_of(record, wanted)


def _panels(page: Any, given: Any, transient: Any, others: Any, of_runs: dict[str, Any]) -> tuple[list[Panel], str]:
    """Return the panels of what is drawn, and what is said of those that are not."""
    left_out = {} if transient is None else _left_out(page, transient)
    if page is run.PAGE:
        return run.panels_and_rest(given, **of_runs, beside=others, **left_out)
    beside = {"beside": others} if page is enclosure.PAGE else {}
    return page.panels_of(given, **beside, **left_out), ""


def _check_axes(ax: Any, path: Any, size: Any) -> None:
    """Refuse what is no axes of a figure, and with axes what is of a figure that is made here."""
    if ax is not None and not hasattr(ax, "figure"):
        raise InputError(f"ax is {ax!r}, needs axes of matplotlib")
    if ax is not None and (path is not None or size is not None):
        raise InputError("path and size are of a figure that is made here, and ax is of one that is there; give one")


def _check(size: Any, dpi: Any) -> None:
    pair = (
        isinstance(size, tuple | list)
        and len(size) == 2
        and all(isinstance(length, int | float) and 1.0 <= length <= 100.0 for length in size)
    )
    if size is not None and not pair:
        raise InputError(f"size is {size!r}, needs width and height in inches, from 1 to 100, like (8, 5)")
    if isinstance(dpi, bool) or not isinstance(dpi, int) or not 20 <= dpi <= 1200:
        raise InputError(f"dpi is {dpi!r}, needs a whole number from 20 to 1200")
