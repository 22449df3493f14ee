"""A tube: bounds of states and observables at some times, and of the times of events, collected step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.layout import Layout, layout_of
from xdynamics.model import Model
from xdynamics.model.detectors import OCCASION, Detector, function_rate
from xdynamics.tubes import Flow, IntervalProblem, Proof, boxes, interval_problem_of
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.crossings import Crossing, Crossings
from xdynamics.tubes.functions import Functions

if TYPE_CHECKING:
    from xdynamics.march.runner import Progress


@dataclass(frozen=True)
class EventBounds:
    """What is known of the zeros of an event.

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
    def counted(self) -> list[Crossing]:
        """The zeros in the event's direction."""
        return [
            found
            for found in self.crossings.found
            if self.direction == "either" or found.rising == (self.direction == "rising")
        ]


@dataclass(frozen=True)
class Tube:
    """What is proven of a motion.

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
    """

    times: NDArray[np.float64]
    bounds: Box
    events: list[EventBounds]
    steps: int
    reached: float
    reason: str
    at_times: bool
    parts: int = 1


def proven(
    model: Model, flow: Flow, end: float, times: Sequence[float] | None, most: int, progress: Progress | None
) -> Tube:
    """March, and collect what is proven.

    Parameters
    ----------
    model : Model
    flow : Flow
    end : float, s
    times : sequence of float, s, optional
        When bounds are wanted; by default after every step.
    most : int
        Steps after which it ends.
    progress : callable, optional
    """
    layout, start = layout_of(model), float(model.initial["t"].si)
    observed = Functions(flow.problem, layout, list(layout.derived.values()))
    events = [_event(flow.problem, layout, detector) for detector in _recorded(layout)]
    collected = _Collected(flow, observed, start, times)
    until, steps, reached = flow.problem.time_of(end), 0, start
    for proof in flow.until([until]):
        steps += 1
        reached = end if proof.end is until else float(proof.end[0])
        collected.add(proof, reached)
        for event in events:
            event.crossings.follow(proof)
        if progress is not None:
            progress((reached - start) / (end - start), reached, steps)
        if steps >= most and reached < end:
            flow.reason = f"max_steps = {most} steps were taken"
            break
    for event in events:
        event.crossings.end()
    bounds = np.stack(collected.rows, axis=1)
    return Tube(np.array(collected.times), bounds, events, steps, reached, flow.reason, times is not None)


def unproven(model: Model, times: Sequence[float]) -> Tube:
    """Return the tube at some times before anything is proven: its quantities, which are nan, and its events."""
    layout, problem = layout_of(model), interval_problem_of(model)
    bounds = np.full((2, len(times), problem.used + len(layout.derived)), np.nan)
    events = [_event(problem, layout, detector) for detector in _recorded(layout)]
    return Tube(np.array(times), bounds, events, 0, np.nan, "", at_times=True)


def _recorded(layout: Layout) -> list[Detector]:
    return [detector for detector in layout.watched if detector.role == OCCASION]


def _event(problem: IntervalProblem, layout: Layout, detector: Detector) -> EventBounds:
    trees = [detector.looked_at, function_rate(layout.model, detector)]
    jumping = bool(problem.constants.tables) and Functions(problem, layout, trees[:1]).reads_tables
    return EventBounds(detector.name, detector.direction, Crossings(Functions(problem, layout, trees), jumping))


class _Collected:
    """Bounds after every step, or at wanted times."""

    def __init__(self, flow: Flow, observed: Functions, start: float, times: Sequence[float] | None) -> None:
        self._observed, self._used, self._law = observed, flow.problem.used, flow.problem.constants
        self._wanted = (
            None if times is None else [(place, flow.problem.time_of(time)) for place, time in enumerate(times)]
        )
        unknown = np.full((2, self._used + observed.count), np.nan)
        held = flow.problem.constants.at(flow.regime, float(flow.time[0]))
        at_start = np.concatenate([flow.box[:, : self._used], observed.at_start(flow.time, flow.box, held)], axis=1)
        self.times = [start] if times is None else list(times)
        self.rows = [at_start] if times is None else [unknown] * len(times)
        for place, time in self._wanted or ():
            if time[0] <= flow.time[0]:
                self.rows[place] = at_start

    def add(self, proof: Proof, reached: float) -> None:
        """Take what a step proves."""
        if self._wanted is None:
            self.times.append(reached)
            self.rows.append(self._row(proof, proof.end, proof.after))
            return
        for place, time in self._wanted:
            if proof.begin[0] < time[0] and time[1] <= proof.end[1]:
                self.rows[place] = self._row(proof, time, proof.at(time))

    def _row(self, proof: Proof, time: Box, states: Box) -> Box:
        found = self._observed.within(proof, time)
        after = self._law.at(proof.held[0], float(time[1]))
        if not (np.array_equal(after, proof.held) or self._law.lacking(after)):  # a piece ends there, another begins
            found = boxes.hull(found, self._observed.within(replace(proof, held=after), time))
        return np.concatenate([states[:, : self._used], found], axis=1)
