"""Legends and names of events, where nothing is drawn: in free places of the axes, or beside them."""

from __future__ import annotations

from dataclasses import dataclass
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
