"""Where bodies are in three dimensions: what neither lines in time nor a plane can show."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.body_names import MOST_BODIES, colour_key, colours_of, omitted_bodies_note
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.framing import Frame, frame_of
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import escaped_text, superscript, typeset
from xdynamics.figures.placing import named_elsewhere
from xdynamics.figures.plane import leaving_bodies_note
from xdynamics.figures.powers import shared_power

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

MOST_POINTS = 4000  # of a path
MOST_TICKS = 5  # of the longest side
SHORTEST_SIDE = 0.25  # of the longest side, that each one has at least
THINNEST = 1e-3  # of the longest side, for whose part a side of no length is taken
EDGES = (-0.05, 0.05)  # of each side, around what is drawn


class Orbit(NamedTuple):
    """The path of a body in three dimensions; its points have the shape (3, n)."""

    body: str
    points: NDArray[np.float64]


class Space(NamedTuple):
    """Paths in three dimensions, with what the axes are and their unit."""

    orbits: list[Orbit]
    axes: tuple[str, str, str]
    units: str


def spaces(views: list[list[BodyPath]]) -> Iterator[Space]:
    """Yield the paths in three dimensions that are seen from three sides."""
    for front, above, side in zip(views, views[1:], views[2:], strict=False):
        first, second, third = front[0], above[0], side[0]
        names = (first.across, first.up, second.up)
        has_same_axes = (second.across, third.across, third.up) == names
        if not (has_same_axes and first.is_space and first.units == second.units == third.units):
            continue
        if any(path.x.shape != above_path.x.shape for path, above_path in zip(front, above, strict=True)):
            continue
        orbits = [
            Orbit(path.label, np.stack([path.x, path.y, above_path.y]))
            for path, above_path in zip(front, above, strict=True)
        ]
        yield Space(orbits, names, first.units)


def draw_space(run: xr.Dataset, space: Space, views: list[list[BodyPath]], axes: Axes) -> None:
    """Draw paths in three dimensions in the place of some axes, a dot at each start.

    All three have one scale; a side that would be too flat for its ticks is stretched, and says so.
    """
    subplot_spec: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    solid: Any = figure.add_subplot(subplot_spec, projection="3d")
    view, orbits = views[0], space.orbits[:MOST_BODIES]
    frame = frame_of([orbit.points for orbit in orbits], [path.times for path in view[:MOST_BODIES]])
    for orbit, colour in zip(orbits, colours_of(view), strict=True):
        points = frame.points_inside(orbit.points) if frame.leaving else orbit.points
        rows = np.append(np.arange(0, points.shape[1] - 1, 1 + points.shape[1] // MOST_POINTS), points.shape[1] - 1)
        solid.plot(*points[:, rows], "-", color=colour, linewidth=1.0, label=escaped_text(orbit.body))
        solid.plot(*points[:, :1], "o", color=colour, markersize=4)
    names = {escaped_text(orbit.body) for orbit in space.orbits if orbit.body}
    if 0 < len(names) <= MOST_NAMED and not names <= named_elsewhere(solid):
        solid.legend(fontsize=8, frameon=False)
    colour_key(view, solid)
    power = _shape_space_axes(solid, frame, space.axes)
    units = f"10{superscript(power)} {typeset(space.units)}" if power else typeset(space.units)
    leaving_text = leaving_bodies_note(frame, view, run["time"])
    solid.set_title(
        f"in space, in {units} (dot: start){omitted_bodies_note(view)}{leaving_text}", loc="left", fontsize=10
    )


def _shape_space_axes(solid: Any, frame: Frame, names: tuple[str, str, str]) -> int:
    """Give a drawing in space its sides and ticks, and return the power of ten in which these are written."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    longest, power = float(frame.sides.max()) or 1.0, shared_power(frame.limits)
    # a side of no length has some room as well
    low, high = (frame.limits + np.outer(np.maximum(frame.sides, THINNEST * longest), EDGES)).T
    sides = np.maximum(high - low, SHORTEST_SIDE * (high - low).max())
    solid.set_box_aspect(sides / sides.max())
    for k, (letter, name) in enumerate(zip("xyz", names, strict=True)):
        axis, is_flat = getattr(solid, f"{letter}axis"), sides[k] > high[k] - low[k]
        getattr(solid, f"set_{letter}lim")(low[k], high[k])
        getattr(solid, f"set_{letter}label")(escaped_text(name) + ", not to scale" * bool(is_flat), fontsize=8)
        axis.set_major_locator(MaxNLocator(max(1, round(MOST_TICKS * float(sides[k] / sides.max())))))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 10.0**power:.6g}"))
    solid.tick_params(labelsize=7)
    return power
