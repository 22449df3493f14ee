"""Where bodies are in the plane: the pairs that a model names, else its coordinates of one unit.

Where bodies are in three dimensions: what neither lines in time nor a plane can show.

Where one body of a picture is, at times that bend as its motion does.

How pictures tell bodies apart: a colour for each, and names in a legend, at their places, or along a scale of colours.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of, free_names, text_of
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import Name
from xdynamics.faults import InputError
from xdynamics.figures.companions import Overlay
from xdynamics.figures.curves import (
    curve_in_plane,
    recorded_model,
    refined_line,
    rows_along,
    ways_along,
    with_role,
)
from xdynamics.figures.event_marks import IN_LEGEND, concerned_elements, event_kinds, legend_label
from xdynamics.figures.framing import Frame, frame_of, leaving_note, whole_frame
from xdynamics.figures.line_panels import GREY, MOST_NAMED, run_dashes
from xdynamics.figures.marks import (
    COLOURS,
    LETTERS,
    draw_isolated,
    draw_line,
    escaped_text,
    label_panel,
    legible,
    shared_power,
    shortened_names,
    straight_lines_note,
    subpanels,
    superscript,
    typeset,
)
from xdynamics.figures.sheet import EVENT, named_elsewhere
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.units import NONE, parse_unit, spell

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Floats = NDArray[np.float64]
Axis = tuple[str, tuple[str, dict[str, int]]]  # what it is called; a coordinate, and its place along further dimensions

POSITIONS = ("coordinate", "state")  # roles
AXES = ("x", "y", "z")
UPRIGHT = ("y", "z", "h", "height")  # coordinates that are drawn upright where they are alone
# `x` and `2`, `y` and `bob`, `z` and `s` of a sprung mass
_STEM = re.compile(r"([a-z]+?)_?(\d+|(?<=_)[a-z]\w*|(?<=^[xyz])[a-z])", re.IGNORECASE | re.ASCII)
_AXIS = re.compile(r"(?:(\w+)_)?[xyz]", re.ASCII)  # `x`, `bob_x`
SEEN = 3  # coordinates of one unit, which are seen from three sides
LONGEST = 30  # characters of an expression that an axis shows
FLATTEST = 8.0  # ratio of the sides, from which on a path has a scale for each
SLENDER, SLIM = 2.0, 3.0  # ratios of the sides, from which on few numbers fit below, and only upright ones
THIN = 1e-3  # of the longer side, under which a view is a line along an axis


def views(run: xr.Dataset) -> list[list[BodyPath]]:
    """Return the paths in each view of the plane: all bodies together, or two coordinates per view."""
    model = recorded_model(run)
    if model is not None and model.elements.pictured.plane:
        return [_model_paths(run, model)]
    if model is not None and model.shapes.dims:
        return _body_views(run, model)
    groups: dict[str, list[str]] = {}
    for name in with_role(run, "coordinate"):
        units = str(run.variables[name].attrs.get("units"))
        if run.variables[name].dims == ("step",) and is_length(units):
            groups.setdefault(units, []).append(name)
    pairs = []
    for units, names in groups.items():
        if 2 <= len(names) <= SEEN and not are_of_one_kind(names):
            for across, up in combinations(names, 2):
                (times, x), (_, y) = _path_line(run, across), _path_line(run, up)
                if min(np.ptp(x), np.ptp(y)) > THIN * max(np.ptp(x), np.ptp(y)):
                    pairs.append([BodyPath(across, up, units, times, x, y, names=(across, up))])
    return pairs


def state_planes(run: xr.Dataset) -> list[list[BodyPath]]:
    """Return the planes of two or three first-order states of a run without coordinates, taken by twos.

    One that the model names is not among them.
    """
    names = [name for name in with_role(run, "state") if run.variables[name].dims == ("step",)]
    if with_role(run, "coordinate") or not 2 <= len(names) <= SEEN:
        return []
    model = recorded_model(run)
    model_pairs = [] if model is None else [{*map(text_of, pair)} for pair in model.elements.pictured.plane]
    times, lines = _path_lines(run, names)
    units = [str(run.variables[name].attrs["units"]) for name in names]
    return [
        [BodyPath(names[i], names[j], units[i], times, lines[i], lines[j], up_units=units[j])]
        for i, j in combinations(range(len(names)), 2)
        if {names[i], names[j]} not in model_pairs
    ]


def are_of_one_kind(names: list[str]) -> bool:
    """Tell whether coordinates are one and the same of several bodies, and no axes: `x1` and `x2`, `x_left` and `x_right`.

    Examples
    --------
    >>> pairs = ["x1", "x2"], ["y_cart", "y_bob"], ["zs", "zu"], ["r_x", "r_y"], ["x", "y"]
    >>> [*map(are_of_one_kind, pairs)]
    [True, True, True, False, False]
    """
    matches = [_STEM.fullmatch(name) for name in names]
    stems = {match[1] for match in matches if match}
    axes = {match[2] for match in matches if match} <= {*AXES}
    return all(matches) and len(stems) == 1 and not axes


def line_views(run: xr.Dataset) -> list[list[BodyPath]]:
    """Return the view of bodies on one line, each with a single coordinate that is a length: upright if called like a height."""
    names = with_role(run, "coordinate")
    units = {str(run.variables[name].attrs["units"]) for name in names if run.variables[name].dims == ("step",)}
    if (
        len(units) != 1
        or any(run.variables[name].dims != ("step",) for name in names)
        or not is_length(unit := units.pop())
    ):
        return []
    if len(names) > 1 and not are_of_one_kind(names):
        return []
    times, lines = _path_lines(run, names)
    zero, view, is_several = np.zeros(times.size), [], len(names) > 1
    axis = _STEM.fullmatch(names[0])[1] if is_several else names[0]  # type: ignore[index]
    for name, values in zip(names, lines, strict=True):
        body = name if is_several else ""
        if axis in UPRIGHT:
            view.append(BodyPath("", axis, unit, times, zero, values, body, names=("", name)))
        else:
            view.append(BodyPath(axis, "", unit, times, values, zero, body, names=(name, "")))
    return [view]


def _body_views(run: xr.Dataset, model: Model) -> list[list[BodyPath]]:
    """Return the views of positions along two or three axes: all bodies together."""
    shapes, pairs = model.shapes, []
    for dims, units, axes in _body_axes(model):
        for (across, on_x), (up, on_y) in combinations(axes, 2):
            view = []
            for indices in shapes.index_combinations(dims):
                ends = (
                    shapes.element_at(on_x[0], {**indices, **on_x[1]}),
                    shapes.element_at(on_y[0], {**indices, **on_y[1]}),
                )
                if any(end not in run for end in ends):
                    return []
                (times, x), (_, y) = (_path_line(run, end) for end in ends)
                labels = ", ".join(shapes.extent(dim).label(indices[dim]) for dim in dims)
                view.append(BodyPath(across, up, units, times, x, y, labels, "", ends, ", ".join(dims)))
            sides = whole_frame([np.stack([path.x, path.y]) for path in view]).sides
            if min(sides) > THIN * max(sides):
                pairs.append(view)
    return pairs


def _body_axes(model: Model) -> Iterator[tuple[tuple[str, ...], str, list[Axis]]]:
    """Yield the positions of bodies with their dimensions, their unit, and the quantity and place of each axis.

    They are the last dimension of a coordinate, `r(disc, axis)`, or coordinates called as axes are: `x(disc)` and `y(disc)`.
    """
    separate_axes: dict[tuple[str, tuple[str, ...], str], list[Axis]] = {}
    for name, part in model.statement.coordinates.items():
        dims, axis = part.dims, _AXIS.fullmatch(name)
        if not dims or not is_length(part.unit.text):
            continue
        extent = model.shapes.extent(dims[-1])
        if axis:
            separate_axes.setdefault((axis[1] or "", dims, part.unit.text), []).append((name, (name, {})))
        elif len(dims) > 1 and extent.size in (2, SEEN):
            component_axes = [(f"{name}[{extent.label(i)}]", (name, {dims[-1]: i})) for i in range(extent.size)]
            yield dims[:-1], part.unit.text, component_axes
    yield from ((dims, units, axes) for (_, dims, units), axes in separate_axes.items() if len(axes) > 1)


def draw_plane(
    run: xr.Dataset, view: list[BodyPath], overlay: Overlay, axes: Axes, *, has_links: bool = False, discs: bool = False
) -> None:
    """Draw the paths of a view with one scale for both axes, and a dot at the start of each, where grey lines may join them.

    Bodies that have been drawn as discs have no dots.
    """
    all_bodies, view = view, view[:MOST_BODIES]
    for body, colour in zip(view, colours_of(view), strict=True):
        if body.is_fixed:
            draw_line(axes, body.x[:1], body.y[:1], "s", colour)
            continue
        x, y = curve_in_plane(run, body.x, body.y)
        label = body.label if body.body and len(view) <= MOST_NAMED else ""
        label = overlay.run_label if overlay.run_label and len(view) == 1 else label
        draw_line(axes, x, y, "-", colour, label, 1.1)
        draw_isolated(axes, x, y, colour)
        if not discs:
            draw_line(axes, body.x[:1], body.y[:1], "o", colour, size=5)
    _draw_companion_paths(view, overlay, axes)
    _mark_path_events(run, view, axes)
    first, frame, note = view[0], frame_of_view(view), ""
    if frame.leaving:
        axes.set(xlim=frame.limits[0], ylim=frame.limits[1])
    wide, high = frame.sides
    if first.is_space and _is_flat(wide, high):
        note = ", not to scale"
    elif first.is_space:
        axes.set_aspect("equal", adjustable="box")
        axes.locator_params(axis="x", nbins=2 if high > SLENDER * wide else "auto")
        axes.tick_params(axis="x", rotation=90 if high > SLIM * wide else 0)
    position_names = with_role(run, *POSITIONS)
    subject = "the plane" if first.is_space else "phase plane"
    start = "rings: start, discs: end" if discs else f"{'dots and grey lines' if has_links else 'dot'}: start"
    ends = name_ends(view, _path_ends(view, frame), axes)
    if len(view) > MOST_ENDS:
        colour_key(view, axes)
    leaving_text = leaving_bodies_note(frame, view, run["time"])
    omitted, straight = omitted_bodies_note(all_bodies), straight_lines_note(run, *position_names)
    label_panel(axes, f"{subject} ({start}{note}{ends}){omitted}{leaving_text}{straight}")
    label_plane(view, axes)


def label_plane(view: list[BodyPath], axes: Axes) -> None:
    """Label both axes of a plane: by what they are of all bodies, with their units."""
    first = view[0]
    is_one = all((body.across, body.up) == (first.across, first.up) for body in view)
    across, up = (
        text if is_one and text and len(text) <= LONGEST else otherwise
        for text, otherwise in ((first.across, "across"), (first.up, "up"))
    )
    label_panel(axes, x=(across, first.units), y=(up, first.up_units or first.units))


def frame_of_view(view: list[BodyPath]) -> Frame:
    """Return what a picture of a plane holds: the bodies that are drawn, but for those that fly off."""
    drawn_bodies = view[:MOST_BODIES]
    paths = [np.stack([path.x, path.y]) for path in drawn_bodies]
    if not view[0].is_space:
        return whole_frame(paths)
    return frame_of(paths, [path.times for path in drawn_bodies])


def leaving_bodies_note(frame: Frame, view: list[BodyPath], time: xr.DataArray) -> str:
    """Say, behind other words of a title, which bodies leave its frame at what times."""
    return leaving_note(frame, [path.label or f"body {k}" for k, path in enumerate(view[:MOST_BODIES])], time)


def _path_ends(view: list[BodyPath], frame: Frame) -> list[tuple[float, float]]:
    """Return where each path ends, or leaves the frame."""
    ends, leaving_bodies = [], {body for body, _ in frame.leaving}
    for k, path in enumerate(view):
        points = frame.points_inside(np.stack([path.x, path.y])) if k in leaving_bodies else np.stack([path.x, path.y])
        rows = np.flatnonzero(np.isfinite(points[0]))
        last = int(rows[-1]) if rows.size else -1
        ends.append((float(path.x[last]), float(path.y[last])))
    return ends


def moves_in_lines(view: list[BodyPath]) -> bool:
    """Whether every body moves across alone, or every one up alone: time shows it better than the plane."""
    sides = ([body.x for body in view], [body.y for body in view])
    return view[0].is_space and any(all(np.ptp(line) == 0.0 for line in lines) for lines in sides)


def _is_flat(wide: float, high: float) -> bool:
    """Whether all paths together are so much longer than wide that nothing would be seen at one scale."""
    return bool(max(wide, high) > 0.0 and max(wide, high) > FLATTEST * min(wide, high))


def _draw_companion_paths(view: list[BodyPath], overlay: Overlay, axes: Axes) -> None:
    """Draw where other runs have the same bodies, and measurements of their coordinates.

    Of one body each run has a colour; of several each body keeps its own, and runs differ by their dashes.
    """
    is_several, shades = len(view) > 1, colours_of(view)
    if is_several and overlay.companions:
        draw_line(axes, [], [], "-", GREY, overlay.run_label, 1.1)
    for k, companion in enumerate(overlay.companions, 1):
        if companion.record is None:
            companion_lines = [companion.values_at_common_times(body.across, body.up) for body in view]
        else:
            first = view[0]
            matching_views = [
                companion_view
                for companion_view in (*views(companion.record), *state_planes(companion.record))
                if (companion_view[0].across, companion_view[0].up) == (first.across, first.up)
            ]
            companion_lines = [[path.x, path.y] for path in matching_views[0][: len(view)]] if matching_views else []
        style: dict[str, Any] = {"style": "+" if companion.record is None else run_dashes(k), "width": 1.2, "size": 6.0}
        for j, pair in enumerate(line for line in companion_lines if line is not None):
            colour = shades[j] if is_several and view[0].dims else (j if is_several else k)
            draw_line(axes, pair[0], pair[1], colour=colour, alpha=0.8, **style)
        if any(line is not None for line in companion_lines):
            draw_line(axes, [], [], colour=GREY if is_several else k, label=companion.label, alpha=0.8, **style)


def _mark_path_events(run: xr.Dataset, view: list[BodyPath], axes: Axes) -> None:
    """Mark where the bodies that an event concerns are then."""
    if not run.sizes.get("event", 0) or not {"event_time", "event_detector", "event_kind"} <= {*run.variables}:
        _add_plane_legend(view, axes)
        return
    kinds, concerned, times = event_kinds(run), concerned_elements(run), run.variables["event_time"].values
    for n, kind in enumerate(kinds):
        label = legend_label(kinds, n, axes)
        for body in view:
            body_labels = {*body.body.split(", ")}
            events = [event for event in kind.marked_events if not concerned[event] or concerned[event] & body_labels]
            moments = times[events] if events and not body.is_fixed else times[:0]
            moments = moments[(moments >= body.times[0]) & (moments <= body.times[-1])]
            x, y = (np.interp(moments, body.times, line) for line in (body.x, body.y))
            style = {"markersize": 3.5, "markeredgewidth": 0.7, **kind.style}
            axes.plot(x, y, label=label if body is view[0] else None, gid=IN_LEGEND, **style)
    _add_plane_legend(view, axes)


def _add_plane_legend(view: list[BodyPath], axes: Axes) -> None:
    """Name what is drawn; where there are several bodies, beside the axes."""
    names = {*axes.get_legend_handles_labels()[1]}
    if names <= named_elsewhere(axes):  # the same bodies seen from another side
        return
    legend_placement: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if view[0].body else {}
    axes.legend(fontsize=8, frameon=False, **legend_placement)


def _model_paths(run: xr.Dataset, model: Model) -> list[BodyPath]:
    """Evaluate the pairs that a model names along the run."""
    elements = model.elements
    names = plane_variables(model)
    if not {*names} <= {*run.variables}:
        return []
    times, lines = _path_lines(run, names)
    places = plane_positions(model, times, dict(zip(names, lines, strict=True)))
    body_names = elements.pictured.bodies if len(elements.pictured.bodies) == len(places) else ("",) * len(places)
    bodies = []
    for pair, (x, y), body in zip(elements.pictured.plane, places, body_names, strict=True):
        across, up = (spell(dimension_of(elements.expanded(component), elements.dimensions)).text for component in pair)
        on_x, on_y = (
            part.name if isinstance(part, Name) and part.name in elements.statement.coordinates else "" for part in pair
        )
        texts, up_units = [*map(text_of, pair)], up if up != across else ""
        bodies.append(BodyPath(texts[0], texts[1], across, times, x, y, body, up_units, names=(on_x, on_y)))
    return bodies


def plane_variables(model: Model) -> list[str]:
    """Return the coordinates, velocities and states that a model's plane reads."""
    elements = model.elements
    names_read = set().union(
        *(free_names(elements.expanded(component)) for pair in elements.pictured.plane for component in pair)
    )
    return [name for name in elements.units if name in names_read]


