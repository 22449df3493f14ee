"""What an event does to a set of motions of which each passes it at a time of its own.

A motion that passes at a time t* of an interval T goes on by other equations from there, perhaps from another state. Up to
the end of T the equations before are proven to hold too. With h for what the event sets, x for the motion by the equations
before, f for its rates and g for those of the motion z after,

    z(end) = h(x(end)) + integral from t* to the end of (g(z) - h'(x) f(x)),

so that the set keeps its shape, and grows by the length of T times bounds of the integrand, over boxes that no motion leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.crossings import Crossing
from xdynamics.tubes.flow import LEAST_SLACK, Flow, Proof
from xdynamics.tubes.functions import Functions
from xdynamics.tubes.series import UndefinedError
from xdynamics.tubes.sets import AffineImage

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
    """A zero that every motion passes within a step, and what is done there.

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
        if ((reached[0] > candidate[0]) & (reached[1] < candidate[1]))[:moving].all():
            return Passage(tuple(names), crossing, proof, reached, step_values, reset, stops)
        slack = boxes.width(reached) * (WIDER * 2.0**trial) + boxes.magnitude(reached) * boxes.EPS + LEAST_SLACK
        slack[moving:] = 0.0
        candidate = np.stack([reached[0] - slack, reached[1] + slack])
    raise UndefinedError("no box was found that motions do not leave while others pass an event: the set is too wide")


def _lasting(crossing: Crossing) -> Box:
    """Return the times from a motion's own zero to the last of all, shape (2, 1)."""
    return np.array([[0.0], [np.nextafter(crossing.time[1] - crossing.time[0], np.inf)]])


def land_after_passage(flow: Flow, passed: Passage) -> None:
    """Let all motions go on behind an event, from when the last of them has passed.

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
