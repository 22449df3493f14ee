"""Arrays that the programs of a law are called with."""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import Law
from xdynamics.kernels.compiling import UNCOMPILED
from xdynamics.kernels.drive_tables import concatenated_tables
from xdynamics.kernels.program import AT, DEVIATION, TABLE, WORDS
from xdynamics.model.motion import constants, drive_pieces
from xdynamics.units import UNSCALED

# in the place of the engine, which laws of contacts of many bodies call: what does nothing. As a float its address is
# next to 0, the key of what does nothing where the law is Python
_nothing = ctypes.CFUNCTYPE(None, ctypes.c_int64, ctypes.c_double, ctypes.c_int64)(lambda *_: None)
_NO_ENGINE = np.array([0, ctypes.cast(_nothing, ctypes.c_void_p).value], np.int64).view(float)
UNCOMPILED[0] = lambda *_: None


class Bench:
    """Arrays that a law's programs are called with, each number once for every lane."""

    def __init__(self, one: Law, lanes: int, states: NDArray[np.float64], steps: NDArray[np.float64]) -> None:
        self.law, model, layout = one, one.layout.model, one.layout
        tables, places = concatenated_tables(drive_pieces(model, UNSCALED))
        kinds = 1 + layout.is_doubled  # beside each number what is left of it
        self.at = np.zeros((DEVIATION + 1, lanes))
        self.at[1], self.at[2], self.at[3] = steps, steps, 0.3
        self.y = np.zeros((len(layout.record), lanes))
        self.y[: len(layout.used)] = states
        known = [*constants(model).values(), *(_NO_ENGINE if model.assemblies else ())]
        self.p = np.repeat(np.array(known * kinds)[:, None], lanes, axis=1)
        self.tables, self.pieces = tables, np.repeat(places[:, None], lanes, axis=1)
        self.pieces[2::3] = 1
        # more than any program fills: the table of contacts is the longest
        self.z, self.e = (
            np.zeros((len(layout.record) + len(layout.row) + 500, lanes)),
            np.zeros((len(layout.used), lanes)),
        )
        self.samples = np.zeros((20 * max(100, layout.sample_width), lanes))
        self.w = np.zeros((max(1, kinds * one.steps.memory + 3 * len(layout.smooth)), lanes))
        if layout.is_doubled:
            self._set_rests()
        assert len(TABLE) == len(self.arrays()) + 1
        assert WORDS == 3
        self.table = np.array([(one.ctypes.data, one.shape[0], 1) for one in (*self.arrays(), self.z)], np.int64)

    def _set_rests(self) -> None:
        """Leave less than half a spacing of each time, constant and variable."""
        random = np.random.default_rng(3)
        first, numbers = self.law.layout.used.size + self.law.layout.evaluation.size, len(self.p) // 2
        for array, distance, size in (
            (self.at, len(AT), 3),
            (self.y, first, self.law.layout.used.size),
            (self.p, numbers, numbers),
        ):
            array[distance : distance + size] = array[:size] * random.uniform(-5e-17, 5e-17, array[:size].shape)

    def arrays(self) -> list[NDArray[np.float64]]:
        """In the order of a program's pointers."""
        return [self.at, self.y, self.p, self.tables, self.pieces, self.z, self.e, self.samples, self.w]

    def call(self, address: int) -> None:
        """Call a compiled program."""
        assert address not in UNCOMPILED, "without numba a law has keys, no addresses: a call of one ends the process"
        call = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(address)
        call(*(one.ctypes.data for one in (self.table, self.y, self.z, self.samples)))

    def call_plainly(self, key: int) -> None:
        """Call a printed one, lane 0 being all there is."""
        UNCOMPILED[key](*(array if array is self.tables else array[:, 0] for array in self.arrays()))
