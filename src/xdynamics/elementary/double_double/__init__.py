"""Numbers with 31 digits: unevaluated sums of two floats, their arithmetic and elementary functions."""

from xdynamics.elementary.double_double.functions import FUNCTIONS
from xdynamics.elementary.double_double.sums import DoubleDouble, nearest

__all__ = ["FUNCTIONS", "DoubleDouble", "nearest"]
