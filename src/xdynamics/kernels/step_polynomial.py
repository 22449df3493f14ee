"""The polynomial that a step leaves for the search for events: its degree, and room for its coefficients."""

from __future__ import annotations

from xdynamics.kernels.layout import Layout

POLYNOMIAL = "polynomial"  # name of the program that writes it


def curve_degree(layout: Layout) -> int:
    """Return the degree of the polynomial that a step leaves for the search for events; 0 if it leaves none.

    Contacts of many links are searched for by the states alone.
    """
    scheme = layout.scheme
    if scheme is None or not scheme.leaves_polynomial or not layout.watched or layout.model.assemblies:
        return 0
    return scheme.interpolant.degree


def curve_size(layout: Layout) -> int:
    """Return how many coefficients that polynomial has, of all components."""
    degree = curve_degree(layout)
    return (degree + 1) * layout.used.size if degree else 0
