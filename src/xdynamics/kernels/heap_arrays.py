"""Large arrays of a program, which are on the heap: the lines that ask for them, and what happens where there is no room.

A program cannot raise. One that was given no memory calls a function of this module, and returns as if a number were
missing. It is called on the thread on which the program runs, so what it notes belongs to one call of compiled code.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence

MOST_ON_STACK = 10_000  # numbers of an array; larger ones are on the heap
LACKING = "xdynamics_lacking"  # what a program calls that was given no memory
DECLARED = f"declare noalias ptr @malloc(i64)\ndeclare void @free(ptr)\ndeclare void @{LACKING}()"


class _Allocation(threading.local):
    """What programs were given on one thread."""

    refused = False


_ALLOCATION = _Allocation()


@ctypes.CFUNCTYPE(None)
def note_refusal() -> None:
    """Note that a program was given no memory."""
    _ALLOCATION.refused = True


def forget_refusal() -> None:
    """Begin anew on this thread, before a call of compiled code."""
    _ALLOCATION.refused = False


def was_refused() -> bool:
    """Whether a program on this thread was given no memory since then."""
    return _ALLOCATION.refused


def refusal_lines(arrays: Sequence[str], unsound: str, lanes: int) -> list[str]:
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
