"""Jets: the Taylor coefficients of everything that forces may consist of, beside those of many digits by mpmath."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from itertools import count
from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.array_programs import bound, compiled, gravity, in_python
from xdynamics.elementary.fma import fma
from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.jets import Motion, UnexpandedError, expansion
from xdynamics.kernels.jets.looped import Looped
from xdynamics.kernels.jets.recurrences import Series, reciprocal
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import expanded, forces, forces_by_elements
from xdynamics.kernels.program import (
    Compute,
    EngineCall,
    Line,
    Load,
    Location,
    Loop,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
    nested_lines,
)
from xdynamics.march.configuration import settings_for
from xdynamics.model.motion import constants

Floats = NDArray[np.float64]
DEGREE = 21
TIME = 0.3
OF_X = Motion(coordinates=0, states=2)  # x' = 1, u' = f(x, t): the series of u are those of f
PLACES = {"x": Location("y", 0), "u": Location("y", 1), "t": Location("at", 0), "c": Location("p", 0)}
EXACT: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(mpmath, name) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "asin", "acos", "atan")},
    **{name: getattr(mpmath, name) for name in ("atan2", "sinh", "cosh", "tanh", "hypot")},
    "abs": abs,
    "min": min,
    "max": max,
    "where": lambda truth, a, b: a if truth else b,
}
SMOOTH = [
    "x*x - x + t",
    "x*x*x/(1 + x*x)",
    "1/(c + x)",
    "(x + t)/c",
    "sqrt(1 + x*x)",
    "sqrt(x)",
    "x**2.7",
    "x**-1.5",
    "(x*t)**0.3",
    "exp(-x)",
    "exp(x*t)",
    "log(2 + x)",
    "log(x)",
    "sin(x)",
    "cos(x)",
    "sin(3*x)*cos(3*x)",
    "cos(c*t)*sin(c*t)",
    "tan(x)",
    "asin(x/2)",
    "acos(x/2)",
    "atan(3*x)",
    "atan2(x, 1 + x*x)",
    "atan2(-x, -t)",
    "sinh(x)",
    "cosh(x)",
    "sinh(x)*cosh(x)",
    "tanh(x)",
    "1/(sqrt(1 + x*x)*sqrt(1 + x*x)*sqrt(1 + x*x))",
    "x/3 + x/c/2",
    "hypot(x, 1 + x*x)",
    "abs(x - 2)*x",
    "abs(x)",
    "min(x, 2*x*x*x)",
    "max(t, x, x*t)",
    "where(x > 0.05, x*x, -x)",
    "c*c*x",
]


def of_x(text: str) -> Program:
    """The forces of x' = 1 and u' = an expression of x, t and the constant c."""
    lines = Assignments(lambda lines, name: lines.load(PLACES[name], name))
    value = lines.value(parse(text))
    lines.store(Location("z", 2), 1.0)
    lines.store(Location("z", 3), value)
    return Program("forces", "Forces.", tuple(lines.lines))


def series_of(
    text: str, x: float, *, written_out: bool, degree: int = DEGREE, c: float = 1.3, fused: bool = True
) -> Floats:
    """The coefficients of an expression of x and t, by plain Python, whose bits compiled lines have too."""
    found = expansion(of_x(text), OF_X, degree, 3, written_out=written_out, fused=fused)
    assert found.written_out == written_out
    y, at = np.array([x, 0.0, 1.0, 0.0]), np.array([TIME, *[0.0] * 7])
    results = []
    # compiling takes ten times as long for coefficients written out, which are the same kinds of lines
    ways = [in_python, compiled] if degree < 10 or not written_out else [in_python]
    for way in ways:
        call, w = way(found.program), np.full(found.memory, 7.0)
        call(y=y, w=w, at=at, p=np.array([c]))
        results.append(w[3 : 3 + 2 * (degree + 1)])
    assert results[0].tobytes() == results[-1].tobytes()
    return np.asarray(results[0].reshape(-1, 2)[1:, 1] * np.arange(1, degree + 1))


@pytest.mark.every(3)
@pytest.mark.parametrize("text", SMOOTH)
def test_series_are_those_of_many_digits(text: str) -> None:
    """Assert that coefficients to order 20 are those that mpmath finds, to rounding over the distance to a singularity."""
    random = np.random.default_rng(len(text))
    x = float(random.uniform(0.2, 0.9))
    ways = [(written_out, fused) for written_out in (True, False) for fused in (True, False)]
    both = [series_of(text, x, written_out=written_out, fused=fused) for written_out, fused in ways]
    with mpmath.workdps(40):

        def f(s: Any) -> Any:
            return eval(text, {}, {**EXACT, "x": x + s, "t": TIME + s, "c": mpmath.mpf(1.3)})

        exact = mpmath.taylor(f, 0, DEGREE - 1)
        # in units of the radius of convergence coefficients are as large as what rounding leaves of those before
        size = max(abs(term) ** (mpmath.mpf(1) / max(k, 1)) for k, term in enumerate(exact)) or mpmath.mpf(1)
        pairs = [(k, found[k], term) for found in both for k, term in enumerate(exact)]
        errors = [float(abs(coefficient - term) / size**k) for k, coefficient, term in pairs]
    assert max(errors) < 1e-13 * max(1.0, float(abs(exact[0])))


def test_quotients_by_reciprocals_are_rounded_as_quotients() -> None:
    """Assert the bits of divisions, of which a product with a rounded reciprocal misses every fourth: a bias, over time."""
    random = np.random.default_rng(8)
    for divisor in (3.0, 5.0, 7.0, 12.0, 49.0, 1.3):
        nearest, rest = reciprocal(divisor)
        values = random.uniform(1.0, 2.0, 400).tolist()
        assert [fma(value, nearest, value * rest) for value in values] == [value / divisor for value in values]
    for x in random.uniform(0.2, 0.9, 5).tolist():
        for written_out in (True, False):
            assert series_of("x*x/c", x, written_out=written_out, degree=2)[1] == 2 * x / 1.3
            assert series_of("x*x/7", x, written_out=written_out, degree=2)[1] == 2 * x / 7


def test_what_stays_the_same_costs_one_product_in_high_orders() -> None:
    """Assert that a coefficient of a sum of multiples takes little more operations than what it is a multiple of."""

    def operations(text: str) -> int:
        """Those of one order more, of a motion with u' = f(u)."""
        programs = [expansion(of_x(text), OF_X, degree, 3, written_out=True, fused=True).program for degree in (19, 20)]
        less, more = (sum(isinstance(line, Compute) for line in program.body) for program in programs)
        return more - less

    assert operations("-c*u/3") <= 4  # the product, its factor over the order, and what nothing reads
    assert operations("-(c*u + c*(2*u*u)/3 - t*c)/c/7") <= operations("u*u") + 6


