"""`floor`, `ceil`, `round` and `mod` at ticks of controllers: what is whole to rounding counts as whole."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.expressions import parse
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.kinks import with_whole_numbers

WAVES = (
    "where(mod(t, T) < T/2, 1, 0)",
    "where(mod(t, T) >= T/2, 0, 1)",
    "where(t/T - floor(t/T) < 0.5, 1, 0)",
    "where(sign(mod(t, T) - T/2) < 0, 1, 0)",
)


@pytest.mark.every(3)
@pytest.mark.parametrize("wave", WAVES)
@pytest.mark.parametrize("every", ["2 us", "5 us", "10 us"])
def test_pulses_by_ticks_last_half_of_each_period(every: str, wave: str) -> None:
    """Assert a duty of one half over 500 periods, whose multiples of a tick are no floats."""
    model = xd.Model(
        name="converter",
        parameters={"tau": "1 ms", "T": "20 us"},
        states={"u": {"unit": "1", "rate": "(p - u)/tau"}},
        initial={"u": "0 1"},
        controllers={"pwm": {"every": every, "outputs": {"p": {"unit": "1", "start": "0 1", "value": wave}}}},
    )
    run = xd.simulate(model, method="dormand_prince", rtol=1e-9, until="10 ms")
    duty = np.sum(np.diff(run["time"]) * run["p"].to_numpy()[:-1]) / 10e-3
    assert duty == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("mod(60e-6, 20e-6)", 0.0),
        ("floor(60e-6/20e-6)", 3.0),
        ("ceil(0.1*3/0.1)", 3.0),
        ("round(0.1*25)", 2.0),
        ("round((1.1 + 1.4)*1)", 2.0),
        ("mod(-60e-6, 20e-6)", 0.0),
        ("mod(70e-6, 20e-6)", 10e-6),
        ("floor(2.9999)", 2.0),
        ("where(mod(30e-6, 20e-6) < 10e-6, 1, 0)", 0.0),
        ("where(mod(30e-6, 20e-6) == 10e-6, 1, 0)", 1.0),
        ("where(mod(30e-6, 20e-6) <= 10e-6, 1, 0)", 1.0),
        ("where(mod(30e-6, 20e-6) > 10e-6, 1, 0)", 0.0),
        ("where(mod(30e-6, 20e-6) != 10e-6, 1, 0)", 0.0),
    ],
)
def test_numbers_that_are_nearly_whole_are_whole(text: str, value: float) -> None:
    """Assert values beside whole numbers, and halves that go to the even one."""
    assert evaluate(with_whole_numbers(parse(text)), {}) == pytest.approx(value, rel=1e-12, abs=1e-18)


@pytest.mark.parametrize("text", ["x < 1", "a*x**2 - b", "where(x < 1, sign(x), max(x, 2))"])
def test_expressions_that_count_nothing_stay(text: str) -> None:
    """Assert the same tree where no whole numbers are asked for."""
    tree = parse(text) if "<" not in text or "where" in text else parse(f"where({text}, 1, 0)")
    assert with_whole_numbers(tree) == tree


def test_periodic_resets_count_alike() -> None:
    """Assert that a reset every 20 us sets what a whole multiple of it gives."""
    model = xd.Model(
        name="counter",
        parameters={"T": "20 us"},
        states={"n": {"unit": "1", "rate": "0/second"}},
        initial={"n": "0 1"},
        events={"tick": {"every": "20 us", "action": "reset", "set": {"n": "floor(t/T)"}}},
    )
    run = xd.simulate(model, method="rk4", step="10 us", until="2 ms")
    after = run["n"].to_numpy()[run["event_row_after"].to_numpy()]
    assert after.tolist() == np.round(run["event_time"].to_numpy() / 20e-6).tolist()
