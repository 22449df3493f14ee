"""Names of single elements: ``r·Jupiter·x`` inside, ``r[Jupiter, x]`` wherever people read and write it.

The dot is a letter of no name in a model file, and one of Python's identifiers: an element is a name like any other.
Words before a name stay before it: the velocity of ``r·Jupiter·x`` is ``v_r·Jupiter·x``.
"""

from __future__ import annotations

from collections.abc import Iterable

from xdynamics.faults import DOT, spoken, written

__all__ = ["DOT", "element", "parted", "spoken", "whole_of", "written"]


def element(name: str, labels: Iterable[str]) -> str:
    """Return the name of an element from the quantity's and its labels.

    Examples
    --------
    >>> element("r", ["Jupiter", "x"]), element("g", [])
    ('r·Jupiter·x', 'g')
    """
    return DOT.join([name, *labels])


def whole_of(name: str) -> str:
    """Return the quantity's name, of an element as it is named inside or as people write it.

    Examples
    --------
    >>> whole_of("v_u·3"), whole_of("v_u[-1]"), whole_of("g"), whole_of("v_u[")
    ('v_u', 'v_u', 'g', 'v_u[')
    """
    return name.partition("[")[0] if name.endswith("]") else name.partition(DOT)[0]


def parted(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the quantity's name and the labels of an element.

    Examples
    --------
    >>> parted("error_r·Jupiter·x"), parted("time")
    (('error_r', ('Jupiter', 'x')), ('time', ()))
    """
    whole, *labels = name.split(DOT)
    return whole, tuple(labels)
