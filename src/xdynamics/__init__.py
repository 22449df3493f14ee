"""Numerical dynamics as self-describing xarray datasets."""
