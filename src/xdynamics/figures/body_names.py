"""How pictures tell bodies apart: a colour for each, and names in a legend, at their places, or along a scale of colours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.figures.body_paths import NUMBERED, BodyPath
from xdynamics.figures.contrast import LETTERS, legible
from xdynamics.figures.line_panels import GREY, MOST_NAMED
from xdynamics.figures.marks import COLOURS, escaped_text, shortened_names
from xdynamics.figures.placing import EVENT

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_BODIES = 200  # that are drawn
MOST_ENDS = 60  # bodies that have their names where they are
MANY = "turbo"  # colours of more bodies than there are single ones
LEAST, MOST = 0.05, 0.95  # of these colours
MOST_TICKS = 6  # names along a scale of colours
SMALL = 6.5  # points of a name at its body


def colours_of(view: list[BodyPath]) -> list[str]:
    """Return a colour for each body that is drawn, grey for those that never move."""
    view = view[:MOST_BODIES]
    moving_bodies = [body for body in view if not body.is_fixed]
    shades = [COLOURS[k % len(COLOURS)] for k in range(len(moving_bodies))]
    if len(moving_bodies) > len(COLOURS) and all(body.dims for body in view):  # no colour twice
        shades = _body_shades(len(moving_bodies))
    remaining_shades = iter(shades)
    return [GREY if body.is_fixed else next(remaining_shades) for body in view]


def _body_shades(count: int) -> list[str]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    return [legible(to_hex(shade)) for shade in colormaps[MANY](np.linspace(LEAST, MOST, count))]


def omitted_bodies_note(view: list[BodyPath]) -> str:
    """Note how many bodies of a view are not drawn, if there are any."""
    return f", the first {MOST_BODIES} of {len(view)} bodies" if len(view) > MOST_BODIES else ""


def brief_names(view: list[BodyPath]) -> list[str]:
    """Return the names of bodies as they stand at their places: labels or numbers without their dimension; none if unknown."""
    return shortened_names([escaped_text(body.body) for body in view]) if all(body.dims for body in view) else []


def names_at_bodies(view: list[BodyPath]) -> list[str]:
    """Return names for the places of more bodies than a legend takes; none if a legend or a scale of colours has them."""
    return brief_names(view) if MOST_NAMED < len(view) <= MOST_ENDS else []


def name_ends(view: list[BodyPath], places: list[tuple[float, float]], axes: Axes) -> str:
    """Put the names of bodies at the ends of their paths, where there is room, and return what the title says of them."""
    names = names_at_bodies(view)
    for path_end, name, colour in zip(places, names, colours_of(view), strict=False):
        style: dict[str, Any] = {"textcoords": "offset points", "fontsize": SMALL, "gid": EVENT}
        axes.annotate(name, path_end, (2, 2), color=legible(colour, LETTERS), **style)
    if not names:
        return ""
    kind_of_names = f"{view[0].dims} numbers" if NUMBERED.fullmatch(view[0].body) else "names"
    return f"; {kind_of_names} at the ends, left out where crowded"


def colour_key(view: list[BodyPath], axes: Any) -> None:
    """Explain the colours of bodies by a scale beside the axes, in space and in the plane, where no names say them."""
    from matplotlib.colors import ListedColormap, NoNorm

    names, solid = brief_names(view[:MOST_BODIES]), axes.name == "3d"
    if not names or len(names) <= MOST_NAMED or any(body.is_fixed for body in view):
        return
    from matplotlib.cm import ScalarMappable

    scale = ScalarMappable(NoNorm(0, len(names) - 1), ListedColormap(colours_of(view)))
    ticks = np.unique(np.linspace(0, len(names) - 1, MOST_TICKS).round().astype(int))
    bar_placement: Any = (
        {"ax": axes, "shrink": 0.7, "pad": 0.15} if solid else {"cax": axes.inset_axes((1.02, 0.0, 0.03, 1.0))}
    )
    bar = axes.figure.colorbar(scale, ticks=ticks, **bar_placement)
    bar.ax.set_yticks(ticks, [names[k] for k in ticks], fontsize=7)
    bar.set_label(escaped_text(view[0].dims), fontsize=8)
