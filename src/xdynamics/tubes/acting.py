"""Events that act: whether every motion of a set passes one within a step, and which is the first."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.tubes.crossings import Crossing, Crossings, Passage, Reset, passage, sign_of
from xdynamics.tubes.flow import Flow, Proof
from xdynamics.tubes.series import UndefinedError


@dataclass
class ActingEvent:
    """An event that acts.

    Attributes
    ----------
    name : str
    direction : str
        Which zeros count.
    count : int
        At which of them, and at all later ones, it acts.
    to : int
        The regime that it switches to; -1 of none.
    stops : bool
    reset : Reset, optional
        What it sets.
    function : str
        Its function, as text: events of the same one act together.
    reads_targets : bool
        Whether what is set is read by the function, which may then be away from zero afterwards.
    crossings : Crossings
    """

    name: str
    direction: str
    count: int
    to: int
    stops: bool
    reset: Reset | None
    function: str
    reads_targets: bool
    crossings: Crossings

    @property
    def zero_count(self) -> int:
        """How many zeros have counted."""
        return sum(map(self.counts_crossing, self.crossings.zeros))

    def counts_crossing(self, crossing: Crossing) -> bool:
        """Whether a zero is passed in the direction that counts."""
        return self.counts_sign(1 if crossing.rising else -1)

    def counts_sign(self, sign: int) -> bool:
        """Whether a zero counts that is passed upward, 1, or downward, -1."""
        return self.direction == "either" or (sign > 0) == (self.direction == "rising")

    def begin(self, flow: Flow) -> None:
        """Find the side on which all motions start.

        Raises
        ------
        UndefinedError
            If they start on both.
        """
        step_values = flow.problem.constants.values_from(flow.regime, float(flow.time[0]))
        value, rate = self.crossings.bounds_over(flow.time, flow.box, step_values).T
        side = sign_of(value)
        if side == 0 and ((value[0] >= 0.0 and rate[0] > 0.0) or (value[1] <= 0.0 and rate[1] < 0.0)):
            side = sign_of(rate)  # it starts at zero, and leaves it
        if side == 0:
            raise UndefinedError(
                f"event '{self.name}' may be zero at the start, where its function lies between {value[0]:.4g} and {value[1]:.4g}"
            )
        self.crossings.set_side(side)

    def trial_step(self, proof: Proof) -> tuple[Crossings, Crossing | None, float]:
        """Return zeros after a further step, the first acting one, and the time from which zeros are undecided."""
        trial = copy(self.crossings)
        # a shallow copy shares its lists: zeros are appended in place, open pieces are always a new list
        trial.zeros, zeros_before, zero_count = list(trial.zeros), len(trial.zeros), self.zero_count
        trial.follow(proof)
        first = None
        for crossing in trial.zeros[zeros_before:]:
            zero_count += self.counts_crossing(crossing)
            if self.counts_crossing(crossing) and zero_count >= self.count:
                first = crossing
                break
        return trial, first, trial.known_until


def first_passage(acting: Sequence[ActingEvent], flow: Flow, proof: Proof) -> tuple[Proof, Passage | None]:
    """Return the part of a step up to which no event acts, and the event that acts there, if one does.

    Raises
    ------
    UndefinedError
        If it cannot be told whether or in which order motions pass events.
    """
    trials = [event.trial_step(proof) for event in acting]
    unknown = min([known_until for _, _, known_until in trials])
    passages = [
        (float(first.time[1]), event, first) for event, (_, first, _) in zip(acting, trials, strict=True) if first
    ]
    # first is by when all motions have passed it; that no other acts meanwhile is checked below
    end, event, crossing = min(passages, key=lambda candidate: candidate[0]) if passages else (np.inf, None, None)
    if event is None or crossing is None or unknown <= end:
        if unknown == np.inf:
            for acting_event, (trial, _, _) in zip(acting, trials, strict=True):
                acting_event.crossings = trial
            return proof, None
        if not unknown > proof.begin[1]:
            name = next(
                acting_event.name
                for acting_event, (_, _, known_until) in zip(acting, trials, strict=True)
                if known_until == unknown
            )
            raise UndefinedError(
                f"whether every motion passes '{name}', and once, cannot be told: the set is too wide, or touches zero"
            )
        return _cut_before(unknown, acting, flow, proof)
    simultaneous = [
        acting_event
        for acting_event, (_, first, _) in zip(acting, trials, strict=True)
        if first and acting_event.function == event.function and np.array_equal(first.time, crossing.time)
    ]
    passed = _simultaneous_passage(simultaneous, flow, proof, crossing)
    for remaining_event in acting:
        if remaining_event not in simultaneous:
            _check_not_acting(remaining_event, passed)
    for acting_event in simultaneous:
        _take_side(acting_event, passed)
    return proof, passed


def _simultaneous_passage(simultaneous: Sequence[ActingEvent], flow: Flow, proof: Proof, crossing: Crossing) -> Passage:
    """Return the common passage of events with one function."""
    names = [event.name for event in simultaneous]
    resets = [event.reset for event in simultaneous if event.reset]
    if len(resets) > 1:
        raise UndefinedError(f"events '{names[0]}' and '{names[1]}' set the state at the same time")
    regimes = [float(proof.step_values[0]), *(float(event.to) for event in simultaneous if event.to >= 0)]
    stops = any(event.stops for event in simultaneous)
    return passage(names, flow, proof, crossing, regimes[-1], resets[0] if resets else None, stops=stops)


def _cut_before(time: float, acting: Sequence[ActingEvent], flow: Flow, proof: Proof) -> tuple[Proof, Passage | None]:
    """End a step where an event may begin to be passed, so that the passage has a full step."""
    part = proof.cut(time)
    trials = [event.trial_step(part) for event in acting]
    if any(first for _, first, _ in trials):  # in a shorter step zeros are told apart that were not
        return first_passage(acting, flow, part)
    for event, (trial, _, known_until) in zip(acting, trials, strict=True):
        if known_until < np.inf:
            raise UndefinedError(f"whether every motion passes '{event.name}' cannot be told")
        event.crossings = trial
    flow.land(part.end, proof.image_at(part.end), part.end_box)
    return part, None


def _check_not_acting(event: ActingEvent, passed: Passage) -> None:
    """Follow another event up to where one acts, and see that it does not act meanwhile."""
    crossing, proof, between, step_values = passed.crossing, passed.proof, passed.between, passed.step_values
    zeros, known_until = event.crossings, np.inf
    if crossing.time[0] > proof.begin[1]:
        zeros, _, known_until = event.trial_step(proof.cut(float(crossing.time[0])))
    zeros = copy(zeros)
    side = zeros.sign_over(crossing.time, proof, between, step_values)
    rate_sign = 0 if passed.reset else zeros.rate_sign_over(crossing.time, proof, between, step_values)
    if side == 0 and rate_sign and not event.counts_sign(rate_sign):
        zeros.set_side(rate_sign)  # what it passes, if at all, does not count
    elif known_until < np.inf or side == 0 or side != zeros.side:
        raise UndefinedError(f"event '{event.name}' may be passed while '{passed.names[0]}' acts, before or after it")
    event.crossings = zeros


def _take_side(event: ActingEvent, passed: Passage) -> None:
    """Record an event's zero, and the side of zero on which all motions continue, perhaps the side they came from.

    Raises
    ------
    UndefinedError
        If that cannot be told.
    """
    crossing, crossings = passed.crossing, event.crossings
    value, rate = crossings.bounds_over(crossing.time, passed.between, passed.step_values).T
    side = sign_of(value)
    if side == 0 and not event.reads_targets:
        side = sign_of(rate)  # each was at zero when it passed
    if side == 0 and not passed.stops:
        raise UndefinedError(f"on which side of zero '{event.name}' is after it has been passed cannot be told")
    earlier = [zero for zero in event.trial_step(passed.proof)[0].zeros if zero.time[1] <= crossing.time[0]]
    zeros = [*crossings.zeros, *earlier[len(crossings.zeros) :], crossing]
    event.crossings = replace(crossings, zeros=zeros)
    event.crossings.set_side(side)


def follow_past(crossings: Crossings, passed: Passage) -> None:
    """Look for zeros of an event that records in a step in which another acts."""
    crossing, proof = passed.crossing, passed.proof
    if crossing.time[0] > proof.begin[1]:
        crossings.follow(proof.cut(float(crossing.time[0])))
    side = crossings.sign_over(crossing.time, proof, passed.between, passed.step_values)
    if crossings.unknown_from == np.inf and (side == 0 or crossings.side != side or crossings.known_until < np.inf):
        crossings.unknown_from = min(float(crossing.time[0]), crossings.known_until)
