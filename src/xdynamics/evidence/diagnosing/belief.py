"""The time up to which a run can be believed: a tighter run stays close to it until then."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.evidence.chunks import Chunks, Unread, with_roles
from xdynamics.evidence.companion import Companion, global_error
from xdynamics.evidence.diagnosing.conservation import ROLE
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.record.flag_words import time_unit_of

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

BELIEVED = 0.1  # of the range of a quantity: the largest error with which it is still believed
AHEAD = 40  # rows of the companion by which its range is taken ahead: what has just begun to move has hardly any yet
LOOKED_AT = 400  # times at which a run is compared with its companion


def belief_variables(rows: Chunks, tighter: Companion) -> dict[str, Any]:
    """Return the time up to which every coordinate, velocity and state is known to a tenth of its range.

    The range is that of the companion up to there: what the run under judgement does later, well or badly, counts for
    nothing.
    """
    until = np.nan if isinstance(rows, Unread) else _believed_until(rows, tighter)
    long_name = (
        "time up to which no coordinate, velocity or state is further from the solution than a tenth of its range"
    )
    return {"believed_until": ((), until, attrs_of(time_unit_of(rows.run).text, long_name, ROLE))}


def _believed_until(rows: Chunks, tighter: Companion) -> float:
    run = rows.run
    end = min(float(rows.values_at("time", rows.size - 1)), float(tighter.run["time"][-1]))
    looked_at = _evenly_spaced_rows(lambda: _rows_off_events(rows, end))
    times = rows.values_at("time", looked_at)
    near, _ = rows.nearby_record(looked_at)
    states = tighter.with_global_errors(
        sample_in_steps(near, times, after_event=True, rule=REINTEGRATE, functions=tighter.functions)
    )
    lost = np.zeros(times.size, bool)
    names = with_roles(run, ("coordinate", "velocity", "state"))
    tighter_run = tighter.holding(names)
    reached = np.searchsorted(tighter_run.variables["time"].values, times, side="right") - 1 + AHEAD
    for name in names:
        span = _range_up_to(tighter_run.variables[name].values, reached)
        far = (np.abs(np.asarray(states.variables[global_error(name)])) > BELIEVED * span) & (span > 0.0)
        lost |= flattened_rows(far).any(axis=1)
    stays = lost & np.append(lost[1:], lost[-1:])  # a single time may lie between two occurrences of the same impact
    return float(times[int(np.argmax(stays))]) if stays.any() else end


def _range_up_to(values: Floats, rows: Rows) -> Floats:
    """Return the range of a column from its first row to each of some rows, or to its last one."""
    spans = np.fmax.accumulate(values) - np.fmin.accumulate(values)
    return np.asarray(spans[np.minimum(rows, len(values) - 1)])


def _rows_off_events(rows: Chunks, end: float) -> Iterator[Rows]:
    """Yield the rows up to a time that are at no event: there two runs may be on different sides, however well they agree."""
    for part in rows.parts("time", "row_kind"):
        at_event = np.isin(part.own_rows("row_kind"), (schema.EVENT_BEFORE, schema.EVENT_AFTER))
        yield part.first + np.flatnonzero(~at_event & (part.own_rows("time") <= end))


def _evenly_spaced_rows(parts: Callable[[], Iterable[Rows]]) -> Rows:
    """Choose some of all rows, evenly by their number."""
    count = sum(part.size for part in parts())
    places, passed, chosen_rows = np.unique(np.linspace(0, count - 1, LOOKED_AT).astype(np.int64)), 0, []
    for part in parts():
        chosen_rows.append(part[places[(places >= passed) & (places < passed + part.size)] - passed])
        passed += part.size
    return np.concatenate(chosen_rows)
