"""Panels of lines against time, and of velocities against positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of
from xdynamics.evidence.sampling import sample
from xdynamics.expressions import Name, free_names, text_of
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.figures.companions import Beside
from xdynamics.figures.curves import DOTS, alone, drawn, is_long, moments, unjoined
from xdynamics.figures.element_maps import draw_map
from xdynamics.figures.event_marks import mark_events
from xdynamics.figures.marks import COLOURS, label_time, shade_regimes, words
from xdynamics.figures.panel_words import joined, straight
from xdynamics.figures.transients import Transient, settled
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.drives import looked_up
from xdynamics.model.motion import constants, tables_of
from xdynamics.record.partial_records import is_whole
from xdynamics.schema import STEPS, velocity
from xdynamics.units import parse_unit, unit_suffix

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


def against_time(run: xr.Dataset, names: list[str], what: str, beside: Beside, axes: Axes) -> None:
    """Draw variables of one unit against time; more than six as a map."""
    if len(names) > MOST_LINES:
        draw_map(run, names, what, axes)
        return
    time, around = run.variables["time"].values, wraps(run)
    for name in names:
        colour, label = key(name, 0, beside.own, names, beside)
        values, (times, (line,)) = run.variables[name].values, drawn(run, name)
        if name in around:
            units = str(run.variables[name].attrs["units"])
            values, line = wrapped(values, units), torn(line, units)
        if run.sizes[STEPS] < FEW_ROWS:
            axes.plot(time, values, ".", color=colour, markersize=4)
        axes.plot(times, line, "-", color=colour, linewidth=1.2, label=words(label))
    overlaid = _overlay(run, names, beside, axes)
    label = SHORT_NAMES[what] if what in SHORT_NAMES and len(names) > 1 else joined(names)
    label_time(axes, run["time"])
    axes.set(ylabel=words(f"{label} ({run.variables[names[0]].attrs['units']})"))
    note = straight(run, *names, beside=[record for _, record in beside.records])
    axes.set_title(f"{what}{note}", loc="left", fontsize=10)
    shade_regimes(run, axes)
    marked = mark_events(run, names, axes)
    over_the_run(run, axes)
    _legend(axes, names, beside if overlaid else Beside(), needed=marked)


def _overlay(run: xr.Dataset, names: list[str], beside: Beside, axes: Axes) -> bool:
    """Draw the same variables of other runs and measurements."""
    overlaid, around = False, wraps(run)
    for k, other in enumerate(beside.others):
        for name in names:
            if name not in other.columns:
                continue
            colour, label = key(name, k + 1, other.label, names, beside)
            times, values, doubts = other.columns[name]
            text = words(label)
            if name in around:
                values = (torn if doubts is None else wrapped)(values, str(run.variables[name].attrs["units"]))
            if doubts is None:
                axes.plot(times, values, DASHES[k % len(DASHES)], color=colour, linewidth=1.4, alpha=0.7, label=text)
            else:
                axes.errorbar(
                    times,
                    values,
                    yerr=doubts if doubts.any() else None,
                    fmt="+",
                    color=colour,
                    markersize=5,
                    linewidth=0.8,
                    label=text,
                )
            overlaid = True
    return overlaid


def driven(run: xr.Dataset, names: list[str], beside: Beside, axes: Axes) -> None:
    """Draw the values of measured tables along the run, and along others."""
    drives = model_of(run, None).drives
    for k, (label, record) in enumerate([(beside.own, run), *beside.records]):
        for name in names:
            if (found := _along(record, name)) is None:
                continue
            colour, text = key(name, k, label, names, beside, f"{name}({text_of(drives[name].argument)})")
            axes.plot(*found, ("-", *DASHES)[k % 4], color=colour, linewidth=1.1, label=words(text))
    label_time(axes, run["time"])
    axes.set(ylabel=words(f"{joined(names)} ({drives[names[0]].table.value_unit.text})"))
    axes.set_title("measured drives along the run", loc="left", fontsize=10)
    over_the_run(run, axes)
    _legend(axes, names, beside)


def _along(run: xr.Dataset, name: str) -> tuple[Floats, Floats] | None:
    """Return times and values of a measured table along a run; None if its model has no such table."""
    if "model_toml" not in run or name not in (model := model_of(run, None)).drives:
        return None
    drive, time = model.drives[name], run.variables["time"].values
    table = dict(zip(model.drives, tables_of(model), strict=True))[name]
    place = model.looked_up_at[name]
    of_time = place == CLOCK
    if of_time:  # its own points too, which no step may have met
        points = table[0][(table[0] > time[0]) & (table[0] < time[-1])]
        at = argument = np.union1d(moments(run), points)
    elif isinstance(place, Name):
        at, (argument,) = drawn(run, place.name)
        argument = argument * float(model.units[place.name].factor)
    else:
        read = free_names(place) & {*model.units}
        state = {word: run.variables[word].values * float(model.units[word].factor) for word in read}
        at, argument = time, evaluate_many(place, {**constants(model), **state, "t": time})
    values: Floats = looked_up(table, argument, of_time=of_time)[0] / float(drive.table.value_unit.factor)
    return at, values


def impulses(run: xr.Dataset, coordinates: list[str]) -> list[str]:
    """Name the impulses that are not zero throughout."""
    names = [f"event_impulse_{name}" for name in coordinates]
    return [name for name in names if name in run and is_whole(run.attrs) and run.variables[name].values.any()]


def impact_needles(run: xr.Dataset, names: list[str], beside: Beside, axes: Axes) -> None:
    """Draw the impulses of impacts as needles at their times."""
    for k, (label, record) in enumerate([(beside.own, run), *beside.records]):
        for name in names:
            if name not in record or "event_time" not in record:
                continue
            colour, text = key(name, k, label, names, Beside(), name.removeprefix("event_"))
            time, values = record["event_time"].values, record[name].values
            shown = values != 0.0
            axes.vlines(time[shown], 0.0, values[shown], color=colour, linewidth=1.0)
            axes.plot(time[shown], values[shown], ".", color=colour, markersize=4, label=words(text))
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    label_time(axes, run["time"])
    axes.set(ylabel=words(f"impulse ({run.variables[names[0]].attrs['units']})"))
    axes.set_title("impulses of impacts", loc="left", fontsize=10)
    over_the_run(run, axes)
    _legend(axes, names, needed=bool(beside.own))


def turn(units: str) -> float:
    """Return a full turn in a unit of angle."""
    return 2.0 * np.pi / float(parse_unit(units).factor)


def wrapped(values: Floats, units: str) -> Floats:
    """Return angles within half a turn to either side."""
    full_turn = turn(units)
    angles: Floats = values - full_turn * np.round(values / full_turn)
    return angles


def torn(values: Floats, units: str) -> Floats:
    """Return wrapped angles with a gap where they jump, so that no line joins both sides."""
    angles = wrapped(values, units)
    angles[1:][np.abs(np.diff(angles)) > turn(units) / 2.0] = np.nan
    return angles


def wraps(run: xr.Dataset) -> tuple[str, ...]:
    """Name the angles that the run's model asks to wrap."""
    return model_of(run, None).pictured.wrap if "model_toml" in run else ()


