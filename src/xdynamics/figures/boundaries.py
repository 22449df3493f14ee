"""Where the gaps of a film's contacts close: floors and walls that bodies meet, and the discs that meet each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of
from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import Name
from xdynamics.figures.body_names import MOST_BODIES, colours_of
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.marks import words
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.shapes.trees import at
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

GRID = 160  # points along each side, among which a gap's zero is looked for
GROUND = "0.6"
REACH = 0.3  # of the longer side, up to which a picture is widened to show a wall
BEHIND = 0.05  # of the longer side, that is shown behind it
PLACE = "place"  # across or up, where it is an expression
LIKE = 9  # digits in which two gaps agree that are of one wall
APART = np.array([[[0.0] * 3] * 3, [[1.0, 2.0, 0.0], [0.0, 0.0, 3.0], [0.0, 1.0, 1.0]]])  # of two bodies, body by axis
DEPTHS = np.array([[0.0] * 5, [0.7, -0.3, 1.1, -1.0, 0.2]])  # of a view's longer side
PROBES = np.array([[0.0, 1.0, 0.0, 0.3, -0.7], [0.0, 0.0, 1.0, 0.9, 0.4]])  # of a view's longer side


@dataclass(frozen=True)
class Gap:
    """The gap of a contact as a function of where one body, or two, are.

    Attributes
    ----------
    tree : Node
    names : tuple of tuples of str
        The coordinates across and up of each body, in space its depth too; empty where an axis has none.
    known : mapping of str to float
        Parameters and constants, in SI units.
    factor, clock : float
        The units of the axes and of recorded times, in SI units.
    """

    tree: Node
    names: tuple[tuple[str, ...], ...]
    known: Mapping[str, float]
    factor: float
    clock: float

    def at(self, places: Floats, now: float) -> Floats:
        """Return the gap in the axes' unit where the bodies are at `places`, shape (bodies, axes, n)."""
        values: dict[str, Any] = {**self.known, "t": np.float64(now * self.clock)}
        for pair, place in zip(self.names, places, strict=True):
            values |= {name: self.factor * axis for name, axis in zip(pair, place, strict=True) if name}
        found: Floats = np.broadcast_to(evaluate_many(self.tree, values), places.shape[-1]) / self.factor
        return found


@dataclass
class Boundary:
    """A floor or wall: where a contact's gap is zero in the plane, a radius beyond the middle of what meets it.

    Attributes
    ----------
    gap : Gap
        Of one body.
    radius : float
        Of the body, in the axes' unit.
    contact : str
        What the model calls it.
    """

    gap: Gap
    radius: float = 0.0
    contact: str = ""
    _grid: Any = None
    _line: Any = None

    @property
    def moves(self) -> bool:
        """Whether the gap depends on time."""
        return "t" in free_names(self.gap.tree)

    def start(self, axes: Axes, limits: Floats) -> None:
        """Draw what stands still, with the forbidden side shaded; prepare what moves."""
        from matplotlib.collections import LineCollection

        self._grid = _grid(limits)
        if self.moves:
            self._line = axes.add_collection(LineCollection([], colors=GROUND, linewidths=2.0), autolim=False)
            return
        gaps = self._gaps(self._grid, 0.0)
        if gaps.min() < 0.0 < gaps.max():
            axes.contourf(*self._grid, gaps, levels=[-np.inf, 0.0], colors=[GROUND], alpha=0.25)
            axes.contour(*self._grid, gaps, levels=[0.0], colors=[GROUND], linewidths=2.0)

    def _gaps(self, grid: tuple[Floats, Floats], now: float) -> Floats:
        """Return how far the wall is from each point of a grid, shape (n, n)."""
        across, up = grid
        found: Floats = self.gap.at(np.stack([across.ravel(), up.ravel()])[None], now) + self.radius
        return found.reshape(across.shape)

    def lines(self, grid: tuple[Floats, Floats], now: float) -> list[Floats]:
        """Return where the gap is zero at a time on a grid, each line of shape (n, 2)."""
        from contourpy import contour_generator

        found: list[Floats] = contour_generator(*grid, self._gaps(grid, now)).lines(0.0)  # type: ignore[assignment]
        return found

    def at(self, now: float) -> Any:
        """Put the line to where the gap is zero at a time."""
        self._line.set_segments(self.lines(self._grid, now))
        return self._line


def _grid(limits: Floats) -> tuple[Floats, Floats]:
    across, up = np.meshgrid(*(np.linspace(low, high, GRID) for low, high in limits))
    return across, up


