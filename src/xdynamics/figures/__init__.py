"""Figures, drawn from records alone."""

from xdynamics.figures.plotting import plot

__all__ = ["plot"]
