"""Zeros of a function over a set of motions: intervals of the crossing times, and the action of an event there.

Where the function has no zero, or rises or falls for all motions throughout, is told from its bounds and those of its
rate on pieces of a step, which are halved until it is; between pieces where all motions are below and all above, each
passes zero once, at a time that the interval Newton method narrows (Moore, Kearfott, Cloud 2009, section 8.1).

Each motion of a set passes an event at a time of its own. A motion that passes at a time t* of an interval T goes on by
other equations from there, perhaps from another state. Up to the end of T the equations before are proven to hold too.
With h for what the event sets, x for the motion by the equations before, f for its rates and g for those of the motion
z after,

    z(end) = h(x(end)) + integral from t* to the end of (g(z) - h'(x) f(x)),

so that the set keeps its shape, and grows by the length of T times bounds of the integrand, over boxes that no motion
leaves.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import UNKNOWN, AffineImage, Box, Floats
from xdynamics.tubes.flow import LEAST_SLACK, Flow, Proof
from xdynamics.tubes.functions import Functions
from xdynamics.tubes.series import UndefinedError

DEEPEST, NARROWINGS, ENOUGH = 7, 30, 0.8  # halvings of a step; turns of Newton's method, while it takes so much off


@dataclass(frozen=True)
class Crossing:
    """A zero that every motion passes.

    Attributes
    ----------
    time : ndarray, shape (2,)
    rising : bool
    state : ndarray, shape (2, n)
        What holds every motion at its own zero.
    """

    time: Box
    rising: bool
    state: Box


@dataclass(frozen=True)
class _Piece:
    """A part of a step in which there may be zeros: the sign of the rate, 0 where it is not known."""

    proof: Proof
    time: Box
    rate: int


@dataclass
class Crossings:
    """The zeros of one function, step after step.

    Attributes
    ----------
    functions : Functions
        The function, and its rate along the motion.
    jumping : bool
        Whether the function reads a table, and may jump where two of its pieces meet.
    fine : bool
        Whether a part of a step in which there may be a zero is to be as short as can be.
    zeros : list of Crossing
    begun_until : float
        The time by which all motions of a set that may have been zero at the start, or a part on either side, are on one
        side: what they pass before is not counted. Minus infinity where they start on one side.
    unknown_from : float
        The time from which zeros are not known; infinite where all are.
    """

    functions: Functions
    jumping: bool = False
    fine: bool = False
    zeros: list[Crossing] = field(default_factory=list)
    begun_until: float = -np.inf
    unknown_from: float = np.inf
    _sign: int = 0
    _open: list[_Piece] = field(default_factory=list)
    _last: Proof | None = None
    _signed: Proof | None = None
    _has_begun: bool = False

    def follow(self, proof: Proof) -> None:
        """Look for zeros in a further step."""
        if self.unknown_from < np.inf:
            return
        if not self._has_begun:
            self._has_begun = True
            self._sign = sign_of(self.functions.bounds_in_step(proof, proof.begin)[:, 0])
        self._last = proof
        time = np.array([proof.begin[0], proof.end[1]])
        # most steps are told from all that motions come by, without looking at their pieces
        everywhere = sign_of(self.functions.at_start(time, proof.enclosure, proof.step_values)[:, 0])
        entire_step = [(_Piece(proof, time, 0), everywhere)]
        for piece, sign in entire_step if everywhere else self._pieces_of_step(proof, time, DEEPEST):
            if sign:
                if not self._open and self._sign * sign < 0:
                    self.unknown_from = float(piece.time[0])  # it jumped
                self._decide_open(sign, proof)
                self._sign, self._signed, self._open = sign, proof, []
            else:
                self._open = [*self._open, piece]  # copies have lists of their own
        if self.jumping and self._open:
            self._conclude(proof)  # before it may jump

    @property
    def side(self) -> int:
        """The sign of the function where it was last known."""
        return self._sign

    @property
    def known_until(self) -> float:
        """The time from which it is not known whether motions have passed zero; infinite where it is."""
        return min(self.unknown_from, float(self._open[0].time[0]) if self._open else np.inf)

    def set_side(self, side: int) -> None:
        """Record that all motions are on one side of zero, or at zero and about to enter that side."""
        self._sign, self._signed, self._open, self._has_begun = side, None, [], True

    def sign_over(self, time: Box, proof: Proof, between: Box, step_values: Floats) -> int:
        """Return the sign over an interval in which motions go over from a step's equations to others; 0 if it has both."""
        return sign_of(self._bounds_across(time, proof, between, step_values)[:, 0])

    def rate_sign_over(self, time: Box, proof: Proof, between: Box, step_values: Floats) -> int:
        """Return the sign of the rate over such an interval; 0 if it has both."""
        return sign_of(self._bounds_across(time, proof, between, step_values)[:, 1])

    def bounds_over(self, time: Box, states: Box, step_values: Floats) -> Box:
        """Return bounds of the function and of its rate over a box, shape (2, 2)."""
        return _steady(self.functions.at_start(time, states, step_values))

    def _bounds_across(self, time: Box, proof: Proof, between: Box, step_values: Floats) -> Box:
        return boxes.hull(
            self.bounds_over(time, proof.box_at(time), proof.step_values), self.bounds_over(time, between, step_values)
        )

    def end(self) -> None:
        """Record that no further step follows."""
        if self._last is not None:
            self._conclude(self._last)
        if self._open and self.unknown_from == np.inf:
            self.unknown_from = float(self._open[0].time[0])

    def _conclude(self, proof: Proof) -> None:
        """Decide the zeros before the end of a step, if the sign is known there."""
        if sign := sign_of(self.functions.bounds_in_step(proof, proof.end)[:, 0]):
            self._decide_open(sign, proof)
            self._sign, self._signed, self._open = sign, proof, []

    def _pieces_of_step(self, proof: Proof, time: Box, depth: int) -> Iterator[tuple[_Piece, int]]:
        """Yield parts of a step in turn: with the sign of the function, or 0 where it may be zero."""
        value, rate = _steady(self.functions.bounds_in_step(proof, time)).T
        middle = boxes.point_box(float(boxes.midpoint(time)))
        # the mean value form, sharper than bounds over the whole piece where the rate is bounded
        # where one end of the rate is infinite, its other end bounds nothing: the time goes to both sides of the middle
        is_bounded = np.isfinite(rate).all()
        slope_term = boxes.multiply(rate, boxes.subtract(time, middle)) if is_bounded else np.array([-np.inf, np.inf])
        value = boxes.intersection(value, boxes.add(self.functions.bounds_in_step(proof, middle)[:, 0], slope_term))
        is_monotone = sign_of(rate) and depth < DEEPEST and not self.fine
        if (sign := sign_of(value)) or is_monotone or depth == 0:
            yield _Piece(proof, time, sign_of(rate)), sign
            return
        for half in ((time[0], middle[0]), (middle[0], time[1])):
            yield from self._pieces_of_step(proof, np.array(half), depth - 1)

    def _decide_open(self, sign: int, closing: Proof) -> None:
        """Decide the zeros between the last known sign and a new one, in a step."""
        if not self._open or self.unknown_from < np.inf:
            return
        rates = {piece.rate for piece in self._open}
        proofs = [piece.proof for piece in self._open] + [closing, self._signed or closing]
        laws = {proof.step_values.tobytes() for proof in proofs}
        if len(rates) > 1 or (self.jumping and len(laws) > 1) or 0 in rates or (self._sign == 0 and sign not in rates):
            self.unknown_from = float(self._open[0].time[0])
        elif self._sign == 0:
            self.begun_until = float(self._open[-1].time[1])
        elif self._sign != sign:
            self.zeros.append(self._narrowed_crossing(sign > 0))

    def _narrowed_crossing(self, rising: bool) -> Crossing:  # noqa: FBT001 - what the crossing is
        """Narrow the time of a zero in each piece, and join the narrowed intervals."""
        narrowed = [(piece, time) for piece in self._open if (time := self._narrowed(piece)) is not None]
        times = [time for _, time in narrowed]
        states = [piece.proof.box_at(time) for piece, time in narrowed]
        time, state = times[0], states[0]
        for next_time, at_other in zip(times[1:], states[1:], strict=True):
            time, state = boxes.hull(time, next_time), boxes.hull(state, at_other)
        return Crossing(time, rising, state)

    def _narrowed(self, piece: _Piece) -> Box | None:
        """Return the times at which the function may be zero in a piece; None if there are none."""
        time = piece.time
        for _ in range(NARROWINGS):
            middle = boxes.point_box(float(boxes.midpoint(time)))
            value = self.functions.bounds_in_step(piece.proof, middle)[:, 0]
            rate = self.functions.bounds_in_step(piece.proof, time)[:, 1]
            if boxes.has_zero(rate) or not np.isfinite([value, rate]).all():
                return time
            narrowed_time = boxes.intersection(time, boxes.subtract(middle, boxes.divide(value, rate)))
            if narrowed_time[0] > narrowed_time[1]:
                return None
            if boxes.width(narrowed_time) > ENOUGH * boxes.width(time):
                return narrowed_time
            time = narrowed_time
        return time


