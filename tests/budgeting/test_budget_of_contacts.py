"""Budgets of models with contacts of many links: after an impact, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.budgeting.budget_summary import budget_lines
from xdynamics.budgeting.numerical import MetEvents
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


BEADS = xd.Model(
    name="beads of unequal masses that strike each other",
    dimensions={"ball": 8},
    relations={"pair": {"of": "ball"}},
    coordinates={"x": {"unit": "m", "dims": ["ball"]}},
    parameters={"m": {"dims": ["ball"], "value": [1.0, 4.0, 2.0, 5.0, 3.0, 1.0, 4.0, 2.0], "unit": "kg"}},
    mass={"x": "m"},
    forces={"springs": {"potential": "50*newton/metre*x**2"}},
    initial={"x": "(0.15*index(ball) - 0.6)*metre", "v_x": "0.1*index(ball)*metre/second"},
    contacts={"balls": {"gap": "second(x, pair) - first(x, pair) - 0.1*metre", "restitution": 1}},
    run={"method": "velocity_verlet", "step": "20 ms"},
)


def test_runs_that_met_other_events_leave_a_number_of_unknown_uncertainty() -> None:
    """Assert infinite terms and totals, no shares, words and a picture that name the events, against numbers of runs."""
    budget = xd.error_budget(BEADS, "x[0]", at=3.0, until=3.0)
    counts = [xd.simulate(BEADS, step=step, until=3.0).sizes["event"] for step in (0.005, 0.0025)]
    assert counts[0] != counts[1]
    assert budget.term_name.values[np.isinf(budget.standard_uncertainty.values)].tolist() == ["truncation"]
    assert np.isnan(budget.share).all()
    assert [float(budget[name]) for name in ("numerical_bound", "numerical_rss", "total_rss")] == [np.inf] * 3
    assert budget.result.item() == f"{budget.value.item():.6g} m, of unknown uncertainty"
    lines = list(budget_lines(budget))
    assert any(line.split()[:3] == ["truncation", "numerical", "unknown"] for line in lines)
    (why,) = (line for line in lines if "did not meet the same events" in line)
    assert f"step_size 0.005 and 0.0025 did not meet the same events (balls {counts[0]} and {counts[1]} times)" in why
    assert any(line.startswith("totals    numerical unknown, at most unknown; physical 0 m;") for line in lines)
    (axes,) = xd.plot(budget).axes
    assert "unknown" in [label.get_text() for label in axes.texts]


def test_runs_that_met_the_same_events_keep_their_uncertainty() -> None:
    """Assert a bound, and that it holds beside a run with a step a hundred times as small."""
    budget = xd.error_budget(BEADS, "x[0]", at=0.3, until=0.3)
    fine = xd.simulate(BEADS, step=0.0002, until=0.3)
    assert 0.0 < abs(float(budget.value - fine.x[-1, 0])) < float(budget.numerical_bound) < 1e-3


def test_an_extreme_after_other_events_is_of_unknown_uncertainty() -> None:
    """Assert it of a largest velocity, which comes after other numbers of impacts in finer runs."""
    assert np.isinf(xd.error_budget(BEADS, "maximum_v_x[1]", until=4.0).total_rss)


@pytest.mark.parametrize(
    ("before", "compared", "expected"),
    [((3, 4), (9, 9), False), ((3, 3), (9, 8), False), ((3, 4), (9, 8), True)],
)
def test_equal_extremes_at_other_times_are_not_apart(
    before: tuple[int, int], compared: tuple[int, int], expected: bool
) -> None:
    """Assert that both the events before the number and those of the runs have to differ in number."""
    one, other = (MetEvents({"floor": count}, whole) for count, whole in zip(before, compared, strict=True))
    assert one.are_apart(other) is expected
