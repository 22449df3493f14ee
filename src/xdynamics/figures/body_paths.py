"""Where one body of a picture is, at times that bend as its motion does.

How pictures tell bodies apart: a colour for each, and names in a legend, at their places, or along a scale of colours.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.figures.line_panels import GREY, MOST_NAMED
from xdynamics.figures.marks import COLOURS, LETTERS, escaped_text, legible, shortened_names
from xdynamics.figures.sheet import EVENT
from xdynamics.units import NONE, parse_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

NUMBERED = re.compile(r"\d+(, \d+)*")


@dataclass(frozen=True)
class BodyPath:
    """Where one body is.

    Attributes
    ----------
    across, up : str
        What the axes are.
    units : str
        Of both, or of the axis across if the other one has its own.
    times, x, y : ndarray, shape (n,)
        A line that bends as the motion does.
    body : str
        Which of several it is: a name, labels, or numbers of elements.
    up_units : str
        Of the axis up, in a plane of unlike quantities.
    names : pair of str
        The coordinates that the axes are, as the run's elements are called; empty where an axis is none.
    dims : str
        Dimensions of which `body` is an element.
    depth : ndarray, shape (n,), optional
        Along the axis that a view in space does not show.
    depth_name : str
        The coordinate that it is.
    """

    across: str
    up: str
    units: str
    times: Floats
    x: Floats
    y: Floats
    body: str = ""
    up_units: str = ""
    names: tuple[str, str] = ("", "")
    dims: str = ""
    depth: Floats | None = None
    depth_name: str = ""

    @property
    def all_names(self) -> tuple[str, ...]:
        """The coordinates of the axes, and of the depth where there is one."""
        return (*self.names, self.depth_name) if self.depth_name else self.names

    @property
    def points(self) -> Floats:
        """Where the body is, shape (2, n), or (3, n) where there is a depth."""
        return np.stack([self.x, self.y] if self.depth is None else [self.x, self.y, self.depth])

    @property
    def label(self) -> str:
        """How pictures call it: numbers of elements with what they are of."""
        return f"{self.dims} {self.body}" if NUMBERED.fullmatch(self.body) else self.body

    @property
    def is_space(self) -> bool:
        """Whether both axes are lengths, so that one scale suits both."""
        return not self.up_units and is_length(self.units)

    @property
    def is_fixed(self) -> bool:
        """Whether the body never moves: an anchor, a wall."""
        return not np.ptp(self.points, axis=-1).any()


def is_length(units: str) -> bool:
    """Whether a unit is that of a position: neither of an angle, nor unreadable."""
    try:
        return parse_unit(units).dimension != NONE
    except InputError:
        return False


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
