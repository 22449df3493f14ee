"""Events that act: whether every motion of a set passes one within a step, and which is the first."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.tubes.crossings import Crossing, Crossings, sign_of
from xdynamics.tubes.flow import Flow, Proof
from xdynamics.tubes.passages import Passage, Reset, passage
from xdynamics.tubes.series import UndefinedError


@dataclass
class Acting:
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
    moved : bool
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
    moved: bool
    crossings: Crossings

    @property
    def counted(self) -> int:
        """How many zeros have counted."""
        return sum(map(self.counts, self.crossings.found))

    def counts(self, crossing: Crossing) -> bool:
        """Whether a zero is passed in the direction that counts."""
        return self.counts_way(1 if crossing.rising else -1)

    def counts_way(self, way: int) -> bool:
        """Whether a zero counts that is passed upward, 1, or downward, -1."""
        return self.direction == "either" or (way > 0) == (self.direction == "rising")

    def begin(self, flow: Flow) -> None:
        """Find the side on which all motions start.

        Raises
        ------
        UndefinedError
            If they start on both.
        """
        held = flow.problem.constants.at(flow.regime, float(flow.time[0]))
        value, rate = self.crossings.over(flow.time, flow.box, held).T
        side = sign_of(value)
        if side == 0 and ((value[0] >= 0.0 and rate[0] > 0.0) or (value[1] <= 0.0 and rate[1] < 0.0)):
            side = sign_of(rate)  # it starts at zero, and leaves it
        if side == 0:
            raise UndefinedError(
                f"event '{self.name}' may be zero at the start, where its function lies between {value[0]:.4g} and {value[1]:.4g}"
            )
        self.crossings.stand(side)

    def followed(self, proof: Proof) -> tuple[Crossings, Crossing | None, float]:
        """Return zeros after a further step, the first at which it acts, and from when on zeros are not told from none."""
        trial = copy(self.crossings)
        trial.found, before, counted = list(trial.found), len(trial.found), self.counted
        trial.follow(proof)
        first = None
        for crossing in trial.found[before:]:
            counted += self.counts(crossing)
            if self.counts(crossing) and counted >= self.count:
                first = crossing
                break
        return trial, first, trial.known_until


def first_passage(acting: Sequence[Acting], flow: Flow, proof: Proof) -> tuple[Proof, Passage | None]:
    """Return the part of a step up to which no event acts, and the event that acts there, if one does.

    Raises
    ------
    UndefinedError
        If it cannot be told whether or in which order motions pass events.
    """
    trials = [event.followed(proof) for event in acting]
    unknown = min([known for _, _, known in trials])
    found = [(float(first.time[1]), event, first) for event, (_, first, _) in zip(acting, trials, strict=True) if first]
    end, event, crossing = min(found, key=lambda each: each[0]) if found else (np.inf, None, None)
    if event is None or crossing is None or unknown <= end:
        if unknown == np.inf:
            for one, (trial, _, _) in zip(acting, trials, strict=True):
                one.crossings = trial
            return proof, None
        if not unknown > proof.begin[1]:
            name = next(one.name for one, (_, _, known) in zip(acting, trials, strict=True) if known == unknown)
            raise UndefinedError(
                f"whether every motion passes '{name}', and once, cannot be told: the set is too wide, or touches zero"
            )
        return _before(unknown, acting, flow, proof)
    together = [
        one
        for one, (_, first, _) in zip(acting, trials, strict=True)
        if first and one.function == event.function and np.array_equal(first.time, crossing.time)
    ]
    passed = _done(together, flow, proof, crossing)
    for other in acting:
        if other not in together:
            _stay(other, passed)
    for one in together:
        _take_side(one, passed)
    return proof, passed


def _done(together: Sequence[Acting], flow: Flow, proof: Proof, crossing: Crossing) -> Passage:
    """Return what some events do at a zero of their function."""
    names = [one.name for one in together]
    resets = [one.reset for one in together if one.reset]
    if len(resets) > 1:
        raise UndefinedError(f"events '{names[0]}' and '{names[1]}' set the state at the same time")
    regimes = [float(proof.held[0]), *(float(one.to) for one in together if one.to >= 0)]
    stops = any(one.stops for one in together)
    return passage(names, flow, proof, crossing, regimes[-1], resets[0] if resets else None, stops=stops)


def _before(time: float, acting: Sequence[Acting], flow: Flow, proof: Proof) -> tuple[Proof, Passage | None]:
    """Let a step end where an event may begin to be passed, so that a whole step is left for it."""
    part = proof.cut(time)
    trials = [event.followed(part) for event in acting]
    if any(first for _, first, _ in trials):  # in a shorter step zeros are told apart that were not
        return first_passage(acting, flow, part)
    for event, (trial, _, known) in zip(acting, trials, strict=True):
        if known < np.inf:
            raise UndefinedError(f"whether every motion passes '{event.name}' cannot be told")
        event.crossings = trial
    flow.land(part.end, proof.seen(part.end), part.after)
    return part, None


def _stay(other: Acting, passed: Passage) -> None:
    """Follow another event up to where one acts, and see that it does not act meanwhile."""
    crossing, proof, between, held = passed.crossing, passed.proof, passed.between, passed.held
    zeros, known = other.crossings, np.inf
    if crossing.time[0] > proof.begin[1]:
        zeros, _, known = other.followed(proof.cut(float(crossing.time[0])))
    zeros = copy(zeros)
    side = zeros.side_over(crossing.time, proof, between, held)
    way = 0 if passed.reset else zeros.way_over(crossing.time, proof, between, held)
    if side == 0 and way and not other.counts_way(way):
        zeros.stand(way)  # what it passes, if at all, does not count
    elif known < np.inf or side == 0 or side != zeros.side:
        raise UndefinedError(f"event '{other.name}' may be passed while '{passed.names[0]}' acts, before or after it")
    other.crossings = zeros


def _take_side(event: Acting, passed: Passage) -> None:
    """Note an event's zero, and on which side of it all motions are behind it: perhaps on that which they came from.

    Raises
    ------
    UndefinedError
        If that cannot be told.
    """
    crossing, before = passed.crossing, event.crossings
    value, rate = before.over(crossing.time, passed.between, passed.held).T
    side = sign_of(value)
    if side == 0 and not event.moved:
        side = sign_of(rate)  # each was at zero when it passed
    if side == 0 and not passed.stops:
        raise UndefinedError(f"on which side of zero '{event.name}' is after it has been passed cannot be told")
    earlier = [found for found in event.followed(passed.proof)[0].found if found.time[1] <= crossing.time[0]]
    kept = [*before.found, *earlier[len(before.found) :], crossing]
    event.crossings = replace(before, found=kept)
    event.crossings.stand(side)


def follow_past(crossings: Crossings, passed: Passage) -> None:
    """Look for zeros of an event that records in a step in which another acts."""
    crossing, proof = passed.crossing, passed.proof
    if crossing.time[0] > proof.begin[1]:
        crossings.follow(proof.cut(float(crossing.time[0])))
    side = crossings.side_over(crossing.time, proof, passed.between, passed.held)
    if crossings.unknown_from == np.inf and (side == 0 or crossings.side != side or crossings.known_until < np.inf):
        crossings.unknown_from = min(float(crossing.time[0]), crossings.known_until)