@pytest.mark.parametrize("written_out", [True, False])
@pytest.mark.parametrize(
    ("text", "x", "beginning"),
    [
        ("abs(x)", 0.0, [0.0, 1.0]),
        ("abs(-x)", 0.0, [0.0, 1.0]),
        ("min(x, 3*x)", 0.0, [0.0, 1.0]),
        ("max(x, 3*x)", 0.0, [0.0, 3.0]),
        ("sign(x)*x", -0.5, [0.5, -1.0]),
        ("floor(4*x)*x", 0.7, [1.4, 2.0]),
        ("mod(x, 0.3)", 0.7, [0.7 - 2 * 0.3, 1.0]),
        ("mod(2, x)", 0.7, [2 - 2 * 0.7, -2.0]),
        ("sqrt(x)", 0.0, [0.0]),
        ("hypot(x, x)", 0.0, [0.0]),
        ("x**1.5", 0.0, [0.0]),
        ("where(x < 0, x, 2*x)", 0.0, [0.0, 2.0]),
        ("c*2", 0.0, [2.6]),
    ],
)
def test_corners_and_steps(text: str, x: float, beginning: list[float], *, written_out: bool) -> None:
    """Assert that at a corner the side is that of the motion, that steps stay, and that a root of zero stops there."""
    wanted = [*beginning, *[0.0] * (6 - len(beginning))]
    assert series_of(text, x, written_out=written_out, degree=6) == pytest.approx(wanted, abs=1e-15)


