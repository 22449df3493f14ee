"""Members added to a folder: the same as a sweep that was made at once; what does not fit is refused in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.faults import InputError
from xdynamics.sweeping import catalogue, grid, members

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ASKED: dict[str, Any] = {"rtol": 1e-6, "until": "5 s"}
KEEPS = (["end"], ["end", "maximum_y", "event_time_ground"], ["y", "event_count_ground"], ["end", "log"])


@pytest.fixture
def marched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many members were marched, call by call."""
    counts: list[int] = []
    march_many = grid.march_many

    def counted(*given: Any, **more: Any) -> Any:
        runs = march_many(*given, **more)
        counts.append(len(runs.ends))
        return runs

    monkeypatch.setattr(grid, "march_many", counted)
    return counts


def larger(rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Axes of a sweep and of one that it is a part of, and the method where that is no axis."""
    speeds = np.sort(rng.uniform(10.0, 40.0, int(rng.integers(3, 7)))).tolist()
    some = sorted(rng.choice(len(speeds), int(rng.integers(1, len(speeds))), replace=False).tolist())
    before: dict[str, Any] = {"v_y": [speeds[i] for i in some]}
    after: dict[str, Any] = {"v_y": speeds}
    kind = int(rng.integers(4))
    if kind == 0:
        before["method"], after["method"] = ["heun"], ["dop853", "heun"]
    elif kind == 1:  # an axis more, of what was a setting
        after["method"] = ["heun", "bogacki_shampine"]
        return before, after, {"method": "heun"}
    elif kind == 2:  # an axis more, of what was the model's own
        after = {"vt": ["25 m s-1", "30 m s-1"], **after}
    if kind == 0 and rng.random() < 0.5:
        after = dict(reversed(after.items()))
    return before, after, {} if kind == 0 else {"method": "heun"}


def test_a_sweep_of_a_version_that_told_less_is_computed_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that members without a variable that this version has are not taken over, and the sweep is as if made at once."""
    rocket = xd.Model.from_toml(MODELS / "staged_rocket.toml")
    with monkeypatch.context() as patch:
        now = members.Plan._run_variables.fget  # type: ignore[attr-defined]
        told = property(lambda plan: [variable for variable in now(plan) if variable.name != "run_events_strayed"])
        patch.setattr(members.Plan, "_run_variables", told)
        before = xd.sweep(rocket, {"g": "9:10:2 m s-2"}, keep=["end"], path=tmp_path / "s").compute()
    assert "run_events_strayed" not in before
    found = xd.sweep(rocket, {"g": "9:10:3 m s-2"}, keep=["end"], path=tmp_path / "s").compute()
    assert found.run_events_strayed.values.tolist() == [0, 0, 0]
    assert found.attrs["content_digest"] == xd.content_digest(
        xd.sweep(rocket, {"g": "9:10:3 m s-2"}, keep=["end"]).compute()
    )


@pytest.mark.dear
@pytest.mark.cases(60)
def test_added_members_are_as_if_made_at_once(case: int, tmp_path: Path, marched: list[int]) -> None:
    """Assert bits, digests of content and members, and that what was there was not marched again."""
    rng = np.random.default_rng([case, 7])
    before, after, method = larger(rng)
    keep = KEEPS[case % 4]
    more: dict[str, Any] = {
        "keep": keep,
        "times": [0.1, 0.7] if "y" in keep else None,
        "members_per_task": int(rng.integers(1, 9)),
    }
    xd.sweep(BALL, before, path=tmp_path / "a", **more, **ASKED, **method).close()
    then = sum(marched)
    marched.clear()
    second = {} if "method" in after else method
    added = xd.sweep(BALL, after, path=tmp_path / "a", **more, **ASKED, **second)
    size = int(np.prod([*added.sizes.values()][: len(after)]))
    assert sum(marched) == size - then
    once = xd.sweep(BALL, after, path=tmp_path / "b", **more, **ASKED, **second)
    assert added.attrs["content_digest"] == once.attrs["content_digest"]
    assert added.attrs["sweep_digest"] == once.attrs["sweep_digest"]
    seals = ["run_seal"] if "log" in keep else []  # of bytes that have a date
    xr.testing.assert_identical(added.drop_attrs().drop_vars(seals).load(), once.drop_attrs().drop_vars(seals).load())
    marched.clear()
    xd.sweep(BALL, after, path=tmp_path / "a", **more, **ASKED, **second)
    assert not marched
    xd.verify(tmp_path / "a")


@pytest.mark.dear
def test_a_finer_axis_takes_what_is_there(tmp_path: Path, marched: list[int]) -> None:
    """Assert that values that differ by rounding alone are marched anew, and none is missed."""
    xd.sweep(BALL, {"v_y": "10:20:11 m s-1"}, path=tmp_path / "a", method="heun", **ASKED).close()
    marched.clear()
    found = xd.sweep(BALL, {"v_y": "10:20:31 m s-1"}, path=tmp_path / "a", members_per_task=4, method="heun", **ASKED)
    assert dict(found.sizes) == {"v_y": 31}
    assert 20 <= sum(marched) < 31
    xr.testing.assert_equal(
        found.drop_attrs().load(), xd.sweep(BALL, {"v_y": "10:20:31 m s-1"}, method="heun", **ASKED).drop_attrs().load()
    )


@pytest.mark.dear
@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"axes": {"v_y": [10.0, 20.0]}}, r"it has v_y = 15\.0, which this sweep has not"),
        ({"axes": {"vt": [10.0, 20.0]}}, "its axis 'v_y' is none of this sweep"),
        ({"rtol": 1e-7}, "setting 'rtol' is 1e-06 there, here 1e-07"),
        ({"method": "dop853"}, "setting 'method' is heun there, here dop853"),
        ({"keep": ["end", "maximum_y"]}, "keep is end there, here end, maximum_y"),
        ({"keep": ["end", "y"], "times": [0.5]}, r"times are none there, here 0\.5"),
        ({"model": BALL.replace(parameters={"vt": "31 m s-1"})}, "its model is another"),
    ],
)
def test_what_does_not_fit_is_refused(changed: dict[str, Any], words: str, tmp_path: Path) -> None:
    """Assert one clear error, and that the folder is as it was."""
    axes = {"v_y": [10.0, 15.0]}
    asked: dict[str, Any] = {"method": "heun", "keep": ["end"]} | ASKED
    found = xd.sweep(BALL, axes, path=tmp_path / "a", **asked)
    found.close()
    more = {key: value for key, value in changed.items() if key not in ("axes", "model")}
    with pytest.raises(InputError, match=words):
        xd.sweep(
            changed.get("model", BALL),
            changed.get("axes", {"v_y": [10.0, 15.0, 20.0]}),
            path=tmp_path / "a",
            **(asked | more),
        )
    assert xd.open_sweep(tmp_path / "a").attrs["content_digest"] == found.attrs["content_digest"]


