"""Panels of lines against time, and of velocities against positions.

Which variables of a run share a panel, and which are not worth one.

Panels about the march itself: steps, errors, how well events were located.

The energy of a run: how the method, forces and events change it.

The energy of a run by term: kinetic energy, and the potential energy of each force that has one.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.path import steps_over_impacts
from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.observables import potentials_on
from xdynamics.evidence.sampling import sample
from xdynamics.expressions import Name, free_names, text_of
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError
from xdynamics.figures.companions import Overlay
from xdynamics.figures.curves import (
    AGREED,
    curve_in_plane,
    energy_changes,
    has_chords,
    inner_states,
    is_long,
    known_model,
    line_times,
    plotted_lines,
    thinned_rows,
    with_role,
)
from xdynamics.figures.element_maps import FEWEST_ELEMENTS, STEADY, draw_map
from xdynamics.figures.event_marks import mark_events
from xdynamics.figures.marks import (
    COLOURS,
    axis_title,
    draw_isolated,
    draw_line,
    escaped_text,
    label_panel,
    label_time,
    shade_regimes,
    straight_lines_note,
    time_axis_label,
)
from xdynamics.figures.transients import Transient, times_after_transient
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.drives import value_and_slope
from xdynamics.model.motion import constants, drive_pieces
from xdynamics.record.schemas import is_whole
from xdynamics.schema import ENERGIES, STEPS, velocity
from xdynamics.shapes import split_element_name
from xdynamics.units import parse_unit, unit_suffix
from xdynamics.units.digits import known_part, short_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes


Floats = NDArray[np.float64]

FEW_ROWS = 150  # up to which every accepted state is a dot
MOST_NAMED = 8  # lines in a legend
MOST_DOTS = 20_000  # of a section
MOST_LINES = 6  # in one panel; more are a map
MOST_CROSSED = (
    2  # variables that are named together with each run; of more the legend has a line for each, and for each run
)
LATE = 0.01  # of the span, before which half of the rows are where time is drawn on a logarithmic axis
FEWEST_LATE = 50  # rows for that
CONTACTS, CONSTRAINTS = "contact and friction", "multipliers of constraints"
SHORT_NAMES = {CONTACTS: "force", CONSTRAINTS: "multiplier"}  # of axes with several of them
GREY = "#555555"  # of what stands for all lines
DASHES = ("--", ":", "-.")


def draw_against_time(run: xr.Dataset, names: list[str], subject: str, overlay: Overlay, axes: Axes) -> None:
    """Draw variables of one unit against time; more than six as a map."""
    if len(names) > MOST_LINES:
        draw_map(run, names, subject, axes)
        return
    time, wrapped_angle_names = run.variables["time"].values, wrapped_names(run)
    for name in names:
        colour, label = colour_and_label(name, 0, overlay.run_label, names, overlay)
        values, (times, (line,)) = run.variables[name].values, plotted_lines(run, name)
        if name in wrapped_angle_names:
            units = str(run.variables[name].attrs["units"])
            values, line = wrapped_angles(values, units), torn_angles(line, units)
        if run.sizes[STEPS] < FEW_ROWS:
            draw_line(axes, time, values, ".", colour)
        draw_line(axes, times, line, "-", colour, label, 1.2)
    overlaid = _draw_companion_lines(run, names, overlay, axes)
    y = SHORT_NAMES[subject] if subject in SHORT_NAMES and len(names) > 1 else axis_title(names)
    note = straight_lines_note(run, *names, companion_records=[record for _, record in overlay.records])
    label_panel(axes, f"{subject}{note}", y=(y, run.variables[names[0]].attrs["units"]))
    shade_regimes(run, axes)
    has_event_legend = mark_events(run, names, axes)
    set_run_time_axis(run, axes)
    _add_line_legend(axes, names, overlay if overlaid else Overlay(), needed=has_event_legend)


def _draw_companion_lines(run: xr.Dataset, names: list[str], overlay: Overlay, axes: Axes) -> bool:
    """Draw the same variables of other runs and measurements; return whether there are any."""
    overlaid, wrapped_angle_names = False, wrapped_names(run)
    for k, companion in enumerate(overlay.companions, 1):
        for name in (name for name in names if name in companion.columns):
            colour, label = colour_and_label(name, k, companion.label, names, overlay)
            times, values, doubts = companion.columns[name]
            if name in wrapped_angle_names:
                wrap = torn_angles if doubts is None else wrapped_angles
                values = wrap(values, str(run.variables[name].attrs["units"]))
            if doubts is None:
                draw_line(axes, times, values, run_dashes(k), colour, label, 1.4, alpha=0.7)
            else:
                style: dict[str, Any] = {"fmt": "+", "color": colour, "markersize": 5, "linewidth": 0.8}
                axes.errorbar(times, values, doubts if doubts.any() else None, label=escaped_text(label), **style)
            overlaid = True
    return overlaid


def draw_drives(run: xr.Dataset, names: list[str], overlay: Overlay, axes: Axes) -> None:
    """Draw the values of measured tables along the run, and along others."""
    drives = model_of_record(run, None).elements.drives
    for k, (label, record) in enumerate(overlay.with_run(run)):
        for name in names:
            if (drive_line := _drive_along_run(record, name)) is not None:
                drive = f"{name}({text_of(drives[name].argument)})"
                colour, text = colour_and_label(name, k, label, names, overlay, drive)
                draw_line(axes, *drive_line, style=run_dashes(k), colour=colour, label=text, width=1.1)
    label_panel(axes, "measured drives along the run", y=(axis_title(names), drives[names[0]].table.value_unit.text))
    set_run_time_axis(run, axes)
    _add_line_legend(axes, names, overlay)


def _drive_along_run(run: xr.Dataset, name: str) -> tuple[Floats, Floats] | None:
    """Return times and values of a measured table along a run; None if its model has no such table."""
    if "model_toml" not in run or name not in (model := model_of_record(run, None)).elements.drives:
        return None
    drive, time = model.elements.drives[name], run.variables["time"].values
    table = dict(zip(model.elements.drives, drive_pieces(model), strict=True))[name]
    lookup_argument = model.elements.looked_up_at[name]
    of_time = lookup_argument == CLOCK
    if of_time:  # its own points too, which no step may have met
        points = table[0][(table[0] > time[0]) & (table[0] < time[-1])]
        curve_times = argument = np.union1d(line_times(run), points)
    elif isinstance(lookup_argument, Name):
        curve_times, (argument,) = plotted_lines(run, lookup_argument.name)
        argument = argument * float(model.elements.units[lookup_argument.name].factor)
    else:
        states_read = free_names(lookup_argument) & {*model.elements.units}
        state = {word: run.variables[word].values * float(model.elements.units[word].factor) for word in states_read}
        curve_times, argument = time, evaluate_many(lookup_argument, {**constants(model), **state, "t": time})
    values: Floats = value_and_slope(table, argument, of_time=of_time)[0] / float(drive.table.value_unit.factor)
    return curve_times, values


def impulses(run: xr.Dataset, coordinates: list[str]) -> list[str]:
    """Name the impulses that are not zero throughout."""
    names = [f"event_impulse_{name}" for name in coordinates]
    return [name for name in names if name in run and is_whole(run.attrs) and run.variables[name].values.any()]


def draw_impact_needles(run: xr.Dataset, names: list[str], overlay: Overlay, axes: Axes) -> None:
    """Draw the impulses of impacts as needles at their times."""
    for k, (label, record) in enumerate(overlay.with_run(run)):
        for name in (name for name in names if name in record and "event_time" in record):
            colour, text = colour_and_label(name, k, label, names, Overlay(), name.removeprefix("event_"))
            is_nonzero = record[name].values != 0.0
            time, values = record["event_time"].values[is_nonzero], record[name].values[is_nonzero]
            axes.vlines(time, 0.0, values, color=colour, linewidth=1.0)
            draw_line(axes, time, values, ".", colour, text)
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    label_panel(axes, "impulses of impacts", y=("impulse", run.variables[names[0]].attrs["units"]))
    set_run_time_axis(run, axes)
    _add_line_legend(axes, names, needed=bool(overlay.run_label))


def full_turn_of(units: str) -> float:
    """Return a full turn in a unit of angle."""
    return 2.0 * np.pi / float(parse_unit(units).factor)


def wrapped_angles(values: Floats, units: str) -> Floats:
    """Return angles within half a turn to either side."""
    full_turn = full_turn_of(units)
    angles: Floats = values - full_turn * np.round(values / full_turn)
    return angles


def torn_angles(values: Floats, units: str) -> Floats:
    """Return wrapped angles with a gap where they jump, so that no line joins both sides."""
    angles = wrapped_angles(values, units)
    angles[1:][np.abs(np.diff(angles)) > full_turn_of(units) / 2.0] = np.nan
    return angles


def wrapped_names(run: xr.Dataset) -> tuple[str, ...]:
    """Name the angles that the run's model asks to wrap."""
    return model_of_record(run, None).elements.pictured.wrap if "model_toml" in run else ()


