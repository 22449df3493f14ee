"""Radau IIA of order 5 in transformed variables: T**-1 A**-1 T = [[gamma, 0, 0], [0, alpha, -beta], [0, beta, alpha]].

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8, eq. (8.5) to (8.8); digits as in the authors' program RADAU5.
A is the matrix of Table 5.6; each row of T belongs to a stage, its columns to the real and the complex system.
"""

# (4 -+ sqrt(6))/10; the third stage is the end of the step
NODES = (0.15505102572168219, 0.64494897427831781, 1.0)

GAMMA = 3.6378342527444957
ALPHA = 2.6810828736277521
BETA = 3.0504301992474106

T = (
    (0.091232394870892943, -0.14125529502095421, -0.030029194105147424),
    (0.24171793270710702, 0.20412935229379993, 0.38294211275726194),
    (0.96604818261509294, 1.0, 0.0),
)
T_INVERSE = (
    (4.3255798900631554, 0.33919925181580987, 0.54177053993587487),
    (-4.1787185915519047, -0.32768282076106239, 0.47662355450055045),
    (-0.50287263494578688, 2.5719269498556054, -0.59603920482822492),
)

# of the stages' increments in the estimate: (-13 - 7 sqrt(6))/3, (-13 + 7 sqrt(6))/3, -1/3; eq. (8.19) over gamma_0
ERROR = (-10.048809399827416, 1.3821427331607488, -0.33333333333333333)

# of the Newton iterations and the step-size control, as in RADAU5
MOST_TURNS = 7  # Newton iterations, after which the step is shortened
SLOW = 1e-3  # theta from which on derivatives are evaluated again
FEW_TURNS = 2  # iterations that are no reason to do so
DIVERGING = 0.99
SAME_STEP = 1e-6  # relative difference of step sizes up to which factors are reused
SHARE = 0.03  # of the error allowed, for Newton's method
STALLED = 0.5  # ratio of a correction to the one before from which only rounding is left
LEAST_NORM = 1e-2  # lower bound of the error norm kept for the next step
SMALLEST = 1e-10  # smallest norm distinguished from zero
HELD = 1.2  # growth up to which the step is kept, to reuse the factors
