"""The simplified Newton iterations of Radau IIA as lines of text, for one run and for runs in lanes.

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8. `march.implicit.radau` uses them as functions of numbers,
`kernels.collocation` in all lanes at once.
"""

from __future__ import annotations

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.methods import radau

C1, C2, _ = radau.NODES
CONSTANTS = {
    "few_turns": float(radau.FEW_TURNS),
    "slow": radau.SLOW,
    "least_norm": radau.LEAST_NORM,
    "eps": EPS,
    "same_step": radau.SAME_STEP,
    "diverging": radau.DIVERGING,
    "stalled": radau.STALLED,
    "most_turns": float(radau.MOST_TURNS),
    "c12": C1 - C2,
    "c21": C2 - 1.0,
    "c11": C1 - 1.0,
    "c1": C1,
    "c2": C2,
}

# Differences of a component of the collocation polynomial, from the end of the step backwards; its continuation to the
# stage at c of the next step, `relative` times as long, or rest where that is 0
RADAU_POLYNOMIAL = """
middle = (z0 - z1)/c12
first = (z1 - z2)/c21
second = (middle - first)/c11
third = second - (middle - z0/c1)/c2
"""
GUESS = """
s = c*relative
guess = where(relative > 0, s*(first + (s - c21)*(second + (s - c11)*third)), 0)
"""
# The convergence of an iteration, by its last two corrections and the two before
CONVERGENCE = """
ratio_now = size/change
theta_now = where(turn_now < 2.5, ratio_now, sqrt(ratio_now*ratio))
eta_now = theta_now/(1 - theta_now)
"""
