"""A sheet of panels with a title and a foot, and the file that it goes to.

Legends and names of events, where nothing is drawn: in free places of the axes, or beside them.

A figure that a notebook shows, though pyplot knows nothing of it.
"""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from xdynamics.archive.folder_store import check_target, taking_name
from xdynamics.archive.store import Place
from xdynamics.faults import ArchiveError, InputError
from xdynamics.figures.marks import escaped_text, fold_power, typeset
from xdynamics.units import NUMBERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from xdynamics.figures.interactive import Interactive

Points = NDArray[np.float64]
Counts = NDArray[np.int64]

EVENT = "event"  # the mark of names that are placed here
CELL = 4.0  # pixels of the side of a cell, which is taken or free
REACH = 70.0  # pixels from a mark to its name
CROSSED = 6.0  # pixels further, that a name goes rather than lie on one more cell with a line
WIDER = 1.13  # that a text may be at another resolution, whose letters are rounded to whole pixels otherwise
FAINT = 0.1  # opacity up to which a patch is a background
MARK = np.array([[0, 0], [1, 1], [1, -1], [-1, 1], [-1, -1]]) * CELL  # pixels, that a marker takes
MOST_ABOVE = 4  # entries of a legend in the line of the title
AROUND = 4.8  # sizes of a letter, that the line before an entry and the room around it take
MOST_ROUNDS = 3  # of placing legends
FEWEST_LETTERS = 12  # of a line of a title
FAR = 1e4  # pixels, from where on nothing is seen


def place_legends_and_names(figure: Figure) -> None:
    """Move legends and the names of events into free places; a legend without one stands beside its axes.

    Names that nobody could read, since others lie there, are hidden: their marks stay.
    """
    panels = [axes for axes in figure.axes if axes.get_visible() and (axes.get_legend() or _event_texts(axes))]
    for axes in panels:
        for text in _event_texts(axes):
            text.set_in_layout(False)  # they find their places in the axes
    _compute_layout(figure)
    for _ in range(MOST_ROUNDS if panels else 0):
        moved_legends = [_is_beside(axes) for axes in panels]
        if not any(moved_legends):
            break
        _compute_layout(figure)  # the axes are smaller now, and legends inside of them lie elsewhere
    for _ in range(MOST_ROUNDS):
        folded = [_is_folded(axes) for axes in figure.axes if axes.get_visible()]  # each of them
        if not any(folded):
            break
        _compute_layout(figure)
    for axes in panels:
        if names := _event_texts(axes):
            _place_names(axes, names)


