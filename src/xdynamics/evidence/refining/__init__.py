"""Refinements: one model over steps, tolerances or rules."""
