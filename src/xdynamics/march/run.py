"""All that a march knows, in flat arrays: phases of the loop change it in place.

Rows of numbers with names are arrays of one record, because compiled code cannot hand records about; their fields are
read and set as ``run.now[0].t``. The bytes of everything but the log and the law's addresses are a march's whole memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Records = NDArray[Any]


def _record(floats: str, whole: str) -> np.dtype[Any]:
    fields = [(name, "f8") for name in floats.split()] + [(name, "i8") for name in whole.split()]
    return np.dtype((np.record, fields))


# What a march does not change. step_size is 0 where the grid is given or steps are chosen; a grid time as close as
# `snap` to a node is that node; order is k of an error that falls as h**k; divisor is 2**order - 1 of the method.
PLAN = _record(
    "start end snap step_size rtol order safety least greatest min_step max_step first_step most_steps divisor",
    "adaptive estimates halved extrapolated limited stages samples coordinates used state",
)
# Where it stands: step is to be tried next, step_norm the error norm of the last accepted step, h the step last tried.
NOW = _record(
    "t h norm step step_norm first_step",
    "status regime rows trials events samples grid node on_grid rejected evaluations",
)
# A step that was made and is yet to be judged; iterations are -1 where Newton's method did not converge.
TRIAL = _record("t h", "landing iterations")
# How to look for each event.
DETECTOR = _record("tolerance", "direction stops")
# What Newton's method solves: unknowns and entries of the matrix stand in lists of their own, first to last.
EQUATIONS = _record("", "evaluations residuals first_unknown unknowns first_entry entries")
# Rows of the log.
TRIAL_ROW = _record("time step_size error_norm", "step reason")
EVENT_ROW = _record("time left residual slope", "row_before row_after detector kind direction")
# The counts of `NOW` at the log's first row.
BASE = _record("", "rows trials events samples")


class Log(NamedTuple):
    """Blocks of a log; a column of the record is one row of `rows` and `samples`, so that it is contiguous."""

    base: Records
    rows: Floats  # `Layout.row`: time, step_size, the state, energies, observables, errors, iterations
    flags: NDArray[np.int8]  # kind, regime
    samples: Floats  # `Layout.sample`: time, step, stage, what was used, what was found
    trials: Records
    events: Records


class Run(NamedTuple):
    """A march of one model by one method. States are arrays in the order of `Layout.record`."""

    plan: Records
    now: Records
    trial: Records
    located: Records  # the trial that ends at an event
    at: Floats  # t, t1, h, s, regime: what a law is told of a step
    y: Floats  # the state at now.t
    z: Floats  # the state that the trial led to
    e: Floats  # its error
    g: Floats  # event functions at y
    g1: Floats  # at z
    d: Floats  # energies and observables of the row that is noted
    samples: Floats  # force evaluations of the trial, one behind the other
    half: Floats  # the state after half a step
    whole: Floats  # the state after a whole one, to judge two halves by
    located_z: Floats
    located_e: Floats
    located_g: Floats
    located_samples: Floats
    lows: Floats  # left end of each event's bracket, as a step
    slopes: Floats  # time derivatives of the event functions
    p: Floats  # parameters, unit constants, pi
    tables: Floats
    places: Whole  # of the tables, and the piece that a drive of time goes through
    of_time: Whole  # drives of time
    atol: Floats
    nodes: Floats  # times to land on between start and end
    grid: Floats  # times of a given grid
    steps: Floats  # the step to each of them
    detectors: Records
    w: Floats  # vectors of an implicit method
    matrix: Floats
    right: Floats
    equations: Records
    unknowns: Whole
    entries: Whole
    law: Whole  # addresses
    log: Log


FLEETING = ("law", "log")  # no part of the memory: addresses belong to a process, the log to whoever reads it


def memory_of(run: Run) -> bytes:
    """Return all that a march knows, to go on from in any process."""
    return b"".join(array.tobytes() for name, array in run._asdict().items() if name not in FLEETING)


def restore(run: Run, memory: bytes) -> None:
    """Put a memory into a run of the same model and settings.

    Raises
    ------
    ValueError
        If it is of another size, and so of another run.
    """
    arrays = [array for name, array in run._asdict().items() if name not in FLEETING]
    if sum(array.nbytes for array in arrays) != len(memory):
        raise ValueError(f"a memory of {len(memory)} bytes is none of this run, which has {sum(one.nbytes for one in arrays)}")
    first = 0
    for array in arrays:
        array.view(np.uint8).reshape(-1)[:] = np.frombuffer(memory, np.uint8, array.nbytes, first)
        first += array.nbytes
