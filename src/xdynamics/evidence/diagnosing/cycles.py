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

SMALLEST = 1e-6  # of the range: a smaller rise and fall is not a swing
TURNS = 60  # of a search: at least every eighth one halves the bracket
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
        Of the crossings, and what their location is uncertain by; the error of the run is not included.
    rule : str
        Why this level.
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
        """Time from each crossing to the next, shape (n - 1,), s."""
        return np.diff(self.times)

    @property
    def doubt(self) -> str:
        """Return a warning if the coordinate turns more often than it passes the level; empty if it does not."""
        if len(self.times) >= self.maxima - 1:
            return ""
        times = {0: "never", 1: "once"}.get(len(self.times), f"{len(self.times)} times")
        return (
            f"{self.name} has {self.maxima} maxima and rises through the level {times}: a cycle here is none from"
            " maximum to maximum; give a level that every swing passes"
        )

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
        In the coordinate's unit. Without it 0, or the middle of the coordinate's range, or that of its smallest swing:
        the first of these that it rises through at least twice, and half as often as it has maxima; else the one that
        it rises through most often.

    Raises
    ------
    InputError
        If there is no such coordinate.
    """
    if name not in run.variables or run[name].attrs.get("role") != "coordinate":
        coordinates = [
            str(coordinate)
            for coordinate, variable in run.data_vars.items()
            if variable.attrs.get("role") == "coordinate"
        ]
        raise InputError(f"'{name}' is no coordinate of the run; there are {', '.join(coordinates) or 'none'}")
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    turns = _turned(values, np.asarray(run[schema.velocity(name)]))
    maxima, rule = int(np.count_nonzero(turns > 0)), "given"
    if level is None:
        level, rule = _chosen(values, time, np.abs(turns), maxima)
    rows = _risen(values, time, level)
    located = _located(run, name, level, rows, functions) if rows.size else (np.zeros(0), np.zeros(0))
    return Cycles(name, level, *located, rule, maxima)


def _turned(values: Floats, speeds: Floats) -> NDArray[np.int64]:
    """Return the rows from which a velocity has another sign than before: positive for a maximum, else negative."""
    moving = np.flatnonzero(speeds)
    up = speeds[moving] > 0.0
    places = np.flatnonzero(up[:-1] != up[1:])
    rows = moving[places + 1]
    swings = np.abs(np.diff(np.concatenate([values[:1], values[rows], values[-1:]])))
    large = np.maximum(swings[:-1], swings[1:]) > SMALLEST * float(np.ptp(values))
    signed_rows: NDArray[np.int64] = np.where(up[places], rows, -rows)[large]
    return signed_rows


def _chosen(values: Floats, time: Floats, turns: NDArray[np.int64], maxima: int) -> tuple[float, str]:
    """Choose a level that cycles rise through; see `cycles`."""
    levels = {"zero": 0.0, "the middle of the range": float(np.min(values) + np.max(values)) / 2.0}
    ends = values[turns]
    if ends.size > 1:
        least = int(np.argmin(np.abs(np.diff(ends))))
        levels["the middle of the smallest swing"] = float(ends[least] + ends[least + 1]) / 2.0
    counts = {rule: len(_risen(values, time, level)) for rule, level in levels.items()}
    enough = [rule for rule, count in counts.items() if count > 1 and 2 * count >= maxima]
    rule = enough[0] if enough else max(counts, key=lambda candidate: counts[candidate])
    if not enough and counts[rule] == counts["the middle of the range"]:
        rule = "the middle of the range"
    return levels[rule], rule


def _risen(values: Floats, time: Floats, level: float) -> NDArray[np.int64]:
    """Return the rows from which a step rises through a level; a start on the level is not a crossing."""
    rows: NDArray[np.int64] = np.flatnonzero((values[:-1] < level) & (values[1:] >= level) & (np.diff(time) > 0))
    return rows


def _located(
    run: xr.Dataset,
    name: str,
    level: float,
    rows: NDArray[np.int64],
    functions: Mapping[str, Callable[..., float]] | None,
) -> tuple[Floats, Floats]:
    """Locate all crossings at once, by Newton steps that stay inside brackets, and by bisection."""
    time = np.asarray(run["time"])
    speed = schema.velocity(name)
    low, high = time[rows], time[rows + 1]
    here = low + (high - low) * (level - (y := np.asarray(run[name]))[rows]) / (y[rows + 1] - y[rows])
    for turn in range(TURNS):
        at = sample(run, here, side="before", functions=functions)
        off, slope = at[name].values - level, at[speed].values
        low, high = np.where(off < 0.0, here, low), np.where(off < 0.0, high, here)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = here - off / slope
        # a step as small as rounding ends where it began, at an end of the bracket: halving would restart the search
        inside = (newton >= low) & (newton <= high) & (turn % 8 != 7)
        there = np.where(off == 0.0, here, np.where(inside, newton, (low + high) / 2.0))
        small = np.abs(there - here) <= 2.0 * EPS * np.maximum(np.abs(here), high - low)
        here = there
        if small.all():
            break
    at = sample(run, here, side="before", functions=functions)
    with np.errstate(divide="ignore", invalid="ignore"):
        uncertainty = (np.abs(at[schema.error(name)].values) + np.abs(at[name].values - level)) / np.abs(
            at[speed].values
        )
    return here, uncertainty + EPS * np.abs(here)
