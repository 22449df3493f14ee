"""A tube: bounds of states and observables at given times, and of event times, collected step by step.

A set of starts may be cut into parts: narrower bounds are proven for each part, and the bounds of all parts are joined.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import text_of
from xdynamics.kernels.layout import Layout, layout_of
from xdynamics.model import Model
from xdynamics.model.detectors import OCCASION, Detector, function_rate
from xdynamics.tubes import Flow, IntervalProblem, Proof, boxes, interval_problem_of
from xdynamics.tubes.acting import ActingEvent, first_passage, follow_past
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.crossings import Crossing, Crossings, Passage, Reset, land_after_passage
from xdynamics.tubes.functions import Functions
from xdynamics.tubes.series import UndefinedError

if TYPE_CHECKING:
    from xdynamics.march.runner import Progress


@dataclass(frozen=True)
class EventBounds:
    """Proven bounds of the zeros of one event.

    Attributes
    ----------
    name : str
    direction : str
        Which of them count.
    crossings : Crossings
    """

    name: str
    direction: str
    crossings: Crossings

    @property
    def counted_crossings(self) -> list[Crossing]:
        """The zeros in the event's direction."""
        return [
            crossing
            for crossing in self.crossings.zeros
            if self.direction == "either" or crossing.rising == (self.direction == "rising")
        ]


@dataclass(frozen=True)
class Tube:
    """Proven bounds of a motion.

    Attributes
    ----------
    times : ndarray, shape (k,), s
    bounds : ndarray, shape (2, k, numbers)
        Of coordinates, velocities and states, then of energies and observables, in SI units; nan at a time that no proof
        reached.
    events : list of EventBounds
    steps : int
    reached : float
        The time up to which the proof holds, s.
    reason : str
        Why it goes no further; empty if it goes to the end.
    at_times : bool
        Whether these times were asked for; else they are those after each step.
    parts : int
        How many tubes it is joined of.
    stopped : str
        The event that stops all motions; empty if none does.
    changes : int
        How often an event sets all motions anew, or lets them go on by other forces.
    """

    times: NDArray[np.float64]
    bounds: Box
    events: list[EventBounds]
    steps: int
    reached: float
    reason: str
    at_times: bool
    parts: int = 1
    stopped: str = ""
    changes: int = 0


def prove_tube(
    model: Model, flow: Flow, end: float, times: Sequence[float] | None, max_steps: int, progress: Progress | None
) -> Tube:
    """March a set of motions to its end, and collect the proven bounds.

    Parameters
    ----------
    model : Model
    flow : Flow
    end : float, s
    times : sequence of float, s, optional
        When bounds are wanted; by default after every step.
    max_steps : int
        Steps after which it ends.
    progress : callable, optional
    """
    layout, start = layout_of(model), float(model.statement.initial["t"].si)
    observed = Functions(flow.problem, layout, list(layout.derived.values()))
    events = [_event_bounds(flow.problem, layout, detector) for detector in _occasion_detectors(layout)]
    acting = [
        _acting_event(flow, layout, event, detector)
        for event, detector in zip(events, _occasion_detectors(layout), strict=True)
    ]
    march = _March(flow, _Collected(flow, observed, (start, end), times), events, [event for event in acting if event])
    until, steps, reached = flow.problem.time_of(end), 0, start
    for proof in march.steps(until):
        steps += 1
        # the interval of the end is handed on as an object, and recognised by identity
        reached = end if proof.end is until else float(proof.end[0])
        if progress is not None:
            progress((reached - start) / (end - start), reached, steps)
        if steps >= max_steps and reached < end and not march.stopped:
            flow.reason = f"max_steps = {max_steps} steps were taken"
            break
    collected = march.collected
    bounds = np.stack(collected.rows, axis=1)
    event_bounds, at_times = march.event_bounds(), times is not None
    return Tube(
        np.array(collected.times),
        bounds,
        event_bounds,
        steps,
        reached,
        flow.reason,
        at_times,
        stopped=march.stopped,
        changes=march.changes,
    )


