"""Taylor series of elements in loops: neighbours side by side, sums by pairs of terms, powers by one recurrence."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.array_programs import compiled, in_python
from xdynamics.kernels.jets import Expansion, Motion, expansion
from xdynamics.kernels.jets.elements import powers_of
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.link_rows import link_rows
from xdynamics.kernels.llvm_program import llvm_of
from xdynamics.kernels.model_programs import expanded, forces_by_elements
from xdynamics.kernels.program import Compute, Line, Load, Location, Loop, Program, Reduction, StoreTo, nested_lines
from xdynamics.march.configuration import settings_for
from xdynamics.model.motion import constants

Floats = NDArray[np.float64]
PLANE = """
name = "laws of links"
[dimensions]
body = {n}
axis = 2
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[parameters]
k = "1.5 J"
l = "1 m"
m = {{ dims = ["body"], value = {masses}, unit = "kg" }}
[mass]
r = "m"
[relations.pair]
{relation}
[definitions]
d = "norm(second(r, pair) - first(r, pair), axis)"
[forces.law]
over = "pair"
potential = "{potential}"
[initial]
r = "(index(body) + 1)*(index(axis) + 1)*metre"
"""
LINE = """
name = "laws of neighbours"
[dimensions]
site = {n}
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
k = "1.5 N/m"
l = "1 m"
m = "2 kg"
[mass]
u = "m"
[relations.bond]
of = "site"
neighbours = 1
[forces.law]
over = "bond"
potential = "{potential}"
[initial]
u = "index(site)*metre"
"""
ALL, NEXT = 'of = "body"', 'of = "body"\nneighbours = 2\nring = true'
POTENTIALS = {
    "gravity": (ALL, "-k*l*first(m, pair)*second(m, pair)/d/(1 kg2)"),
    "softened gravity": (ALL, "-k*l/sqrt(d**2 + l**2)"),
    "Lennard-Jones": (ALL, "k*((l/d)**12 - 2*(l/d)**6)"),
    "springs of a length": (ALL, "k*(d/l - 1)**2/2"),
    "a power that is no half": (ALL, "k*(d/l)**(-4/3)"),
    "waves": (ALL, "k*sin(d/l)*exp(-d/l)"),
    "neighbours in a ring": (NEXT, "k*l/d + k*(d/l)**3/3"),
}
NEIGHBOURS = {
    "springs": "k*(second(u, bond) - first(u, bond))**2/2",
    "quartic springs": "k*(second(u, bond) - first(u, bond))**4/l**2/4",
    "sines": "-k*l**2*cos((second(u, bond) - first(u, bond))/l)",
}


def layout_of(text: str) -> tuple[Layout, Floats]:
    """The layout of a model by series, and its parameters."""
    model = xd.Model.from_text(text)
    settings = settings_for(model, method="taylor", step="1 s", until="1 s")
    return settings.layout(model), np.array([*constants(model).values()])


def plane(name: str, n: int) -> tuple[Layout, Floats]:
    """Bodies in a plane with a law of links between them."""
    relation, potential = POTENTIALS[name]
    masses = [1.0 + 0.3 * i for i in range(n)]
    potential = potential.replace("(1 kg2)", "kilogram**2")
    return layout_of(PLANE.format(n=n, masses=masses, relation=relation, potential=potential))


def state_of(layout: Layout) -> Floats:
    """Places near points of a lattice, so that no two bodies meet, and velocities; room for results."""
    random, size = np.random.default_rng(5), layout.coordinates.size
    y = np.zeros(layout.record.size)
    number = np.arange(size // 2 if size % 2 == 0 else size)
    lattice = np.stack([number % 5, number // 5], axis=1).ravel()[:size] if size % 2 == 0 else number
    y[:size] = lattice + random.uniform(-0.2, 0.2, size)
    y[size : 2 * size] = random.normal(size=size)
    return y


def coefficients(
    found: Expansion, layout: Layout, p: Floats, degree: int, *, plain: bool = False, **how: int
) -> Floats:
    """The coefficients of the state that a program finds."""
    runs = how.get("runs", 1)
    y, w, at = state_of(layout), np.zeros(found.memory * runs), np.zeros(8 * runs)
    given = {"y": np.repeat(y, runs), "w": w, "p": np.repeat(p, runs), "at": at}
    (in_python(found.program) if plain else compiled(found.program, **how))(**given)
    return w[: (degree + 1) * layout.used.size * runs].reshape(degree + 1, -1, runs)[..., -1]


@pytest.mark.parametrize("n", [3, 9, 16, 21])
def test_elements_side_by_side_have_the_bits_of_python(n: int) -> None:
    """Assert that 1, 4, 8 and 16 rows at once, runs side by side, and plain Python, find the same."""
    layout, p = plane("gravity", n)
    found = expanded(layout, 7)
    wanted = coefficients(found, layout, p, 7, plain=True)
    assert np.isfinite(wanted).all()
    for how in ({}, {"abreast": 4}, {"abreast": 8}, {"abreast": 16}, {"runs": 4}):
        assert coefficients(found, layout, p, 7, **how).tobytes() == wanted.tobytes()


def by_elements(layout: Layout, degree: int) -> Expansion:
    """The program without loops, whose sums are ascending and whose powers are products, roots and quotients."""
    motion = Motion(layout.coordinates.size, layout.states.size)
    found = expansion(forces_by_elements(layout), motion, degree, written_out=False, fused=True)
    assert not any(isinstance(line, Reduction) and line.below == "_half" for line in nested_lines(found.program.body))
    return found


@pytest.mark.every(3)
@pytest.mark.parametrize("name", POTENTIALS)
def test_links_have_the_series_of_elements_one_by_one(name: str) -> None:
    """Assert that loops find, to rounding, what a program without loops finds by plain sums, and side by side its bits."""
    (layout, p), degree = plane(name, 6), 8
    wanted, rows = (coefficients(of(layout, degree), layout, p, degree) for of in (by_elements, expanded))
    assert (np.abs(rows - wanted) <= 1e-12 * np.abs(wanted).max(axis=1, keepdims=True)).all()
    layout, p = plane(name, 18)
    one, eight = (coefficients(expanded(layout, 5), layout, p, 5, abreast=wide) for wide in (1, 8))
    assert eight.tobytes() == one.tobytes()


@pytest.mark.every(2)
@pytest.mark.parametrize("name", NEIGHBOURS)
def test_chains_have_the_series_of_elements_one_by_one(name: str) -> None:
    """Assert the same of neighbours, all of which go side by side in every order."""
    (layout, p), degree = layout_of(LINE.format(n=21, potential=NEIGHBOURS[name])), 7
    found = expanded(layout, degree)
    wanted, rows = (coefficients(each, layout, p, degree) for each in (by_elements(layout, degree), found))
    assert (np.abs(rows - wanted) <= 1e-13 * np.abs(wanted).max(axis=1, keepdims=True)).all()
    assert coefficients(found, layout, p, degree, abreast=8).tobytes() == rows.tobytes()
    (orders,) = (line for line in found.program.body if isinstance(line, Loop) and line.index == "_order")
    assert all(line.independent for line in orders.body if isinstance(line, Loop))


def test_rows_of_links_go_side_by_side_in_every_order() -> None:
    """Assert that the rows of order 0, and of the orders after it, are such that some can be made at once."""
    layout, _ = plane("gravity", 18)
    found = expanded(layout, 8)
    loops = [line for line in nested_lines(found.program.body) if isinstance(line, Loop)]
    rows = [line for line in loops if link_rows(line)]
    assert len(rows) == 2
    assert any(isinstance(line, Reduction) for line in nested_lines(rows[1].body[-4:]))
    assert (
        link_rows(Loop(rows[1].index, rows[1].count, rows[1].body)) is None
    )  # without knowing whose elements are whose
    assert "fma.8(" in llvm_of([found.program], abreast=8)


def test_a_law_of_distance_takes_the_recurrence_of_one_power() -> None:
    """Assert that gravity has series of squared distances and of a power alone: two sums of products less than by parts."""
    layout, _ = plane("gravity", 18)
    lines = list(nested_lines(expanded(layout, 8).program.body))
    (sums,) = (line for line in lines if isinstance(line, Reduction) and line.index == "_term")
    assert (
        len(sums.totals) == 2 + 2 + 2 * 2
    )  # squares along two axes; the power, and the force along each, from both ends
    kept = {line.location.array for line in lines if isinstance(line, StoreTo) and len(line.location.strides) == 3}
    assert len(kept) == 2


def body_of(*lines: Compute) -> tuple[Line, ...]:
    """Lines in a loop, of which the last is kept."""
    start = Load("a", Location("y", 0, (("i", 1),))), Load("c", Location("p", 0))
    return (Loop("i", 3, (*start, *lines, StoreTo(Location("z", 6, (("i", 1),)), lines[-1].target))),)


ROOT = Compute("root", "sqrt", ("a",))
CUBE = Compute("cube", "multiply", ("a", "root"))
INVERSE = Compute("inverse", "divide", ("c", "cube"))


def test_powers_are_found_through_products_roots_and_quotients() -> None:
    """Assert base, exponent and what is passed over: of c/(a*sqrt(a)); a root that is read elsewhere keeps its series."""
    found = powers_of(body_of(ROOT, CUBE, INVERSE))
    assert found.made == {"inverse": ("a", Fraction(-3, 2))}
    assert found.passed_over == {"root", "cube"}
    read = powers_of(body_of(ROOT, CUBE, INVERSE, Compute("sum", "add", ("root", "inverse"))))
    assert read.made == {"inverse": ("a", Fraction(-3, 2))}
    assert read.passed_over == {"cube"}
    square = Compute("square", "multiply", ("inverse", "inverse"))
    assert powers_of(body_of(ROOT, CUBE, INVERSE, square)).made == {"square": ("a", Fraction(-3))}
    turned = Compute("turned", "negative", ("inverse",))
    assert powers_of(body_of(ROOT, CUBE, INVERSE, turned)).made == {"turned": ("a", Fraction(-3, 2))}


@pytest.mark.parametrize(
    "lines",
    [
        (Compute("square", "multiply", ("a", "a")),),
        (ROOT,),
        (Compute("inverse", "divide", ("c", "a")),),
        (ROOT, Compute("square", "multiply", ("root", "root"))),
        (ROOT, Compute("a2", "multiply", ("a", "root")), Compute("whole", "multiply", ("a2", "root"))),
        (Compute("more", "add", ("a", 1.0)), Compute("mixed", "multiply", ("a", "more"))),
        (ROOT, Compute("other", "add", ("a", 1.0)), Compute("mixed", "divide", ("root", "other"))),
    ],
)
def test_what_takes_as_little_by_its_own_recurrence_is_no_power(lines: tuple[Compute, ...]) -> None:
    """Assert that squares, roots, quotients, whole powers (which go through zero) and products of others stay."""
    found = powers_of(body_of(*lines))
    assert not found.made
    assert not found.passed_over


def test_powers_outside_of_loops_stay() -> None:
    """Assert that scalar models keep their series: nothing is looked for among lines outside of loops."""
    (loop,) = body_of(ROOT, CUBE, INVERSE)
    assert isinstance(loop, Loop)
    assert not powers_of(loop.body).made
    program = Program("forces", "Forces.", tuple(line for line in loop.body if not isinstance(line, StoreTo)))
    assert not expansion(program, Motion(1, 0), 3, written_out=False, fused=True).program.tables


def running_sums(n: int) -> tuple[Program, Program]:
    """Sums of n elements to which later rows add squares of what they find there: in loops, and line by line."""
    i, j, k = ((index, 1) for index in "ijk")
    links = (
        Load("x", Location("y", 0, (j,))),
        Load("sum", Location("sums", 0, (j,))),
        Compute("part", "add", ("sum", "x")),
        Compute("square", "multiply", ("part", "part")),
        Compute("more", "add", ("sum", "square")),
        StoreTo(Location("sums", 0, (j,)), "more"),
        Compute("new", "add", ("total", "square")),
    )
    row = Reduction("j", n, links, ("new",), ("total",), "newest", 0.0, below="i")
    rates = Load("rate", Location("sums", 0, (k,))), StoreTo(Location("z", n, (k,)), "rate")
    looped = (Loop("i", n, (row, StoreTo(Location("sums", 0, (i,)), "total"))), Loop("k", n, rates))
    lines: list[Line] = [Load(f"x{j}", Location("y", j)) for j in range(n)]
    sums: list[str | float] = [0.0] * n
    for row_number in range(n):
        total: str | float = 0.0
        for other in range(row_number):
            names = [f"{name}{row_number}.{other}" for name in ("part", "square", "more", "new")]
            lines += [
                Compute(names[0], "add", (sums[other], f"x{other}")),
                Compute(names[1], "multiply", (names[0], names[0])),
                Compute(names[2], "add", (sums[other], names[1])),
                Compute(names[3], "add", (total, names[1])),
            ]
            sums[other], total = names[2], names[3]
        sums[row_number] = total
    lines += [StoreTo(Location("z", n + j), value) for j, value in enumerate(sums)]
    return Program("forces", "F.", looped, local={"sums": n}), Program("forces", "F.", tuple(lines))


def test_what_passes_change_keeps_the_series_that_each_pass_found() -> None:
    """Assert that a sum which later passes add to is not read again in its stead, where its square needs all orders."""
    n, degree, results = 4, 6, []
    for program in running_sums(n):
        found = expansion(program, Motion(0, n), degree, written_out=False, fused=True)
        w = np.zeros(found.memory)
        in_python(found.program)(y=np.array([0.3, -0.2, 0.5, 0.1]), w=w, at=np.zeros(8))
        results.append(w[: (degree + 1) * n])
    assert np.abs(results[1]).min() > 1e-6
    assert results[0] == pytest.approx(results[1], rel=1e-12, abs=0.0)
