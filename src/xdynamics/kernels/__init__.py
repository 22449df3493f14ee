"""From a model and a method to compiled laws: programs, their texts, machine code behind addresses, the cache on disk."""

from xdynamics.kernels.law import Law, law_of
from xdynamics.kernels.layout import Layout, layout_of

__all__ = ["Law", "Layout", "law_of", "layout_of"]
