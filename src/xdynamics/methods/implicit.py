"""Implicit methods: each step solves its equations by Newton's method.

Radau IIA of order 5 in transformed variables: T**-1 A**-1 T = [[gamma, 0, 0], [0, alpha, -beta], [0, beta, alpha]].

Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8, eq. (8.5) to (8.8); digits as in the authors' program RADAU5.
A is the matrix of Table 5.6; each row of T belongs to a stage, its columns to the real and the complex system.
"""

from __future__ import annotations

from xdynamics.methods.lines import Interpolant, spread_over_vectors
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import Collocation
from xdynamics.model import Trait

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


IMPLICIT_VELOCITY_VERLET = Method(
    name="implicit_velocity_verlet",
    synonyms=(
        "velocity Verlet with a solve for the new velocity",
        "Newmark beta = 0, gamma = 1/2, implicit in velocity",
    ),
    order=2,
    symplectic=False,
    symmetric=True,
    evaluations=2,
    update="""
        q1 = q + h*v + h**2/2*a
        v1 = v + h*a
        x1 = x + h*r
        solve v1, x1:
            a2, r2 = f(t1, q1, v1, x1)
            v1 = v + h/2*(a + a2)
            x1 = x + h/2*(r + r2)
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words=(
        "position with the old velocity and acceleration, the velocity that agrees with the mean of both accelerations,"
        " solved for, then the force"
    ),
    reference=(
        "Swope et al. 1982, J. Chem. Phys. 76, 637, doi:10.1063/1.442716; Newmark 1959, J. Eng. Mech. Div. 85, 67, eq."
        " (3), (6)"
    ),
    refuses=(Trait.NO_COORDINATES, Trait.PYTHON_FORCES, Trait.CONTACTS),
)

IMPLICIT_MIDPOINT = Method(
    name="implicit_midpoint",
    synonyms=("Gauss method with one stage", "implicit midpoint rule"),
    order=2,
    symplectic=True,
    symmetric=True,
    evaluations=2,
    update=spread_over_vectors("""
        y2 = y + h/2*k
        solve y2:
            k2 = f(t + h/2, y2)
            y2 = y + h/2*k2
        y1 = 2*y2 - y
        k1 = f(t1, y1)
    """),
    words="the state half-way that agrees with the force there, solved for, then as far again, then the force",
    reference="Hairer, Lubich, Wanner, section II.1, eq. (1.7), and theorem VI.4.2 (symplectic); A-stable",
    refuses=(Trait.PYTHON_FORCES, Trait.CONTACTS),
)

_RADAU_IIA = Collocation(
    a=(
        ("(88 - 7*sqrt(6))/360", "(296 - 169*sqrt(6))/1800", "(-2 + 3*sqrt(6))/225"),
        ("(296 + 169*sqrt(6))/1800", "(88 + 7*sqrt(6))/360", "(-2 - 3*sqrt(6))/225"),
        ("(16 - sqrt(6))/36", "(16 + sqrt(6))/36", "1/9"),
    ),
    b=("(16 - sqrt(6))/36", "(16 + sqrt(6))/36", "1/9"),
    c=("(4 - sqrt(6))/10", "(4 + sqrt(6))/10", "1"),
)
RADAU_IIA = Method(
    name="radau_iia",
    synonyms=("Radau IIA of order 5", "RADAU5", "Ehle's method"),
    order=5,
    symplectic=False,
    evaluations=4,
    update=spread_over_vectors(_RADAU_IIA.template),
    words="three stages at Radau's points, solved for together; the third is the new state, then the force",
    reference="Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.5, Table 5.6, and IV.8, eq. (8.19); L-stable",
    # the linear filter of eq. (8.19), (I - h*g0*J)**-1, as the equation that it solves; g0 = 0.2748888295956774 there
    estimate=spread_over_vectors("""
        yz = 0.27488882959567735*(h*k + (-(13 + 7*sqrt(6))/3)*(y2 - y) + ((-13 + 7*sqrt(6))/3)*(y3 - y) - 1/3*(y4 - y))
        ye = yz
        solve ye:
            yd = y1 + ye
            kd = f(t1, yd)
            ye = yz + 0.27488882959567735*h*(kd - k1)
    """),
    estimate_order=3,
    interpolant=Interpolant(
        spread_over_vectors("""
        ya = (y2 - y)/((4 - sqrt(6))/10)
        yb = 5/sqrt(6)*(y3 - y2)
        yc = (y1 - y3)/((6 - sqrt(6))/10)
        yd = (yb - ya)/((4 + sqrt(6))/10)
        yg = (yc - yb)/((6 + sqrt(6))/10) - yd
        ys = y + s*(ya + (s - (4 - sqrt(6))/10)*(yd + (s - (4 + sqrt(6))/10)*yg))
    """),
        "the collocation polynomial, cubic, through the start and the three stages, solved for again",
        order=3,
        needs_no_stages=True,
    ),
    stepper=_RADAU_IIA,
    refuses=(Trait.PYTHON_FORCES, Trait.CONTACTS),
)

METHODS = (IMPLICIT_VELOCITY_VERLET, IMPLICIT_MIDPOINT, RADAU_IIA)
