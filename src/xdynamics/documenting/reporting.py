"""The last stage of a pipeline: records into a folder, each with its figure and its summary in words.

A report can be one file, HTML or PDF: the title, the figure and the summary of each record.
"""

from __future__ import annotations

import base64
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

from xdynamics import archive
from xdynamics.archive.folder_store import check_target, made_folder, taking_name
from xdynamics.archive.store import Given, Place, check_file_name, location_of
from xdynamics.documenting.equations import plain_markdown
from xdynamics.documenting.summary import summary
from xdynamics.evidence.cluster import Tell, connected
from xdynamics.evidence.stages import compute_datasets
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.figures import plot
from xdynamics.record.arguments import is_unmarched
from xdynamics.schema import EVIDENCE

if TYPE_CHECKING:
    import xarray as xr

HTML, PDF = ".html", ".pdf"
ENDINGS = (HTML, PDF)
A4 = (8.27, 11.69)  # inches
MARGIN, LINE, LETTERS = 0.6, 0.145, 121  # inches, inches of a line of text, letters in it
DPI = 200  # of figures on paper
STYLE = (
    "body{font:16px/1.5 system-ui,sans-serif;max-width:62rem;margin:2rem auto;padding:0 1rem;color:#1a1a1a}"
    "img{max-width:100%}pre{font-size:13px;overflow-x:auto;background:#f6f6f4;padding:.8rem}h1,h2{font-weight:600}"
)


def is_page(path: Place) -> bool:
    """Whether a report is to be one file, by its suffix."""
    return path.suffix.lower() in ENDINGS


def write_page(path: Place, records: Mapping[str, Any]) -> str:
    """Write a page, and return its words.

    Raises
    ------
    ArchiveError
        If the file cannot be written.
    """
    parts = {name: (_figure(record), _record_lines(record)) for name, record in records.items()}
    content = _html(parts) if path.suffix.lower() == HTML else _pdf(parts)
    with taking_name(path) as temporary:
        temporary.part.write_bytes(content)
    return "\n".join(f"## {name.replace('_', ' ')}\n\n" + "\n".join(lines) + "\n" for name, (_, lines) in parts.items())


def _record_lines(record: xr.Dataset | dict[str, xr.Dataset]) -> list[str]:
    """Return the summary of a record, or of several by name, with its digest."""
    if isinstance(record, dict):
        return [line for name, entry in record.items() for line in (f"{name}:", *_record_lines(entry), "")]
    return [*summary(record), f"digest    {archive.content_digest(record)}"]


def _figure(record: Any) -> Any:
    """Draw a record; None if there is nothing to draw."""
    try:
        return plot(record)
    except InputError:
        return None


def _figure_png(figure: Any) -> bytes:
    png_buffer = BytesIO()
    with figure.as_laid_out():
        figure.savefig(png_buffer, format="png", dpi=DPI, metadata={"Software": None})
    return png_buffer.getvalue()


def _html(parts: Mapping[str, tuple[Any, list[str]]]) -> bytes:
    """Return a page that needs no other file."""
    body = []
    for name, (figure, lines) in parts.items():
        picture = base64.b64encode(_figure_png(figure)).decode("ascii") if figure is not None else ""
        image = f'<img alt="{escape(name)}" src="data:image/png;base64,{picture}">' if picture else ""
        text = escape("\n".join(lines[1:]))
        body.append(f"<h2>{escape(lines[0])}</h2>{image}<pre>{text}</pre>")
    title = escape(", ".join(name.replace("_", " ") for name in parts))
    page = (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title><style>{STYLE}</style></head>'
        f"<body>{''.join(body)}</body></html>\n"
    )
    return page.encode()


