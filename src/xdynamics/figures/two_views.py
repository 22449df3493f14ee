"""Bodies in three dimensions as a film shows them: two views of one scale, side by side or one over the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.bodies_scene import Bodies
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.boundaries import boundaries, outside, radii_of, walls_in_space
from xdynamics.figures.frame_sizes import double_frame_size
from xdynamics.figures.framing import Frame, frame_of
from xdynamics.figures.marks import words
from xdynamics.figures.scenery import fastenings

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

SIDES = {0: ((0, 2), (0, 1)), 1: ((0, 1), (2, 1)), 2: ((0, 2), (1, 2))}  # across and up of both, by the longest side


@dataclass
class TwoViews:
    """Bodies in space from two sides: along x one view over the other, else side by side with one axis up.

    Attributes
    ----------
    views : pair of Bodies
        Left or above, and right or below.
    is_stacked : bool
        Whether they share the axis across, not that which goes up.
    undrawn : sequence of str
        Contacts whose walls neither view shows.
    """

    views: tuple[Bodies, Bodies]
    is_stacked: bool
    undrawn: Sequence[str] = ()

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.views[0].times

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as both together."""
        return double_frame_size([view.limits for view in self.views], self.views[0].names, is_stacked=self.is_stacked)

    def start(self, axes: Axes) -> str:
        """Divide the place of the axes, and prepare both views."""
        figure: Any = axes.figure
        place: Any = axes.get_subplotspec()
        lengths = [float(np.ptp(view.limits[int(self.is_stacked)])) for view in self.views]
        shape = {"nrows": 2, "ncols": 1, "height_ratios": lengths}
        if not self.is_stacked:
            shape = {"nrows": 1, "ncols": 2, "width_ratios": lengths}
        grid = place.subgridspec(**shape)
        axes.set_subplotspec(grid[0])
        other = figure.add_subplot(grid[1])
        other.grid(linewidth=0.6)
        self.views[0].start(axes)
        self.views[1].start(other)
        if self.is_stacked:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
        else:
            other.set_ylabel("")
            other.tick_params(labelleft=False)
        far = dict.fromkeys(name for view in self.views for name in view.far)
        undrawn = words(f"; not drawn: {', '.join(self.undrawn)}") if self.undrawn else ""
        return f"{self.views[0].notes}{outside([*far])}{undrawn}"

    def at(self, now: float) -> list[Any]:
        """Put everything where it is, in both."""
        return [moved for view in self.views for moved in view.at(now)]


def in_space(views: list[list[BodyPath]]) -> tuple[list[BodyPath], list[BodyPath], bool] | None:
    """Return the paths in two views of bodies that are seen from three sides, and whether they share the axis across.

    The axis that both have is the longest side of the motion.
    """
    if len(views) < 3:
        return None
    plan, front, side = views[:3]
    names = (plan[0].across, plan[0].up, front[0].up)
    if (front[0].across, side[0].across, side[0].up) != names or not plan[0].is_space:
        return None
    lines = [_lines(path, other) for path, other in zip(plan, front, strict=True)]
    frame = frame_of(lines, [path.times for path in plan])
    longest = int(np.argmax(frame.sides))
    first, second = (
        [_seen(path, other, pair, line) for path, other, line in zip(plan, front, lines, strict=True)]
        for pair in SIDES[longest]
    )
    return first, second, longest == 0


def _lines(path: BodyPath, other: BodyPath) -> Floats:
    """Return a path in space, shape (3, n)."""
    return np.stack([path.x, path.y, np.interp(path.times, other.times, other.y)])


def _seen(path: BodyPath, other: BodyPath, pair: tuple[int, int], line: Floats) -> BodyPath:
    """Return a path as a view shows it, with what it does not show as its depth."""
    away = 3 - sum(pair)
    titles, names = (path.across, path.up, other.up), (*path.names, other.names[1])
    across, up = pair
    return replace(
        path,
        across=titles[across],
        up=titles[up],
        x=line[across],
        y=line[up],
        names=(names[across], names[up]),
        depth=line[away],
        depth_name=names[away],
    )


def two_views_of(run: xr.Dataset, views: list[list[BodyPath]], trail: float | None) -> TwoViews | None:
    """Return the scene of bodies that are seen from three sides; None if they are not."""
    if (found := in_space(views)) is None:
        return None
    first, second, is_stacked = found
    radii = radii_of(run, first)
    frame = frame_of([path.points for path in first], [path.times for path in first])
    drafts = [
        Bodies(view, run["time"], trail, fastenings(run, view), boundaries(run, view, radii), radii, frame=part)
        for view, part in ((first, _part(frame, first, first)), (second, _part(frame, first, second)))
    ]
    shared = 0 if is_stacked else 1
    held = np.stack([draft.limits[shared] for draft in drafts])
    both = np.array([held[:, 0].min(), held[:, 1].max()])
    limits = [draft.limits.copy() for draft in drafts]
    for each in limits:
        each[shared] = both
    one, other = (
        replace(draft, held=each, is_named=is_stacked == (k == 0))
        for k, (draft, each) in enumerate(zip(drafts, limits, strict=True))
    )
    return TwoViews((one, other), is_stacked, _undrawn(run, drafts, first))


def _part(frame: Frame, first: list[BodyPath], view: list[BodyPath]) -> Frame:
    """Return the part of a frame in space, whose axes are those of the first view and its depth, that a view shows."""
    order = [*first[0].names, first[0].depth_name]
    return Frame(frame.limits[[order.index(name) for name in view[0].names]], frame.leaving)


def _undrawn(run: xr.Dataset, drafts: Sequence[Bodies], view: list[BodyPath]) -> list[str]:
    """Return the contacts of bodies with walls that neither view can show."""
    drawn = {wall.contact for draft in drafts for wall in draft.boundaries}
    return [name for name in walls_in_space(run, view) if name not in drawn]
