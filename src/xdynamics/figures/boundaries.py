"""Where the gaps of a film's contacts close: floors and walls that bodies meet, and the discs that meet each other.

What joins bodies: rods, springs and threads that a model names, and the links of its relations.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.expressions import Node, free_names
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import Name
from xdynamics.figures.marks import escaped_text
from xdynamics.figures.plane import MOST_BODIES, BodyPath, colours_of
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.model.parts import ORIGIN
from xdynamics.shapes import join_element_name, split_element_name
from xdynamics.shapes.trees import at_element
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
    constant_values : mapping of str to float
        Parameters and constants, in SI units.
    factor, clock : float
        The units of the axes and of recorded times, in SI units.
    """

    tree: Node
    names: tuple[tuple[str, ...], ...]
    constant_values: Mapping[str, float]
    factor: float
    clock: float

    def values_at(self, places: Floats, time: float) -> Floats:
        """Return the gap in the axes' unit where the bodies are at `places`, shape (bodies, axes, n)."""
        values: dict[str, Any] = {**self.constant_values, "t": np.float64(time * self.clock)}
        for pair, body_place in zip(self.names, places, strict=True):
            values |= {name: self.factor * axis for name, axis in zip(pair, body_place, strict=True) if name}
        gap: Floats = np.broadcast_to(evaluate_many(self.tree, values), places.shape[-1]) / self.factor
        return gap


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

        self._grid = _grid_over_limits(limits)
        if self.moves:
            self._line = axes.add_collection(LineCollection([], colors=GROUND, linewidths=2.0), autolim=False)
            return
        gaps = self._wall_distances(self._grid, 0.0)
        # matplotlib warns of contours that are nowhere in the picture
        if gaps.min() < 0.0 < gaps.max():
            axes.contourf(*self._grid, gaps, levels=[-np.inf, 0.0], colors=[GROUND], alpha=0.25)
            axes.contour(*self._grid, gaps, levels=[0.0], colors=[GROUND], linewidths=2.0)

    def _wall_distances(self, grid: tuple[Floats, Floats], time: float) -> Floats:
        """Return how far the wall is from each point of a grid, shape (n, n)."""
        across, up = grid
        distances: Floats = self.gap.values_at(np.stack([across.ravel(), up.ravel()])[None], time) + self.radius
        return distances.reshape(across.shape)

    def zero_lines(self, grid: tuple[Floats, Floats], time: float) -> list[Floats]:
        """Return where the gap is zero at a time on a grid, each line of shape (n, 2)."""
        from contourpy import contour_generator

        contour_lines: list[Floats] = contour_generator(*grid, self._wall_distances(grid, time)).lines(0.0)  # type: ignore[assignment]
        return contour_lines

    def move_to(self, time: float) -> Any:
        """Put the line to where the gap is zero at a time."""
        self._line.set_segments(self.zero_lines(self._grid, time))
        return self._line


def _grid_over_limits(limits: Floats) -> tuple[Floats, Floats]:
    across, up = np.meshgrid(*(np.linspace(low, high, GRID) for low, high in limits))
    return across, up


def widened_limits(limits: Floats, walls: Sequence[Boundary], times: Sequence[float]) -> tuple[Floats, list[str]]:
    """Return the limits of a picture, widened to hold the walls that are near, and the contacts of those farther off.

    Parameters
    ----------
    limits : ndarray, shape (2, 2)
        Across and up, in the axes' unit.
    walls : sequence of Boundary
    times : sequence of float
        At which walls that move are looked for.
    """
    longer, far_contacts, near_contacts = float(np.ptp(limits, axis=-1).max()), list[str](), set[str]()
    wide, wide_limits = _grid_over_limits(limits + REACH * longer * np.array([-1.0, 1.0])), limits
    for wall in walls:
        lines = [line for time in (times if wall.moves else times[:1]) for line in wall.zero_lines(wide, time)]
        if not lines:
            far_contacts.append(wall.contact)
            continue
        near_contacts.add(wall.contact)
        points = np.concatenate(lines).T
        distances = np.hypot(*np.maximum(0.0, np.maximum(limits[:, :1] - points, points - limits[:, 1:])))
        nearest_point = points[:, int(np.argmin(distances))]
        low = np.where(
            nearest_point < limits[:, 0],
            np.minimum(wide_limits[:, 0], nearest_point - BEHIND * longer),
            wide_limits[:, 0],
        )
        high = np.where(
            nearest_point > limits[:, 1],
            np.maximum(wide_limits[:, 1], nearest_point + BEHIND * longer),
            wide_limits[:, 1],
        )
        wide_limits = np.stack([low, high], axis=-1)
    return wide_limits, [f"part of {name}" if name in near_contacts else name for name in dict.fromkeys(far_contacts)]