def _pdf(parts: Mapping[str, tuple[Any, list[str]]]) -> bytes:
    """Return pages of paper: a record begins a page, with its figure above its summary."""
    from matplotlib.backends.backend_pdf import PdfPages
    from matplotlib.figure import Figure
    from matplotlib.image import imread

    pdf_buffer = BytesIO()
    with PdfPages(pdf_buffer, metadata={"CreationDate": None, "Producer": None, "Creator": "xdynamics"}) as pages:
        for figure, lines in parts.values():
            rows = [part for line in lines for part in _wrapped_line(line)]
            top = A4[1] - MARGIN
            page = Figure(figsize=A4)
            if figure is not None:
                picture = imread(BytesIO(_figure_png(figure)), format="png")
                width = A4[0] - 2.0 * MARGIN
                height = min(width * picture.shape[0] / picture.shape[1], 0.62 * A4[1])
                axes = page.add_axes((MARGIN / A4[0], (top - height) / A4[1], width / A4[0], height / A4[1]))
                axes.imshow(picture, aspect="equal")
                axes.set_axis_off()
                top -= height + 2.0 * LINE
            while rows:
                count = max(1, int((top - MARGIN) / LINE))
                for k, row in enumerate(rows[:count]):
                    page.text(
                        MARGIN / A4[0],
                        (top - k * LINE) / A4[1],
                        row,
                        family="monospace",
                        fontsize=7,
                        va="top",
                        parse_math=False,
                    )
                pages.savefig(page)
                rows, top, page = rows[count:], A4[1] - MARGIN, Figure(figsize=A4)
    return pdf_buffer.getvalue()


def _wrapped_line(line: str) -> list[str]:
    import textwrap

    return textwrap.wrap(line, LETTERS, subsequent_indent=" " * 10, drop_whitespace=False) or [""]


if TYPE_CHECKING:
    import xarray as xr

    Record = xr.Dataset | dict[str, xr.Dataset]

PAGE = "report.md"
WIDTH = 40  # letters of a bar of progress, as dask draws it


def report(folder: Given, **records: xr.Dataset | dict[str, xr.Dataset]) -> str:
    """Leave records in a folder: an archive each, a figure each, and one page of words.

    Stages that are not computed yet are computed first, all in one graph, so that what several need is marched once.

    Parameters
    ----------
    folder : str or Path
        Made where it is not there; or ``"s3://bucket/results"``. A name that ends in ``.html`` or ``.pdf`` is that of one
        page, which needs no other file, and no archives are written.
    **records : xarray.Dataset, or dict of str to xarray.Dataset
        Runs and evidence by name, lazy or not; several by name are drawn together where they are refinements or
        diagnoses.

    Returns
    -------
    str
        The page, `report.md` in a folder: of each record its title, figure, summary, and the digest of its archive.

    Raises
    ------
    InputError
        If a name is none for a file, or a record is neither run nor evidence. If a stage cannot be computed: it is
        named with its reason, here and on the page, which has all others.
    """
    if not records:
        raise InputError("report needs at least one record, like report('results', run=run)")
    for name, entry in records.items():
        entry_records = entry.values() if isinstance(entry, dict) else [entry]
        if not entry_records or not all(hasattr(record, "attrs") for record in entry_records):
            raise InputError(f"'{name}' is {str(entry)[:40]!r}, needs a run, evidence, or several of them by name")
        for file_name in [name, *(f"{name}_{key}" for key in (entry if isinstance(entry, dict) else ()))]:
            check_file_name(file_name)
    is_single_page = is_page(location_of(folder))
    if is_single_page:
        check_target(location_of(folder))
    target = location_of(folder) if is_single_page else made_folder(location_of(folder))
    computed_records, faults = _compute_records(records)
    if is_single_page:
        if faults:
            failures = [f"stage '{name}' failed: {fault}" for name, fault in faults.items()]
            raise InputError(f"'{target}' is not written:{numbered_lines(failures)}", tuple(failures))
        return write_page(target, computed_records)
    return _write_folder(target, computed_records, faults)


def _write_folder(target: Place, computed_records: Mapping[str, Record], faults: dict[str, str]) -> str:
    """Write the archives, figures and the page of a folder."""
    lines: list[str] = []
    for name, entry in computed_records.items():
        try:
            lines += _page_of(target, name, entry)
        except ArchiveError:
            raise  # of the folder: the others cannot be written either
        except InputError as error:
            faults[name] = str(error)
    words = "\n".join(lines)
    words += "".join(f"\n## {name}\n\nfailed    {fault}\n" for name, fault in faults.items())
    with taking_name(target / PAGE) as temporary:
        temporary.part.write_text(words + "\n")
    if faults:
        failures = [f"stage '{name}' failed: {fault}" for name, fault in faults.items()]
        raise InputError(
            f"'{target / PAGE}' has all but {len(faults)} of the stages:{numbered_lines(failures)}", tuple(failures)
        )
    return words


