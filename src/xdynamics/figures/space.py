"""Where bodies are in three dimensions: what neither lines in time nor a plane can show."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import typeset, words
from xdynamics.figures.placing import named_elsewhere
from xdynamics.figures.plane import MOST_BODIES, colours_of, left_out

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_POINTS = 4000  # of a path


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
        same = (second.across, third.across, third.up) == names
        if not (same and first.is_space and first.units == second.units == third.units):
            continue
        if any(path.x.shape != other.x.shape for path, other in zip(front, above, strict=True)):
            continue
        orbits = [
            Orbit(path.label, np.stack([path.x, path.y, other.y])) for path, other in zip(front, above, strict=True)
        ]
        yield Space(orbits, names, first.units)


def draw(space: Space, views: list[list[BodyPath]], axes: Axes) -> None:
    """Draw paths in three dimensions in the place of some axes, with one scale for all three, a dot at each start."""
    place: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    solid: Any = figure.add_subplot(place, projection="3d")
    shades = colours_of(views[0][:MOST_BODIES])
    for orbit, colour in zip(space.orbits, shades, strict=False):
        points = orbit.points[:, :: 1 + orbit.points.shape[1] // MOST_POINTS]
        solid.plot(*points, "-", color=colour, linewidth=1.0, label=words(orbit.body))
        solid.plot(*points[:, :1], "o", color=colour, markersize=4)
    names = {words(orbit.body) for orbit in space.orbits if orbit.body}
    if 0 < len(names) <= MOST_NAMED and not names <= named_elsewhere(solid):
        solid.legend(fontsize=8, frameon=False)
    solid.set_aspect("equal", adjustable="box")
    for axis, name in zip("xyz", space.axes, strict=True):
        getattr(solid, f"set_{axis}label")(words(name), fontsize=8)
    solid.locator_params(nbins=5)
    solid.tick_params(labelsize=7)
    solid.set_title(f"in space, in {typeset(space.units)} (dot: start){left_out(views[0])}", loc="left", fontsize=10)
