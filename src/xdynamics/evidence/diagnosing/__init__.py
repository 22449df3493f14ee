"""Diagnoses of a run: energy, momentum, cycles, extremes, chaos."""
