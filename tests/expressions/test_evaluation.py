"""The number of a tree, against compiled code and against IEEE 754."""

from __future__ import annotations

import math

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import particle
from xdynamics.expressions import FUNCTIONS, parse
from xdynamics.expressions.evaluation import evaluate, evaluate_many

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
    model = xd.Model(
        name="incline",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2", "alpha": "0.5 rad"},
        mass={"x": "m"},
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
