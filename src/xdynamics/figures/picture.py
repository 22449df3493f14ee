"""A figure that a notebook shows, though pyplot knows nothing of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from typing import TYPE_CHECKING, Any

from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

if TYPE_CHECKING:
    from xdynamics.figures.interactive import Interactive

NOTEBOOK_DPI = 100  # of a picture in a notebook


class Picture(Figure):
    """A figure of matplotlib that shows itself as the last line of a cell."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
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