def draw_section(
    run: xr.Dataset, names: list[str], overlay: Overlay, axes: Axes, transient: Transient | None = None
) -> None:
    """Draw the Poincaré section: velocities against positions, once per period, without those of the transient."""
    model = model_of_record(run, None)
    strobe_times = section_times(model, float(run["time"][0]), float(run["time"][-1]))
    times = times_after_transient(run, strobe_times, transient)
    for k, (label, record) in enumerate(overlay.with_run(run)):
        if "model_toml" not in record or not {*names} <= {*record.variables}:
            continue
        its_model, time = model_of_record(record, None), record["time"].values
        its_times = times_after_transient(record, section_times(its_model, float(time[0]), float(time[-1])), transient)
        states = sample(record, its_times, functions=its_model.functions)
        for name in names:
            position, units = states[name].values, str(run.variables[name].attrs["units"])
            position = wrapped_angles(position, units) if name in model.elements.pictured.wrap else position
            colour, text = colour_and_label(name, k, label, names, Overlay())
            draw_line(axes, position, states[velocity(name)].values, ".", colour, text, size=2.5)
    left_out = f" after {strobe_times.size - times.size}" if strobe_times.size > times.size else ""
    second = unit_suffix(model.time_unit.text)
    title = f"Poincare section, {times.size} periods of {_period(model):.4g}{second}{left_out}"
    _label_phase_plane(run, names, title, axes)
    _add_line_legend(axes, names, needed=bool(overlay.run_label))


