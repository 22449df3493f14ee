"""One trial: the method's step, with step doubling or the solution of its equations where it asks for them."""

from __future__ import annotations

from math import nan
from typing import Any

from numpy import int64
from numpy.typing import NDArray

from xdynamics.kernels.compiling import apart, compiled, shared
from xdynamics.kernels.law import DETECT, PROPOSE, RADAU
from xdynamics.kernels.linear import solve_linear
from xdynamics.kernels.program import T1, UNSOUND, H, T
from xdynamics.kernels.stepping import DIRECT
from xdynamics.march.evaluating import evaluate, finite_state, keep_sample
from xdynamics.march.handle import called, stepped_by
from xdynamics.march.run import Run

MOST_ITERATIONS = 25
NEWTON_TOLERANCE = 1e-10  # of a correction against the size of its unknown; what is left is of the order of its square

State = NDArray[Any]
_FIRST = int64(0)  # no literal: of a function that is given one, numba makes a copy


@compiled
def propose(run: Run, t1: float, h: float) -> None:
    """Make one step from the state where the march stands, which stays as it is; look what the events are there."""
    trial = run.trial[0]
    trial.t, trial.h, trial.iterations = t1, h, 0
    if run.plan[0].halved:
        double(run, t1, h)
    else:
        advance(run, run.now[0].t, t1, h, run.y, run.z, _FIRST)
    trial.unsound, trial.unsound_events = run.at[UNSOUND], 0.0
    if run.detectors.shape[0] > 0:
        run.at[T] = t1
        called(run.law[DETECT], run, run.z, run.g1, 0)
        trial.unsound_events = run.at[UNSOUND]


@compiled
def advance(run: Run, t: float, t1: float, h: float, y: State, z: State, sample: int) -> None:
    """Make one step by the lines of the method, its force evaluations kept from place `sample` on."""
    run.at[T], run.at[T1], run.at[H] = t, t1, h
    if run.plan[0].simplified:
        stepped_by(run.law[RADAU], run, t, t1, h, y, z, sample)
        return
    called(run.law[PROPOSE], run, y, z, sample)
    run.now[0].evaluations += run.plan[0].stages
    if run.equations.shape[0] > 0:
        solve(run, y, z, sample)


@shared
def solve(run: Run, y: State, z: State, sample: int) -> None:
    """Solve the equations of a step one after the other, and do what stands behind each."""
    for k in range(run.equations.shape[0]):
        turns = newton(run, k, y, z, sample)
        trial = run.trial[0]
        trial.iterations = trial.iterations + turns if turns >= 0 and trial.iterations >= 0 else -1
        called(run.law[PROPOSE + 2 * k + 2], run, y, z, sample)


@shared
def newton(run: Run, k: int, y: State, z: State, sample: int) -> int:
    """Solve by Newton's method with the exact Jacobian at every iteration; return the iterations, -1 if in vain."""
    one, w = run.equations[k], run.w
    n, right = one.unknowns, run.right
    turns, solved = 0, n == 0
    while turns < MOST_ITERATIONS and not solved:
        turns += 1
        called(run.law[PROPOSE + 2 * k + 1], run, y, z, sample)
        assemble(run, k)
        run.now[0].jacobians += 1
        run.now[0].factorisations += 1
        for i in range(n):
            right[i] = w[one.residuals + i]
        if not solve_linear(run.matrix, right, n):
            break
        solved = True
        for i in range(n):
            row = one.first_unknown + i
            unknown, before, rate = run.unknowns[row, 0], run.unknowns[row, 1], run.unknowns[row, 2]
            w[unknown] -= right[i]
            if right[i] != 0.0:
                size = abs(w[unknown]) + abs(y[before]) + abs(run.at[H] * y[rate])
                solved = solved and abs(right[i]) / size <= NEWTON_TOLERANCE
    run.now[0].evaluations += max(0, turns - 1) * one.evaluations
    return turns if solved else -1


@shared
def assemble(run: Run, k: int) -> None:
    """Put the matrix together: the unit matrix less what the equations have by themselves and through the forces."""
    one, w = run.equations[k], run.w
    n, matrix = one.unknowns, run.matrix
    for i in range(n * n):
        matrix[i] = 0.0
    for i in range(n):
        matrix[i * n + i] = 1.0
    for i in range(one.first_entry, one.first_entry + one.entries):
        row, column, place, slope = run.entries[i, 0], run.entries[i, 1], run.entries[i, 2], run.entries[i, 3]
        # an entry left out has no such term at all: a derivative that is not a number must not reach the others
        matrix[row * n + column] -= w[place] if slope == DIRECT else w[place] * w[slope]


advance_apart = apart(advance)


@shared
def double(run: Run, t1: float, h: float) -> None:
    """Make two half steps, and a whole one to judge them by: their difference over 2**p - 1 is the error of the two."""
    plan, t = run.plan[0], run.now[0].t
    width = plan.stages * (run.log_samples.shape[0] - 2)
    middle = t + h / 2.0
    advance_apart(run, t, t1, h, run.y, run.whole, _FIRST)
    advance_apart(run, t, middle, h / 2.0, run.y, run.half, width)
    run.kept[0].fresh = 0  # derivatives are those of the first half
    advance_apart(run, middle, t1, h / 2.0, run.half, run.z, 2 * width)
    run.kept[0].fresh = 0
    for i in range(plan.used):
        run.e[i] = (run.z[i] - run.whole[i]) / plan.divisor
    if plan.extrapolated:
        for i in range(plan.used):
            run.z[i] = run.z[i] + run.e[i]
        evaluate(run, t1, run.z)
        run.at[UNSOUND] = 0.0 if finite_state(run) else nan
        keep_sample(run, t1, run.z, 3 * width)