def outside_note(contacts: Sequence[str]) -> str:
    """Say, behind other words of a title, whose walls are outside the frame."""
    return f"; outside the frame: {', '.join(contacts)}" if contacts else ""


def boundaries_of(run: xr.Dataset, view: list[BodyPath], radii: Floats) -> list[Boundary]:
    """Return where gaps of contacts close that read no more than where one body is.

    What many bodies meet in the same way is one wall; of bodies without radii that of the one that comes nearest.
    """
    if "model_toml" not in run or not view[0].is_space:
        return []
    model, walls_by_gap = model_of_record(run, None), dict[Any, tuple[float, Boundary]]()
    constant_values, factor, clock = _constants_and_units(model, view)
    span = max(float(np.ptp(path.x)) + float(np.ptp(path.y)) for path in view) or 1.0
    for contact, tree, path, radius in _single_body_gaps(model, view, radii):
        if path.depth_name in free_names(tree):
            gap_in_space = Gap(tree, (path.all_names,), constant_values, factor, clock)
            near_gaps, far_gaps = (
                gap_in_space.values_at(np.stack([*PROBES, depth])[None] * span, 0.0) for depth in DEPTHS
            )
            if (near_gaps != far_gaps).any():
                continue
            constant_values = {**constant_values, path.depth_name: 0.0}
        gap = Gap(tree, (path.names,), constant_values, factor, clock)
        values = gap.values_at(span * PROBES[None], float(view[0].times[0])) + radius
        key = (contact, *np.round((values - values[0]) / span, LIKE).tolist())
        if key not in walls_by_gap or values[0] > walls_by_gap[key][0]:
            walls_by_gap[key] = (float(values[0]), Boundary(gap, radius, contact))
    walls = {(*key[1:], round(value / span, LIKE)): wall for key, (value, wall) in walls_by_gap.items()}
    return [*walls.values()]


def draw_walls(walls: Sequence[Boundary], axes: Axes) -> None:
    """Draw the walls that stand still into a picture of paths, and say in its title which are outside."""
    standing_walls = [wall for wall in walls if not wall.moves]
    limits, far_contacts = widened_limits(np.array([axes.get_xlim(), axes.get_ylim()]), standing_walls, [0.0])
    for wall in standing_walls:
        wall.start(axes, limits)
    if standing_walls:
        axes.set(xlim=limits[0], ylim=limits[1])
        axes.set_title(axes.get_title(loc="left") + escaped_text(outside_note(far_contacts)), loc="left", fontsize=10)


def _single_body_gaps(model: Model, view: list[BodyPath], radii: Floats) -> Iterator[tuple[str, Node, BodyPath, float]]:
    """Yield gaps that read no more than where one body is, with its path and its radius."""
    owner = {name: k for k, path in enumerate(view[:MOST_BODIES]) for name in path.all_names if name}
    plane_axes, constant_names = dict(_plane_expressions(model, len(view))), constants(model).keys()
    for contact, tree in _contact_gaps(model):
        if tree in plane_axes:
            yield contact, Name(PLACE), replace(view[0], names=plane_axes[tree]), 0.0
            continue
        names_read = free_names(tree) - constant_names - {"t"}
        if names_read and names_read <= owner.keys() and len(bodies := {owner[name] for name in names_read}) == 1:
            body = bodies.pop()
            yield contact, tree, view[body], float(radii[body]) if radii.size else 0.0


def walls_in_space(run: xr.Dataset, view: list[BodyPath]) -> list[str]:
    """Return the contacts whose gaps read no more than where one body is in space."""
    if "model_toml" not in run:
        return []
    return [*dict.fromkeys(contact for contact, *_ in _single_body_gaps(model_of_record(run, None), view, np.zeros(0)))]


def _plane_expressions(model: Model, count: int) -> Iterator[tuple[Node, tuple[str, str]]]:
    """Yield what a model's plane shows beside plain coordinates, and on which of the axes: a gap may be the same."""
    elements = model.elements
    for pair in elements.pictured.plane[:count]:
        yield elements.expanded(pair[0]), (PLACE, "")
        yield elements.expanded(pair[1]), ("", PLACE)


