"""Which form the value of a quantity has: a number with a unit, numbers for elements, or an expression."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from xdynamics.expressions import parse
from xdynamics.faults import InputError
from xdynamics.model.python_values import is_array
from xdynamics.model.uncertainty import split_uncertainty
from xdynamics.units import parse_quantity

_CALLING = re.compile(r"[A-Za-z_]\w*\s*\(|^\s*[0-9.]+\s*[*+(-]")
OF_ELEMENTS = ("dims", "values", "table", "csv", "column", "columns")  # keys of a quantity with dimensions alone


def is_of_elements(entry: Any) -> bool:
    """Whether an entry has values for elements, or is an expression."""
    if isinstance(entry, Mapping):
        return any(key in entry for key in OF_ELEMENTS) or is_of_elements(entry.get("value"))
    return isinstance(entry, list | tuple) or is_array(entry) or is_expression(entry) or is_meant(entry)


def is_expression(value: Any) -> bool:
    """Whether a text is an expression, and no number with a unit."""
    if not isinstance(value, str) or split_uncertainty(value):
        return False
    try:
        parse_quantity(value)
    except InputError:
        try:
            parse(value)
        except InputError:
            return False
        return True
    return False


def is_meant(value: Any) -> bool:
    """Whether a text that is neither is meant as an expression: it has a call, or an operator behind its first number."""
    if not isinstance(value, str) or split_uncertainty(value) or is_expression(value):
        return False
    try:
        parse_quantity(value)
    except InputError:
        return _CALLING.search(value) is not None
    return False
