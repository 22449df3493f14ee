"""Coefficients of the methods: order conditions and local errors, read from the very lines that a record quotes.

Everything is computed with 40 digits, so that a wrong last digit of a long decimal shows.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from itertools import combinations_with_replacement

import numpy as np
import pytest
from mpmath import MPContext
from numpy.typing import NDArray

import xdynamics as xd
from xdynamics.expressions.evaluation import evaluate
from xdynamics.methods import composition, nystrom, runge_kutta
from xdynamics.methods.lines import Evaluation, VectorStatement, read_lines
from xdynamics.methods.method import Method

mp = MPContext()  # its own context: the digits are no one else's
mp.dps = 40

Vector = NDArray[np.object_]
State = tuple[Vector, Vector, Vector]  # q, v, x
Force = Callable[[object, Vector, Vector, Vector], tuple[Vector, Vector]]

PAIRS = [one for one in runge_kutta.METHODS if one.estimate]
EXTENDED = [one for one in runge_kutta.METHODS if one.interpolant.order > 3]
SECOND_ORDER = [*composition.METHODS, *nystrom.METHODS]
SYMMETRIC = [one for one in composition.METHODS if one is not composition.RUTH3]
EVERY = [*runge_kutta.METHODS, *SECOND_ORDER]
NUMBER = re.compile(r"(?<![\w.])(\d+\.?\d*)(?![\w.])")


FUNCTIONS = {
    "number": mp.mpf,
    "where": np.where,
    "abs": np.abs,
    "sqrt": np.frompyfunc(mp.sqrt, 1, 1),
    "hypot": np.frompyfunc(mp.hypot, 2, 1),
}


@cache
def code(text: str) -> object:
    """An expression with every digit of its numbers."""
    return compile(NUMBER.sub(r"number('\1')", text), text, "eval")


def run(text: str, names: dict[str, object], f: Force) -> None:
    """Do what lines of a method say with the names there are."""
    for line in read_lines(text):
        if isinstance(line, Evaluation):
            time = eval(code(line.time), FUNCTIONS, names)
            state = (names[one] for one in (line.position, line.velocity, line.state))
            names[line.acceleration], names[line.rate] = f(time, *state)
        else:
            names[line.target] = eval(code(line.source.split(" = ")[1]), FUNCTIONS, names)


def step(method: Method, f: Force, t: object, h: object, start: State) -> dict[str, object]:
    """Everything that one step computes."""
    names = dict(zip("qvx", start, strict=True)) | {"t": t, "t1": t + h, "h": h}
    names["a"], names["r"] = f(t, *start)
    run(method.update, names, f)
    return names


Tree = tuple["Tree", ...]  # a root is the tuple of the trees that stand on it


@cache
def size(tree: Tree) -> int:
    """Number of its nodes."""
    return 1 + sum(map(size, tree))


@cache
def density(tree: Tree) -> int:
    """Gamma: the product of the sizes of all subtrees."""
    return size(tree) * int(np.prod([density(one) for one in tree], dtype=object))


@cache
def trees(order: int) -> tuple[Tree, ...]:
    """All rooted trees with that many nodes: 1, 1, 2, 4, 9, 20, 48, 115."""
    return forests(order - 1, order - 1)


@cache
def forests(nodes: int, largest: int) -> tuple[Tree, ...]:
    """All multisets of trees of at most that size with so many nodes together."""
    if not nodes:
        return ((),)
    found = []
    for first in range(min(nodes, largest), 0, -1):
        for count in range(1, nodes // first + 1):
            for rest in forests(nodes - count * first, first - 1):
                found += [(*some, *rest) for some in combinations_with_replacement(trees(first), count)]
    return tuple(found)


class Weights:
    """A Runge-Kutta method's weights, found by a step from 0 of size 1 whose k-th slope is the k-th unit vector."""

    def __init__(self, method: Method, s: object = None) -> None:
        self.c: list[object] = []
        self.a: list[Vector] = []
        self.known: dict[Tree, Vector] = {}
        self.names = step(method, self.unit, mp.mpf(0), mp.mpf(1), (self.zero(), self.zero(), self.zero()))
        if s is not None:
            self.names["s"] = s
            run(method.interpolant.text, self.names, self.unit)
        self.rows = np.array(self.a, dtype=object)[:, : len(self.a)]

    def zero(self) -> Vector:
        """A vector with a place for each stage."""
        return np.array([mp.mpf(0)] * 16, dtype=object)  # the most stages there are

    def unit(self, time: object, _: Vector, v: Vector, x: Vector) -> tuple[Vector, Vector]:
        """Note where a slope is asked for, and answer with its unit vector."""
        assert (v == x).all()  # the motion and the states have the same weights
        one = self.zero()
        one[len(self.a)] = mp.mpf(1)
        self.c.append(time)
        self.a.append(v)
        return one, one

    def stages(self, tree: Tree) -> Vector:
        """A tree's elementary weight at each stage."""
        if tree not in self.known:
            value = np.array([mp.mpf(1)] * len(self.a), dtype=object)
            for one in tree:
                value = value * self.rows.dot(self.stages(one))
            self.known[tree] = value
        return self.known[tree]

    def defect(self, weights: str, order: int, s: object = 1, exact: int = 1) -> float:
        """The largest violation of the conditions of one order by the vector of that name."""
        b = self.names[weights][: len(self.a)]
        return max(
            float(abs(b.dot(self.stages(tree)) - exact * mp.mpf(s) ** order / density(tree))) for tree in trees(order)
        )


