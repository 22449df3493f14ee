"""Loops in which every two elements meet once: rows side by side have the bits of plain Python."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cases.array_programs import compiled, in_python
from xdynamics.kernels.link_rows import link_rows
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.program import Compute, Line, Load, Location, Loop, Program, Reduction, StoreTo, loop_element

WIDTHS = (1, 4, 8, 16)
MEETING = (
    Load("qj", loop_element("p", 0, "j")),
    Compute("sum", "add", ("qi", "qj")),
    Compute("force", "divide", ("qi", "sum")),
    Compute("opposite", "negative", ("force",)),
)
ADDED = (
    Load("own", loop_element("z", 0, "j")),
    Compute("more", "add", ("own", "opposite")),
    StoreTo(loop_element("z", 0, "j"), "more"),
)


def meetings(n: int, *links: Line, after: tuple[Line, ...] = ()) -> Program:
    """Forces between every two of n elements, `z`, of numbers `p`; each pair once."""
    new = Compute("new", "add", ("total", "force"))
    row = Reduction("j", n, (*MEETING, *(links or ADDED), new), ("new",), ("total",), "newest", -0.0, below="i")
    body = (Load("qi", loop_element("p", 0, "i")), row, *(after or (StoreTo(loop_element("z", 0, "i"), "total"),)))
    return Program("meetings", "Forces of every two.", (Loop("i", n, body),))


def by_hand(q: np.ndarray) -> np.ndarray:
    """The same by plain loops over all others, ascending."""
    found = np.zeros_like(q)
    for i in range(q.size):
        total = -0.0
        for j in range(q.size):
            if j != i:
                total += q[i] / (q[i] + q[j]) if j < i else -(q[j] / (q[j] + q[i]))
        found[i] = total
    return found


@pytest.mark.parametrize("n", [2, 8, 9, 15, 16, 18, 33, 40])
def test_each_pair_once_has_the_bits_of_ascending_sums(n: int) -> None:
    """Assert that 1, 4, 8, 16 rows at once, and plain Python, add up what all others give in their order."""
    q = np.random.default_rng(n).normal(size=n) * 10.0 ** np.arange(n)[::-1]
    wanted = by_hand(q)
    for call in (in_python(meetings(n)), *(compiled(meetings(n), abreast=wide) for wide in WIDTHS)):
        z = np.full(n, 7.0)
        call(p=q, z=z)
        assert z.tobytes() == wanted.tobytes()


@pytest.mark.parametrize("runs", [4, 8])
def test_runs_side_by_side_meet_once(runs: int) -> None:
    """Assert that every lane has the bits of a single run."""
    q = np.random.default_rng(runs).normal(size=(19, runs))
    z = np.zeros_like(q)
    compiled(meetings(19), runs=runs)(p=q, z=z)
    assert all(z[:, lane].tobytes() == by_hand(q[:, lane].copy()).tobytes() for lane in range(runs))


def test_rows_are_side_by_side_in_tiles() -> None:
    """Assert one quotient of all rows of a tile, half as many rows where there would be less than two, and none alone."""
    for n, rows in ((8, 4), (15, 4), (16, 8), (17, 8), (40, 8)):
        text = llvm_of([meetings(n)], abreast=8)
        assert text.count(f"fdiv <{rows} x double>") == 1
        assert text.count("fdiv") == 1
    assert llvm_of([meetings(7)], abreast=8).count("fdiv double") == 21


def test_the_text_is_as_long_for_any_number() -> None:
    """Assert that a thousand elements take as many lines as forty, and any remainder by eight as many as any other."""
    for numbers in ((40, 1000), (41, 42, 47, 1003)):
        assert len({llvm_of([meetings(n)], abreast=8).count("\n") for n in numbers}) == 1


def energies(n: int) -> Program:
    """A sum over every two of n elements, each with those after it, of terms that take long: by the total so far."""
    links = (
        Load("qj", loop_element("p", 0, "j")),
        Compute("both", "add", ("qi", "qj")),
        Compute("term", "divide", ("qi", "both")),
        Compute("half", "multiply", ("total", 0.5)),
        Compute("new", "add", ("half", "term")),
    )
    row = Reduction("j", n, links, ("new",), ("total",), "newest", ("so_far",), above="i")
    rows = Reduction("i", n, (Load("qi", loop_element("p", 0, "i")), row), ("total",), ("so_far",), "newest")
    return Program("energies", "A sum.", (rows, StoreTo(Location("z"), "so_far")))


@pytest.mark.parametrize("n", [2, 7, 8, 9, 17, 40])
def test_terms_side_by_side_are_joined_one_by_one(n: int) -> None:
    """Assert that a total of quotients, halved at each, has the bits of plain Python however many come at once."""
    q, wanted = np.random.default_rng(n).normal(size=n) * 10.0 ** np.arange(n)[::-1], 0.0
    for i in range(n):
        for j in range(i + 1, n):
            wanted = wanted * 0.5 + q[i] / (q[i] + q[j])
    for call in (in_python(energies(n)), *(compiled(energies(n), abreast=wide) for wide in WIDTHS)):
        z = np.full(1, 7.0)
        call(p=q, z=z)
        assert z[0] == wanted
    assert "fdiv <8 x double>" in llvm_of([energies(40)], abreast=8)


SET = StoreTo(loop_element("z", 0, "i"), "total")
DEPENDENT = {
    "what is added is another sum's": (
        *ADDED[:2],
        Load("far", loop_element("z", 1, "j")),
        replace(ADDED[1], arguments=("own", "far")),
        ADDED[2],
    ),
    "what is added is the row's own sum": (ADDED[0], replace(ADDED[1], arguments=("own", "total")), ADDED[2]),
    "a sum is set, not added to": (StoreTo(loop_element("z", 0, "j"), "force"),),
    "a number is set besides": (*ADDED, StoreTo(loop_element("z", 60, "j"), "force")),
    "a sum is read twice": (*ADDED, Compute("square", "multiply", ("own", "own"))),
    "a sum is multiplied": (ADDED[0], replace(ADDED[1], operation="multiply"), ADDED[2]),
    "two sums are in one place": (
        *ADDED,
        Load("l", loop_element("z", 0, "j")),
        Compute("m", "add", ("l", 1.0)),
        StoreTo(loop_element("z", 0, "j"), "m"),
    ),
    "a sum of all": (Load("l", Location("z", 3)), Compute("m", "add", ("l", "force")), StoreTo(Location("z", 3), "m")),
}
DEPENDENT_AFTER = {
    "a row changes another's sum": (SET, StoreTo(loop_element("z", 1, "i"), "total")),
    "a row reads its numbers after it wrote them": (SET, StoreTo(loop_element("p", 0, "i"), "total")),
}


@pytest.mark.parametrize("name", [*DEPENDENT, *DEPENDENT_AFTER])
def test_rows_that_depend_on_one_another_come_one_by_one(name: str) -> None:
    """Assert that a row which reads or changes what another changes is made by itself, with the bits of Python."""
    n, links, after = 24, DEPENDENT.get(name, ()), DEPENDENT_AFTER.get(name, ())
    made = meetings(n, *links, after=after)
    (line,) = made.body
    assert isinstance(line, Loop)
    assert link_rows(line) is None
    assert link_rows(replace(line, body=meetings(n).body[0].body)) is not None  # type: ignore[union-attr]
    found = []
    for call in (in_python(made), compiled(made, abreast=8)):
        q, z = np.random.default_rng(3).uniform(1.0, 2.0, 99), np.ones(99)
        call(p=q, z=z)
        found.append(z.tobytes() + q.tobytes())
    assert found[0] == found[1]


@pytest.mark.parametrize("changed", [{"below": ""}, {"below": "", "above": "i"}, {"count": 23}, {"where": "close"}])
def test_only_rows_of_all_before_an_element_are_made_together(changed: dict[str, Any]) -> None:
    """Assert that a loop over others than all elements before one, or over some of them, is left as it is."""
    (line,) = meetings(24).body
    assert isinstance(line, Loop)
    load, row, store = line.body
    assert isinstance(row, Reduction)
    assert link_rows(line) is not None
    assert link_rows(replace(line, body=(load, replace(row, **changed), store))) is None
