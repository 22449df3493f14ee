"""A sheet of panels with a title and a foot, and the file that it goes to."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.place import Place
from xdynamics.archive.stores import check_target, taking_name
from xdynamics.faults import ArchiveError, InputError
from xdynamics.figures.marks import escaped_text, typeset
from xdynamics.figures.placing import place_legends_and_names
from xdynamics.figures.powers import fold_power
from xdynamics.units import NUMBERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from xdynamics.figures.picture import Picture

Panel = Callable[["Axes"], None]

PAGE = ".html"  # of an interactive figure
FORMATS = (".png", ".svg", ".pdf", PAGE)
WIDTH, MOST_LINES = 170, 3  # of the text below
HEIGHT = 2.9  # inches
LEAST = (2.4, 1.6)  # inches of a panel, with its labels
DPI = 130
LIGHT: Any = {"grid.color": "#e3e3e3"}
DARK: Any = {
    "figure.facecolor": "#16181d",
    "axes.facecolor": "#16181d",
    "savefig.facecolor": "#16181d",
    "grid.color": "#3a3f4a",
    "text.color": "#e8e8e8",
    "axes.labelcolor": "#e8e8e8",
    "axes.edgecolor": "#9aa0ac",
    "xtick.color": "#cfd3da",
    "ytick.color": "#cfd3da",
}
_BEHIND = re.compile(r" ?\(([^()]*)\)$")  # the unit after a label


@dataclass(frozen=True)
class Page:
    """How records of some kinds are drawn.

    Attributes
    ----------
    kinds : tuple of str
        Of evidence, as its attribute names them.
    panels_of, foot_of : callable
        The panels of a record, and the text below them.
    most_panels : int
        More are left out.
    height, single_height : float
        Inches of a panel, and of one that is alone on its sheet, if that has more.
    """

    kinds: tuple[str, ...]
    panels_of: Callable[..., list[Panel]]
    foot_of: Callable[..., str]
    most_panels: int = 1 << 10
    height: float = HEIGHT
    single_height: float = 0.0

    def panel_height(self, panels: int) -> float:
        """Return the height of each of so many panels."""
        return max(self.height, self.single_height) if panels == 1 else self.height


def sheet(
    panels: Sequence[Panel], title: str, foot: str, height: float = HEIGHT, size: tuple[float, float] | None = None
) -> Picture:
    """Draw panels in reading order in two columns, a single one across both; each of a height in inches, or all of a size.

    Raises
    ------
    InputError
        If a given size leaves too little room for each panel.
    """
    from xdynamics.figures.picture import Picture

    columns = min(2, len(panels))
    rows = (len(panels) + 1) // 2
    if size is not None and (size[0] / columns < LEAST[0] or size[1] / rows < LEAST[1]):
        raise InputError(
            f"size {size[0]:g}x{size[1]:g} leaves {size[0] / columns:.2g} by {size[1] / rows:.2g} inches for each of"
            f" {len(panels)} panels, needs {LEAST[0]:g} by {LEAST[1]:g}; draw fewer with only, or give more room"
        )
    figure = Picture(figsize=size or (11, height * rows + 0.7), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for axes, draw in zip(grid.flat, panels, strict=False):
        _style_axes(axes)
        draw(axes)
    _typeset_labels(figure.axes)
    figure.suptitle(escaped_text(title), x=0.01, ha="left", fontsize=13)
    lines = textwrap.wrap(escaped_text(foot), WIDTH, max_lines=MOST_LINES, placeholder=" …")
    figure.supxlabel("\n".join(lines), fontsize=8, alpha=0.7, x=0.01, ha="left")
    place_legends_and_names(figure)
    figure.stale = False  # until somebody changes it
    return figure


def on_axes(axes: Axes, draw: Panel) -> None:
    """Draw a panel on axes of a figure that is another's."""
    _style_axes(axes)
    draw(axes)
    _typeset_labels([axes])


def _style_axes(axes: Axes) -> None:
    from matplotlib import rcParams

    axes.grid(color=rcParams["grid.color"], linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def _typeset_labels(row: Sequence[Axes]) -> None:
    """Typeset the units of labels, and put powers of ten beside them."""
    panels: list[Any] = [part for axes in row for part in (axes, *axes.child_axes) if part.name != "3d"]
    for axis in (axis for part in panels for axis in (part.xaxis, part.yaxis)):
        axis.set_label_text(_BEHIND.sub(_typeset_unit, axis.get_label_text()))
        fold_power(axis)


def _typeset_unit(match: re.Match[str]) -> str:
    """Return the unit after a label as it is typeset; nothing for a pure number."""
    return "" if match[1] == NUMBERS.text else f" ({typeset(match[1])})"


@contextmanager
def background_style(*, dark: bool) -> Iterator[None]:
    """Draw on a white or on a dark background."""
    from matplotlib import rc_context

    with rc_context(DARK if dark else LIGHT):
        yield


def write_figure(figure: Picture, path: Place, dpi: int = DPI) -> None:
    """Write a figure whole, or not at all."""
    ending = path.suffix.lower()
    if ending == PAGE:
        page = figure.interactive().html()
        with temporary_file("figure", path) as part:
            part.write_text(page, encoding="utf-8")
        return
    image_buffer = BytesIO()
    with figure.as_laid_out():
        figure.savefig(image_buffer, format=ending[1:], dpi=dpi, metadata={"Date": None} if ending == ".svg" else None)
    with temporary_file("figure", path) as part:
        part.write_bytes(image_buffer.getvalue())


@contextmanager
def temporary_file(file_kind: str, path: Place) -> Iterator[Path]:
    """Lend a temporary path to write to; the file then takes its final name whole, or not at all.

    Raises
    ------
    ArchiveError
        If the file cannot be written there.
    """
    try:
        with taking_name(path) as target:
            yield target.part
    except ArchiveError as error:
        raise ArchiveError(f"{file_kind} {error}") from None


def check_path(path: Place, formats: Sequence[str] = FORMATS, file_kind: str = "figure") -> None:
    """Check before drawing that a file can be written.

    Raises
    ------
    InputError
        If the file's ending is unknown, or its path cannot be written.
    """
    if path.suffix.lower() not in formats:
        raise InputError(f"{file_kind} '{path}' has the ending '{path.suffix}'; there are {', '.join(formats)}")
    try:
        check_target(path)
    except InputError as error:
        raise InputError(f"{file_kind} {error}") from None
