"""Vectors that stand where their copies go: fewer copies, the same numbers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.elementary import NAME
from xdynamics.kernels import law_of
from xdynamics.kernels.coalescing import coalesced
from xdynamics.kernels.operations import python_of_set
from xdynamics.kernels.program import Compute, Load, Loop, Program, ProgramCall, StoreTo, element
from xdynamics.kernels.python_text import python_of
from xdynamics.march.configuration import settings_for

SITES = 7
CHAIN = f"""
name = "chain"
[dimensions]
site = {SITES}
[relations.spring]
of = "site"
neighbours = 1
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
m = "1 kg"
k = "3 N m-1"
[mass]
u = "m"
[forces.springs]
over = "spring"
potential = "k*(second(u, spring) - first(u, spring))**2/2"
[forces.ground]
u = "-0.1*k*u"
[initial]
u = "metre*sin(index(site))"
v_u = "0*metre/second"
"""
FOLLOWERS = """s = "metre"
[states.s]
unit = "m"
dims = ["site"]
rate = "(u - s)/second"
"""
EXPLICIT = [name for name, method in xd.METHODS.items() if not method.solves and not method.stepper.foresees]


def executed(programs: list[Program], name: str, sizes: dict[str, int]) -> dict[str, Any]:
    """Run one of some programs in Python, and return all arrays after it."""
    scope: dict[str, Any] = {**python_of_set(NAME), "_empty": lambda count: np.full(count, np.nan)}
    exec("\n".join(map(python_of, programs)), scope)
    numbers = np.random.default_rng(1)
    arrays = {array: numbers.normal(size=count) for array, count in sizes.items()}
    arrays["at"][:5] = 0.3, 0.4, 0.1, 0.5, 0.0
    arrays["p"] = np.abs(arrays["p"]) + 0.5
    scope[name](*arrays.values())
    return arrays


@pytest.mark.parametrize("name", EXPLICIT)
def test_steps_keep_their_numbers(name: str) -> None:
    """Assert that a step of every explicit method leaves the same bits everywhere, with fewer numbers of its own."""
    with_states = not xd.METHODS[name].symplectic and name != "dprkn6"
    model = xd.Model.from_text(CHAIN + FOLLOWERS * with_states)
    law = law_of(settings_for(model, method=name, step=0.1, until=1.0).layout(model), sampled=True)
    layout = law.layout
    lengths = {"y": layout.record.size, "z": layout.record.size, "e": layout.used.size}
    by_name = {program.name: program for program in law.programs}
    fewer = [coalesced(program, by_name, lengths) for program in law.programs]
    sizes = {"at": 16, "y": lengths["y"], "p": 50, "tables": 1, "pieces": 1, "z": lengths["z"]}
    sizes |= {"e": lengths["e"], "samples": 5000, "w": max(1, law.memory)}
    for program in ("forces", "propose"):
        plain, other = (executed(list(texts), program, sizes) for texts in (law.programs, fewer))
        for array, values in plain.items():
            assert values.tobytes() == other[array].tobytes(), array
    own = [sum(by_name["propose"].local.values()), sum(fewer[[*by_name].index("propose")].local.values())]
    assert own[1] <= own[0] - 2 * SITES


def vectors(*lines: tuple[str, int, str, int]) -> Program:
    """Return a program of copies between vectors of five: source, first, target, first; from "x" to itself it doubles."""
    body = []
    for i, (source, begin, target, first) in enumerate(lines):
        names = f"_a{i}", f"_b{i}"
        inner: tuple[Any, ...] = (Load(names[0], element(source, begin)),)
        if source == target:
            inner += (Compute(names[1], "multiply", (names[0], 2.0)),)
        body.append(Loop("i", 5, (*inner, StoreTo(element(target, first), names[len(inner) - 1]))))
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
    fewer = coalesced(program, {}, {"y": 10, "z": 10, "e": 10})
    assert sum(fewer.local.values()) == left
    plain, other = (executed([text], "one", SIZES) for text in (program, fewer))
    assert all(values.tobytes() == other[array].tobytes() for array, values in plain.items())


def test_what_is_not_understood_stays() -> None:
    """Assert that rows of the log, and programs that call what is not known, are left as they are."""
    copies = vectors(("y", 0, "x", 0), ("x", 0, "z", 0))
    row = replace(copies, spread=True)
    assert coalesced(row, {}, SIZES) is row
    calls = replace(copies, body=(*copies.body, ProgramCall("forces", "at", "z", "z")))
    assert coalesced(calls, {}, SIZES) is calls
