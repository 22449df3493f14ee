"""Flags of a record as words, the unit of its times, and the attributes of its variables.

Attributes of variables and runs are the same in memory and from a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.schema import AT_TIME
from xdynamics.units import NUMBERS, SECONDS, Unit

if TYPE_CHECKING:
    import xarray as xr


def words_of_flag(flag: xr.DataArray | xr.Variable) -> list[str]:
    """Return the word of every value of a flag, row by row; switches of records of version 0.2 are ``drag:abs``, here ``drag.abs``."""
    words = str(flag.attrs["flag_meanings"]).replace(":", ".").split()
    names = dict(zip(np.atleast_1d(flag.attrs["flag_values"]).tolist(), words, strict=True))
    return [names[int(value)] for value in np.asarray(flag).ravel()]


def in_prose(word: str) -> str:
    """Return the word of a flag as sentences have it.

    Examples
    --------
    >>> in_prose("pre_asymptotic"), in_prose("event_limited")
    ('pre-asymptotic', 'event limited')
    """
    return word.replace("pre_", "pre-").replace("_", " ")


def time_unit_of(record: xr.Dataset) -> Unit:
    """Return the unit of a record's times: seconds, or 1 if its model's time is dimensionless."""
    times = (record.variables[name] for name in ("time", AT_TIME, "event_time") if name in record.variables)
    units = next((str(variable.attrs.get("units", SECONDS.text)) for variable in times), SECONDS.text)
    return NUMBERS if units == NUMBERS.text else SECONDS


def own_attributes(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes of a variable, without those of its storage in a file."""
    kept_as = {schema.DIGEST, "coordinates", "_FillValue", "_Encoding"}
    if schema.TEXT_FORM in attributes:  # a text whose flags are of the file alone
        kept_as |= {schema.TEXT_FORM, *schema.FLAG_ATTRIBUTES}
    return {str(key): value for key, value in attributes.items() if key not in kept_as}


def without_bounds(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return the attributes of a time beside which its bounds do not stand."""
    return {str(key): value for key, value in attributes.items() if key != "bounds"}


def plain(attributes: Mapping[Any, Any]) -> dict[str, Any]:
    """Return attributes as plain values, equal in memory and from a file: an array of one number is a number."""
    return {str(key): _plain_value(value) for key, value in attributes.items()}


def _plain_value(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    return value[0] if isinstance(value, list) and len(value) == 1 else value
