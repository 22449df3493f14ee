"""Named methods, with their update equations as data. A new family takes one file and one line here."""

from xdynamics.methods import composition, euler, implicit, midpoint, moreau, nystrom, runge_kutta, taylor, verlet
from xdynamics.methods.lines import ConstraintImpulse, Evaluation, Solve, VectorStatement
from xdynamics.methods.method import Method, method_named, unknown_method
from xdynamics.methods.table import Methods

FAMILIES = (euler, midpoint, verlet, composition, moreau, runge_kutta, nystrom, implicit, taylor)
METHODS = Methods({method.name: method for family in FAMILIES for method in family.METHODS})


def method_of(name: str, order: int) -> Method:
    """Return a method by name, of an order where there are several."""
    method = METHODS[name]
    return taylor.of_order(order) if method.has_orders else method


__all__ = [
    "METHODS",
    "ConstraintImpulse",
    "Evaluation",
    "Method",
    "Solve",
    "VectorStatement",
    "method_named",
    "method_of",
    "unknown_method",
]
