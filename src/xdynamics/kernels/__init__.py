"""Compiled laws of a model and a method: programs, their texts, machine code, and the cache on disk."""

from xdynamics.kernels.law import Law, law_of
from xdynamics.kernels.layout import Layout, layout_of

__all__ = ["Law", "Layout", "law_of", "layout_of"]
