"""A figure that a notebook shows, though pyplot knows nothing of it."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure

DPI = 100  # of a picture in a notebook


class Picture(Figure):
    """A figure of matplotlib that shows itself as the last line of a cell."""

    def _repr_png_(self) -> bytes:
        drawn = BytesIO()
        self.savefig(drawn, format="png", dpi=DPI)
        return drawn.getvalue()