def plane_positions(model: Model, times: Floats, states: Mapping[str, Floats]) -> list[tuple[Floats, Floats]]:
    """Evaluate the pairs that a model names at states, given in recorded units."""
    elements = model.elements
    state = {name: states[name] * float(elements.units[name].factor) for name in plane_variables(model)}
    namespace = dict(constants(model)) | state | {"t": times}
    return [
        (np.broadcast_to(x, times.shape), np.broadcast_to(y, times.shape))
        for x, y in (
            (evaluate_many(elements.expanded(part), namespace) for part in pair) for pair in elements.pictured.plane
        )
    ]


def _path_line(run: xr.Dataset, name: str) -> tuple[Floats, Floats]:
    """Return times and values of a line, bent where states are few."""
    times, (values,) = _path_lines(run, [name])
    return times, values


def _path_lines(run: xr.Dataset, names: list[str]) -> tuple[Floats, list[Floats]]:
    """Return times and values of lines, all at the same times, bent where states are few."""
    curves = [curve for name in names if (curve := refined_line(run, name)) is not None]
    if len(curves) < len(names) or not curves:
        return run.variables["time"].values, [run.variables[name].values for name in names]
    return curves[0][0], [values for _, values in curves]


MOST_TICKS = 5  # of the longest side
SHORTEST_SIDE = 0.25  # of the longest side, that each one has at least
THINNEST = 1e-3  # of the longest side, for whose part a side of no length is taken
EDGES = (-0.05, 0.05)  # of each side, around what is drawn


