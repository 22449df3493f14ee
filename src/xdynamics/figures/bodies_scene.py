"""Bodies in the plane as a film shows them: dots or discs with their trails, links and walls.

Bodies in three dimensions as a film shows them: two views of one scale, side by side or one over the other.

Bodies that turn, in space: each by its points, and by the ellipsoid that has its mass and its moments of inertia.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Name, Node, expand
from xdynamics.expressions.evaluation import evaluate
from xdynamics.figures.boundaries import (
    Boundary,
    Fastening,
    add_discs,
    boundaries_of,
    disc_radii,
    fastenings_of,
    outside_note,
    walls_in_space,
    widened_limits,
)
from xdynamics.figures.curves import plotted_lines, recorded_model
from xdynamics.figures.framing import PROFILE, Frame, double_frame_size, frame_of, frame_size, padded_limits
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import COLOURS, LETTERS, draw_line, legible
from xdynamics.figures.plane import (
    MOST_BODIES,
    MOST_ENDS,
    SMALL,
    BodyPath,
    brief_names,
    colours_of,
    frame_of_view,
    label_plane,
    leaving_bodies_note,
    names_at_bodies,
    omitted_bodies_note,
    spaces,
)
from xdynamics.model import Model
from xdynamics.model.body_sections import AXES, Body, Triple, position, scalar_part, vector_part
from xdynamics.model.constraint_consistency import parameter_values
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import join_element_name

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

LARGE = 8.0  # points of a name on a disc
BESIDE = (4.0, 3.0)  # points from the middle of a dot to its name
LOOKED_AT = 9  # times at which walls that move are looked for
MOST_TRAILED = 1000  # points of a trail
MOST_TRAILS = 30  # bodies with a trail; many would hide each other


@dataclass
class BodiesScene:
    """Bodies in the plane.

    Attributes
    ----------
    view : list of BodyPath
    time : DataArray
        Recorded times, in whose unit the title says when a body leaves.
    trail : float, optional
        How far back trails go; a tenth of the run.
    fastenings : list of Fastening
        Rods, springs and threads that the model names.
    boundaries : list of Boundary
        Walls and floors, where gaps are zero.
    radii : ndarray, shape (bodies,)
        Of discs, in the axes' unit; empty where bodies are dots.
    frame : Frame, optional
        Of the motion; found from the view if not given.
    fixed_limits : ndarray, shape (2, 2), optional
        What the axes hold, across and up; the motion and walls nearby if not given.
    is_named : bool
        Whether there is a legend, where bodies have names.
    """

    view: list[BodyPath]
    time: xr.DataArray
    trail: float | None = None
    fastenings: Sequence[Fastening] = ()
    boundaries: Sequence[Boundary] = ()
    radii: Floats = field(default_factory=lambda: np.zeros(0))
    frame: Frame | None = None
    fixed_limits: Floats | None = None
    is_named: bool = True
    _dots: Any = None
    _trails: Any = None
    _tags: list[Any] = field(default_factory=list)

    @property
    def times(self) -> Floats:
        """The times of the first path."""
        return self.view[0].times

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as the motion."""
        if not self.view[0].is_space:
            return PROFILE
        return frame_size(self.limits, self.legend_names)

    @property
    def legend_names(self) -> list[str]:
        """What bodies are called, where there are several, and not too many for a legend."""
        return _names_in_legend([body.label for body in self.view])

    @cached_property
    def _motion_frame(self) -> Frame:
        """The motion of all bodies that are drawn, but for those that fly off."""
        return frame_of_view(self.view) if self.frame is None else self.frame

    @property
    def limits(self) -> Floats:
        """What the axes hold, shape (2, 2)."""
        return self._limits_and_far_walls[0] if self.fixed_limits is None else self.fixed_limits

    @property
    def far_walls(self) -> list[str]:
        """Contacts whose walls are outside the frame."""
        return self._limits_and_far_walls[1]

    @cached_property
    def _limits_and_far_walls(self) -> tuple[Floats, list[str]]:
        """What the axes hold: the motion, no side much shorter than the other, and walls nearby; and which walls they do not."""
        low, high = self._motion_frame.limits.T
        if any((part.ends < 0).any() for part in self.fastenings):  # to the origin
            low, high = np.minimum(low, 0.0), np.maximum(high, 0.0)
        for anchor in (anchor[:2] for part in self.fastenings for anchor in part.anchors):
            low, high = np.minimum(low, anchor), np.maximum(high, anchor)
        largest_radius = float(self.radii.max(initial=0.0))
        low, high = low - largest_radius, high + largest_radius
        longer = float(max(high - low)) or 1.0 if self.view[0].is_space else np.where(high > low, high - low, 1.0)
        limits = padded_limits(low, high, longer)
        times = np.linspace(float(self.times[0]), float(self.times[-1]), LOOKED_AT).tolist()
        return widened_limits(limits, self.boundaries, times)

    def start(self, axes: Axes) -> str:
        """Prepare dots, links and trails; both axes have one scale, that holds the whole motion."""
        from matplotlib.collections import LineCollection

        view, (across, up) = self.view, self.limits
        axes.set(xlim=across, ylim=up, aspect="equal" if view[0].is_space else "auto")
        label_plane(view, axes)
        drawn_bodies, colours = view[:MOST_BODIES], colours_of(view)
        has_trails = len(drawn_bodies) <= MOST_TRAILS
        trails = LineCollection(
            [], colors=colours[: len(drawn_bodies)], linewidths=1.2 if has_trails else 0.0, alpha=0.6
        )
        self._trails = axes.add_collection(trails, autolim=False)
        for fastening in self.fastenings:
            fastening.start(axes, self.limits)
        for wall in self.boundaries:
            wall.start(axes, self.limits)
        self._dots = self._prepare_bodies(axes, colours[: len(drawn_bodies)])
        _add_body_legend(axes, self.legend_names, colours, "o", is_drawn=self.is_named, handletextpad=0.2)
        self._tags = self._prepare_name_tags(axes, colours)
        return f"{self.title_notes}{outside_note(self.far_walls)}"

    @property
    def title_notes(self) -> str:
        """What the title says of the bodies."""
        drawn_bodies = self.view[:MOST_BODIES]
        scale = f", colours from {drawn_bodies[0].label} to {drawn_bodies[-1].body}" if self._is_scaled else ""
        return f"{omitted_bodies_note(self.view)}{leaving_bodies_note(self._motion_frame, self.view, self.time)}{scale}"

    @property
    def _is_scaled(self) -> bool:
        """Whether there are so many bodies that colours alone tell them apart."""
        return len(self.view) > MOST_ENDS and bool(brief_names(self.view))

    def _prepare_name_tags(self, axes: Axes, colours: list[str]) -> list[Any]:
        """Prepare the names that go along with bodies: on discs, or beside dots."""
        discs, tags = bool(self.radii.size), []
        style: dict[str, Any] = {"textcoords": "offset points", "zorder": 4, "annotation_clip": True}
        style |= {"ha": "center", "va": "center", "fontsize": LARGE} if discs else {"fontsize": SMALL}
        for name, colour in zip(names_at_bodies(self.view), colours, strict=False):
            ink = "white" if discs else legible(colour, LETTERS)
            tags.append(axes.annotate(name, (0.0, 0.0), (0.0, 0.0) if discs else BESIDE, color=ink, **style))
        return tags

    def _prepare_bodies(self, axes: Axes, colours: list[str]) -> Any:
        """Prepare the bodies: discs as large as they are, or dots."""
        unplaced = np.full((len(colours), 2), np.nan)
        if not self.radii.size:
            area = 64.0 if len(colours) <= MOST_TRAILS else 16.0
            return axes.scatter(unplaced[:, 0], unplaced[:, 1], s=area, c=colours, zorder=3)
        radii = self.radii[: len(colours)]
        return add_discs(axes, unplaced, radii, facecolors=colours, edgecolors="none", zorder=3)

    def move_to(self, time: float) -> list[Any]:
        """Put dots, links and trails where they are."""
        drawn_bodies = self.view[:MOST_BODIES]
        places = np.array([[np.interp(time, body.times, part) for part in (body.x, body.y)] for body in drawn_bodies])
        self._dots.set_offsets(places)
        places_and_origin = np.vstack([places, np.zeros((1, 2))])  # the last is the origin
        moved_artists = [part.place_lines(places_and_origin) for part in self.fastenings] + [
            part.move_to(time) for part in self.boundaries if part.moves
        ]
        if len(drawn_bodies) <= MOST_TRAILS:
            begin = time - _trail_duration(self.times, self.trail)
            self._trails.set_segments([_trail(body, begin, time) for body in drawn_bodies])
        for tag, body_place in zip(self._tags, places, strict=False):
            tag.xy = tuple(body_place)
        return [self._trails, *moved_artists, self._dots, *self._tags]


