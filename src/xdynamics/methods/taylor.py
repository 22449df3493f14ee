"""Taylor series of the motion, of any order, from the jets of the forces."""

from __future__ import annotations

from decimal import ROUND_CEILING, Decimal
from functools import lru_cache

from xdynamics.expressions.parser import LARGEST_EXPONENT
from xdynamics.methods.lines import Interpolant, spread_over_vectors
from xdynamics.methods.method import Method
from xdynamics.methods.steppers import Jets
from xdynamics.model import Trait

NAME = "taylor"
DEFAULT_ORDER = 8  # of steps that are given; what the rule below gives for a relative tolerance of 1e-6
LEAST_ORDER, MOST_ORDER = 2, 60
ORDER_RULE = "ceil(1 - ln(rtol)/2)"


def order_for(rtol: float) -> int:
    """Return the order with which a relative tolerance is reached with the least work: Jorba and Zou 2005, section 3.2.

    With it a step is the radius of convergence over e**2, whatever the tolerance. Decimal arithmetic gives the logarithm
    the same digits on every machine.

    Examples
    --------
    >>> [order_for(rtol) for rtol in (1e-6, 1e-9, 1e-12, 1e-15)]
    [8, 12, 15, 19]
    """
    order = int((1 - Decimal(rtol).ln() / 2).to_integral_value(ROUND_CEILING))
    return min(max(order, LEAST_ORDER), MOST_ORDER)


def _power_of_step(exponent: int) -> str:
    """Write a power as factors whose exponents the language has."""
    full_factors, remaining_exponent = divmod(exponent, LARGEST_EXPONENT)
    return "*".join([f"h**{LARGEST_EXPONENT}"] * full_factors + [f"h**{remaining_exponent}"] * (remaining_exponent > 0))


@lru_cache(maxsize=64)
def of_order(order: int) -> Method:
    """Return the method of an order."""
    series = f"expand f at t, q, v, x: i*q_i = v_(i - 1), i*v_i = a_(i - 1), i*x_i = r_(i - 1), i = 1 ... {order}"
    return Method(
        name=NAME,
        synonyms=("Taylor series integration", "power series", "automatic differentiation", "recurrent power series"),
        order=order,
        symplectic=False,
        evaluations=1,
        update=f"{series}\n" + spread_over_vectors(f"y1 = y + sum(h**i*y_i, i = 1 ... {order})\nk1 = f(t1, y1)"),
        words=(
            "the Taylor coefficients of the motion and of all that forces consist of, order by order, from the state at"
            " the start; their sum at t1, then the force"
        ),
        reference=(
            "Jorba, Zou 2005, Exp. Math. 14, 99, doi:10.1080/10586458.2005.10128904; Griewank, Walther, Evaluating"
            " Derivatives, 2nd ed., chapter 13; Moore 1966, Interval Analysis, chapter 11"
        ),
        refuses=(Trait.PYTHON_FORCES,),
        # what the force at t1 lacks to the slope of the sum is (order + 1) h**order of the first coefficient left out; that
        # of the coordinates is known, as the slope of their sum is that of velocities but for the last term
        estimate=f"qe = {_power_of_step(order + 1)}*v_{order}/{order + 1}\n"
        + "\n".join(
            f"{y}e = h*({k}1 - sum(i*h**(i - 1)*{y}_i, i = 1 ... {order}))/{order + 1}" for y, k in ("va", "xr")
        ),
        estimate_order=order,
        interpolant=Interpolant(
            f"{series}\n" + spread_over_vectors(f"ys = y + sum((s*h)**i*y_i, i = 1 ... {order})"),
            f"the Taylor polynomial of degree {order} about the start of the step",
            order=order,
            needs_no_stages=True,
        ),
        stepper=Jets(order),
    )


METHODS = (of_order(DEFAULT_ORDER),)
