"""The energy of a run: how the method, forces and events change it.

The energy of a run by term: kinetic energy, and the potential energy of each force that has one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.path import steps_over_impacts
from xdynamics.evidence.observables import potentials_on
from xdynamics.faults import InputError
from xdynamics.figures.companions import Overlay
from xdynamics.figures.curves import (
    AGREED,
    energy_changes,
    has_chords,
    inner_states,
    known_model,
    plotted_lines,
    thinned_rows,
)
from xdynamics.figures.element_maps import STEADY
from xdynamics.figures.line_panels import FEW_ROWS, run_dashes, set_run_time_axis
from xdynamics.figures.marks import draw_line, label_panel, label_time, shade_regimes
from xdynamics.model import Model
from xdynamics.schema import ENERGIES, STEPS
from xdynamics.units import unit_suffix
from xdynamics.units.digits import known_part, short_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXCHANGED = 1e-2  # of the largest energy, from which on what changes the total is worth three lines
ROUNDINGS = 16.0  # of the largest energy, for each step of a walk without a bias
POINT = 4.0  # points of a mark at a row
MATTERS = 0.05  # of the change of the total energy


def is_exchanged(run: xr.Dataset) -> bool:
    """Whether the change of the total energy is large enough to be seen beside the energies."""
    return _departure(run) > EXCHANGED


def is_at_rounding(run: xr.Dataset) -> bool:
    """Whether the total energy is kept to what the rounding of each step leaves, so that its changes say nothing."""
    return bool(_departure(run) <= ROUNDINGS * np.finfo(float).eps * np.sqrt(run.sizes[STEPS]))


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
    draw_line(axes, times, kinetic, "--", label="kinetic")
    note = ""
    if times_and_terms is not None:
        times, energies = times_and_terms
        if STEADY * max(np.abs(values).max() for values in energies.values()) > max(
            map(np.ptp, [kinetic, *energies.values()])
        ):
            energies, note = {name: values - values[0] for name, values in energies.items()}, ", each less its start"
        order = sorted(energies, key=lambda name: (-float(np.ptp(energies[name])), name))
        drawn_terms = [name for name in energies if name in order[:MOST]]
        for k, name in enumerate(drawn_terms, 1):
            draw_line(axes, times, energies[name], colour=k, label=name)
        if remaining_terms := [name for name in energies if name not in drawn_terms]:
            remaining_energy = sum((energies[name] for name in remaining_terms), np.zeros(times.size))
            draw_line(axes, times, remaining_energy, ":", "0.5", f"{len(remaining_terms)} others")
    label_panel(axes, f"kinetic energy, and potential energy by term{note}", y=("energy", units))
    axes.legend(fontsize=8, frameon=False)
    shade_regimes(run, axes)
    set_run_time_axis(run, axes)
