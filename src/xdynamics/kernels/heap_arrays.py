"""Large arrays of a program, which are on the heap: the lines that ask for them, and what happens where there is no room.

A program cannot raise. One that was given no memory calls a function of this module, and returns as if a number were
missing; the march, which then ends or goes on with numbers that mean nothing, asks `is_lacking` and raises.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

MOST_ON_STACK = 10_000  # numbers of an array; larger ones are on the heap
LACKING = "xdynamics_lacking"  # what a program calls that was given no memory
DECLARED = f"declare noalias ptr @malloc(i64)\ndeclare void @free(ptr)\ndeclare void @{LACKING}()"

_LACKED: list[bool] = []


@ctypes.CFUNCTYPE(None)
def lack() -> None:
    """Note that a program was given no memory."""
    _LACKED.append(True)


def is_lacking() -> bool:
    """Whether a program was given no memory since this was asked last."""
    lacked = bool(_LACKED)
    _LACKED.clear()
    return lacked


def refusal(arrays: Sequence[str], unsound: str, lanes: int) -> list[str]:
    """Return the lines after which arrays are there; without memory for one, the program says so and returns nan.

    Parameters
    ----------
    arrays : sequence of str
        At least one, all asked for.
    unsound : str
        Where the number is that says whether results are finite, one for each lane.
    lanes : int
    """
    lines, any_lacks = [], "false"
    for k, name in enumerate(arrays):
        lines.append(f"%lacks{k} = icmp eq ptr %{name}, null")
        lines.append(f"%lack{k} = or i1 {any_lacks}, %lacks{k}")
        any_lacks = f"%lack{k}"
    lines += [f"br i1 {any_lacks}, label %lacking, label %given", "lacking:"]
    lines += [f"call void @free(ptr %{name})" for name in arrays]
    lines.append(f"call void @{LACKING}()")
    for lane in range(lanes):
        lines.append(f"%lane{lane}.at = getelementptr double, ptr {unsound}, i64 {lane}")
        lines.append(f"store double 0x7FF8000000000000, ptr %lane{lane}.at, align 8")
    return [*lines, "ret void"]
