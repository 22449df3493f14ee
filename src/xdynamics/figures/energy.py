"""The energy of a run: how the method, forces and events change it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.companions import Beside
from xdynamics.figures.curves import drawn, energy_changes
from xdynamics.figures.line_panels import DASHES, over_the_run, straight
from xdynamics.figures.marks import COLOURS, label_time, shade_regimes, words
from xdynamics.schema import ENERGIES, STEPS
from xdynamics.units import unit_suffix
from xdynamics.units.digits import known_part, short_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXCHANGED = 1e-2  # of the largest energy, from which on what changes the total is worth three lines
ROUNDINGS = 16.0  # of the largest energy, for each step of a walk without a bias
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


def draw(run: xr.Dataset, beside: Beside, axes: Axes) -> None:
    """Draw kinetic, potential and total energy if energy is exchanged, or kept to rounding, else how the total departs from its start.

    Of several runs the total is drawn alone.
    """
    units, energy = run.variables["total_energy"].attrs["units"], run.variables["total_energy"].values
    others = [other for other in beside.others if "total_energy" in other.columns]
    label_time(axes, run["time"])
    kept = is_at_rounding(run)
    if (is_exchanged(run) or kept) and not others:
        names = [name for name in ENERGIES if name in run]
        for colour, name in zip(COLOURS, names, strict=False):
            times, (values,) = drawn(run, name)
            axes.plot(times, values, color=colour, linewidth=1.0, label=name.split("_")[0])
        axes.set(ylabel=words(f"energy ({units})"))
        about = f", total constant to {_departure(run):.0e} (relative)" if kept else _changed(run)
        axes.set_title(f"energy{about}{straight(run, *names)}", loc="left", fontsize=10)
        axes.legend(fontsize=8, frameon=False)
        shade_regimes(run, axes)
        return
    less = not is_exchanged(run)
    times, (values,) = drawn(run, "total_energy", exact=True)
    label = words(beside.own) if others else None
    axes.plot(times, values - less * energy[0], color=COLOURS[0 if others else 1], linewidth=1.0, label=label)
    for k, other in enumerate(others):
        times, values, _ = other.columns["total_energy"]
        colour, dashes = COLOURS[(k + 1) % len(COLOURS)], DASHES[k % len(DASHES)]
        axes.plot(times, values - less * values[0], dashes, color=colour, linewidth=1.2, label=words(other.label))
    if others:
        axes.legend(fontsize=8, frameon=False)
    axes.set(ylabel=words(f"{'E - E(0)' if less else 'E'} ({units})"))
    note = straight(run, "total_energy", exact=True)
    known = known_part(float(run.attrs["solver_rtol"]) if "solver_rtol" in run.attrs else None, [])
    start = f" less its start, {short_number(float(energy[0]), known)}{unit_suffix(units)}" if less else ""
    axes.set_title(words(f"total energy{start}{note}"), loc="left", fontsize=10)
    over_the_run(run, axes)


def _changed(run: xr.Dataset) -> str:
    """Name what changes the total energy appreciably: forces, events or the method's error."""
    changes = energy_changes(run)
    if changes is None:
        return ""
    share = MATTERS * float(np.ptp(run.variables["total_energy"].values))
    causes = [what for what, change in changes.items() if change > share]
    if causes == ["the method's error"]:
        return ", changed by the method's error alone"
    return f", changed by {', '.join(causes[:-1])}{' and ' * (len(causes) > 1)}{causes[-1]}" if causes else ""