def _steady(bounds: Box) -> Box:
    """Return bounds of a function and its rate, which tells nothing where the function may jump: there it has no bounds."""
    return bounds if np.isfinite(bounds[:, 0]).all() else np.concatenate([bounds[:, :1], UNKNOWN], axis=1)


def sign_of(bounds: Box) -> int:
    """Return 1 or -1 where all of an interval is above or below zero, else 0."""
    return int(bounds[0] > 0.0) - int(bounds[1] < 0.0)


TRIALS, WIDER = 8, 0.5  # of candidates for a box that no motion leaves; by which part of what is reached they are wider


@dataclass(frozen=True)
class Reset:
    """New values of some numbers of a set, from those before.

    Attributes
    ----------
    functions : Functions
        They read no time.
    targets : tuple of int
        Which numbers they are of.
    """

    functions: Functions
    targets: tuple[int, ...]

    def box(self, time: Box, states: Box, step_values: Floats) -> Box:
        """Return a box that holds the states after."""
        states_after = states.copy()
        states_after[:, self.targets] = self.functions.at_start(time, states, step_values)
        return states_after

    def rates(self, time: Box, states: Box, step_values: Floats, rates: Box) -> Box:
        """Return how fast the states after change with those before, of which rates are given."""
        rates_after = rates.copy()
        _, slopes = self.functions.enclosures(time, states, step_values)
        rates_after[:, self.targets] = boxes.matrix_product(slopes, rates)
        return rates_after

    def image_after(self, time: Box, image_before: AffineImage, states: Box, step_values: Floats) -> AffineImage:
        """Return the states after, seen from those that the states before are seen from."""
        middle = boxes.point_box(boxes.midpoint(image_before.image))
        _, slopes = self.functions.enclosures(time, boxes.hull(states, middle), step_values)
        values = self.functions.at_start(time, middle, step_values)
        image, derivatives = image_before.image.copy(), image_before.derivatives.copy()
        image[:, self.targets] = boxes.add(
            values, boxes.matrix_product(slopes, boxes.subtract(image_before.image, middle))
        )
        derivatives[:, self.targets] = boxes.matrix_product(slopes, image_before.derivatives)
        return replace(image_before, image=image, derivatives=derivatives)


