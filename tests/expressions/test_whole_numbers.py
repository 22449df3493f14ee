"""`floor`, `ceil`, `round`, `mod`: numpy's numbers, switches where they jump, and names that stay free.

Messages for texts that cannot be read name the whole text to write, which is then read.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.elementary.intervals import Interval, Intervals
from xdynamics.elementary.sets import SETS
from xdynamics.expressions import derivative, dimension_of, latex, parse, text_of
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.evaluation import evaluate, evaluate_many
from xdynamics.faults import InputError
from xdynamics.units import parse_unit

OF_NUMPY = {"floor(x)": np.floor, "ceil(x)": np.ceil, "round(x)": np.rint, "mod(x, y)": np.mod}


def numbers() -> tuple[np.ndarray, np.ndarray]:
    """Numbers of all sizes, ties, multiples, both signs, zeros and infinities."""
    rng = np.random.default_rng(3)
    x = np.concatenate([rng.normal(size=900) * 10.0 ** rng.integers(-8, 12, 900), np.arange(-50, 50) / 2])
    y = np.concatenate([rng.normal(size=900) * 10.0 ** rng.integers(-3, 3, 900), np.arange(-50, 50) / 4 + 0.125])
    x[:60] = y[:60] * np.arange(60)
    rest = np.array([0.0, -0.0, np.inf, -np.inf, np.nan, -0.3, 0.3, -1e-20, 1.0, -1.0])
    return np.concatenate([x, rest]), np.concatenate([y, [3.0] * 8, [np.inf] * 2])


@pytest.mark.parametrize("text", OF_NUMPY)
def test_numbers_are_those_of_numpy(text: str) -> None:
    """Assert every bit, of single numbers and of arrays."""
    x, y = numbers()
    with np.errstate(all="ignore"):
        expected = OF_NUMPY[text](x, y) if "y" in text else OF_NUMPY[text](x)  # type: ignore[operator]
        near = np.abs(x / y) < 2.0**53 if "y" in text else np.full(len(x), fill_value=True)
    single = np.array([evaluate(parse(text), {"x": a, "y": b}) for a, b in zip(x.tolist(), y.tolist(), strict=True)])
    assert np.array_equal(single, evaluate_many(parse(text), {"x": x, "y": y}), equal_nan=True)
    assert np.array_equal(single[near], expected[near], equal_nan=True)
    assert (np.signbit(single) == np.signbit(expected))[near & ~np.isnan(expected)].all()


@pytest.mark.parametrize("text", OF_NUMPY)
def test_intervals_hold_the_values_inside(text: str) -> None:
    """Assert bounds that hold what points between them give, and that a jump is known as one."""
    kind, name, rng = Intervals(SETS["xdynamics 2"]), text.split("(", maxsplit=1)[0], np.random.default_rng(4)
    for low, width, y in rng.normal(size=(200, 3)) * [5.0, 1.0, 2.0]:
        ends = [Interval(low, low + abs(width)), *([Interval(y, y)] if name == "mod" else [])]
        bounds = kind.of(name, *ends)
        values = evaluate_many(parse(text), {"x": np.linspace(*ends[0][:2], 33), "y": y})
        assert bounds.low <= values.min()
        assert values.max() <= bounds.high
        assert bounds.flaw > 0 or name == "mod" or values.min() == values.max()


def stairs(rate: str, start: str = "0 1") -> xd.Model:
    """A state whose rate jumps."""
    return xd.Model(
        name="stairs",
        states={"w": {"unit": "1", "rate": rate}},
        initial={"t": "0 s", "w": start},
        parameters={"floor": "1 1", "mod": "0 1"},
    )


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("rate", "first", "end"),
    [
        ("floor(t/second)/second", 1.0, 21 + 2.1),
        ("ceil(t/second)/second", 1.0, 28 + 2.4),
        ("round(t/second)/second", 0.5, 21 + 5.6),
        ("mod(t, 1.5*second)/second**2", 1.5, 4.5 + 1.3**2 / 2),
    ],
)
def test_jumps_are_located(rate: str, first: float, end: float) -> None:
    """Assert the times of jumps, the area below stairs, and the bits of a run among others side by side."""
    model = stairs(rate)
    run = xd.simulate(model, method="rk4", step="0.35 s", until="7.3 s")
    jumps = np.arange(first, 7.3, 1.5 if "mod" in rate else 1.0)
    assert run.event_time.values == pytest.approx(jumps, abs=1e-11)
    assert float(run.w[-1]) == pytest.approx(end, abs=1e-10)
    starts = {"w": [0.0, 0.25, 0.5, 0.75, 1.0]}
    many = xd.sweep(model, starts, method="rk4", step="0.35 s", until="7.3 s", keep=["end"]).compute()
    assert float(many.end_w[0]) == float(run.w[-1])


@pytest.mark.parametrize(
    ("start", "way", "end"), [(1, 1, 2.0), (1, -1, -0.5), (-1, 0, -1.5), (0, -1, -2.0), (2, 0, 3.0)]
)
def test_a_start_on_a_whole_number_takes_its_side(start: int, way: int, end: float) -> None:
    """Assert what follows from a start on a jump: up, down, or at rest."""
    states = {"u": {"unit": "1", "rate": f"{way}/second"}, "w": {"unit": "1", "rate": "floor(u)/second"}}
    model = xd.Model(name="step", states=states, initial={"t": "0 s", "u": f"{start} 1", "w": "0 1"})
    run = xd.simulate(model, method="rk4", step="0.25 s", until="1.5 s")
    assert float(run.w[-1]) == pytest.approx(end, abs=1e-12)


def test_names_stay_free() -> None:
    """Assert parameters of these names beside the functions, and a text that is read again."""
    model = stairs("floor*floor(3*w + mod)/second - mod(w, floor)/second", "0.2 1")
    assert xd.Model.from_text(model.to_toml()) == model
    assert float(xd.simulate(model, method="rk4", step="1 ms", until="1 ms").w[-1]) == pytest.approx(
        0.2 - 0.0002, rel=1e-3
    )


def test_units_derivatives_and_formulas() -> None:
    """Assert what units they take, how they are differentiated, and set."""
    names = {"x": parse_unit("m").dimension, "k": parse_unit("1").dimension}
    assert dimension_of(parse("mod(x, 2*x)"), names) == names["x"]
    with pytest.raises(xd.InputError, match="'floor' needs a pure number, got 'x' in 'm'"):
        dimension_of(parse("floor(x)"), names)
    with pytest.raises(xd.InputError, match="'mod' joins 'x' in 'm' with 'k'"):
        dimension_of(parse("mod(x, k)"), names)
    with pytest.raises(xd.InputError, match="'mod' takes 2 arguments, got 1"):
        parse("mod(x)")
    assert text_of(derivative(parse("mod(x, 3) + round(x)*x"), {"x": ONE})) == "1 + round(x)"
    assert text_of(derivative(parse("mod(3, x)"), {"x": ONE})) == "-floor(3/x)"
    assert latex(parse("floor(x) + mod(x, 2)")) == r"\left\lfloor{}x\right\rfloor + \mathrm{mod}\left(x, 2\right)"


MEANT = {
    "1 m - y": "1*metre - y",
    "sin(30 degree)": "sin(30*degree)",
    "sin(30 degrees)": "sin(30*degree)",
    "9.81 m s-2*b": "9.81*metre*second**-2*b",
    "1 m/s - v_x": "1*metre/second - v_x",
    "0.5 m2 + b": "0.5*metre**2 + b",
    "5 cm - x": "0.05*metre - x",
    "1e3kg": "1e3*kilogram",
    "12 year - t": "12*year - t",
    "2 k*x": "2*k*x",
    "2x": "2*x",
    "2(x + 1)": "2*(x + 1)",
    "(a)(b)": "(a)*(b)",
    "y^2": "y**2",
    "k·x": "k*x",
    "30°": "30*degree",
    "np.sin(x)": "sin(x)",
    "y' - 2 x": "v_y - 2*x",
}


@pytest.mark.parametrize("text", MEANT)
def test_the_message_names_a_text_that_is_read(text: str) -> None:
    """Assert that the first text it names is the one that was meant, and that the next try succeeds."""
    with pytest.raises(InputError, match="; write '") as refused:
        parse(text)
    named = re.findall(r"write '([^']+)'", str(refused.value))[0]
    assert (named, text_of(parse(named))) == (MEANT[text], text_of(parse(MEANT[text])))


def test_a_symbol_may_be_a_name() -> None:
    """Assert that of a unit's symbol that the model may have as a name both readings are named."""
    with pytest.raises(InputError, match=r"write '2\*metre\*g', or '2\*m\*g' if m is a name of the model"):
        parse("2 m*g")


@pytest.mark.parametrize("text", ["a b c", "3 -", "x''", "5 % x"])
def test_nothing_is_guessed(text: str) -> None:
    """Assert that no text is named where it is not known what was meant."""
    with pytest.raises(InputError) as refused:
        parse(text)
    assert "write '" not in str(refused.value)


def test_derivatives_have_names() -> None:
    """Assert that a mark after a velocity leads to how rates are named."""
    with pytest.raises(InputError, match="no sign stands for a derivative: the velocity of x is v_x"):
        parse("v_x'")