def _compute_records(records: Mapping[str, Record]) -> tuple[dict[str, Record], dict[str, str]]:
    """Compute lazy stages in one graph; return all that could be computed, and the faults of the others by name."""
    places = [(name, key) for name, entry in records.items() for key in (entry if isinstance(entry, dict) else [""])]
    stages = [entry[key] if isinstance(entry := records[name], dict) else entry for name, key in places]
    faults: dict[str, str] = {}
    with _progress() as tell:
        try:
            results: list[xr.Dataset | None] = _computed_stages(stages, tell)
        except Exception:  # noqa: BLE001 - of any stage: the others are computed by themselves, what was marched is remembered
            results = []
            for (name, key), stage in zip(places, stages, strict=True):
                try:
                    results += _computed_stages([stage], tell)
                except Exception as error:  # noqa: BLE001 - as above
                    results.append(None)
                    faults[" ".join(filter(None, (name, key)))] = str(error) or type(error).__name__
    computed_records: dict[str, Record] = {}
    for (name, key), result in zip(places, results, strict=True):
        if result is not None and isinstance(records[name], dict):
            named_records = computed_records.setdefault(name, {})
            assert isinstance(named_records, dict)  # noqa: S101
            named_records[key] = result
        elif result is not None:
            computed_records[name] = result
    return computed_records, faults


def _computed_stages(records: Sequence[xr.Dataset], tell: Tell | None) -> list[xr.Dataset | None]:
    """Compute stages in one graph; a run in chunks of a file stays as it is, to be drawn and written chunk by chunk."""
    lazy_stages = [record for record in records if EVIDENCE in record.attrs or is_unmarched(record)]
    results = iter(compute_datasets(*lazy_stages, tell=tell))
    return [next(results) if EVIDENCE in record.attrs or is_unmarched(record) else record for record in records]


@contextmanager
def _progress() -> Iterator[Tell | None]:
    """Show the progress of a graph on a terminal after one second; yield a function for events of a cluster."""
    if "dask" not in sys.modules or not sys.stderr.isatty():
        yield None
        return
    if connected() is None:
        from dask.diagnostics import progress

        bar: Any = progress.ProgressBar  # it is not typed
        with bar(minimum=1.0, out=sys.stderr):
            yield None
        return
    try:
        yield _draw_progress_bar
    finally:
        sys.stderr.write("\r\033[K")


def _draw_progress_bar(done_share: float, _time: float, count: int) -> None:
    """Draw a bar over the last one; dask's own sees graphs of this process alone."""
    sys.stderr.write(f"\r\033[K[{'#' * int(WIDTH * done_share):{WIDTH}}] | {done_share:.0%} | {count} tasks done")
    sys.stderr.flush()


def _page_of(folder: Place, name: str, record: xr.Dataset | dict[str, xr.Dataset]) -> Iterator[str]:
    """Archive and draw one record, or several by name, and summarise them."""
    datasets = (
        {f"{name}_{key}": dataset for key, dataset in record.items()} if isinstance(record, dict) else {name: record}
    )
    yield from (f"## {plain_markdown(name.replace('_', ' '))}", "")
    if figure := _draw_figure(folder, name, record):
        yield from (f"![{plain_markdown(name)}]({figure})", "")
    for key, dataset in datasets.items():
        path = archive.save(dataset, folder / f"{key}.nc")
        yield from ("```", *summary(dataset), f"archive   {path.name}, {archive.verify(path).digest}", "```", "")


def _draw_figure(folder: Place, name: str, record: xr.Dataset | dict[str, xr.Dataset]) -> str:
    """Draw a record, and return the figure's name; empty if there is nothing to draw."""
    try:
        plot(record, folder / f"{name}.png")
    except InputError:
        return ""
    return f"{name}.png"