@pytest.mark.dear
def test_an_addition_that_was_stopped_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that runs of members that were being added are no damage, that `verify` says so, and that the same call goes on."""
    folder, axes = tmp_path / "s", {"v_y": "10, 20, 30 m s-1"}
    asked = ASKED | {"method": "heun", "keep": ["log"], "path": folder}
    xd.sweep(BALL, {"v_y": "10 m s-1"}, **asked)

    def stopped(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(catalogue, "_join_blocks", stopped)
        with pytest.raises(KeyboardInterrupt):
            xd.sweep(BALL, axes, **asked)
    assert xd.open_sweep(folder).sizes["v_y"] == 1
    said = CliRunner().invoke(main, ["verify", str(folder)])
    assert said.exit_code == 0
    assert "its 1 archived run; members were being added to it: the same sweep, called again, goes on" in said.output
    assert xd.sweep(BALL, axes, **asked).sizes["v_y"] == 3
    (folder / "runs" / "added.nc").write_bytes(b"")
    with pytest.raises(xd.ArchiveError, match="added.nc is no run of the sweep"):
        xd.verify(folder)


@pytest.mark.every(3)
@pytest.mark.parametrize("dim", ["v_y", "vt", "method"])
def test_an_opened_and_a_lazy_sweep_are_put_together(dim: str, tmp_path: Path) -> None:
    """Assert that xr.concat along any axis gives the sweep that was made at once, whose members are found."""
    axes: dict[str, Any] = {
        "v_y": [10.0, 15.0, 20.0, 25.0],
        "vt": [20.0, 30.0, 40.0],
        "method": ["heun", "dop853", "rk4"],
    }
    asked: dict[str, Any] = {"keep": ["end", "maximum_y"], "step": "20 ms", "until": "3 s"}
    parts = [axes | {dim: axes[dim][:1]}, axes | {dim: axes[dim][1:]}]
    opened = xd.sweep(BALL, parts[0], path=tmp_path / "a", **asked)
    lazy = xd.sweep(BALL, parts[1], **asked)
    along = "solver_method" if dim == "method" else dim
    both = xr.concat(
        [opened, lazy],
        dim=along,
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="outer",
        combine_attrs="override",
    )
    whole = xd.sweep(BALL, axes, **asked)
    xr.testing.assert_equal(both.drop_attrs().load(), whole.drop_attrs().load())
    plain = xr.concat([opened, lazy], dim=along, data_vars="all", coords="different", compat="equals", join="outer")
    assert {name: variable.dims for name, variable in plain.data_vars.items() if name.startswith("end_")} == {
        name: variable.dims for name, variable in whole.data_vars.items() if name.startswith("end_")
    }
    run = xd.member(plain, v_y=15.0, vt=30.0, method="dop853")
    assert float(run.y[-1]) == float(whole.end_y.sel({"v_y": 15.0, "vt": 30.0, "solver_method": "dop853"}))
