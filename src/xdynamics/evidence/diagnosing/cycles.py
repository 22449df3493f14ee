"""Cycles of a coordinate: the times at which it rises through a level, located by steps of the run's own method."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.chunks import Chunks
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.record.unfolding import find_column
from xdynamics.shapes.naming import split_element_name

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

SMALLEST = 1e-6  # of the range: a smaller rise and fall is not a swing
ROUNDING = 1e-9  # of the largest value of a quantity: an element that moves by less hardly moves beside the others
TURNS = 60  # of a search: at least every eighth one halves the bracket
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
    share : float
        Of an element, its range over the largest value of its quantity; else 1.
    """

    name: str
    level: float
    times: Floats
    uncertainties: Floats
    rule: str
    maxima: int
    share: float = 1.0

    @property
    def periods(self) -> Floats:
        """Time from each crossing to the next, shape (n - 1,), s."""
        return np.diff(self.times)

    @property
    def doubt(self) -> str:
        """Return a warning if the coordinate hardly moves, or turns more often than it passes the level; else empty."""
        if self.share < ROUNDING:
            return (
                f"{self.name} moves by {self.share:.1g} of the largest {split_element_name(self.name)[0]} alone, as rounding does:"
                " its cycles say little; name a coordinate that moves"
            )
        if len(self.times) >= self.maxima - 1:
            return ""
        times = {0: "never", 1: "once"}.get(len(self.times), f"{len(self.times)} times")
        return (
            f"{self.name} has {self.maxima} maxima and rises through the level {times}: a cycle here is none from"
            " maximum to maximum; give a level that every swing passes"
        )

    def phase(self, times: Floats) -> Floats:
        """Return the phase at times, rad: a multiple of 2 pi at each crossing, linear between them; nan outside."""
        if len(self.times) < 2:
            return np.full(times.shape, np.nan)
        turns = np.arange(len(self.times), dtype=float)
        return np.interp(times, self.times, TURN * turns, left=np.nan, right=np.nan)