@dataclass(frozen=True)
class Passage:
    """A zero that every motion passes within a step, and the action there.

    Attributes
    ----------
    names : tuple of str
        Of the events that act there.
    crossing : Crossing
    proof : Proof
        Of the step, by the equations before.
    between : ndarray, shape (2, n)
        What holds the motions that have passed, up to the end of the interval of times.
    step_values : ndarray
        What holds for a step after it.
    reset : Reset, optional
    stops : bool
    """

    names: tuple[str, ...]
    crossing: Crossing
    proof: Proof
    between: Box
    step_values: Floats
    reset: Reset | None
    stops: bool


def passage(
    names: Sequence[str],
    flow: Flow,
    proof: Proof,
    crossing: Crossing,
    regime: float,
    reset: Reset | None,
    *,
    stops: bool,
) -> Passage:
    """Prove that all motions go on to the end of an interval of times in which each passes a zero.

    Raises
    ------
    UndefinedError
        If that is not proven.
    """
    step_values, moving = proof.step_values.copy(), flow.problem.used
    step_values[0] = regime
    states = proof.box_at(crossing.time)
    if reset is not None:
        states = reset.box(crossing.time, states, proof.step_values)
    if not np.isfinite(states).all():
        raise UndefinedError(f"what '{names[0]}' sets is not defined for some of the states")
    candidate = states
    for trial in range(TRIALS):
        reached = boxes.add(
            states, boxes.multiply(_lasting(crossing), flow.rates(crossing.time, candidate, step_values))
        )
        reached[:, moving:] = states[:, moving:]
        # strictly inside: by Picard's theorem no motion leaves the candidate while others still pass
        if ((reached[0] > candidate[0]) & (reached[1] < candidate[1]))[:moving].all():
            return Passage(tuple(names), crossing, proof, reached, step_values, reset, stops)
        slack = boxes.width(reached) * (WIDER * 2.0**trial) + boxes.magnitude(reached) * boxes.EPS + LEAST_SLACK
        slack[moving:] = 0.0
        candidate = np.stack([reached[0] - slack, reached[1] + slack])
    raise UndefinedError("no box was found that motions do not leave while others pass an event: the set is too wide")


