"""The log of a march: blocks of rows, filled by compiled code, read as columns."""

from __future__ import annotations

import mmap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import called, compiled, shared
from xdynamics.kernels.law import DERIVED
from xdynamics.kernels.layout import Layout
from xdynamics.march.run import BASE, EVENT_ROW, TRIAL_ROW, Run

MOST_SUBSTEPS = 200  # of one event's bracket; halving alone needs 60


class Log(NamedTuple):
    """Blocks of a log; a column of the record is one row of `rows` and `samples`, so that it is contiguous."""

    base: NDArray[Any]
    rows: NDArray[np.float64]
    flags: NDArray[np.int8]
    samples: NDArray[np.float64]
    trials: NDArray[Any]
    events: NDArray[Any]

    def lend(self, run: Run) -> None:
        """Let a run write here from now on."""
        run.put(base=self.base, log_rows=self.rows, log_flags=self.flags, log_samples=self.samples,
                log_trials=self.trials, log_events=self.events)  # fmt: skip


@compiled
def has_room(run: Run) -> bool:
    """Whether one more step, with every event and node it may hold, fits the blocks."""
    now, base, events = run.now[0], run.base[0], run.detectors.shape[0]
    return (
        now.rows - base.rows + 2 <= run.log_rows.shape[1]
        and now.trials - base.trials + events * MOST_SUBSTEPS + 1 <= run.log_trials.shape[0]
        and now.events - base.events + events <= run.log_events.shape[0]
        and now.samples - base.samples + run.plan[0].samples + 2 <= run.log_samples.shape[1]
    )


@compiled
def note(run: Run, kind: int, t: float, h: float, state: NDArray[Any]) -> bool:
    """Write one row of the log, and count it if its energies and observables are finite."""
    now, plan, rows = run.now[0], run.plan[0], run.log_rows
    row = now.rows - run.base[0].rows
    rows[0, row], rows[1, row] = t, h
    column = 2
    for i in range(plan.state):
        rows[column + i, row] = state[i]
    column += plan.state
    finite = True
    if run.d.shape[0] > 0:
        run.at[0] = t
        called(run.law[DERIVED], run.at, state, run.p, run.tables, run.places, run.d, run.e, run.samples, 0, run.w)
        for i in range(run.d.shape[0]):
            rows[column + i, row] = run.d[i]
            finite = finite and np.isfinite(run.d[i])
        column += run.d.shape[0]
    reached = h > 0.0  # by a step, which has an error
    if plan.estimates:
        rows[column, row] = now.norm if reached else 0.0
        for i in range(plan.used):
            rows[column + 1 + i, row] = run.e[i] if reached else 0.0
        column += 1 + plan.used
    if run.equations.shape[0] > 0:
        rows[column, row] = run.trial[0].iterations if reached else 0
    run.log_flags[0, row], run.log_flags[1, row] = kind, now.regime
    if finite:
        now.rows += 1
    return finite


@compiled
def note_trial(run: Run, h: float, norm: float, reason: int) -> None:
    """Write one rejected trial."""
    now = run.now[0]
    row = run.log_trials[now.trials - run.base[0].trials]
    row.time, row.step_size, row.error_norm, row.step, row.reason = now.t, h, norm, now.rows - 1, reason
    now.trials += 1


@compiled
def note_samples(run: Run, row: int) -> None:
    """Keep the force evaluations of an accepted trial, which led to a row."""
    now, plan, samples = run.now[0], run.plan[0], run.log_samples
    width = samples.shape[0] - 2
    first = now.samples - run.base[0].samples
    for stage in range(plan.samples):
        samples[0, first + stage] = run.samples[stage * width]
        samples[1, first + stage] = row
        samples[2, first + stage] = stage + 1
        for i in range(1, width):
            samples[2 + i, first + stage] = run.samples[stage * width + i]
    now.samples += plan.samples


@shared
def note_sample(run: Run, t: float, state: NDArray[Any], row: int) -> None:
    """Keep one force evaluation that belongs to no step: at the start, and behind a node of a drive."""
    now, plan, samples = run.now[0], run.plan[0], run.log_samples
    if plan.samples == 0:
        return
    at, used = now.samples - run.base[0].samples, plan.used
    samples[0, at], samples[1, at], samples[2, at] = t, row, 0
    for i in range(used):
        samples[3 + i, at] = state[i]
    found = samples.shape[0] - 3 - used
    for i in range(found):
        samples[3 + used + i, at] = state[state.shape[0] - found + i]
    now.samples += 1


def allocate(layout: Layout, rows: int, *, sampled: int) -> Log:
    """Return an empty log for `rows` rows, with `sampled` force samples a step."""
    events = len(layout.model.events)
    # an odd stride: columns a power of two apart would share one cache set
    rows = (rows + 4) | 1
    samples = (sampled * rows + rows // 4 + 4) | 1 if sampled else 3
    trials = min(rows, 20_000) + events * MOST_SUBSTEPS + 1
    return Log(
        np.zeros(1, BASE),
        _pages((len(layout.row), rows), np.float64),
        _pages((2, rows), np.int8),
        _pages((len(layout.sample), samples), np.float64),
        np.zeros(trials, TRIAL_ROW),
        np.zeros((min(rows, 4_000) if events else 0) + events, EVENT_ROW),
    )


def _pages(shape: tuple[int, int], dtype: type[Any]) -> NDArray[Any]:
    """Return an array on plain pages of memory, touched when it is filled.

    numpy asks the system for huge pages, and putting those together can stall a first run longer than it marches:
    198 ns a step instead of 60, measured on 10**7 steps of the oscillator.
    """
    size = shape[0] * shape[1] * np.dtype(dtype).itemsize
    if size < 1 << 22 or not hasattr(mmap, "MAP_PRIVATE"):
        return np.empty(shape, dtype)
    memory = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
    return np.frombuffer(memory, dtype).reshape(shape)
