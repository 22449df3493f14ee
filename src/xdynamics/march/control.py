"""Step control: the error test, the next step, the first step. Plain Python that numba compiles with the loop."""

from __future__ import annotations

import math

import numpy as np

from xdynamics.kernels.elementary import power
from xdynamics.march.interface import State, begin, moved, sizes
from xdynamics.march.log import Control, Log, Memory, Pace, Plan

SPACINGS = 10.0  # of t that the shortest step has at least, like scipy's
NONFINITE_FACTOR = 0.25
STRETCH = 1.01  # of a step that would end just before a node
SMALLEST_NORM = 1e-4  # that the next step remembers
CONTROLLER = "PI: safety*norm**-alpha*norm_before**beta, beta = 0.2/k, alpha = 1/k - 0.75*beta, k = order of the estimate + 1 (Hairer, Norsett, Wanner II.4 and IV.2; Gustafsson 1991, doi:10.1145/210232.210242)"
ERROR_NORM = "largest component of |error|/(atol + rtol*max(|value before|, |value after|))"
FIRST_STEP = "Hairer, Norsett, Wanner I, section II.4, a)-f), with the norm above; 1e-6 of the span stands for its 1e-6"


def accepts(norm: float) -> bool:
    """Whether a trial passes the error test; one whose error is not a number does not."""
    return norm <= 1.0


def shortest(plan: Plan, t: float) -> float:
    """Return the shortest step that may be tried at t."""
    return max(plan.control.min_step, SPACINGS * (np.nextafter(t, np.inf) - t))


def grown(control: Control, pace: Pace, h: float, norm: float, cut: bool) -> Pace:
    """Return the pace after an accepted step: no growth right after a rejection, and none lost to a cut step."""
    k = control.order
    beta = 0.2 / k
    factor = control.greatest
    if norm > 0.0:
        factor = control.safety * power(norm, 0.75 * beta - 1.0 / k) * power(pace.norm, beta)
        factor = min(control.greatest, max(control.least, factor))
    if pace.rejected:
        factor = min(factor, 1.0)
    step = h * factor
    if cut and not pace.rejected:
        step = max(step, pace.step)
    step = min(control.max_step, max(control.min_step, step))
    return Pace(step, max(norm, SMALLEST_NORM), False, pace.first)


def reduced(plan: Plan, pace: Pace, t: float, h: float, norm: float, finite: bool) -> Pace:
    """Return the pace after a rejected trial of step h."""
    control = plan.control
    factor = NONFINITE_FACTOR
    if finite and math.isfinite(norm):
        factor = max(control.least, min(0.9, control.safety * power(norm, -1.0 / control.order)))
    return Pace(max(h * factor, shortest(plan, t)), pace.norm, True, pace.first)


def first_step(plan: Plan, memory: Memory, state: State, log: Log) -> float:
    """Choose the first step from the sizes of the state, its slope and its curvature.

    Hairer, Norsett, Wanner I, section II.4; the Euler probe is logged as a force sample behind the initial one.
    """
    control, t, pieces = plan.control, memory.t, memory.pieces
    span = plan.nodes[plan.nodes.shape[0] - 1] - t
    size, slope, _ = sizes(state, state, control.rtol, control.atol)
    guess = 1e-6 * span if size < 1e-5 or slope < 1e-5 else 0.01 * size / slope
    guess = min(guess, plan.nodes[memory.node] - t, control.max_step)
    probe, _at = begin(t + guess, moved(state, guess), plan.parameters, plan.tables, pieces, log, 1, 0)
    _, _, change = sizes(state, probe, control.rtol, control.atol)
    steepest = max(slope, change / guess)
    if not math.isfinite(steepest):
        step = guess
    elif steepest <= 1e-15:
        step = max(1e-6 * span, guess * 1e-3)
    else:
        step = power(0.01 / steepest, 1.0 / control.order)
    return min(max(min(100.0 * guess, step), shortest(plan, t)), control.max_step)