def with_walls(limits: Floats, walls: Sequence[Boundary], times: Sequence[float]) -> tuple[Floats, list[str]]:
    """Return the limits of a picture, widened to hold the walls that are near, and the contacts of those farther off.

    Parameters
    ----------
    limits : ndarray, shape (2, 2)
        Across and up, in the axes' unit.
    walls : sequence of Boundary
    times : sequence of float
        At which walls that move are looked for.
    """
    longer, far, near = float(np.ptp(limits, axis=-1).max()), list[str](), set[str]()
    wide, held = _grid(limits + REACH * longer * np.array([-1.0, 1.0])), limits
    for wall in walls:
        lines = [line for now in (times if wall.moves else times[:1]) for line in wall.lines(wide, now)]
        if not lines:
            far.append(wall.contact)
            continue
        near.add(wall.contact)
        points = np.concatenate(lines).T
        beyond = np.hypot(*np.maximum(0.0, np.maximum(limits[:, :1] - points, points - limits[:, 1:])))
        place = points[:, int(np.argmin(beyond))]
        low = np.where(place < limits[:, 0], np.minimum(held[:, 0], place - BEHIND * longer), held[:, 0])
        high = np.where(place > limits[:, 1], np.maximum(held[:, 1], place + BEHIND * longer), held[:, 1])
        held = np.stack([low, high], axis=-1)
    return held, [f"part of {name}" if name in near else name for name in dict.fromkeys(far)]


def outside(contacts: Sequence[str]) -> str:
    """Say, behind other words of a title, whose walls are outside the frame."""
    return words(f"; outside the frame: {', '.join(contacts)}") if contacts else ""


def boundaries(run: xr.Dataset, view: list[BodyPath], radii: Floats) -> list[Boundary]:
    """Return where gaps of contacts close that read no more than where one body is.

    What many bodies meet in the same way is one wall; of bodies without radii that of the one that comes nearest.
    """
    if "model_toml" not in run or not view[0].is_space:
        return []
    model, found = model_of(run, None), dict[Any, tuple[float, Boundary]]()
    known, factor, clock = _units_of(model, view)
    span = max(float(np.ptp(path.x)) + float(np.ptp(path.y)) for path in view) or 1.0
    for contact, tree, path, radius in _of_single_bodies(model, view, radii):
        if path.depth_name in free_names(tree):
            whole = Gap(tree, (path.all_names,), known, factor, clock)
            near, far = (whole.at(np.stack([*PROBES, depth])[None] * span, 0.0) for depth in DEPTHS)
            if (near != far).any():
                continue
            known = {**known, path.depth_name: 0.0}
        gap = Gap(tree, (path.names,), known, factor, clock)
        values = gap.at(span * PROBES[None], float(view[0].times[0])) + radius
        key = (contact, *np.round((values - values[0]) / span, LIKE).tolist())
        if key not in found or values[0] > found[key][0]:
            found[key] = (float(values[0]), Boundary(gap, radius, contact))
    walls = {(*key[1:], round(value / span, LIKE)): wall for key, (value, wall) in found.items()}
    return [*walls.values()]


def draw_walls(walls: Sequence[Boundary], axes: Axes) -> None:
    """Draw the walls that stand still into a picture of paths, and say in its title which are outside."""
    still = [wall for wall in walls if not wall.moves]
    limits, far = with_walls(np.array([axes.get_xlim(), axes.get_ylim()]), still, [0.0])
    for wall in still:
        wall.start(axes, limits)
    if still:
        axes.set(xlim=limits[0], ylim=limits[1])
        axes.set_title(axes.get_title(loc="left") + outside(far), loc="left", fontsize=10)


def _of_single_bodies(model: Model, view: list[BodyPath], radii: Floats) -> Iterator[tuple[str, Node, BodyPath, float]]:
    """Yield gaps that read no more than where one body is, with its path and its radius."""
    owner = {name: k for k, path in enumerate(view[:MOST_BODIES]) for name in path.all_names if name}
    shown, known = dict(_places(model, len(view))), constants(model).keys()
    for contact, tree in _gaps(model):
        if tree in shown:
            yield contact, Name(PLACE), replace(view[0], names=shown[tree]), 0.0
            continue
        read = free_names(tree) - known - {"t"}
        if read and read <= owner.keys() and len(bodies := {owner[name] for name in read}) == 1:
            body = bodies.pop()
            yield contact, tree, view[body], float(radii[body]) if radii.size else 0.0


def walls_in_space(run: xr.Dataset, view: list[BodyPath]) -> list[str]:
    """Return the contacts whose gaps read no more than where one body is in space."""
    if "model_toml" not in run:
        return []
    return [*dict.fromkeys(contact for contact, *_ in _of_single_bodies(model_of(run, None), view, np.zeros(0)))]


def _places(model: Model, count: int) -> Iterator[tuple[Node, tuple[str, str]]]:
    """Yield what a model's plane shows beside plain coordinates, and on which of the axes: a gap may be the same."""
    for pair in model.pictured.plane[:count]:
        yield model.expanded(pair[0]), (PLACE, "")
        yield model.expanded(pair[1]), ("", PLACE)


def _units_of(model: Model, view: list[BodyPath]) -> tuple[Mapping[str, float], float, float]:
    return constants(model), float(parse_unit(view[0].units).factor), float(model.time_unit.factor)


