"""Expressions with dimensions, computed in loops, have the bits of their elements written out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from cases.array_programs import compiled, in_python
from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import negative
from xdynamics.expressions.evaluation import evaluate
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.nests import Nests
from xdynamics.kernels.program import Location, Operand, Program
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