def _constants_and_units(model: Model, view: list[BodyPath]) -> tuple[Mapping[str, float], float, float]:
    return constants(model), float(parse_unit(view[0].units).factor), float(model.time_unit.factor)


def _contact_gaps(model: Model) -> Iterator[tuple[str, Node]]:
    """Yield the gaps of contacts, of many bodies for each, and for each of the walls that a relation leads to."""
    for name, contact in model.statement.contacts.items():
        if not isinstance(contact.gap, Node):
            continue
        for element in _contact_elements(model, model.shapes.dims.get(name, ())):
            yield name, model.elements.expanded(at_element(contact.gap, element, model.shapes))


def _contact_elements(model: Model, dims: tuple[str, ...]) -> Iterator[Mapping[str, int]]:
    """Yield the elements of a contact, those of a relation where it leads from the first bodies to another dimension."""
    if not {*dims} & model.shapes.relations.keys():
        yield from model.shapes.index_combinations(dims)
    elif len(dims) == 1 and (relation := model.shapes.relations[dims[0]]).source != relation.target:
        is_drawn = (relation.first < MOST_BODIES) & (relation.second < MOST_BODIES)
        yield from ({dims[0]: link} for link in np.flatnonzero(is_drawn).tolist())


def disc_radii(run: xr.Dataset, view: list[BodyPath]) -> Floats:
    """Return the radii of bodies that meet each other as discs, shape (bodies,), in the axes' unit; empty if they do not.

    Where two bodies are at a distance d, their gap is d less both radii; three pairs tell the first one's.
    """
    no_radii, count = np.zeros(0), len(view)
    if "model_toml" not in run or not view[0].is_space or count < 2 or not all(path.names[0] for path in view):
        return no_radii
    model = model_of_record(run, None)
    required_pairs = {(0, body) for body in range(1, count)} | ({(1, 2)} if count > 2 else set())
    constant_values, factor, clock = _constants_and_units(model, view)
    sums = dict[tuple[int, int], float]()
    for pair, tree in _pair_gaps(model, view, required_pairs):
        names = tuple(view[body].all_names for body in pair)
        if free_names(tree) - constant_values.keys() != {name for pair_radii in names for name in pair_radii}:
            return no_radii
        gap = Gap(tree, names, constant_values, factor, clock)
        test_places = APART[:, : len(names[0])] * float(np.ptp(view[0].x) or 1.0)
        pair_radii = np.sqrt((test_places[1] ** 2).sum(axis=0)) - gap.values_at(test_places, float(view[0].times[0]))
        if not np.allclose(pair_radii, pair_radii[0], rtol=1e-9) or pair_radii[0] <= 0.0:
            return no_radii
        sums[pair] = float(pair_radii[0])
    if sums.keys() != required_pairs:
        return no_radii
    first = sums[0, 1] / 2.0 if count == 2 else (sums[0, 1] + sums[0, 2] - sums[1, 2]) / 2.0
    radii = np.array([first, *(sums[0, body] - first for body in range(1, count))])
    return radii if (radii > 0.0).all() else no_radii


def draw_discs(view: list[BodyPath], radii: Floats, axes: Axes) -> bool:
    """Draw bodies that have radii as large as they are, rings at the start and discs at the end; return whether they have."""
    drawn_bodies, size = view[:MOST_BODIES], 2.0 * radii[:MOST_BODIES]
    if not radii.size:
        return False
    colours = colours_of(view)[: len(drawn_bodies)]
    for row, style in (
        (0, {"facecolors": "none", "edgecolors": colours, "alpha": 0.5}),
        (-1, {"facecolors": colours, "edgecolors": "none", "alpha": 0.35}),
    ):
        places = np.array([[path.x[row], path.y[row]] for path in drawn_bodies])
        add_discs(axes, places, radii[:MOST_BODIES], linewidths=0.8, **style)
        for margin in (-size, size):  # what limits do not know of a collection in units of its own
            axes.update_datalim(places + margin[:, None] / 2.0)
    axes.autoscale_view()
    return True


def add_discs(axes: Axes, places: Floats, radii: Floats, **style: Any) -> Any:
    """Add discs of some radii, in the axes' unit, at places of shape (bodies, 2)."""
    from matplotlib.collections import EllipseCollection

    size, transform = 2.0 * radii, axes.transData
    discs = EllipseCollection(
        size, size, np.zeros(len(size)), units="xy", offsets=places, offset_transform=transform, **style
    )
    return axes.add_collection(discs, autolim=False)


