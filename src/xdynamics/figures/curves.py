"""Lines through recorded states: bent between states that are far apart, thinned where there are very many."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.schema import acceleration, rate, velocity

DRAWN = 4000  # points of a line; what is longer is thinned
MOST_BETWEEN = 40  # points of a line from one state to the next

Rows = NDArray[np.int64]
Floats = NDArray[np.float64]


def thinned(values: NDArray[Any], most: int = DRAWN) -> Rows:
    """Return rows to draw: all, or the least and the greatest of each stretch, in order, with both ends."""
    n = len(values)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, most // 2 + 1).astype(np.int64)
    kept = [np.array([0, n - 1])]
    for begin, end in pairwise(edges):
        part = values[begin:end]
        kept.append(begin + np.array([np.argmin(part), np.argmax(part)]))
    return np.unique(np.concatenate(kept))


def paired(run: xr.Dataset, rows: Rows) -> Rows:
    """Add the states on both sides of events to rows, so that no line passes one by; only where they are few."""
    if not {"event_row_before", "event_row_after"} <= set(run.variables) or run.sizes["event"] > DRAWN:
        return rows
    sides = [run[f"event_row_{side}"].values for side in ("before", "after")]
    found: Rows = np.unique(np.concatenate([rows, *sides]))
    return found[found < run.sizes["step"]]


def between(run: xr.Dataset, name: str) -> tuple[Floats, Floats] | None:
    """Return times and values of a line that bends as the motion does, of a coordinate, a velocity or a state.

    From one state to the next it is Hermite's polynomial through what is recorded at both: of a coordinate its velocity and
    acceleration too, of a velocity the acceleration, of a first-order state the rate. None where that is not recorded, or
    states are so many that straight lines are as good.
    """
    time, n = run["time"].values, run.sizes["step"]
    points = min(DRAWN // max(1, n), MOST_BETWEEN)
    owner = name.removeprefix(velocity(""))
    chain = (name, rate(name)) if rate(name) in run.variables else (name, velocity(name), acceleration(name))
    if name == velocity(owner) and owner in run.variables:
        chain = (name, acceleration(owner))
    if points < 2 or n < 2 or not {*chain, "step_size"} <= set(run.variables):
        return None
    if not np.allclose(np.diff(time), run["step_size"].values[1:], rtol=1e-6, atol=0.0):
        return None  # rows were left out: what was between them is not recorded
    values = [run[one].values for one in chain]  # velocities and rates are in their owner's unit per second
    h = np.diff(time)
    s = np.arange(points) / points
    drawn = _hermite([one[:-1] for one in values], [one[1:] for one in values], h, s)
    times = (time[:-1, None] + h[:, None] * s).ravel()
    return np.append(times, time[-1]), np.append(drawn.ravel(), values[0][-1])


def _hermite(start: list[Floats], end: list[Floats], h: Floats, s: Floats) -> Floats:
    """Return Hermite's polynomial through values and their derivatives at both ends, shape (intervals, points).

    Of two derivatives the quintic one, of one the cubic (Hairer, Norsett, Wanner, Solving ODEs I, section II.6).
    """
    u, w = s[None, :], h[:, None]
    a, b = start[0][:, None], end[0][:, None]
    p, q = w * start[1][:, None], w * end[1][:, None]
    if len(start) == 2:
        return a + u * p + u**2 * (3 * (b - a) - 2 * p - q) + u**3 * (2 * (a - b) + p + q)
    k, m = w**2 * start[2][:, None], w**2 * end[2][:, None]
    rest, slope, bend = b - a - p - k / 2, q - p - k, m - k
    return a + u * p + u**2 * k / 2 + u**3 * (10 * rest - 4 * slope + bend / 2) + u**4 * (-15 * rest + 7 * slope - bend) + u**5 * (6 * rest - 3 * slope + bend / 2)  # fmt: skip
