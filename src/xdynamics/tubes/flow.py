"""A set of motions marched step by step, each with a proof that they exist and where they are.

A step is proven by Taylor's theorem: if B holds, in its interior, all that the polynomials of degree p from the set, with
the coefficients of order p + 1 in B as remainder, reach within the step, no motion leaves B in the step, so that it exists
for all of it and has that remainder (Picard and Lindeloef's theorem in the form of Corliss and Rihm 1996; Nedialkov,
Jackson, Corliss 1999, Applied Mathematics and Computation 105, 21).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from math import frexp, inf, ldexp

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import AffineImage, Box, Doubleton, Floats, Polynomials, doubleton_of
from xdynamics.tubes.interval_problem import IntervalProblem
from xdynamics.tubes.series import MotionSeries, UndefinedError

WIDER = 0.02  # by which a candidate is wider than what is reached, as a part of it
TRIALS = 3  # of wider candidates, before a step is shortened
SHORTER, LEAST = 0.5, 1e-9  # factor of a step that is not proven, and what of the first guess is given up
SHARE = 1e-4  # of the width of a set that a remainder may add in a step
SAFETY, WIDE = 0.9, 0.1  # a set that is told of as wide, beside its largest values
LEAST_SLACK, NOTHING = 1e-290, 1e-250  # of what is zero and stays zero; sizes below which rounding does not matter


@dataclass(frozen=True)
class Proof:
    """The proven result of a step.

    Attributes
    ----------
    begin, end : ndarray, shape (2,)
        Intervals that hold the times.
    polynomials : Polynomials
        Evaluates polynomials of the flow.
    coefficients : ndarray, shape (2, p + 2, n + n*n)
        Of the motion from the point of the set, the last of which is the remainder, then of its derivatives by the start,
        for any state of the set.
    set : Doubleton
        At the beginning.
    enclosure : ndarray, shape (2, n)
        What holds all motions for the whole step.
    end_box : ndarray, shape (2, n)
        A box that holds them at its end.
    used : int
        How many numbers move.
    step_values : ndarray
        What holds for the step: `StepConstants.values_from`.
    end_image : AffineImage, optional
        All motions at the end.
    """

    begin: Box
    end: Box
    polynomials: Polynomials
    coefficients: Box
    set: Doubleton
    enclosure: Box
    end_box: Box
    used: int
    step_values: Floats
    end_image: AffineImage | None = None

    def mapped(self, time: Box) -> tuple[Box, Box]:
        """Return the image of the point of the set at a time within the step, and its derivatives for all of the set."""
        # the outward rounding of a difference may reach below zero, where the step proves nothing
        since = np.maximum(boxes.subtract(time, self.begin), 0.0)
        n = self.set.point.size
        values = self.polynomials.values_at(since, self.coefficients)
        image, jacobian = values[:, :n], values[:, n:].reshape(2, n, n)
        constant = slice(self.used, n)  # uncertain constants stay what they are
        image[:, constant] = self.set.point[constant]
        jacobian[:, constant] = np.eye(n)[constant]
        return image, jacobian

    def cut(self, time: float) -> Proof:
        """Return the part of the step up to a time within it."""
        end = boxes.point_box(time)
        return replace(self, end=end, end_box=self.box_at(end), end_image=self.image_at(end))

    @np.errstate(all="ignore")
    def image_at(self, time: Box) -> AffineImage:
        """Return all motions at a time, or at any of an interval, within the step."""
        if time is self.end and self.end_image is not None:
            return self.end_image
        return self.set.image_under(*self.mapped(time))

    @np.errstate(all="ignore")
    def box_at(self, time: Box) -> Box:
        """Return a box that holds all motions at a time, or at any of an interval, within the step."""
        return self.end_box if time is self.end else boxes.intersection(self.image_at(time).box(), self.enclosure)


class Flow:
    """The motions of some equations from a set of starts.

    Parameters
    ----------
    problem : IntervalProblem
    order : int
        Of the polynomials.
    tolerance : float
        Of the truncation of a step, relative to the largest values so far.

    Attributes
    ----------
    reason : str
        Why no further step was proven; empty before.
    """

    def __init__(self, problem: IntervalProblem, order: int, tolerance: float) -> None:
        self.problem, self.order, self.tolerance = problem, order, tolerance
        numbers = problem.start.shape[1]
        self._plain = MotionSeries(problem.motions, numbers, order + 1)
        self._sloped = MotionSeries(problem.motions, numbers, order, derivatives=True)
        self._polynomials = Polynomials(order + 1, numbers * (1 + numbers))
        self.restart()

    def restart(self) -> None:
        """Go back to the set of starts."""
        start, self.reason = self.problem.start, ""
        self._largest = boxes.magnitude(start)
        self.set = Doubleton.of_box(start, self._scales())
        self.box, self.time = start, self.problem.time
        self.regime, self.step_values = float(self.problem.regime), np.empty(0)

    def with_starts(self, start: Box) -> Flow:
        """Return the flow from another set of starts, by shared programs: two threads must not run both at once."""
        flow = copy(self)
        flow.problem = replace(self.problem, start=start)
        flow.restart()
        return flow

    def _scales(self) -> Floats:
        """Return powers of two near the largest values so far, shape (n,); 1 where all values were zero."""
        _, exponents = np.frexp(self._largest)
        # limited, so that the quotient of two scales neither overflows nor vanishes
        return np.where(self._largest > 0.0, np.ldexp(1.0, np.clip(exponents, -300, 300)), 1.0)

    def until(self, ends: Sequence[Box]) -> Iterator[Proof]:
        """Prove step after step, each landing on the next of some times if it gets so far, until one cannot be proven.

        Parameters
        ----------
        ends : sequence of ndarray, shape (2,)
            Ascending.
        """
        nodes = [boxes.point_box(float(node)) for node in self.problem.constants.nodes]
        for end in sorted([*ends, *(node for node in nodes if node[0] < ends[-1][0])], key=lambda end: float(end[0])):
            while self.time[1] < end[1]:
                try:
                    proof = self._prove_step(end)
                except UndefinedError as error:
                    self.reason = f"{error}{self._width_said()}"
                    return
                yield proof

    def land(self, time: Box, seen: AffineImage, enclosure: Box) -> None:
        """Go on from where all motions are at a time of the last step."""
        self.set = doubleton_of(seen, self._scales())
        self.box = boxes.intersection(boxes.intersection(self.set.box(), enclosure), seen.box())
        self.box[:, self.problem.used :] = enclosure[:, self.problem.used :]
        self.time = time

    def rates(self, time: Box, states: Box, step_values: Floats) -> Box:
        """Return the rates of all numbers of a set, over a box; of uncertain constants 0."""
        state_rates = np.zeros_like(states)
        state_rates[:, : self.problem.used] = self._plain.coefficients_of(time, states, step_values)[:, 1, :, 0]
        return state_rates

    def _width_said(self) -> str:
        """Describe the width of the set, if it is wide."""
        parts = boxes.width(self.box) / np.maximum(self._largest, LEAST_SLACK)
        i = int(np.argmax(parts))
        if parts[i] < WIDE:
            return ""
        return f"; the set is wide, with {self.problem.names[i]} from {self.box[0, i]:.4g} to {self.box[1, i]:.4g} (SI units)"

    @np.errstate(all="ignore")  # bounds that are beyond the range of floats are looked for
    def _prove_step(self, end: Box) -> Proof:
        p, used = self.order, self.problem.used
        self.step_values = self.problem.constants.values_from(self.regime, float(self.time[0]))
        if lacking := self.problem.constants.lacking(self.step_values):
            raise UndefinedError(lacking)
        # the theorem of the mean asks for derivatives between the point and every state of the set
        start = boxes.hull(self.box, boxes.point_box(self.set.point))
        centre = self._coefficients_about(self._plain, boxes.point_box(self.set.point))[:, : p + 1]
        around = self._coefficients_about(self._sloped, start)
        # around a point at rest the terms are rounding alone, and tell of no step
        step = first = min(self._proposed(centre), float(end[1] - self.time[0]))
        while True:
            # a step that would leave next to nothing goes all the way to the end
            landing = end if self.time[0] + step * (1.0 + 1e-3) >= end[0] else boxes.point_box(self.time[1] + step)
            span = boxes.subtract(landing, self.time)
            if not 0.0 < span[0] <= span[1] < inf or step < LEAST * first:
                raise UndefinedError(self.reason or "steps become shorter than the spacing of times")
            proven = self._enclose_step(around[..., 0], span)
            if proven is not None:
                enclosure, remainder, reached = proven
                longest = self._allowed(remainder, span[1], enclosure)
                if longest >= 1.0:
                    break
                step = float(span[1]) * max(longest, 0.2)
            else:
                step = float(min(step, span[1])) * SHORTER
        self.reason = ""
        n = start.shape[1]
        coefficients = np.zeros((2, p + 2, n + n * n))
        coefficients[:, :-1, :n], coefficients[:, -1, :n] = centre[..., 0], remainder
        coefficients[:, :-1, n:] = around[..., 1:].reshape(2, p + 1, n * n)
        proof = Proof(
            self.time, landing, self._polynomials, coefficients, self.set, enclosure, self.box, used, self.step_values
        )
        seen = proof.image_at(landing)
        self._largest = np.maximum(self._largest, boxes.magnitude(reached))
        self.set = doubleton_of(seen, self._scales())
        self.box = boxes.intersection(boxes.intersection(self.set.box(), reached), seen.box())
        self.box[:, used:] = start[:, used:]
        if not (np.isfinite(self.box).all() and (self.box[0] <= self.box[1]).all()):
            raise UndefinedError("the set is too wide: its bounds are beyond the range of floats")
        self.time = landing
        return replace(proof, end_box=self.box, end_image=seen)

    def _coefficients_about(self, series: MotionSeries, start: Box) -> Box:
        """Return coefficients, with those of uncertain constants: their values, and nothing further."""
        return self._with_constants(series.coefficients_of(self.time, start, self.step_values), start)

    def _with_constants(self, moving_coefficients: Box, start: Box) -> Box:
        used, number = self.problem.used, start.shape[1]
        coefficients = np.zeros((2, moving_coefficients.shape[1], number, moving_coefficients.shape[3]))
        coefficients[:, :, :used] = moving_coefficients
        coefficients[:, 0, used:, 0] = start[:, used:]
        if moving_coefficients.shape[3] > 1:
            for i in range(used, number):
                coefficients[:, 0, i, 1 + i] = 1.0
        return coefficients

    def _proposed(self, centre: Box) -> float:
        """Return the step after which the last two terms are as small as the tolerance; whichever is shorter."""
        sizes, used = boxes.magnitude(centre[..., 0]), self.problem.used
        scale = np.maximum(self._largest, boxes.width(self.box))[:used]
        steps = [inf]
        for k in (self.order - 1, self.order):
            ratio = float((sizes[k, :used] / np.where(scale > NOTHING, scale, inf)).max(initial=0.0))
            if ratio > 0.0:
                steps.append(_nth_root(self.tolerance / ratio, k))
        step = SAFETY * min(steps)
        return step if step < inf else float(max(1.0, 2.0 * abs(self.time[1])))

    def _enclose_step(self, around: Box, span: Box) -> tuple[Box, Box, Box] | None:
        """Return a box that no motion leaves in a step, its remainder coefficients, and the reached set."""
        full_span = np.array([0.0, span[1]])
        reached, end = self._polynomials.values_at(full_span, around), self._polynomials.values_at(span, around)
        # the sum is rounded to nearest: the next float is a bound of it
        time = np.array([self.time[0], np.nextafter(self.time[1] + span[1], inf)])
        used = self.problem.used
        beyond = boxes.multiply(around[:, -1], boxes.interval_power(span, self.order)[:, None])
        grown = boxes.magnitude(beyond)
        for trial in range(TRIALS):
            slack = boxes.width(reached) * (WIDER * 4.0**trial) + grown * 2.0**trial
            # strict inclusion needs slack even of a set that is a point at rest
            slack = (
                slack + (boxes.magnitude(reached) + self._largest * self.tolerance) * (8.0 * boxes.EPS) + LEAST_SLACK
            )
            slack[used:] = 0.0
            candidate = np.stack([reached[0] - slack, reached[1] + slack])
            try:
                coefficients = self._plain.coefficients_of(time, candidate, self.step_values)
            except UndefinedError as error:
                self.reason = str(error)
                return None
            remainder = self._with_constants(coefficients, candidate)[:, -1, :, 0]
            remainder_term = boxes.multiply(remainder, boxes.interval_power(full_span, self.order + 1)[:, None])
            reached_box = boxes.add(reached, remainder_term)[:, :used]
            if (reached_box[0] > candidate[0, :used]).all() and (reached_box[1] < candidate[1, :used]).all():
                enclosure = candidate.copy()
                enclosure[:, :used] = reached_box
                return (
                    enclosure,
                    remainder,
                    boxes.add(end, boxes.multiply(remainder, boxes.interval_power(span, self.order + 1)[:, None])),
                )
            grown = np.maximum(grown, 2.0 * boxes.magnitude(remainder_term))
        self.reason = "no box was found that the motions do not leave within a step, however short: the set is too wide"
        return None

    def _allowed(self, remainder: Box, span: float, enclosure: Box) -> float:
        """Return by how much a step has to be shorter for its remainder to be small beside tolerance and set."""
        used = self.problem.used
        added = boxes.width(remainder)[:used] * float(boxes.interval_power(boxes.point_box(span), self.order + 1)[1])
        largest = np.maximum(self._largest, boxes.magnitude(enclosure))[:used]
        allowed = 10.0 * self.tolerance * largest + SHARE * boxes.width(self.box)[:used]
        moving = added > 0.0
        smallest_ratio = float((np.maximum(allowed, NOTHING)[moving] / added[moving]).min(initial=inf))
        return 1.0 if smallest_ratio >= 1.0 else SAFETY * _nth_root(smallest_ratio, self.order + 1)


def _nth_root(x: float, n: int) -> float:
    """Return the n-th root of a positive number by Newton's method from above, with equal bits on every machine."""
    # 0 counts as the least positive float: towards a root of 0 Newton's method has linear convergence alone
    mantissa, exponent = frexp(max(x, 5e-324))
    quotient, left = divmod(exponent, n)
    radicand = ldexp(mantissa, left)
    # never below the root, by Bernoulli's inequality; from there Newton's method falls until rounding stops it
    root = min(2.0, 1.0 + (radicand - 1.0) / n) if radicand >= 1.0 else 1.0
    while True:
        lower = root - (root - radicand / _integer_power(root, n - 1)) / n
        if not lower < root:
            return ldexp(root, quotient)
        root = lower


def _integer_power(x: float, n: int) -> float:
    power_value = 1.0
    for _ in range(n):
        power_value *= x
    return power_value
