"""The runs of all levels of a refinement, and every number that is compared between them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.seals import slabs
from xdynamics.evidence.diagnosing.cycles import TURN, Cycles, cycles
from xdynamics.evidence.event_matching import Rows, matched, met
from xdynamics.evidence.observables import observe
from xdynamics.evidence.refining.family import Watched
from xdynamics.evidence.refining.levels import Levels
from xdynamics.evidence.refining.subjects import ENERGY_RANGE, PERIOD, Subjects
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.model.switches import bent_and_smooth, smooth_switches
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT, FIRST_PASSED, PASSED, acceleration, rate, velocity
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

EPS = float(np.finfo(float).eps)
FINEST = 2  # levels in which the error by switches that steps went over is measured
STEPPED_OVER = 1.25  # times that error, for the errors of the located runs themselves
SMOOTH_TABLE = 2  # order left by points of a table that steps went over


@dataclass(frozen=True)
class Study:
    """The runs of all levels, and the names of the numbers that are compared; see `Subjects`."""

    levels: Levels
    runs: list[xr.Dataset]
    names: tuple[str, ...]
    at: Any = None
    occurrences: int | None = None

    @cached_property
    def subjects(self) -> Subjects:
        """What is compared."""
        return Subjects(self.levels, self.names, self.at, self.occurrences)

    def finer(self) -> Study:
        """Return the study with one more level."""
        levels = self.levels.finer()
        return replace(self, levels=levels, runs=[*self.runs, levels.marched(len(self.runs))])

    @property
    def times(self) -> Floats:
        """The times of comparison, s.

        Raises
        ------
        InputError
            If a time is not in every run.
        """
        unit = self.levels.model.time_unit
        begin, end = float(self.runs[0]["time"][0]), min(float(run["time"][-1]) for run in self.runs)
        times = self.subjects.times
        if times is None:
            return np.array([end])
        self.check_reached(times)
        for time in times.tolist():
            if not begin <= time <= end:
                raise InputError(
                    f"at has {time!r}{unit_suffix(unit)}, needs times in every run, from {begin!r}{unit_suffix(unit)} to"
                    f" {end!r}{unit_suffix(unit)}"
                )
        return times

    def check_reached(self, times: Floats) -> None:
        """Refuse a level whose run failed before the times of comparison.

        Raises
        ------
        InputError
            Naming the level, its outcome and a remedy.
        """
        for value, run in zip(self.levels.values.tolist(), self.runs, strict=True):
            if str(run.attrs["run_outcome"]) in GOOD or float(run["time"][-1]) >= float(times.max()):
                continue
            unit = unit_suffix(self.levels.varied.units or self.levels.model.time_unit.text)
            second = unit_suffix(self.levels.model.time_unit.text)
            raise InputError(
                f"the level with {self.levels.varied.name} = {value:.6g}{unit} ended before t ="
                f" {float(times.max()):.9g}{second}, as '{run.attrs['run_outcome']}': {run.attrs['run_outcome_text']};"
                " leave that level out, or change what ended it"
            )

    def watched(self) -> Iterator[Watched]:
        """Yield every number that is compared, with the error by switches that steps went over before it."""
        numbers = list(self.numbers())
        located = self._with_switches_located(numbers)
        for number in numbers:
            if located is None:
                yield replace(number, kinks=np.array([self.kink_before(time) for time in self._when(number).tolist()]))
                continue
            # one of the two levels may by chance have the switch at the end of a step
            cost = np.max(np.abs(located[number.name] - number.values[:, -FINEST:]), axis=-1) if located else 0.0
            yield replace(number, moved=number.moved + STEPPED_OVER * np.nan_to_num(cost, nan=np.inf))

    def _with_switches_located(self, numbers: list[Watched]) -> dict[str, Floats] | None:
        """Return the numbers of the two finest levels with all switches located.

        Empty if no step went over one that is declared smooth; None if they cannot be located.
        """
        if self.kink_before(float(self.runs[-1]["time"][-1])) == np.inf:
            return {}
        levels = self.levels.located()
        if levels is None or not self.levels.ordered:
            return None
        count = len(self.runs)
        runs = [levels.marched(k) for k in range(max(0, count - FINEST), count)]
        if any(float(run["time"][-1]) < self.times.max() for run in runs):
            return None
        finest = replace(levels, values=levels.values[-FINEST:])
        again = replace(self, levels=finest, runs=runs, at=self.times.tolist())
        located = {number.name: number.values for number in again.numbers()}
        same = all(number.name in located and located[number.name].shape[0] == len(number.values) for number in numbers)
        return located if same else None

    def _when(self, number: Watched) -> Floats:
        """Return the times of a number's places; for a number of the whole run, its end."""
        if number.dims == (AT,):
            return self.times
        return self._occurred(number) if number.dims else np.full(len(number.values), float(self.runs[-1]["time"][-1]))

    def kink_before(self, time: float) -> float:
        """Return the order left by switches that steps went over before a time in any level; inf if there are none."""
        orders = [float(SMOOTH_TABLE)] if bent_and_smooth(self.levels.model) else []
        switches = {switch.name: switch for switch in smooth_switches(self.levels.model)}
        for run in self.runs:
            if PASSED.name not in run.variables:
                continue
            names = str(run[PASSED.name].attrs["names"]).split()
            for name, first in zip(names, run[FIRST_PASSED.name].values.tolist(), strict=True):
                row = int(np.searchsorted(run["time"].values, first)) if first == first else 0
                if row and time > float(run["time"][row - 1]):  # somewhere in the step to the first row after it
                    orders.append(switches[name].flatness + 1.0)
        return min(orders, default=np.inf)

    def _occurred(self, number: Watched) -> Floats:
        """Return when the occurrences of an event were met in the finest level; inf for those that it did not meet."""
        rows = next(
            event_rows
            for name, event_rows in self.met().items()
            if number.name in (f"event_time_{name}", *(f"after_{name}_{quantity}" for quantity in self.names))
        )
        times, last = np.full(len(number.values), np.inf), self.runs[-1]["event_time"].values[rows[-1]]
        times[: len(last)] = last[: len(times)]
        return times

    def numbers(self) -> Iterator[Watched]:
        """Yield every number that is compared."""
        times = self.times
        yield from self._at_times(times)
        yield from self._energy_range()
        for name in self.subjects.counted:
            yield self._of_cycles(name, times)
        rows = self.met()
        # as many as the finest level has; if that has none, as many as any other level
        most = max((len(per_run[-1]) or max(map(len, per_run)) for per_run in rows.values()), default=0)
        for name, event_rows in rows.items():
            for number in self._of_events(name, event_rows, most):
                yield number if self.occurrences is None else number.first(self.occurrences)

    def met(self) -> dict[str, list[Rows]]:
        """Return the events of each name in every run: of those that were met, or if their number is given of all."""
        if self.occurrences == 0:
            return {}
        events_by_run = [met(run) for run in self.runs]
        names = dict.fromkeys(name for events in events_by_run for name in events)
        names = names if self.occurrences is None else dict.fromkeys(self.subjects.detectors)
        return {name: [events.get(name, np.zeros(0, np.int64)) for events in events_by_run] for name in names}

    def _at_times(self, times: Floats) -> Iterator[Watched]:
        """Yield observables at the times of comparison."""
        levels, last, names = self.levels, self.runs[-1], self.subjects.observed
        samples = [observe(run, levels.model, names, times, levels.rule(k)) for k, run in enumerate(self.runs)]
        for name in names:
            values, errors = (np.stack([level[name][i] for level in samples], axis=-1) for i in (0, 1))
            moved = np.array([_moved_by_events(self.runs, name, time) for time in times])
            scale = _largest(last, name) or 1.0
            yield Watched(*self.subjects.observable(name), values, errors, _rounding(last, values), moved, scale)

    def _energy_range(self) -> Iterator[Watched]:
        """Yield the range of the energy in each run, if it is asked for."""
        if ENERGY_RANGE in self.names:
            ranges = np.array([[_range(run, "total_energy") for run in self.runs]])
            scale = _largest(self.runs[-1], "total_energy") or 1.0
            rounding = np.array([2.0 * EPS * scale])
            yield Watched(*self.subjects.energy_range, ranges, 0.0 * ranges, rounding, np.zeros(1), scale)

    def cycles(self, coordinate: str) -> list[Cycles]:
        """Return the cycles of a coordinate in every run, all counted through the level that the finest run chose.

        A level chosen by each run would differ between runs, and with it the periods of decaying motion.
        """
        functions = self.levels.model.functions
        finest = cycles(self.runs[-1], coordinate, functions=functions)
        coarser = [cycles(run, coordinate, level=finest.level, functions=functions) for run in self.runs[:-1]]
        return [*coarser, finest]

    def _of_cycles(self, name: str, times: Floats) -> Watched:
        """Return the mean period of each run, or its phase at times."""
        counted = self.cycles(name.partition("_")[2])
        uncertainties = np.array([float(level.uncertainties.max(initial=0.0)) for level in counted])
        if name.startswith(PERIOD):
            means = [float(level.periods.mean()) if level.periods.size else np.nan for level in counted]
            counts = np.array([max(1, level.periods.size) for level in counted])
            values, errors = np.array([means]), np.array([2.0 * uncertainties / counts])
        else:
            values = np.stack([level.phase(times) for level in counted], axis=-1)
            speeds = [TURN / level.periods.mean() if level.periods.size else np.nan for level in counted]
            errors = np.broadcast_to(uncertainties * np.array(speeds), values.shape).copy()
        scale = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        rounding = _rounding(self.runs[-1], values)
        return Watched(*self.subjects.cycles(name), values, errors, rounding, np.zeros(len(values)), scale)

    def _of_events(self, detector: str, rows: list[Rows], most: int) -> Iterator[Watched]:
        """Yield the times at which one event function was met, occurrence by occurrence, and the states after it."""
        runs, unmoved = self.runs, np.zeros(most)
        times_met = [run["event_time"].values[mine] for run, mine in zip(runs, rows, strict=True)]
        # occurrences of the finest level, and the nearest ones of every other level
        places = [matched(entry, times_met[-1]) if len(times_met[-1]) else matched(entry, entry) for entry in times_met]

        def of(by_run: list[Floats]) -> Floats:
            aligned = np.full((most, len(by_run)), np.nan)
            for k, (entry, (mine, theirs)) in enumerate(zip(by_run, places, strict=True)):
                aligned[theirs, k] = entry[mine]
            return aligned

        times = of(times_met)
        by_run = [run["event_time_uncertainty"].values[mine] for run, mine in zip(runs, rows, strict=True)]
        span = float(runs[-1]["time"][-1] - runs[-1]["time"][0]) or 1.0
        rounding = 4 * EPS * np.abs(times[:, -1])
        yield Watched(*self.subjects.event_time(detector), times, of(by_run), rounding, unmoved, span)
        for name in self.subjects.after_events:
            states, uncertainties = [], []
            for run, mine, uncertainty in zip(runs, rows, by_run, strict=True):
                after, before = run["event_row_after"].values[mine], run["event_row_before"].values[mine]
                states.append(run[name][after].values)
                uncertainties.append(np.abs(run[_rate_of(run, name)][before].values) * uncertainty)
            values, scale = of(states), _largest(runs[-1], name) or 1.0
            subject = self.subjects.after_event(detector, name)
            yield Watched(*subject, values, of(uncertainties), _rounding(runs[-1], values), unmoved, scale)


