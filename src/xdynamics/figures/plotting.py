"""Which sheet is drawn of which record."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, cast

from xdynamics.archive import check_states, without_stale_units
from xdynamics.archive.content import content_digest
from xdynamics.archive.store import GIVEN, Given, location_of
from xdynamics.evidence.grid_axes import is_sweep, sweep_of
from xdynamics.evidence.stages import compute_datasets
from xdynamics.faults import InputError
from xdynamics.figures import comparison, element_maps, ledger, refinement, run, sweep
from xdynamics.figures.excerpt import excerpt_of
from xdynamics.figures.sheet import DPI, Panel, background_style, check_path, on_axes, sheet, write_figure
from xdynamics.figures.transients import Transient
from xdynamics.record import of_elements
from xdynamics.record.folding import model_dimensions
from xdynamics.record.run_dataset import check_dataset
from xdynamics.record.schemas import with_article
from xdynamics.record.unfolding import unfold
from xdynamics.schema import EVIDENCE, ROOT_DIGEST

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.figures.sheet import Picture

PAGES = {
    kind: page
    for module in (comparison, element_maps, ledger, refinement, sweep)
    for page in module.PAGES
    for kind in page.kinds
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
        check_path(location_of(path))
    requested_names = [only] if isinstance(only, str) else only
    companions = (
        [beside] if isinstance(beside, GIVEN) or hasattr(beside, "attrs") or hasattr(beside, "columns") else [*beside]
    )
    subject, companions, names = _split_first_record(record, companions)
    sources = [subject, *companions]
    subject, *companions = [
        _record_to_draw(source) if hasattr(source, "data_vars") else source for source in (subject, *companions)
    ]
    subject = _computed_record(subject, requested_names)
    if hasattr(subject, "attrs"):
        kind = str(subject.attrs.get(EVIDENCE, ""))
        if kind and kind not in PAGES:
            raise InputError(f"there is no figure of {with_article(kind)}; `xdynamics show` prints what it found")
        page, title = PAGES.get(kind, run.PAGE), str(subject.attrs.get("title", "run"))
        if page is run.PAGE and companions:
            title = title.removesuffix(f", by {subject.attrs.get('solver_method')}")
    else:
        page, title = refinement.JOINT_PAGE, f"{', '.join(subject)}, side by side"
    if page is not run.PAGE and (
        only is not None or panels != run.FEW or (companions and page is not comparison.TUBE_PAGE)
    ):
        raise InputError("only, panels and beside are for figures of a run, beside for those of proven bounds too")
    if panels not in run.AMOUNTS:
        raise InputError(f"panels is {panels!r}; there are {', '.join(run.AMOUNTS)}")
    _check_size_and_dpi(size, dpi)
    drawn_panels, omission_note = _panels_of_page(
        page, subject, transient, companions, {"only": requested_names, "amount": panels, "names": names}
    )
    foot = "; ".join(filter(None, (page.foot_of(subject), omission_note)))
    if not drawn_panels:
        raise InputError(_nothing_drawn(title))
    if ax is not None:
        with background_style(dark=dark):
            on_axes(ax, drawn_panels[0])
        return cast("Picture", ax.figure)
    if len(drawn_panels) > page.most_panels:
        foot = f"the first {page.most_panels} of {len(drawn_panels)} panels; {foot}"
        drawn_panels = drawn_panels[: page.most_panels]
    with background_style(dark=dark):
        figure = sheet(drawn_panels, title, foot, page.panel_height(len(drawn_panels)), size)
        if path is not None:
            figure.title, figure.about = title, _digests_text(sources)
            write_figure(figure, location_of(path), dpi)
    return figure


def _digests_text(records: Iterable[Any]) -> str:
    """Return the digests of what is drawn, each that an archive of it has or would have; of what is lazy none."""
    digests = []
    for record in filter(lambda record: hasattr(record, "data_vars"), records):
        lazy = any(variable.chunks is not None for variable in record.variables.values())
        digest = record.attrs.get(ROOT_DIGEST) or ("" if lazy else content_digest(record))
        digests += [f"{record.attrs.get('title', 'a record')}: {ROOT_DIGEST} {digest}"] if digest else []
    return "; ".join(dict.fromkeys(digests))


def _record_to_draw(record: xr.Dataset) -> xr.Dataset:
    """Return a record by its elements, without units that edits made wrong; a run whose motion was edited is refused."""
    if is_sweep(record):
        record = sweep_of(record)
    if not record.attrs.get(EVIDENCE):
        check_states(record)
    record = without_stale_units(record)
    return unfold(record) if model_dimensions(record) else record


def _transient_option(page: Any, transient: int | str) -> dict[str, Any]:
    if page not in (run.PAGE, sweep.PAGE):
        raise InputError("transient is for figures of sweeps that keep occurrences of events, and of sections of runs")
    return {"transient": Transient.from_argument(transient)}


def _split_first_record(record: Any, companions: list[Any]) -> tuple[Any, list[Any], list[str]]:
    """Part several runs into the first one and those beside it, with the names that they were given."""
    if hasattr(record, "attrs"):
        return record, companions, []
    if isinstance(record, str) or not isinstance(record, Sequence | Mapping):
        check_dataset(record)
    names = [str(name) for name in record] if isinstance(record, Mapping) else []
    records = [*record.values()] if isinstance(record, Mapping) else [*record]
    if not records:
        raise InputError("plot got no record, needs one at least")
    if any(not hasattr(entry, "attrs") for entry in records):
        raise InputError(f"plot got {', '.join(type(entry).__name__ for entry in records)}, needs Datasets")
    if any(entry.attrs.get(EVIDENCE) for entry in records):
        kinds = dict.fromkeys(str(entry.attrs.get(EVIDENCE, "run")) for entry in records)
        if not names:
            raise InputError(f"several of {', '.join(kinds)} are drawn together by names, {{'name': record, …}}")
        return record, companions, []
    return records[0], [*records[1:], *companions], names if len(records) > 1 and not companions else []


def _computed_record(record: Any, requested_names: Sequence[str] | None) -> Any:
    """Compute lazy evidence, once for all panels; of a run in chunks what is drawn, so that no chunk is read twice."""
    if not hasattr(record, "attrs"):
        return dict(zip(record, compute_datasets(*record.values()), strict=True))
    if record.attrs.get(EVIDENCE):
        return compute_datasets(record)[0]
    return excerpt_of(record, requested_names)


def _panels_of_page(
    page: Any, record: Any, transient: Any, companions: Any, of_runs: dict[str, Any]
) -> tuple[list[Panel], str]:
    """Return the panels of what is drawn, and what is said of those that are not."""
    left_out = {} if transient is None else _transient_option(page, transient)
    if page is run.PAGE:
        return run.panels_and_omissions(record, **of_runs, beside=companions, **left_out)
    enclosed_runs = {"beside": companions} if page is comparison.TUBE_PAGE else {}
    try:
        return page.panels_of(record, **enclosed_runs, **left_out), ""
    except KeyError as error:  # of a part of it
        raise InputError(_nothing_drawn(record.attrs.get("title"))) from error


def _nothing_drawn(title: object) -> str:
    return f"'{title}' has nothing that is drawn of it; give it whole, as it was made"


def _check_axes(ax: Any, path: Any, size: Any) -> None:
    """Refuse what is no axes of a figure, and with axes what is of a figure that is made here."""
    if ax is not None and not hasattr(ax, "figure"):
        raise InputError(f"ax is {ax!r}, needs axes of matplotlib")
    if ax is not None and (path is not None or size is not None):
        raise InputError("path and size are of a figure that is made here, and ax is of one that is there; give one")


def _check_size_and_dpi(size: Any, dpi: Any) -> None:
    pair = (
        isinstance(size, tuple | list)
        and len(size) == 2
        and all(isinstance(length, int | float) and 1.0 <= length <= 100.0 for length in size)
    )
    if size is not None and not pair:
        raise InputError(f"size is {size!r}, needs width and height in inches, from 1 to 100, like (8, 5)")
    if isinstance(dpi, bool) or not isinstance(dpi, int) or not 20 <= dpi <= 1200:
        raise InputError(f"dpi is {dpi!r}, needs a whole number from 20 to 1200")