def _lasting(crossing: Crossing) -> Box:
    """Return the times from a motion's own zero to the last of all, shape (2, 1)."""
    # the difference is rounded to nearest: the next float is a bound of it
    return np.array([[0.0], [np.nextafter(crossing.time[1] - crossing.time[0], np.inf)]])


def land_after_passage(flow: Flow, passed: Passage) -> None:
    """Continue with the set of all motions after an event, from the time at which the last of them has passed.

    Raises
    ------
    UndefinedError
        If that is not bounded.
    """
    proof, crossing = passed.proof, passed.crossing
    coordinates, moving = flow.problem.motions.motion.coordinates, flow.problem.used
    states, end = proof.box_at(crossing.time), boxes.point_box(float(crossing.time[1]))
    rates_before, seen = flow.rates(crossing.time, states, proof.step_values), proof.image_at(end)
    if passed.reset is not None:
        rates_before = passed.reset.rates(crossing.time, states, proof.step_values, rates_before)
        seen = passed.reset.image_after(end, seen, proof.box_at(end), proof.step_values)
    jump = boxes.subtract(flow.rates(crossing.time, passed.between, passed.step_values), rates_before)
    off = boxes.multiply(_lasting(crossing), jump)
    if passed.reset is None:  # positions differ by no more than velocities have come to do so
        off[:, :coordinates] = boxes.multiply(_lasting(crossing), off[:, coordinates : 2 * coordinates])
    off[:, moving:] = 0.0
    if not (np.isfinite(off).all() and np.isfinite(seen.image).all() and np.isfinite(seen.derivatives).all()):
        raise UndefinedError(f"what '{passed.names[0]}' sets has no bounded derivatives for some of the states")
    flow.regime = float(passed.step_values[0])
    flow.land(end, replace(seen, image=boxes.add(seen.image, off)), passed.between)
