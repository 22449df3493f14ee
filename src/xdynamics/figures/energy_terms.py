"""The energy of a run by term: kinetic energy, and the potential energy of each force that has one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.observables import potentials_on
from xdynamics.faults import InputError
from xdynamics.figures.curves import AGREED, drawn, inner_states, thinned
from xdynamics.figures.element_maps import STEADY
from xdynamics.figures.level_lines import known_model
from xdynamics.figures.line_panels import over_the_run
from xdynamics.figures.marks import COLOURS, label_time, shade_regimes, words
from xdynamics.model import Model

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

FEWEST = 2  # potentials, of which each alone says more than their sum
MOST = 5  # that are drawn; of more those that change most
KINETIC, POTENTIAL = "kinetic_energy", "potential_energy"


def has_terms(run: xr.Dataset) -> bool:
    """Whether the potential energy of a run is a sum of several, and the record has what they are made of."""
    model = known_model(run)
    if model is None or not {KINETIC, POTENTIAL, *model.units} <= {*run.variables}:
        return False
    return _count(model) >= FEWEST


def _count(model: Model) -> int:
    forces = model.shaped.forces if model.shapes.dims else model.forces
    return sum(force.potential is not None for force in forces.values())


def terms(run: xr.Dataset) -> tuple[Floats, dict[str, Floats]] | None:
    """Return times and the potential energy of each term, in the SI unit of its sum; None if they do not give the recorded sum.

    Rows of a long run are thinned; where its steps were made again there are points inside of them.
    """
    model, inner = known_model(run), inner_states(run)
    if model is None:
        return None
    time, sums = run.variables["time"].values, run.variables[POTENTIAL].values
    rows = thinned(sums, times=time)
    states, times, places = {name: run.variables[name].values[rows] for name in model.units}, time[rows], rows
    if inner is not None and inner.again and {*model.units} <= {*inner.states}:
        order = np.argsort(np.concatenate([rows, inner.rows + 0.5]), kind="stable")
        times = np.concatenate([times, inner.times])[order]
        states = {name: np.concatenate([states[name], inner.states[name]])[order] for name in model.units}
        places = np.concatenate([rows, inner.rows])[order]
    try:
        found = potentials_on(run, model, states, times, places)
    except (InputError, KeyError):
        return None
    at = np.searchsorted(times, time[rows], side="left")
    together = sum(found.values(), np.zeros(times.size))[at]
    known = sums[np.searchsorted(time, time[rows], side="left")]
    is_same = np.abs(together - known) <= AGREED * np.abs(sums).max()
    return (times, found) if np.mean(is_same) > 0.5 else None


def draw(run: xr.Dataset, axes: Axes) -> None:
    """Draw kinetic energy, and the potential energy of each term; of many those that change most, and the sum of the rest."""
    found = terms(run)
    units = str(run.variables[KINETIC].attrs["units"])
    times, (kinetic,) = drawn(run, KINETIC)
    axes.plot(times, kinetic, "--", color=COLOURS[0], linewidth=1.0, label="kinetic")
    note = ""
    if found is not None:
        times, each = found
        if STEADY * max(np.abs(values).max() for values in each.values()) > max(map(np.ptp, [kinetic, *each.values()])):
            each, note = {name: values - values[0] for name, values in each.items()}, ", each less its start"
        order = sorted(each, key=lambda name: (-float(np.ptp(each[name])), name))
        shown = [name for name in each if name in order[:MOST]]
        for colour, name in zip(COLOURS[1:], shown, strict=False):
            axes.plot(times, each[name], color=colour, linewidth=1.0, label=words(name))
        if rest := [name for name in each if name not in shown]:
            others = sum((each[name] for name in rest), np.zeros(times.size))
            axes.plot(times, others, ":", color="0.5", linewidth=1.0, label=f"{len(rest)} others")
    label_time(axes, run["time"])
    axes.set(ylabel=words(f"energy ({units})"))
    axes.set_title(f"kinetic energy, and potential energy by term{note}", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    shade_regimes(run, axes)
    over_the_run(run, axes)
