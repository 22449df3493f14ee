"""Numbers by which bounds are wider than what was computed, in a run alone and in lanes: rounding, and what lies between.

Rounding is that of IEEE 754's double precision.
"""

from __future__ import annotations

EPS, LEAST, MOST = 2.220446049250313e-16, 5e-324, 1.7976931348623157e308
ULPS = 4.0 * EPS  # of an elementary function
ROUNDED = 4.0 * EPS  # of a state, relative
# how far a rate is from the straight line, by what odd and even say of it, if it is half a wave (pi/2, 1/9.5) or less of one
ARCHED, BENT = 1.571, 0.1053
SMOOTH, BREAKS, UNBOUNDED = 0, 1, 2  # whether a value may jump there, or be infinite or none at all
