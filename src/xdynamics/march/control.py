"""Step control: the error test, the next step, the first step."""

from __future__ import annotations

import math

import numpy as np

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.lane_step import LEAST_LOGARITHM
from xdynamics.kernels.law import EXP, FORCES, LOG
from xdynamics.kernels.program import T
from xdynamics.march.force_evaluation import slope_of
from xdynamics.march.handle import applied, called
from xdynamics.march.log import note_sample
from xdynamics.march.run import Run
from xdynamics.march.tolerance_sizes import tops_of

SPACINGS = 10.0  # of t in the shortest step, as in scipy
NONFINITE_FACTOR = 0.25
CONTROLLER = (
    "PI: safety*norm**-alpha*norm_before**beta, beta = 0.2/k, alpha = 1/k - 0.75*beta, k = order of the estimate + 1"
    " (Hairer, Norsett, Wanner II.4 and IV.2; Gustafsson 1991, doi:10.1145/210232.210242)"
)
PREDICTIVE = (
    "predictive: safety*min(norm**(-1/4)*15/(i + 14), h/h_before*(norm_before/norm**2)**(1/4)), i = Newton iterations;"
    " a growth of up to 1.2 is left out after at most 2 of them or where they converge by theta < 0.001, for the sake"
    " of what is kept (Hairer, Wanner, Solving ODEs II, IV.8; Gustafsson 1994, doi:10.1145/198429.198437)"
)
ERROR_NORM = "largest component of |error|/(atol + rtol*max(|value before|, |value after|))"
FIRST_STEP = (
    "Hairer, Norsett, Wanner I, section II.4, with the norm above, in units of T = max(size/slope,"
    " sqrt(size/curvature)): h0 = 0.01*size/slope, h = min(T, T*(0.01/max(slope*T, curvature*T**2))**(1/k)); size is 1"
    " at zero, h0 1e-6 of the time to the first node or the end where the slope is zero"
)


@compiled
def accepts(norm: float) -> bool:
    """Whether a trial passes the error test; nan does not."""
    return norm <= 1.0


@compiled
def larger(x: float, y: float) -> float:
    """Return the larger; nan if the first is, so that a norm once nan stays nan."""
    return x if x > y or x != x else y


@compiled
def error_norm(run: Run) -> float:
    """Return the largest ratio of the trial's errors to their scales: the tolerances allow 1."""
    rtol, norm, follows = run.plan[0].rtol, 0.0, run.plan[0].follows
    if follows:
        tops_of(run, run.z)
    for i in range(run.plan[0].used):
        if run.e[i] != 0.0:  # a component that stays zero has no error, whatever its scale
            atol = run.atol[i]
            if follows and run.followers[i]:  # variables that start from zero are measured by others of their kind
                reach = rtol * run.plan[0].rest
                at_rest = reach * abs(slope_of(run, run.z, i)) if atol == 0.0 else 0.0  # none of the kind has moved yet
                atol = max(atol, run.plan[0].floor * run.tops[run.kinds[i]], at_rest)
            scale = atol + rtol * larger(abs(run.y[i]), abs(run.z[i]))
            norm = larger(norm, abs(run.e[i]) / scale)
        else:
            norm = larger(norm, 0.0)
    return norm


@compiled
def shortest(run: Run) -> float:
    """Return the shortest step that may be tried where the march stands."""
    t = run.now[0].t
    return max(run.plan[0].min_step, SPACINGS * (np.nextafter(t, np.inf) - t))


@compiled
def grow(run: Run, h: float, cut: bool) -> None:
    """Choose the step after an accepted one: no growth right after a rejection, no loss from a cut step."""
    plan, now = run.plan[0], run.now[0]
    k, factor, logarithm = plan.order, plan.greatest, LEAST_LOGARITHM
    if plan.predictive:
        factor = min(plan.greatest, max(plan.least, run.kept[0].growth))
    elif now.norm > 0.0:
        beta, logarithm = 0.2 / k, applied(run.law[LOG], now.norm)
        factor = plan.safety * applied(run.law[EXP], (0.75 * beta - 1.0 / k) * logarithm + beta * now.step_log)
        factor = min(plan.greatest, max(plan.least, factor))
    if now.rejected:
        factor = min(factor, 1.0)
    step = h * factor
    if cut and not now.rejected:
        step = max(step, now.step)
    now.step = min(plan.max_step, max(plan.min_step, step))
    now.step_log = max(logarithm, LEAST_LOGARITHM)
    now.rejected = 0


@compiled
def reduce(run: Run, h: float, failed_test: bool) -> None:
    """Choose the step after a rejected trial of step h."""
    plan, now = run.plan[0], run.now[0]
    factor = NONFINITE_FACTOR
    if plan.predictive and (failed_test or run.trial[0].iterations < 0):
        factor = min(0.9, run.kept[0].growth)
    elif failed_test and math.isfinite(now.norm):
        shrink = plan.safety * applied(run.law[EXP], -applied(run.law[LOG], now.norm) / plan.order)
        factor = max(plan.least, min(0.9, shrink))
    now.step = max(h * factor, shortest(run))
    now.rejected = 1


@shared
def first_step(run: Run) -> float:
    """Choose the first step from the sizes of the state, its slope and its curvature, all over their tolerances.

    The rule of Hairer, Norsett, Wanner I, section II.4, takes the unit of time for the time scale of the problem; here
    it is a time scale of the problem itself, so that steps are the same in all units. The Euler probe is logged as a force
    sample after the initial one.
    """
    plan, t, y, probe = run.plan[0], run.now[0].t, run.y, run.half
    node = run.nodes[run.now[0].node] if run.now[0].node < run.nodes.shape[0] else plan.end
    span = node - t
    size, slope, change = 0.0, 0.0, 0.0
    for i in range(plan.used):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        if scale > 0.0:  # a tolerance that follows a size of 0 is 0 for now
            size = larger(size, abs(y[i]) / scale)
            slope = larger(slope, abs(slope_of(run, y, i)) / scale)
    if not size > 0.0:  # natural sizes where tolerances follow them
        size = 1.0 / plan.rtol if plan.follows else 1.0
    time = size / slope if slope > 0.0 else 1e-4 * span
    guess = min(0.01 * time, span, plan.max_step)
    for i in range(plan.used):
        probe[i] = y[i] + guess * slope_of(run, y, i)
    run.at[T] = t + guess
    called(run.law[FORCES], run, probe, probe, 0)
    run.now[0].evaluations += 1
    note_sample(run, t + guess, probe, 0)
    for i in range(plan.used):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        if scale > 0.0:
            change = larger(change, abs(slope_of(run, probe, i) - slope_of(run, y, i)) / scale)
    curvature = change / guess
    if curvature > 0.0:  # the slope of a body at rest says little
        time = max(time, math.sqrt(size / curvature))
    steepest = max(slope * time, curvature * time * time)
    step = guess
    if 0.0 < steepest < math.inf:
        step = min(time, time * applied(run.law[EXP], applied(run.law[LOG], 0.01 / steepest) / plan.order))
    return min(max(step, shortest(run)), plan.max_step)
