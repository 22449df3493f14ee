"""Named methods, with their update equations as data. A new family takes one file and one line here."""

from xdynamics.methods import composition, euler, implicit, midpoint, moreau, nystrom, runge_kutta, verlet
from xdynamics.methods.lines import Evaluation, Solve, VectorStatement
from xdynamics.methods.method import Method, method_named, unknown_method
from xdynamics.methods.table import Methods

FAMILIES = (euler, midpoint, verlet, composition, moreau, runge_kutta, nystrom, implicit)
METHODS = Methods({method.name: method for family in FAMILIES for method in family.METHODS})

__all__ = ["METHODS", "Evaluation", "Method", "Solve", "VectorStatement", "method_named", "unknown_method"]
