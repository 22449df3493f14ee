"""Sine, logarithm, power and the others, from arithmetic that is the same on every machine."""

from xdynamics.elementary.functions import FUNCTIONS, NAME, PAIRS, TOGETHER

__all__ = ["FUNCTIONS", "NAME", "PAIRS", "TOGETHER"]
