"""Turning points: where the velocity of a coordinate passes zero within a step."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.diagnosing.conservation import ROLE
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.named_elements import get_column

Floats = NDArray[np.float64]

TURNS = "turn"  # dimension
HALVINGS = 60  # of a step
DEEPEST, MOST_PLACES = 6, 500  # of the halvings whose places are evaluated at once, and of these places


def turn_variables(rows: Chunks, name: str, functions: Mapping[str, Callable[..., float]] | None) -> dict[str, Any]:
    """Return times and places of a coordinate's turns as variables of a Dataset."""
    speed, turn_rows, signs = schema.velocity(name), [np.zeros(0, np.int64)], [np.zeros(0)]
    for part in rows.parts("time", speed):
        time, v, numbers = part.columns["time"], part.columns[speed], part.row_numbers
        passed = np.flatnonzero((numbers[:-1] >= part.first) & (v[:-1] * v[1:] < 0.0) & (np.diff(time) > 0.0))
        turn_rows.append(numbers[passed])
        signs.append(np.sign(v[passed]))
    rows_before, sign = np.concatenate(turn_rows), np.concatenate(signs)
    low, high = rows.values_at("time", np.stack([rows_before, rows_before + 1]))
    run, _ = rows.nearby_record(np.concatenate([rows_before, rows_before + 1]))
    points = np.zeros(0)
    if rows_before.size:
        interpolator = StepInterpolator.of_run(run, functions, REINTEGRATE)

        def not_yet(times: Floats) -> NDArray[np.bool_]:
            velocities: Floats = interpolator.values_of(interpolator.states_at(times.ravel(), after_event=False), speed)
            return sign * velocities.reshape(times.shape) > 0.0

        high = _bisect_turns(low, high, not_yet, 1 if rows.model.assemblies else DEEPEST)
        points = interpolator.values_of(interpolator.states_at(high, after_event=False), name)
    units = str(get_column(rows.run, name).attrs["units"])
    located = f"time at which {name} turns, located with steps of the run's own method"
    return {
        "turning_time": ((TURNS,), high, attrs_of(time_unit_of(rows.run).text, located, ROLE)),
        "turning_point": ((TURNS,), points, attrs_of(units, f"{name} at the turning point", ROLE)),
    }


def _bisect_turns(low: Floats, high: Floats, not_yet: Callable[[Floats], NDArray[np.bool_]], deepest: int) -> Floats:
    """Return the least known time behind each zero.

    The middles of several halvings are evaluated at once, whichever halves will be kept: asking takes longer than
    evaluating, but of many links. They are those of one halving after the other, to the bit.
    """
    columns, depth = np.arange(low.size), deepest
    while depth > 1 and (2**depth - 1) * low.size > MOST_PLACES:
        depth -= 1
    for _ in range(HALVINGS // depth):
        lows, highs, middles = low[None], high[None], []
        for _ in range(depth):
            middles.append((lows + highs) / 2.0)
            halves = (lows, middles[-1]), (middles[-1], highs)
            lows, highs = (np.stack(half, axis=1).reshape(-1, low.size) for half in halves)
        later, half_index = not_yet(np.concatenate(middles)), np.zeros(low.size, np.int64)
        for level in range(depth):
            half_index = 2 * half_index + later[2**level - 1 + half_index, columns]
        low, high = lows[half_index, columns], highs[half_index, columns]
    return high
