"""The number of a tree, against compiled code and against IEEE 754.

Expressions as a list of operations: the bits of `evaluate`, tree by tree, on random trees that share their parts.
"""

from __future__ import annotations

import math
import random
import struct
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import particle
from xdynamics.expressions import FUNCTIONS, Binary, Call, Compare, Name, Negative, Node, Number, parse
from xdynamics.expressions.evaluation import Tape, evaluate, evaluate_many
from xdynamics.faults import InputError
from xdynamics.model.linearisation import derivative_assignments, initial_state, linearise
from xdynamics.model.motion import constants, drive_pieces, motion

CALLS = {name: f"{name}(u)" for name, arguments in FUNCTIONS.items() if arguments == 1} | {
    "acosh_free": "acos(u/8) + asin(u/9)",
    "atan2": "atan2(u, -2)",
    "hypot": "hypot(u, 3)",
    "min": "min(u, 2, -u)",
    "max": "max(1, u, 2)",
    "where": "where(u*u >= 2, u, -u)",
    "cube": "u**3",
    "seventh": "u**-7",
    "twelfth": "u**12",
    "root": "u**0.5",
    "power_three_halves": "u**(3/2)",
    "power_minus_five_halves": "u**-2.5",
    "third": "u**(1/3)",
    "quotient": "(u - 3)/(u*7 - 1)",
}


def test_numbers_are_those_of_compiled_code() -> None:
    """Assert that a recorded observable has the bits of its evaluation, for every function of the language."""
    observables = {f"o_{name}": text for name, text in CALLS.items() if name not in ("asin", "acos")}
    model = particle(definitions={"u": "x/metre"}, observables=observables)
    run = xd.simulate(model, method="forward_euler", step=0.37, until=0.74)
    for x, row in zip(run.x.values, range(3), strict=True):
        for name, text in observables.items():
            assert evaluate(parse(text), {"u": float(x)}) == float(run[name][row]), name


@pytest.mark.parametrize(
    ("text", "number"),
    [
        ("1/zero", math.inf),
        ("-1/zero", -math.inf),
        ("1/(-zero)", -math.inf),
        ("zero/zero", math.nan),
        ("zero**-1", math.inf),
        ("(-zero)**-3", -math.inf),
        ("sqrt(-1)", math.nan),
        ("log(zero)", -math.inf),
        ("log(-1)", math.nan),
        ("exp(1000)", math.inf),
        ("exp(-1000)", 0.0),
        ("sinh(-1000)", -math.inf),
        ("cosh(-1000)", math.inf),
        ("sin(1/zero)", math.nan),
        ("asin(2)", math.nan),
        ("acos(-2)", math.nan),
        ("(-1)**(1/3)", math.nan),
        ("1e300*1e300", math.inf),
        ("(1e300)**2", math.inf),
        ("1e300**(4/3)", math.inf),
        ("sign(-3)", -1.0),
        ("sign(zero/zero)", math.nan),
        ("min(zero/zero, 1)", math.nan),
        ("max(1, zero/zero)", math.nan),
        ("where(zero/zero < 1, 2, 3)", 3.0),
        ("zero**0", 1.0),
    ],
)
def test_no_arithmetic_raises(text: str, number: float) -> None:
    """Assert that what has no finite value gives the infinity or nan of IEEE 754."""
    assert evaluate(parse(text), {"zero": 0.0}) == pytest.approx(number, rel=0, abs=0, nan_ok=True)


def test_a_name_without_a_value_is_told() -> None:
    """Assert that a missing name is named, with those that are there."""
    with pytest.raises(xd.InputError, match="name 'k' has no value; there are x, y"):
        evaluate(parse("k*x"), {"x": 1.0, "y": 2.0})


