"""Events that act: when every motion of a set has passed one, all go on by the forces of another regime, or stop.

A motion that passes at its own time t* in an interval T goes on by other equations from there. To the end of T it differs
from the motion by the equations before, which are proven to hold up to there, by the integral of the difference of both
rates: of which bounds over boxes that no motion leaves in T are known. So the set keeps its shape, and grows by the length
of T times the jump of the rates.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.crossings import Crossing, Crossings, sign_of
from xdynamics.tubes.flow import Flow, Proof
from xdynamics.tubes.series import UndefinedError

TRIALS, WIDER = 8, 0.5  # of candidates for a box that no motion leaves; by which part of what is reached they are wider


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
        The regime that it switches to; -1 where it stops.
    crossings : Crossings
    """

    name: str
    direction: str
    count: int
    to: int
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
        value, rate = self.crossings.functions.at_start(flow.time, flow.box, held).T
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


@dataclass(frozen=True)
class Passage:
    """An event that every motion passes within a step.

    Attributes
    ----------
    event : Acting
    crossing : Crossing
    proof : Proof
        Of the step, by the equations before.
    between : ndarray, shape (2, n)
        What holds the motions that have passed, up to the end of the interval of times.
    held : ndarray
        What holds for a step after it.
    """

    event: Acting
    crossing: Crossing
    proof: Proof
    between: Box
    held: Floats


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
        return _before(unknown, acting, flow, proof), None
    between, held = _between(flow, proof, crossing, event.to)
    for other in acting:
        if other is not event:
            _stay(other, proof, crossing, between, held)
    return proof, Passage(event, crossing, proof, between, held)


def _before(time: float, acting: Sequence[Acting], flow: Flow, proof: Proof) -> Proof:
    """Let a step end where an event may begin to be passed, so that a whole step is left for it."""
    part = proof.cut(time)
    for event in acting:
        event.crossings, _, known = event.followed(part)
        if known < np.inf:
            raise UndefinedError(f"whether every motion passes '{event.name}' cannot be told")
    flow.land(part.end, proof.seen(part.end), part.after)
    return part


def _stay(other: Acting, proof: Proof, crossing: Crossing, between: Box, held: Floats) -> None:
    """Follow another event up to where one acts, and see that it does not act meanwhile."""
    zeros, known = other.crossings, np.inf
    if crossing.time[0] > proof.begin[1]:
        zeros, _, known = other.followed(proof.cut(float(crossing.time[0])))
    zeros = copy(zeros)
    side = zeros.side_over(crossing.time, proof, between, held)
    if side == 0 and (way := zeros.way_over(crossing.time, proof, between, held)) and not other.counts_way(way):
        zeros.stand(way)  # what it passes, if at all, does not count
    elif known < np.inf or side == 0 or side != zeros.side:
        raise UndefinedError(f"event '{other.name}' may be passed while another acts, before or after it")
    other.crossings = zeros


def _between(flow: Flow, proof: Proof, crossing: Crossing, to: int) -> tuple[Box, Floats]:
    """Return a box that motions do not leave from their own zeros to the last of all, and what holds for them there."""
    held = proof.held.copy()
    if to >= 0:
        held[0] = to
    states, moving = proof.at(crossing.time), flow.problem.used
    lasting = np.array([0.0, boxes.width(crossing.time) * (1.0 + 4.0 * boxes.EPS)])
    candidate = states
    for trial in range(TRIALS):
        reached = boxes.add(states, boxes.multiply(lasting[:, None], flow.rates(crossing.time, candidate, held)))
        reached[:, moving:] = states[:, moving:]
        inside = (reached[0] > candidate[0]) & (reached[1] < candidate[1])
        if inside[:moving].all():
            return reached, held
        slack = boxes.width(reached) * (WIDER * 2.0**trial) + boxes.size(reached) * boxes.EPS + 1e-290
        slack[moving:] = 0.0
        candidate = np.stack([reached[0] - slack, reached[1] + slack])
    raise UndefinedError("no box was found that motions do not leave while others pass an event: the set is too wide")


def go_on(flow: Flow, passage: Passage) -> None:
    """Let all motions go on by the equations of another regime, from when the last of them has passed."""
    proof, crossing, event = passage.proof, passage.crossing, passage.event
    coordinates, moving = flow.problem.motions.motion.coordinates, flow.problem.used
    lasting = np.array([0.0, boxes.width(crossing.time) * (1.0 + 4.0 * boxes.EPS)])
    jump = boxes.subtract(
        flow.rates(crossing.time, passage.between, passage.held),
        flow.rates(crossing.time, proof.at(crossing.time), proof.held),
    )
    off = boxes.multiply(lasting[:, None], jump)
    # positions differ by no more than velocities have come to do so
    off[:, :coordinates] = boxes.multiply(lasting[:, None], off[:, coordinates : 2 * coordinates])
    off[:, moving:] = 0.0
    end = boxes.point(float(crossing.time[1]))
    seen = proof.seen(end)
    flow.regime = float(event.to)
    flow.land(end, replace(seen, image=boxes.add(seen.image, off)), passage.between)
    _take_side(event, passage)


def _take_side(event: Acting, passage: Passage) -> None:
    """Note an event's zero, and on which side of it all motions are behind it.

    Raises
    ------
    UndefinedError
        If that cannot be told, or each would pass it again at once.
    """
    crossing, before = passage.crossing, event.crossings
    rates = before.functions.at_start(crossing.time, passage.between, passage.held)[:, 1]
    side, ahead = sign_of(rates), 1 if crossing.rising else -1
    if side == 0:
        raise UndefinedError(f"on which side of zero '{event.name}' is after it has been passed cannot be told")
    if side != ahead and event.direction == "either":
        raise UndefinedError(f"event '{event.name}' would be passed again at once, by forces that drive motions back")
    earlier = [found for found in event.followed(passage.proof)[0].found if found.time[1] <= crossing.time[0]]
    kept = [*before.found, *(found for found in earlier[len(before.found) :]), crossing]
    event.crossings = replace(before, found=kept)
    event.crossings.stand(side)


def follow_past(crossings: Crossings, passage: Passage) -> None:
    """Look for zeros of an event that records in a step in which another acts."""
    crossing, proof = passage.crossing, passage.proof
    if crossing.time[0] > proof.begin[1]:
        crossings.follow(proof.cut(float(crossing.time[0])))
    side = crossings.side_over(crossing.time, proof, passage.between, passage.held)
    if crossings.unknown_from == np.inf and (side == 0 or crossings.side != side or crossings.known_until < np.inf):
        crossings.unknown_from = min(float(crossing.time[0]), crossings.known_until)
