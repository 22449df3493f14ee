"""Numbers of functions, which are real: numpy drops imaginary parts where it makes floats."""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics.faults import InputError


def real(values: Any) -> Any:
    """Return numbers, or anything else, as they are; of complex ones without imaginary parts the real parts.

    Raises
    ------
    InputError
        If one has an imaginary part.
    """
    if not np.iscomplexobj(values):
        return values
    if (imaginary := np.flatnonzero(np.imag(values))).size:
        first = np.ravel(values)[imaginary[0]]
        raise InputError(f"the function makes {first:.6g}, needs real numbers; write real and imaginary parts apart")
    return np.real(values)
