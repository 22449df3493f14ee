"""Whether what a variable holds is still to be computed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import xarray as xr


def is_chunked(variable: xr.Variable) -> bool:
    """Return whether a variable is in chunks.

    xarray looks through all that an array of chunks must have, 0.2 ms for each variable; an array in memory is none.
    """
    return not isinstance(variable._data, np.ndarray) and variable.chunks is not None  # noqa: SLF001 - `.data` would read what is lazy
