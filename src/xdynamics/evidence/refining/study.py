"""The levels of a refinement, and every number that is compared between them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.diagnosing.cycles import TURN
from xdynamics.evidence.evidence_dataset import Rows, match_times
from xdynamics.evidence.refining.levels import Levels
from xdynamics.evidence.refining.readings import ENERGY, ComparisonPoints, Readings, RunSummary, summary_of_finest
from xdynamics.evidence.refining.subjects import (
    ENERGY_RANGE,
    EVENT_TIME,
    PERIOD,
    StateAfter,
    StudyQuantities,
    TrackedValue,
)
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.model.switches import bent_and_smooth, smooth_switches
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import AT
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

FINEST = 2  # levels in which the error by switches that steps went over is measured
STEPPED_OVER = 1.25  # times that error, for the errors of the located runs themselves
SMOOTH_TABLE = 2  # order left by points of a table that steps went over


@dataclass(frozen=True)
class Study:
    """The levels of a refinement, and every number that is compared between them.

    Attributes
    ----------
    subjects : StudyQuantities
    outlines : sequence of RunSummary
        What the run of each level tells by itself.
    readings : sequence of Readings
        What each level tells at the points of comparison; none before these are known.
    """

    subjects: StudyQuantities
    outlines: Sequence[RunSummary]
    readings: Sequence[Readings] = ()

    @classmethod
    def of_runs(cls, subjects: StudyQuantities, runs: Sequence[xr.Dataset]) -> Study:
        """Compare the runs of all levels."""
        coarser = [RunSummary.of(run) for run in runs[:-1]]
        return cls(subjects, [*coarser, summary_of_finest(subjects)(runs[-1])]).with_readings(runs)

    def with_readings(self, runs: Sequence[xr.Dataset]) -> Study:
        """Return the study with what the runs tell at the points of comparison."""
        last = len(runs) - 1
        readings = [Readings.of(run, self.subjects, self.common, k, finest=k == last) for k, run in enumerate(runs)]
        return replace(self, readings=readings)

    @property
    def levels(self) -> Levels:
        """One model at every level."""
        return self.subjects.levels

    @cached_property
    def common(self) -> ComparisonPoints:
        """Where the levels are compared."""
        return ComparisonPoints(
            self.times, self.outlines[-1].crossing_levels, self._corresponding_events(), self.occurrence_count
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

    def tracked_values(self) -> Iterator[TrackedValue]:
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
            yield replace(number, event_errors=number.event_errors + STEPPED_OVER * np.nan_to_num(cost, nan=np.inf))

    def _with_switches_located(self, numbers: list[TrackedValue]) -> dict[str, Floats] | None:
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
        subjects = replace(self.subjects, levels=finest, requested_times=self.times.tolist(), defects=False)
        located_study = Study.of_runs(subjects, runs)
        located = {number.name: number.values for number in located_study.numbers()}
        same = all(number.name in located and located[number.name].shape[0] == len(number.values) for number in numbers)
        return located if same else None

    def _when(self, number: TrackedValue) -> Floats:
        """Return the times of a number's values; for a number of the complete run, its end."""
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

    def _occurred(self, number: TrackedValue) -> Floats:
        """Return when the occurrences of an event were met in the finest level; inf for those that it did not meet."""

        def when(event: str) -> Floats:
            times, last = (
                np.full(self.common.occurrences, np.inf),
                self.outlines[-1].event_times[self.event_rows()[event][-1]],
            )
            times[: len(last)] = last[: len(times)]
            return times

        state = next((state for state in self.states_after if state.name == number.name), None)
        if state is None:
            return when(number.name.removeprefix(EVENT_TIME))
        occurrence_times = np.full(number.values.shape[:-1], np.inf)
        for event in self._events_of(state):
            index = (slice(None), *state.index(self.subjects.event_place(event)[1]))
            occurrence_times[index] = when(event).reshape(-1, *[1] * (occurrence_times[index].ndim - 1))
        return occurrence_times

    def numbers(self) -> Iterator[TrackedValue]:
        """Yield every number that is compared."""
        yield from self._at_times()
        yield from self._energy_range()
        for name in self.subjects.cycle_numbers:
            yield self._cycle_values(name)
        for detector in self._event_detectors:
            yield from (
                self._event_times(event) for event in self.event_rows() if split_element_name(event)[0] == detector
            )
            yield from (self._values_after_events(state) for state in self.states_after if state.detector == detector)

    @property
    def occurrence_count(self) -> int:
        """How many occurrences of every event are compared: by default those of the finest level, or if it has none of any."""
        if self.subjects.occurrences is not None:
            return self.subjects.occurrences
        return max((len(rows[-1]) or max(map(len, rows)) for rows in self.event_rows().values()), default=0)

    @cached_property
    def states_after(self) -> list[StateAfter]:
        """The states that are compared after events."""
        subjects, occurrences = self.subjects, self.common.occurrences
        return [state for detector in self._event_detectors for state in subjects.compared_after(detector, occurrences)]

    @property
    def left_out(self) -> str:
        """The states after events that are not compared, in words."""
        return self.subjects.left_out(self._event_detectors, self.common.occurrences)

    @property
    def _event_detectors(self) -> list[str]:
        return list(dict.fromkeys(split_element_name(event)[0] for event in self.event_rows()))

    def event_rows(self) -> dict[str, list[Rows]]:
        """Return the events of each name in every run: of those that were met, or if their number is given of all."""
        if self.subjects.occurrences == 0:
            return {}
        events_by_run = [outline.event_rows for outline in self.outlines]
        names = dict.fromkeys(name for events in events_by_run for name in events)
        names = names if self.subjects.occurrences is None else dict.fromkeys(self.subjects.detectors)
        return {name: [events.get(name, np.zeros(0, np.int64)) for events in events_by_run] for name in names}

    def _corresponding_events(self) -> dict[str, list[tuple[Rows, Rows]]]:
        """Return those events of every level that correspond to the finest's, of each name, and the numbers of these."""
        places, requested = {}, self.subjects.occurrences
        for name, rows in self.event_rows().items():
            times = [outline.event_times[mine] for outline, mine in zip(self.outlines, rows, strict=True)]
            # occurrences of the finest level, and the nearest ones of every other level
            pairs = [match_times(entry, times[-1]) if len(times[-1]) else match_times(entry, entry) for entry in times]
            is_compared = [theirs < (len(theirs) + 1 if requested is None else requested) for _, theirs in pairs]
            places[name] = [
                (mine[first[is_kept]], second[is_kept])
                for mine, (first, second), is_kept in zip(rows, pairs, is_compared, strict=True)
            ]
        return places

    def _at_times(self) -> Iterator[TrackedValue]:
        """Yield observables at the times of comparison."""
        finest, uncertain = self.readings[-1], self._around_events()
        for name in self.subjects.observed:
            values, errors = (np.stack([level.observed[name][i] for level in self.readings], axis=-1) for i in (0, 1))
            event_errors = np.where(uncertain, np.inf, finest.event_errors[name].T).T
            scale = _never_zero(finest.largest[name])
            yield TrackedValue(
                *self.subjects.observable(name), values, errors, self._rounding(values), event_errors, scale
            )

    def _around_events(self) -> NDArray[np.bool_]:
        """Return at which times the two finest levels differ in the number of events, or an event may be before or after."""
        located = [outline.event_times for outline in self.outlines[-FINEST:]]
        around = []
        for time in self.common.times:
            counts_differ = len({int((times < time).sum()) for times in located}) > 1
            paired = len(located) == FINEST and len(located[0]) == len(located[1])
            # it is not known on which side of the event it is
            around.append(
                counts_differ or (paired and bool((np.abs(time - located[1]) <= np.abs(located[1] - located[0])).any()))
            )
        return np.array(around, bool)

    def _energy_range(self) -> Iterator[TrackedValue]:
        """Yield the range of the energy in each run, if it is asked for."""
        if ENERGY_RANGE in self.subjects.names:
            ranges = np.array([[level.energy_range for level in self.readings]])
            scale = float(self.readings[-1].largest[ENERGY]) or 1.0
            rounding = np.array([2.0 * EPS * scale])
            yield TrackedValue(*self.subjects.energy_range, ranges, 0.0 * ranges, rounding, np.zeros(1), scale)

    def _cycle_values(self, name: str) -> TrackedValue:
        """Return the mean period of each run, or its phase at times.

        Cycles of all runs are counted through the level that the finest chose: one chosen by each would differ between
        runs, and with it the periods of decaying motion.
        """
        cycles_by_level = [level.swings[name.partition("_")[2]] for level in self.readings]
        uncertainties, means = (
            np.array([getattr(swings, statistic) for swings in cycles_by_level])
            for statistic in ("uncertainty", "mean")
        )
        if name.startswith(PERIOD):
            counts = np.array([swings.cycle_count for swings in cycles_by_level])
            values, errors = means[None, :], (2.0 * uncertainties / counts)[None, :]
        else:
            values = np.stack([swings.phases for swings in cycles_by_level], axis=-1)
            errors = np.broadcast_to(uncertainties * (TURN / means), values.shape).copy()
        scale = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
        rounding = self._rounding(values)
        return TrackedValue(*self.subjects.cycles(name), values, errors, rounding, np.zeros(len(values)), scale)

    def _event_times(self, event: str) -> TrackedValue:
        """Return the times at which one event function was met, occurrence by occurrence."""
        levels = [(outline, mine) for outline, (mine, _) in zip(self.outlines, self.common.places[event], strict=True)]
        times = self._aligned(event, [outline.event_times[mine] for outline, mine in levels])
        errors = self._aligned(event, [outline.event_uncertainties[mine] for outline, mine in levels])
        span = self.outlines[-1].end - self.outlines[-1].begin or 1.0
        rounding = 4 * EPS * np.abs(times[:, -1])
        return TrackedValue(*self.subjects.event_time(event), times, errors, rounding, np.zeros(len(times)), span)

    def _values_after_events(self, state: StateAfter) -> TrackedValue:
        """Return a state after the events of a detector, occurrence by occurrence."""
        values, errors = (
            self._spread_over_elements(
                state,
                {
                    event: [level.states_after[event][state.name][i] for level in self.readings]
                    for event in self._events_of(state)
                },
            )
            for i in (0, 1)
        )
        scale = np.broadcast_to(_never_zero(self.readings[-1].largest[state.state]), values.shape[1:-1])
        event_errors = np.zeros(values.shape[:-1])
        return TrackedValue(
            *self.subjects.after_event(state), values, errors, self._rounding(values), event_errors, scale
        )

    def _events_of(self, state: StateAfter) -> list[str]:
        """Return the events after which a state is compared: those of all elements, or of its own element."""
        events = {event: self.subjects.event_place(event) for event in self.event_rows()}
        return [
            event
            for event, (detector, element_index) in events.items()
            if detector == state.detector and state.has_value_at(element_index)
        ]

    def _spread_over_elements(self, state: StateAfter, by_event: Mapping[str, list[Floats]]) -> Floats:
        """Return numbers of every level at the events of elements as one array: occurrences first, levels last."""
        shape = self.subjects.shapes.shape(state.places[1:])
        spread_values = np.full((self.common.occurrences, *shape, len(self.outlines)), np.nan)
        for event, by_run in by_event.items():
            index = state.index(self.subjects.event_place(event)[1])
            spread_values[(slice(None), *index)] = self._aligned(event, by_run)
        return spread_values

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


def numbers_by_name(study: Study, names: Iterable[str]) -> list[TrackedValue]:
    """Return compared numbers by name; an element is taken out of its quantity."""
    numbers, selected = {number.name: number for number in study.numbers()}, []
    for name in names:
        quantity_name = split_element_name(name)[0]
        if name in numbers:
            selected.append(numbers[name])
        elif quantity_name in numbers:
            element_index = Block.from_shapes(quantity_name, "", study.subjects.shapes).indices_of(name)
            selected.append(numbers[quantity_name].element(name, tuple(element_index.values())))
    return selected


def _never_zero(size: Floats) -> Floats:
    """Return sizes to divide differences by: 1 instead of 0."""
    return np.where(size == 0.0, 1.0, size)
