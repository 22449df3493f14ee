"""Sizes of variables and the fastest time scale of the motion, without units, as measures for tolerances that follow.

A size is the largest absolute value so far. What starts at rest or at zero has none yet: its size is what the forces
about the start make of it in the fastest time scale, and never less than a small part of the largest of its kind.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.formulas import function_of
from xdynamics.kernels.step_control import TOLERANCE
from xdynamics.march.force_evaluation import evaluate, slope_of
from xdynamics.march.run import Run

ATOL_RULE = (
    "atol not given: rtol (solver_rtol_used) times the size of the variable, its largest absolute value so far; never"
    " less than 1e-6 rtol, or 10 spacings, of the largest of its kind (coordinates, velocities, states of one"
    " dimension), nor of what the forces about the start make of it in 1/omega, omega the fastest rate there, longer"
    " than which the first step is not; of what moves when nothing of its kind has moved yet, of its rate in a"
    " hundredth of the time to the first node or the end"
)

_tolerance = function_of(TOLERANCE, "rtol size floor top", "atol")

State = NDArray[Any]
Floats = NDArray[Any]

FLOOR = 1e-6  # of the largest of its kind: the least size
ROUNDED = 10.0  # spacings of that, which may be due to rounding alone
PRODUCTS = 6  # of the Jacobian and a vector
DIFFERENCE = 2.0**-10  # of the sizes: rounding leaves twelve digits, and a scale needs three
LITTLE = 1e-3  # of its kind: the least component of a direction
BEGINNING = 1e-2  # of the time to the first node or the end, where there is no other time scale
GOLDEN = 0.6180339887498949  # multiples of it, less whole numbers, are spread evenly
PARALLEL = 1e-6  # square of the angle below which vectors count as parallel


@shared
def tops_of(run: Run, state: State) -> None:
    """Find the largest absolute value of each kind in a state."""
    for k in range(run.tops.shape[0]):
        run.tops[k] = 0.0
    for i in range(run.plan[0].used):
        run.tops[run.kinds[i]] = max(run.tops[run.kinds[i]], abs(state[i]))


@shared
def settle_tolerances(run: Run) -> None:
    """Set tolerances that follow to `rtol` times the sizes so far, at least `floor` times the largest of their kind."""
    tops_of(run, run.largest)
    for i in range(run.plan[0].used):
        if run.followers[i]:
            run.atol[i] = _tolerance(run.plan[0].rtol, run.largest[i], run.plan[0].floor, run.tops[run.kinds[i]])


@shared
def begin_sizes(run: Run) -> float:
    """Give sizes to variables that start at rest or at zero, and return the longest first step.

    Until it is chosen, tolerances are those of the full natural sizes.
    """
    plan, used, turning = run.plan[0], run.plan[0].used, run.turning
    time = natural_sizes(run, run.y)
    rate = fastest_rate(run, run.now[0].t, run.y)
    if rate > 0.0:
        time = min(1.0 / rate, plan.rest / BEGINNING)
    for i in range(used):
        if run.followers[i]:
            natural = time * max(turning[used + i], abs(slope_of(run, run.y, i)))
            if i < plan.coordinates:
                second = plan.coordinates + i
                natural = max(natural, time * time * max(turning[used + second], abs(slope_of(run, run.y, second))))
            run.largest[i] = max(run.largest[i], plan.floor / plan.rtol * natural)
            run.atol[i] = plan.rtol * max(run.largest[i], natural)
    return time if rate > 0.0 else math.inf


@shared
def natural_sizes(run: Run, y: State) -> float:
    """Fill `turning` with the size of each variable, now or after a time scale of the motion; return that time."""
    n, used, turning = run.plan[0].coordinates, run.plan[0].used, run.turning
    time = time_at(run, y)
    for i in range(used):
        slope, second = abs(slope_of(run, y, i)), abs(slope_of(run, y, n + i)) if i < n else 0.0
        turning[i] = max(abs(y[i]), slope * time, second * time * time)
    for i in range(n):  # a body at rest in equilibrium needs a direction, too
        turning[i] = max(turning[i], LITTLE * turning[n + i] * time)
        turning[n + i] = max(turning[n + i], LITTLE * turning[i] / time)
    tops_of(run, turning)
    for i in range(used):
        turning[i] = max(turning[i], LITTLE * run.tops[run.kinds[i]])
        if turning[used + i] != 0.0:
            turning[used + i] = 0.0
    return time


@shared
def time_at(run: Run, y: State) -> float:
    """Return a time scale from the sizes of state and slopes alone: that of the fastest kind."""
    plan, n, tops = run.plan[0], run.plan[0].coordinates, run.tops
    kinds, span, shortest = run.tops.shape[0] // 2, plan.rest / BEGINNING, 0.0
    tops_of(run, y)
    for i in range(plan.used):
        tops[kinds + run.kinds[i]] = max(tops[kinds + run.kinds[i]], abs(slope_of(run, y, i)))
    for i in range(plan.used):
        size, slope, time = tops[run.kinds[i]], tops[kinds + run.kinds[i]], 0.0
        if slope > 0.0:
            time = size / slope
        if i < n:
            second = tops[kinds + run.kinds[n + i]]
            if second > 0.0:
                time = max(time, math.sqrt(size / second)) if size > 0.0 else slope / second
        if 0.0 < time < math.inf and (shortest == 0.0 or time < shortest):
            shortest = time
    return min(shortest, span) if shortest > 0.0 else plan.rest


@shared
def fastest_rate(run: Run, t: float, y: State) -> float:
    """Estimate the size of the fastest eigenvalue of the motion about a state, the sizes of which are in `turning`.

    A few products of the Jacobian and a vector, by differences of the forces: the last three vectors are fitted by
    a recurrence whose roots are the eigenvalues (Krylov; Saad, Numerical Methods for Large Eigenvalue Problems,
    chapter 6). Exact for one oscillator or two decays; for many modes an estimate, mostly from below. 0 where it is not
    known.
    """
    used, turning, rate, before = run.plan[0].used, run.turning, 0.0, 2 * run.plan[0].used
    now, n = 3 * used, run.plan[0].coordinates
    for i in range(used):
        part = (i % n if n > 0 and i < 2 * n else i) * GOLDEN + (0.5 if n <= i < 2 * n else 0.0)
        part = 2.0 * (part - math.floor(part)) - 1.0
        turning[now + i] = turning[i] * (part + (1.0 if part >= 0.0 else -1.0)) / 2.0
    for k in range(PRODUCTS):
        amount = 0.0
        for i in range(used):
            if turning[i] > 0.0:
                amount = max(amount, abs(turning[now + i]) / turning[i])
        if not 0.0 < amount < math.inf:
            return 0.0  # a power of the Jacobian is zero: nothing turns or decays
        for i in range(used):
            turning[now + i] /= amount
            run.probe[i] = y[i] + DIFFERENCE * turning[now + i]
        evaluate(run, t, run.probe)
        estimate = recurred(run, y, amount, k)
        if not estimate < math.inf:
            return 0.0
        rate = estimate
        for i in range(used):
            product = (slope_of(run, run.probe, i) - slope_of(run, y, i)) / DIFFERENCE
            turning[before + i], turning[now + i] = turning[now + i], product
            if k == 0 and run.plan[0].follows:  # who reads it
                turning[used + i] = abs(product)
    return rate


@shared
def recurred(run: Run, y: State, amount: float, k: int) -> float:
    """Return the larger root of the recurrence c + p b + q a = 0 that fits three vectors best, each over the sizes."""
    used, turning = run.plan[0].used, run.turning
    aa = ab = ac = bb = bc = 0.0
    for i in range(used):
        if turning[i] > 0.0:
            a = turning[2 * used + i] / turning[i] if k > 0 else 0.0
            b = turning[3 * used + i] / turning[i]
            c = (slope_of(run, run.probe, i) - slope_of(run, y, i)) / DIFFERENCE / turning[i]
            aa, ab, ac, bb, bc = aa + a * a, ab + a * b, ac + a * c, bb + b * b, bc + b * c
    determinant = aa * bb - ab * ab
    if not determinant > PARALLEL * aa * bb:
        return abs(bc) / bb
    half, product = (ac * ab - bc * aa) / determinant / 2.0, (bc * ab - ac * bb) / determinant * amount
    square = half * half - product
    return math.sqrt(product) if square < 0.0 else abs(half) + math.sqrt(square)


@shared
def derivatives(run: Run, t: float, y: State, found: Floats) -> None:
    """Fill `found`, after its first row, with the derivatives of slopes by the state, scaled by sizes, by columns."""
    used, turning = run.plan[0].used, run.turning
    for column in range(used):
        for i in range(used):
            run.probe[i] = y[i]
        run.probe[column] = y[column] + DIFFERENCE * turning[column]
        change = run.probe[column] - y[column]
        evaluate(run, t, run.probe)
        for i in range(used):
            slope = slope_of(run, run.probe, i) - slope_of(run, y, i)
            found[1 + i, column] = (
                slope / change * (turning[column] / turning[i]) if change != 0.0 and turning[i] > 0.0 else 0.0
            )
