"""All that a march knows, in flat arrays: phases of the loop change it in place.

Rows of numbers with names are arrays of one record, because compiled code cannot hand records about; their fields are
read and set as ``run.now[0].t``. The bytes of everything but the log and the law's addresses are a march's whole memory.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


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


# Every array of a run: kind of its elements, dimensions. The last, behind `law`, are the log and not memory.
ARRAYS: dict[str, tuple[Any, int]] = {
    "plan": (PLAN, 1),
    "now": (NOW, 1),
    "trial": (TRIAL, 1),
    "located": (TRIAL, 1),  # the trial that ends at an event
    "at": ("f8", 1),  # t, t1, h, s, regime: what a law is told of a step
    "y": ("f8", 1),  # the state at now.t
    "z": ("f8", 1),  # the state that the trial led to
    "e": ("f8", 1),  # its error
    "g": ("f8", 1),  # event functions at y
    "g1": ("f8", 1),  # at z
    "d": ("f8", 1),  # energies and observables of the row that is noted
    "samples": ("f8", 1),  # force evaluations of the trial, one behind the other
    "half": ("f8", 1),  # the state after half a step
    "whole": ("f8", 1),  # the state after a whole one, to judge two halves by
    "located_z": ("f8", 1),
    "located_e": ("f8", 1),
    "located_g": ("f8", 1),
    "located_samples": ("f8", 1),
    "lows": ("f8", 1),  # left end of each event's bracket, as a step
    "slopes": ("f8", 1),  # time derivatives of the event functions
    "p": ("f8", 1),  # parameters, unit constants, pi
    "tables": ("f8", 1),
    "places": ("i8", 1),  # of the tables, and the piece that a drive of time goes through
    "of_time": ("i8", 1),  # drives of time
    "atol": ("f8", 1),
    "nodes": ("f8", 1),  # times to land on between start and end
    "grid": ("f8", 1),  # times of a given grid
    "steps": ("f8", 1),  # the step to each of them
    "detectors": (DETECTOR, 1),
    "w": ("f8", 1),  # vectors of an implicit method
    "matrix": ("f8", 1),
    "right": ("f8", 1),
    "equations": (EQUATIONS, 1),
    "unknowns": ("i8", 2),
    "entries": ("i8", 2),
    "law": ("i8", 1),  # addresses
    "base": (BASE, 1),  # the counts of `now` at the log's first row
    "log_rows": ("f8", 2),  # `Layout.row`: time, step_size, the state, energies, observables, errors, iterations
    "log_flags": ("i1", 2),  # kind, regime
    "log_samples": ("f8", 2),  # `Layout.sample`: time, step, stage, what was used, what was found
    "log_trials": (TRIAL_ROW, 1),
    "log_events": (EVENT_ROW, 1),
}
LOG = ("base", "log_rows", "log_flags", "log_samples", "log_trials", "log_events")
FLEETING = ("law", *LOG)  # no part of the memory: addresses belong to a process, the log to whoever reads it


class Run:
    """A march of one model by one method: `ARRAYS` as attributes. States are in the order of `Layout.record`.

    Parameters
    ----------
    **arrays : ndarray
        Contiguous, each of the kind that `ARRAYS` says.
    """

    __slots__ = (*ARRAYS, "_table", "address")

    def __init__(self, **arrays: NDArray[Any]) -> None:
        self._table = np.zeros((len(ARRAYS), 3), np.int64)
        self.address = int(self._table.ctypes.data)
        self.put(**arrays)

    def put(self, **arrays: NDArray[Any]) -> None:
        """Put arrays in their places, for compiled code too; new blocks of a log, say."""
        for name, array in arrays.items():
            place = list(ARRAYS).index(name)
            setattr(self, name, array)
            self._table[place] = array.ctypes.data, array.shape[0], array.shape[-1]

    def memory(self) -> bytes:
        """Return all that the march knows, to go on from in any process."""
        return b"".join(array.tobytes() for array in self._remembered())

    def restore(self, memory: bytes) -> None:
        """Put a memory into a run of the same model and settings.

        Raises
        ------
        ValueError
            If it is of another size, and so of another run.
        """
        size = sum(array.nbytes for array in self._remembered())
        if size != len(memory):
            raise ValueError(f"a memory of {len(memory)} bytes is none of this run, which has {size}")
        first = 0
        for array in self._remembered():
            array.view(np.uint8).reshape(-1)[:] = np.frombuffer(memory, np.uint8, array.nbytes, first)
            first += array.nbytes

    def _remembered(self) -> list[NDArray[Any]]:
        return [getattr(self, name) for name in ARRAYS if name not in FLEETING]
