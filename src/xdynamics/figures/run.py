"""Figures of runs: drawn from the record alone, against recorded times, with units and events."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.dynamics.recorded_models import model_of
from xdynamics.faults import InputError
from xdynamics.figures import (
    boundaries,
    energy,
    energy_terms,
    lattice,
    line_panels,
    march_panels,
    plane,
    scenery,
    space,
)
from xdynamics.figures.attitudes import Turning
from xdynamics.figures.body_paths import BodyPath
from xdynamics.figures.companions import Beside
from xdynamics.figures.fields import fields
from xdynamics.figures.panel_groups import by_unit, drives_by_unit, is_rounding
from xdynamics.figures.panel_words import shared_axis
from xdynamics.figures.roles import with_role
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.side_by_side import beside_of
from xdynamics.figures.transients import Transient
from xdynamics.model.controllers import pending
from xdynamics.model.joints import made_by_joints
from xdynamics.reaction_names import JOINT, constraint_force
from xdynamics.record import check
from xdynamics.record.partial_records import ended, is_whole, log_description, rows_apart
from xdynamics.schema import HELD, STEPS, velocity
from xdynamics.shapes import parted, spoken

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEWEST_LOCATED = 3  # events, from which on a panel shows more than their list
# words by which panels are chosen, besides the names of variables
KINDS = (
    "plane",
    "trajectory",
    "velocity",
    "attitude",
    "state",
    "profile",
    "space",
    "map",
    "contact",
    "constraint",
    "drive",
    "controller",
    "phase",
    "section",
    "energy",
    *("steps", "errors", "events"),
)

# kinds in the order in which they are chosen for a sheet of few panels: what a person came for
FIRST = (
    "plane",
    "space",
    "map",
    "trajectory",
    "attitude",
    "section",
    "energy",
    "contact",
    "constraint",
    "drive",
    "controller",
    "state",
    "velocity",
    "profile",
    "phase",
)
FEW, ALL = AMOUNTS = ("few", "all")  # of panels
MOST = 4  # panels, where few are drawn

Keyed = tuple[str, list[str], Panel]  # what kind of panel, which variables, how it is drawn


def panels_of(run: xr.Dataset, *options: Any, **named: Any) -> list[Panel]:
    """Return the panels of a run, as `panels_and_rest` does."""
    return panels_and_rest(run, *options, **named)[0]


def panels_and_rest(
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
        raise InputError("plot needs a run record with 'time' along 'step'")
    if not run.variables["time"].size:
        raise InputError("there is nothing to draw: the record has no rows")
    check(run, whole=False, values=False)
    if transient is not None and not _is_driven(run):
        raise InputError(
            "transient is for the section of a run, and its model names none; name the period of what drives it:"
            ' [figure] section = "2*pi/w"'
        )
    run = run.copy(deep=False)  # what is between its rows is kept as long as it is drawn
    wanted = None if only is None else _wanted(run, only)
    overlays = beside_of(run, beside, wanted, names)
    keyed = [
        each for each in _panels(run, overlays, wanted, transient) if wanted is None or {each[0], *each[1]} & {*wanted}
    ]
    chosen = _chosen(keyed) if wanted is None and amount == FEW else keyed
    panels = [panel for _, _, panel in chosen]
    if not panels and wanted == ["plane"]:
        raise InputError(
            'the run has no plane to be seen in; name it in the model: [figure] plane = ["l*sin(theta)",'
            ' "-l*cos(theta)"]'
        )
    if not panels and wanted is not None:
        log_note = log_description(run.attrs)
        raise InputError(
            f"the run has nothing of {', '.join(wanted) or 'an empty list'} to draw{log_note and f'; {log_note}'}"
        )
    if not panels:
        raise InputError(
            f"there is nothing along '{STEPS}' to draw among {', '.join(map(str, run.data_vars)) or 'nothing'}"
        )
    return panels, _rest_of(keyed, chosen)


def _rest_of(keyed: list[Keyed], chosen: list[Keyed]) -> str:
    """Say what panels are not drawn, and how they are."""
    kinds = dict[str, int]()
    for kind in (kind for kind, _, panel in keyed if all(panel is not drawn for _, _, drawn in chosen)):
        kinds[kind] = kinds.get(kind, 0) + 1
    rest = ", ".join(kind if number == 1 else f"{number} of {kind}" for kind, number in kinds.items())
    return f'{len(chosen)} of {len(keyed)} panels; with panels = "{ALL}" also {rest}' if kinds else ""


def _chosen(panels: list[Keyed]) -> list[Keyed]:
    """Return what a person came for, in reading order: the first panel of each kind, then the second ones."""
    seen: dict[str, int] = {}
    ranks = []
    has_plane = any(kind == "plane" for kind, _, _ in panels)
    for place, (kind, names, _) in enumerate(panels):
        is_map = (
            has_plane and len(names) > line_panels.MOST_LINES
        )  # bodies are seen better in the plane, from each side
        seen[kind] = seen.get(kind, 0) + 1
        if kind in FIRST:
            turn = 1 if is_map and shared_axis(names) else seen[kind]  # each axis before the next kind
            ranks.append((is_map, turn, FIRST.index(kind), place))
    return [panels[place] for place in sorted(place for *_, place in sorted(ranks)[:MOST])] or panels[:MOST]


def _wanted(run: xr.Dataset, only: Sequence[str]) -> list[str]:
    """Return kinds of panels and names of variables, of a quantity with dimensions those of its elements."""
    if not isinstance(only, Iterable) or not all(isinstance(word, str) for word in only):
        raise InputError(f"only is {only!r}, needs kinds of panels and names in a list, like ['energy']")
    drawable = {name for _, names, _ in _panels(run, Beside()) for name in names} | {*_others(run)}
    drawable |= {name for name in Turning(run).unseen if _drawn(run, name)}
    elements, only = dict[str, list[str]](), [*map(lattice.shapes_of(run).inside, only)]
    for name in sorted(drawable):
        elements.setdefault(parted(name)[0], []).append(name)
    if unknown := [word for word in only if word not in (*KINDS, *drawable, *elements)]:
        raise InputError(
            f"only has {', '.join(map(repr, map(spoken, unknown)))}; there are {', '.join(KINDS)}, and {', '.join(elements)}"
        )
    return [name for word in only for name in ([word] if word in KINDS else elements.get(word, [word]))]


def foot_of(run: xr.Dataset) -> str:
    """Describe how a run ended; `show` adds the remarks."""
    every = rows_apart(run.attrs)
    kept = f"; one in {every} of its rows" if every > 1 else ""
    return f"{ended(run.attrs)[0]}{kept}"


def _panels(
    run: xr.Dataset, beside: Beside, wanted: Sequence[str] | None = None, transient: Transient | None = None
) -> Iterator[Keyed]:
    """Yield every panel, in reading order."""
    views = [view for view in plane.views(run) if not plane.moves_in_lines(view) or boundaries.radii_of(run, view).size]
    for view in views:
        yield "plane", [], partial(_plane, run, view, beside)
    for seen in space.spaces(views):
        yield "space", [], partial(space.draw, run, seen, views)
    for names, panel in fields(run):
        is_whole_field = wanted is None or {*names} <= {*wanted}
        yield "map", names if is_whole_field else [], panel
    yield from _of_motion(run, beside, wanted)
    yield from _of_forces(run, beside, wanted, transient)
    yield from _of_march(run, beside)


def _plane(run: xr.Dataset, view: list[BodyPath], beside: Beside, axes: Axes) -> None:
    """Draw the paths of bodies, as large as they are where they meet as discs, what joins them at the start, and walls."""
    radii = boundaries.radii_of(run, view)
    discs = boundaries.draw_discs(view, radii, axes)
    plane.draw(run, view, beside, axes, joined=scenery.draw_at_start(run, view, axes), discs=discs)
    boundaries.draw_walls(boundaries.boundaries(run, view, radii), axes)


def _of_motion(run: xr.Dataset, beside: Beside, wanted: Sequence[str] | None) -> Iterator[Keyed]:
    """Yield coordinates, velocities, first-order states, and variables asked for by name."""
    coordinates, turning = _with_role(run, "coordinate"), Turning(run)
    moving = [velocity(name) for name in coordinates if _drawn(run, velocity(name))]
    moving += [name for name in _with_role(run, "velocity") if name.removeprefix(velocity("")) not in run]
    states, observables = _with_role(run, "state"), _with_role(run, "observable")
    if (
        wanted is None
        and not coordinates
        and observables
        and not any(np.ptp(run.variables[name].values) for name in states)
    ):
        states, wanted = [], observables  # nothing moves, and what is computed was asked for
    if wanted is None:
        coordinates, moving, states = map(turning.shown, (coordinates, moving, states))
    kinds = [("trajectory", "trajectory", coordinates)]
    kinds += [("velocity", title, names) for title, names in turning.parted(moving)]
    kinds += [("state", "first-order state", states), ("controller", "held between ticks", _held(run))]
    maps = {tuple(names): panel for names, panel in fields(run)}  # which tell more than a row for each element
    for kind, title, names in (*kinds, ("other", "", _others(run))):
        for group in by_unit(run, _wanted_names(kind, names, wanted)):
            what = title or str(run.variables[group[0]].attrs["role"]).replace("_", " ")
            panel = maps.get(tuple(group))
            if panel is None:
                yield kind, group, partial(line_panels.against_time, run, group, what, beside)
            elif wanted is not None and kind in wanted:
                yield kind, group, panel
    for parts in turning.attitudes:
        if wanted is None or "attitude" in wanted:
            yield "attitude", parts, partial(line_panels.against_time, run, parts, "attitude, a quaternion", beside)
    for names, panel in lattice.profiles(run):
        yield "profile", names, panel


def _of_forces(
    run: xr.Dataset, beside: Beside, wanted: Sequence[str] | None, transient: Transient | None
) -> Iterator[Keyed]:
    """Yield forces and impulses of contacts, drives, and velocities against positions."""
    coordinates = _with_role(run, "coordinate")
    joined = {*_joined(run)}
    for kind, role, title in (
        ("contact", "reaction", line_panels.CONTACTS),
        ("constraint", JOINT, "forces and torques in joints"),
        ("constraint", "multiplier", line_panels.CONSTRAINTS),
    ):
        shown = [name for name in _with_role(run, role) if name not in joined]
        acting = [name for name in shown if run.variables[name].ndim == 1 and run.variables[name].values.any()]
        for names in by_unit(run, _wanted_names(kind, acting, wanted)):
            if not is_rounding(run, names):
                yield kind, names, partial(line_panels.against_time, run, names, title, beside)
            elif wanted is not None:
                yield (
                    kind,
                    names,
                    partial(line_panels.against_time, run, names, f"{title}: no more than rounding", beside),
                )
    for names in by_unit(run, line_panels.impulses(run, coordinates)):
        yield "contact", [], partial(line_panels.impact_needles, run, names, beside)
    for names in drives_by_unit(run):
        yield "drive", names, partial(line_panels.driven, run, names, beside)
    for view in plane.of_states(run):
        yield "phase", [], partial(plane.draw, run, view, beside)
    turning = Turning(run)
    alone = [name for name in turning.shown(coordinates) if name not in turning.places]
    for names in by_unit(run, [name for name in alone if _drawn(run, velocity(name))]):
        if len(names) <= line_panels.MOST_LINES:
            yield "phase", [], partial(line_panels.phase, run, names, beside)
            if _is_driven(run):
                yield "section", [], partial(line_panels.section, run, names, beside, transient=transient)


def _of_march(run: xr.Dataset, beside: Beside) -> Iterator[Keyed]:
    """Yield energies, steps, errors, and how well events were located."""
    if _drawn(run, "total_energy"):
        yield "energy", ["total_energy"], partial(energy.draw, run, beside)
        if not beside.others and energy_terms.has_terms(run):
            yield "energy", [], partial(energy_terms.draw, run)
    if _drawn(run, "step_size", "trial_reason", "trial_step_size", "trial_time") and not _is_steady(run):
        yield "steps", ["step_size"], partial(march_panels.steps, run, beside)
    if _drawn(run, "error_norm"):
        yield "errors", ["error_norm"], partial(march_panels.errors, run, beside)
    if run.sizes.get("event", 0) >= FEWEST_LOCATED and {*march_panels.PARTS} <= set(run.variables):
        yield "events", [], partial(march_panels.locations, run)


def _wanted_names(kind: str, names: list[str], wanted: Sequence[str] | None) -> list[str]:
    """Return the variables of a kind to draw: all if the kind is wanted, else those wanted by name."""
    if wanted is None:
        return names if kind != "other" else []
    return names if kind in wanted else [name for name in names if name in wanted]


def _held(run: xr.Dataset) -> list[str]:
    """Name what controllers hold and what is in effect of what they put out."""
    held = _with_role(run, HELD)
    controllers = model_of(run, None).controllers if held and "model_toml" in run else {}
    waiting = {name for part in controllers.values() for output in part.outputs for name in pending(output, part)}
    return [name for name in held if name not in waiting]


def _others(run: xr.Dataset) -> list[str]:
    """Name the variables that are drawn only on request: forces, accelerations, rates, observables, multipliers of joints."""
    roles = ("force", "acceleration", "rate", "observable", "energy", "gap")
    named = [name for role in roles for name in _with_role(run, role) if name != "total_energy"]
    return named + _joined(run)


def _joined(run: xr.Dataset) -> list[str]:
    """Name the multipliers of constraints that joints stand for: what joints do is drawn in their place."""
    joints = model_of(run, None).joints if "model_toml" in run else {}
    made = {constraint_force(name) for name in made_by_joints(joints, "constraints")}
    return [name for name in _with_role(run, "multiplier") if parted(name)[0] in made]


def _is_driven(run: xr.Dataset) -> bool:
    """Whether the run's model names the period of a section, and the run is whole and has one."""
    if "model_toml" not in run or not is_whole(run.attrs):
        return False
    return model_of(run, None).pictured.section is not None


def _is_steady(run: xr.Dataset) -> bool:
    """Whether the steps are fixed, so that a picture of them is uninformative."""
    return run.attrs.get("solver_step_control") == "fixed"


def _with_role(run: xr.Dataset, role: str) -> list[str]:
    return [name for name in with_role(run, role) if _drawn(run, name)]


def _drawn(run: xr.Dataset, *names: str) -> bool:
    """Whether all of these variables have rows, as in a whole record."""
    return all(name in run and run.variables[name].dims[:1] in ((STEPS,), ("trial",)) for name in names)


PAGE = Page((), panels_of, foot_of)
