"""Budgets of models with contacts of many links: after an impact, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.faults import InputError

BALLS = xd.Model.from_text("""
name = "bouncing balls"
[dimensions]
ball = 26
[coordinates.y]
unit = "m"
dims = ["ball"]
[parameters]
g = { value = 9.81, unit = "m s-2", uncertainty = 0.01 }
[mass]
y = "1*kilogram"
[forces.weight]
y = "-g*kilogram"
[contacts.floor]
gap = "y"
restitution = 0.8
[initial]
y = "(1 + 0.01*index(ball))*metre"
[run]
method = "dop853"
rtol = 1e-9
until = "0.8 s"
""")


def height(g: float, t: float = 0.7) -> float:
    """Height after the first of its impacts, of a ball let go at 1 m."""
    met = np.sqrt(2.0 / g)
    return float(0.8 * g * met * (t - met) - g * (t - met) ** 2 / 2.0)


@pytest.mark.dear
def test_budget_after_an_impact() -> None:
    """Assert value and share of a parameter's uncertainty against the closed form."""
    budget = xd.error_budget(BALLS, "y[0]", at="0.7 s")
    assert float(budget.value) == pytest.approx(height(9.81), abs=1e-9)
    slope = (height(9.82) - height(9.80)) / 0.02
    assert float(budget.physical_rss) == pytest.approx(abs(slope) * 0.01, rel=1e-5)


@pytest.mark.parametrize("verb", [xd.error_budget, xd.certify])
def test_an_impact_of_many_links_is_no_event_of_a_budget(verb: object) -> None:
    """Assert one sentence with the remedy."""
    with pytest.raises(InputError, match=r"'floor', a contact of many links.*at='1 s'"):
        verb(BALLS, "y[0]", event="floor")  # type: ignore[operator]


def test_contacts_of_many_links_have_no_31_digits() -> None:
    """Assert that a run with sums of two floats is refused, as with contacts that are written out, and so is no twin."""
    with pytest.raises(InputError, match="contacts and frictions, whose impacts and forces are solved in float64"):
        xd.simulate(BALLS, precision="double_double")
