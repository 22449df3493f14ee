"""Intervals as a kind of number: the same bounds printed as Python and as LLVM text, with any number of lanes."""

from __future__ import annotations

import ctypes
import math

import numpy as np
import pytest
from numpy.typing import NDArray

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.bounds import POLYNOMIALS, on_curve
from xdynamics.elementary.intervals import Intervals
from xdynamics.kernels import machine
from xdynamics.kernels.interval_program import OPERANDS, VARIABLES
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import INTERVAL, TABLE, WORDS, Compute, Load, Location, Program, StoreTo
from xdynamics.kernels.python_text import python_of

DEGREE = 3  # of the polynomials that variables are enclosed by
COUNT = 20  # numbers that the longest operation takes
PLACES = {name: OPERANDS[name] for name in VARIABLES}
CURVES = {on_curve(name): POLYNOMIALS[name] * (DEGREE + 1) + 2 * PLACES[name] + 6 for name in VARIABLES}
NUMBERS = {name: 2 * count + 3 for name, count in PLACES.items()} | CURVES  # that operations on numbers take
OPERATIONS = OPERANDS | dict.fromkeys(CURVES, 0)
SPECIAL = (0.0, -0.0, 1.0, -1.0, math.pi, 5e-324, 1e-310, 1.7e308, math.inf, -math.inf, math.nan)


def every_operation() -> Program:
    """A program of every operation on intervals of numbers in `y`, whose bounds go to `z`."""
    body = [Load(f"y{k}", Location("y", k)) for k in range(COUNT)]
    body += [Compute(f"i{k}", "between", (f"y{2 * k}", f"y{2 * k + 1}"), INTERVAL) for k in range(3)]
    for number, (name, count) in enumerate(OPERATIONS.items()):
        numbers = tuple(f"y{k}" for k in range(NUMBERS.get(name, 0)))
        given = numbers or tuple(f"i{k}" for k in range(count))
        body.append(Compute(f"f{number}", name, given, INTERVAL))
        for k, bound in enumerate(("low", "high")):
            body.append(Compute(f"{bound}{number}", bound, (f"f{number}",), INTERVAL))
            body.append(StoreTo(Location("z", 2 * number + k), f"{bound}{number}"))
    return Program("everything", "Every operation on intervals.", tuple(body))


def numbers(case: int) -> NDArray[np.float64]:
    """Numbers of any size and sign, the ends of intervals in order, for eight lanes."""
    random = np.random.default_rng([28, case])
    found = random.normal(size=(COUNT, 8)) * 10.0 ** random.uniform(-3, [1, 20, 300][case % 3], (COUNT, 8))
    special = random.random((COUNT, 8)) < 0.1
    found[special] = random.choice(SPECIAL, special.sum())
    if case % 2:
        found[:6] = np.sort(found[:6].reshape(3, 2, 8), axis=1).reshape(6, 8)
    return found


def machine_code(lanes: int, y: NDArray[np.float64]) -> NDArray[np.float64]:
    """What the compiled program writes for some lanes."""
    code = machine.compiled(llvm_of([every_operation()], lanes), ["everything"])
    given, z = np.ascontiguousarray(y[:, :lanes]), np.zeros((2 * len(OPERATIONS), lanes))
    table = np.zeros(WORDS * len(TABLE), np.int64)
    entry = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(code.addresses["everything"])
    entry(table.ctypes.data, given.ctypes.data, z.ctypes.data, z.ctypes.data)
    return z


@pytest.mark.cases(60)
def test_printed_intervals_have_the_bits_of_python(case: int) -> None:
    """Assert that one, four and eight lanes of machine code bound every operation as plain Python does."""
    scope = {"_interval": Intervals(FUNCTIONS, rough=True)}
    exec(python_of(every_operation()), scope)
    y = numbers(case)
    plain = np.zeros((2 * len(OPERATIONS), 8))
    for lane in range(8):
        scope["everything"](None, y[:, lane].tolist(), None, None, None, plain[:, lane], None, None, None)
    for lanes in (1, 4, 8):
        both = machine_code(lanes, y), plain[:, :lanes]
        assert len({np.where(np.isnan(bounds), 7.0, bounds).tobytes() for bounds in both}) == 1, lanes