def _label_phase_plane(run: xr.Dataset, names: list[str], title: str, axes: Axes) -> None:
    """Label a plane of positions and their velocities."""
    speeds = [velocity(name) for name in names]
    x, y = ((axis_title(group), run.variables[group[0]].attrs["units"]) for group in (names, speeds))
    label_panel(axes, title, x=x, y=y)


def section_times(model: Model, start: float, end: float) -> Floats:
    """Return the times of a section: one in each period that a model names."""
    period = _period(model)
    times = start + period * np.arange(1, min(MOST_DOTS, int((end - start) / period * (1 + 1e-12))) + 1)
    return np.asarray(times[times <= end], float)


def _period(model: Model) -> float:
    return float(evaluate(model.elements.expanded(model.elements.pictured.section), constants(model)))  # type: ignore[arg-type]


def draw_phase_portrait(run: xr.Dataset, names: list[str], overlay: Overlay, axes: Axes) -> None:
    """Draw velocities against positions."""
    wrapped_angle_names = wrapped_names(run)
    for name in names:
        units = str(run.variables[name].attrs["units"])
        tear, wrap = (
            partial(function, units=units) if name in wrapped_angle_names else lambda angles: angles
            for function in (torn_angles, wrapped_angles)
        )
        curves: list[tuple[str, Any]] = [(overlay.run_label, plotted_lines(run, name, velocity(name))[1])]
        for companion in overlay.companions:
            pair = companion.values_at_common_times(name, velocity(name))
            curves += [] if pair is None else [(companion.label, pair)]
        for k, (label, (positions, velocities)) in enumerate(curves):
            colour, text = colour_and_label(name, k, label, names, overlay)
            line, speeds = tear(positions), velocities
            if k == 0 and is_long(run):
                line, speeds = curve_in_plane(run, *(run.variables[entry].values for entry in (name, velocity(name))))
                line = tear(line)
                draw_isolated(axes, line, speeds, colour)
            draw_line(axes, line, speeds, run_dashes(k), colour, text)
            draw_line(axes, wrap(positions[:1]), velocities[:1], "o", colour)
    note = straight_lines_note(run, *names, *(velocity(name) for name in names))
    _label_phase_plane(run, names, f"phase portrait (dot: start){note}", axes)
    _add_line_legend(axes, names, overlay)


def run_dashes(k: int) -> str:
    """Return the dashes of the k-th run: the first one is solid."""
    return "-" if k == 0 else DASHES[(k - 1) % len(DASHES)]


