"""The energy of a run by term: kinetic energy, and the potential energy of each force that has one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.observables import potentials_on
from xdynamics.faults import InputError
from xdynamics.figures.curves import AGREED, inner_states, plotted_lines, thinned_rows
from xdynamics.figures.element_maps import STEADY
from xdynamics.figures.level_lines import known_model
from xdynamics.figures.line_panels import set_run_time_axis
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, shade_regimes
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
    return _count_potentials(model) >= FEWEST


def _count_potentials(model: Model) -> int:
    forces = model.shaped.forces if model.shapes.dims else model.forces
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
    states, times, places = {name: run.variables[name].values[rows] for name in model.units}, time[rows], rows
    if inner is not None and inner.is_repeated and {*model.units} <= {*inner.states}:
        order = np.argsort(np.concatenate([rows, inner.rows + 0.5]), kind="stable")
        times = np.concatenate([times, inner.times])[order]
        states = {name: np.concatenate([states[name], inner.states[name]])[order] for name in model.units}
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
    axes.plot(times, kinetic, "--", color=COLOURS[0], linewidth=1.0, label="kinetic")
    note = ""
    if times_and_terms is not None:
        times, energies = times_and_terms
        if STEADY * max(np.abs(values).max() for values in energies.values()) > max(
            map(np.ptp, [kinetic, *energies.values()])
        ):
            energies, note = {name: values - values[0] for name, values in energies.items()}, ", each less its start"
        order = sorted(energies, key=lambda name: (-float(np.ptp(energies[name])), name))
        drawn_terms = [name for name in energies if name in order[:MOST]]
        for colour, name in zip(COLOURS[1:], drawn_terms, strict=False):
            axes.plot(times, energies[name], color=colour, linewidth=1.0, label=escaped_text(name))
        if remaining_terms := [name for name in energies if name not in drawn_terms]:
            remaining_energy = sum((energies[name] for name in remaining_terms), np.zeros(times.size))
            axes.plot(times, remaining_energy, ":", color="0.5", linewidth=1.0, label=f"{len(remaining_terms)} others")
    label_time(axes, run["time"])
    axes.set(ylabel=escaped_text(f"energy ({units})"))
    axes.set_title(f"kinetic energy, and potential energy by term{note}", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
    shade_regimes(run, axes)
    set_run_time_axis(run, axes)