def _pair_gaps(
    model: Model, view: list[BodyPath], required_pairs: set[tuple[int, int]]
) -> Iterator[tuple[tuple[int, int], Node]]:
    """Yield gaps between two bodies of a view, for the wanted pairs of them."""
    owner = {name: k for k, path in enumerate(view) for name in path.all_names}
    for name, contact in model.statement.contacts.items():
        if not isinstance(contact.gap, Node):
            continue
        if not (dims := model.shapes.dims.get(name, ())):
            tree = model.elements.expanded(contact.gap)
            bodies = sorted({owner[name_read] for name_read in free_names(tree) if name_read in owner})
            if tuple(bodies) in required_pairs:
                yield (bodies[0], bodies[1]), tree
        elif len(dims) == 1 and dims[0] in model.shapes.relations:
            relation = model.shapes.relations[dims[0]]
            if relation.source != relation.target or model.shapes.extent(relation.source).size != len(view):
                continue
            for link, pair in enumerate(zip(relation.first.tolist(), relation.second.tolist(), strict=True)):
                if pair in required_pairs:
                    yield pair, model.elements.expanded(at_element(contact.gap, {dims[0]: link}, model.shapes))


WIDTHS = {"links": 3.0, "springs": 1.2, "threads": 0.9, "lines": 1.5}
NAMED = ("links", "springs", "threads")  # by a model's plane
STIFF = 0.05  # change of its length, up to which a spring looks like a bar
MOST_COILED = 40  # springs of a relation; more would hide each other
ANCHOR: dict[str, Any] = {"color": "0.35", "marker": "^", "markersize": 5, "linestyle": "none", "zorder": 2}
AT_START: dict[str, Any] = {"color": "0.6", "linewidth": 1.0, "zorder": 1.5}
COILS = 8  # of a spring
COIL = 0.025  # of the longer side, that a coil goes to either side
STRAIGHT = 0.12  # of a spring at either end


@dataclass
class Fastening:
    """Rods, springs or threads from body to body, or to a fixed place.

    Attributes
    ----------
    kind : {"links", "springs", "threads", "lines"}
    ends : ndarray of int, shape (m, 2)
        Numbers of bodies, after these of anchors, -1 for the origin.
    anchors : ndarray, shape (n, 2) or (n, 3)
        Fixed places, in the axes' unit, with their depth where there is one.
    """

    kind: str
    ends: NDArray[np.int_]
    anchors: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    _coil: float = 0.0
    _lines: Any = None

    def start(self, axes: Axes, limits: Floats) -> None:
        """Prepare the lines."""
        from matplotlib.collections import LineCollection

        self._coil = COIL * float(np.ptp(limits, axis=-1).max())
        self._lines = axes.add_collection(
            LineCollection([], colors="0.45", linewidths=WIDTHS[self.kind]), autolim=False
        )
        if self.anchors.size:
            axes.plot(*self.anchors[:, :2].T, **ANCHOR)

    def place_lines(self, places: Floats) -> Any:
        """Put the lines between the places of bodies, the last of which is the origin."""
        self._lines.set_segments(self.segments(places, self._coil))
        return self._lines

    def segments(self, places: Floats, coil: float) -> Sequence[Any]:
        """Return the lines between the places of bodies, anchors and the origin; of the former the last is the origin."""
        endpoints = np.concatenate([places[:-1], self.anchors[:, :2], places[-1:]])[self.ends]
        is_coiled = self.kind == "springs"
        return [spring_zigzag(start, end, coil) if is_coiled else np.stack([start, end]) for start, end in endpoints]


def spring_zigzag(start: Floats, end: Floats, coil: float) -> Floats:
    """Return the zigzag of a spring, shape (n, 2), from one end to the other."""
    axis_vector = end - start
    length = float(np.hypot(*axis_vector)) or 1.0
    part = np.concatenate([[0.0], np.linspace(STRAIGHT, 1.0 - STRAIGHT, 2 * COILS + 1), [1.0]])
    side = np.zeros(part.size)
    side[2:-2] = coil * np.where(np.arange(part.size - 4) % 2, -1.0, 1.0)
    across = np.array([-axis_vector[1], axis_vector[0]]) / length
    points: Floats = start + part[:, None] * axis_vector + side[:, None] * across
    return points


