"""A report as one file: of each record its title, its figure and its summary, as HTML or PDF."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Any

from xdynamics import archive
from xdynamics.archive.place import Place
from xdynamics.archive.stores import taking_name
from xdynamics.documenting.summary import summary
from xdynamics.faults import InputError
from xdynamics.figures import plot

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
    """Whether a report is asked for as one file."""
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
