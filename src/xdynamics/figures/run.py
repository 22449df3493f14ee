"""Figures of runs: drawn from the record alone, against recorded times, with units and events."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.faults import InputError
from xdynamics.figures.curves import between, paired, thinned
from xdynamics.figures.marks import COLOURS, mark_events, shade_regimes, words
from xdynamics.figures.sheet import Panel
from xdynamics.record import check
from xdynamics.record.kinds import is_whole
from xdynamics.schema import STEPS, velocity

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEW_ROWS = 400  # up to which every accepted state is a dot
LONGEST_LABEL = 24  # characters
MOST_NAMED = 8  # lines in a legend
CONTACTS = "contact and friction"


_PARTS = {"event_time_uncertainty_bracket": "width of the bracket", "event_time_uncertainty": "uncertainty"}
FEWEST_LOCATED = 3  # events, from which on a panel tells more than their list


def panels_of(run: xr.Dataset) -> list[Panel]:
    """Return what draws each panel of a run: trajectory, velocity, forces and impulses of contacts, phase portrait, energy error, steps.

    Between few states lines are Hermite's polynomials through states, velocities and accelerations; those of more than
    4,000 points are thinned by keeping the least and the greatest value of each stretch. The record keeps every row.

    Raises
    ------
    InputError
        If the Dataset has no recorded times.
    """
    if "time" not in run.variables or run["time"].dims != (STEPS,) or not run["time"].size:
        raise InputError("plot needs a run record with 'time' along 'step'")
    check(run, whole=False, values=False)
    panels = list(_panels(run))
    if not panels:
        raise InputError(
            f"there is nothing along '{STEPS}' to draw among {', '.join(map(str, run.data_vars)) or 'nothing'}"
        )
    return panels


def foot_of(run: xr.Dataset) -> str:
    """Say how a run ended."""
    return f"{run.attrs.get('run_outcome', '')}: {run.attrs.get('run_outcome_text', '')}"


def _panels(run: xr.Dataset) -> Iterator[Panel]:
    """Yield what draws each panel, in reading order."""
    coordinates = _with_role(run, "coordinate")
    for names in _by_unit(run, coordinates):
        yield partial(_against_time, run, names, "trajectory")
    moving = [name for name in coordinates if _drawn(run, velocity(name))]
    for names in _by_unit(run, [velocity(name) for name in moving]):
        yield partial(_against_time, run, names, "velocity")
    for names in _by_unit(run, _with_role(run, "state")):
        yield partial(_against_time, run, names, "first-order state")
    for names in _by_unit(run, [name for name in _with_role(run, "reaction") if run[name].values.any()]):
        yield partial(_against_time, run, names, CONTACTS)
    for names in _by_unit(run, _impulses(run)):
        yield partial(_struck, run, names)
    for names in _by_unit(run, moving):
        yield partial(_phase, run, names)
    if _drawn(run, "total_energy"):
        yield partial(_energy, run)
    if _drawn(run, "step_size", "trial_reason", "trial_step_size", "trial_time"):
        yield partial(_steps, run)
    if _drawn(run, "error_norm"):
        yield partial(_errors, run)
    if run.sizes.get("event", 0) >= FEWEST_LOCATED and {*_PARTS} <= set(run.variables):
        yield partial(_locations, run)


def _against_time(run: xr.Dataset, names: list[str], what: str, axes: Axes) -> None:
    time = run["time"].values
    for colour, name in zip(_cycled(names), names, strict=True):
        values, curve, shown = run[name].values, between(run, name), words(name)
        rows, dots = thinned(values), "." if run.sizes[STEPS] < FEW_ROWS else ""
        if curve is None:
            axes.plot(time[rows], values[rows], dots + "-", color=colour, linewidth=1.2, markersize=4, label=shown)
        else:
            axes.plot(time, values, marker=dots, linestyle="none", color=colour, markersize=4)
            axes.plot(*curve, "-", color=colour, linewidth=1.2, label=shown)
    label = _joined(names) if what != CONTACTS else "force"
    axes.set(xlabel="time (s)", ylabel=words(f"{label} ({run[names[0]].attrs['units']})"))
    axes.set_title(what, loc="left", fontsize=10)
    shade_regimes(run, axes)
    mark_events(run, names, axes)
    _legend(axes, names)


def _impulses(run: xr.Dataset) -> list[str]:
    """Name the impulses of which there are some."""
    names = [f"event_impulse_{name}" for name in _with_role(run, "coordinate")]
    return [name for name in names if name in run and is_whole(run.attrs) and run[name].values.any()]


def _struck(run: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw the impulses of impacts as needles at their times."""
    time = run["event_time"].values
    for colour, name in zip(_cycled(names), names, strict=True):
        values = run[name].values
        shown = values != 0.0
        axes.vlines(time[shown], 0.0, values[shown], color=colour, linewidth=1.0)
        axes.plot(time[shown], values[shown], ".", color=colour, markersize=4, label=words(name.removeprefix("event_")))
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    axes.set(xlabel="time (s)", ylabel=words(f"impulse ({run[names[0]].attrs['units']})"))
    axes.set_title("impulses of impacts", loc="left", fontsize=10)
    _over_the_run(run, axes)
    _legend(axes, names)


