"""Elementary functions (sine, logarithm, power and others) from arithmetic that is the same on every machine."""

from xdynamics.elementary.sets import FUNCTIONS, NAME, PAIRS, SETS, TOGETHER, kept_set

__all__ = ["FUNCTIONS", "NAME", "PAIRS", "SETS", "TOGETHER", "kept_set"]
