"""States between the rows of a record, on Hermite polynomials through what is recorded at both ends of a step."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.schema import acceleration, rate, velocity

if TYPE_CHECKING:
    import xarray as xr

Rows = NDArray[np.int64]
Floats = NDArray[np.float64]


def bent(run: xr.Dataset, name: str, times: Floats, rows: Rows) -> Floats | None:
    """Return a state on Hermite polynomials: a coordinate from its velocity and acceleration, a velocity from its acceleration."""
    owner = name.removeprefix(velocity(""))
    chain = (name, rate(name)) if rate(name) in run.variables else (name, velocity(name), acceleration(name))
    if name == velocity(owner) and owner in run.variables:
        chain = (name, acceleration(owner))
    if chain[1] not in run.variables:
        return None
    chain = chain if {*chain} <= set(run.variables) else chain[:2]  # of a run of states alone
    time, values = (
        run.variables["time"].values,
        [run.variables[derivative].values for derivative in chain],
    )  # rates are in their owner's unit per second
    h = (time[rows + 1] - time[rows]).astype(float)
    return _hermite(
        [derivative[rows] for derivative in values],
        [derivative[rows + 1] for derivative in values],
        h,
        (times - time[rows]) / h,
    )


def _hermite(start: list[Floats], end: list[Floats], w: Floats, u: Floats) -> Floats:
    """Return the Hermite polynomial through values and derivatives at both ends of steps of size w, at fractions u of them.

    Quintic with two derivatives, cubic with one (Hairer, Norsett, Wanner, Solving ODEs I, section II.6).
    """
    a, b, p, q = start[0], end[0], w * start[1], w * end[1]
    if len(start) == 2:
        return a + u * p + u**2 * (3 * (b - a) - 2 * p - q) + u**3 * (2 * (a - b) + p + q)
    k, m = w**2 * start[2], w**2 * end[2]
    rest, slope, bend = b - a - p - k / 2, q - p - k, m - k
    return (
        a
        + u * p
        + u**2 * k / 2
        + u**3 * (10 * rest - 4 * slope + bend / 2)
        + u**4 * (-15 * rest + 7 * slope - bend)
        + u**5 * (6 * rest - 3 * slope + bend / 2)
    )
