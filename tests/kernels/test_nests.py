"""Expressions with dimensions, computed in loops, have the bits of their elements written out.

Loops in which every two elements meet once: rows side by side have the bits of plain Python.
Stretches of elements with equal links are those that a look at every element finds.
Vectors that stand where their copies go: fewer copies, the same numbers.
The law of a model with dimensions, printed with loops, has the bits of its elements written out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.chain_steps import EXPLICIT, SITES, chain_law, executed, left_by, lengths_of
from cases.shaped_laws import MODELS
from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import negative
from xdynamics.expressions.evaluation import evaluate
from xdynamics.kernels import law_of, layout_of, model_programs
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.link_rows import link_rows
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.machine import AS_WRITTEN
from xdynamics.kernels.nests import PIECES, Nests, Pattern, patterns
from xdynamics.kernels.program import (
    AT,
    Compute,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    loop_element,
)
from xdynamics.kernels.shared_storage import coalesce_copies
from xdynamics.march.configuration import settings_for
from xdynamics.model import Model
from xdynamics.model.motion import constants
from xdynamics.shapes import Extent, Relation, Shapes, at_element, dims_of, gradient, resolve_min_max

N = 19  # so that 1, 4, 8 and 16 side by side leave some over
RING = np.arange(N)
SHAPES = Shapes(
    {
        "body": Extent("body", N),
        "axis": Extent("axis", 3),
        "site": Extent("site", N),
        "row": Extent("row", 6),
        "wall": Extent("wall", 2),
    },
    {
        "pair": Relation("pair", "body", "body", *np.triu_indices(N, 1)),
        "next": Relation("next", "site", "site", RING[:-1], RING[1:]),
        "ring": Relation("ring", "site", "site", RING, (RING + 1) % N),
        "two": Relation(
            "two", "site", "site", np.repeat(RING[:-2], 2), (np.repeat(RING[:-2], 2) + np.tile([1, 2], N - 2))
        ),
        "bond": Relation("bond", "body", "body", np.array([3, 0, 11, 3, 7] * 5), np.array([0, 1, 3, 18, 3] * 5)),
        "touch": Relation("touch", "body", "wall", np.array([0, 1, 1, 3, 18]), np.array([1, 1, 0, 0, 1])),
    },
    {
        "m": ("body",),
        "r": ("body", "axis"),
        "u": ("site",),
        "k": ("site",),
        "g": ("row", "site"),
        "e": ("axis",),
        "c": ("bond",),
        "s": ("next",),
        "h": ("wall",),
    },
)
SCALARS = ("a", "b")


def offsets() -> dict[str, int]:
    """Return where each quantity begins among the numbers, and after them single ones."""
    found, offset = {}, 0
    for name, dims in SHAPES.dims.items():
        found[name], offset = offset, offset + int(np.prod(SHAPES.shape(dims)))
    return found | {name: offset + i for i, name in enumerate(SCALARS)}


OFFSETS = offsets()


def program(trees: list[Node]) -> Program:
    """Return a program that writes expressions to `z`, one after the other."""

    def find(lines: Assignments, name: str) -> Operand:
        quantity, *labels = name.split("·")
        dims = SHAPES.dims.get(quantity, ())
        flat = int(np.ravel_multi_index([*map(int, labels)], SHAPES.shape(dims))) if labels else 0
        return lines.load(Location("p", OFFSETS[quantity] + flat), name)

    nests = Nests(SHAPES, find, lambda name: Location("p", OFFSETS[name]))
    offset, results = 0, []
    for i, tree in enumerate(trees):
        dims = dims_of(tree, SHAPES)
        results.append((f"result{i}", dims, tree, Location("z", offset)))
        offset += int(np.prod(SHAPES.shape(dims)))
    nests.results(results)
    return Program("nests", "Test.", tuple(nests.lines), local=nests.local, tables=nests.tables)


def numbers() -> tuple[np.ndarray, dict[str, float]]:
    """Return numbers for all quantities, some of them zeros of both signs, as an array and by element."""
    random = np.random.default_rng(7)
    p = random.uniform(0.3, 1.7, OFFSETS["b"] + 1)
    r, size = OFFSETS["r"], N * 3
    p[r + 2 : r + size : 3] = np.where(np.arange(N) % 2, 0.0, -0.0)  # bodies in a plane
    names = [element for name in SHAPES.dims for element in SHAPES.elements(name)]
    return p, dict(zip([*names, *SCALARS], p.tolist(), strict=True))


GRAVITY = "-a*first(m, pair)*second(m, pair)/sqrt(norm(second(r, pair) - first(r, pair), axis)**2 + b**2)"


def force(text: str, name: str) -> Node:
    """Return the force of a potential."""
    return gradient(negative(resolve_min_max(parse(text), SHAPES)), {name}, SHAPES)[name]


CASES: Mapping[str, list[Node]] = {
    "pointwise": [
        parse(text) for text in ("a*u + b", "a*g*u", "r*e - m", "u*index(site) + size(site)", "a**-1.5 + u**3")
    ],
    "gravity": [force(GRAVITY, "r"), force(GRAVITY, "m")],
    "energy": [parse(f"sum({GRAVITY}, pair)"), parse("sum(m*r**2, body, axis)"), parse("mean(g*u, row, site)")],
    "chain": [force("s*(second(u, next) - first(u, next))**2/2 + k**4", "u")],
    "ring": [force("(second(u, ring) - first(u, ring))**2/2 + (second(u, ring) - first(u, ring))**3*a", "u")],
    "second neighbours": [force("sin(second(u, two) - first(u, two))*first(k, two)", "u")],
    "bonds": [force("c*(norm(second(r, bond) - first(r, bond), axis) - a)**2/2", "r"), force("c*second(m, bond)", "m")],
    "walls": [force("first(m, touch)*second(h, touch)**2", "h"), force("first(m, touch)**2*second(h, touch)", "m")],
    "lattice": [
        parse("a*(shift(u, site, 1, 0) - 2*u + shift(u, site, -1, b))"),
        parse("roll(u, site, 1) - roll(g, site, -3)*shift(g, row, 2, k)"),
        force("(u - roll(u, site, 1))**4/4 + (shift(u, site, 1, a) - u)**2*k", "u"),
    ],
    "shifts of shifts": [
        parse("shift(roll(u, site, 1), site, 1, a) + roll(roll(k, site, 3), site, 5)"),
        parse("shift(shift(u, site, 2, b), site, -5, a) + roll(shift(u, site, 1, a), site, -3)"),
        parse("sum(shift(roll(u, site, 4), site, 3, a)*u, site)"),
    ],
    "reductions": [
        parse("sum(g, row)*k + max(g, row, site)"),
        parse("sum(g, site)*g"),
        resolve_min_max(parse("min(g, site) + norm(g, site)*a + dot(g, u, site)"), SHAPES),
        parse("norm(r, axis)*m + dot(r, e, axis) + sum(r, axis)"),
        parse("cross(r, e, axis)*m"),
        force("min(u*k, site)*max(g, row)", "u"),
    ],
    "taken": [
        parse("take(u, site, size(site) - 1 - index(site)) + take(u, site, mod(5*index(site), 19))*k"),
        parse("a*take(u, site, 3*index(row) + index(axis)) + take(g, site, index(row) + 2)"),
        parse("sum(take(u, site, 3*index(row) + index(axis))*e, axis) + take(u, site, 4)"),
        parse(
            "take(sum(g*k, site), row, mod(index(site), 6)) + take(take(g, row, index(axis) + 1), site, floor(index(site)/2))"
        ),
        parse("take(take(r, body, mod(index(site) + 7, 19)), axis, mod(index(site), 3))"),
    ],
    "elements": [parse("u[0]*u - r[3, 1]"), force("u[0]**2*a + u[-1]*u", "u"), parse("where(index(site) > 3, u, k)")],
    "nested": [
        parse("first(norm(r, axis), pair)*second(m, pair)"),
        force("first(sum(first(m, bond), bond)*m, pair)*a", "m"),
        parse("first(m, touch) + second(h, touch)"),
    ],
    "functions": [parse("where(u > k, sin(u)*cos(u), exp(-k))*max(u, k, a)"), parse("atan2(g, u) + hypot(u, a)")],
}


@pytest.mark.every(19)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("abreast", [0, 1, 4, 8, 16])
def test_bits_of_elements(name: str, abreast: int) -> None:
    """Assert that loops, however many elements are side by side, and in Python, have the bits of elements written out."""
    trees = [resolve_min_max(tree, SHAPES) for tree in CASES[name]]
    p, values = numbers()
    expected = [
        evaluate(at_element(tree, place, SHAPES), values)
        for tree in trees
        for place in SHAPES.index_combinations(dims_of(tree, SHAPES))
    ]
    z = np.full(len(expected), np.nan)
    if abreast:
        compiled(program(trees), abreast=abreast)(p=p, z=z)
    else:
        in_python(program(trees))(p=p, z=z)
    np.testing.assert_array_equal(z.view(np.int64), np.array(expected).view(np.int64))


@pytest.mark.every(7)
@pytest.mark.parametrize("name", ["gravity", "chain", "bonds", "lattice", "reductions"])
def test_runs_side_by_side(name: str) -> None:
    """Assert that every one of several runs has the bits of a single one."""
    trees = [resolve_min_max(tree, SHAPES) for tree in CASES[name]]
    p, _ = numbers()
    runs = np.stack([p * (1 + 0.01 * lane) for lane in range(4)], axis=-1)
    count = sum(int(np.prod(SHAPES.shape(dims_of(tree, SHAPES)))) for tree in trees)
    z, one = np.full((count, 4), np.nan), np.full(count, np.nan)
    compiled(program(trees), runs=4)(p=np.ascontiguousarray(runs), z=z)
    for lane in range(4):
        compiled(program(trees))(p=np.ascontiguousarray(runs[:, lane]), z=one)
        np.testing.assert_array_equal(z[:, lane].copy().view(np.int64), one.view(np.int64))


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


def relations() -> Iterator[tuple[int, Relation]]:
    """Yield chains, rings, second neighbours, a star and links at random, with how many elements there are."""
    random = np.random.default_rng(3)
    for n in (2, 3, 5, 19, 40):
        sites = np.arange(n)
        yield n, Relation("chain", "site", "site", sites[:-1], sites[1:])
        yield n, Relation("ring", "site", "site", sites, (sites + 1) % n)
        yield n, Relation("two", "site", "site", np.repeat(sites, 2), (np.repeat(sites, 2) + np.tile([1, 2], n)) % n)
        yield n, Relation("star", "site", "site", np.zeros(n, int), sites)
        for count in random.integers(0, 2 * n, 20).tolist():
            yield n, Relation("bond", "site", "site", *random.integers(0, n, (2, count)))


def looked_up(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return the stretches, element by element."""
    stride = max(1, int(np.count_nonzero(relation.first == size // 2)))
    found: dict[int, Pattern] = {}
    previous = None
    for element in range(size):
        ends = [
            (int(link), end)
            for end, numbers in enumerate((relation.first, relation.second))
            for link in np.flatnonzero(numbers == element)
            if acting[end]
        ]
        pattern = stride, tuple((end, link - stride * element) for link, end in sorted(ends))
        if pattern != previous:
            found[element] = previous = pattern
    return found


def test_stretches_are_those_of_every_element() -> None:
    """Assert the same stretches with the same links, up to as many as are used."""
    for size, relation in relations():
        for acting in ((True, True), (True, False), (False, True)):
            right = list(looked_up(relation, acting, size).items())
            assert list(patterns(relation, acting, size).items()) == right[: PIECES + 1]


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


def has_loops(program: Program) -> bool:
    """Whether loops were printed, which make a program shorter than its elements."""
    return any(isinstance(line, Loop | Reduction) for line in program.body)


def arrays(model: Model, runs: int = 1) -> dict[str, np.ndarray]:
    """Return numbers for a program of a model, each run's its own; a number of the state is -0.0."""
    layout, random = layout_of(model), np.random.default_rng(3)
    y = random.uniform(0.5, 1.5, (layout.record.size, runs))
    y[1] = -0.0
    p = np.array([*constants(model).values()])[:, None] * np.linspace(1, 1.1, runs)
    at = np.zeros((len(AT), runs))
    at[0], at[1] = 1.5, 1.5
    z = np.full((layout.record.size + layout.row.size, runs), np.nan)
    flat = {"y": y, "p": p, "at": at, "z": z}
    return {name: np.ascontiguousarray(array if runs > 1 else array[:, 0]) for name, array in flat.items()}


def both(name: str, which: str, monkeypatch: pytest.MonkeyPatch) -> tuple[Model, Program, Program]:
    """Return a program of a model in loops and with its elements written out."""
    text = MODELS[name]
    if name == "reaction":  # tables are tested with marches
        text = text.replace('[drives.bath]\ntable = "bath.csv"\ncsv = "t [s],bath [1]\\n0,1\\n5,2\\n9,0\\n"\n', "")
        text = text.replace("[parameters]", '[parameters]\nbath = "2"')
    model = xd.Model.from_text(text)
    write = getattr(model_programs, which)
    loops = write(layout_of(model))
    monkeypatch.setattr(model_programs, "has_loops", lambda _: False)
    elements = write(layout_of(model))
    assert has_loops(loops)
    assert not has_loops(elements)
    return model, loops, elements


@pytest.mark.every(13)
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("which", ["forces", "derived"])
@pytest.mark.parametrize("abreast", [0, 1, 4, 8, 16])
def test_bits(name: str, which: str, abreast: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that forces, energies and observables have the same bits, also in Python."""
    model, loops, elements = both(name, which, monkeypatch)
    found, expected = arrays(model), arrays(model)
    compiled(elements)(**expected)
    if abreast:
        compiled(loops, abreast=abreast)(**found)
    else:
        in_python(loops)(**found)
    np.testing.assert_array_equal(found["z"].view(np.int64), expected["z"].view(np.int64))
    assert np.isfinite(found["z"]).sum() > 20 or which == "derived"


@pytest.mark.every(3)
@pytest.mark.parametrize("name", MODELS)
def test_laws_of_runs_side_by_side(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that lanes of runs have the bits of the elements written out."""
    model, loops, elements = both(name, "forces", monkeypatch)
    found, expected = arrays(model, 4), arrays(model, 4)
    compiled(loops, runs=4)(**found)
    compiled(elements, runs=4)(**expected)
    np.testing.assert_array_equal(found["z"].view(np.int64), expected["z"].view(np.int64))


def test_loops_over_elements_are_compiled_as_written() -> None:
    """Assert that the law of a chain is as long for any number of its elements, and that LLVM is to unroll no loop."""
    lines = []
    for n in (104, 1000):  # what is left of them beside eight abreast is as long
        model = xd.Model.from_text(MODELS["chain"].replace("site = 21", f"site = {n}"))
        settings = settings_for(model, method="rk4", step=0.1, until=1.0)
        text = law_of(settings.layout(model), sampled=False).text()
        assert text.startswith(AS_WRITTEN)
        lines.append(text.count("\n"))
    assert lines[0] == lines[1]


def test_the_greatest_of_a_dimension_has_series_by_its_elements() -> None:
    """Assert that `taylor` marches the largest of a row of states, whose loops keep no coefficients of the greatest so far."""
    text = """
name = "greatest"
[dimensions]
cell = 5
[states.a]
unit = "1"
dims = ["cell"]
rate = "-a*index(cell)/second"
[states.b]
unit = "1"
rate = "max(a, cell)/second"
smooth = true
[initial]
a = "1 + index(cell)/10"
b = "0"
"""
    # the last, 1.4*exp(-4 t), is above all others until 0.07 s
    run = xd.simulate(xd.Model.from_text(text), method="taylor", step=1e-3, until=0.05)
    assert float(run.b[-1]) == pytest.approx(1.4 * (1 - np.exp(-0.2)) / 4, rel=1e-12)