class _March:
    """A proof with the events that record, and those that act.

    Parameters
    ----------
    flow : Flow
    collected : _Collected
    events : list of EventBounds
    acting : list of Acting
        Those of them that act.
    """

    def __init__(self, flow: Flow, collected: _Collected, events: list[EventBounds], acting: list[ActingEvent]) -> None:
        self._flow, self.collected, self._events, self._acting = flow, collected, events, acting
        self._acting_by_name = {event.name: event for event in acting}
        self.stopped, self.changes = "", 0

    def steps(self, until: Box) -> Iterator[Proof]:
        """Prove step after step; yield the part of each up to which no event acts, or the last of all motions has met one."""
        try:
            for event in self._acting:
                event.begin(self._flow)
            for proof in self._flow.until([until]):
                yield self._take_step(proof)
                if self.stopped:
                    return
        except UndefinedError as error:
            self._flow.reason = str(error)

    def _take_step(self, proof: Proof) -> Proof:
        """Collect the bounds that a step proves; after an acting event, continue from its states."""
        recorded = [event.crossings for event in self._events if event.name not in self._acting_by_name]
        passed = None
        if self._acting:
            proof, passed = first_passage(self._acting, self._flow, proof)
        if passed is None:
            self.collected.add(proof)
            for crossings in recorded:
                crossings.follow(proof)
            return proof
        begin, end = map(float, passed.crossing.time)
        for crossings in recorded:
            follow_past(crossings, passed)
        if passed.stops:
            self.stopped = passed.names[0]
            part = proof.cut(max(begin, float(proof.begin[0])))
            if begin > proof.begin[1]:  # else the first motion stops where the step begins
                self.collected.add(part)
            return part
        land_after_passage(self._flow, passed)
        self.changes += 1
        self.collected.pass_over(passed)
        return proof.cut(end)

    def event_bounds(self) -> list[EventBounds]:
        """Return the events, each with the proven bounds of its zeros."""
        for event in self._events:
            if event.name not in self._acting_by_name:
                event.crossings.end()
        return [
            replace(event, crossings=self._acting_by_name[event.name].crossings)
            if event.name in self._acting_by_name
            else event
            for event in self._events
        ]


def unproven(model: Model, times: Sequence[float]) -> Tube:
    """Return the tube at some times before anything is proven: its quantities, which are nan, and its events."""
    layout, problem = layout_of(model), interval_problem_of(model)
    bounds = np.full((2, len(times), problem.used + len(layout.derived)), np.nan)
    events = [_event_bounds(problem, layout, detector) for detector in _occasion_detectors(layout)]
    return Tube(np.array(times), bounds, events, 0, np.nan, "", at_times=True)


def _occasion_detectors(layout: Layout) -> list[Detector]:
    return [detector for detector in layout.watched if detector.role == OCCASION]


def _event_bounds(problem: IntervalProblem, layout: Layout, detector: Detector) -> EventBounds:
    trees = [detector.looked_at, function_rate(layout.model, detector)]
    jumping = bool(problem.constants.tables) and Functions(problem, layout, trees[:1]).reads_tables
    return EventBounds(detector.name, detector.direction, Crossings(Functions(problem, layout, trees), jumping))


def _acting_event(flow: Flow, layout: Layout, event: EventBounds, detector: Detector) -> ActingEvent | None:
    """Return an event that acts; None for one that records."""
    declared, model, problem = detector.event, layout.model, flow.problem
    if declared.action == "record":
        return None
    to = list(model.regimes).index(declared.to) if declared.action == "switch" else -1
    trees = {problem.names.index(target): model.elements.expanded(tree) for target, tree in declared.reset.items()}
    reset = Reset(Functions(problem, layout, [*trees.values()]), tuple(trees)) if trees else None
    resets_function = not model.elements.reads(detector.function).isdisjoint(declared.reset)
    function, zeros, stops = text_of(detector.function), replace(event.crossings, fine=True), declared.action == "stop"
    return ActingEvent(event.name, event.direction, declared.count, to, stops, reset, function, resets_function, zeros)


