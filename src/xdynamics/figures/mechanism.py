"""Bodies that turn, in space: each by its points, and by the ellipsoid that has its mass and its moments of inertia."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.expressions import Name, Node, expand
from xdynamics.expressions.evaluation import evaluate
from xdynamics.figures.curves import plotted_lines
from xdynamics.figures.frame_sizes import MARGIN, SLIM, frame_size
from xdynamics.figures.line_panels import MOST_NAMED
from xdynamics.figures.marks import COLOURS, escaped_text
from xdynamics.model import Model
from xdynamics.model.bodies import position, scalar_part, vector_part
from xdynamics.model.body_sections import AXES, Body, Triple
from xdynamics.model.contact_consistency import parameter_values
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.shapes import join_element_name

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

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
        return [solid.name for solid in self.solids] if 1 < len(self.solids) <= MOST_NAMED else []

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
        half = np.maximum((high - low) / 2.0 + MARGIN * longer, SLIM * longer)
        return np.stack([(low + high) / 2.0 - half, (low + high) / 2.0 + half], axis=-1)

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
        for name, colour in zip(self._legend_names, colours, strict=False):
            axes.plot([], [], "-", color=colour, label=escaped_text(name))
        if self._legend_names:
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
        return ", going along" if self.follows_bodies else ""

    def move_to(self, time: float) -> list[Any]:
        """Put everything where it is."""
        middle = self._middle(time)
        trail_duration = 0.1 * float(np.ptp(self.times)) if self.trail is None else self.trail
        dots, lines, colours, trails = [], [], [], []
        for k, solid in enumerate(self.solids):
            origin, body_lines = solid.lines_at(self.times, time)
            dots.append(projected(origin - middle))
            lines += [projected(line - middle) for line in body_lines]
            colours += [COLOURS[k % len(COLOURS)]] * len(body_lines)
            passed = np.append(
                solid.places[(self.times > time - trail_duration) & (self.times < time)], origin[None], axis=0
            )
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
    model = model_of_record(run, None) if "model_toml" in run else None
    bodies: Mapping[str, Body] = model.shaped.bodies if model is not None else {}
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
    constant_values = parameter_values(model.statement)

    def evaluated_number(node: Node) -> float:
        return evaluate(expand(node, model.statement.definitions), constant_values)

    def evaluated_point(triple: Triple) -> Floats:
        return np.array([evaluated_number(part) for part in triple])

    q0, *components = (values_by_name[part] for part in _recorded_names(name, body))
    attitudes = np.stack([q0, *components[:3]], axis=-1)
    places = (
        np.broadcast_to(evaluated_point(body.pivot), (len(q0), 3)) if body.pivot else np.stack(components[3:], axis=-1)
    )
    arms = [evaluated_point(triple) for triple in body.points.values()]
    for joint in model.shaped.joints.values():
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
