"""Implicit methods: each step solves its equations by Newton's method."""

from xdynamics.methods.lines import Interpolant, spread_over_vectors
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import Collocation
from xdynamics.model import Trait

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
