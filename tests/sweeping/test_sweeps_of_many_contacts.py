"""Sweeps of bodies with many contacts: members go on where the log that they share is full of impacts or closed links."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.documenting.summary import summary
from xdynamics.march import simd_ensemble

RESTITUTIONS = [0.0, 0.5]
COUNT = 30  # more contacts than are written out one by one


def falling(restitution: float) -> xd.Model:
    """Return balls that fall on a floor from different heights."""
    return xd.Model(
        name="hail",
        dimensions={"ball": COUNT},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "e": str(restitution)},
        mass={"y": "m"},
        forces={"weight": {"y": "-9.80665*m*metre/second**2"}},
        contacts={"floor": {"gap": "y", "restitution": "e"}},
        initial={"y": {"unit": "m", "value": np.linspace(0.01, 0.05, COUNT).tolist()}},
    )


@pytest.mark.parametrize("keep", [["end"], ["end", "maximum_kinetic_energy"]])
def test_members_go_on_where_their_log_is_full(monkeypatch: pytest.MonkeyPatch, keep: list[str]) -> None:
    """Assert the bits of single runs, in logs with room for a part of the impacts and of the rows of closed links."""
    rows = simd_ensemble.FEWEST_ROWS
    monkeypatch.setattr(simd_ensemble, "LOG_ROWS", rows)
    asked = {"method": "velocity_verlet", "step": "2 ms", "until": "0.4 s"}
    found = xd.sweep(falling(0.5), {"e": RESTITUTIONS}, keep=keep, **asked).load()
    assert found.attrs["comment"].startswith("members are marched one after the other")
    assert any(line.startswith("remark    members are marched one after the other") for line in summary(found))
    for k, restitution in enumerate(RESTITUTIONS):
        run = xd.simulate(falling(restitution), **asked)
        assert run.sizes["step"] > 2 * rows
        assert run.sizes["closed"] > 2 * COUNT * rows
        for name in ("y", "v_y"):
            assert np.array_equal(found[f"end_{name}"].values[k], run[name].values[-1])
    assert run.sizes["event"] > rows + 3 * COUNT


def test_states_at_times_are_those_of_single_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the bits of `sample` of each run of a heap that rubs, whose steps go on with the closed links of their rows."""
    monkeypatch.setattr(simd_ensemble, "LOG_ROWS", simd_ensemble.FEWEST_ROWS)  # of a member there are several logs
    pile, frictions = xd.Model.from_toml(MODELS / "rough_pile.toml"), ["0.4", "0.35"]
    times, until = np.linspace(0.005, 0.245, 49), "0.25 s"
    found = xd.sweep(pile, {"mu": frictions}, keep=["theta", "v_theta"], times=times, until=until).load()
    for k, friction in enumerate(frictions):
        run = xd.simulate(pile.replace(parameters={"mu": friction}), until=until)
        assert run.sizes["step"] > 2 * simd_ensemble.FEWEST_ROWS
        expected = xd.sample(run, times)
        for name in ("theta", "v_theta"):
            assert np.array_equal(found[name].values[k], expected[name].values)


def test_members_are_checked_and_marched_again(tmp_path: Path) -> None:
    """Assert that members of bodies with contacts of single links pass the check, and are runs with the bits of the ends."""
    box = xd.Model.from_toml(MODELS / "balls_in_box.toml")
    axis = {"m[a]": ["0.9 kg", "1 kg"]}
    for keep, path in ((["end"], None), (["end"], tmp_path / "ends"), (["end", "log"], tmp_path / "logs")):
        found = xd.sweep(box, axis, keep=keep, until="0.5 s", check=1.0, path=path).load()
        run = xd.member(found, **{"m[a]": "0.9 kg"})
        assert run.r.dims == ("step", "disc", "axis")
        assert np.array_equal(found.end_r.values[0], run.r.values[-1])
        assert str(found.run_digest.values[0]) != str(found.run_digest.values[1])
