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

    def times_of_rows(self, rows: NDArray[np.int64]) -> Floats:
        """Return the times of rows."""
        if len(self._offsets) == 2:
            return self._chunk(0)[rows]
        chunks = np.searchsorted(self._offsets, rows, side="right") - 1
        times = np.empty(rows.size)
        for chunk in np.unique(chunks).tolist():
            is_in_chunk = chunks == chunk
            times[is_in_chunk] = self._chunk(chunk)[rows[is_in_chunk] - self._offsets[chunk]]
        return times

    def row_counts(self, requested_times: Floats, side: Literal["left", "right"]) -> NDArray[np.int64]:
        """Count the rows before each time, or up to and including it."""
        counts = np.empty(requested_times.size, np.int64)
        pending = [(0, len(self._offsets) - 2, np.arange(requested_times.size))]
        while pending:
            low, high, which = pending.pop()
            if low == high:
                counts[which] = self._offsets[low] + np.searchsorted(
                    self._chunk(low), requested_times[which], side=side
                )
                continue
            middle = (low + high + 1) // 2
            border = self._chunk(middle)[0]
            is_above = requested_times[which] >= border if side == "right" else requested_times[which] > border
            parts = (low, middle - 1, which[~is_above]), (middle, high, which[is_above])
            pending += [part for part in parts if part[2].size]
        return counts

    def _chunk(self, chunk: int) -> Floats:
        if chunk not in self._read:
            part = self._time.isel({STEPS: slice(int(self._offsets[chunk]), int(self._offsets[chunk + 1]))})
            self._read[chunk] = np.asarray(part)
        return self._read[chunk]


def locate_steps(
    accepted: AcceptedTimes, requested_times: Floats, *, after_event: bool
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Find the row from which each time's step starts, and the times at both ends of that step.

    Raises
    ------
    InputError
        If a time is outside the run.
    """
    first, last = accepted.times_of_rows(np.array([0, len(accepted) - 1])).tolist()
    if first > last:
        raise InputError(
            "the rows are not in the order of time; take them in their order, as in run.isel(step=slice(a, b))"
        )
    outside = np.flatnonzero((requested_times < first) | (requested_times > last))
    if outside.size:
        unit = unit_suffix(accepted.units)
        raise InputError(
            f"times[{int(outside[0])}] = {float(requested_times[outside[0]])!r}{unit} is outside the run, from {first!r}{unit}"
            f" to {last!r}{unit}; a run is never extrapolated"
        )
    rows = accepted.row_counts(requested_times, "right") - 1
    if not after_event:
        rows = np.minimum(rows, accepted.row_counts(requested_times, "left"))
    return rows, accepted.times_of_rows(rows), accepted.times_of_rows(np.minimum(rows + 1, len(accepted) - 1))
