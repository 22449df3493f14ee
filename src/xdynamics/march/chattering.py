"""Motion that rests on a switch at which a force jumps: passages to and fro, each within what can be resolved."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.model.detectors import SWITCH

NOWHERE = -1
PASSAGES = 32  # the last ones of a run, which all have to be of one switch and close together
CLOSE = 100.0  # time tolerances from one to the next
SMALL = 64.0  # uncertainties of the switch's function between them


def chattering(detectors: NDArray[Any], events: NDArray[Any]) -> int:
    """Return the detector of the switch that the last events passed to and fro, or `NOWHERE`.

    Between two passages its function stays within a multiple of its rounding, by its rate at the second and the time
    from the first, or the time itself is a small multiple of its tolerance: what happens there is made by rounding.
    """
    last = events[-PASSAGES:]
    if len(last) < PASSAGES or (last["detector"] != last["detector"][0]).any():
        return NOWHERE
    detector = detectors[last["detector"][0]]
    if detector["role"] != SWITCH:
        return NOWHERE
    pauses, rates = np.diff(last["time"]), np.abs(last["slope"][1:])
    near = (pauses <= CLOSE * detector["tolerance"]) | (rates * pauses / 4.0 <= SMALL * last["uncertainty"][1:])
    return int(last["detector"][0]) if near.all() else NOWHERE
