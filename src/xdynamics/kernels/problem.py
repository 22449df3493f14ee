"""The numbers of one run: what a compiled march is called with, in its internal units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.layout import Layout
from xdynamics.kernels.writer import constants_of
from xdynamics.model import Model
from xdynamics.model.drives import coefficients
from xdynamics.units import CONSTANTS, TIME, Scales, constant

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Problem:
    """An initial-value problem as plain numbers.

    Attributes
    ----------
    start : float
        Initial time.
    initial : tuple of float
        Coordinates, velocities and first-order states.
    parameters : tuple of float
        Parameters, unit constants and pi.
    tables : tuple
        Origin and coefficients of each drive's pieces.
    nodes : ndarray
        Times at which a drive of time changes its piece, ascending.
    """

    start: float
    initial: tuple[float, ...]
    parameters: tuple[float, ...]
    tables: tuple[tuple[Floats, Floats], ...]
    nodes: Floats


def pose(model: Model, scales: Scales) -> Problem:
    """Turn a model into numbers, in SI units over the scales."""
    layout = Layout(model)
    sizes = {name: scales.of(dimension) for name, dimension in model.dimensions.items()}
    values = {name: one.quantity.si / sizes[name] for name, one in model.parameters.items()}
    values |= {name: float(constant(name).factor) / sizes[name] for name in CONSTANTS}
    values["pi"] = float(np.pi)
    tables, nodes = [], [np.empty(0)]
    for name, drive in model.drives.items():
        argument = drive.table.argument / sizes[drive.argument]
        of_time = drive.argument == "t"
        values_there = drive.table.value / sizes[name]
        tables.append(coefficients(argument, values_there, drive.interpolation, drive.outside, of_time=of_time))
        if of_time:
            nodes.append(argument)
    return Problem(
        model.initial["t"].si / scales.of(TIME),
        tuple(model.initial[name].si / sizes[name] for name in layout.used),
        tuple(values[name] for name in constants_of(model)),
        tuple(tables),
        np.unique(np.concatenate(nodes)),
    )
