"""The Euler family: first order, one force evaluation a step.

Its methods differ in the velocity that moves the position.
"""

from xdynamics.methods.method import Method
from xdynamics.model import Trait

FORWARD_EULER = Method(
    name="forward_euler",
    synonyms=("explicit Euler",),
    order=1,
    symplectic=False,
    evaluations=1,
    update="""
        q1 = q + h*v
        v1 = v + h*a
        x1 = x + h*r
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words="position with the old velocity, velocity with the old acceleration, then the force",
    reference="Hairer, Norsett, Wanner, Solving ODEs I, 2nd ed., section I.7, eq. (7.3)",
)

EULER_CROMER = Method(
    name="euler_cromer",
    synonyms=("semi-implicit Euler", "symplectic Euler"),
    order=1,
    symplectic=True,
    evaluations=1,
    update="""
        v1 = v + h*a
        q1 = q + h*v1
        x1 = x + h*r
        a1, r1 = f(t1, q1, v1, x1)
    """,
    constrained_update="""
        v1 = v + h*a
        q1 = q + h*v1
        keep q1, v1 at t1 over h
        x1 = x + h*r
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words="velocity with the old acceleration, position with the new velocity, then the force",
    reference="Cromer 1981, Am. J. Phys. 49, 455, doi:10.1119/1.12478; Hairer, Lubich, Wanner, section I.1.2",
    refuses=(Trait.NO_COORDINATES, Trait.HELD_LINKS),  # a link that opened would close again
)

AVERAGED_VELOCITY = Method(
    name="averaged_velocity",
    synonyms=("second-order Taylor position with first-order velocity",),
    order=1,
    symplectic=False,
    evaluations=1,
    update="""
        v1 = v + h*a
        q1 = q + h*((v + v1)/2)
        x1 = x + h*r
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words="velocity with the old acceleration, position with the mean of both velocities, then the force",
    reference="Cromer 1981, Am. J. Phys. 49, 455, doi:10.1119/1.12478",
    refuses=(Trait.NO_COORDINATES,),
)

METHODS = (FORWARD_EULER, EULER_CROMER, AVERAGED_VELOCITY)
