"""Archives of versions 0.1 and 0.2, kept as they were made: they open, verify, show, plot, sample and reproduce."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import ROOT
from cases.verdicts import verified

GOLDEN = ROOT / "data" / "golden"
ARCHIVES = sorted((GOLDEN / "0.1").glob("*.nc"))
SECOND = sorted((GOLDEN / "0.2").glob("*.nc"))
# its method has other iterations and another choice of steps since
OTHER_STEPS = {"linear_drag_radau_iia": "38 rows became 33"}
# without elementary functions, fixed steps: the same bits whatever the set; but the rocket's liftoff, where its height has a
# kink, is looked for in a part of the step, and located elsewhere within its time tolerance
EXACT = {"ball_drag_midpoint", "cart_spring_verlet", "kepler_dprkn6_given"}
SAID = (
    "version 0.1.0 wrote the law in other words than 0.2.0; "
    "the archive was made with the elementary functions 'libm', here they are 'xdynamics 2'; "
)


def test_the_set_is_whole() -> None:
    """Assert that there is an archive for each model and kind of step but one."""
    assert (len(ARCHIVES), len(SECOND)) == (10, 20)


@pytest.mark.every(3)
@pytest.mark.parametrize("path", ARCHIVES, ids=lambda one: one.stem)
def test_numbers_are_reproduced(path: Path) -> None:
    """Assert that every number has the same bits, or that one sentence tells why not and the largest difference, a tiny one."""
    table = xd.reproduce(path)
    assert table.attrs["arithmetic"].startswith(SAID)
    said = table.attrs["arithmetic"].removeprefix(SAID)
    if table.attrs["identical"]:
        assert said == "every number has the same bits"
        return
    assert path.stem not in EXACT
    if path.stem in OTHER_STEPS:
        assert said.endswith(OTHER_STEPS[path.stem])
        assert "solver_controller: 'PI" in table.attrs["settings"]
        return
    allowed = max(1e-9, float(xd.open_run(path).attrs.get("solver_rtol", 0.0)))  # chosen steps end at other times
    assert float(re.search(r"the largest difference is .*: (\S+) of its largest value$", said)[1]) < allowed


@pytest.mark.every(2)
@pytest.mark.parametrize("path", SECOND, ids=lambda path: path.stem)
def test_version_0_2_is_reproduced_to_the_bit(path: Path) -> None:
    """Assert that every number of an archive of version 0.2 comes out again with the same bits."""
    assert xd.reproduce(path).attrs["identical"] == 1


@pytest.mark.every(13)
@pytest.mark.parametrize("path", ARCHIVES + SECOND[::4], ids=lambda path: path.stem)
def test_they_are_read_by_everything(path: Path, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Assert that an old archive is verified, shown and sampled, and every third drawn; with --whole, all."""
    from click.testing import CliRunner

    from xdynamics.cli import main

    assert len(verified(path)) == 64
    assert CliRunner().invoke(main, ["show", str(path)]).exit_code == 0
    if request.config.getoption("--whole") or (ARCHIVES + SECOND).index(path) % 3 == 0:
        assert CliRunner().invoke(main, ["plot", str(path), "-o", str(tmp_path / "run.png")]).exit_code == 0
    run = xd.open_run(path)
    inner = np.unique((run.time.values[1:] + run.time.values[:-1])[::7] / 2)
    found = xd.sample(run, inner)
    name = next(str(key) for key, variable in run.data_vars.items() if variable.attrs.get("role") == "coordinate")
    assert np.isfinite(found[name]).all()


def test_a_record_of_schema_1_is_shown_in_the_words_of_today(tmp_path: Path) -> None:
    """Assert coordinates and numbers of rows when it is opened, the same digest saved again, and that a selection keeps its rows."""
    path = GOLDEN / "0.2" / "bouncing_ball_verlet.nc"
    run = xd.open_run(path)
    assert "xdynamics-1" in run.attrs["Conventions"]
    assert run.model_toml.dims == ("document",)
    assert {"m", "time", "event_time", "model_toml", "step_number"} <= {*run.coords}
    assert run.step_number.values.tolist() == list(range(run.sizes["step"]))
    assert float(run.mean("step").y) == pytest.approx(float(run.y.mean()))
    xd.save(run, tmp_path / "again.nc")
    assert verified(tmp_path / "again.nc") == verified(path)
    last = int(run.event_row_before[-1])
    xd.save(run.isel(step=slice(last, None), event=[-1]), tmp_path / "part.nc")
    part = xd.open_run(tmp_path / "part.nc")
    assert "xdynamics-2" in part.attrs["Conventions"]
    assert part.step_number.values[0] == last
    assert part.dynamics.events().before_v_y.values.tolist() == [float(run.v_y[last])]
    assert xd.reproduce(tmp_path / "part.nc").attrs["identical"] == 1
