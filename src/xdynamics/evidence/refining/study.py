"""The levels of a refinement, and every number that is compared between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.evidence.diagnosing.cycles import TURN
from xdynamics.evidence.event_matching import Rows, matched
from xdynamics.evidence.refining.family import Watched
from xdynamics.evidence.refining.levels import Levels
from xdynamics.evidence.refining.readings import ENERGY, Common, Outline, Readings
from xdynamics.evidence.refining.states_after import StateAfter
from xdynamics.evidence.refining.subjects import ENERGY_RANGE, EVENT_TIME, PERIOD, Subjects
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.model.switches import bent_and_smooth, smooth_switches
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import AT
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.naming import parted
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

FINEST = 2  # levels in which the error by switches that steps went over is measured
STEPPED_OVER = 1.25  # times that error, for the errors of the located runs themselves
SMOOTH_TABLE = 2  # order left by points of a table that steps went over


@dataclass(frozen=True)
class Study:
    """The levels of a refinement, and every number that is compared between them; see `Subjects`.

    Attributes
    ----------
    runs : list of Dataset
        Of all levels; none where outlines and readings are given.
    outlined : sequence of Outline
        Those that are known, of the first levels.
    read : sequence of Readings
        Of all levels, if they are known.
    """

    levels: Levels
    runs: list[xr.Dataset]
    names: tuple[str, ...]
    at: Any = None
    occurrences: int | None = None
    defects: bool = False
    outlined: Sequence[Outline] = ()
    read: Sequence[Readings] = ()

    @classmethod
    def of(cls, subjects: Subjects, outlines: Sequence[Outline], readings: Sequence[Readings] = ()) -> Study:
        """Return a study of runs that are elsewhere."""
        wanted = (subjects.names, subjects.at, subjects.occurrences, subjects.defects)
        return cls(subjects.levels, [], *wanted, outlines, readings)

    @cached_property
    def subjects(self) -> Subjects:
        """What is compared."""
        return Subjects(self.levels, self.names, self.at, self.occurrences, self.defects)

    @cached_property
    def outlines(self) -> Sequence[Outline]:
        """What each level tells by itself."""
        further, functions = self.runs[len(self.outlined) :], self.levels.model.functions
        coarser = [Outline.of(run) for run in further[:-1]]
        return [*self.outlined, *coarser, *(Outline.of(run, self.subjects.cyclic, functions) for run in further[-1:])]

    @cached_property
    def common(self) -> Common:
        """Where the levels are compared."""
        return Common(self.times, self.outlines[-1].crossing_levels, self._places(), self.most)

    @cached_property
    def readings(self) -> Sequence[Readings]:
        """What each level tells there."""
        last = len(self.runs) - 1
        return self.read or [
            Readings.of(run, self.subjects, self.common, k, finest=k == last) for k, run in enumerate(self.runs)
        ]

    def finer(self) -> Study:
        """Return the study with one more level."""
        levels = self.levels.finer()
        return replace(
            self, levels=levels, runs=[*self.runs, levels.marched(len(self.runs))], outlined=self.outlines, read=()
        )

    @property
    def times(self) -> Floats:
        """The times of comparison, s.

        Raises
        ------
        InputError
            If a time is not in every run.
        """
        unit = self.levels.model.time_unit
        begin, end = self.outlines[0].begin, min(outline.end for outline in self.outlines)
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
        for value, outline in zip(self.levels.values.tolist(), self.outlines, strict=True):
            if outline.outcome in GOOD or outline.end >= float(times.max()):
                continue
            unit = unit_suffix(self.levels.varied.units or self.levels.model.time_unit.text)
            second = unit_suffix(self.levels.model.time_unit.text)
            raise InputError(
                f"the level with {self.levels.varied.name} = {value:.6g}{unit} ended before t ="
                f" {float(times.max()):.9g}{second}, as '{outline.outcome}': {outline.outcome_text};"
                " leave that level out, or change what ended it"
            )

    def watched(self) -> Iterator[Watched]:
        """Yield every number that is compared, with the error by switches that steps went over before it."""
        numbers = list(self.numbers())
        located = self._with_switches_located(numbers)
        for number in numbers:
            if located is None:
                times = self._when(number)
                kinks = [self.kink_before(time) for time in times.ravel().tolist()]
                yield replace(number, kinks=np.reshape(kinks, times.shape))
                continue
            # one of the two levels may by chance have the switch at the end of a step
            cost = np.max(np.abs(located[number.name] - number.values[..., -FINEST:]), axis=-1) if located else 0.0
            yield replace(number, moved=number.moved + STEPPED_OVER * np.nan_to_num(cost, nan=np.inf))

    def _with_switches_located(self, numbers: list[Watched]) -> dict[str, Floats] | None:
        """Return the numbers of the two finest levels with all switches located.

        Empty if no step went over one that is declared smooth; None if they cannot be located.
        """
        if self.kink_before(self.outlines[-1].end) == np.inf:
            return {}
        levels = self.levels.located()
        if levels is None or not self.levels.ordered:
            return None
        count = len(self.outlines)
        runs = [levels.marched(k) for k in range(max(0, count - FINEST), count)]
        if any(float(run["time"][-1]) < self.times.max() for run in runs):
            return None
        finest = replace(levels, values=levels.values[-FINEST:])
        again = Study(finest, runs, self.names, self.times.tolist(), self.occurrences)
        located = {number.name: number.values for number in again.numbers()}
        same = all(number.name in located and located[number.name].shape[0] == len(number.values) for number in numbers)
        return located if same else None

    def _when(self, number: Watched) -> Floats:
        """Return the times of a number's places; for a number of the whole run, its end."""
        if number.dims[:1] == (AT,):
            return self.times
        return self._occurred(number) if number.dims else np.full(len(number.values), self.outlines[-1].end)

    def kink_before(self, time: float) -> float:
        """Return the order left by switches that steps went over before a time in any level; inf if there are none."""
        orders = [float(SMOOTH_TABLE)] if bent_and_smooth(self.levels.model) else []
        switches = {switch.name: switch for switch in smooth_switches(self.levels.model)}
        for outline in self.outlines:  # somewhere in the step to the first row after it
            orders += [switches[name].flatness + 1.0 for name, last in outline.passed.items() if time > last]
        return min(orders, default=np.inf)

    def _occurred(self, number: Watched) -> Floats:
        """Return when the occurrences of an event were met in the finest level; inf for those that it did not meet."""

        def when(event: str) -> Floats:
            times, last = np.full(self.common.occurrences, np.inf), self.outlines[-1].event_times[self.met()[event][-1]]
            times[: len(last)] = last[: len(times)]
            return times

        state = next((state for state in self.states_after if state.name == number.name), None)
        if state is None:
            return when(number.name.removeprefix(EVENT_TIME))
        whole = np.full(number.values.shape[:-1], np.inf)
        for event in self._events_of(state):
            place = (slice(None), *state.index(self.subjects.event_place(event)[1]))
            whole[place] = when(event).reshape(-1, *[1] * (whole[place].ndim - 1))
        return whole

    def numbers(self) -> Iterator[Watched]:
        """Yield every number that is compared."""
        yield from self._at_times()
        yield from self._energy_range()
        for name in self.subjects.counted:
            yield self._of_cycles(name)
        for detector in self._detectors:
            yield from (self._of_event(event) for event in self.met() if parted(event)[0] == detector)
            yield from (self._of_state(state) for state in self.states_after if state.detector == detector)

    @property
    def most(self) -> int:
        """How many occurrences of every event are compared: by default those of the finest level, or if it has none of any."""
        if self.occurrences is not None:
            return self.occurrences
        return max((len(rows[-1]) or max(map(len, rows)) for rows in self.met().values()), default=0)

    @cached_property
    def states_after(self) -> list[StateAfter]:
        """What is compared after events."""
        subjects, occurrences = self.subjects, self.common.occurrences
        return [state for detector in self._detectors for state in subjects.compared_after(detector, occurrences)]

    @property
    def left_out(self) -> str:
        """Which states after events are not compared, in words."""
        return self.subjects.left_out(self._detectors, self.common.occurrences)

    @property
    def _detectors(self) -> list[str]:
        return list(dict.fromkeys(parted(event)[0] for event in self.met()))

    def met(self) -> dict[str, list[Rows]]:
        """Return the events of each name in every run: of those that were met, or if their number is given of all."""
        if self.occurrences == 0:
            return {}
        events_by_run = [outline.met for outline in self.outlines]
        names = dict.fromkeys(name for events in events_by_run for name in events)
        names = names if self.occurrences is None else dict.fromkeys(self.subjects.detectors)
        return {name: [events.get(name, np.zeros(0, np.int64)) for events in events_by_run] for name in names}

    def _places(self) -> dict[str, list[tuple[Rows, Rows]]]:
        """Return those events of every level that correspond to the finest's, of each name, and the numbers of these."""
        places = {}
        for name, rows in self.met().items():
            times = [outline.event_times[mine] for outline, mine in zip(self.outlines, rows, strict=True)]
            # occurrences of the finest level, and the nearest ones of every other level
            pairs = [matched(entry, times[-1]) if len(times[-1]) else matched(entry, entry) for entry in times]
            wanted = [
                theirs < (len(theirs) + 1 if self.occurrences is None else self.occurrences) for _, theirs in pairs
            ]
            places[name] = [
                (mine[first[kept]], second[kept])
                for mine, (first, second), kept in zip(rows, pairs, wanted, strict=True)
            ]
        return places

    def _at_times(self) -> Iterator[Watched]:
        """Yield observables at the times of comparison."""
        finest, uncertain = self.readings[-1], self._around_events()
        for name in self.subjects.observed:
            values, errors = (np.stack([level.observed[name][i] for level in self.readings], axis=-1) for i in (0, 1))
            moved = np.where(uncertain, np.inf, finest.moved[name].T).T
            scale = _never_zero(finest.largest[name])
            yield Watched(*self.subjects.observable(name), values, errors, self._rounding(values), moved, scale)

    def _around_events(self) -> NDArray[np.bool_]:
        """Return at which times the two finest levels differ in the number of events, or an event may be before or after."""
        located = [outline.event_times for outline in self.outlines[-FINEST:]]
        around = []
        for time in self.common.times:
            apart = len({int((times < time).sum()) for times in located}) > 1
            paired = len(located) == FINEST and len(located[0]) == len(located[1])
            # it is not known on which side of the event it is
            around.append(
                apart or (paired and bool((np.abs(time - located[1]) <= np.abs(located[1] - located[0])).any()))
            )
        return np.array(around, bool)

    def _energy_range(self) -> Iterator[Watched]:
        """Yield the range of the energy in each run, if it is asked for."""
        if ENERGY_RANGE in self.names:
            ranges = np.array([[level.energy_range for level in self.readings]])
            scale = float(self.readings[-1].largest[ENERGY]) or 1.0
            rounding = np.array([2.0 * EPS * scale])
            yield Watched(*self.subjects.energy_range, ranges, 0.0 * ranges, rounding, np.zeros(1), scale)

    def _of_cycles(self, name: str) -> Watched:
        """Return the mean period of each run, or its phase at times.

        Cycles of all runs are counted through the level that the finest chose: one chosen by each would differ between
        runs, and with it the periods of decaying motion.
        """
        counted = [level.swings[name.partition("_")[2]] for level in self.readings]
        uncertainties, means = (
            np.array([getattr(swings, one) for swings in counted]) for one in ("uncertainty", "mean")
        )
        if name.startswith(PERIOD):
            counts = np.array([swings.counted for swings in counted])
            values, errors = means[None, :], (2.0 * uncertainties / counts)[None, :]
        else:
            values = np.stack([swings.phases for swings in counted], axis=-1)
            errors = np.broadcast_to(uncertainties * (TURN / means), values.shape).copy()
        scale = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        rounding = self._rounding(values)
        return Watched(*self.subjects.cycles(name), values, errors, rounding, np.zeros(len(values)), scale)

    def _of_event(self, event: str) -> Watched:
        """Return the times at which one event function was met, occurrence by occurrence."""
        levels = [(outline, mine) for outline, (mine, _) in zip(self.outlines, self.common.places[event], strict=True)]
        times = self._aligned(event, [outline.event_times[mine] for outline, mine in levels])
        errors = self._aligned(event, [outline.event_uncertainties[mine] for outline, mine in levels])
        span = self.outlines[-1].end - self.outlines[-1].begin or 1.0
        rounding = 4 * EPS * np.abs(times[:, -1])
        return Watched(*self.subjects.event_time(event), times, errors, rounding, np.zeros(len(times)), span)

    def _of_state(self, state: StateAfter) -> Watched:
        """Return a state after the events of a detector, occurrence by occurrence."""
        values, errors = (
            self._spread(
                state,
                {
                    event: [level.after[event][state.name][i] for level in self.readings]
                    for event in self._events_of(state)
                },
            )
            for i in (0, 1)
        )
        scale = np.broadcast_to(_never_zero(self.readings[-1].largest[state.state]), values.shape[1:-1])
        moved = np.zeros(values.shape[:-1])
        return Watched(*self.subjects.after_event(state), values, errors, self._rounding(values), moved, scale)

    def _events_of(self, state: StateAfter) -> list[str]:
        """Return the events after which a state is compared: those of all elements, or of the one that is asked for."""
        events = {event: self.subjects.event_place(event) for event in self.met()}
        return [event for event, (own, place) in events.items() if own == state.detector and state.has_value_at(place)]

    def _spread(self, state: StateAfter, by_event: Mapping[str, list[Floats]]) -> Floats:
        """Return numbers of every level at the events of elements as one array: occurrences first, levels last."""
        shape = self.subjects.shapes.shape(state.places[1:])
        whole = np.full((self.common.occurrences, *shape, len(self.outlines)), np.nan)
        for event, by_run in by_event.items():
            index = state.index(self.subjects.event_place(event)[1])
            whole[(slice(None), *index)] = self._aligned(event, by_run)
        return whole

    def _aligned(self, event: str, by_run: list[Floats]) -> Floats:
        """Return numbers of every level at the events of one name by occurrence, levels last; nan where there is none."""
        aligned = np.full((self.common.occurrences, *by_run[0].shape[1:], len(by_run)), np.nan)
        for k, (entry, (_, theirs)) in enumerate(zip(by_run, self.common.places[event], strict=True)):
            aligned[theirs, ..., k] = entry
        return aligned

    def _rounding(self, values: Floats) -> Floats:
        """Return the rounding error accumulated in the finest run: of the largest value, growing as the root of steps."""
        largest = np.max(np.abs(values), axis=-1, where=np.isfinite(values), initial=0.0)
        bound: Floats = 4.0 * EPS * largest * np.sqrt(self.outlines[-1].rows)
        return bound


def numbers_named(study: Study, names: Iterable[str]) -> list[Watched]:
    """Return what is compared by its name; an element is taken out of its quantity."""
    numbers, found = {number.name: number for number in study.numbers()}, []
    for name in names:
        whole = parted(name)[0]
        if name in numbers:
            found.append(numbers[name])
        elif whole in numbers:
            place = Block.of(whole, "", study.subjects.shapes).places(name)
            found.append(numbers[whole].at(name, tuple(place.values())))
    return found


def _never_zero(size: Floats) -> Floats:
    """Return sizes by which differences are divided: 1 in the place of 0."""
    return np.where(size == 0.0, 1.0, size)
