"""What joins bodies: rods, springs and threads that a model names, and the links of its relations."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.figures.body_names import MOST_BODIES
from xdynamics.figures.body_paths import BodyPath
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.model.parts import ORIGIN
from xdynamics.shapes import join_element_name, split_element_name
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

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
        pairs = self.endpoint_places(places)[self.ends]
        self._lines.set_segments(
            [spring_zigzag(start, end, self._coil) for start, end in pairs] if self.kind == "springs" else pairs
        )
        return self._lines

    def endpoint_places(self, places: Floats) -> Floats:
        """Return the places of bodies, anchors and the origin, of which the first and the last are given."""
        return np.concatenate([places[:-1], self.anchors[:, :2], places[-1:]])


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
    pictured = model.pictured
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
    vectors = (part.dims for part in model.shaped.coordinates.values() if len(part.dims) == 2 and part.dims[0] == body)
    axis = next(vectors, ("", ""))[1]
    constrained_names = {dim for name in model.shaped.constraints for dim in model.shapes.dims.get(name, ())}
    spring_names = {
        force.over for force in model.shaped.forces.values() if force.potential is not None
    } - constrained_names
    for name, declared in model.shaped.relations.items():
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
        and (parameter := model.statement.parameters.get(shapes.elements(name)[0])) is not None
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
        for start, end in part.endpoint_places(places)[part.ends]:
            axes.plot(
                *(spring_zigzag(start, end, coil) if part.kind == "springs" else np.stack([start, end])).T, **AT_START
            )
        if part.anchors.size:
            axes.plot(*part.anchors.T, **ANCHOR)
    return any(part.ends.size for part in parts)