def _phase(run: xr.Dataset, names: list[str], axes: Axes) -> None:
    for colour, name in zip(_cycled(names), names, strict=True):
        position, speed = run[name].values, run[velocity(name)].values
        rows = paired(run, np.union1d(thinned(position), thinned(speed)))
        drawn = position[rows], speed[rows]
        if (there := between(run, name)) is not None and (then := between(run, velocity(name))) is not None:
            drawn = there[1], then[1]
        axes.plot(*drawn, color=colour, linewidth=1.0, label=words(name))
        axes.plot(position[:1], speed[:1], "o", color=colour, markersize=4)
    units, per_second = run[names[0]].attrs["units"], run[velocity(names[0])].attrs["units"]
    axes.set(
        xlabel=words(f"{_joined(names)} ({units})"),
        ylabel=words(f"{_joined([velocity(name) for name in names])} ({per_second})"),
    )
    axes.set_title("phase portrait (dot: start)", loc="left", fontsize=10)
    _legend(axes, names)


def _energy(run: xr.Dataset, axes: Axes) -> None:
    energy = run["total_energy"]
    values = energy.values - energy.values[0]
    rows = thinned(values)
    axes.plot(run["time"].values[rows], values[rows], color=COLOURS[1], linewidth=1.0)
    axes.set(xlabel="time (s)", ylabel=words(f"E - E(0) ({energy.attrs['units']})"))
    axes.set_title(
        words(f"total energy less its start, {float(energy[0]):.6g} {energy.attrs['units']}"), loc="left", fontsize=10
    )


def _steps(run: xr.Dataset, axes: Axes) -> None:
    """Draw the steps on a logarithmic scale; an event's second row has none."""
    size, time = run["step_size"].values, run["time"].values
    taken = np.flatnonzero(size > 0)
    rows = taken[thinned(size[taken])] if len(taken) else taken
    axes.plot(time[rows], size[rows], ".", color=COLOURS[5], markersize=2.5, label="accepted")
    about = run["trial_reason"].attrs
    words = np.array(about["flag_meanings"].split()) if about["role"] == "flag" else np.zeros(0, "U")
    failed = np.atleast_1d(about["flag_values"])[words == "error_test"] if words.size else words
    chosen = np.flatnonzero(np.isin(run["trial_reason"].values, failed))
    if len(chosen):
        chosen = chosen[thinned(run["trial_step_size"].values[chosen])]
        axes.plot(run["trial_time"].values[chosen], run["trial_step_size"].values[chosen], "x", color=COLOURS[1],
                  markersize=3.5, markeredgewidth=0.8, label="rejected by the error test")  # fmt: skip
        axes.legend(fontsize=8, frameon=False)
    if len(rows):
        axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="step size (s)")
    _over_the_run(run, axes)
    axes.set_title("step used to reach each state", loc="left", fontsize=10)


def _errors(run: xr.Dataset, axes: Axes) -> None:
    """Draw the error norm of every accepted step; 1 is what the tolerances allow."""
    norm, time = run["error_norm"].values, run["time"].values
    taken = np.flatnonzero(norm > 0)
    rows = taken[thinned(norm[taken])] if len(taken) else taken
    axes.plot(time[rows], norm[rows], ".", color=COLOURS[2], markersize=2.5)
    axes.axhline(1.0, color="#777777", linewidth=0.8, linestyle="--")
    if len(rows):
        axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="scaled local error (1)")
    _over_the_run(run, axes)
    axes.set_title("local error over what the tolerances allow", loc="left", fontsize=10)


def _locations(run: xr.Dataset, axes: Axes) -> None:
    """Draw how wide the bracket of each event is, and how well its time is known."""
    time = run["event_time"].values
    for name, marker, colour in zip(_PARTS, "_.", (COLOURS[0], COLOURS[1]), strict=True):
        values = run[name].values
        shown = (values > 0) & np.isfinite(values)
        axes.plot(time[shown], values[shown], marker, color=colour, markersize=5, label=words(_PARTS[name]))
    axes.set_yscale("log")
    axes.set(xlabel="time (s)", ylabel="located within (s)")
    _over_the_run(run, axes)
    axes.set_title("events: bracket, and uncertainty of the time", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _with_role(run: xr.Dataset, role: str) -> list[str]:
    return [
        str(name) for name, one in run.data_vars.items() if one.attrs.get("role") == role and _drawn(run, str(name))
    ]


def _drawn(run: xr.Dataset, *names: str) -> bool:
    """Whether there are rows of all of these, as in a whole record there are."""
    return all(name in run and run[name].dims[:1] in ((STEPS,), ("trial",)) for name in names)


def _by_unit(run: xr.Dataset, names: list[str]) -> list[list[str]]:
    groups: dict[str, list[str]] = {}
    for name in names:
        groups.setdefault(run[name].attrs["units"], []).append(name)
    return list(groups.values())


def _cycled(names: list[str]) -> list[str]:
    return [COLOURS[i % len(COLOURS)] for i in range(len(names))]


def _joined(names: list[str]) -> str:
    """Name what an axis shows, briefly: the legend has all names."""
    joined = ", ".join(names)
    return joined if len(joined) <= LONGEST_LABEL else f"{names[0]} … {names[-1]}"


def _legend(axes: Axes, names: list[str]) -> None:
    """Name the lines of a panel, where there are several and not too many for it."""
    if 1 < len(names) <= MOST_NAMED:
        axes.legend(fontsize=8, frameon=False)


def _over_the_run(run: xr.Dataset, axes: Axes) -> None:
    """Give a panel the time axis of all the others."""
    time = run["time"].values
    margin = 0.05 * (time[-1] - time[0])
    if margin > 0:
        axes.set_xlim(time[0] - margin, time[-1] + margin)
