"""Programs with loops: gravity of N bodies, a lattice, links; the same for intervals, and how they are called."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.double_double.functions import DoubleDoubles
from xdynamics.elementary.intervals import Intervals
from xdynamics.kernels import machine
from xdynamics.kernels.drive_tables import PYTHON_TABLES
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import (
    ARRAYS,
    INTERVAL,
    TABLE,
    WORDS,
    Compute,
    Load,
    Location,
    Loop,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
)
from xdynamics.kernels.python_text import PYTHON, python_of

Floats = NDArray[np.float64]
AXES = "xyz"


def gravity(n: int, *, by_body: bool = False) -> Program:
    """Accelerations of n bodies, `z`, by their places, `y`, and masses, `p`; coordinates axis by axis, or body by body."""

    def vector(array: str, axis: int, index: str) -> Location:
        return Location(array, axis, ((index, 3),)) if by_body else Location(array, axis * n, ((index, 1),))

    inner = [Load(f"{a}j", vector("y", k, "j")) for k, a in enumerate(AXES)]
    inner += [Load("mj", Location("p", 0, (("j", 1),))), Ordinal("nj", "j"), Compute("other", "unequal", ("ni", "nj"))]
    inner += [Compute(f"d{a}", "subtract", (f"{a}j", f"{a}i")) for a in AXES]
    inner += [Compute(f"s{a}", "multiply", (f"d{a}", f"d{a}")) for a in AXES]
    inner += [Compute("sxy", "add", ("sx", "sy")), Compute("d2", "add", ("sxy", "sz")), Compute("d", "sqrt", ("d2",))]
    inner += [Compute("d3", "multiply", ("d2", "d")), Compute("g", "divide", ("mj", "d3"))]
    inner += [Compute(f"f{a}", "multiply", ("g", f"d{a}")) for a in AXES]
    body = [Ordinal("ni", "i"), *(Load(f"{a}i", vector("y", k, "i")) for k, a in enumerate(AXES))]
    terms, totals = tuple(f"f{a}" for a in AXES), tuple(f"a{a}" for a in AXES)
    body.append(Reduction("j", n, tuple(inner), terms, totals, where="other"))
    body += [StoreTo(vector("z", k, "i"), f"a{a}") for k, a in enumerate(AXES)]
    return Program("gravity", "Accelerations by gravity.", (Loop("i", n, tuple(body)),))


def plain_gravity(places: Floats, masses: Floats) -> Floats:
    """The same in plain Python, of places by axis and body."""
    found = np.zeros_like(places)
    for i in range(masses.size):
        for j in range(masses.size):
            if i != j:
                d = [places[k, j] - places[k, i] for k in range(3)]
                d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
                g = masses[j] / (d2 * np.sqrt(d2))
                for k in range(3):
                    found[k, i] += g * d[k]
    return found


def enclosed(program: Program) -> Program:
    """The program for intervals: in place of every number two, its lower and its upper bound, one after the other."""

    def doubled(place: Location, more: int) -> Location:
        return Location(place.array, 2 * place.offset + more, tuple((index, 2 * by) for index, by in place.strides))

    def lines(body: tuple[Any, ...], exact: set[str]) -> tuple[Any, ...]:
        found: list[Any] = []
        for line in body:
            match line:
                case Load():
                    ends = [f"{line.target}_{end}" for end in ("low", "high")]
                    found += [Load(end, doubled(line.location, k)) for k, end in enumerate(ends)]
                    found.append(Compute(line.target, "between", tuple(ends), INTERVAL))
                case StoreTo():
                    for k, end in enumerate(("low", "high")):
                        found.append(Compute(f"{line.value}_{end}", end, (line.value,), INTERVAL))
                        found.append(StoreTo(doubled(line.location, k), f"{line.value}_{end}"))
                case Compute() if exact.issuperset(line.arguments):
                    exact.add(line.target)
                    found.append(line)
                case Compute():
                    found.append(replace(line, kind=INTERVAL))
                case Ordinal():
                    exact.add(line.target)
                    found.append(line)
                case Loop():
                    found.append(replace(line, body=lines(line.body, exact)))
                case Reduction():
                    found.append(replace(line, body=lines(line.body, exact), kind=INTERVAL))
        return tuple(found)

    return replace(program, body=lines(program.body, set()))


def compiled(program: Program, *called: Program, **sizes: int) -> Any:
    """Return the machine code of a program, and of those that it calls, as a function of arrays by their names."""
    return lambda **arrays: bound(program, *called, **sizes, **arrays)()


def bound(
    program: Program, *called: Program, runs: int = 1, abreast: int = 1, apart: int = 0, **arrays: Floats
) -> Callable[[], None]:
    """Compile the program and return a call of it with these arrays; elements of a row of the log are so far apart."""
    code = machine.Code(machine.build_object(llvm_of([*called, program], runs, abreast=abreast)), [program.name])
    entry = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(code.addresses[program.name])
    table = np.zeros(WORDS * len(TABLE), np.int64)
    for name, array in arrays.items():
        table[WORDS * ARRAYS.index(name)] = array.ctypes.data
    table[WORDS * TABLE.index("rows") + 2] = apart
    given = [arrays[name].ctypes.data if name in arrays else 0 for name in ("y", "z", "samples")]
    call: Callable[[], None] = partial(entry, table.ctypes.data, *given)
    _KEPT.append((code, table, arrays))  # as long as the process
    return call


_KEPT: list[Any] = []


def in_python(program: Program) -> Any:
    """Return the program as printed Python, called with arrays by their names."""
    scope = PYTHON | PYTHON_TABLES | {"_interval": Intervals(FUNCTIONS, rough=True), "_empty": np.empty}
    scope["_double_double"] = DoubleDoubles()
    exec(python_of(program), scope)

    def call(**arrays: Any) -> None:
        with np.errstate(all="ignore"):  # of passes that are left out
            scope[program.name](*(arrays.get(name) for name in ARRAYS))

    return call
