"""Comparisons: of two runs, and of a run with measured data."""
