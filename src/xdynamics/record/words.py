"""Flags of a record as the words that they stand for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


def words_of(flag: xr.DataArray) -> list[str]:
    """Return the word of every value of a flag."""
    words = str(flag.attrs["flag_meanings"]).split()
    names = dict(zip(np.atleast_1d(flag.attrs["flag_values"]).tolist(), words, strict=True))
    return [names[int(one)] for one in np.atleast_1d(np.asarray(flag))]
