"""Cycles of a coordinate: the times at which it rises through a level, located by steps of the run's own method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

TURNS = 60  # of a search: every second one halves at least
EPS = float(np.finfo(float).eps)
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Cycles:
    """Where a coordinate rises through a level.

    Attributes
    ----------
    name : str
    level : float
        In the coordinate's unit.
    times, uncertainties : ndarray, shape (n,), s
        Of what was located: not of the states that it was located between.
    """

    name: str
    level: float
    times: Floats
    uncertainties: Floats

    @property
    def periods(self) -> Floats:
        """From each to the next, shape (n - 1,), s."""
        return np.diff(self.times)

    def phase(self, times: Floats) -> Floats:
        """Return the phase at times, rad: whole turns at the crossings, in proportion between; nan outside."""
        if len(self.times) < 2:
            return np.full(times.shape, np.nan)
        turns = np.arange(len(self.times), dtype=float)
        return np.interp(times, self.times, TURN * turns, left=np.nan, right=np.nan)


def cycles(
    run: xr.Dataset,
    name: str,
    *,
    level: float | None = None,
    functions: Mapping[str, Callable[..., float]] | None = None,
) -> Cycles:
    """Locate where a coordinate rises through a level.

    Parameters
    ----------
    run : xarray.Dataset
        A run record.
    name : str
        A coordinate.
    level : float, optional
        In the coordinate's unit; 0 where the coordinate rises through it twice at least, else the middle of its range.

    Raises
    ------
    InputError
        If there is no such coordinate.
    """
    if name not in run.variables or run[name].attrs.get("role") != "coordinate":
        known = [str(one) for one, about in run.data_vars.items() if about.attrs.get("role") == "coordinate"]
        raise InputError(f"'{name}' is no coordinate of the run; there are {', '.join(known) or 'none'}")
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    if level is None:
        level = 0.0 if len(_risen(values, time, 0.0)) > 1 else float(np.min(values) + np.max(values)) / 2.0
    rows = _risen(values, time, level)
    if not rows.size:
        return Cycles(name, level, np.zeros(0), np.zeros(0))
    return Cycles(name, level, *_located(run, name, level, rows, functions))


def _risen(values: Floats, time: Floats, level: float) -> NDArray[np.int64]:
    """Return the rows from which a step rises through a level; the start on a level is where the motion begins."""
    found: NDArray[np.int64] = np.flatnonzero((values[:-1] < level) & (values[1:] >= level) & (np.diff(time) > 0))
    return found


def _located(run: xr.Dataset, name: str, level: float, rows: NDArray[np.int64], functions: Mapping[str, Callable[..., float]] | None) -> tuple[Floats, Floats]:  # fmt: skip
    """Search all crossings at once, by Newton's steps that stay inside halving brackets."""
    time = np.asarray(run["time"])
    speed = schema.velocity(name)
    low, high = time[rows], time[rows + 1]
    here = low + (high - low) * (level - (y := np.asarray(run[name]))[rows]) / (y[rows + 1] - y[rows])
    for turn in range(TURNS):
        at = sample(run, here, side="before", functions=functions)
        off, slope = at[name].values - level, at[speed].values
        low, high = np.where(off < 0.0, here, low), np.where(off < 0.0, high, here)
        with np.errstate(divide="ignore", invalid="ignore"):
            aimed = here - off / slope
        inside = (aimed > low) & (aimed < high) & (turn % 8 != 7)
        there = np.where(off == 0.0, here, np.where(inside, aimed, (low + high) / 2.0))
        small = np.abs(there - here) <= 2.0 * EPS * np.maximum(np.abs(here), high - low)
        here = there
        if small.all():
            break
    at = sample(run, here, side="before", functions=functions)
    with np.errstate(divide="ignore", invalid="ignore"):
        doubt = (np.abs(at[schema.error(name)].values) + np.abs(at[name].values - level)) / np.abs(at[speed].values)
    return here, doubt + EPS * np.abs(here)