EXACT = 1e-27  # the longest table prints 30 digits, of numbers up to 400


def test_numbers_of_trees() -> None:
    """Assert that the trees are all there: 200 conditions for order 8."""
    assert [len(trees(order)) for order in range(1, 10)] == [1, 1, 2, 4, 9, 20, 48, 115, 286]


@pytest.mark.parametrize("method", runge_kutta.METHODS, ids=lambda one: one.name)
def test_runge_kutta_order_is_exact(method: Method) -> None:
    """Assert all order conditions up to the order, and that one of the next order fails."""
    weights = Weights(method)
    assert max(weights.defect("v1", order) for order in range(1, method.order + 1)) < EXACT
    assert weights.defect("v1", method.order + 1) > 1e-5


@pytest.mark.parametrize("method", PAIRS, ids=lambda one: one.name)
def test_embedded_order_is_exact(method: Method) -> None:
    """Assert that a difference from an embedded formula vanishes up to its order, and not at the next."""
    weights = Weights(method)
    run(method.estimate, weights.names, weights.unit)
    # dop853 combines two such differences, of its formulas of order 5 and 3
    formulas = {"vu": 5, "vw": 3} if "vu" in weights.names else {"ve": method.estimate_order}
    for name, order in formulas.items():
        assert max(weights.defect(name, one, exact=0) for one in range(1, order + 1)) < EXACT
        assert weights.defect(name, order + 1, exact=0) > 1e-5


@pytest.mark.every(3)
@pytest.mark.parametrize("s", ["0.125", "0.5", "0.77"])
@pytest.mark.parametrize("method", EXTENDED, ids=lambda one: one.name)
def test_extension_order_is_exact(method: Method, s: str) -> None:
    """Assert the order conditions of a continuous extension inside the step, and that one of the next order fails."""
    weights = Weights(method, mp.mpf(s))
    assert max(weights.defect("vs", order, s) for order in range(1, method.interpolant.order + 1)) < EXACT
    assert weights.defect("vs", method.interpolant.order + 1, s) > 1e-6


@pytest.mark.parametrize("method", runge_kutta.METHODS, ids=lambda one: one.name)
def test_times_are_row_sums(method: Method) -> None:
    """Assert that each stage's time is the sum of its weights, also of the stages of the extension."""
    weights = Weights(method, mp.mpf("0.5"))
    assert largest(weights.rows.sum(axis=1) - np.array(weights.c, dtype=object)) < EXACT


