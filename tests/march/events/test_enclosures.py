"""Intervals of event functions hold every value there is, and are not much wider than the tightest ones."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import ival
import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.plain import between_states, plain, rules_in_python
from xdynamics.elementary.bounds import BREAKS, SMOOTH, UNBOUNDED
from xdynamics.kernels.drive_tables import PYTHON_TABLES
from xdynamics.kernels.interval_program import OPERATIONS as NAMES
from xdynamics.kernels.interval_program import VARIABLES
from xdynamics.march.events.enclosures import enclose_functions, store_bounds
from xdynamics.march.run import ALL, Run
from xdynamics.march.runner import March
from xdynamics.march.settings import Settings
from xdynamics.model.drives import INTERPOLATIONS, OUTSIDE

Floats = NDArray[np.float64]
Bounds = tuple[float, float, int]  # and whether a value may jump there, or be none
# where a state of one coordinate and three states has a variable and its derivatives
PLACES = {
    **dict.fromkeys(("position", "velocity", "acceleration"), (0, 1, 5)),
    **dict.fromkeys(("state", "rate"), (2, 6)),
}
EPS = float(np.finfo(float).eps)
MOST, LEAST = float(np.finfo(float).max), 5e-324
TABLE = "q [m],curve [1]\n-3,1.5\n-1,-2\n0,0.1\n0.5,0.3\n0.7,5\n3,5\n4,-7\n9,1e3\n"


@pytest.fixture(autouse=True)
def _digits() -> Iterator[None]:
    """Compute truths with 50 digits, and leave others' tests with theirs."""
    with mpmath.workdps(50):
        yield


@lru_cache
def machine(function: str, interpolation: str = "linear", outside: str = "hold") -> Run:
    """A run with an event function of the numbers x, y and z, or of the place q, its elementary functions as plain Python."""
    states = {name: {"unit": "1", "rate": "0/second"} for name in "xyz"}
    drives = {
        "curve": {"table": "d.csv", "csv": TABLE, "argument": "q", "interpolation": interpolation, "outside": outside}
    }
    model = xd.Model(
        name="numbers",
        coordinates={"q": "m"},
        parameters={"m": "1 kg"},
        mass={"q": "m"},
        forces={},
        states=states,
        drives=drives,
        initial={"q": "0 m", "v_q": "0 m s-1"} | dict.fromkeys("xyz", "0.5"),
        events={"e": {"function": function}},
    )
    run = March(model, Settings(xd.METHODS["rk4"], until=1.0, step=0.1)).run
    run.put(functions=rules_in_python())
    plain(enclose_functions)(run, run.y, run.y, 0, run.parts[0], ALL)
    return run


def enclosed(run: Run, *given: tuple[float, float], slope: bool = False) -> Bounds:
    """Enclose a function of numbers that lie between two each, or its slope where they grow by one a second."""
    for k in range(run.parts[0], run.parts[2] if slope else run.parts[1]):
        operation, place, number, *_ = run.rows[k]
        if NAMES[operation] in VARIABLES:
            itself = {"position": number, "state": number - 2}
            ends = given[itself[NAMES[operation]]] if NAMES[operation] in itself else (1.0, 1.0)
            plain(store_bounds)(run, place, *ends, SMOOTH)
        else:
            with np.errstate(all="ignore"):
                plain(enclose_functions)(run, run.y, run.y, k, k + 1, ALL)
    place = run.detectors[0].slope if slope else run.detectors[0].value
    return float(run.under[place]), float(run.over[place]), int(run.flaws[place])


def ends(random: np.random.Generator) -> float:
    """A number of any size and sign, and those where functions turn."""
    special = (0.0, 1.0, 0.5, 2.0, LEAST, 1e-310, MOST, math.pi, math.pi / 2, 3 * math.pi / 2, 2 * math.pi, 1e15, 709.0)
    kind = random.integers(5)
    size = (
        special[random.integers(len(special))],
        random.uniform(0, 10),
        10.0 ** random.uniform(-300, 300),
        random.uniform(0, 1),
        10.0 ** random.uniform(-3, 16),
    )
    return float(size[kind]) * (1 if random.integers(2) else -1)


