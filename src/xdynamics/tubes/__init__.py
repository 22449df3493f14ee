"""Tubes: sets of motions that are proven to lie between bounds, by interval arithmetic rounded outward.

Only + - * / and square roots, as IEEE 754 rounds them, and the next float up or down: the same bounds on every machine.
"""

from xdynamics.tubes.flow import Flow, Proof
from xdynamics.tubes.interval_problem import IntervalProblem, interval_problem_of

__all__ = ["Flow", "IntervalProblem", "Proof", "interval_problem_of"]