def colour_and_label(
    name: str, k: int, run: str, names: list[str], overlay: Overlay, shown_name: str = ""
) -> tuple[str, str]:
    """Return colour and label of a variable's line of the k-th run, which is called `run`.

    A few variables have a colour for each line. Of more each keeps its colour in all runs, and is named once; runs are told
    apart by their dashes, which `_add_line_legend` names.
    """
    i, shown_name = names.index(name), shown_name or name
    if is_crossed(names, overlay):
        return COLOURS[i % len(COLOURS)], "" if k else shown_name
    text = run if run and len(names) == 1 else ", ".join(filter(None, (shown_name, run)))
    return COLOURS[(i + k * len(names)) % len(COLOURS)], text


def is_crossed(names: list[str], overlay: Overlay) -> bool:
    """Whether there are so many variables of several runs that the legend names them apart."""
    return bool(overlay.run_label) and len(names) > MOST_CROSSED


def _add_line_legend(axes: Axes, names: list[str], overlay: Overlay | None = None, *, needed: bool = False) -> None:
    """Name the lines of a panel, where there are several and not too many for it."""
    if overlay is not None and is_crossed(names, overlay):
        draw_line(axes, [], [], "-", GREY, overlay.run_label, 1.1)
        for k, companion in enumerate(overlay.companions, 1):
            draw_line(axes, [], [], "+" if companion.record is None else run_dashes(k), GREY, companion.label, 1.1, 6.0)
    if needed or (overlay is not None and overlay.run_label) or 1 < len(names) <= MOST_NAMED:
        axes.legend(fontsize=8, frameon=False)


def needs_logarithmic_time(run: xr.Dataset) -> bool:
    """Whether logarithmic time suits the rows: half of them lie in the first hundredth of the span."""
    time, numbers = run.variables["time"].values, run[STEPS].values
    span, median = time[-1] - time[0], np.interp((numbers[0] + numbers[-1]) / 2.0, numbers, time)
    return bool(len(time) >= FEWEST_LATE and span > 0 and median - time[0] < LATE * span)


def set_run_time_axis(run: xr.Dataset, axes: Axes) -> None:
    """Give a panel the time axis of all the others: the run's span, logarithmic where that suits its rows."""
    label_time(axes, run["time"])
    time = run.variables["time"].values
    if needs_logarithmic_time(run):
        first = float(np.diff(time)[np.diff(time) > 0].min())
        axes.set_xscale("log", nonpositive="mask")
        axes.set_xlim(time[0] + first, time[-1])
        return
    margin = 0.05 * (time[-1] - time[0])
    if margin > 0:
        axes.set_xlim(time[0] - margin, time[-1] + margin)


ROUNDINGS = 16.0  # spacings of the largest force, which the balance of forces at a contact may leave


