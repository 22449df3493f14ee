"""Jets: the Taylor coefficients, order by order, of what a program computes along the motion."""

from xdynamics.kernels.jets.expansion import Expansion, expansion
from xdynamics.kernels.jets.motion import Motion, UnexpandedError

__all__ = ["Expansion", "Motion", "UnexpandedError", "expansion"]
