"""Names of single elements: ``r·Jupiter·x`` internally, ``r[Jupiter, x]`` wherever people read and write them.

The dot is a letter of no name in a model file, but is one of Python's identifiers: an element's name is like any other.
Words before a name stay before it: the velocity of ``r·Jupiter·x`` is ``v_r·Jupiter·x``.
"""

from __future__ import annotations

from collections.abc import Iterable

from xdynamics.faults import DOT, display_text, internal_text

__all__ = ["DOT", "display_text", "internal_text", "join_element_name", "quantity_name", "split_element_name"]


def join_element_name(name: str, labels: Iterable[str]) -> str:
    """Return the name of an element from the quantity's and its labels.

    Examples
    --------
    >>> join_element_name("r", ["Jupiter", "x"]), join_element_name("g", [])
    ('r·Jupiter·x', 'g')
    """
    return DOT.join([name, *labels])


def quantity_name(name: str) -> str:
    """Return the quantity's name, of an element as it is named inside or as people write it.

    Examples
    --------
    >>> quantity_name("v_u·3"), quantity_name("v_u[-1]"), quantity_name("g"), quantity_name("v_u[")
    ('v_u', 'v_u', 'g', 'v_u[')
    """
    return name.partition("[")[0] if name.endswith("]") else name.partition(DOT)[0]


def split_element_name(name: str) -> tuple[str, tuple[str, ...]]:
    """Return the quantity's name and the labels of an element.

    Examples
    --------
    >>> split_element_name("error_r·Jupiter·x"), split_element_name("time")
    (('error_r', ('Jupiter', 'x')), ('time', ()))
    """
    quantity, *labels = name.split(DOT)
    return quantity, tuple(labels)
