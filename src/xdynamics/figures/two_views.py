"""Bodies in three dimensions as a film shows them: two views of one scale, side by side or one over the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.bodies_scene import BodiesScene
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.boundaries import boundaries_of, disc_radii, outside_note, walls_in_space
from xdynamics.figures.frame_sizes import double_frame_size
from xdynamics.figures.framing import Frame, frame_of
from xdynamics.figures.marks import escaped_text
from xdynamics.figures.scenery import fastenings_of

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

    views: tuple[BodiesScene, BodiesScene]
    is_stacked: bool
    undrawn: Sequence[str] = ()

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.views[0].times

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as both together."""
        return double_frame_size(
            [view.limits for view in self.views], self.views[0].legend_names, is_stacked=self.is_stacked
        )

    def start(self, axes: Axes) -> str:
        """Divide the place of the axes, and prepare both views."""
        figure: Any = axes.figure
        subplot_spec: Any = axes.get_subplotspec()
        lengths = [float(np.ptp(view.limits[int(self.is_stacked)])) for view in self.views]
        shape = {"nrows": 2, "ncols": 1, "height_ratios": lengths}
        if not self.is_stacked:
            shape = {"nrows": 1, "ncols": 2, "width_ratios": lengths}
        grid = subplot_spec.subgridspec(**shape)
        axes.set_subplotspec(grid[0])
        second_axes = figure.add_subplot(grid[1])
        second_axes.grid(linewidth=0.6)
        self.views[0].start(axes)
        self.views[1].start(second_axes)
        if self.is_stacked:
            axes.set_xlabel("")
            axes.tick_params(labelbottom=False)
        else:
            second_axes.set_ylabel("")
            second_axes.tick_params(labelleft=False)
        far_contacts = dict.fromkeys(name for view in self.views for name in view.far_walls)
        undrawn = escaped_text(f"; not drawn: {', '.join(self.undrawn)}") if self.undrawn else ""
        return f"{self.views[0].title_notes}{outside_note([*far_contacts])}{undrawn}"

    def move_to(self, time: float) -> list[Any]:
        """Put everything where it is, in both."""
        return [artist for view in self.views for artist in view.move_to(time)]


def paths_in_two_views(views: list[list[BodyPath]]) -> tuple[list[BodyPath], list[BodyPath], bool] | None:
    """Return the paths in two views of bodies that are seen from three sides, and whether they share the axis across.

    The axis that both have is the longest side of the motion.
    """
    if len(views) < 3:
        return None
    plan, front, side = views[:3]
    names = (plan[0].across, plan[0].up, front[0].up)
    if (front[0].across, side[0].across, side[0].up) != names or not plan[0].is_space:
        return None
    lines = [_space_path(path, front_path) for path, front_path in zip(plan, front, strict=True)]
    frame = frame_of(lines, [path.times for path in plan])
    longest = int(np.argmax(frame.sides))
    first, second = (
        [_path_in_view(path, front_path, pair, line) for path, front_path, line in zip(plan, front, lines, strict=True)]
        for pair in SIDES[longest]
    )
    return first, second, longest == 0


def _space_path(path: BodyPath, front_path: BodyPath) -> Floats:
    """Return a path in space, shape (3, n)."""
    return np.stack([path.x, path.y, np.interp(path.times, front_path.times, front_path.y)])


def _path_in_view(path: BodyPath, front_path: BodyPath, pair: tuple[int, int], line: Floats) -> BodyPath:
    """Return a path as a view shows it, with what it does not show as its depth."""
    depth_axis = 3 - sum(pair)
    titles, names = (path.across, path.up, front_path.up), (*path.names, front_path.names[1])
    across, up = pair
    return replace(
        path,
        across=titles[across],
        up=titles[up],
        x=line[across],
        y=line[up],
        names=(names[across], names[up]),
        depth=line[depth_axis],
        depth_name=names[depth_axis],
    )


def two_views_of(run: xr.Dataset, views: list[list[BodyPath]], trail: float | None) -> TwoViews | None:
    """Return the scene of bodies that are seen from three sides; None if they are not."""
    if (paired_paths := paths_in_two_views(views)) is None:
        return None
    first, second, is_stacked = paired_paths
    radii = disc_radii(run, first)
    frame = frame_of([path.points for path in first], [path.times for path in first])
    drafts = [
        BodiesScene(
            view, run["time"], trail, fastenings_of(run, view), boundaries_of(run, view, radii), radii, frame=part
        )
        for view, part in ((first, _frame_in_view(frame, first, first)), (second, _frame_in_view(frame, first, second)))
    ]
    shared = 0 if is_stacked else 1
    shared_limits = np.stack([draft.limits[shared] for draft in drafts])
    shared_range = np.array([shared_limits[:, 0].min(), shared_limits[:, 1].max()])
    limits = [draft.limits.copy() for draft in drafts]
    for view_limits in limits:
        view_limits[shared] = shared_range
    first_view, second_view = (
        replace(draft, fixed_limits=view_limits, is_named=is_stacked == (k == 0))
        for k, (draft, view_limits) in enumerate(zip(drafts, limits, strict=True))
    )
    return TwoViews((first_view, second_view), is_stacked, _undrawn_contacts(run, drafts, first))


def _frame_in_view(frame: Frame, first: list[BodyPath], view: list[BodyPath]) -> Frame:
    """Return the part of a frame in space, whose axes are those of the first view and its depth, that a view shows."""
    order = [*first[0].names, first[0].depth_name]
    return Frame(frame.limits[[order.index(name) for name in view[0].names]], frame.leaving)


def _undrawn_contacts(run: xr.Dataset, drafts: Sequence[BodiesScene], view: list[BodyPath]) -> list[str]:
    """Return the contacts of bodies with walls that neither view can show."""
    shown_contacts = {wall.contact for draft in drafts for wall in draft.boundaries}
    return [name for name in walls_in_space(run, view) if name not in shown_contacts]
