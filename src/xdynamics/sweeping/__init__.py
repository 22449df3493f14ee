"""Grids of runs: axes, members, recorded variables, and their archive."""
