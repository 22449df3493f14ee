"""Named methods: their update equations as data. A new family is one file and one line here."""

from xdynamics.methods import composition, euler, implicit, midpoint, nystrom, runge_kutta, verlet
from xdynamics.methods.method import Evaluation, Method, Solve, Statement, method_named

METHODS: dict[str, Method] = {one.name: one for family in (euler, midpoint, verlet, composition, runge_kutta, nystrom, implicit) for one in family.METHODS}

__all__ = ["METHODS", "Evaluation", "Method", "Solve", "Statement", "method_named"]