def groups_by_unit(run: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group variables that share an axis: those of one unit, and elements of one quantity for themselves.

    Of many elements those along each axis (the few labels of a last dimension) are a group.
    """
    groups: dict[tuple[str, str], list[str]] = {}
    for name in names:
        quantity, labels = split_element_name(name)
        groups.setdefault((run.variables[name].attrs["units"], quantity if labels else ""), []).append(name)
    return [part for group in groups.values() for part in _by_axis(group)]


def _by_axis(names: list[str]) -> list[list[str]]:
    """Part many elements by the last of several dimensions, where that has few and each part is still a map."""
    parts: dict[str, list[str]] = {}
    for name in names:
        labels = split_element_name(name)[1]
        parts.setdefault(labels[-1] if len(labels) > 1 else "", []).append(name)
    is_many = min(map(len, parts.values())) > MOST_LINES
    return [*parts.values()] if is_many and len(parts) < FEWEST_ELEMENTS else [names]


def drives_by_unit(run: xr.Dataset) -> list[list[str]]:
    """Group the drives of a run's model by unit."""
    if "model_toml" not in run:
        return []
    model = model_of_record(run, None)
    groups: dict[str, list[str]] = {}
    for name, drive in model.elements.drives.items():
        if (free_names(model.elements.looked_up_at[name]) & {*model.elements.units}).issubset(run.variables):
            groups.setdefault(drive.table.value_unit.text, []).append(name)
    return list(groups.values())


def are_rounding_errors(run: xr.Dataset, names: list[str]) -> bool:
    """Whether reactions of one unit are nothing but what rounding leaves of the forces that they balance."""
    units = run.variables[names[0]].attrs["units"]
    forces = [name for name in with_role(run, "force") if run.variables[name].attrs["units"] == units]
    largest = max((_largest_magnitude(run, name) for name in forces), default=0.0)
    return max(_largest_magnitude(run, name) for name in names) <= ROUNDINGS * EPS * largest


def _largest_magnitude(run: xr.Dataset, name: str) -> float:
    values = run.variables[name].values
    return float(np.nanmax(np.abs(values), initial=0.0)) if run.variables[name].dims[:1] == (STEPS,) else 0.0


PARTS = {"event_time_uncertainty_bracket": "width of the bracket", "event_time_uncertainty": "uncertainty"}


def draw_steps(run: xr.Dataset, overlay: Overlay, axes: Axes) -> None:
    """Draw the steps on a logarithmic scale; an event's second row has none."""
    _draw_positive_points(run, "step_size", overlay.run_label or "accepted", 5, axes)
    _draw_companion_points(overlay, "step_size", axes)
    attributes = run.variables["trial_reason"].attrs
    reasons = np.array(attributes["flag_meanings"].split()) if attributes["role"] == "flag" else np.zeros(0, "U")
    error_test_codes = np.atleast_1d(attributes["flag_values"])[reasons == "error_test"] if reasons.size else reasons
    rejected = np.flatnonzero(np.isin(run.variables["trial_reason"].values, error_test_codes))
    if len(rejected):
        rejected = rejected[thinned_rows(run.variables["trial_step_size"].values[rejected])]
        time, size = (run.variables[name].values[rejected] for name in ("trial_time", "trial_step_size"))
        draw_line(axes, time, size, "x", 1, "rejected by the error test", size=3.5, markeredgewidth=0.8)
    if len(rejected) or overlay.run_label:
        axes.legend(fontsize=8, frameon=False)
    _set_logarithmic(axes)
    label_panel(axes, "step used to reach each state", y=time_axis_label(run["step_size"], "step size"))
    set_run_time_axis(run, axes)


def draw_errors(run: xr.Dataset, overlay: Overlay, axes: Axes) -> None:
    """Draw the error norm of every accepted step; 1 is what the tolerances allow."""
    _draw_positive_points(run, "error_norm", overlay.run_label, 2, axes)
    if _draw_companion_points(overlay, "error_norm", axes):
        axes.legend(fontsize=8, frameon=False)
    axes.axhline(1.0, color="#777777", linewidth=0.8, linestyle="--")
    _set_logarithmic(axes)
    label_panel(axes, "local error over what the tolerances allow", y="scaled local error (1)")
    set_run_time_axis(run, axes)


def _draw_companion_points(overlay: Overlay, name: str, axes: Axes) -> bool:
    """Draw the positive values of other runs; return whether there are any."""
    companion_records = [(label, record) for label, record in overlay.records if name in record]
    for k, (label, record) in enumerate(companion_records):
        _draw_positive_points(record, name, label, k + 3, axes)
    return bool(companion_records)


def _draw_positive_points(run: xr.Dataset, name: str, label: str, colour: int, axes: Axes) -> None:
    """Draw what has a place on a logarithmic axis: positive values, thinned."""
    time, values = run.variables["time"].values, run.variables[name].values
    rows = np.flatnonzero(values > 0)
    rows = rows[thinned_rows(values[rows])] if len(rows) else rows
    draw_line(axes, time[rows], values[rows], ".", colour, label, size=2.5)


def _set_logarithmic(axes: Axes) -> None:
    """Give positive points a logarithmic axis, where there are any."""
    if len(axes.lines[0].get_xdata()):  # type: ignore[arg-type]
        axes.set_yscale("log")


def draw_event_locations(run: xr.Dataset, axes: Axes) -> None:
    """Draw the width of each event's bracket and the uncertainty of its time."""
    time = run.variables["event_time"].values
    for k, (name, marker) in enumerate(zip(PARTS, "_.", strict=True)):
        values = run.variables[name].values
        is_drawable = (values > 0) & np.isfinite(values)
        draw_line(axes, time[is_drawable], values[is_drawable], marker, k, PARTS[name], size=5)
    axes.set_yscale("log")
    label_panel(axes, "events: bracket, and uncertainty of the time", y=time_axis_label(run["time"], "located within"))
    set_run_time_axis(run, axes)
    axes.legend(fontsize=8, frameon=False)


EXCHANGED = 1e-2  # of the largest energy, from which on what changes the total is worth three lines
STEP_ROUNDINGS = 16.0  # of the largest energy, for each step of a walk without a bias
POINT = 4.0  # points of a mark at a row
MATTERS = 0.05  # of the change of the total energy


def is_exchanged(run: xr.Dataset) -> bool:
    """Whether the change of the total energy is large enough to be seen beside the energies."""
    return _departure(run) > EXCHANGED


def is_at_rounding(run: xr.Dataset) -> bool:
    """Whether the total energy is kept to what the rounding of each step leaves, so that its changes say nothing."""
    return bool(_departure(run) <= STEP_ROUNDINGS * np.finfo(float).eps * np.sqrt(run.sizes[STEPS]))


def _departure(run: xr.Dataset) -> float:
    """Return the range of the total energy as a part of the largest energy."""
    largest = max(float(np.abs(run.variables[name].values).max()) for name in ENERGIES if name in run)
    return float(np.ptp(run.variables["total_energy"].values)) / largest if largest else 0.0


def draw_energy(run: xr.Dataset, overlay: Overlay, axes: Axes) -> None:
    """Draw kinetic, potential and total energy if energy is exchanged, or kept to rounding, else how the total departs from its start.

    Of several runs the total is drawn alone.
    """
    units, energy = run.variables["total_energy"].attrs["units"], run.variables["total_energy"].values
    companions = [companion for companion in overlay.companions if "total_energy" in companion.columns]
    is_conserved, is_relative = is_at_rounding(run), not is_exchanged(run)
    if (not is_relative or is_conserved) and not companions:
        _draw_energies(run, units, axes, is_conserved=is_conserved)
        return
    times, (values,) = plotted_lines(run, "total_energy", exact=True)
    style = _energy_line_style(run, "total_energy", exact=True)
    draw_line(axes, times, values - is_relative * energy[0], colour=not companions, label=overlay.run_label, **style)
    for k, companion in enumerate(companions, 1):
        times, values, _ = companion.columns["total_energy"]
        draw_line(axes, times, values - is_relative * values[0], run_dashes(k), k, companion.label, 1.2)
    if companions:
        axes.legend(fontsize=8, frameon=False)
    note = _at_rows(run, "total_energy", exact=True)
    known_digits = known_part(float(run.attrs["solver_rtol"]) if "solver_rtol" in run.attrs else None, [])
    start = (
        f" less its start, {short_number(float(energy[0]), known_digits)}{unit_suffix(units)}" if is_relative else ""
    )
    label_panel(axes, f"total energy{start}{note}", y=("E - E(0)" if is_relative else "E", units))
    set_run_time_axis(run, axes)


def _draw_energies(run: xr.Dataset, units: str, axes: Axes, *, is_conserved: bool) -> None:
    """Draw kinetic, potential and total energy."""
    names = [name for name in ENERGIES if name in run and run.variables[name].attrs["units"] == units]
    lines = {name: plotted_lines(run, name) for name in names}
    sizes = [(float(np.abs(values).max()), float(np.ptp(values))) for _, (values,) in lines.values()]
    is_flat = STEADY * max(size for size, _ in sizes) > max(change for _, change in sizes) > 0.0
    style = _energy_line_style(run, *names)
    for k, (name, (times, (values,))) in enumerate(lines.items()):
        draw_line(axes, times, values - is_flat * values[0], colour=k, label=name.split("_")[0], **style)
    note = f", total constant to {_departure(run):.0e} (relative)" if is_conserved else _energy_change_note(run)
    title = f"energy{', each less its start' * is_flat}{note}{_at_rows(run, *names)}"
    label_time(axes, run["time"])
    set_run_time_axis(run, axes)
    label_panel(axes, title, y=("energy", units))
    axes.legend(fontsize=8, frameon=False)
    shade_regimes(run, axes)


def _energy_line_style(run: xr.Dataset, *names: str, exact: bool = False) -> dict[str, Any]:
    """Return the style of lines, or of points where energies between rows are unknown: chords would miss their swings."""
    if not has_chords(run, *names, exact=exact):
        return {}
    return {"style": ".", "size": POINT if run.sizes[STEPS] < FEW_ROWS else POINT / 2.0}


def _at_rows(run: xr.Dataset, *names: str, exact: bool = False) -> str:
    return "; at recorded states" if has_chords(run, *names, exact=exact) else ""


def _energy_change_note(run: xr.Dataset) -> str:
    """Name what changes the total energy appreciably: forces, events or the method's error."""
    changes = energy_changes(run)
    if changes is None:
        return ""
    share = MATTERS * float(np.ptp(run.variables["total_energy"].values))
    causes = [cause for cause, change in changes.items() if change > share]
    model = known_model(run)
    if causes[-1:] == ["the method's error"] and model is not None and steps_over_impacts(run, model):
        causes[-1:] = ["contacts", "the method's error"]
    if causes == ["the method's error"]:
        return ", changed by the method's error alone"
    return f", changed by {', '.join(causes[:-1])}{' and ' * (len(causes) > 1)}{causes[-1]}" if causes else ""


FEWEST_TERMS = 2  # potentials, of which each alone says more than their sum
MOST_TERMS = 5  # that are drawn; of more those that change most
KINETIC, POTENTIAL = "kinetic_energy", "potential_energy"


def has_terms(run: xr.Dataset) -> bool:
    """Whether the potential energy of a run is a sum of several, and the record has what they are made of."""
    model = known_model(run)
    if model is None or not {KINETIC, POTENTIAL, *model.elements.units} <= {*run.variables}:
        return False
    return _count_potentials(model) >= FEWEST_TERMS


def _count_potentials(model: Model) -> int:
    forces = model.statement.forces if model.shapes.dims else model.elements.forces
    return sum(force.potential is not None for force in forces.values())


def potential_terms(run: xr.Dataset) -> tuple[Floats, dict[str, Floats]] | None:
    """Return times and the potential energy of each term, in the SI unit of its sum; None if they do not give the recorded sum.

    Rows of a long run are thinned; where its steps were made again there are points inside of them.
    """
    model, inner = known_model(run), inner_states(run)
    if model is None:
        return None
    time, sums = run.variables["time"].values, run.variables[POTENTIAL].values
    rows = thinned_rows(sums, times=time)
    states, times, places = {name: run.variables[name].values[rows] for name in model.elements.units}, time[rows], rows
    if inner is not None and inner.is_repeated and {*model.elements.units} <= {*inner.states}:
        order = np.argsort(np.concatenate([rows, inner.rows + 0.5]), kind="stable")
        times = np.concatenate([times, inner.times])[order]
        states = {name: np.concatenate([states[name], inner.states[name]])[order] for name in model.elements.units}
        places = np.concatenate([rows, inner.rows])[order]
    try:
        potentials = potentials_on(run, model, states, times, places)
    except (InputError, KeyError):
        return None
    row_positions = np.searchsorted(times, time[rows], side="left")
    potential_sums = sum(potentials.values(), np.zeros(times.size))[row_positions]
    recorded_sums = sums[np.searchsorted(time, time[rows], side="left")]
    is_same = np.abs(potential_sums - recorded_sums) <= AGREED * np.abs(sums).max()
    return (times, potentials) if np.mean(is_same) > 0.5 else None


def draw_energy_terms(run: xr.Dataset, axes: Axes) -> None:
    """Draw kinetic energy, and the potential energy of each term; of many those that change most, and the sum of the rest."""
    times_and_terms = potential_terms(run)
    units = str(run.variables[KINETIC].attrs["units"])
    times, (kinetic,) = plotted_lines(run, KINETIC)
    draw_line(axes, times, kinetic, "--", label="kinetic")
    note = ""
    if times_and_terms is not None:
        times, energies = times_and_terms
        if STEADY * max(np.abs(values).max() for values in energies.values()) > max(
            map(np.ptp, [kinetic, *energies.values()])
        ):
            energies, note = {name: values - values[0] for name, values in energies.items()}, ", each less its start"
        order = sorted(energies, key=lambda name: (-float(np.ptp(energies[name])), name))
        drawn_terms = [name for name in energies if name in order[:MOST_TERMS]]
        for k, name in enumerate(drawn_terms, 1):
            draw_line(axes, times, energies[name], colour=k, label=name)
        if remaining_terms := [name for name in energies if name not in drawn_terms]:
            remaining_energy = sum((energies[name] for name in remaining_terms), np.zeros(times.size))
            draw_line(axes, times, remaining_energy, ":", "0.5", f"{len(remaining_terms)} others")
    label_panel(axes, f"kinetic energy, and potential energy by term{note}", y=("energy", units))
    axes.legend(fontsize=8, frameon=False)
    shade_regimes(run, axes)
    set_run_time_axis(run, axes)