def _names_in_legend(names: list[str]) -> list[str]:
    """Return what bodies are called, where there are several, and not too many for a legend."""
    return names if 1 < len(names) <= MOST_NAMED and all(names) else []


def _add_body_legend(
    axes: Axes, names: list[str], colours: Sequence[str], style: str, *, is_drawn: bool = True, **options: Any
) -> None:
    """Name bodies beside their axes."""
    for name, colour in zip(names, colours, strict=False):
        draw_line(axes, [], [], style, colour, name, 1.5, 6.0)
    if names and is_drawn:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False, **options)


def _trail_duration(times: Floats, trail: float | None) -> float:
    """Return how far back trails go: a tenth of the run, where nothing is said."""
    return 0.1 * float(np.ptp(times)) if trail is None else trail


def _trail(body: BodyPath, begin: float, end: float) -> Floats:
    """Return where a body was from one time to another, shape (n, 2): all points of its path, or some of very many."""
    first, last = (int(row) for row in np.searchsorted(body.times, (begin, end)))
    row_spacing = max(1, (last - first) // MOST_TRAILED)
    times = np.concatenate([[max(begin, float(body.times[0]))], body.times[first:last:row_spacing], [end]])
    return np.stack([np.interp(times, body.times, body.x), np.interp(times, body.times, body.y)], axis=-1)


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
        undrawn = f"; not drawn: {', '.join(self.undrawn)}" if self.undrawn else ""
        return f"{self.views[0].title_notes}{outside_note([*far_contacts])}{undrawn}"

    def move_to(self, time: float) -> list[Any]:
        """Put everything where it is, in both."""
        return [artist for view in self.views for artist in view.move_to(time)]


def paths_in_two_views(views: list[list[BodyPath]]) -> tuple[list[BodyPath], list[BodyPath], bool] | None:
    """Return the paths in two views of bodies that are seen from three sides, and whether they share the axis across.

    The axis that both have is the longest side of the motion.
    """
    if (paths := next(spaces(views), None)) is None:
        return None
    frame = frame_of([path.points for path in paths], [path.times for path in paths])
    longest = int(np.argmax(frame.sides))
    first, second = ([_turned_path(path, *pair) for path in paths] for pair in SIDES[longest])
    return first, second, longest == 0


def _turned_path(path: BodyPath, across: int, up: int) -> BodyPath:
    """Return a path in space as a view of two of its axes shows it, with what it does not show as its depth."""
    order = [across, up, 3 - across - up]
    titles, names = (path.across, path.up, path.depth_axis), (*path.names, path.depth_name)
    (x, y, depth), (name, up_name, depth_name) = path.points[order], (names[k] for k in order)
    across_axis, up_axis, depth_axis = (titles[k] for k in order)
    turned = replace(path, across=across_axis, up=up_axis, x=x, y=y, names=(name, up_name))
    return replace(turned, depth=depth, depth_axis=depth_axis, depth_name=depth_name)


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


AZIMUTH, ELEVATION = np.radians((-60.0, 20.0))  # of the eye, about the vertical from x, and above the level
RIGHT = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
UP = np.array([-np.sin(ELEVATION) * np.cos(AZIMUTH), -np.sin(ELEVATION) * np.sin(AZIMUTH), np.cos(ELEVATION)])
ROUND = 49  # points of an ellipse
LIMIT_TIMES = 200  # times that the limits are found from
FAR = 3.0  # sizes of the bodies together: whoever goes farther is followed


@dataclass(frozen=True)
class Solid:
    """One body: where it is, and what is drawn of it in its own axes, m.

    Attributes
    ----------
    name : str
    places : ndarray, shape (n, 3)
        Of its origin, along the times.
    attitudes : ndarray, shape (n, 4)
        Quaternions, scalar first.
    arms : ndarray, shape (k, 3)
        Its points, to which lines go from its origin.
    outline : ndarray, shape (3, m, 3)
        Three ellipses; none of a body with a pivot, whose mass is not known.
    """

    name: str
    places: Floats
    attitudes: Floats
    arms: Floats
    outline: Floats

    def lines_at(self, times: Floats, time: float) -> tuple[Floats, list[Floats]]:
        """Return where its origin is, and its lines in space."""
        origin = _vectors_at_time(times, self.places, time)
        q0, *vector = _vectors_at_time(times, self.attitudes, time)
        q = np.array(vector)
        # between rows a quaternion is interpolated, and no longer of unit length
        length = float(np.hypot(q0, np.linalg.norm(q)))
        q0, q = q0 / length, q / length

        def rotated_to_space(vectors: Floats) -> Floats:
            return origin + vectors + 2.0 * np.cross(q, np.cross(q, vectors) + q0 * vectors)

        ends = rotated_to_space(self.arms) if len(self.arms) else self.arms
        return origin, [
            *(np.stack([origin, end]) for end in ends),
            *(rotated_to_space(ellipse) for ellipse in self.outline),
        ]


@dataclass
class Mechanism:
    """Bodies that turn, seen from the side and from above, by parallel rays; those that go far are followed.

    Attributes
    ----------
    times : ndarray, shape (n,)
    solids : list of Solid
    trail : float, optional
        How far back trails of centres go; a tenth of the run.
    """

    times: Floats
    solids: list[Solid]
    trail: float | None = None
    _lines: Any = None
    _dots: Any = None
    _trails: Any = None

    @property
    def size(self) -> tuple[float, float]:
        """A frame as wide and as high as the motion."""
        return frame_size(self._motion_limits, self._legend_names)

    @property
    def _legend_names(self) -> list[str]:
        """What bodies are called, where there are several, and not too many for a legend."""
        return _names_in_legend([solid.name for solid in self.solids])

    @cached_property
    def follows_bodies(self) -> bool:
        """Whether the picture goes along with the bodies."""
        middle = np.mean([solid.places for solid in self.solids], axis=0)
        return bool(np.ptp(middle, axis=0).max() > FAR * self._initial_size)

    @property
    def _initial_size(self) -> float:
        """The size of all bodies together at the start."""
        origins, lines = zip(*(solid.lines_at(self.times, float(self.times[0])) for solid in self.solids), strict=True)
        points = np.concatenate([np.array(origins), *(line for part in lines for line in part)])
        return float(np.ptp(points, axis=0).max())

    def _middle(self, time: float) -> Floats:
        """Return what the picture is centred on."""
        if not self.follows_bodies:
            return np.zeros(3)
        middle: Floats = np.mean([_vectors_at_time(self.times, solid.places, time) for solid in self.solids], axis=0)
        return middle * [1.0, 1.0, 0.0]

    @cached_property
    def _motion_limits(self) -> Floats:
        """What the axes hold, shape (2, 2)."""
        projections = []
        for time in np.linspace(float(self.times[0]), float(self.times[-1]), LIMIT_TIMES).tolist():
            middle = self._middle(time)
            for solid in self.solids:
                origin, lines = solid.lines_at(self.times, time)
                projections.append(projected(np.concatenate([origin[None], *lines]) - middle))
        points = np.concatenate(projections)
        low, high = points.min(axis=0), points.max(axis=0)
        longer = float(max(high - low))
        return padded_limits(low, high, longer)

    def start(self, axes: Axes) -> str:
        """Prepare lines, dots and trails."""
        from matplotlib.collections import LineCollection

        across, up = self._motion_limits
        axes.set(xlim=across, ylim=up, aspect="equal", xlabel="across (m)", ylabel="up (m)")
        colours = [COLOURS[k % len(COLOURS)] for k in range(len(self.solids))]
        self._trails = axes.add_collection(LineCollection([], colors=colours, linewidths=1.0, alpha=0.5), autolim=False)
        self._lines = axes.add_collection(LineCollection([], linewidths=1.4), autolim=False)
        unplaced = np.full(len(colours), np.nan)
        self._dots = axes.scatter(unplaced, unplaced, s=16.0, c=colours, zorder=3)
        _add_body_legend(axes, self._legend_names, colours, "-")
        return ", going along" if self.follows_bodies else ""

    def move_to(self, time: float) -> list[Any]:
        """Put everything where it is."""
        middle = self._middle(time)
        begin = time - _trail_duration(self.times, self.trail)
        dots, lines, colours, trails = [], [], [], []
        for k, solid in enumerate(self.solids):
            origin, body_lines = solid.lines_at(self.times, time)
            dots.append(projected(origin - middle))
            lines += [projected(line - middle) for line in body_lines]
            colours += [COLOURS[k % len(COLOURS)]] * len(body_lines)
            passed = np.append(solid.places[(self.times > begin) & (self.times < time)], origin[None], axis=0)
            trails.append(projected(passed - middle))
        self._dots.set_offsets(np.array(dots))
        self._lines.set_segments(lines)
        self._lines.set_color(colours)
        self._trails.set_segments(trails)
        return [self._trails, self._lines, self._dots]


def projected(points: Floats) -> Floats:
    """Return points in space as they are seen: across and up."""
    return np.stack([points @ RIGHT, points @ UP], axis=-1)


def mechanism_of(run: xr.Dataset, trail: float | None) -> Mechanism | None:
    """Return the bodies of a run that turn, where each is one and is recorded; None if there are none."""
    model = recorded_model(run)
    bodies: Mapping[str, Body] = model.statement.bodies if model is not None else {}
    if model is None or not bodies or any(body.dims for body in bodies.values()):
        return None
    names = [name for body, part in bodies.items() for name in _recorded_names(body, part)]
    if not all(name in run for name in names):
        return None
    times, lines = plotted_lines(run, *names)
    values_by_name = dict(zip(names, lines, strict=True))
    return Mechanism(times, [_solid_of(model, name, body, values_by_name) for name, body in bodies.items()], trail)


def _recorded_names(name: str, body: Body) -> Iterator[str]:
    yield scalar_part(name)
    for vector_name in (vector_part(name), *(() if body.pivot else (position(name),))):
        yield from (join_element_name(vector_name, [axis]) for axis in AXES)


def _solid_of(model: Model, name: str, body: Body, values_by_name: Mapping[str, Floats]) -> Solid:
    constant_values = parameter_values(model.elements.statement)

    def evaluated_number(node: Node) -> float:
        return evaluate(expand(node, model.elements.statement.definitions), constant_values)

    def evaluated_point(triple: Triple) -> Floats:
        return np.array([evaluated_number(part) for part in triple])

    q0, *components = (values_by_name[part] for part in _recorded_names(name, body))
    attitudes = np.stack([q0, *components[:3]], axis=-1)
    places = (
        np.broadcast_to(evaluated_point(body.pivot), (len(q0), 3)) if body.pivot else np.stack(components[3:], axis=-1)
    )
    arms = [evaluated_point(triple) for triple in body.points.values()]
    for joint in model.statement.joints.values():
        pairs = zip(joint.bodies, joint.at, strict=True)
        arms += [
            evaluated_point(joint_point)
            for owner, joint_point in pairs
            if owner == name and not isinstance(joint_point, Name)
        ]
    inertia = np.array([[evaluated_number(entry) for entry in row] for row in body.inertia])
    matrix = inertia if body.has_products else np.diag(inertia[0])
    outline = np.zeros((0, ROUND, 3)) if body.mass is None else ellipses(matrix, evaluated_number(body.mass))
    return Solid(name, places, attitudes, np.array([arm for arm in arms if arm.any()]).reshape(-1, 3), outline)


def ellipses(inertia: Floats, mass: float) -> Floats:
    """Return three ellipses about the principal axes of the ellipsoid of even density with a mass and an inertia, m.

    Its half axes are sqrt(5 (I2 + I3 - I1)/(2 m)), and so on; shape (3, 49, 3).
    """
    moments, axes = np.linalg.eigh(inertia)
    halves = np.sqrt(np.maximum(2.5 / mass * (moments.sum() - 2.0 * moments), 0.0))
    angle = np.linspace(0.0, 2.0 * np.pi, ROUND)
    rings = [np.roll([np.cos(angle), np.sin(angle), np.zeros(ROUND)], k, axis=0).T for k in range(3)]
    return np.stack([(halves * ring) @ axes.T for ring in rings])


def _vectors_at_time(times: Floats, values: Floats, time: float) -> Floats:
    """Return vectors at a time, straight between points of their lines."""
    return np.array([np.interp(time, times, part) for part in values.T])
