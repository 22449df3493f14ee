"""Attributes of a quantity with dimensions, from those of its elements, and the other way round."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from xdynamics.schema import (
    ATOL_FOLLOWING,
    ATOL_FOLLOWS,
    ATOL_RULE,
    ELEMENT_NAME,
    ELEMENTS,
    OF_ELEMENTS,
)
from xdynamics.shapes.naming import DOT, parted, spoken

_LABELS = re.compile(rf"(?<=\w)(?:{DOT}(?:[0-9]+(?![0-9])|\w+))+")  # a number ends before what follows: after_hit·3_u


def of_whole(text: str) -> str:
    """Return a text about an element as one about the quantity.

    Examples
    --------
    >>> of_whole("velocity of r·Jupiter·x")
    'velocity of r'
    >>> of_whole("uncertainty of after_hit·3_u")
    'uncertainty of after_hit_u'
    """
    return _LABELS.sub("", text) if DOT in text else text


def of_wholes(names: Iterable[str]) -> tuple[str, ...]:
    """Return names with those of quantities in the place of their elements'."""
    return tuple(dict.fromkeys(map(of_whole, names)))


def elements_of(name: str, known: Iterable[str]) -> str:
    """Say of a name that is not known how its elements are named, where it is a quantity with dimensions; else nothing."""
    members = [spoken(entry) for entry in known if parted(entry)[1] and of_whole(entry) == of_whole(name)]
    if not members:
        return ""
    few = ", ".join(members[:3]) + (f", … {members[-1]}" if len(members) > 3 else "")
    return f"; '{of_whole(name)}' has the elements {few}: name one"


def attributes_of_whole(elements: Mapping[int, tuple[str, Mapping[Any, Any]]], size: int) -> dict[str, Any]:
    """Return the attributes that elements share, and those that differ as one number for each element.

    Parameters
    ----------
    elements : mapping of int to (str, mapping)
        By the number of each element its name and its attributes.
    size : int
        How many elements the quantity has.
    """
    every = {number: attributes for number, (_, attributes) in elements.items()}
    shared: dict[str, Any] = {}
    for key in dict.fromkeys(key for attributes in every.values() for key in attributes):
        values = {number: attributes[key] for number, attributes in every.items() if key in attributes}
        first = next(iter(values.values()))
        if key in OF_ELEMENTS:
            numbers = np.full(size, np.nan)
            numbers[[*values]] = [float(value) for value in values.values()]
            alike = len(values) == len(every) and len(set(values.values())) == 1
            shared[key] = float(first) if alike else numbers
        elif key == ATOL_RULE and len(values) < len(every):
            following = np.zeros(size, np.int8)
            following[[*values]] = 1
            shared[ATOL_FOLLOWING] = following
        elif isinstance(first, str):
            texts = dict.fromkeys(of_whole(str(value)) for value in values.values())
            shared[key] = "; ".join(texts)
        else:
            shared[key] = first
    return shared


def attributes_of_element(attributes: Mapping[Any, Any], number: int, size: int) -> dict[str, Any]:
    """Return the attributes of one element."""
    own = {key: value for key, value in attributes.items() if key not in (ELEMENTS, ELEMENT_NAME)}
    for key in OF_ELEMENTS:
        value = own.get(key)
        if value is None or np.shape(value) != (size,) or size == 1:
            continue
        own[key] = float(value[number])
        if np.isnan(own[key]):
            del own[key]
    if own.pop(ATOL_FOLLOWING, 0):
        own[ATOL_RULE] = ATOL_FOLLOWS
    return own
