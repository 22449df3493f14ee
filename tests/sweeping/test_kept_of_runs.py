"""What is kept of members under the names of a run, of its events and of its diagnosis."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.record.flag_words import words_of_flag

AXES = {"v_y": "10:20:2 m s-1", "method": ["heun", "dop853"]}


def alone(sweep: xr.Dataset, at: dict[str, int]) -> xr.Dataset:
    """March the member of a sweep by itself."""
    mine = sweep.isel(at)
    return xd.member(sweep, v_y=float(mine.v_y), method=str(mine.solver_method.values))


def test_a_number_of_a_diagnosis_is_that_of_the_member_alone() -> None:
    """Assert bits, units and flags of what only whole runs tell, and that a lazy sweep has them too."""
    words = ["energy_drift", "continuity_verdict", "believed_until", "turning_time", "run_fastest_rate"]
    lazy = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, keep=words, rtol=1e-6, until="4 s")
    assert lazy.energy_drift.chunks is not None
    found = lazy.compute()
    for at in ({"v_y": 0, "solver_method": 0}, {"v_y": 1, "solver_method": 1}):
        run = alone(found, at)
        diagnosis, mine = xd.diagnose(run), found.isel(at)
        for name in ("energy_drift", "continuity_verdict", "believed_until"):
            assert float(mine[name]) == float(diagnosis[name]), name
            assert mine[name].attrs["units"] == diagnosis[name].attrs["units"]
        assert float(mine.turning_time) == float(diagnosis.turning_time[0])
        assert float(mine.run_fastest_rate) == run.attrs["run_fastest_rate"]
        assert words_of_flag(mine.continuity_verdict.expand_dims("one")) == ["passed"]


def test_cycles_are_occurrences() -> None:
    """Assert the periods of two oscillators along `occurrence`, nan behind their last ones."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.sweep(
        model, {"k": "4, 16 N m-1"}, keep="period", occurrences=(1, 6), method="dop853", rtol=1e-9, until="10 s"
    )
    assert found.period.dims == ("k", "occurrence")
    periods = found.period.values
    assert np.count_nonzero(~np.isnan(periods), axis=1).tolist() == [1, 4]
    assert np.nanmax(abs(periods - np.array([[np.pi], [np.pi / 2]]))) < 1e-7


def test_what_a_record_has_of_an_event_is_kept() -> None:
    """Assert residual, uncertainty and direction of events against the members' records."""
    names = ["event_residual_ground", "event_time_uncertainty_ground", "event_direction_ground"]
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    found = xd.sweep(model, AXES, keep=names, rtol=1e-6, until="4 s").compute()
    run = alone(found, {"v_y": 1, "solver_method": 0})
    ground = words_of_flag(run.event_detector).index("ground")
    for name in names:
        recorded = run[name.removesuffix("_ground")][ground]
        assert float(found[name][1, 0]) == float(recorded)
        assert found[name].attrs["units"] == recorded.attrs["units"]


def test_a_member_that_fails_has_no_number_of_a_diagnosis() -> None:
    """Assert nan, not zero, of a run that ends in nothing finite, beside one that ends well."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.sweep(model, {"k": [1.0, -1e6]}, keep=["energy_drift"], method="rk4", step=0.5, until="200 s").compute()
    outcomes = found.run_outcome.values.tolist()
    assert outcomes[0] == "completed"
    assert outcomes[1] != "completed"
    assert np.isnan(found.energy_drift.values).tolist() == [False, True]


def test_a_catalogue_keeps_them_and_marches_no_member_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same numbers from a folder, and that the finished sweep is read and not marched."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    asked: dict[str, Any] = {"keep": ["energy_drift"], "rtol": 1e-6, "until": "4 s"}
    here = xd.sweep(model, AXES, **asked).compute()
    there = xd.sweep(model, AXES, path=tmp_path / "s", **asked)
    assert there.energy_drift.values.tolist() == here.energy_drift.values.tolist()
    monkeypatch.setattr("xdynamics.sweeping.members.run_values", None)
    again = xd.sweep(model, AXES, path=tmp_path / "s", **asked)
    assert again.energy_drift.values.tolist() == here.energy_drift.values.tolist()


@pytest.mark.parametrize(
    ("word", "near"),
    [
        ("energy_drit", "energy_drift"),
        ("event_time_grund", "event_time_ground"),
        ("run_force_evaluation", "run_force_evaluations"),
        ("hieght", ""),
    ],
)
def test_an_unknown_word_has_its_three_nearest_names(word: str, near: str) -> None:
    """Assert the word, and three names, the one that was meant among them."""
    with pytest.raises(xd.InputError, match=f"keep has '{word}'") as caught:
        xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, keep=[word], until="1 s")
    nearest = str(caught.value).partition("the nearest are ")[2].split(", ")
    assert len(nearest) == 3
    assert near in nearest or not near


def test_what_every_sweep_has_may_be_asked_for() -> None:
    """Assert that the names of counts and outcomes are taken."""
    words = ["run_force_evaluations", "run_outcome", "end_time"]
    found = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, keep=words, rtol=1e-6, until="1 s")
    assert {*words} <= {*found.data_vars}
    assert "end_y" not in found
