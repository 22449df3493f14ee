"""Moreau's time-stepping: contacts by impulses over complete steps, without events."""

from xdynamics.methods.composition import POSITION_VERLET
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import TimeStepping
from xdynamics.model import Trait

MOREAU_JEAN = Method(
    name="moreau_jean",
    synonyms=("Moreau's midpoint rule", "nonsmooth contact dynamics with explicit forces"),
    order=2,
    symplectic=True,
    symmetric=True,
    evaluations=2,
    update=POSITION_VERLET.update,
    moving_update="""
        q2 = q + 1/2*h*v
        v2 = v + 1/2*h*a
        x2 = x + 1/2*h*r
        a2, r2 = f(t + 1/2*h, q2, v2, x2)
        v1 = v + h*a2
        x1 = x + h*r2
        q1 = q2 + 1/2*h*v1
        a1, r1 = f(t1, q1, v1, x1)
    """,
    words=(
        "half a drift, a kick by the forces there and by the impulses of every contact whose gap is closed there, half"
        " a drift with the new velocity; of first order where there are impacts, which are in no bracket"
    ),
    reference=(
        "Moreau 1999, Comput. Methods Appl. Mech. Eng. 177, 329, doi:10.1016/S0045-7825(98)00387-9;"
        " Jean 1999, ibid. 235, doi:10.1016/S0045-7825(98)00383-1"
    ),
    refuses=(Trait.NO_COORDINATES,),
    stepper=TimeStepping(),
)

METHODS = (MOREAU_JEAN,)