def _is_folded(axes: Axes) -> bool:
    """Break a title that would go beyond its part of the sheet into lines; return whether it did."""
    subplot_spec = axes.get_subplotspec()
    if (text := _title(axes)) is None or subplot_spec is None:
        return False
    subplot_spec = subplot_spec.get_topmost_subplotspec()  # of which these axes may be a part
    lines, left = text.get_text(), text.get_window_extent().x0
    title = lines.rstrip("\n").replace("\n", " ")
    below = "\n" * (len(lines) - len(lines.rstrip("\n")))  # room for what else is there
    room = axes.figure.bbox.width * subplot_spec.colspan.stop / subplot_spec.get_gridspec().ncols - CELL - left
    letters = len(title)
    while WIDER * text.get_window_extent().width > room and letters > FEWEST_LETTERS:
        letters = max(FEWEST_LETTERS, letters * 9 // 10)
        text.set_text("\n".join(wrap(title, letters, break_long_words=False)) + below)
    return letters < len(title)


def named_elsewhere(axes: Axes) -> set[str]:
    """Return what legends of other axes of a sheet name."""
    legends = [panel_axes.get_legend() for panel_axes in axes.figure.axes if panel_axes is not axes]
    return {text.get_text() for legend in legends if legend is not None for text in legend.get_texts()}


def _compute_layout(figure: Figure) -> None:
    """Give all axes their places, without the cost of drawing them."""
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    for axes in figure.axes:
        axes.apply_aspect()


def _event_texts(axes: Axes) -> list[Any]:
    return [text for text in axes.texts if text.get_gid() == EVENT]


@dataclass
class _OccupiedCells:
    """Which cells of some axes are taken.

    Attributes
    ----------
    x, y : float
        Pixels of its lower left corner.
    occupied : ndarray of bool, shape (rows, columns)
    """

    x: float
    y: float
    occupied: NDArray[np.bool_]

    @classmethod
    def of_axes(cls, axes: Axes) -> _OccupiedCells:
        """Return the ground of some axes with all that is drawn on it but their legend and names of events."""
        box = axes.bbox
        size = max(1, int(box.height / CELL)), max(1, int(box.width / CELL))
        ground = cls(box.x0, box.y0, np.zeros(size, bool))
        for line in axes.lines:
            points = line.get_transform().transform(np.asarray(line.get_xydata(), float))
            if line.get_linestyle() not in ("None", " ", ""):
                ground.mark_points(dense(points))
            for shift in MARK if line.get_marker() not in ("None", None, "", " ") else ():
                ground.mark_points(points + shift)
        for collection in axes.collections:
            ground.mark_collection(collection)
        for patch in axes.patches:
            if (patch.get_alpha() or 1.0) > FAINT:
                ground.mark_box(patch.get_window_extent())
        for text in axes.texts:
            if text.get_gid() != EVENT and text.get_visible():
                ground.mark_box(text.get_window_extent())
        if axes.images:
            ground.occupied[:] = True
        return ground

    def mark_points(self, points: Points) -> None:
        """Take the cells of points."""
        points = points[np.isfinite(points).all(axis=-1)]
        columns, rows = ((points - (self.x, self.y)) / CELL).astype(int).T if len(points) else np.zeros((2, 0), int)
        is_inside = (rows >= 0) & (columns >= 0) & (rows < self.occupied.shape[0]) & (columns < self.occupied.shape[1])
        self.occupied[rows[is_inside], columns[is_inside]] = True

    def mark_box(self, box: Any) -> None:
        """Take the cells of a box in pixels."""
        left, right = (int(max(0.0, (edge - self.x) / CELL)) for edge in (box.x0, box.x1))
        low, high = (int(max(0.0, (edge - self.y) / CELL)) for edge in (box.y0, box.y1))
        self.occupied[low : high + 1, left : right + 1] = True

    def mark_collection(self, collection: Any) -> None:
        """Take what a collection draws: a mesh everything, an area its columns, needles and points themselves."""
        kind = type(collection).__name__
        if kind == "QuadMesh":
            self.occupied[:] = True
            return
        if kind == "PathCollection":
            self.mark_points(
                collection.get_offset_transform().transform(np.ma.filled(collection.get_offsets(), np.nan))
            )
            return
        for path in collection.get_paths():
            if not len(path.vertices):
                continue
            points = dense(collection.get_transform().transform(path.vertices))
            self.mark_points(points)
            if kind in ("PolyCollection", "FillBetweenPolyCollection"):
                column = ((points[:, 0] - self.x) / CELL).astype(int)
                for cell_column in np.unique(column):
                    edges = points[column == cell_column, 1]
                    middle = self.x + (cell_column + 0.5) * CELL
                    heights = np.arange(edges.min(), edges.max(), CELL)
                    self.mark_points(np.stack([np.full(heights.size, middle), heights], axis=-1))

    def occupied_counts(self, width: float, height: float) -> Counts:
        """Return how many cells are taken under a box in pixels, for each place of its lower left cell."""
        rows, columns = int(np.ceil(height / CELL)) + 1, int(np.ceil(width / CELL)) + 1
        if rows > self.occupied.shape[0] or columns > self.occupied.shape[1]:
            return np.zeros((0, 0), np.int64)
        # a summed-area table: four numbers of it give the count in a box of any size
        sums = np.pad(self.occupied.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
        box_counts: Counts = (
            sums[rows:, columns:] - sums[:-rows, columns:] - sums[rows:, :-columns] + sums[:-rows, :-columns]
        )
        return box_counts


def dense(points: Points) -> Points:
    """Return points along lines, so near that no cell between two of them is missed."""
    points = np.clip(points, -FAR, FAR)
    if len(points) < 2:
        return points
    steps = np.diff(points, axis=0)
    lengths = np.hypot(*steps.T)
    counts = np.where(np.isfinite(lengths), np.ceil(lengths / CELL * 1.5), 0.0).astype(np.int64) + 1
    segment = np.repeat(np.arange(len(steps)), counts)
    part = (np.arange(segment.size) - (np.cumsum(counts) - counts)[segment]) / counts[segment]
    return np.concatenate([points[segment] + part[:, None] * steps[segment], points[-1:]])


def _is_beside(axes: Axes) -> bool:
    """Place the legend of some axes; return whether it went beside or above them, which may make them smaller."""
    legend = axes.get_legend()
    if legend is None or (box := legend.get_window_extent()).x0 >= axes.bbox.x1 - CELL:
        return False
    if box.y0 >= axes.bbox.y1:  # in the line of the title, which is shorter now
        if box.x0 < _end_of_title(axes):
            _stand_beside(axes, _in_columns(axes, legend, 1))
        return bool(box.x0 < _end_of_title(axes))
    ground = _OccupiedCells.of_axes(axes)
    free = np.argwhere(ground.occupied_counts(box.width + CELL, box.height + CELL) == 0)
    legend.borderaxespad = 0.0
    if not len(free):
        if not _is_above(axes, legend):
            _stand_beside(axes, legend)
        return True
    # the corner it is nearest to, the upper right one first
    from_corner = np.minimum(free, free.max(axis=0) - free).sum(axis=-1) + 1e-3 * (free.max(axis=0) - free).sum(axis=-1)
    row, column = free[int(np.argmin(from_corner))]
    x, y = (column + 0.5) * CELL / axes.bbox.width, (row + 0.5) * CELL / axes.bbox.height
    legend.set_loc("lower left")
    legend.set_bbox_to_anchor((x, y), transform=axes.transAxes)
    return False


def _stand_beside(axes: Axes, legend: Any) -> None:
    """Put a legend at the right of its axes and of what is drawn beside them."""
    insets = [inset.get_tightbbox() for inset in axes.child_axes]
    right = max([axes.bbox.x1, *(inset.x1 for inset in insets if inset is not None)])
    legend.set_loc("upper left")
    legend.set_bbox_to_anchor(((right - axes.bbox.x0) / axes.bbox.width + 0.02, 1.0), transform=axes.transAxes)


def _is_above(axes: Axes, legend: Any) -> bool:
    """Put a legend of few entries into the line of the title, behind it, if there is room; return whether there was."""
    texts = legend.get_texts()
    if not 0 < len(texts) <= MOST_ABOVE:
        return False
    letter = texts[0].get_fontsize() * axes.figure.dpi / 72.0
    width = sum(WIDER * text.get_window_extent().width + AROUND * letter for text in texts)
    if _end_of_title(axes) + width > axes.bbox.x1:
        return False
    above = _in_columns(axes, legend, len(texts))
    above.set_loc("lower right")
    above.set_bbox_to_anchor((1.0, 1.0), transform=axes.transAxes)
    return True


def _in_columns(axes: Axes, legend: Any, columns: int) -> Any:
    """Return a legend again, with its entries in columns."""
    names = [text.get_text() for text in legend.get_texts()]
    return axes.legend(legend.legend_handles, names, ncols=columns, fontsize=8, frameon=False, borderaxespad=0.0)


def _end_of_title(axes: Axes) -> float:
    """Return where, in pixels, the title of some axes ends, with a space behind it."""
    title = _title(axes)
    return float(axes.bbox.x0 if title is None else max(title.get_window_extent().x1, axes.bbox.x0)) + 2.0 * CELL


def _title(axes: Axes) -> Any:
    """Return the text of the title of some axes; None if they have none."""
    from matplotlib.text import Text

    title = axes.get_title(loc="left")
    return next((text for text in axes.findobj(Text) if title and text.get_text() == title), None)


def _place_names(axes: Axes, names: list[Any]) -> None:
    """Put each name into the free place nearest to its mark; across as few lines as possible if there is none."""
    ground = _OccupiedCells.of_axes(axes)
    text_cells = _OccupiedCells(ground.x, ground.y, np.zeros_like(ground.occupied))
    for text in axes.texts:
        if text.get_gid() != EVENT and text.get_visible():
            text_cells.mark_box(text.get_window_extent())
    if (legend := axes.get_legend()) is not None:
        for cells in (ground, text_cells):
            cells.mark_box(legend.get_window_extent())
    scale = axes.figure.dpi / 72.0
    for name in sorted(names, key=lambda text: axes.transData.transform(text.xy)[0]):
        box, mark = name.get_window_extent(), axes.transData.transform(name.xy)
        width = WIDER * box.width
        crossed, hidden = (cells.occupied_counts(width, box.height) for cells in (ground, text_cells))
        left = ground.x + CELL * np.arange(crossed.shape[1])
        low = ground.y + CELL * np.arange(crossed.shape[0])
        across = np.maximum(0.0, np.maximum(left - mark[0], mark[0] - left - width))
        up = np.maximum(0.0, np.maximum(low - mark[1], mark[1] - low - box.height))
        distances = np.hypot(across[None, :], up[:, None])
        costs = np.where((hidden == 0) & (distances < REACH), distances + CROSSED * crossed, np.inf)
        if not costs.size or not np.isfinite(costs.min()):
            name.set_visible(False)
            continue
        row, column = np.unravel_index(int(np.argmin(costs)), costs.shape)
        x, y = float(left[column]) + CELL / 2, float(low[row]) + CELL / 2
        name.set(ha="left", va="bottom", position=((x - mark[0]) / scale, (y - mark[1]) / scale))
        for cells in (ground, text_cells):
            cells.mark_box(name.get_window_extent().expanded(2.0 * WIDER - 1.0, 1.0))


NOTEBOOK_DPI = 100  # of a picture in a notebook


class Picture(Figure):
    """A figure of matplotlib that shows itself as the last line of a cell.

    Attributes
    ----------
    title, about : str
        What is drawn, and the digests of it, for the metadata of a file.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.title, self.about = "", ""
        FigureCanvasAgg(self)  # a canvas without a kind looks for a renderer anew for the size of every text

    def _repr_png_(self) -> bytes:
        png_buffer = BytesIO()
        with self.as_laid_out():
            self.savefig(png_buffer, format="png", dpi=NOTEBOOK_DPI)
        return png_buffer.getvalue()

    @contextmanager
    def as_laid_out(self) -> Iterator[None]:
        """Keep all axes where they are, unless the figure was changed: names were placed there.

        Another layout would cost as much as the drawing; with an engine that does nothing matplotlib draws twice.
        """
        if self.stale:
            yield
            return
        engine = self.get_layout_engine()
        with rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
            self.set_layout_engine(None)
        try:
            yield
        finally:
            self.set_layout_engine(engine)
            self.stale = False

    def interactive(self) -> Interactive:
        """Return the figure as one that can be zoomed and asked for values, in a notebook or as a page; it needs plotly."""
        from xdynamics.figures.interactive import interactive_figure

        with self.as_laid_out():
            self.draw_without_rendering()
        return interactive_figure(self)


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
    typeset_labels(figure.axes)
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
    typeset_labels([axes])


def _style_axes(axes: Axes) -> None:
    from matplotlib import rcParams

    axes.grid(color=rcParams["grid.color"], linewidth=0.6)
    axes.spines[["top", "right"]].set_visible(False)


def typeset_labels(row: Sequence[Axes]) -> None:
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
        figure.savefig(image_buffer, format=ending[1:], dpi=dpi, metadata=_metadata(figure, ending))
    with temporary_file("figure", path) as part:
        part.write_bytes(image_buffer.getvalue())


def _metadata(figure: Picture, ending: str) -> dict[str, str | None]:
    """Return what a file says of itself: what is drawn, and its digests; no dates, so that the same is the same file."""
    about_key = {".pdf": "Subject"}.get(ending, "Description")
    dates = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}.get(ending, {})
    return {"Title": figure.title, about_key: figure.about} | dates


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
