"""Budgets and certificates described before they are marched: a task for each level, term and block of draws."""

from __future__ import annotations

from typing import Any

import dask
import pytest

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches, no_march
from xdynamics.documenting.summary import summary

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ROCKET = xd.Model.from_toml(MODELS / "rocket_c6.toml")
RK4: dict[str, Any] = {"method": "rk4", "step": "10 ms"}
BUDGETS: dict[str, tuple[xd.Model, str, dict[str, Any]]] = {
    "time": (BALL, "y", {"at": "1 s", **RK4}),
    "event": (BALL, "t", {"event": "apex", "draws": 600}),
    "extreme": (BALL, "maximum_y", {"draws": 100, "terms": xd.Declared("wind", "maximum_y", "1 mm")}),
    "table": (ROCKET, "y", {"event": "apogee", **RK4}),
}


@pytest.mark.every(5)
@pytest.mark.parametrize("case", BUDGETS)
def test_a_lazy_budget_has_the_bits_of_the_eager_one(case: str) -> None:
    """Assert the description while every march fails, one graph, and the bits of the eager budget."""
    model, quantity, asked = BUDGETS[case]
    with no_march():
        stage = xd.error_budget(model, quantity, compute=False, **asked)
    eager = xd.error_budget(model, quantity, **asked)
    assert_described(stage, eager)
    with marches() as begun:
        assert float(stage.value) == float(eager.value)
        marched = len(begun)
        assert_same_bits(stage, eager)
    assert len(begun) == marched
    assert eager.attrs["result"] == str(eager.result.values)
    assert summary(stage.compute())[2:] == summary(eager)[2:]  # the lines before count runs


def test_a_level_is_shared_with_a_refinement_and_draws_are_blocks() -> None:
    """Assert that levels of a budget and of a study are marched once, and that more draws are more tasks."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    study = xd.refine(oscillator, method="rk4", steps=["10 ms", "5 ms"], at=["1 s"], compute=False)
    budget = xd.error_budget(oscillator, "x", at="1 s", compute=False, **RK4)
    with marches() as begun:
        dask.compute(study, budget)
    with marches() as alone:
        budget.value.compute()
    assert len(begun) == len(alone)
    sizes = [
        len(xd.error_budget(BALL, "y", at="1 s", draws=512 * n, compute=False, **RK4).value.__dask_graph__())
        for n in (1, 2, 3)
    ]
    assert sizes[1] - sizes[0] == sizes[2] - sizes[1] < 8


@pytest.mark.parametrize("compute", [True, False])
def test_what_stages_need_is_marched_once(compute: bool) -> None:
    """Assert one march of each step for a run, a study and a budget, one after the other or in one graph."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    asked: dict[str, Any] = {"method": "rk4", "until": "1 s"}
    with marches() as begun:
        run = xd.simulate(oscillator, step=0.02, force_samples="none", compute=False, **asked)
        study = xd.refine(oscillator, steps=[0.02, 0.01], at=["1 s"], compute=compute, **asked)
        budget = xd.error_budget(oscillator, "x", at="1 s", step=0.02, only="truncation", compute=compute, **asked)
        dask.compute(run, study, budget)
    assert sorted(begun) == [f"Harmonic oscillator rk4 {step}" for step in (0.0025, 0.005, 0.01, 0.02)]


def test_draws_that_end_by_themselves_are_refused() -> None:
    """Assert the remedy where the number of draws is known only after drawing."""
    with pytest.raises(xd.InputError, match="give draws=10000, or compute=True"):
        xd.error_budget(BALL, "y", at="1 s", until_uncertainty="1 m", compute=False)


@pytest.mark.dear
def test_a_lazy_certificate_has_the_bits_of_the_eager_one() -> None:
    """Assert a whole certificate: budget, gates and ledger."""
    asked = {"event": "apex", "draws": 200, **RK4}
    with no_march():
        stage = xd.certify(BALL, "t", compute=False, **asked)
    eager = xd.certify(BALL, "t", **asked)
    assert_described(stage, eager)
    assert_same_bits(stage, eager)
    assert xd.recheck(eager).attrs["result"] == eager.attrs["result"]