class _Collected:
    """Bounds after every step, or at wanted times."""

    def __init__(
        self, flow: Flow, observed: Functions, span: tuple[float, float], times: Sequence[float] | None
    ) -> None:
        (start, self._end), self._flow = span, flow
        self._observed, self._used, self._law = observed, flow.problem.used, flow.problem.constants
        self._rows_and_times = (
            None if times is None else [(row_index, flow.problem.time_of(time)) for row_index, time in enumerate(times)]
        )
        unknown = np.full((2, self._used + observed.count), np.nan)
        initial_constants = flow.problem.constants.values_from(flow.regime, float(flow.time[0]))
        at_start = np.concatenate(
            [flow.box[:, : self._used], observed.at_start(flow.time, flow.box, initial_constants)], axis=1
        )
        self.times = [start] if times is None else list(times)
        self.rows = [at_start] if times is None else [unknown] * len(times)
        for row_index, time in self._rows_and_times or ():
            if time[0] <= flow.time[0]:
                self.rows[row_index] = at_start

    def add(self, proof: Proof) -> None:
        """Collect the bounds that a step proves."""
        if self._rows_and_times is None:
            self._append(proof.end, self._bounds_row(proof, proof.end, proof.end_box))
            return
        for row_index, time in self._rows_and_times:
            if proof.begin[0] < time[0] and time[1] <= proof.end[1]:
                self.rows[row_index] = self._bounds_row(proof, time, proof.box_at(time))

    def pass_over(self, passed: Passage) -> None:
        """Collect the bounds of a step with an acting event: before it, while motions pass, and after the last."""
        proof, (begin, end) = passed.proof, passed.crossing.time
        flow = self._flow
        observed_after = self._observed.of_set(flow.time, flow.set.itself(), flow.box, passed.step_values)
        last = np.concatenate([flow.box[:, : self._used], observed_after], axis=1)
        if self._rows_and_times is None:
            self._append(flow.time, last)
            return
        for row_index, time in self._rows_and_times:
            if not (proof.begin[0] < time[0] and time[1] <= end):
                continue
            self.rows[row_index] = self._bounds_row(proof, time, proof.box_at(time))
            if time[0] == end:
                self.rows[row_index] = last
            elif time[1] >= begin:
                beyond = self._observed.at_start(time, passed.between, passed.step_values)
                beyond = np.concatenate([passed.between[:, : self._used], beyond], axis=1)
                self.rows[row_index] = boxes.hull(self.rows[row_index], beyond)

    def _append(self, time: Box, row: Box) -> None:
        self.times.append(self._end if np.array_equal(time, self._flow.problem.time_of(self._end)) else float(time[0]))
        self.rows.append(row)

    def _bounds_row(self, proof: Proof, time: Box, states: Box) -> Box:
        observed_bounds = self._observed.bounds_in_step(proof, time)
        constants_after = self._law.values_from(proof.step_values[0], float(time[1]))
        if not (
            np.array_equal(constants_after, proof.step_values) or self._law.lacking(constants_after)
        ):  # a piece ends there, another begins
            observed_bounds = boxes.hull(
                observed_bounds, self._observed.bounds_in_step(replace(proof, step_values=constants_after), time)
            )
        return np.concatenate([states[:, : self._used], observed_bounds], axis=1)


def split_box(start: Box, count: int) -> list[Box]:
    """Cut a box into `count` parts, each cut halving the component that is widest relative to its size.

    Neighbours share the number at which they are cut, so that together they are the whole.
    """
    parts = deque([start])
    while len(parts) < count:
        part = parts.popleft()
        i = int(np.argmax(boxes.width(part) / np.maximum(boxes.magnitude(part), np.finfo(float).tiny)))
        lower, upper = part.copy(), part.copy()
        lower[1, i] = upper[0, i] = boxes.midpoint(part)[i]
        parts += [lower, upper]
    return list(parts)


def join_tubes(tubes: Sequence[Tube]) -> Tube:
    """Return bounds of all motions of several tubes at common times.

    Bounds are known where they are of every part, and zeros of an event as far as every part has as many of them.
    """
    first = min(tubes, key=lambda tube: tube.reached)
    low, high = (np.stack([tube.bounds[side] for tube in tubes]) for side in range(2))
    bounds = np.stack([low.min(axis=0), high.max(axis=0)])  # nan where one is
    events = [_join_event(same) for same in zip(*(tube.events for tube in tubes), strict=True)]
    steps, changes = sum(tube.steps for tube in tubes), {tube.changes for tube in tubes}
    same = changes.pop() if len(changes) == 1 else 0  # else some motions are changed more often than others
    return replace(first, bounds=bounds, events=events, steps=steps, parts=len(tubes), changes=same)


def _join_event(parts: Sequence[EventBounds]) -> EventBounds:
    """Return bounds of the zeros of an event from those of each part of the starts."""
    event, many = parts[0], [part.crossings for part in parts]
    common = list(_common_crossings([crossings.zeros for crossings in many]))
    beyond = [crossings.zeros[len(common)].time[0] for crossings in many if len(crossings.zeros) > len(common)]
    unknown = min([crossings.unknown_from for crossings in many] + [float(time) for time in beyond], default=inf)
    known_crossings = [crossing for crossing in common if crossing.time[1] < unknown]
    begun_until = max(crossings.begun_until for crossings in many)
    return replace(
        event, crossings=replace(event.crossings, zeros=known_crossings, begun_until=begun_until, unknown_from=unknown)
    )


def _common_crossings(parts: Sequence[Sequence[Crossing]]) -> Iterator[Crossing]:
    """Yield crossings that every part has, each joined, up to the first that one lacks."""
    for same in zip(*parts, strict=False):
        if len({crossing.rising for crossing in same}) > 1:
            return
        joined_crossing = same[0]
        for part_crossing in same[1:]:
            time, state = (
                boxes.hull(joined_crossing.time, part_crossing.time),
                boxes.hull(joined_crossing.state, part_crossing.state),
            )
            joined_crossing = Crossing(time, joined_crossing.rising, state)
        yield joined_crossing
