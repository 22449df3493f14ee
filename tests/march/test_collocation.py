"""Members marched by Radau IIA side by side: each has the bits that it has alone; and the parts that this is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from stiff_problems import STIFF

import xdynamics as xd
from cases.plain import plain
from xdynamics.kernels import collocation, law_of, linear
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Compute, Load, Location, Operand, Program, ProgramCall, StoreTo, When, While
from xdynamics.kernels.python_text import PYTHON, python_of
from xdynamics.march import Runs, march_many
from xdynamics.march.configuration import settings_for
from xdynamics.march.simd_ensemble import lanes_for

N = 37
COMPARED = ("time", "state", "status", "rows", "trials", "evaluations", "largest", "ends", "events")


def assert_same(one: Runs, other: Runs) -> None:
    """Assert that two results agree in every bit, the numbers of Jacobians and factorisations and the logs included."""
    for name in COMPARED:
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name
    assert one.log_block.log.rows.tobytes() == other.log_block.log.rows.tobytes()


def solved_in_lanes(model: xd.Model, lanes: int, *, logs: bool = False, given: Any, **asked: Any) -> Runs:
    """March members alone and in lanes; assert that there are lanes, and the same bits."""
    settings = settings_for(model, method="radau_iia", force_samples="none", **asked)
    assert lanes_for(law_of(settings.layout(model), sampled=False), settings, N, lanes) == lanes
    alone = march_many(model, settings, lanes=1, logs=logs, **given)
    assert_same(march_many(model, settings, lanes=lanes, logs=logs, **given), alone)
    return alone


def masses(count: int, draw: np.random.Generator) -> tuple[xd.Model, dict[str, Any]]:
    """Return masses in a row with springs, some of them cubic, and a drag on some; and members of them."""
    names = [f"x{i}" for i in range(count)]
    springs = {f"s{i}": {"potential": f"k*(x{i} - x{i - 1})**2/2" if i else "k*x0**2/2"} for i in range(count)}
    cubic = {f"c{i}": {"potential": f"c*x{i}**4/4"} for i in range(count) if draw.random() < 0.5}
    drag = {name: f"-{draw.uniform(0.0, 30.0)!r}*newton*second/metre*v_{name}" for name in names if draw.random() < 0.6}
    model = xd.Model(
        name="masses",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "k": "4 N m-1", "c": "2 N m-3"},
        mass=dict.fromkeys(names, "m"),
        forces=springs | cubic | ({"drag": drag} if drag else {}),
        initial={name: f"{0.3 * (-1) ** i} m" for i, name in enumerate(names)}
        | {f"v_{name}": "0 m s-1" for name in names},
        events={"met": {"function": "x0 - 0.1*metre"}} if draw.random() < 0.4 else {},
    )
    varied = {"k": 10.0 ** draw.uniform(-1.0, 4.0, N), "c": draw.uniform(0.0, 90.0, N)}
    return model, {"parameters": varied, "initial": {"x0": draw.uniform(-0.5, 0.5, N)}}


@pytest.mark.cases(46)
def test_random_masses(case: int) -> None:
    """Assert the bits of one lane: one to four masses, tolerances given or following, logs and ends, events among them."""
    draw = np.random.default_rng(case)
    model, given = masses(1 + case % 4 if case != 23 else 2, draw)
    rtol = 10.0 ** draw.uniform(-9.0, -3.0)
    tolerances = {"rtol": rtol, "atol": rtol} if draw.random() < 0.5 else {"rtol": rtol}
    lanes, logs = int(draw.choice([2, 4, 16])), bool(draw.integers(2))
    found = solved_in_lanes(model, lanes, logs=logs, given=given, until=5.0, **tolerances)
    assert {*found.outcomes} == {"completed"}


@pytest.mark.parametrize(("name", "first", "small"), [("van_der_pol", "x", 1.0), ("robertson", "b", 1e-8)])
def test_stiff_problems(name: str, first: str, small: float) -> None:
    """Assert the bits of one lane where Newton's iterations fail, derivatives grow old and steps are rejected."""
    model = STIFF[name].model()
    given = {"initial": {first: model.initial[first].si + np.linspace(0.0, 0.1 * small, N)}}
    found = solved_in_lanes(model, 4, given=given, until=STIFF[name].end, rtol=1e-4, atol=1e-4 * small)
    assert (found.trials > 0).all()
    assert (found.ends["jacobians"] > 10).all()


def test_nodes_and_first_steps() -> None:
    """Assert the bits of one lane behind the breakpoints of a measured force, with a first step of each member's own."""
    model = xd.Model(
        name="driven",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"push": {"x": "push"}, "spring": {"potential": "newton/metre*x**2/2"}},
        drives={
            "push": {
                "table": "p.csv",
                "csv": "t [s],p [N]\n0,0\n0.5,1\n0.6,-1\n1.7,2\n3,0\n",
                "interpolation": "previous",
            }
        },
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    given = {"initial": {"x": np.linspace(-1.0, 1.0, N)}, "steps": np.geomspace(1e-4, 2.0, N)}
    solved_in_lanes(model, 4, logs=True, given=given, until=2.9, step=0.1, rtol=1e-6, nodes=[0.55, 1.0])