def test_many_at_once_are_the_same_bits() -> None:
    """Assert for expressions with every function, at many values at once, the bits that one value at a time gives."""
    texts = [
        "where(x > y, x**-1.5, 1/0)",
        "min(x, y, 0.3) + max(x, y)",
        "abs(x)*sign(y) - sqrt(x)",
        "x**7/y**2 + x**0.7",
        "hypot(x, y)*atan2(x, y)",
        "sin(x) + cos(y) + tan(x)",
        "exp(-x) + log(y*y)",
        "asin(x/9) + acos(y/9) + atan(x)",
        "sinh(x) - cosh(y) + tanh(x)",
        "-x + 2",
    ]
    x, y = np.random.default_rng(5).normal(size=(2, 40))
    x[:3], y[:3] = (0.0, -0.0, np.nan), (1.0, 0.0, 2.0)
    for text in texts:
        tree = parse(text)
        many = np.broadcast_to(evaluate_many(tree, {"x": x, "y": y}), x.shape)
        each = np.array([evaluate(tree, {"x": a, "y": b}) for a, b in zip(x.tolist(), y.tolist(), strict=True)])
        assert np.array_equal(many, each, equal_nan=True), text


@pytest.mark.parametrize(
    "name", ["sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs", "sign"]
)
@pytest.mark.parametrize("x", [0.5, -0.25, 0.9, 1e-9])
def test_one_number_at_once_is_what_it_is_alone(name: str, x: float) -> None:
    """Assert that a function of a number is the same as a number, as an array without a dimension, and as one with one."""
    node = parse(f"{name}(x)")
    alone = evaluate(node, {"x": x})
    for given in (x, np.float64(x), np.array(x), np.array([x])):
        assert np.array_equal(np.ravel(evaluate_many(node, {"x": given})), [alone], equal_nan=True)
    if x > 0:
        both = parse("atan2(x, y) + hypot(x, y) + x**1.3")
        assert float(evaluate_many(both, {"x": np.float64(x), "y": 2.0})) == evaluate(both, {"x": x, "y": 2.0})


