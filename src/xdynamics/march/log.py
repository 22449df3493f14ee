"""The log of a march: blocks of rows, filled by compiled code, read as columns."""

from __future__ import annotations

import mmap
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Layout

Floats = NDArray[np.float64]
Words = NDArray[np.int8]

MOST_SUBSTEPS = 200  # of one event's bracket; halving alone needs 60


class Control(NamedTuple):
    """How steps are chosen; without `adaptive` they are given and the tolerances only scale the errors."""

    adaptive: bool
    rtol: float
    atol: tuple[float, ...]  # of everything a force evaluation uses
    order: float  # k: the error of a step falls as h**k
    safety: float
    least: float  # factors between one step and the next
    greatest: float
    min_step: float
    max_step: float
    first: float  # first step; 0 has it chosen
    most_steps: float  # accepted and rejected


class Plan(NamedTuple):
    """What a march does not change."""

    start: float
    step_size: float  # of the uniform grid; 0 where the grid is given
    grid: Floats  # times of a given grid, from the start on
    steps: Floats  # the step to each of them
    control: Control
    nodes: Floats  # times to land on; the end is the last
    snap: float  # a grid time this close to a node is that node
    directions: tuple[int, ...]
    tolerances: tuple[float, ...]
    stops: tuple[bool, ...]
    parameters: tuple[float, ...]
    tables: tuple[tuple[Floats, Floats], ...]
    sampled: int  # force samples that a step logs; 0 where they are off


class Tally(NamedTuple):
    """How many rows of each kind there are since the run began."""

    rows: int
    trials: int
    events: int
    samples: int


class Pace(NamedTuple):
    """What step control remembers."""

    step: float  # to try next
    norm: float  # of the error of the last accepted step
    rejected: bool  # whether the last trial was
    first: float  # the first step


class Memory(NamedTuple):
    """All that a march knows between two blocks; it goes on from this to the same bits."""

    status: int
    t: float
    h: float  # the step last tried
    grid: int  # grid times passed
    node: int  # nodes passed
    on_grid: bool  # whether t is a grid time
    state: tuple[float, ...]
    trial: tuple[float, ...]  # the state last proposed
    values: tuple[float, ...]  # of the event functions at t
    pieces: tuple[int, ...]  # of the drives of time
    norm: float  # of the error of the trial last proposed
    pace: Pace
    evaluations: int  # of the forces, those of rejected trials included
    tally: Tally


class Trial(NamedTuple):
    """A step that was made and is yet to be judged."""

    t: float  # where it ends
    h: float
    landing: int  # on a grid time, a node or both
    state: tuple[float, ...]
    error: tuple[float, ...]
    values: tuple[float, ...]  # of the event functions
    effort: tuple[int, int]  # force evaluations, Newton iterations
    samples: int  # of the run, with those of this step


class Log(NamedTuple):
    """Blocks of a log; one row of a table is one column here, so that a variable is contiguous.

    Whole numbers stand among the floats, which hold them exactly; the record gives them their own type.
    """

    rows: Floats  # `Layout.row`: time, step_size, the state, energies, observables
    row_flags: Words  # kind, regime
    samples: Floats  # `Layout.sample`: time, step, stage, what was used, what was found
    trials: Floats  # time, step_size, error_norm, step, reason
    events: Floats  # time, left, right, residual, slope, row before, row after, detector, kind, direction
    lows: Floats  # scratch: left end of each event's bracket, as a step


def note_trial(log: Log, at: int, memory: Memory, h: float, norm: float, reason: int) -> None:
    """Write one rejected trial."""
    log.trials[0, at] = memory.t
    log.trials[1, at] = h
    log.trials[2, at] = norm
    log.trials[3, at] = memory.tally.rows - 1
    log.trials[4, at] = reason


def allocate(layout: Layout, rows: int, *, sampled: int) -> Log:
    """Return an empty log for `rows` rows, with `sampled` force samples a step."""
    events = max(1, len(layout.model.events))
    # an odd stride: columns a power of two apart would share one cache set
    rows = (rows + 4) | 1
    samples = (sampled * rows + rows // 4 + 4) | 1 if sampled else 1
    trials = min(rows, 20_000) + events * MOST_SUBSTEPS + 1
    event_rows = min(rows, 4_000) + events
    return Log(
        _pages((len(layout.row), rows), np.float64),
        _pages((2, rows), np.int8),
        _pages((len(layout.sample), samples), np.float64),
        np.empty((5, trials)),
        np.empty((10, event_rows)),
        np.zeros(events),
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
