"""Attributes of a quantity with dimensions, from those of its elements, and the other way round."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from xdynamics.schema import ATOL_FOLLOWING, ATOL_FOLLOWS, ATOL_RULE, ELEMENT_NAME, ELEMENTS, OF_ELEMENTS
from xdynamics.shapes.naming import DOT, display_text, split_element_name

_LABELS = re.compile(rf"(?<=\w)(?:{DOT}(?:[0-9]+(?![0-9])|\w+))+")  # a number ends before what follows: after_hit·3_u


def quantity_of(text: str) -> str:
    """Return a text about an element as one about the quantity.

    Examples
    --------
    >>> quantity_of("velocity of r·Jupiter·x")
    'velocity of r'
    >>> quantity_of("uncertainty of after_hit·3_u")
    'uncertainty of after_hit_u'
    """
    return _LABELS.sub("", text) if DOT in text else text


def quantity_names(names: Iterable[str]) -> tuple[str, ...]:
    """Return names with those of quantities in the place of their elements'."""
    return tuple(dict.fromkeys(map(quantity_of, names)))


def elements_of(name: str, known_names: Iterable[str]) -> str:
    """Say of a name that is not known how its elements are named, where it is a quantity with dimensions; else nothing."""
    members = [
        display_text(entry)
        for entry in known_names
        if split_element_name(entry)[1] and quantity_of(entry) == quantity_of(name)
    ]
    if not members:
        return ""
    few = ", ".join(members[:3]) + (f", … {members[-1]}" if len(members) > 3 else "")
    return f"; '{quantity_of(name)}' has the elements {few}: name one"


def attributes_of_quantity(elements: Mapping[int, tuple[str, Mapping[Any, Any]]], size: int) -> dict[str, Any]:
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
            all_equal = len(values) == len(every) and len(set(values.values())) == 1
            shared[key] = float(first) if all_equal else numbers
        elif key == ATOL_RULE and len(values) < len(every):
            following = np.zeros(size, np.int8)
            following[[*values]] = 1
            shared[ATOL_FOLLOWING] = following
        elif isinstance(first, str):
            texts = dict.fromkeys(quantity_of(str(value)) for value in values.values())
            shared[key] = "; ".join(texts)
        else:
            shared[key] = first
    return shared


def attributes_of_element(attributes: Mapping[Any, Any], number: int, size: int) -> dict[str, Any]:
    """Return the attributes of one element."""
    element_attributes = {key: value for key, value in attributes.items() if key not in (ELEMENTS, ELEMENT_NAME)}
    for key in OF_ELEMENTS:
        value = element_attributes.get(key)
        if value is None or np.shape(value) != (size,) or size == 1:
            continue
        element_attributes[key] = float(value[number])
        if np.isnan(element_attributes[key]):
            del element_attributes[key]
    if element_attributes.pop(ATOL_FOLLOWING, 0):
        element_attributes[ATOL_RULE] = ATOL_FOLLOWS
    return element_attributes
