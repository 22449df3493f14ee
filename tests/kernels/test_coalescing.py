"""Vectors that stand where their copies go: fewer copies, the same numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from cases.chain_steps import EXPLICIT, SITES, chain_law, executed, left_by, lengths_of
from xdynamics.kernels.program import Compute, Load, Loop, Program, ProgramCall, StoreTo, loop_element
from xdynamics.kernels.shared_storage import coalesce_copies


@pytest.mark.parametrize("name", EXPLICIT)
def test_steps_keep_their_numbers(name: str) -> None:
    """Assert that a step of every explicit method leaves the same bits everywhere, with fewer numbers of its own."""
    law = chain_law(name, sampled=True)
    by_name = {program.name: program for program in law.programs}
    fewer = [coalesce_copies(program, by_name, lengths_of(law)) for program in law.programs]
    for program in ("forces", "propose"):
        plain, other = (left_by(law, texts, program) for texts in (law.programs, fewer))
        for array, values in plain.items():
            assert values.tobytes() == other[array].tobytes(), array
    own = [sum(by_name["propose"].local.values()), sum(fewer[[*by_name].index("propose")].local.values())]
    assert own[1] <= own[0] - 2 * SITES


def vectors(*lines: tuple[str, int, str, int]) -> Program:
    """Return a program of copies between vectors of five: source, first, target, first; from "x" to itself it doubles."""
    body = []
    for i, (source, begin, target, first) in enumerate(lines):
        names = f"_a{i}", f"_b{i}"
        inner: tuple[Any, ...] = (Load(names[0], loop_element(source, begin)),)
        if source == target:
            inner += (Compute(names[1], "multiply", (names[0], 2.0)),)
        body.append(Loop("i", 5, (*inner, StoreTo(loop_element(target, first), names[len(inner) - 1]))))
    return Program("one", "About.", tuple(body), local={"x": 5})


SIZES = {"at": 8, "y": 10, "p": 1, "tables": 1, "pieces": 1, "z": 10, "e": 10, "samples": 1, "w": 1}


@pytest.mark.parametrize(
    ("lines", "left"),
    [
        ([("y", 0, "x", 0), ("x", 0, "z", 2)], 0),  # it stands in z
        ([("y", 0, "x", 0), ("x", 0, "z", 2), ("x", 0, "x", 0), ("x", 0, "e", 0)], 0),  # not in z, which is to keep it
        ([("y", 0, "x", 0), ("x", 0, "z", 2), ("x", 0, "x", 0), ("x", 0, "z", 3)], 5),  # in either it would be lost
        ([("z", 0, "x", 0), ("y", 0, "z", 0), ("x", 0, "z", 5), ("x", 0, "e", 5)], 0),
        ([("z", 0, "x", 0), ("x", 0, "z", 1)], 5),  # each element would be that before it
    ],
)
def test_only_what_nothing_tells_apart_is_moved(lines: list[tuple[str, int, str, int]], left: int) -> None:
    """Assert that a vector is put where its copy goes only where every line finds the same as before."""
    program = vectors(*lines)
    fewer = coalesce_copies(program, {}, {"y": 10, "z": 10, "e": 10})
    assert sum(fewer.local.values()) == left
    plain, other = (executed([text], "one", SIZES) for text in (program, fewer))
    assert all(values.tobytes() == other[array].tobytes() for array, values in plain.items())


def test_what_is_not_understood_stays() -> None:
    """Assert that rows of the log, and programs that call what is not known, are left as they are."""
    copies = vectors(("y", 0, "x", 0), ("x", 0, "z", 0))
    row = replace(copies, spread=True)
    assert coalesce_copies(row, {}, SIZES) is row
    calls = replace(copies, body=(*copies.body, ProgramCall("forces", "at", "z", "z")))
    assert coalesce_copies(calls, {}, SIZES) is calls