def section(run: xr.Dataset, names: list[str], beside: Beside, axes: Axes, transient: Transient | None = None) -> None:
    """Draw the Poincaré section: velocities against positions, once per period, without those of the transient."""
    model = model_of(run, None)
    found = strobes(model, float(run["time"][0]), float(run["time"][-1]))
    times = settled(run, found, transient)
    for k, (label, record) in enumerate([(beside.own, run), *beside.records]):
        if "model_toml" not in record or not {*names} <= {*record.variables}:
            continue
        its_model, time = model_of(record, None), record["time"].values
        its_times = settled(record, strobes(its_model, float(time[0]), float(time[-1])), transient)
        states = sample(record, its_times, functions=its_model.functions)
        for name in names:
            units = str(run.variables[name].attrs["units"])
            position = wrapped(states[name].values, units) if name in model.pictured.wrap else states[name].values
            colour, text = key(name, k, label, names, Beside())
            speeds = states[velocity(name)].values
            axes.plot(position, speeds, ".", color=colour, markersize=2.5, label=words(text))
    speed_names = [velocity(coordinate) for coordinate in names]
    axes.set(
        xlabel=words(f"{joined(names)} ({run.variables[names[0]].attrs['units']})"),
        ylabel=words(f"{joined(speed_names)} ({run.variables[speed_names[0]].attrs['units']})"),
    )
    left_out = f" after {found.size - times.size}" if found.size > times.size else ""
    second = unit_suffix(model.time_unit.text)
    axes.set_title(
        f"Poincare section, {times.size} periods of {_period(model):.4g}{second}{left_out}", loc="left", fontsize=10
    )
    _legend(axes, names, needed=bool(beside.own))