def between(random: np.random.Generator) -> tuple[float, float]:
    """Two numbers in order: far apart, near, neighbours, the same."""
    low, kind = ends(random), random.integers(5)
    high = (
        low,
        np.nextafter(low, MOST),
        low + abs(low) * 10.0 ** random.uniform(-12, 0),
        low + random.uniform(0, 7),
        ends(random),
    )[kind]
    high = float(min(high, MOST))
    return (low, high) if low <= high else (high, low)


def inside(random: np.random.Generator, low: float, high: float, count: int) -> Floats:
    """Numbers between two: both, their neighbours, some in proportion and some by order of size."""
    parts = np.concatenate([[0.0, 1.0], random.uniform(0, 1, count // 2)])
    found = [low * (1 - parts) + high * parts, np.nextafter([low, high], [high, low])]
    sides = [(max(low, LEAST), high)] if high > 0 else []
    sides += [(-min(high, -LEAST), -low)] if low < 0 else []
    for k, (small, large) in enumerate(sides):
        logs = np.exp(random.uniform(math.log(small), math.log(large), count // 2))
        found.append(logs if k == 0 and high > 0 else -logs)
    return np.clip(np.concatenate([*found, [0.0]]), low, high)


def _rooted(x: Any) -> Any:
    return mpmath.power(x, mpmath.mpf(1.25)) if x >= 0 else mpmath.nan


def _thrice(x: Any) -> Any:
    return mpmath.power(x, mpmath.mpf(0.3)) if x >= 0 else mpmath.nan


def _real(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of reals that is none where it is not real."""

    def found(*given: Any) -> Any:
        try:
            value = function(*given)
        except (ZeroDivisionError, ValueError):
            return mpmath.nan
        return value if not isinstance(value, mpmath.mpc) else mpmath.nan

    return found


# each operation: its text, numpy's, mpmath's, and the tightest intervals
One = tuple[str, Callable[..., Any], Callable[..., Any], Callable[..., Any] | None]
OPERATIONS: dict[str, One] = {
    "add": ("x + y", np.add, mpmath.fadd, lambda x, y: x + y),
    "subtract": ("x - y", np.subtract, mpmath.fsub, lambda x, y: x - y),
    "multiply": ("x*y", np.multiply, mpmath.fmul, lambda x, y: x * y),
    "divide": ("x/y", np.divide, _real(mpmath.fdiv), lambda x, y: x / y),
    "negative": ("-x", np.negative, mpmath.fneg, lambda x: -x),
    "square": ("x**2", np.square, lambda x: x * x, ival.sqr),
    "cube": ("x**3", lambda x: x * x * x, lambda x: x**3, lambda x: x**3),
    "fifth": ("x**5", lambda x: (x * x) * (x * x) * x, lambda x: x**5, lambda x: x**5),
    "inverse": ("x**-1", lambda x: 1 / x, _real(lambda x: 1 / x), lambda x: 1 / x),
    "inverse square": ("x**-2", lambda x: 1 / (x * x), _real(lambda x: x**-2), lambda x: x**-2),
    "root": ("x**0.5", np.sqrt, _real(mpmath.sqrt), ival.sqrt),
    "half powers": ("x**-1.5", lambda x: 1 / (x * np.sqrt(x)), _real(lambda x: 1 / (x * mpmath.sqrt(x))), None),
    "1.25": ("x**1.25", lambda x: x**1.25, _rooted, lambda x: ival.pow(x, 1.25)),
    "0.3": ("x**0.3", lambda x: x**0.3, _thrice, lambda x: ival.pow(x, 0.3)),
    "abs": ("abs(x)", np.abs, abs, abs),
    "sign": ("sign(x)", np.sign, mpmath.sign, ival.sign),
    "min": ("min(x, y)", np.minimum, min, ival.min),
    "max": ("max(x, y)", np.maximum, max, ival.max),
    "hypot": ("hypot(x, y)", np.hypot, mpmath.hypot, None),
    "atan2": ("atan2(x, y)", np.arctan2, mpmath.atan2, ival.atan2),
    "sqrt": ("sqrt(x)", np.sqrt, _real(mpmath.sqrt), ival.sqrt),
    "exp": ("exp(x)", np.exp, mpmath.exp, ival.exp),
    "log": ("log(x)", np.log, _real(mpmath.log), ival.log),
    "sin": ("sin(x)", np.sin, mpmath.sin, ival.sin),
    "cos": ("cos(x)", np.cos, mpmath.cos, ival.cos),
    "tan": ("tan(x)", np.tan, mpmath.tan, ival.tan),
    "asin": ("asin(x)", np.arcsin, _real(mpmath.asin), ival.asin),
    "acos": ("acos(x)", np.arccos, _real(mpmath.acos), ival.acos),
    "atan": ("atan(x)", np.arctan, mpmath.atan, ival.atan),
    "sinh": ("sinh(x)", np.sinh, mpmath.sinh, ival.sinh),
    "cosh": ("cosh(x)", np.cosh, mpmath.cosh, ival.cosh),
    "tanh": ("tanh(x)", np.tanh, mpmath.tanh, ival.tanh),
    "less": (
        "where(x < y, x, y + 1)",
        lambda x, y: np.where(x < y, x, y + 1),
        lambda x, y: x if x < y else y + 1,
        None,
    ),
    "at most": (
        "where(x <= y, x, y + 1)",
        lambda x, y: np.where(x <= y, x, y + 1),
        lambda x, y: x if x <= y else y + 1,
        None,
    ),
    "more": (
        "where(x > y, x, y + 1)",
        lambda x, y: np.where(x > y, x, y + 1),
        lambda x, y: x if x > y else y + 1,
        None,
    ),
    "at least": (
        "where(x >= y, x, y + 1)",
        lambda x, y: np.where(x >= y, x, y + 1),
        lambda x, y: x if x >= y else y + 1,
        None,
    ),
    "equal": ("where(x == y, 7, y)", lambda x, y: np.where(x == y, 7, y), lambda x, y: 7 if x == y else y, None),
    "unequal": ("where(x != y, 7, y)", lambda x, y: np.where(x != y, 7, y), lambda x, y: 7 if x != y else y, None),
}


def misses(name: str, seed: int, count: int, points: int, exact: int) -> list[str]:
    """Enclose an operation on random intervals; say where a value is outside."""
    text, numeric, real, _ = OPERATIONS[name]
    arity, random, found = 1 + (", y" in text or "y" in text.replace("sy", "")), np.random.default_rng(seed), []
    run = machine(text)
    for _ in range(count):
        given = [between(random) for _ in range(arity)]
        low, high, flaw = enclosed(run, *given)
        xs = [
            random.permutation(inside(random, *one, points))[:points] if arity > 1 else inside(random, *one, points)
            for one in given
        ]
        size = min(map(len, xs))
        xs = [one[:size] for one in xs]
        with np.errstate(all="ignore"):
            values = np.asarray(numeric(*xs), float)
        seen = values[~np.isnan(values)]
        if seen.size < values.size and flaw != UNBOUNDED:
            found.append(f"{name} {given} -> {low, high}: is nowhere said to be undefined")
        for x, value in zip(zip(*xs, strict=True), values, strict=True):
            if value < low or value > high:
                found.append(f"{name} {given} -> {low, high}: {value!r} at {x} is outside")
                break
        for x in list(zip(*xs, strict=True))[:: max(1, size // exact)]:
            value = real(*map(mpmath.mpf, x))
            if not mpmath.isnan(value) and (value < low or value > high):
                found.append(f"{name} {given} -> {low, high}: exact {mpmath.nstr(value, 25)} at {x} is outside")
                break
    return found


@pytest.mark.every(5)
@pytest.mark.parametrize("name", OPERATIONS)
def test_every_value_is_enclosed(name: str) -> None:
    """Assert of every operation that no value on random intervals is outside its enclosure."""
    assert misses(name, 1, 60, 300, 8) == []


@pytest.mark.every(17)
@pytest.mark.parametrize("outside", OUTSIDE)
@pytest.mark.parametrize("interpolation", INTERPOLATIONS)
def test_every_value_of_a_drive_is_enclosed(interpolation: str, outside: str) -> None:
    """Assert that no value or slope of a table is outside its enclosure, on its points and beyond its ends neither."""
    run, random = machine("curve", interpolation, outside), np.random.default_rng(2)
    points = [-3.0, -1.0, 0.0, 0.5, 0.7, 3.0, 4.0, 9.0]
    for _ in range(150):
        one, other = (random.choice(points) if random.integers(3) == 0 else random.uniform(-4, 10) for _ in range(2))
        low, high = min(one, other), max(one, other)
        if random.integers(2):
            high = min(high, low + 10.0 ** random.uniform(-16, 0))
        for slope, law in ((False, "_value_at"), (True, "_slope_at")):
            least, most, flaw = enclosed(run, (low, high), slope=slope)
            xs = [x for x in (*inside(random, low, high, 40), *points) if low <= x <= high]
            pieces = [PYTHON_TABLES["_find_piece"](run.tables, run.places, x, 0) for x in xs]
            values = [PYTHON_TABLES[law](run.tables, run.places, x, k, 0) for x, k in zip(xs, pieces, strict=True)]
            assert flaw == UNBOUNDED or all(least <= value <= most for value in values), (low, high, least, most)


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_rough_waves_are_enclosed(name: str) -> None:
    """Assert that one call for a sine instead of two, as the first look at a step makes, loses no value."""
    run, random = machine.__wrapped__(f"{name}(x)"), np.random.default_rng(4)
    run.piece[0].rough = 1
    for _ in range(500):
        low = float(10.0 ** random.uniform(-3, 14.9) * random.choice([-1, 1]))
        high = float(
            random.choice(
                [
                    np.nextafter(low, np.inf),
                    low + random.uniform(0, 1) * np.spacing(abs(low)) * 8,
                    low + random.uniform(0, 7),
                ]
            )
        )
        least, most, _ = enclosed(run, (low, high))
        for x in inside(random, low, high, 10):
            assert least <= getattr(mpmath, name)(mpmath.mpf(x)) <= most, (low, high)


def test_poles_of_the_tangent_are_seen() -> None:
    """Assert that an interval with a pole in it is known to have one, however far out."""
    run, random = machine("tan(x)"), np.random.default_rng(6)
    for _ in range(500):
        pole = (int(10.0 ** random.uniform(0, 14.5)) + mpmath.mpf(1) / 2) * mpmath.pi
        spacing = float(np.spacing(float(pole)))
        low, high = (float(pole) + side * random.integers(5) * spacing for side in (-1, 1))
        least, most, _ = enclosed(run, (low, high))
        if low < pole < high:
            assert (least, most) == (-math.inf, math.inf)
        for x in (low, high):
            assert least <= mpmath.tan(mpmath.mpf(x)) <= most


def excess(name: str, seed: int, count: int) -> float:
    """How far enclosures are wider than the tightest interval: the 95th of 100, in eps of the larger end."""
    text, _, _, tightest = OPERATIONS[name]
    run, random, found = machine(text), np.random.default_rng(seed), []
    assert tightest is not None
    for _ in range(count):
        given = [tuple(sorted(random.uniform(0.01, 0.99, 2))) for _ in range(1 + ("y" in text))]
        low, high, _ = enclosed(run, *given)
        tight = tightest(*(ival.Interval(*one) for one in given))
        assert low <= tight.lo <= tight.hi <= high
        found.append(max(tight.lo - low, high - tight.hi) / (EPS * max(abs(tight.lo), abs(tight.hi))))
    return float(np.quantile(found, 0.95))


@pytest.mark.every(11)
@pytest.mark.parametrize("name", [name for name, operation in OPERATIONS.items() if operation[-1] is not None])
def test_enclosures_are_tight(name: str) -> None:
    """Assert that an enclosure holds the tightest interval there is, and ends within a few roundings of it."""
    assert excess(name, 8, 60) < 16


def test_what_is_undefined_is_neither_less_nor_more() -> None:
    """Assert that a comparison with what may be no number chooses neither side."""
    run = machine("where(sqrt(x) < 2, 1, 3)")
    assert enclosed(run, (-1.0, 1.0)) == (1.0, 3.0, BREAKS)
    assert enclosed(run, (0.5, 1.0)) == (1.0, 1.0, SMOOTH)


@pytest.mark.parametrize("width", [0.01, 0.5, 1.5, 3.1415, 6.2831])
def test_motion_between_two_states_is_enclosed(width: float) -> None:
    """Assert that a sine is held between two of its states: a period of a coordinate's, half a one of a first-order state's."""
    run, random = machine("x"), np.random.default_rng(9)
    n, used, s = run.plan[0].coordinates, run.plan[0].used, np.linspace(0, width, 300)
    for phase in (0.0, math.pi / 2, *random.uniform(0, 2 * math.pi, 100)):
        q, v, a = np.sin(s + phase), np.cos(s + phase), -np.sin(s + phase)
        for state, k in ((run.y, 0), (run.z, -1)):
            state[[0, n, used, 2 * n, used + n]] = q[k], v[k], a[k], q[k], v[k]
        rows = list(zip(("position", "velocity", "acceleration"), (q, v, a), strict=True))
        rows += [("state", q), ("rate", v)] if width < math.pi else []
        for name, values in rows:
            low, high, _ = between_states(name, run.y, run.z, PLACES[name], width)
            assert low <= values.min(), (name, phase)
            assert values.max() <= high, (name, phase)


def hull(degree: int, *values: float) -> tuple[float, float]:
    """The least and the largest Bernstein coefficient of the polynomial through values at equal distances."""
    s = np.linspace(0.0, 1.0, degree + 1)
    basis = np.stack([math.comb(degree, k) * s**k * (1.0 - s) ** (degree - k) for k in range(degree + 1)], axis=1)
    found = np.linalg.solve(basis, np.array(values))
    return float(found.min()), float(found.max())


def between_two(motion: Callable[[Floats], tuple[Floats, ...]], width: float) -> dict[str, tuple[float, float]]:
    """Enclosures of a coordinate and its rates, and of a first-order state and its own, between two states of a motion."""
    run = machine("x")
    n, used = run.plan[0].coordinates, run.plan[0].used
    for state, at in ((run.y, 0.0), (run.z, width)):
        q, v, a = (float(one[0]) for one in motion(np.array([at])))
        state[[0, n, used, 2 * n, used + n]] = q, v, a, q, v
    return {name: between_states(name, run.y, run.z, places, width)[:2] for name, places in PLACES.items()}


@pytest.mark.parametrize("size", [1.0, 1e6, 1e-6])
@pytest.mark.parametrize("seed", range(3))
def test_polynomials_between_two_states_have_their_hull(seed: int, size: float) -> None:
    """Assert that of a cubic motion, and of a state with a constant rate, enclosures end in Bernstein coefficients, to rounding."""
    c, width = (
        size * np.random.default_rng(seed).normal(size=4),
        float(np.random.default_rng([seed, 1]).uniform(0.1, 3.0)),
    )

    def cubic(t: Floats) -> tuple[Floats, ...]:
        return c[0] + t * (c[1] + t * (c[2] + t * c[3])), c[1] + t * (2 * c[2] + t * 3 * c[3]), 2 * c[2] + 6 * c[3] * t

    found = between_two(cubic, width)
    for order, (name, degree) in enumerate({"position": 5, "velocity": 3, "acceleration": 1}.items()):
        expected = hull(degree, *cubic(np.linspace(0.0, width, degree + 1))[order].tolist())
        assert found[name] == pytest.approx(expected, abs=1e-11 * size)
    straight = between_two(lambda t: (c[0] + c[1] * t, c[1] + 0.0 * t, 0.0 * t), width)
    assert straight["state"] == pytest.approx(hull(1, c[0], c[0] + c[1] * width), abs=1e-11 * size)
    assert straight["rate"] == pytest.approx((c[1], c[1]), abs=1e-11 * size)


def test_enclosures_of_motion_become_tight_with_their_width() -> None:
    """Assert by how much the range of a sine is exceeded at most, by powers of the width: from rates and changes of them."""
    for width in (0.2, 0.1, 0.05):
        s = np.linspace(0.0, width, 400)
        for phase in (0.0, 0.7, 2.0, 4.0):
            q, v, a = np.sin(s + phase), np.cos(s + phase), -np.sin(s + phase)
            found = between_two(
                lambda t, phase=phase: (np.sin(t + phase), np.cos(t + phase), -np.sin(t + phase)), width
            )
            limits = {
                "position": (q, width**4 / 800),
                "velocity": (v, width**2 / 20),
                "acceleration": (a, 0.3 * width**2),
            }
            limits |= {"state": (q, width**2 / 15), "rate": (v, 4.0 * width)}
            for name, (values, most) in limits.items():
                low, high = found[name]
                assert values.min() - most <= low <= values.min(), (name, width, phase)
                assert values.max() <= high <= values.max() + most, (name, width, phase)


def test_rows_of_a_piece_are_enclosed_by_what_they_read() -> None:
    """Assert times, parameters, numbers, states and coordinates of an event function between two states."""
    states = {"s": {"unit": "1", "rate": "2/second"}}
    for function, low, high in (
        ("t/second - 7", -6.5, -6.25),
        ("k - 1", 2.0, 2.0),
        ("s", 5.0, 5.5),
        ("q/metre + 3*k", 10.0, 10.25),
        ("v_q/(1*metre/second)", 1.0, 1.0),
        ("2*s - t/second", 9.25, 10.5),
    ):
        model = xd.Model(
            name="rows",
            coordinates={"q": "m"},
            parameters={"k": "3"},
            mass={"q": "1*kilogram"},
            forces={},
            states=states,
            initial={"q": "1 m", "v_q": "1 m s-1", "s": "5"},
            events={"e": {"function": function}},
        )
        run = March(model, Settings(xd.METHODS["rk4"], until=1.0, step=0.25)).run
        run.piece[0].start, run.piece[0].end, run.piece[0].width = 0.5, 0.75, 0.25
        n, used = run.plan[0].coordinates, run.plan[0].used
        for state, at in ((run.y, 0.0), (run.z, 0.25)):
            state[[0, n, used, 2 * n, used + n]] = 1.0 + at, 1.0, 0.0, 5.0 + 2.0 * at, 2.0
        run.put(functions=rules_in_python())
        plain(enclose_functions)(run, run.y, run.z, 0, run.parts[1], ALL)
        place = run.detectors[0].value
        assert (run.under[place], run.over[place]) == pytest.approx((low, high), abs=1e-12), function


BETWEEN = """
import sys
import numpy as np
import xdynamics as xd
from cases.problems import MODELS, coupled_springs
from cases.plain import between_states
from xdynamics.march import loop, trial_step
from xdynamics.march.run import ARRAYS

KEPT = [name for name in ARRAYS if not name.startswith("log_") and name not in ("law", "functions", "base")]

def accept(run, old=loop.accept):
    n, used, t, h = run.plan[0].coordinates, run.plan[0].used, run.now[0].t, run.trial[0].h
    before = {name: getattr(run, name).copy() for name in KEPT}
    cuts = np.concatenate([[0.0], np.sort(random.uniform(0, h, 50)), [h]])
    states = [run.y.copy()]
    for s in cuts[1:]:
        trial_step.propose_step(run, t + s, s)
        states.append(run.z.copy())
        for name, array in before.items():
            getattr(run, name)[...] = array
    states = np.array(states)
    for first, last in ((0, 51), (0, 26), (12, 40), (30, 34)):
        here, width = states[first : last + 1], cuts[last] - cuts[first]
        asked = [(("position", "velocity", "acceleration")[k], (i, n + i, used + i), k) for i in range(n) for k in range(3)]
        asked += [(("state", "rate")[k], (2 * n + i, used + n + i), k) for i in range(used - 2 * n) for k in range(2)]
        for name, places, k in asked:
            low, high, _ = between_states(name, here[0], here[-1], places, width)
            count[0] += 1
            if not low <= here[:, places[k]].min() <= here[:, places[k]].max() <= high:
                print("lost", method, model.name, t, h, name, places, first, last)
    for name, array in before.items():
        getattr(run, name)[...] = array
    old(run)

loop.accept, random, count = accept, np.random.default_rng(3), [0]
for model, until in ((coupled_springs().model, 0.5), (xd.Model.from_toml(MODELS / "kepler.toml"), 0.8), (xd.Model.from_toml(MODELS / "double_pendulum.toml"), 0.3)):
    import tomllib
    statement = tomllib.loads(model.to_toml())
    model = xd.Model(**statement | {"events": {"e": {"function": "t - 1e3*second"}}})
    for method, one in xd.METHODS.items():
        if one.order < 4 or (model.name == "Double pendulum" and not one.estimate):
            continue
        asked = {} if one.estimate else {"estimator": "step_doubling"}
        try:
            xd.simulate(model, method=method, rtol=1e-4, until=until, **asked)
        except xd.InputError as error:
            if "refuses" not in str(error):
                raise
print(count[0])
"""


@pytest.mark.dear
def test_shortened_steps_are_enclosed() -> None:
    """Assert of every method of order 4 or more that states of shortened steps lie in the intervals between two of them."""
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    plainly = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": paths}
    told = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", BETWEEN], env=plainly, capture_output=True, text=True, check=True
    ).stdout
    *lost, count = told.splitlines()
    assert lost == []
    assert int(count) > 1000


SAME = """
import sys
import numpy as np
import xdynamics as xd
from xdynamics.march.runner import March
from xdynamics.march.settings import Settings
states = {"x": {"unit": "1", "rate": "3*cos(7*t/second)/second"}, "y": {"unit": "1", "rate": "-2*sin(5*t/second)/second"}}
drives = {"curve": {"table": "d.csv", "csv": "q [m],curve [1]\\n-3,1.5\\n0,0.1\\n0.5,0.3\\n0.7,5\\n9,1e3\\n", "argument": "q", "interpolation": "cubic", "outside": "hold"}}
model = xd.Model(name="all", coordinates={"q": "m"}, parameters={"m": "1 kg"}, mass={"q": "m"}, forces={}, states=states, drives=drives,
    initial={"q": "-1 m", "v_q": "1 m s-1", "x": "0.5", "y": "0.55"}, events={f"e{i}": {"function": one} for i, one in enumerate(sys.argv[1:])})
march = March(model, Settings(xd.METHODS["rk4"], until=2.0, step=0.1))
for block in march.blocks(rows=64):
    print(block.rows, block.events, block.log.events[:block.events].tobytes().hex())
print(*(one.tobytes().hex() for one in (march.run.under, march.run.over, march.run.flaws)))
"""


@pytest.mark.dear
def test_compiled_equals_plain_python() -> None:
    """Assert that intervals of every operation have the same bits without numba."""
    command = [sys.executable, "-c", SAME, "curve - 1", *(text for text, *_ in OPERATIONS.values())]
    without = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    first, second = (
        subprocess.run(command, env=one, capture_output=True, text=True, check=True).stdout
        for one in (os.environ, without)
    )
    assert first == second
    assert len(first) > 5_000


if __name__ == "__main__":
    for name in OPERATIONS:
        found = misses(name, int(sys.argv[1]), int(sys.argv[2]), 2000, 20)
        print(name, len(found), *found[:3], sep="\n   ")