def _moved_by_events(runs: list[xr.Dataset], name: str, time: float) -> float:
    """Return the error of an observable by the uncertain times of events before it; inf if their numbers differ."""
    counts = [int((run["event_time"].values < time).sum()) for run in runs[-2:]]
    if len(set(counts)) > 1:
        return np.inf
    times = [run["event_time"].values for run in runs[-2:]]
    if (
        len(times) == 2
        and len(times[0]) == len(times[1])
        and (np.abs(time - times[1]) <= np.abs(times[1] - times[0])).any()
    ):
        return np.inf  # it is not known on which side of the event it is
    run = runs[-1]
    if not counts[-1]:
        return 0.0
    rates = _rates(run, name, run["event_row_before"].values[: counts[-1]])
    return float(np.sum(np.abs(rates) * run["event_time_uncertainty"].values[: counts[-1]]))


def _rates(run: xr.Dataset, name: str, rows: NDArray[np.int64]) -> Floats:
    """Return the rate of change of an observable in the step to each row; 0 where a time of an event is repeated."""
    span, change = (
        run[variable][rows].values - run[variable][np.maximum(rows - 1, 0)].values for variable in ("time", name)
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        rates: Floats = np.where(span > 0.0, change / span, 0.0)
    return rates


def _largest(run: xr.Dataset, name: str) -> float:
    """Return the largest absolute value of a quantity, reading files slab by slab."""
    return max(float(np.max(np.abs(part))) for part in slabs(run[name].variable))


def _range(run: xr.Dataset, name: str) -> float:
    """Return the largest less the least value of a quantity."""
    ends = [(float(np.max(part)), float(np.min(part))) for part in slabs(run[name].variable)]
    return max(high for high, _ in ends) - min(low for _, low in ends)


def _rate_of(run: xr.Dataset, name: str) -> str:
    """Return the name of the variable that is the rate of a coordinate, velocity or state."""
    role = run[name].attrs["role"]
    return {"coordinate": velocity(name), "velocity": acceleration(name.removeprefix("v_")), "state": rate(name)}[role]


def _rounding(run: xr.Dataset, values: Floats) -> Floats:
    """Return the rounding error accumulated in the finest run: of the largest value, growing as the root of steps."""
    largest = np.max(np.abs(values), axis=-1, where=np.isfinite(values), initial=0.0)
    bound: Floats = 4.0 * EPS * largest * np.sqrt(run.sizes["step"])
    return bound
