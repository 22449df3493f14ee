"""Extremes of many elements: their rates are evaluated as arrays, and not at more states than memory holds."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.evidence.diagnosing import extremes, states_inside

CLUSTER = """
name = "cluster"
[dimensions]
body = 4
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[states.heat]
unit = "J"
rate = "1*watt*sin(2*radian*t/second) - 0.3*heat/second"
dims = ["body"]
[parameters]
k = "2 N m-1"
[mass]
r = "1*kilogram"
[forces.springs]
over = "pair"
potential = "k*norm(second(r, pair) - first(r, pair), axis)**4/(1*metre)**2"
[initial]
r = { unit = "m", value = [[0.0, 0.1], [1.0, 0.0], [0.9, 1.1], [-0.2, 0.8]] }
heat = { unit = "J", value = [0.1, 0.2, 0.3, 0.4] }
[run]
method = "rk4"
step = "0.02 s"
until = "4 s"
"""


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """March four bodies that attract each other, with heats of their own."""
    return xd.simulate(xd.Model.from_text(CLUSTER))


def found(run: xr.Dataset) -> xr.Dataset:
    """Return the extremes of what steps integrate."""
    diagnosis = xd.diagnose(run, companion=False)
    words = [f"{word}_{name}" for name in ("r", "v_r", "heat") for word in ("maximum", "minimum")]
    return diagnosis[[f"{word}{end}" for word in words for end in ("", "_time", "_rule", "_uncertainty")]]


def test_rates_of_wholes_have_the_bits_of_elements(run: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that extremes of a large model are those that expressions of single elements give, bit for bit."""
    expected, rates, asked = found(run), states_inside.state_rates, []

    def seen(*arguments: object) -> object:
        asked.append(1)
        return rates(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(states_inside, "state_rates", seen)
    for module in (extremes, states_inside):
        monkeypatch.setattr(module, "MOST_NAMES", 0)
    large = found(run)
    assert len(asked) > 1
    assert (expected.maximum_v_r_rule == extremes.INTERPOLATED).any()
    assert (expected.maximum_heat_rule == extremes.INTERPOLATED).any()
    xr.testing.assert_identical(large.drop_attrs(deep=False), expected.drop_attrs(deep=False))


def test_too_many_states_are_not_evaluated(run: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that extremes are then accepted states, off by no more than they are said to be."""
    between = found(run)
    monkeypatch.setattr(extremes, "MOST_NUMBERS", 1)
    accepted = found(run)
    for name in ("r", "v_r", "heat"):
        assert (accepted[f"maximum_{name}_rule"] == extremes.SAMPLED).all()
        np.testing.assert_array_equal(accepted[f"maximum_{name}"], run[name].max("step"))
        off = between[f"maximum_{name}"] - accepted[f"maximum_{name}"]
        assert (off >= 0.0).all()
        assert (off > 0.0).any()
        assert (off <= 1.001 * accepted[f"maximum_{name}_uncertainty"]).all()
