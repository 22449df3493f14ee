"""Numbers by which bounds are wider than what was computed, in a run alone and in lanes: rounding, and what lies between.

Rounding is that of IEEE 754's double precision.
"""

from __future__ import annotations

EPS, MOST = 2.0**-52, 1.7976931348623157e308
# What a bound is wider by, over eps and beside its size: of zero that is the least normal number, since smaller ones take
# many processors a hundred cycles. Version 0.2 took the least of all.
LEAST, LEAST_OF_0_2 = 2.0**-970, 2.0**-1022
ULPS = 4.0 * EPS  # of an elementary function
ROUNDED = 4.0 * EPS  # of a state, relative
# how far a rate is from the straight line, by what odd and even say of it, if it is half a wave (pi/2, 1/9.5) or less of one
ARCHED, BENT = 1.571, 0.1053
SMOOTH, BREAKS, UNBOUNDED = 0, 1, 2  # whether a value may jump there, or be infinite or none at all
