"""Figures of modes: the shape of each, coordinate beside coordinate, with its frequency."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.faults import InputError
from xdynamics.figures.marks import COLOURS, typeset, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.shapes import parted
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHAPE = "shape_"
MOST_NAMED = 10  # coordinates with their names below them
TILTED = 5  # names, from where on they are tilted


def panels_of(modes: xr.Dataset) -> list[Panel]:
    """Return the panel of each mode, the slowest first.

    Raises
    ------
    InputError
        If nothing oscillates.
    """
    order = np.argsort(modes["frequency"].values, kind="stable")
    if not order.size:
        raise InputError("there is nothing to draw: the model has no modes")
    return [partial(_shape, modes, int(number)) for number in order]


def foot_of(modes: xr.Dataset) -> str:
    """Describe where the modes are of."""
    return f"{modes.attrs.get('summary', '')}; the largest displacement of each mode is 1, in SI units"


def _shape(modes: xr.Dataset, number: int, axes: Axes) -> None:
    """Draw the displacement of every coordinate in a mode."""
    from matplotlib.ticker import MaxNLocator

    shapes = {str(name): variable for name, variable in modes.items() if variable.attrs.get("role") == "mode_shape"}
    values = np.array([float(variable[number]) for variable in shapes.values()])
    places = np.arange(values.size)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.vlines(places, 0.0, values, color=COLOURS[0], linewidth=1.0, alpha=0.5)
    axes.plot(places, values, "o-", color=COLOURS[0], markersize=4, linewidth=1.0)
    names = [words(name.removeprefix(SHAPE)) for name in shapes]
    wholes, elements = zip(*(parted(name.removeprefix(SHAPE)) for name in shapes), strict=True)
    if values.size <= MOST_NAMED:
        if len({*wholes}) == 1 and all(elements):  # of one quantity, which the axis names
            names = [words(", ".join(labels)) for labels in elements]
            axes.set_xlabel(words(wholes[0]))
        tilted: dict[str, Any] = (
            {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if values.size >= TILTED else {}
        )
        axes.set_xticks(places, names, **tilted)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(f"{names[0]} to {names[-1]}")
    units = dict.fromkeys(str(variable.attrs["units"]) for variable in shapes.values())
    axes.set(ylim=(-1.15, 1.15), ylabel=words(f"displacement ({', '.join(map(typeset, units))})"))
    said = [
        f"{float(modes[name][number]):.4g}{unit_suffix(typeset(str(modes[name].attrs['units'])))}"
        for name in ("frequency", "period")
        if name in modes
    ]
    axes.set_title(words(f"mode {number + 1}: {', period '.join(said)}"), loc="left", fontsize=10)


PAGE = Page(("modes",), panels_of, foot_of, most_panels=6)
