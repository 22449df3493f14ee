"""Figures of runs: drawn from the record alone, against recorded times, with units and events.

What figures show of bodies that turn: attitudes and angular velocities, and no integral of these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.faults import InputError
from xdynamics.figures import boundaries, element_maps, line_panels, plane
from xdynamics.figures.companions import Overlay
from xdynamics.figures.curves import recorded_model, with_role
from xdynamics.figures.element_maps import field_panels
from xdynamics.figures.excerpt import overlay_of
from xdynamics.figures.line_panels import are_rounding_errors, drives_by_unit, groups_by_unit
from xdynamics.figures.marks import shared_axis
from xdynamics.figures.plane import BodyPath
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.transients import Transient
from xdynamics.model.body_sections import position, quasi_coordinate, unit_quaternions
from xdynamics.model.controllers import pending
from xdynamics.model.joints import made_by_joints
from xdynamics.reaction_names import JOINT, constraint_force
from xdynamics.record import check
from xdynamics.record.long_times import in_long_unit
from xdynamics.record.run_dataset import chosen_times_remedy
from xdynamics.record.schemas import ending_words, is_whole, log_description, rows_apart
from xdynamics.schema import HELD, STEPS, velocity
from xdynamics.shapes import display_text, split_element_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class BodyVariables:
    """The variables of bodies in a record, element by element.

    Attributes
    ----------
    attitudes : list of list of str
        The four parts of every quaternion.
    angular_velocities : set of str
        Angular velocities, along the axes of the bodies.
    positions : set of str
        Where bodies are.
    hidden_names : set of str
        What is not drawn unless it is asked for: integrals of angular velocities, and where a body is that rests.
    """

    def __init__(self, run: xr.Dataset) -> None:
        model = recorded_model(run)
        bodies = model.statement.bodies if model is not None else {}
        self.attitudes: list[list[str]] = []
        self.angular_velocities, self.positions, self.hidden_names = set[str](), set[str](), set[str]()
        if model is None or not bodies:
            return
        quads = [[*parts] for parts in unit_quaternions(bodies, model.shapes)]
        self.attitudes = [parts for parts in quads if all(part in run for part in parts)]
        for body in bodies:
            turns = model.shapes.elements(quasi_coordinate(body))
            self.angular_velocities |= {velocity(name) for name in turns}
            self.hidden_names |= {*turns}
            places = [] if bodies[body].pivot else model.shapes.elements(position(body))
            self.positions |= {*places}
            if not any(name in run and np.ptp(run.variables[name].values) for name in places):
                self.hidden_names |= {*places, *map(velocity, places)}

    @property
    def quaternion_parts(self) -> set[str]:
        """All parts of quaternions."""
        return {part for parts in self.attitudes for part in parts}

    def visible_names(self, names: list[str]) -> list[str]:
        """Return what of some variables is drawn without being asked for."""
        return [name for name in names if name not in self.hidden_names | self.quaternion_parts]

    def titled_velocities(self, names: list[str]) -> Iterator[tuple[str, list[str]]]:
        """Yield angular velocities in bodies, and other velocities, with a title for each."""
        yield "angular velocity in the body", [name for name in names if name in self.angular_velocities]
        yield "velocity", [name for name in names if name not in self.angular_velocities]


FEWEST_LOCATED = 3  # events, from which on a panel shows more than their list
# kinds in the order in which they are chosen for a sheet of few panels: what a person came for
FIRST = (
    *("plane", "space", "map", "trajectory", "attitude", "section", "energy", "contact", "constraint"),
    *("drive", "controller", "state", "velocity", "profile", "phase", "observable"),
)
KINDS = (*FIRST, "steps", "errors", "events")  # words by which panels are chosen, besides the names of variables
FEW, ALL = AMOUNTS = ("few", "all")  # of panels
MOST = 4  # panels, where few are drawn

KeyedPanel = tuple[str, list[str], Panel]  # what kind of panel, which variables, how it is drawn


def panels_of(run: xr.Dataset, *options: Any, **keyword_options: Any) -> list[Panel]:
    """Return the panels of a run, as `panels_and_omissions` does."""
    return panels_and_omissions(run, *options, **keyword_options)[0]


def panels_and_omissions(
    run: xr.Dataset,
    only: Sequence[str] | None = None,
    beside: Sequence[Any] = (),
    amount: str = ALL,
    names: Sequence[str] = (),
    transient: Transient | None = None,
) -> tuple[list[Panel], str]:
    """Return the panels of a run: the plane, trajectory, velocity, contacts, drives, phase portrait, energy, steps.

    Between rows that are far apart lines go through states of the run's own method, recomputed from the record, and
    quantities computed from states are evaluated on them; a panel states where that is impossible. Lines of more than 4,000
    points are thinned by keeping the least and the greatest value of each stretch. The record keeps every row.

    Parameters
    ----------
    run : xarray.Dataset
    only : sequence of str, optional
        Kinds of panels, or names of variables, to be drawn alone.
    beside : sequence of Dataset or path, optional
        Other runs and measurements, drawn over the same variables.
    amount : {"few", "all"}
        Of panels; few are four at most.
    names : sequence of str
        Of the run and of each that is beside it; by default what differs.
    transient : Transient, optional
        What is left out of the section; by default its first fifth.

    Returns
    -------
    list of callable
    str
        What few panels leave out, for the text below them; empty where they are all.

    Raises
    ------
    InputError
        If the Dataset has no recorded times, or nothing that was asked for.
    """
    if "time" not in run.variables or run.variables["time"].dims != (STEPS,):
        raise InputError(f"plot needs a run record with 'time' along 'step'{chosen_times_remedy(run)}")
    if not run.variables["time"].size:
        raise InputError("there is nothing to draw: the record has no rows")
    check(run, whole=False, values=False)
    if transient is not None and not _is_driven(run):
        raise InputError(
            "transient is for the section of a run, and its model names none; name the period of what drives it:"
            ' [figure] section = "2*pi/w"'
        )
    run = run.copy(deep=False)  # what is between its rows is kept as long as it is drawn
    requested_names = None if only is None else _requested_names(run, only)
    overlay = overlay_of(run, beside, requested_names, names)
    keyed = [
        keyed_panel
        for keyed_panel in _run_panels(run, overlay, requested_names, transient)
        if requested_names is None or {keyed_panel[0], *keyed_panel[1]} & {*requested_names}
    ]
    selected_panels = _leading_panels(keyed) if requested_names is None and amount == FEW else keyed
    panels = [panel for _, _, panel in selected_panels]
    if not panels and requested_names == ["plane"]:
        raise InputError(
            'the run has no plane to be seen in; name it in the model: [figure] plane = ["l*sin(theta)",'
            ' "-l*cos(theta)"]'
        )
    if not panels and requested_names is not None:
        log_note = log_description(run.attrs)
        raise InputError(
            f"the run has nothing of {', '.join(requested_names) or 'an empty list'} to draw{log_note and f'; {log_note}'}"
        )
    if not panels:
        raise InputError(
            f"there is nothing along '{STEPS}' to draw among {', '.join(map(str, run.data_vars)) or 'nothing'}"
        )
    return panels, _omitted_panels_note(keyed, selected_panels)


def _omitted_panels_note(keyed: list[KeyedPanel], selected_panels: list[KeyedPanel]) -> str:
    """Say what panels are not drawn, and how they are."""
    counts = Counter(kind for kind, _, _ in keyed)
    counts.subtract(kind for kind, _, _ in selected_panels)
    omitted_kinds = ", ".join(kind if count == 1 else f"{count} of {kind}" for kind, count in counts.items() if count)
    note = f'{len(selected_panels)} of {len(keyed)} panels; with --panels {ALL} (panels="{ALL}") also {omitted_kinds}'
    return note if omitted_kinds else ""


def _leading_panels(panels: list[KeyedPanel]) -> list[KeyedPanel]:
    """Return what a person came for, in reading order: the first panel of each kind, then the second ones."""
    seen, ranks, has_plane = Counter[str](), [], any(kind == "plane" for kind, _, _ in panels)
    for panel_index, (kind, names, _) in enumerate(panels):
        # bodies are seen better in the plane, from each side
        is_map = has_plane and len(names) > line_panels.MOST_LINES
        seen[kind] += 1
        if kind in FIRST:
            turn = 1 if is_map and shared_axis(names) else seen[kind]  # each axis before the next kind
            ranks.append((is_map, turn, FIRST.index(kind), panel_index))
    return [panels[k] for k in sorted(panel_index for *_, panel_index in sorted(ranks)[:MOST])] or panels[:MOST]


def _requested_names(run: xr.Dataset, only: Sequence[str]) -> list[str]:
    """Return kinds of panels and names of variables, of a quantity with dimensions those of its elements."""
    if not isinstance(only, Iterable) or not all(isinstance(word, str) for word in only):
        raise InputError(f"only is {only!r}, needs kinds of panels and names in a list, like ['energy']")
    drawable = {name for _, names, _ in _run_panels(run, Overlay()) for name in names} | {*_variables_on_request(run)}
    drawable |= {name for name in BodyVariables(run).hidden_names if _has_rows(run, name)}
    elements, only = dict[str, list[str]](), [*map(element_maps.model_shapes(run).internal_name, only)]
    for name in sorted(drawable):
        elements.setdefault(split_element_name(name)[0], []).append(name)
    if unknown := [word for word in only if word not in (*KINDS, *drawable, *elements)]:
        raise InputError(
            f"only has {', '.join(map(repr, map(display_text, unknown)))}; there are {', '.join(KINDS)}, and {', '.join(elements)}"
        )
    return [name for word in only for name in ([word] if word in KINDS else elements.get(word, [word]))]


def foot_of(run: xr.Dataset) -> str:
    """Describe how a run ended; `show` adds the remarks."""
    row_spacing = rows_apart(run.attrs)
    thinning_note = f"; one in {row_spacing} of its rows" if row_spacing > 1 else ""
    last = in_long_unit(run["time"], float(run["time"][-1])) if run["time"].size else ""
    return f"{ending_words(run.attrs)[0]}{last}{thinning_note}"


def _run_panels(
    run: xr.Dataset, overlay: Overlay, requested_names: Sequence[str] | None = None, transient: Transient | None = None
) -> Iterator[KeyedPanel]:
    """Yield every panel, in reading order."""
    views = [
        view for view in plane.views(run) if not plane.moves_in_lines(view) or boundaries.disc_radii(run, view).size
    ]
    for view in views:
        yield "plane", [], partial(_draw_body_plane, run, view, overlay)
    for seen in plane.spaces(views):
        yield "space", [], partial(plane.draw_space, run, seen)
    for names, panel in field_panels(run, 2):
        is_whole_field = requested_names is None or {*names} <= {*requested_names}
        yield "map", names if is_whole_field else [], panel
    yield from _motion_panels(run, overlay, requested_names)
    yield from _force_panels(run, overlay, requested_names, transient)
    yield from _march_panels(run, overlay)


def _draw_body_plane(run: xr.Dataset, view: list[BodyPath], overlay: Overlay, axes: Axes) -> None:
    """Draw the paths of bodies, as large as they are where they meet as discs, what joins them at the start, and walls."""
    radii = boundaries.disc_radii(run, view)
    discs = boundaries.draw_discs(view, radii, axes)
    plane.draw_plane(run, view, overlay, axes, has_links=boundaries.draw_at_start(run, view, axes), discs=discs)
    boundaries.draw_walls(boundaries.boundaries_of(run, view, radii), axes)


def _motion_panels(run: xr.Dataset, overlay: Overlay, requested_names: Sequence[str] | None) -> Iterator[KeyedPanel]:
    """Yield coordinates, velocities, first-order states, and variables asked for by name."""
    coordinates, body_variables = _drawable_with_role(run, "coordinate"), BodyVariables(run)
    velocities = [velocity(name) for name in coordinates if _has_rows(run, velocity(name))]
    velocities += [name for name in _drawable_with_role(run, "velocity") if name.removeprefix(velocity("")) not in run]
    states, observables = _drawable_with_role(run, "state"), _drawable_with_role(run, "observable")
    if (
        requested_names is None
        and not coordinates
        and observables
        and not any(np.ptp(run.variables[name].values) for name in states)
    ):
        states = []  # nothing moves, and what is computed was asked for
    if requested_names is None:
        coordinates, velocities, states = map(body_variables.visible_names, (coordinates, velocities, states))
    kinds = [("trajectory", "trajectory", coordinates)]
    kinds += [("velocity", title, names) for title, names in body_variables.titled_velocities(velocities)]
    kinds += [("state", "first-order state", states), ("controller", "held between ticks", _held_by_controllers(run))]
    kinds.append(("observable", "observable", observables))
    maps = {tuple(names): panel for names, panel in field_panels(run, 2)}  # which tell more than a row for each element
    for kind, title, names in (*kinds, ("other", "", _variables_on_request(run))):
        for group in groups_by_unit(run, _requested_variables(kind, names, requested_names)):
            subject = title or str(run.variables[group[0]].attrs["role"]).replace("_", " ")
            panel = maps.get(tuple(group))
            if panel is None:
                yield _against_time(run, kind, group, subject, overlay)
            elif requested_names is not None and kind in requested_names:
                yield kind, group, panel
    if requested_names is None or "attitude" in requested_names:
        for parts in body_variables.attitudes:
            yield _against_time(run, "attitude", parts, "attitude, a quaternion", overlay)
    yield from (("profile", names, panel) for names, panel in field_panels(run, 1))


def _against_time(run: xr.Dataset, kind: str, names: list[str], subject: str, overlay: Overlay) -> KeyedPanel:
    """Return the panel of some variables of one unit against time."""
    return kind, names, partial(line_panels.draw_against_time, run, names, subject, overlay)


def _force_panels(
    run: xr.Dataset, overlay: Overlay, requested_names: Sequence[str] | None, transient: Transient | None
) -> Iterator[KeyedPanel]:
    """Yield forces and impulses of contacts, drives, and velocities against positions."""
    coordinates = _drawable_with_role(run, "coordinate")
    joint_multipliers = {*_multipliers_of_joints(run)}
    for kind, role, title in (
        ("contact", "reaction", line_panels.CONTACTS),
        ("constraint", JOINT, "forces and torques in joints"),
        ("constraint", "multiplier", line_panels.CONSTRAINTS),
    ):
        role_names = [name for name in _drawable_with_role(run, role) if name not in joint_multipliers]
        acting_names = [
            name for name in role_names if run.variables[name].ndim == 1 and run.variables[name].values.any()
        ]
        for names in groups_by_unit(run, _requested_variables(kind, acting_names, requested_names)):
            is_noise = are_rounding_errors(run, names)
            if not is_noise or requested_names is not None:
                yield _against_time(run, kind, names, f"{title}{': no more than rounding' * is_noise}", overlay)
    for names in groups_by_unit(run, line_panels.impulses(run, coordinates)):
        yield "contact", [], partial(line_panels.draw_impact_needles, run, names, overlay)
    for names in drives_by_unit(run):
        yield "drive", names, partial(line_panels.draw_drives, run, names, overlay)
    for view in plane.state_planes(run):
        yield "phase", [], partial(plane.draw_plane, run, view, overlay)
    body_variables = BodyVariables(run)
    phase_coordinates = [
        name for name in body_variables.visible_names(coordinates) if name not in body_variables.positions
    ]
    for names in groups_by_unit(run, [name for name in phase_coordinates if _has_rows(run, velocity(name))]):
        if len(names) <= line_panels.MOST_LINES:
            yield "phase", [], partial(line_panels.draw_phase_portrait, run, names, overlay)
            if _is_driven(run):
                yield "section", [], partial(line_panels.draw_section, run, names, overlay, transient=transient)


def _march_panels(run: xr.Dataset, overlay: Overlay) -> Iterator[KeyedPanel]:
    """Yield energies, steps, errors, and how well events were located."""
    if _has_rows(run, "total_energy"):
        yield "energy", ["total_energy"], partial(line_panels.draw_energy, run, overlay)
        if not overlay.companions and line_panels.has_terms(run):
            yield "energy", [], partial(line_panels.draw_energy_terms, run)
    if _has_rows(run, "step_size", "trial_reason", "trial_step_size", "trial_time") and not _is_steady(run):
        yield "steps", ["step_size"], partial(line_panels.draw_steps, run, overlay)
    if _has_rows(run, "error_norm"):
        yield "errors", ["error_norm"], partial(line_panels.draw_errors, run, overlay)
    if run.sizes.get("event", 0) >= FEWEST_LOCATED and {*line_panels.PARTS} <= set(run.variables):
        yield "events", [], partial(line_panels.draw_event_locations, run)


def _requested_variables(kind: str, names: list[str], requested_names: Sequence[str] | None) -> list[str]:
    """Return the variables of a kind to draw: all if the kind is wanted, else those wanted by name."""
    if requested_names is None:
        return names if kind != "other" else []
    return names if kind in requested_names else [name for name in names if name in requested_names]


def _held_by_controllers(run: xr.Dataset) -> list[str]:
    """Name what controllers hold and what is in effect of what they put out."""
    held_names = _drawable_with_role(run, HELD)
    controllers = model_of_record(run, None).elements.controllers if held_names and "model_toml" in run else {}
    pending_names = {name for part in controllers.values() for output in part.outputs for name in pending(output, part)}
    return [name for name in held_names if name not in pending_names]


def _variables_on_request(run: xr.Dataset) -> list[str]:
    """Name the variables that are drawn only on request: forces, accelerations, rates, their terms, multipliers of joints."""
    roles = ("force", "acceleration", "rate", "rate_term", "energy", "gap")
    role_names = [name for role in roles for name in _drawable_with_role(run, role) if name != "total_energy"]
    return role_names + _multipliers_of_joints(run)


def _multipliers_of_joints(run: xr.Dataset) -> list[str]:
    """Name the multipliers of constraints that joints stand for: what joints do is drawn in their place."""
    joints = model_of_record(run, None).joints if "model_toml" in run else {}
    joint_multipliers = {constraint_force(name) for name in made_by_joints(joints, "constraints")}
    return [name for name in _drawable_with_role(run, "multiplier") if split_element_name(name)[0] in joint_multipliers]


def _is_driven(run: xr.Dataset) -> bool:
    """Whether the run's model names the period of a section, and the run is whole and has one."""
    model = recorded_model(run)
    return model is not None and is_whole(run.attrs) and model.elements.pictured.section is not None


def _is_steady(run: xr.Dataset) -> bool:
    """Whether the steps are fixed, so that a picture of them is uninformative."""
    return run.attrs.get("solver_step_control") == "fixed"


def _drawable_with_role(run: xr.Dataset, role: str) -> list[str]:
    return [name for name in with_role(run, role) if _has_rows(run, name)]


def _has_rows(run: xr.Dataset, *names: str) -> bool:
    """Whether all of these variables have rows, as in a whole record."""
    return all(name in run and run.variables[name].dims[:1] in ((STEPS,), ("trial",)) for name in names)


PAGE = Page((), panels_of, foot_of)