@pytest.mark.parametrize("method", EVERY, ids=lambda one: one.name)
def test_number_of_evaluations(method: Method) -> None:
    """Assert that the update evaluates forces as often as the method says."""
    assert sum(isinstance(statement, Evaluation) for statement in method.statements) == method.evaluations


START = mp.mpf("0.3")
STEP = mp.mpf(2) ** -7  # here the errors of order 8 stand far above the last digits given, which are those of 1e-26
SHORT = mp.mpf(2) ** -14  # for coefficients without end: a relative error of 1e-14 in one shows


def largest(vector: Vector) -> object:
    """The largest component."""
    return max(abs(one) for one in vector)


def kepler(t: object, q: Vector, _v: Vector, _x: Vector) -> tuple[Vector, Vector]:
    """Attraction by an origin that swings, so that the force depends on time; the state's rate does on time alone."""
    origin, pull = swing(t), np.array([-mp.sin(t), -4 * mp.cos(2 * t)], dtype=object)
    d = q - origin
    return pull - d / mp.sqrt(d.dot(d)) ** 3, np.array([4 * mp.exp(4 * t)], dtype=object)


def swing(t: object) -> Vector:
    """Where the origin is."""
    return np.array([mp.sin(t), mp.cos(2 * t)], dtype=object)


@cache
def ellipse(t: object) -> State:
    """The exact solution: an ellipse of eccentricity 0.6 round the origin, and exp(4 t)."""
    e = mp.mpf("0.6")
    anomaly = mp.findroot(lambda u: u - e * mp.sin(u) - t, t / (1 - e))
    width, rate = mp.sqrt(1 - e**2), 1 / (1 - e * mp.cos(anomaly))
    q = np.array([mp.cos(anomaly) - e, width * mp.sin(anomaly)], dtype=object)
    v = np.array([mp.cos(t) - rate * mp.sin(anomaly), width * rate * mp.cos(anomaly) - 2 * mp.sin(2 * t)], dtype=object)
    return swing(t) + q, v, np.array([mp.exp(4 * t)], dtype=object)


def slopes(method: Method, text: str, name: str, s: object = 1) -> list[float]:
    """The powers of h with which what the lines `text` call q, v, x with that name falls; less the solution at s."""
    sizes = []
    longest = SHORT if method.name == "dprkn6" else STEP
    for h in (longest, longest / 2):
        names = step(method, kepler, START, h, ellipse(START))
        names["s"] = s
        run(text, names, kepler)
        exact = [0, 0, 0] if name == "e" else ellipse(START + s * h)
        sizes.append([largest(names[letter + name] - right) for letter, right in zip("qvx", exact, strict=True)])
    return [float(mp.log(one / other, 2)) for one, other in zip(*sizes, strict=True)]


@pytest.mark.parametrize("method", EVERY, ids=lambda one: one.name)
def test_local_error(method: Method) -> None:
    """Assert that the error of one step falls as h**(order + 1), in positions, velocities and states."""
    assert slopes(method, "", "1") == pytest.approx([method.order + 1] * 3, abs=0.2)


@pytest.mark.parametrize("method", [node for node in EVERY if node.estimate], ids=lambda one: one.name)
def test_error_estimate(method: Method) -> None:
    """Assert that the estimate falls as h**(estimate_order + 1)."""
    assert slopes(method, method.estimate, "e") == pytest.approx([method.estimate_order + 1] * 3, abs=0.2)


@pytest.mark.parametrize("method", EVERY, ids=lambda one: one.name)
def test_interpolant(method: Method) -> None:
    """Assert that the interpolant's worst error falls as its order says, or as that of the ends if this is lower."""
    worst = min(slopes(method, method.interpolant.text, "s", mp.mpf("0.37")))
    assert worst == pytest.approx(min(method.interpolant.order, method.order) + 1, abs=0.3)