@pytest.mark.parametrize("written_out", [True, False])
@pytest.mark.parametrize("operation", ["value_at", "slope_at"])
def test_tables_inside_a_piece(operation: str, *, written_out: bool) -> None:
    """Assert that a table has the series of the cubic of its piece, of an argument that moves in any way."""
    table = np.array(
        [0.0, 0.5, 2.0, -1.0, 0.7, 3.0, 1.5, -0.2, 0.4, 0.9]
    )  # two pieces: origins, then cubic to constant
    lines = Assignments(lambda lines, name: lines.load(PLACES[name], name))
    argument = lines.value(parse("x*x"))
    piece = lines.compute("find_piece", argument, 0)
    lines.store(Location("z", 2), 1.0)
    lines.store(Location("z", 3), lines.compute(operation, argument, piece, 0))
    forces = Program("forces", "Forces.", tuple(lines.lines))
    found = expansion(forces, OF_X, 8, written_out=written_out, fused=True)
    w, x = np.zeros(found.memory), 0.9
    given = {"y": np.array([x, 0.0, 1.0, 0.0]), "at": np.zeros(8), "tables": table}
    bound(found.program, w=w, pieces=np.array([0, 2, 0]), **given)()
    polynomial = np.polynomial.Polynomial(table[[9, 7, 5, 3]])
    cubic = polynomial if operation == "value_at" else polynomial.deriv()
    argument_of_time = np.polynomial.Polynomial([x * x - 0.5, 2 * x, 1.0])
    wanted = cubic(argument_of_time).coef
    series = w[: 2 * 9].reshape(-1, 2)[1:, 1] * np.arange(1, 9)
    assert series == pytest.approx([*wanted, *[0.0] * (8 - len(wanted))], abs=1e-14)


class Passes:
    """The lines of loops, one pass after the other, with every value under a name of its own."""

    def __init__(self) -> None:
        self.lines: list[Line] = []
        self._names: dict[str, Any] = {}

    def write(self, body: Iterable[Any], at: dict[str, int]) -> None:
        """Write lines where loops are at some numbers."""
        for line in body:
            match line:
                case Load():
                    self.lines.append(Load(self._named(line.target), self._place(line.location, at)))
                case Ordinal():
                    self._names[line.target] = float(at[line.index])
                case Compute():
                    given = tuple(self._names.get(name, name) for name in line.arguments)
                    self.lines.append(Compute(self._named(line.target), line.operation, given))
                case StoreTo():
                    self.lines.append(StoreTo(self._place(line.location, at), self._names[line.value]))
                case Loop():
                    for k in range(line.count):
                        self.write(line.body, {**at, line.index: k})
                case Reduction():
                    self._reduce(line, at)

    def _reduce(self, line: Reduction, at: dict[str, int]) -> None:
        totals: list[Any] = list(line.starts)
        for k in range(line.count):
            if line.where and k == at["i"]:  # gravity leaves out the body itself
                continue
            self.write(line.body, {**at, line.index: k})
            terms = [self._names[term] for term in line.terms]
            for i, pair in enumerate(zip(totals, terms, strict=True)):
                totals[i] = self._named("total")
                self.lines.append(Compute(totals[i], "add", pair))
        self._names.update(zip(line.totals, totals, strict=True))

    def _named(self, name: str) -> str:
        self._names[name] = f"{name}_{len(self.lines)}"
        return str(self._names[name])

    def _place(self, of: Location, at: Mapping[str, int]) -> Location:
        return Location(of.array, of.offset + sum(at[index] * stride for index, stride in of.strides))


def moving(program: Program, numbers: int) -> Program:
    """A program of accelerations at the beginning of `z` as one of forces, which follow the state."""

    def moved(line: Any) -> Any:
        if isinstance(line, Loop):
            return replace(line, body=tuple(map(moved, line.body)))
        if isinstance(line, StoreTo):
            return replace(line, location=replace(line.location, offset=line.location.offset + 2 * numbers))
        return line

    return Program("forces", "Forces.", tuple(map(moved, program.body)))


@pytest.mark.parametrize("by_body", [True, False])
def test_loops_have_the_series_of_what_they_write(*, by_body: bool) -> None:
    """Assert that gravity in loops over bodies has the coefficients of gravity written out, alone and in lanes."""
    n, degree = 3, 8
    motion, looped = Motion(3 * n, 0), moving(gravity(n, by_body=by_body), 3 * n)
    passes = Passes()
    passes.write(looped.body, {})
    straight = Program("forces", "Forces.", tuple(passes.lines))
    random, results = np.random.default_rng(4), []
    y, p = np.concatenate([random.normal(size=6 * n), np.zeros(3 * n)]), random.uniform(0.5, 2.0, n)
    for program, written_out in ((looped, False), (straight, False), (straight, True)):
        found = expansion(program, motion, degree, written_out=written_out, fused=True)
        w = np.zeros(found.memory)
        (compiled if program is looped else in_python)(found.program)(y=y, w=w, p=p, at=np.zeros(8))
        results.append(w[: (degree + 1) * 6 * n].copy())
    size = np.abs(results[2]).max()
    assert np.abs(results[0] - results[2]).max() < 1e-13 * size
    assert np.abs(results[1] - results[2]).max() < 1e-13 * size
    lanes = expansion(looped, motion, degree, fused=True)
    assert not lanes.written_out
    w = np.zeros((lanes.memory, 4))
    given = {"y": np.repeat(y[:, None], 4, 1), "p": np.repeat(p[:, None], 4, 1), "at": np.zeros((8, 4))}
    compiled(lanes.program, runs=4)(w=w, **given)
    assert w[: (degree + 1) * 6 * n, 2].tobytes() == results[0].tobytes()


