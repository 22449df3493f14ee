"""Margins of bounds over computed values, in single runs and in lanes: for rounding, and for what lies between.

Rounding is that of IEEE 754's double precision.
"""

from __future__ import annotations

EPS, MOST = 2.0**-52, 1.7976931348623157e308
# Added to the size of a bound, whose product with eps widens it: a zero is widened by the least normal number, since
# smaller ones take many processors a hundred cycles. Version 0.2 took the least number of all.
LEAST, LEAST_OF_0_2 = 2.0**-970, 2.0**-1022
ULPS = 4.0 * EPS  # of an elementary function
ROUNDED = 4.0 * EPS  # of a state, relative
# distance of a rate from the straight line, in terms of odd and even, if it is half a wave (pi/2, 1/9.5) or less
ARCHED, BENT = 1.571, 0.1053
SMOOTH, BREAKS, UNBOUNDED = 0, 1, 2  # whether a value may jump there, or be infinite or undefined