@pytest.mark.parametrize("method", EVERY, ids=lambda one: one.name)
@pytest.mark.parametrize(("s", "end"), [(0, ""), (1, "1")])
def test_interpolant_meets_the_ends(method: Method, s: int, end: str) -> None:
    """Assert that the interpolant is the state at both ends of a step."""
    names = step(method, kepler, START, STEP, ellipse(START))
    names["s"] = mp.mpf(s)
    run(method.interpolant.text, names, kepler)
    assert max(largest(names[letter + "s"] - names[letter + end]) for letter in "qvx") < EXACT


def test_estimate_of_nothing_is_zero() -> None:
    """Assert that dop853's quotient is 0 where both its formulas agree with the step exactly."""
    rest = np.array([mp.mpf(0)], dtype=object)
    names = step(runge_kutta.DOP853, lambda *_: (rest, rest), mp.mpf(0), STEP, (rest, rest, rest))
    run(runge_kutta.DOP853.estimate, names, lambda *_: (rest, rest))
    assert [names[name][0] for name in ("qe", "ve", "xe")] == [0, 0, 0]


@pytest.mark.parametrize("method", [*SYMMETRIC, composition.RUTH3], ids=lambda one: one.name)
def test_symmetric_composition_is_reversible(method: Method) -> None:
    """Assert that a step of -h undoes one of h; and that of Ruth's method, which is not symmetric, it does not."""
    h, start = mp.mpf("0.05"), ellipse(START)
    there = step(method, kepler, START, h, start)
    back = step(method, kepler, START + h, -h, (there["q1"], there["v1"], there["x1"]))
    off = max(largest(back[letter + "1"] - right) for letter, right in zip("qvx", start, strict=True))
    assert off < 1e-25 if method in SYMMETRIC else off > 1e-8


@pytest.mark.parametrize("method", composition.METHODS, ids=lambda one: one.name)
def test_composition_is_symplectic(method: Method) -> None:
    """Assert that a step of the pendulum keeps the area: its Jacobian has determinant 1."""
    h, tiny = mp.mpf("0.25"), mp.mpf("1e-12")

    def moved(q: object, v: object) -> Vector:
        start = (np.array([q], dtype=object), np.array([v], dtype=object), np.array([mp.mpf(0)], dtype=object))
        names = step(method, lambda _t, q, _v, x: (np.array([-mp.sin(q[0])], dtype=object), 0 * x), mp.mpf(0), h, start)
        return np.array([names["q1"][0], names["v1"][0]], dtype=object)

    q, v = mp.mpf("0.7"), mp.mpf("0.4")
    (a, c), (b, d) = ((moved(q + i, v + j) - moved(q - i, v - j)) / (2 * tiny) for i, j in ((tiny, 0), (0, tiny)))
    assert abs(a * d - b * c - 1) < 1e-20  # the difference quotients err by tiny**2


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=lambda method: method.name)
def test_interpolant_is_the_polynomial_of_its_coefficients(method: Method) -> None:
    """Assert that the coefficients in s, of one degree for all vectors, have the values of the nested lines."""
    draw, lines = np.random.default_rng(4), method.interpolant.polynomials
    names = {name for line in lines if isinstance(line, VectorStatement) for name in line.vectors}
    values: dict[str, float] = {name: float(draw.normal()) for name in sorted(names)} | {"h": 0.7, "s": 0.3}
    for part in (method.interpolant.lines, lines):
        for line in part:
            if isinstance(line, VectorStatement):
                values[line.target] = evaluate(line.expression, values)
    for vector in ("qs", "vs", "xs"):
        terms = [values[f"{vector}{k}"] * values["s"] ** k for k in range(method.interpolant.degree + 1)]
        assert values[vector] == pytest.approx(sum(terms), rel=1e-11)


def test_degrees_of_polynomials() -> None:
    """Assert the degree of each kind of interpolant."""
    found = {
        name: xd.METHODS[name].interpolant.degree for name in ("rk4", "dormand_prince", "dop853", "dprkn6", "radau_iia")
    }
    assert found == {"rk4": 5, "dormand_prince": 4, "dop853": 7, "dprkn6": 6, "radau_iia": 3}
