"""The energy of a run: how the method, forces and events change it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.curves import drawn, energy_changes
from xdynamics.figures.lines import DASHES, Beside, over_the_run, straight
from xdynamics.figures.marks import COLOURS, shade_regimes, timed, words
from xdynamics.schema import ENERGIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXCHANGED = 1e-2  # of the largest energy, from which on what changes the total is worth three lines
MATTERS = 0.05  # of the change of the total energy


def is_exchanged(run: xr.Dataset) -> bool:
    """Whether the change of the total energy is large enough to be seen beside the energies."""
    total = run["total_energy"].values
    largest = max(float(np.abs(run[name].values).max()) for name in ENERGIES if name in run)
    return bool(np.ptp(total) > EXCHANGED * largest)


def draw(run: xr.Dataset, beside: Beside, axes: Axes) -> None:
    """Draw kinetic, potential and total energy if energy is exchanged, otherwise how the total departs from its start."""
    units, energy = run["total_energy"].attrs["units"], run["total_energy"].values
    axes.set_xlabel(timed(run["time"]))
    if is_exchanged(run):
        names = [name for name in ENERGIES if name in run]
        for colour, name in zip(COLOURS, names, strict=False):
            times, (values,) = drawn(run, name)
            axes.plot(times, values, color=colour, linewidth=1.0, label=name.split("_")[0])
        axes.set(ylabel=words(f"energy ({units})"))
        axes.set_title(f"energy{_changed(run)}{straight(run, *names)}", loc="left", fontsize=10)
        axes.legend(fontsize=8, frameon=False)
        shade_regimes(run, axes)
        return
    times, (values,) = drawn(run, "total_energy", exact=True)
    axes.plot(times, values - energy[0], color=COLOURS[1], linewidth=1.0)
    for k, (label, columns) in enumerate(beside):
        if "total_energy" in columns:
            times, values, _ = columns["total_energy"]
            axes.plot(
                times,
                values - values[0],
                DASHES[k % len(DASHES)],
                color=COLOURS[(k + 2) % len(COLOURS)],
                linewidth=1.0,
                label=words(label),
            )
            axes.legend(fontsize=8, frameon=False)
    axes.set(ylabel=words(f"E - E(0) ({units})"))
    note = straight(run, "total_energy", exact=True)
    axes.set_title(words(f"total energy less its start, {float(energy[0]):.6g} {units}{note}"), loc="left", fontsize=10)
    over_the_run(run, axes)


def _changed(run: xr.Dataset) -> str:
    """Name what changes the total energy appreciably: forces, events or the method's error."""
    changes = energy_changes(run)
    if changes is None:
        return ""
    share = MATTERS * float(np.ptp(run["total_energy"].values))
    causes = [what for what, change in changes.items() if change > share]
    if causes == ["the method's error"]:
        return ", changed by the method's error alone"
    return f", changed by {', '.join(causes[:-1])}{' and ' * (len(causes) > 1)}{causes[-1]}" if causes else ""
