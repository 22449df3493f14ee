"""Attitudes: quaternions of unit length, to which they are brought back after every step.

A step by a method of order p followed by that projection is one of order p (Hairer, Lubich, Wanner, Geometric Numerical
Integration, 2nd ed., IV.4).
"""

from __future__ import annotations

from math import nan, sqrt

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.force_evaluation import evaluate_held, finite_state
from xdynamics.march.run import Run

PARTS = 4
ROUNDING = 4.0 * EPS  # of the square of a length that needs no projection


@jit_separate
def hold_attitudes(run: Run, t: float) -> None:
    """Bring the quaternions of the trial's state back to unit length, and evaluate the forces there.

    Numbers of two floats are left as the method has them: their lengths are off by its error alone.
    """
    trial, any_moved = run.trial[0], False
    trial.deviation = 0.0
    for k in range(run.attitudes.shape[0]):
        square = 0.0
        for i in range(PARTS):
            square += run.z[run.attitudes[k, i]] * run.z[run.attitudes[k, i]]
        trial.deviation = max(trial.deviation, abs(sqrt(square) - 1.0))
        if abs(square - 1.0) > ROUNDING and run.plan[0].doubled == 0:
            normalise_quaternion(run, k, sqrt(square))
            any_moved = True
    if any_moved:
        evaluate_held(run, t, run.z, trial.h)
        run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@jit_separate
def normalise_quaternion(run: Run, k: int, length: float) -> None:
    """Divide a quaternion by its length; rounding carried for the value before is not that of the new one."""
    first_compensation = run.plan[0].used + run.plan[0].evaluated
    for i in range(PARTS):
        part_index = run.attitudes[k, i]
        run.z[part_index] = run.z[part_index] / length
        if first_compensation < run.z.shape[0]:
            run.z[first_compensation + part_index] = 0.0
