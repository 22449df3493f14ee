"""The polynomial that a step leaves, for the search for events or for delayed values: its degree, and room for it."""

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


def past_degree(layout: Layout) -> int:
    """Return the degree of the polynomial that is kept of every accepted step for delayed values; 0 without any."""
    return layout.scheme.interpolant.degree if layout.scheme is not None and layout.model.delays else 0


def curve_size(layout: Layout) -> int:
    """Return how many coefficients the polynomial of a step has, of all components."""
    degree = max(curve_degree(layout), past_degree(layout))
    return (degree + 1) * layout.used.size if degree else 0
