"""Comparisons: two runs side by side, and a run beside measured data."""
