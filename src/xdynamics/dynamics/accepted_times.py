"""The accepted times of a record."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.schema import STEPS
from xdynamics.units import SECONDS, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]


class AcceptedTimes:
    """Accepted times, of which only the chunks are read that a search needs."""

    def __init__(self, time: xr.Variable) -> None:
        self._time, self.units = time, str(time.attrs.get("units", SECONDS.text))
        sizes = time.chunks[0] if time.chunks else (time.size,)
        self._offsets = np.concatenate([[0], np.cumsum(sizes)])
        self._read: dict[int, Floats] = {}

    def __len__(self) -> int:
        return int(self._offsets[-1])

    def at(self, rows: NDArray[np.int64]) -> Floats:
        """Return the times of rows."""
        if len(self._offsets) == 2:
            return self._chunk(0)[rows]
        chunks = np.searchsorted(self._offsets, rows, side="right") - 1
        times = np.empty(rows.size)
        for chunk in np.unique(chunks).tolist():
            inside = chunks == chunk
            times[inside] = self._chunk(chunk)[rows[inside] - self._offsets[chunk]]
        return times

    def count(self, wanted: Floats, side: Literal["left", "right"]) -> NDArray[np.int64]:
        """Count the rows before each time, or up to and including it."""
        counts = np.empty(wanted.size, np.int64)
        pending = [(0, len(self._offsets) - 2, np.arange(wanted.size))]
        while pending:
            low, high, which = pending.pop()
            if low == high:
                counts[which] = self._offsets[low] + np.searchsorted(self._chunk(low), wanted[which], side=side)
                continue
            middle = (low + high + 1) // 2
            border = self._chunk(middle)[0]
            after = wanted[which] >= border if side == "right" else wanted[which] > border
            parts = (low, middle - 1, which[~after]), (middle, high, which[after])
            pending += [part for part in parts if part[2].size]
        return counts

    def _chunk(self, chunk: int) -> Floats:
        if chunk not in self._read:
            part = self._time.isel({STEPS: slice(int(self._offsets[chunk]), int(self._offsets[chunk + 1]))})
            self._read[chunk] = np.asarray(part)
        return self._read[chunk]


def located(accepted: AcceptedTimes, wanted: Floats, *, after: bool) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Find the row from which each time's step starts, and the times at both ends of that step.

    Raises
    ------
    InputError
        If a time is outside the run.
    """
    first, last = accepted.at(np.array([0, len(accepted) - 1])).tolist()
    if first > last:
        raise InputError(
            "the rows are not in the order of time; take them in their order, as in run.isel(step=slice(a, b))"
        )
    outside = np.flatnonzero((wanted < first) | (wanted > last))
    if outside.size:
        unit = unit_suffix(accepted.units)
        raise InputError(
            f"times[{int(outside[0])}] = {float(wanted[outside[0]])!r}{unit} is outside the run, from {first!r}{unit}"
            f" to {last!r}{unit}; a run is never extrapolated"
        )
    rows = accepted.count(wanted, "right") - 1
    if not after:
        rows = np.minimum(rows, accepted.count(wanted, "left"))
    return rows, accepted.at(rows), accepted.at(np.minimum(rows + 1, len(accepted) - 1))
