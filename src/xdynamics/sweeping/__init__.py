"""Grids of runs: axes, members, what is kept of each, and their archive."""