def fastenings_of(run: xr.Dataset, view: list[BodyPath]) -> list[Fastening]:
    """Return what the model fastens its bodies by: as its plane names it, or by its relations."""
    if "model_toml" not in run:
        return []
    model = model_of_record(run, None)
    pictured = model.elements.pictured
    if not pictured.plane:
        return _relation_fastenings(model, view)
    number = {name: k for k, name in enumerate(pictured.bodies[: len(view)])} | {ORIGIN: -1}
    named_fastenings = []
    for kind in NAMED:
        ends = [[number[end] for end in pair] for pair in getattr(pictured, kind) if {*pair} <= number.keys()]
        if ends:
            named_fastenings.append(Fastening(kind, np.array(ends)))
    return named_fastenings


def _relation_fastenings(model: Model, view: list[BodyPath]) -> list[Fastening]:
    """Return the links of relations between bodies that are a table or neighbours, not every two; and from bodies to fixed places.

    A relation that a constraint holds is of rods. One that has a potential is of springs; these are lines where they are
    many, or so stiff that none changes its length by what could be seen: the bars of a truss.
    """
    body, link_fastenings = view[0].dims, list[Fastening]()
    vectors = (
        part.dims for part in model.statement.coordinates.values() if len(part.dims) == 2 and part.dims[0] == body
    )
    axis = next(vectors, ("", ""))[1]
    constrained_names = {dim for name in model.statement.constraints for dim in model.shapes.dims.get(name, ())}
    spring_names = {
        force.over for force in model.statement.forces.values() if force.potential is not None
    } - constrained_names
    for name, declared in model.statement.relations.items():
        relation = model.shapes.relations[name]
        between = {relation.source, relation.target}
        if body not in between or not (declared.table or declared.neighbours or name in constrained_names):
            continue
        count, anchors = min(len(view), MOST_BODIES), np.zeros((0, 2))
        ends = np.stack([relation.first, relation.second], axis=-1)
        bodies = np.array([end == body for end in (relation.source, relation.target)])
        ends = ends[(ends < count)[:, bodies].all(axis=-1)]
        if not bodies.all():
            anchors = _fixed_places(model, (between - {body}).pop(), axis, view[0])
            ends[:, ~bodies] += count
        if not bodies.all() and not anchors.size:
            continue
        is_coiled = (
            name in spring_names and len(ends) <= MOST_COILED and _largest_stretch(view[:count], ends, anchors) > STIFF
        )
        link_fastenings.append(
            Fastening("links" if name in constrained_names else "springs" if is_coiled else "lines", ends, anchors)
        )
    return link_fastenings


def _fixed_places(model: Model, dim: str, axis: str, path: BodyPath) -> Floats:
    """Return where the elements of a dimension are that has one parameter of positions; none if none or several could be meant."""
    length, shapes, constant_values = parse_unit(path.units), model.shapes, constants(model)
    position_parameters = [
        name
        for name, dims in shapes.dims.items()
        if dims == (dim, axis)
        and (parameter := model.elements.statement.parameters.get(shapes.elements(name)[0])) is not None
        and parameter.quantity.unit.dimension == length.dimension
    ]
    if len(position_parameters) != 1:
        return np.zeros((0, 2))
    labels = [split_element_name(name)[1][-1] for name in path.all_names]
    return np.array(
        [
            [
                constant_values[join_element_name(position_parameters[0], [shapes.extent(dim).label(k), label])]
                / float(length.factor)
                for label in labels
            ]
            for k in range(shapes.extent(dim).size)
        ]
    )


def _largest_stretch(view: list[BodyPath], ends: NDArray[np.int_], anchors: Floats) -> float:
    """Return how much the length of a link changes, as a part of the longest that it has: the most of all links."""
    largest, places = 0.0, [path.points for path in view] + [anchor[:, None] for anchor in anchors]
    for first, second in ends.tolist():
        first_path, second_path = places[first], places[second]
        lengths = np.sqrt(((second_path - first_path) ** 2).sum(axis=0))
        largest = max(largest, float(np.ptp(lengths) / (lengths.max() or 1.0)))
    return largest


def draw_at_start(run: xr.Dataset, view: list[BodyPath], axes: Axes) -> bool:
    """Draw what joins the bodies of a plane where the motion starts, as thin grey lines; return whether anything does."""
    drawn_bodies = view[:MOST_BODIES]
    places = np.array([[path.x[0], path.y[0]] for path in drawn_bodies] + [[0.0, 0.0]])
    coil = COIL * float(np.ptp(places, axis=0).max())
    parts = fastenings_of(run, drawn_bodies)
    for part in parts:
        for segment in part.segments(places, coil):
            axes.plot(*segment.T, **AT_START)
        if part.anchors.size:
            axes.plot(*part.anchors.T, **ANCHOR)
    return any(part.ends.size for part in parts)
