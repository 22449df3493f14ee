"""Flags of a record as the words that they stand for, and the unit of its times."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

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
