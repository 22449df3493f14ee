"""Velocity Verlet: for forces of position and time."""

from xdynamics.methods.composition import update_of
from xdynamics.methods.method import Method
from xdynamics.model import Trait

VELOCITY_VERLET = Method(
    name="velocity_verlet",
    synonyms=("leapfrog, kick-drift-kick", "Stoermer-Verlet in velocity form", "Newmark beta = 0, gamma = 1/2"),
    order=2,
    symplectic=True,
    symmetric=True,
    evaluations=1,
    update="""
        q1 = q + h*v + h**2/2*a
        a1, r1 = f(t1, q1, v, x)
        v1 = v + h/2*(a + a1)
        x1 = x + h/2*(r + r1)
    """,
    constrained_update=update_of(
        """
        kick   1/2  1/2
        drift   1
    """,
        keeping=True,
    ),
    words=(
        "position with the old velocity and acceleration, the force at the new position, velocity with the mean of both"
        " accelerations"
    ),
    reference="Swope et al. 1982, J. Chem. Phys. 76, 637, doi:10.1063/1.442716; Hairer, Lubich, Wanner, section I.1.4",
    refuses=(Trait.VELOCITY_DEPENDENT, Trait.COUPLED_MASS, Trait.COUPLED_STATES, Trait.NO_COORDINATES),
)

METHODS = (VELOCITY_VERLET,)