def cycles(
    run: xr.Dataset | Chunks,
    name: str,
    *,
    level: float | None = None,
    functions: Mapping[str, Callable[..., float]] | None = None,
) -> Cycles:
    """Locate where a coordinate rises through a level.

    Parameters
    ----------
    run : xarray.Dataset, or Chunks
        A run record, or its rows.
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
    rows, turns, maxima = _turns_of(run, name, functions)
    rule = "given"
    if level is None:
        level, rule = _choose_level(rows, name, turns, maxima)
    risen = _rising_rows(rows, name, [level])[0]
    located = _locate_crossings(rows, name, level, risen, functions) if risen.size else (np.zeros(0), np.zeros(0))
    return Cycles(name, level, *located, rule, maxima, _share(rows, name, turns.high - turns.low))


def chosen_level(run: xr.Dataset, name: str, functions: Mapping[str, Callable[..., float]] | None = None) -> float:
    """Return the level through which `cycles` counts where none is given, in the coordinate's unit.

    Raises
    ------
    InputError
        If there is no such coordinate.
    """
    rows, turns, maxima = _turns_of(run, name, functions)
    return _choose_level(rows, name, turns, maxima)[0]


def _turns_of(
    run: xr.Dataset | Chunks, name: str, functions: Mapping[str, Callable[..., float]] | None
) -> tuple[Chunks, Turns, int]:
    """Return the rows of a run, the turning points of a coordinate, and how many of these are maxima."""
    rows = Chunks.of(run, functions)
    check_coordinate(rows.run, name)
    turns = _turning_points(rows, name)
    return rows, turns, int(np.count_nonzero(turns.rows > 0))


def check_coordinate(record: xr.Dataset, name: str) -> None:
    """Check that a run has a coordinate.

    Raises
    ------
    InputError
        Naming those that it has.
    """
    coordinate_variable = find_column(record, name)
    if (
        coordinate_variable is None
        or coordinate_variable.attrs.get("role") != "coordinate"
        or coordinate_variable.ndim > 1
    ):
        coordinates = [
            str(coordinate)
            for coordinate, variable in record.data_vars.items()
            if variable.attrs.get("role") == "coordinate"
        ]
        raise InputError(f"'{name}' is no coordinate of the run; there are {', '.join(coordinates) or 'none'}")


@dataclass(frozen=True)
class Turns:
    """Where a velocity has another sign than before, if the swing to or from there is large enough.

    Attributes
    ----------
    rows : ndarray of int, shape (n,)
        The first rows with the other sign: positive for a maximum, else negative.
    values : ndarray, shape (n,)
        Of the coordinate in these rows.
    low, high : float
        The range of the coordinate in the run.
    """

    rows: Rows
    values: Floats
    low: float
    high: float


def _turning_points(rows: Chunks, name: str) -> Turns:
    """Find where a coordinate turns, at accepted states."""
    turn_rows, values, low, high = [np.zeros(0, np.int64)], [np.zeros(0)], np.inf, -np.inf
    rising: list[bool] = []  # in the last row so far that moves
    speed = schema.velocity(name)
    for part in rows.parts(name, speed):
        part_values, moving = part.own_rows(name), np.flatnonzero(part.own_rows(speed))
        up = np.concatenate([np.array(rising, bool), part.own_rows(speed)[moving] > 0.0])
        places = np.flatnonzero(up[:-1] != up[1:])
        # the direction of the part before stands first in `up`, and is no row of this part
        part_turns = moving[places + 1 - len(rising)]
        # a sign can mark minima: row 0 has none before it, and is never a turn
        turn_rows.append(np.where(up[places], part.first + part_turns, -part.first - part_turns))
        values.append(part_values[part_turns])
        rising = up[-1:].tolist()
        low, high = np.minimum(low, part_values.min()), np.maximum(high, part_values.max())
    turns = np.concatenate(values)
    first, last = rows.values_at(name, [0, rows.size - 1])
    swings = np.abs(np.diff(np.concatenate([[first], turns, [last]])))
    large = np.maximum(swings[:-1], swings[1:]) > SMALLEST * float(high - low)
    return Turns(np.concatenate(turn_rows)[large], turns[large], float(low), float(high))


def _share(rows: Chunks, name: str, extent: float) -> float:
    """Return the range of an element over the largest value of its quantity; 1 for a single number."""
    quantity_name = split_element_name(name)[0]
    if quantity_name == name:
        return 1.0
    elements = [
        element_name
        for element_name in map(str, rows.run.variables)
        if element_name == quantity_name or split_element_name(element_name)[0] == quantity_name
    ]
    largest = max(
        np.max(np.abs(part.own_rows(element_name)), initial=0.0)
        for part in rows.parts(*elements)
        for element_name in elements
    )
    return extent / float(largest) if largest > 0.0 else 1.0


def _choose_level(rows: Chunks, name: str, turns: Turns, maxima: int) -> tuple[float, str]:
    """Choose a level that cycles rise through; see `cycles`."""
    levels = {"zero": 0.0, "the middle of the range": float(turns.low + turns.high) / 2.0}
    ends = turns.values
    if ends.size > 1:
        smallest_swing = int(np.argmin(np.abs(np.diff(ends))))
        levels["the middle of the smallest swing"] = float(ends[smallest_swing] + ends[smallest_swing + 1]) / 2.0
    counts = dict(zip(levels, map(len, _rising_rows(rows, name, [*levels.values()])), strict=True))
    enough = [rule for rule, count in counts.items() if count > 1 and 2 * count >= maxima]
    rule = enough[0] if enough else max(counts, key=lambda candidate: counts[candidate])
    if not enough and counts[rule] == counts["the middle of the range"]:
        rule = "the middle of the range"
    return levels[rule], rule


def _rising_rows(rows: Chunks, name: str, levels: Sequence[float]) -> list[Rows]:
    """Return for each level the rows from which a step rises through it; a start on the level is not a crossing."""
    risen: list[list[Rows]] = [[] for _ in levels]
    for part in rows.parts(name, "time"):
        values, time, numbers = part.columns[name], part.columns["time"], part.row_numbers
        is_step = (numbers[:-1] >= part.first) & (np.diff(time) > 0)
        for level_rows, level in zip(risen, levels, strict=True):
            level_rows.append(numbers[:-1][is_step & (values[:-1] < level) & (values[1:] >= level)])
    return [np.concatenate(level_rows) for level_rows in risen]


def _locate_crossings(
    rows: Chunks, name: str, level: float, risen: Rows, functions: Mapping[str, Callable[..., float]] | None
) -> tuple[Floats, Floats]:
    """Locate all crossings at once, by Newton steps that stay inside brackets, and by bisection."""
    run, _ = rows.nearby_record(np.concatenate([risen, risen + 1]))
    (low, high), (values_before, values_after) = (
        rows.values_at(column_name, np.stack([risen, risen + 1])) for column_name in ("time", name)
    )
    interpolator, speed = StepInterpolator.of_run(run, functions, REINTEGRATE), schema.velocity(name)
    crossing_times = low + (high - low) * (level - values_before) / (values_after - values_before)
    for turn in range(TURNS):
        states = interpolator.states_at(crossing_times, after_event=False)
        off, slope = interpolator.values_of(states, name) - level, interpolator.values_of(states, speed)
        low, high = np.where(off < 0.0, crossing_times, low), np.where(off < 0.0, high, crossing_times)
        with np.errstate(divide="ignore", invalid="ignore"):
            newton = crossing_times - off / slope
        # a step as small as rounding ends where it began, at an end of the bracket: halving would restart the search
        bracketed = (newton >= low) & (newton <= high) & (turn % 8 != 7)
        next_times = np.where(off == 0.0, crossing_times, np.where(bracketed, newton, (low + high) / 2.0))
        small = np.abs(next_times - crossing_times) <= 2.0 * EPS * np.maximum(np.abs(crossing_times), high - low)
        crossing_times = next_times
        if small.all():
            break
    states = interpolator.states_at(crossing_times, after_event=False)
    value, slope = (interpolator.values_of(states, column_name) for column_name in (name, speed))
    with np.errstate(divide="ignore", invalid="ignore"):
        uncertainty = (np.abs(interpolator.errors_of(states, name)) + np.abs(value - level)) / np.abs(slope)
    return crossing_times, uncertainty + EPS * np.abs(crossing_times)