def _gaps(model: Model) -> Iterator[tuple[str, Node]]:
    """Yield the gaps of contacts, of many bodies for each, and for each of the walls that a relation leads to."""
    for name, contact in model.shaped.contacts.items():
        if not isinstance(contact.gap, Node):
            continue
        for place in _elements_of(model, model.shapes.dims.get(name, ())):
            yield name, model.expanded(at(contact.gap, place, model.shapes))


def _elements_of(model: Model, dims: tuple[str, ...]) -> Iterator[Mapping[str, int]]:
    """Yield the elements of a contact, those of a relation where it leads from the first bodies to another dimension."""
    if not {*dims} & model.shapes.relations.keys():
        yield from model.shapes.places(dims)
    elif len(dims) == 1 and (relation := model.shapes.relations[dims[0]]).source != relation.target:
        shown = (relation.first < MOST_BODIES) & (relation.second < MOST_BODIES)
        yield from ({dims[0]: link} for link in np.flatnonzero(shown).tolist())


def radii_of(run: xr.Dataset, view: list[BodyPath]) -> Floats:
    """Return the radii of bodies that meet each other as discs, shape (bodies,), in the axes' unit; empty if they do not.

    Where two bodies are at a distance d, their gap is d less both radii; three pairs tell the first one's.
    """
    none, count = np.zeros(0), len(view)
    if "model_toml" not in run or not view[0].is_space or count < 2 or not all(path.names[0] for path in view):
        return none
    model = model_of(run, None)
    wanted = {(0, body) for body in range(1, count)} | ({(1, 2)} if count > 2 else set())
    known, factor, clock = _units_of(model, view)
    sums = dict[tuple[int, int], float]()
    for pair, tree in _gaps_between(model, view, wanted):
        names = tuple(view[body].all_names for body in pair)
        if free_names(tree) - known.keys() != {name for both in names for name in both}:
            return none
        gap = Gap(tree, names, known, factor, clock)
        apart = APART[:, : len(names[0])] * float(np.ptp(view[0].x) or 1.0)
        both = np.sqrt((apart[1] ** 2).sum(axis=0)) - gap.at(apart, float(view[0].times[0]))
        if not np.allclose(both, both[0], rtol=1e-9) or both[0] <= 0.0:
            return none
        sums[pair] = float(both[0])
    if sums.keys() != wanted:
        return none
    first = sums[0, 1] / 2.0 if count == 2 else (sums[0, 1] + sums[0, 2] - sums[1, 2]) / 2.0
    radii = np.array([first, *(sums[0, body] - first for body in range(1, count))])
    return radii if (radii > 0.0).all() else none


def draw_discs(view: list[BodyPath], radii: Floats, axes: Axes) -> bool:
    """Draw bodies that have radii as large as they are, rings at the start and discs at the end; return whether they have."""
    from matplotlib.collections import EllipseCollection

    shown, size = view[:MOST_BODIES], 2.0 * radii[:MOST_BODIES]
    if not radii.size:
        return False
    for row, style in (
        (0, {"facecolors": "none", "edgecolors": colours_of(view)[: len(shown)], "alpha": 0.5}),
        (-1, {"facecolors": colours_of(view)[: len(shown)], "edgecolors": "none", "alpha": 0.35}),
    ):
        places = np.array([[path.x[row], path.y[row]] for path in shown])
        given: dict[str, Any] = {"offsets": places, "offset_transform": axes.transData, "linewidths": 0.8, **style}
        axes.add_collection(EllipseCollection(size, size, np.zeros(len(shown)), units="xy", **given), autolim=False)
        for beyond in (-size, size):  # what limits do not know of a collection in units of its own
            axes.update_datalim(places + beyond[:, None] / 2.0)
    axes.autoscale_view()
    return True


def _gaps_between(
    model: Model, view: list[BodyPath], wanted: set[tuple[int, int]]
) -> Iterator[tuple[tuple[int, int], Node]]:
    """Yield gaps between two bodies of a view, for the wanted pairs of them."""
    owner = {name: k for k, path in enumerate(view) for name in path.all_names}
    for name, contact in model.shaped.contacts.items():
        if not isinstance(contact.gap, Node):
            continue
        if not (dims := model.shapes.dims.get(name, ())):
            tree = model.expanded(contact.gap)
            bodies = sorted({owner[read] for read in free_names(tree) if read in owner})
            if tuple(bodies) in wanted:
                yield (bodies[0], bodies[1]), tree
        elif len(dims) == 1 and dims[0] in model.shapes.relations:
            relation = model.shapes.relations[dims[0]]
            if relation.source != relation.target or model.shapes.extent(relation.source).size != len(view):
                continue
            for link, pair in enumerate(zip(relation.first.tolist(), relation.second.tolist(), strict=True)):
                if pair in wanted:
                    yield pair, model.expanded(at(contact.gap, {dims[0]: link}, model.shapes))
