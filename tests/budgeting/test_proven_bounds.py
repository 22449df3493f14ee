"""Numbers of budgets and certificates beside bounds that are proven."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.smooth_models import oscillator
from cases.stages import assert_described, assert_same_bits
from xdynamics.budgeting.budget_summary import budget_lines
from xdynamics.budgeting.certificate import _decide_gates

ASKED: dict[str, Any] = {"method": "rk4", "step": "0.1 s", "without": ["roundoff", "k"], "proven": True}


def stopped() -> xd.Model:
    """Return a mass on a spring of uncertain stiffness, whose run ends at its second turn."""
    events = '[events.turn]\nfunction = "v_x"\naction = "stop"\ncount = 2\n'
    model = oscillator(k={"value": "4 N m-1", "half_width": "0.01 N m-1"})
    return xd.Model.from_text(f"{model.to_toml()}\n{events}")


@pytest.mark.parametrize(
    ("quantity", "where", "exact"),
    [
        ("x", {"at": "1 s", "until": "1 s"}, np.cos(2.0)),
        ("total_energy", {"at": "1 s", "until": "1 s"}, 2.0),
        ("t", {"event": "turn", "until": "9 s"}, np.pi / 2.0),
        ("x", {"event": "turn", "occurrence": 2, "until": "9 s"}, 1.0),
    ],
)
def test_the_number_lies_within_what_is_proven(quantity: str, where: dict[str, Any], exact: float) -> None:
    """Assert that the interval of the values as written holds the closed form, is narrow, and that the error is told from it."""
    budget = xd.error_budget(stopped(), quantity, **where, **ASKED)
    low, high = budget.proven_interval.values
    assert low - 2e-16 <= exact <= high + 2e-16
    assert high - low < 1e-12
    off, value = float(budget.proven_error), float(budget.value)
    assert off == np.nextafter(max(value - low, high - value), 1.0)
    assert abs(value - exact) <= off <= float(budget.numerical_bound)
    assert budget.proven_error.attrs["units"] == budget.value.attrs["units"]
    assert sum(line.startswith("proven    ") for line in budget_lines(budget)) == 1


def test_where_nothing_is_proven() -> None:
    """Assert that a number beyond a corner has no interval, and says why."""
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    budget = xd.error_budget(ball, "t", event="ground", **ASKED | {"only": ["truncation"], "without": None})
    assert np.isnan(budget.proven_interval.values).all()
    assert "no bounds are proven after t = 1.7" in str(budget.proven_text.item())
    assert [line for line in budget_lines(budget) if line.startswith("proven    nothing: no bounds")]


@pytest.mark.parametrize(
    ("model", "quantity", "where", "words"),
    [
        ("harmonic_oscillator", "maximum_x", {}, "no bounds are proven of the maximum of x; give a time or an event"),
        (
            "bouncing_ball",
            "t",
            {"event": "floor"},
            "no bounds are proven of what happens at 'floor', which is no event",
        ),
        ("bouncing_ball", "y", {"at": "0.1 s"}, "cannot be enclosed: contact 'floor' ends the smooth motion"),
    ],
)
def test_numbers_without_bounds_are_refused(model: str, quantity: str, where: dict[str, Any], words: str) -> None:
    """Assert that it is said before anything is marched."""
    with pytest.raises(xd.InputError, match=words):
        xd.error_budget(xd.Model.from_toml(MODELS / f"{model}.toml"), quantity, **where, proven=True, compute=False)


def test_a_lazy_budget_has_the_same_bounds() -> None:
    """Assert description and bits, with the proof as a task."""
    asked = ASKED | {"at": "1 s", "until": "1 s", "only": ["truncation"], "without": None}
    stage = xd.error_budget(stopped(), "x", **asked, compute=False)
    assert any(str(name).startswith("proven-") for name in dict(stage.__dask_graph__()))
    eager = xd.error_budget(stopped(), "x", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [
        ((2.875, 3.125), "passed"),
        ((3.0, 3.25), "not_checked"),
        ((2.8125, 2.875), "passed"),
        ((3.125, 3.5), "not_checked"),
        ((3.375, 3.5), "failed"),
        ((2.0, 2.6), "failed"),
        ((np.nan, np.nan), "not_checked"),
    ],
)
def test_the_gate_of_proven_bounds(interval: tuple[float, float], verdict: str) -> None:
    """Assert by hand-made figures: a value 3 with a numerical bound 0.25."""
    budget = xr.Dataset(
        {
            "term_name": ("term", np.array(["truncation", "interpolation"])),
            "bound": ("term", np.array([0.125, 0.125])),
            "level_value": ("level", np.array([3.0, 3.25, 4.0])),
            "level_verdict": ((), 0, {"flag_meanings": "asymptotic converging not_converging"}),
            "proven_interval": ("bound", np.array(interval)),
        }
    )
    numbers = {
        "linear_verdict": 0,
        "run_outcome": "completed",
        "physical_rss": 0.0,
        "numerical_bound": 0.25,
        "value": 3.0,
    }
    budget = budget.assign({name: ((), number) for name, number in numbers.items()} | {"proven_text": ((), "why")})
    ledger = xr.Dataset({"verdict": ("case", np.array([0]))})
    found = {name: became for name, became, _ in _decide_gates(budget, ledger, has_draws=False)}
    assert found["proven"] == verdict


@pytest.mark.dear
def test_a_certificate_with_proven_bounds(tmp_path: Path) -> None:
    """Assert that it carries them, passes their gate, and is made again from its file to the bit."""
    model = oscillator()
    certificate = xd.certify(model, "x", at="1 s", method="rk4", step="0.1 s", until="1 s", proven=True)
    assert certificate.attrs["proven"] == 1
    gates = dict(zip(certificate.gate_name.values.tolist(), certificate.gate_verdict.values.tolist(), strict=True))
    assert gates["proven"] == 0
    xd.save(certificate, tmp_path / "c.nc")
    assert xd.recheck(tmp_path / "c.nc").attrs["proven"] == 1