def bodies(n: int) -> tuple[Layout, NDArray[np.float64]]:
    """The layout of bodies that all attract each other along a relation, and their parameters."""
    model = xd.Model.from_text(f"""
name = "cluster"
[dimensions]
body = {n}
axis = 3
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[parameters]
G = "1.5 m3 kg-1 s-2"
m = {{ dims = ["body"], value = {[1.0 + 0.3 * i for i in range(n)]}, unit = "kg" }}
[mass]
r = "m"
[relations.pair]
of = "body"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = "(index(body) + 1)*(index(axis) + 1)*metre"
""")
    settings = settings_for(model, method="taylor", step="1 s", until="1 s")
    return settings.layout(model), np.array([*constants(model).values()])


def series_of_bodies(y: Floats, masses: Floats, degree: int) -> Floats:
    """The coefficients of the places of bodies, by Miller's recurrence for the power -3/2 of all squared distances."""
    n = masses.size
    q, v = (np.zeros((degree + 1, n, 3)) for _ in range(2))
    q[0], v[0] = y.reshape(2, n, 3)
    d, square, power = (np.zeros((degree + 1, n, n, *more)) for more in ((3,), (), ()))
    for k in range(degree):
        d[k] = q[k][None, :] - q[k][:, None]
        square[k] = sum((d[j] * d[k - j]).sum(-1) for j in range(k + 1)) + (np.eye(n) if k == 0 else 0.0)
        terms = [(-1.5 * j - (k - j)) * square[j] * power[k - j] for j in range(1, k + 1)]
        power[k] = sum(terms) / (k * square[0]) if k else square[0] ** -1.5
        pull = sum(power[j][..., None] * d[k - j] for j in range(k + 1))
        v[k + 1] = 1.5 * (masses[None, :, None] * pull).sum(1) / (k + 1)
        q[k + 1] = v[k] / (k + 1)
    return q


LINKED = """
name = "sites"
[dimensions]
site = {n}
[relations.near]
of = "site"
neighbours = {reach}
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[parameters]
k = "4 N m-1"
l = "1 m"
c = "0.3 N s m-1"
m = "1 kg"
[mass]
u = "m"
[forces.links]
over = "near"
u = "c*(second(v_u, near) - first(v_u, near)) + k*l*sin((second(u, near) - first(u, near))/l)"
[forces.trap]
u = "-k*(u - mean(u, site)) - k*u**3/l**2"
[initial]
u = "0.1*metre*sin(index(site)**2 + 1)"
"""


@pytest.mark.parametrize(("n", "reach"), [(2, 1), (3, 1), (4, 2), (7, 2), (12, 1)])
def test_what_is_kept_for_other_lines_has_its_series(n: int, reach: int) -> None:
    """Assert that arrays of links, written and read one element at a time or in loops, have the series of their elements."""
    model = xd.Model.from_text(LINKED.format(n=n, reach=reach))
    layout = settings_for(model, method="taylor", step="1 s", until="1 s").layout(model)
    p, y = np.array([*constants(model).values()]), np.random.default_rng(7).normal(size=layout.record.size)
    results = []
    together, apart = forces(layout), forces_by_elements(layout)
    assert together.local
    loops = any(isinstance(line, Loop | Reduction) for line in together.body)
    for program, written_out in [(apart, True), (together, False), *([] if loops else [(together, True)])]:
        found = expansion(program, Motion(n, 0), 9, written_out=written_out, fused=True)
        w = np.zeros(found.memory)
        in_python(found.program)(y=y, w=w, p=p, at=np.zeros(8))
        results.append(w[: 10 * 2 * n])
    assert len(results) == (2 if loops else 3)
    for series in results[1:]:
        assert series == pytest.approx(results[0], rel=1e-11, abs=1e-11)


