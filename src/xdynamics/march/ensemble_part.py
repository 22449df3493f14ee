"""One thread's part of many runs: their inputs and their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Law, Layout
from xdynamics.march.initial_run import floor_of, widened
from xdynamics.march.log import LOG_COUNTS, Log, allocate, is_wide
from xdynamics.march.run import NOW, Run
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.units import TIME

Floats = NDArray[np.float64]
Arrays = Mapping[tuple[str, str], Floats]  # by kind and name; one number for each run
# rows that many runs fill at a time, at most and at least; and the bytes of wide ones: a system provides memory in pages of
# some megabytes, of which a row of 10,000 numbers may touch all
LOG_ROWS, FEWEST_ROWS, LOG_BYTES = 1 << 14, 64, 1 << 24


@dataclass
class EnsemblePart:
    """What one thread marched, in internal units, with the pieces of its log."""

    ends: NDArray[Any]
    lasts: Floats
    largest: Floats
    passed: Floats  # of each switch declared smooth: its side at the end, how often it was passed, and when first
    parameters: Floats
    logs: list[Log]

    @classmethod
    def empty(cls, runs: int, law: Law, parameters: Floats) -> EnsemblePart:
        """Return room for a number of runs."""
        used, row, smooth = law.layout.used.size, law.layout.row.size, len(law.layout.smooth)
        lasts, largest, passed = (np.zeros((runs, width)) for width in (row, used, 3 * smooth))
        return cls(np.zeros(runs, NOW), lasts, largest, passed, parameters, [])


def inputs_of_runs(
    model: Model, settings: Settings, law: Law, run: Run, arrays: Arrays
) -> tuple[NDArray[Any], Floats, Floats, Floats]:
    """Return plan, start, parameters and absolute tolerances of every run, in internal units."""
    n, scales, layout = len(next(iter(arrays.values()))), settings.scales, law.layout
    plans = np.repeat(run.plan, n)
    starts = np.tile(run.y[: layout.used.size], (n, 1))
    parameters, atols = np.tile(run.p, (n, 1)), np.tile(run.atol, (n, 1))
    places = {name: i for i, name in enumerate(constants(model))}
    for (kind, name), values in arrays.items():
        if kind == "parameter":
            parameters[:, places[name]] = values / scales.si_factor(model.dimensions[name])
        elif kind == "initial value":
            starts[:, layout.used.offset_of(name)] = values / scales.si_factor(model.dimensions[name])
        elif kind == "step":
            plans["first_step" if settings.adaptive else "step_size"] = values / scales.si_factor(TIME)
        elif settings.tolerances is not None:
            plans["rtol"] = [law.scheme.inner(value) for value in values.tolist()]
            factors = np.array([widened(law, value) for value in values.tolist()])
            plans["floor"] = [floor_of(rtol) for rtol in plans["rtol"].tolist()]
            for i, used in enumerate(layout.used):
                atol = settings.tolerances.atol_of(used)
                if atol is not None:
                    atols[:, i] = atol / scales.si_factor(model.dimensions[used]) * factors
    return plans, starts, parameters, atols


def log_of_many(layout: Layout, settings: Settings) -> Log:
    """Return a log for many runs, which is filled repeatedly."""
    rows = rows_of_many(LOG_ROWS, layout.row.size)
    return allocate(layout, rows, sampled=0, one_by_one=settings.locates_one_by_one, by_rows=is_wide(layout))


def rows_of_many(max_rows: int, numbers: int) -> int:
    """Return how many rows of so many numbers many runs fill at a time: some megabytes, and a step at least."""
    return max(FEWEST_ROWS, min(max_rows, LOG_BYTES // (8 * max(1, numbers))))


def copy_log_start(log: Log, rows: int, events: int) -> Log:
    """Copy the first rows and events of a log, with closed links where there are rows."""
    return Log(
        log.base,
        log.rows[:, :rows].copy(),
        log.flags[:, :rows].copy(),
        log.samples[:, :0],
        log.trials[:0],
        log.events[:events].copy(),
        log.rates[:, :events].copy(),
        log.impulses[:, :events].copy(),
        log.closed_rows[:, : None if rows else 0].copy(),
    )


def take_out_log(run: Run, log: Log, *, logs: bool) -> Log:
    """Copy what is kept out of the log, and have it filled from its beginning."""
    now, base = run.now[0], log.base[0]
    rows, events = int(now.rows - base.rows) if logs else 0, int(now.events - base.events)
    log_part = copy_log_start(log, rows, events)
    log.follow(*(int(now[count]) for count in LOG_COUNTS))
    return log_part
