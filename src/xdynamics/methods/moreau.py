"""Moreau's time-stepping: contacts by impulses over complete steps, without events."""

from xdynamics.methods.composition import POSITION_VERLET, REFUSES
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import TimeStepping

MOREAU_JEAN = Method(
    name="moreau_jean",
    synonyms=("Moreau's midpoint rule", "nonsmooth contact dynamics with explicit forces"),
    order=2,
    symplectic=True,
    symmetric=True,
    evaluations=2,
    update=POSITION_VERLET.update,
    words=(
        "half a drift, a kick by the forces there and by the impulses of every contact whose gap is closed there, half"
        " a drift with the new velocity; of first order where there are impacts, which are in no bracket"
    ),
    reference=(
        "Moreau 1999, Comput. Methods Appl. Mech. Eng. 177, 329, doi:10.1016/S0045-7825(98)00387-9;"
        " Jean 1999, ibid. 235, doi:10.1016/S0045-7825(98)00383-1"
    ),
    refuses=REFUSES,
    stepper=TimeStepping(),
)

METHODS = (MOREAU_JEAN,)