def spaces(views: list[list[BodyPath]]) -> Iterator[list[BodyPath]]:
    """Yield the paths in three dimensions of bodies that are seen from three sides: those of one view, with their depth."""
    for front, above, side in zip(views, views[1:], views[2:], strict=False):
        first, second, third = front[0], above[0], side[0]
        has_same_axes = (second.across, third.across, third.up) == (first.across, first.up, second.up)
        if has_same_axes and first.is_space and first.units == second.units == third.units:
            yield [
                replace(
                    path,
                    depth=np.interp(path.times, beside.times, beside.y),
                    depth_axis=beside.up,
                    depth_name=beside.names[1],
                )
                for path, beside in zip(front, above, strict=True)
            ]


def draw_space(run: xr.Dataset, view: list[BodyPath], axes: Axes) -> None:
    """Draw paths in three dimensions in the place of some axes, a dot at each start.

    All three have one scale; a side that would be too flat for its ticks is stretched, and says so.
    """
    (solid,) = subpanels(axes, 1, projection="3d")
    first, bodies = view[0], view[:MOST_BODIES]
    frame = frame_of([path.points for path in bodies], [path.times for path in bodies])
    for path, colour in zip(bodies, colours_of(view), strict=True):
        points = frame.points_inside(path.points) if frame.leaving else path.points
        solid.plot(
            *points[:, rows_along(ways_along(*points))],
            "-",
            color=colour,
            linewidth=1.0,
            label=escaped_text(path.label),
        )
        solid.plot(*points[:, :1], "o", color=colour, markersize=4)
    names = {escaped_text(path.label) for path in view if path.body}
    if 0 < len(names) <= MOST_NAMED and not names <= named_elsewhere(solid):
        solid.legend(fontsize=8, frameon=False)
    colour_key(view, solid)
    power = _shape_space_axes(solid, frame, (first.across, first.up, first.depth_axis))
    units = f"10{superscript(power)} {typeset(first.units)}" if power else typeset(first.units)
    leaving_text = leaving_bodies_note(frame, view, run["time"])
    label_panel(solid, f"in space, in {units} (dot: start){omitted_bodies_note(view)}{leaving_text}")


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
    depth_axis, depth_name : str
        What that axis is, and the coordinate.
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
    depth_axis: str = ""
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
FIRST_SHADE, LAST_SHADE = 0.05, 0.95  # of these colours
MOST_KEYED = 6  # names along a scale of colours
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

    return [legible(to_hex(shade)) for shade in colormaps[MANY](np.linspace(FIRST_SHADE, LAST_SHADE, count))]


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
    ticks = np.unique(np.linspace(0, len(names) - 1, MOST_KEYED).round().astype(int))
    bar_placement: Any = (
        {"ax": axes, "shrink": 0.7, "pad": 0.15} if solid else {"cax": axes.inset_axes((1.02, 0.0, 0.03, 1.0))}
    )
    bar = axes.figure.colorbar(scale, ticks=ticks, **bar_placement)
    bar.ax.set_yticks(ticks, [names[k] for k in ticks], fontsize=7)
    bar.set_label(escaped_text(view[0].dims), fontsize=8)