def test_a_series_is_never_taken_for_one_before_it() -> None:
    """Assert that what is stored of a series that nobody names again is not what another one has."""
    lines = Assignments(lambda _lines, name: name, "_e")
    order = Looped(lines, 4, Location, count(1), started=True, in_element_loops=False, stores={}, fused=True)
    for k in range(100):
        order.keep(Series(location=Location("w", 4 * k)), f"_v{k}")
        assert not order.knows(Series(location=Location("w", 400)))


def test_links_are_made_once() -> None:
    """Assert that every two bodies meet once, by lines as many for any number, with the series of each with all others."""
    n, degree = 6, 9
    (layout, p), (larger, _) = bodies(n), bodies(n + 5)
    found, more = (expanded(of, degree) for of in (layout, larger))
    assert len(list(nested_lines(found.program.body))) == len(list(nested_lines(more.program.body)))
    assert any(isinstance(line, Reduction) and line.operation == "newest" for line in nested_lines(found.program.body))
    y, w = np.random.default_rng(3).normal(size=layout.record.size), np.zeros(found.memory)
    in_python(found.program)(y=y, w=w, p=p, at=np.zeros(8))
    again = np.zeros(found.memory)
    compiled(found.program)(y=y, w=again, p=p, at=np.zeros(8))
    assert again.tobytes() == w.tobytes()
    exact = series_of_bodies(y[: 6 * n], np.array([1.0 + 0.3 * i for i in range(n)]), degree)
    series = w[: (degree + 1) * 6 * n].reshape(degree + 1, 6 * n)[:, : 3 * n]
    sizes = np.abs(exact).max(axis=(1, 2))
    assert (np.abs(series - exact.reshape(degree + 1, -1)).max(axis=1) < 1e-13 * sizes).all()


def test_sums_are_made_together() -> None:
    """Assert that what is read alone is stored, and that the sums of three squares, and of products, are one loop's."""
    layout, _ = bodies(6)
    lines = list(nested_lines(expanded(layout, 9).program.body))
    sums = [line for line in lines if isinstance(line, Reduction) and line.index == "_term"]
    assert max(len(line.totals) for line in sums) >= 9
    read = {line.location.offset for line in lines if isinstance(line, Load) and line.location.array == "w"}
    written = {line.location for line in lines if isinstance(line, StoreTo) and line.location.array == "w"}
    inside = [place for place in written if len({index for index, _ in place.strides} - {"_order", "i"}) == 2]
    assert all(any(place.offset - 1 <= offset <= place.offset + 1 for offset in read) for place in inside)


def test_sums_of_the_same_coefficients_are_made_together() -> None:
    """Assert that products that alternate in the text are summed by loops in which each coefficient is read once."""
    terms = [f"(u + {i}*t)" for i in range(1, 13)]
    text = " + ".join([*(f"{term}*{term}" for term in terms), *(f"{term}*u" for term in terms)])
    body = expansion(of_x(text), OF_X, 9, 3, written_out=False, fused=True).program.body
    loops = [line for line in nested_lines(body) if isinstance(line, Reduction) and line.index == "_term"]
    loads = sum(isinstance(line, Load) for loop in loops for line in loop.body)
    assert sum(len(loop.totals) for loop in loops) == 24
    assert loads < 1.3 * 24  # one by one in the order of the text, 1.6


def test_what_has_no_series_is_refused() -> None:
    """Assert that functions in Python, calls of the engine and largest elements are told apart."""
    store = StoreTo(Location("z", 2), "_v")
    called = Program("forces", "Forces.", (Load("_x", PLACES["x"]), Compute("_v", "python_f", ("_x",)), store))
    with pytest.raises(UnexpandedError, match="python_f"):
        expansion(called, OF_X, 4)
    with pytest.raises(UnexpandedError, match="EngineCall"):
        expansion(Program("forces", "Forces.", (EngineCall(0),)), OF_X, 4)
    terms = (Load("_x", Location("y", 0, (("i", 1),))),)
    largest = Reduction("i", 2, terms, ("_x",), ("_v",), "greatest", -np.inf)
    with pytest.raises(UnexpandedError, match="greatest"):
        expansion(Program("forces", "Forces.", (largest, store)), OF_X, 4)
