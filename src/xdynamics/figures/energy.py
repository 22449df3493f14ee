"""The energy of a run: what the method does to it, and what forces without a potential take and bring."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.curves import thinned
from xdynamics.figures.lines import DASHES, Beside, over_the_run
from xdynamics.figures.marks import COLOURS, shade_regimes, words
from xdynamics.schema import ENERGIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes

EXCHANGED = 1e-2  # of the largest energy, from which on the total changes by what forces do


def is_exchanged(run: xr.Dataset) -> bool:
    """Whether drives, drags or impacts change the total energy by more than a method would."""
    total = run["total_energy"].values
    largest = max(float(np.abs(run[name].values).max()) for name in ENERGIES if name in run)
    return bool(np.ptp(total) > EXCHANGED * largest)


def draw(run: xr.Dataset, beside: Beside, axes: Axes) -> None:
    """Draw kinetic, potential and total energy where they are exchanged, else how the total leaves its start."""
    time, units = run["time"].values, run["total_energy"].attrs["units"]
    if is_exchanged(run):
        for colour, name in zip(COLOURS, ENERGIES, strict=False):
            if name in run:
                rows = thinned(run[name].values)
                axes.plot(time[rows], run[name].values[rows], color=colour, linewidth=1.0, label=name.split("_")[0])
        axes.set(xlabel="time (s)", ylabel=words(f"energy ({units})"))
        axes.set_title("energy, which forces without a potential change", loc="left", fontsize=10)
        axes.legend(fontsize=8, frameon=False)
        shade_regimes(run, axes)
        return
    energy = run["total_energy"].values
    rows = thinned(energy)
    axes.plot(time[rows], energy[rows] - energy[0], color=COLOURS[1], linewidth=1.0)
    for k, (label, columns) in enumerate(beside):
        if "total_energy" in columns:
            times, values, _ = columns["total_energy"]
            axes.plot(times, values - values[0], DASHES[k % len(DASHES)], color=COLOURS[(k + 2) % len(COLOURS)], linewidth=1.0, label=words(label))  # fmt: skip
            axes.legend(fontsize=8, frameon=False)
    axes.set(xlabel="time (s)", ylabel=words(f"E - E(0) ({units})"))
    axes.set_title(words(f"total energy less its start, {float(energy[0]):.6g} {units}"), loc="left", fontsize=10)
    over_the_run(run, axes)
