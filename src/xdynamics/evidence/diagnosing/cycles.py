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

SMALLEST = 1e-6  # of the range: what goes up and down by less is no swing
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
    rule : str
        Why through this level.
    maxima : int
        How often the coordinate turns from rising to falling.
    """

    name: str
    level: float
    times: Floats
    uncertainties: Floats
    rule: str
    maxima: int

    @property
    def periods(self) -> Floats:
        """From each to the next, shape (n - 1,), s."""
        return np.diff(self.times)

    @property
    def doubt(self) -> str:
        """Say so where the coordinate turns oftener than it comes by the level; empty where it does not."""
        if len(self.times) >= self.maxima - 1:
            return ""
        times = {0: "never", 1: "once"}.get(len(self.times), f"{len(self.times)} times")
        return f"{self.name} has {self.maxima} maxima and rises through the level {times}: a cycle here is none from maximum to maximum; give a level that every swing passes"  # fmt: skip

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
        In the coordinate's unit. Without it 0, or the middle of the coordinate's range, or that of its smallest swing: the
        first of these that it rises through twice at least, and half as often as it has maxima; else the one that it rises
        through most often.

    Raises
    ------
    InputError
        If there is no such coordinate.
    """
    if name not in run.variables or run[name].attrs.get("role") != "coordinate":
        known = [str(one) for one, about in run.data_vars.items() if about.attrs.get("role") == "coordinate"]
        raise InputError(f"'{name}' is no coordinate of the run; there are {', '.join(known) or 'none'}")
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    turns = _turned(values, np.asarray(run[schema.velocity(name)]))
    maxima, rule = int(np.count_nonzero(turns > 0)), "given"
    if level is None:
        level, rule = _chosen(values, time, np.abs(turns), maxima)
    rows = _risen(values, time, level)
    located = _located(run, name, level, rows, functions) if rows.size else (np.zeros(0), np.zeros(0))
    return Cycles(name, level, *located, rule, maxima)


def _turned(values: Floats, speeds: Floats) -> NDArray[np.int64]:
    """Return the rows from which a velocity has another sign than before; a maximum's row as it is, a minimum's negative."""
    moving = np.flatnonzero(speeds)
    up = speeds[moving] > 0.0
    places = np.flatnonzero(up[:-1] != up[1:])
    rows = moving[places + 1]
    swings = np.abs(np.diff(np.concatenate([values[:1], values[rows], values[-1:]])))
    large = np.maximum(swings[:-1], swings[1:]) > SMALLEST * float(np.ptp(values))
    found: NDArray[np.int64] = np.where(up[places], rows, -rows)[large]
    return found


def _chosen(values: Floats, time: Floats, turns: NDArray[np.int64], maxima: int) -> tuple[float, str]:
    """Choose a level that cycles rise through; see `cycles`."""
    found = {"zero": 0.0, "the middle of the range": float(np.min(values) + np.max(values)) / 2.0}
    ends = values[turns]
    if ends.size > 1:
        least = int(np.argmin(np.abs(np.diff(ends))))
        found["the middle of the smallest swing"] = float(ends[least] + ends[least + 1]) / 2.0
    counts = {rule: len(_risen(values, time, level)) for rule, level in found.items()}
    enough = [rule for rule, count in counts.items() if count > 1 and 2 * count >= maxima]
    rule = enough[0] if enough else max(counts, key=lambda one: counts[one])
    if not enough and counts[rule] == counts["the middle of the range"]:
        rule = "the middle of the range"
    return found[rule], rule


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
        # a step of rounding ends where it began, which is an end of the bracket: halving from there would begin anew
        inside = (aimed >= low) & (aimed <= high) & (turn % 8 != 7)
        there = np.where(off == 0.0, here, np.where(inside, aimed, (low + high) / 2.0))
        small = np.abs(there - here) <= 2.0 * EPS * np.maximum(np.abs(here), high - low)
        here = there
        if small.all():
            break
    at = sample(run, here, side="before", functions=functions)
    with np.errstate(divide="ignore", invalid="ignore"):
        doubt = (np.abs(at[schema.error(name)].values) + np.abs(at[name].values - level)) / np.abs(at[speed].values)
    return here, doubt + EPS * np.abs(here)