def test_an_observable_of_a_parameter_alone() -> None:
    """Assert that observables and energies with functions of parameters are the same between rows and in them."""
    model = particle(
        name="incline",
        parameters={"m": "1 kg", "g": "9.81 m s-2", "alpha": "0.5 rad"},
        forces={"weight": {"potential": "-m*g*x*cos(alpha)"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
        observables={"across": "x*cos(alpha)", "turned": "x*atan(alpha)*log(alpha)*tan(alpha)*cosh(alpha)"},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    study = xd.refine(
        model, method="rk4", steps=[0.1, 0.05], at=[1.0], observables=["across", "turned", "total_energy"], until=1.0
    )
    for name in ("across", "turned", "total_energy"):
        assert float(study[name][0, 0]) == pytest.approx(float(run[name][-1]), rel=1e-13, abs=1e-13)
    grid = xd.sweep(
        model, {"m": [1.0]}, keep=["across", "turned"], times=[1.0], method="rk4", step=0.1, until=1.0
    ).compute()
    assert float(grid.across[0, 0]) == float(study.across[0, 0])
    assert float(grid.turned[0, 0]) == float(study.turned[0, 0])


MODELS = sorted((Path(__file__).parents[2] / "data" / "models").glob("*.toml"))
EXPONENTS = (2.0, 3.0, 4.0, 7.0, 0.5, 1.5, 2.5, 0.0, 1.0, 0.25)
VALUES = (0.0, -0.0, 1.0, -2.5, 1e-310, 1e300, math.inf, -math.inf, math.nan)


def any_tree(rng: random.Random, parts: list[Node], depth: int) -> Node:
    """A tree of everything that the language has, parts of which stand in others too."""
    if depth == 0 or rng.random() < 0.1:
        return rng.choice(parts)
    kind = rng.randrange(6)
    inner = [any_tree(rng, parts, depth - 1) for _ in range(3)]
    if kind == 0:
        power = Number(rng.choice(EXPONENTS))
        found: Node = Binary("**", inner[0], rng.choice([power, Negative(power)]))
    elif kind == 1:
        found = Call(rng.choice(["sqrt", "abs", "sign", "sin", "exp", "log", "atan"]), (inner[0],))
    elif kind == 2:
        found = Call(rng.choice(["min", "max", "atan2", "hypot"]), tuple(inner[:2]))
    elif kind == 3:
        comparison = Compare(rng.choice(["<", "<=", ">", ">=", "==", "!="]), inner[0], inner[1])
        found = Call("where", (comparison, inner[1], inner[2]))
    elif kind == 4:
        found = Negative(inner[0])
    else:
        found = Binary(rng.choice("+-*/"), inner[0], inner[1])
    parts.append(found)
    return found


def bits(value: float) -> bytes:
    """What a number is made of; of what is none only that it is none."""
    return b"nan" if math.isnan(value) else struct.pack("<d", value)


@pytest.mark.cases(400)
def test_every_number_has_the_bits_of_its_tree(case: int) -> None:
    """Assert that expressions that use one another give what they give one by one, zeros with their signs."""
    rng = random.Random(case)
    parts: list[Node] = [*(Name(name) for name in "abc"), Number(0.0), Number(2.0), Number(0.1)]
    named = []
    for i in range(rng.randint(1, 5)):
        named.append((f"_{i}", any_tree(rng, parts, rng.randint(0, 5))))
        parts.append(Name(f"_{i}"))
    tape = Tape(named)
    for _ in range(5):
        values = {name: rng.choice([rng.gauss(0.0, 2.0), rng.choice(VALUES)]) for name in "abc"}
        found, expected = tape.evaluate_tape(values), dict(values)
        for name, tree in named:
            expected[name] = evaluate(tree, expected)
        assert {name: bits(value) for name, value in found.items()} == {name: bits(expected[name]) for name, _ in named}


def test_a_sum_may_be_long_and_equal_parts_are_computed_once() -> None:
    """Assert that ten thousand terms are taken in a loop, and that they cost one operation each."""
    term: Node = Call("sin", (Name("a"),))
    total = term
    for _ in range(9_999):
        total = Binary("+", total, Call("sin", (Name("a"),)))
    tape = Tape([("total", total), ("again", total)])
    assert len(tape._steps) == 10_000
    found = tape.evaluate_tape({"a": 1.0})
    assert found == {"total": evaluate(total, {"a": 1.0}), "again": found["total"]}


def test_a_name_means_what_it_was_given_last() -> None:
    """Assert that a tree that stands on both sides of a new meaning has both values, and that a name needs one."""
    tree = Binary("*", Name("a"), Name("a"))
    tape = Tape([("old", tree), ("a", Number(3.0)), ("new", tree)])
    assert tape.evaluate_tape({"a": 2.0}) == {"old": 4.0, "a": 3.0, "new": 9.0}
    with pytest.raises(InputError, match="name 'a' has no value; there are b"):
        tape.evaluate_tape({"b": 1.0})


@pytest.mark.every(3)
@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.stem)
def test_jacobians_of_the_gallery_have_the_bits_of_their_trees(path: Path) -> None:
    """Assert it of every derivative at the start, each tree evaluated by itself."""
    model = xd.Model.from_toml(path)
    if model.python_forces or model.drives or len(model.regimes) > 1:
        return
    state = initial_state(model)
    values = dict(constants(model)) | state | {"_regime": 0.0}
    assert drive_pieces(model) == ()
    for one in (*motion(model.elements), *derivative_assignments(model)):
        values[one.name] = evaluate(one.value, values)
    found = linearise(model, state).jacobian.tolist()
    names = (
        *model.elements.statement.coordinates,
        *(f"v_{name}" for name in model.elements.statement.coordinates),
        *model.elements.statement.states,
    )
    n = len(model.elements.statement.coordinates)
    for i, name in enumerate(model.elements.statement.coordinates):
        expected = [values.get(f"_da_{name}_{by}", 0.0) for by in names]
        assert list(map(bits, found[n + i])) == list(map(bits, expected))
