"""Figures of diagnoses: what changes from cycle to cycle."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.faults import InputError
from xdynamics.figures.marks import COLOURS, timed, words
from xdynamics.figures.sheet import Panel
from xdynamics.schema import CYCLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEADY = 1e-4  # of the first value: what changes by less is drawn as its change
SHOWN = ("period", "phase_offset", "amplitude", "phase_space_area")


def panels_of(found: xr.Dataset) -> list[Panel]:
    """Return what draws period, phase, amplitude and area of each cycle.

    Raises
    ------
    InputError
        If there is no cycle.
    """
    names = [name for name in SHOWN if name in found and found.sizes.get(CYCLE, 0) and found[name].notnull().any()]
    residuals = [str(name) for name in found.data_vars if str(name).startswith("residual_")]
    if not names:
        raise InputError(
            "there is nothing to draw: the diagnosis has no cycle; what it found is told by `xdynamics show`"
        )
    panels: list[Panel] = [partial(_along_cycles, found, name) for name in names]
    return panels + [partial(_residual, found, name) for name in residuals]


def foot_of(found: xr.Dataset) -> str:
    """Say what was counted, beside what, and what the energy did."""
    energy = ""
    if "energy_band" in found:
        units = found["energy_band"].attrs["units"]
        energy = (
            f"; energy band {float(found['energy_band']):.3g} {units}, drift {float(found['energy_drift']):.3g} {units}"
        )
    return f"cycles of {found.attrs['coordinate']}; phases beside {found.attrs['reference']}{energy}"


def _along_cycles(found: xr.Dataset, name: str, axes: Axes) -> None:
    one, units = found[name], found[name].attrs["units"]
    first = float(one[0])
    steady = float(np.nanmax(np.abs(one.values - first))) < STEADY * abs(first)
    values, shown = (one.values - first, f"{name} - {first:.9g} {units}") if steady else (one.values, name)
    axes.plot(found["cycle_time"].values, values, ".-", color=COLOURS[0], linewidth=1.0, markersize=4)
    axes.set(xlabel=timed(found["cycle_time"], "time at the end of the cycle"), ylabel=words(f"{name} ({units})"))
    axes.set_title(words(shown), loc="left", fontsize=10, pad=14)


def _residual(found: xr.Dataset, name: str, axes: Axes) -> None:
    one = found[name]
    axes.plot(found["time"].values, one.values, color=COLOURS[1], linewidth=1.0)
    axes.set(xlabel=timed(found["time"]), ylabel=words(f"{name} ({one.attrs['units']})"))
    axes.set_title(words(str(one.attrs["long_name"])), loc="left", fontsize=10)