def test_what_stays_alone() -> None:
    """Assert that given steps, judged by halves, and larger systems are marched one after the other."""
    small, large = (masses(count, np.random.default_rng(0))[0] for count in (1, 6))
    for model, asked in ((small, {"step": 0.1}), (small, {"estimator": "step_doubling"}), (large, {})):
        settings = settings_for(model, method="radau_iia", until=1.0, force_samples="none", **asked)
        assert lanes_for(law_of(settings.layout(model), sampled=False), settings, N, 4) == 1


# -------------------------------------------------------------------------------------------------------- elimination


def written(solve: Any, count: int) -> Any:
    """Return lines that some numbers go through as a function of them."""
    lines = Assignments(lambda own, name: own.load(Location("y", int(name))))
    given: list[Operand] = [lines.load(Location("y", i)) for i in range(count)]
    for i, value in enumerate(solve(lines, given)):
        lines.store(Location("z", i), value)
    scope = dict(PYTHON) | {"_zero": np.float64(0.0)}
    exec(python_of(Program("one", "Elimination.", tuple(lines.lines))), scope)

    def made(numbers: np.ndarray, length: int) -> np.ndarray:
        found = np.full(length, np.nan)
        with np.errstate(all="ignore"):
            scope["one"](None, numbers, None, None, None, found, None, None, None)
        return found

    return made


def real_solved(lines: Assignments, given: list[Operand], n: int) -> list[Operand]:
    """Factorise a matrix, column by column, and solve for what stands behind it."""
    m = [[(one,) for one in given[j * n : (j + 1) * n]] for j in range(n)]
    right = [(one,) for one in given[n * n :]]
    pivots, sound = collocation.factorise_columns(lines, m)
    collocation.substitute_columns(lines, m, pivots, right)
    return [one for column in m for (one,) in column] + pivots + [one for (one,) in right] + [sound]


def complex_solved(lines: Assignments, given: list[Operand], n: int) -> list[Operand]:
    """The same for a complex one, real parts first."""
    entries = list(zip(given[: n * n], given[n * n : 2 * n * n], strict=True))
    m = [entries[j * n : (j + 1) * n] for j in range(n)]
    right = list(zip(given[2 * n * n : 2 * n * n + n], given[2 * n * n + n :], strict=True))
    pivots, sound = collocation.factorise_columns(lines, m)
    collocation.substitute_columns(lines, m, pivots, right)
    planes = [entry[part] for part in range(2) for column in m for entry in column]
    return planes + pivots + [entry[part] for part in range(2) for entry in right] + [sound]


@pytest.mark.parametrize("n", [1, 2, 3, 5])
def test_elimination_has_the_bits_of_the_single_march(n: int) -> None:
    """Assert it for random matrices with zeros of both signs, whose rows are exchanged, and for singular ones."""
    draw = np.random.default_rng(n)
    real = written(lambda lines, given: real_solved(lines, given, n), n * n + n)
    both = written(lambda lines, given: complex_solved(lines, given, n), 2 * n * n + 2 * n)
    regular = 0
    for _ in range(40):
        matrix = draw.normal(size=3 * n * n) * 10.0 ** draw.integers(-3, 4, 3 * n * n)
        matrix[draw.random(3 * n * n) < 0.5] = draw.choice([0.0, -0.0])
        right = np.where(draw.random(2 * n) < 0.3, -0.0, draw.normal(size=2 * n))
        pivots, kept, own, twice = np.zeros(6 * n, np.int64), matrix.copy(), right[:n].copy(), right.copy()
        sound = plain(linear.factorise)(matrix, pivots, n), plain(linear.factorise_complex)(matrix, pivots, n)
        one = real(np.concatenate([kept[: n * n], own]), n * n + 2 * n + 1)
        other = both(np.concatenate([kept[n * n :], twice]), 2 * n * n + 3 * n + 1)
        assert (one[-1], other[-1]) == sound
        if all(sound):
            regular += 1
            plain(linear.substitute)(matrix, pivots, own, n)
            plain(linear.substitute_complex)(matrix, pivots, twice, n)
            expected = [*matrix[: n * n], *pivots[:n], *own]
            assert one[:-1].tobytes() == np.array(expected).tobytes()
            expected = [*matrix[n * n :], *pivots[3 * n : 4 * n], *twice]
            assert other[:-1].tobytes() == np.array(expected).tobytes()
    assert regular > 3


def test_calls_where_a_number_asks_for_them() -> None:
    """Assert that a call is made where a number is not zero, and another one until it is."""
    less = (Load("_n", Location("w")), Compute("_less", "subtract", ("_n", 1.0)), StoreTo(Location("w"), "_less"))
    more = (Load("_n", Location("w", 1)), Compute("_more", "add", ("_n", 5.0)), StoreTo(Location("w", 1), "_more"))
    body = (
        While(Location("w"), ProgramCall("less", "at", "y", "z")),
        When(Location("w"), ProgramCall("more", "at", "y", "z")),
        When(Location("w", 2), ProgramCall("more", "at", "y", "z")),
    )
    scope: dict[str, Any] = {}
    for program in (Program("less", "", less), Program("more", "", more), Program("own", "", body)):
        exec(python_of(program), scope)
    w = np.array([7.0, 0.0, 1.0])
    scope["own"](*[None] * 8, w)
    assert w.tolist() == [0.0, 5.0, 1.0]