def strobes(model: Model, start: float, end: float) -> Floats:
    """Return the times of a section: one in each period that a model names."""
    period = _period(model)
    times = start + period * np.arange(1, min(MOST_DOTS, int((end - start) / period * (1 + 1e-12))) + 1)
    return np.asarray(times[times <= end], float)


def _period(model: Model) -> float:
    return float(evaluate(model.expanded(model.pictured.section), constants(model)))  # type: ignore[arg-type]


def phase(run: xr.Dataset, names: list[str], beside: Beside, axes: Axes) -> None:
    """Draw velocities against positions."""
    around = wraps(run)
    for name in names:
        _, lines = drawn(run, name, velocity(name))
        found = [(beside.own, lines)]
        for other in beside.others:
            found += [(other.label, pair)] if (pair := other.together(name, velocity(name))) is not None else []
        for k, (label, (line, speeds)) in enumerate(found):
            start, units = line[:1], str(run.variables[name].attrs["units"])
            if name in around:
                start, line = wrapped(start, units), torn(line, units)  # noqa: PLW2901
            colour, text = key(name, k, label, names, beside)
            first = speeds[:1]
            if k == 0 and is_long(run):
                columns = (run.variables[entry].values for entry in (name, velocity(name), "time"))
                line, speeds = unjoined(*columns)  # noqa: PLW2901
                line = torn(line, units) if name in around else line  # noqa: PLW2901
                axes.plot(*alone(line, speeds), color=colour, **DOTS)
            axes.plot(line, speeds, ("-", *DASHES)[k % 4], color=colour, linewidth=1.0, label=words(text))
            axes.plot(start, first, "o", color=colour, markersize=4)
    units, per_second = run.variables[names[0]].attrs["units"], run.variables[velocity(names[0])].attrs["units"]
    axes.set(
        xlabel=words(f"{joined(names)} ({units})"),
        ylabel=words(f"{joined([velocity(name) for name in names])} ({per_second})"),
    )
    note = straight(run, *names, *(velocity(name) for name in names))
    axes.set_title(f"phase portrait (dot: start){note}", loc="left", fontsize=10)
    _legend(axes, names, beside)


def key(name: str, k: int, run: str, names: list[str], beside: Beside, shown: str = "") -> tuple[str, str]:
    """Return colour and label of a variable's line of the k-th run, which is called `run`.

    A few variables have a colour for each line. Of more each keeps its colour in all runs, and is named once; runs are told
    apart by their dashes, which `_legend` names.
    """
    i, shown = names.index(name), shown or name
    if is_crossed(names, beside):
        return COLOURS[i % len(COLOURS)], "" if k else shown
    text = run if run and len(names) == 1 else ", ".join(filter(None, (shown, run)))
    return COLOURS[(i + k * len(names)) % len(COLOURS)], text


def is_crossed(names: list[str], beside: Beside) -> bool:
    """Whether there are so many variables of several runs that the legend names them apart."""
    return bool(beside.own) and len(names) > MOST_CROSSED


def _legend(axes: Axes, names: list[str], beside: Beside | None = None, *, needed: bool = False) -> None:
    """Name the lines of a panel, where there are several and not too many for it."""
    if beside is not None and is_crossed(names, beside):
        axes.plot([], [], "-", color=GREY, linewidth=1.1, label=words(beside.own))
        for k, other in enumerate(beside.others):
            style = "+" if other.record is None else DASHES[k % len(DASHES)]
            axes.plot([], [], style, color=GREY, linewidth=1.1, label=words(other.label))
    if needed or (beside is not None and beside.own) or 1 < len(names) <= MOST_NAMED:
        axes.legend(fontsize=8, frameon=False)


def is_late(run: xr.Dataset) -> bool:
    """Whether logarithmic time suits the rows: half of them lie in the first hundredth of the span."""
    time, numbers = run.variables["time"].values, run[STEPS].values
    span, median = time[-1] - time[0], np.interp((numbers[0] + numbers[-1]) / 2.0, numbers, time)
    return bool(len(time) >= FEWEST_LATE and span > 0 and median - time[0] < LATE * span)


def over_the_run(run: xr.Dataset, axes: Axes) -> None:
    """Give a panel the time axis of all the others: the run's span, logarithmic where that suits its rows."""
    time = run.variables["time"].values
    if is_late(run):
        first = float(np.diff(time)[np.diff(time) > 0].min())
        axes.set_xscale("log", nonpositive="mask")
        axes.set_xlim(time[0] + first, time[-1])
        return
    margin = 0.05 * (time[-1] - time[0])
    if margin > 0:
        axes.set_xlim(time[0] - margin, time[-1] + margin)
