"""Sizes of variables and the fastest time scale of the motion, as measures for tolerances that follow them.

Both need no units. A size is the largest absolute value so far. What starts at rest or at zero has none yet: its size
is what the forces about the start make of it in the fastest time scale, and never less than a small part of the largest
of its kind.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.formulas import TOLERANCE, compiled_function_of
from xdynamics.march.force_evaluation import evaluate_forces, state_slope
from xdynamics.march.run import Run

ATOL_RULE = (
    "atol not given: rtol (solver_rtol_used) times the size of the variable, its largest absolute value so far; never"
    " less than 1e-6 rtol, or 10 spacings, of the largest of its kind (coordinates, velocities, states of one"
    " dimension), nor of what the forces about the start make of it in 1/omega, omega the fastest rate there, longer"
    " than which the first step is not; of what moves when nothing of its kind has moved yet, of its rate in a"
    " hundredth of the time to the first node or the end"
)

_tolerance = compiled_function_of(TOLERANCE, "rtol size floor top", "atol")

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


@jit_separate
def tops_of(run: Run, state: State) -> None:
    """Find the largest absolute value of each kind in a state."""
    for k in range(run.tops.shape[0]):
        run.tops[k] = 0.0
    for i in range(run.plan[0].used):
        run.tops[run.kinds[i]] = max(run.tops[run.kinds[i]], abs(state[i]))


@jit_separate
def settle_tolerances(run: Run) -> None:
    """Set tolerances that follow to `rtol` times the sizes so far, at least `floor` times the largest of their kind."""
    tops_of(run, run.largest)
    for i in range(run.plan[0].used):
        if run.adaptive_atol[i]:
            run.atol[i] = _tolerance(run.plan[0].rtol, run.largest[i], run.plan[0].floor, run.tops[run.kinds[i]])


@jit_separate
def begin_sizes(run: Run) -> float:
    """Give sizes to variables that start at rest or at zero, and return the longest first step.

    Until it is chosen, tolerances are those of the full natural sizes.
    """
    plan, used, turning = run.plan[0], run.plan[0].used, run.turning
    time = natural_sizes(run, run.y)
    rate = estimate_fastest_rate(run, run.now[0].t, run.y)
    if rate > 0.0:
        time = min(1.0 / rate, plan.rest / BEGINNING)
    for i in range(used):
        if run.adaptive_atol[i]:
            natural = time * max(turning[i], abs(state_slope(run, run.y, i)))
            if i < plan.coordinates:
                second = plan.coordinates + i
                natural = max(natural, time * time * max(turning[second], abs(state_slope(run, run.y, second))))
            run.largest[i] = max(run.largest[i], plan.floor / plan.rtol * natural)
            run.atol[i] = plan.rtol * max(run.largest[i], natural)
    return time if rate > 0.0 else math.inf


@jit_separate
def natural_sizes(run: Run, y: State) -> float:
    """Prepare `variable_size`: sizes of variables now, or after a time scale of the motion; return that time.

    Of a million variables sizes are not kept: they would take as much memory as the state.
    """
    used, turning, kinds = run.plan[0].used, run.turning, run.tops.shape[0] // 2
    time = time_at(run, y)
    run.tops[2 * kinds] = time
    for k in range(2 * kinds):
        run.tops[k] = 0.0
    for i in range(used):
        run.tops[kinds + run.kinds[i]] = max(run.tops[kinds + run.kinds[i]], abs(variable_size(run, y, i)))
        # no zero is written over a zero: memory that was never written is not taken from the system
        if turning[i] != 0.0:
            turning[i] = 0.0
    for k in range(kinds):
        run.tops[k] = run.tops[kinds + k]
    return time


@jit_inline
def variable_size(run: Run, y: State, i: int) -> float:
    """Return the size of a variable in the time of `natural_sizes`, and no less than a little of the largest of its kind."""
    n, time = run.plan[0].coordinates, run.tops[run.tops.shape[0] - 1]
    size = own_size(run, y, i, time)
    if i < n:  # a body at rest in equilibrium needs a direction, too
        size = max(size, LITTLE * own_size(run, y, n + i, time) * time)
    elif i < 2 * n:
        size = max(size, LITTLE * max(own_size(run, y, i - n, time), LITTLE * size * time) / time)
    return max(size, LITTLE * run.tops[run.kinds[i]])


@jit_inline
def own_size(run: Run, y: State, i: int, time: float) -> float:
    """Return the size of a variable by itself: its value, or the change by its slopes in a time."""
    n = run.plan[0].coordinates
    slope, second = abs(state_slope(run, y, i)), abs(state_slope(run, y, n + i)) if i < n else 0.0
    return max(abs(y[i]), slope * time, second * time * time)


@jit_separate
def time_at(run: Run, y: State) -> float:
    """Return a time scale from the sizes of state and slopes alone: that of the fastest kind."""
    plan, n, tops = run.plan[0], run.plan[0].coordinates, run.tops
    kinds, span, shortest = run.tops.shape[0] // 2, plan.rest / BEGINNING, 0.0
    tops_of(run, y)
    for i in range(plan.used):
        tops[kinds + run.kinds[i]] = max(tops[kinds + run.kinds[i]], abs(state_slope(run, y, i)))
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


@jit_separate
def estimate_fastest_rate(run: Run, t: float, y: State) -> float:
    """Estimate the size of the fastest eigenvalue of the motion about a state, of which `natural_sizes` knows the sizes.

    A few products of the Jacobian and a vector, by differences of the forces: the last three vectors are fitted by
    a recurrence whose roots are the eigenvalues (Krylov; Saad, Numerical Methods for Large Eigenvalue Problems,
    chapter 6). Exact for one oscillator or two decays; for many modes an estimate, mostly from below. 0 where it is not
    known.
    """
    used, turning, rate, n = run.plan[0].used, run.turning, 0.0, run.plan[0].coordinates
    first_before, first_now = used, 2 * used - n
    for i in range(n, used):
        turning[first_now + i] = first_direction(run, y, i)
    for k in range(PRODUCTS):
        amount = 0.0
        for i in range(used):
            size = variable_size(run, y, i)
            if size > 0.0:
                amount = max(amount, abs(direction_after(run, y, i, k)) / size)
        if not 0.0 < amount < math.inf:
            return 0.0  # a power of the Jacobian is zero: nothing turns or decays
        for i in range(used):
            direction = direction_after(run, y, i, k) / amount
            if i >= n:
                turning[first_now + i] = direction
            run.probe[i] = y[i] + DIFFERENCE * direction
        evaluate_forces(run, t, run.probe)
        estimate = recurrence_root(run, y, amount, k)
        if not estimate < math.inf:
            return 0.0
        rate = estimate
        for i in range(used):
            product = (state_slope(run, run.probe, i) - state_slope(run, y, i)) / DIFFERENCE
            if k == 0 and run.plan[0].follows:  # who reads it
                turning[i] = abs(product)
            if i < n:
                turning[first_before + i] = direction_after(run, y, i, k) / amount
            else:
                turning[first_before + i], turning[first_now + i] = turning[first_now + i], product
    return rate


@jit_inline
def first_direction(run: Run, y: State, i: int) -> float:
    """Return the first direction along a variable."""
    n = run.plan[0].coordinates
    part = (i % n if n > 0 and i < 2 * n else i) * GOLDEN + (0.5 if n <= i < 2 * n else 0.0)
    part = 2.0 * (part - math.floor(part)) - 1.0
    return variable_size(run, y, i) * (part + (1.0 if part >= 0.0 else -1.0)) / 2.0


@jit_inline
def direction_after(run: Run, y: State, i: int, k: int) -> float:
    """Return the direction that the products so far led to; along coordinates it follows from velocities before."""
    n, used = run.plan[0].coordinates, run.plan[0].used
    if i >= n:
        return run.turning[2 * used - n + i]
    if k == 0:
        return first_direction(run, y, i)
    # not `turning` itself, but as the difference of slopes at `probe` rounds it
    return (y[n + i] + DIFFERENCE * run.turning[used + n + i] - y[n + i]) / DIFFERENCE


@jit_separate
def recurrence_root(run: Run, y: State, amount: float, k: int) -> float:
    """Return the larger root of the recurrence c + p b + q a = 0 that fits three vectors best, each over the sizes."""
    used, turning, n = run.plan[0].used, run.turning, run.plan[0].coordinates
    aa = ab = ac = bb = bc = 0.0
    for i in range(used):
        size = variable_size(run, y, i)
        if size > 0.0:
            a = turning[used + i] / size if k > 0 else 0.0
            b = (turning[2 * used - n + i] if i >= n else direction_after(run, y, i, k) / amount) / size
            c = (state_slope(run, run.probe, i) - state_slope(run, y, i)) / DIFFERENCE / size
            aa, ab, ac, bb, bc = aa + a * a, ab + a * b, ac + a * c, bb + b * b, bc + b * c
    determinant = aa * bb - ab * ab
    if not determinant > PARALLEL * aa * bb:
        return abs(bc) / bb
    half, product = (ac * ab - bc * aa) / determinant / 2.0, (bc * ab - ac * bb) / determinant * amount
    square = half * half - product
    return math.sqrt(product) if square < 0.0 else abs(half) + math.sqrt(square)


@jit_separate
def fill_derivatives(run: Run, t: float, y: State, derivative_rows: Floats) -> None:
    """Fill `derivative_rows`, after its first row, with the derivatives of slopes by the state, scaled by sizes, by columns."""
    used = run.plan[0].used
    for column in range(used):
        for i in range(used):
            run.probe[i] = y[i]
        width = variable_size(run, y, column)
        run.probe[column] = y[column] + DIFFERENCE * width
        # the shift as it was rounded
        change = run.probe[column] - y[column]
        evaluate_forces(run, t, run.probe)
        for i in range(used):
            slope = state_slope(run, run.probe, i) - state_slope(run, y, i)
            size = variable_size(run, y, i)
            derivative_rows[1 + i, column] = slope / change * (width / size) if change != 0.0 and size > 0.0 else 0.0
