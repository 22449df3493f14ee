"""Attributes of variables and runs, the same in memory and from a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics import schema


def own_attributes(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes that belong to a variable itself, not to the way it is kept."""
    kept_as = {schema.DIGEST, "coordinates", "_FillValue", "_Encoding"}
    if schema.TEXT_FORM in attributes:  # a text whose flags are of the file alone
        kept_as |= {schema.TEXT_FORM, *schema.FLAG_ATTRIBUTES}
    return {str(key): value for key, value in attributes.items() if key not in kept_as}


def without_bounds(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes of a time beside which its bounds do not stand."""
    return {str(key): value for key, value in attributes.items() if key != "bounds"}


def plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return attributes as plain values, the same in memory and from a file, where an array of one is a number."""
    return {str(key): _plain_value(value) for key, value in attributes.items()}


def _plain_value(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    return value[0] if isinstance(value, list) and len(value) == 1 else value
