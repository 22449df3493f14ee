"""Figures, drawn from records alone."""

from xdynamics.figures.run import plot

__all__ = ["plot"]
