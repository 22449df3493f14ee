"""Comparisons that are described before runs are marched: the same bits and words as of runs that were."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, ROOT
from cases.stages import CIRCUMSTANCES, assert_same_bits, marches, no_march
from cases.verdicts import verified
from xdynamics.documenting.summary import summary
from xdynamics.evidence.comparing.comparison import LATER
from xdynamics.evidence.stages import compute_datasets

BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
ASKED: dict[str, Any] = {"method": "euler_cromer", "until": "1 s"}
SIZES = {"step": 300, "event": 10}


def pair(*, compute: bool) -> list[xr.Dataset]:
    """Two runs of a bouncing ball by different steps, marched or not."""
    sizes = {} if compute else {"sizes": SIZES}
    return [xd.simulate(BALL, step=step, compute=compute, **sizes, **ASKED) for step in ("20 ms", "10 ms")]


def assert_told(stage: xr.Dataset, eager: xr.Dataset) -> None:
    """Assert what a stage that is computed variable by variable says of runs, and that it is summed up as the eager one."""
    for name in LATER:
        assert stage[name].values.item() == eager.attrs[name], name
    lines = [[line for line in summary(found) if not line.startswith("kind")] for found in (stage, eager)]
    assert lines[0] == lines[1]


@pytest.mark.parametrize("times", [None, [0.25, 0.5, 0.75]], ids=["rows", "times"])
def test_a_comparison_of_runs_to_be_marched_has_the_bits_of_the_eager_one(times: Any) -> None:
    """Assert names, units and words while every march fails, one march of each run, and all values and attributes."""
    eager = xd.compare(*pair(compute=True), times)
    sizes = {"sizes": {"at": eager.sizes["at"]}} if times is None else {}
    with no_march():
        stage = xd.compare(*pair(compute=False), times, compute=False, occurrences=eager.sizes["occurrence"], **sizes)
        assert [*stage.variables] == [*eager.variables, *LATER]
        assert dict(stage.sizes) == dict(eager.sizes)
        assert all(repr(stage[name].attrs) == repr(eager[name].attrs) for name in eager.variables)
        assert {*eager.attrs} - {*stage.attrs} == {"runs", *LATER}
        assert stage["name"].values.tolist() == eager["name"].values.tolist()
        assert (stage.at_time.chunks is None) == (times is not None)
    with marches() as begun:
        assert_same_bits(stage, eager)
        assert_told(stage.compute(), eager)
        (whole,) = compute_datasets(stage)
    assert len(begun) == 2
    assert {name for name in eager.attrs if repr(whole.attrs[name]) != repr(eager.attrs[name])} <= CIRCUMSTANCES
    assert xd.content_digest(whole) == xd.content_digest(eager)


@pytest.mark.dear
def test_what_is_not_there_has_no_value(tmp_path: Path) -> None:
    """Assert nan behind the last time and event and where an event is never met, and the archive of the eager one."""
    eager = xd.compare(*pair(compute=True))
    stage = xd.compare(*pair(compute=False), compute=False, sizes={"at": 400}, occurrences=9)
    assert int(stage.at_time.count()) == eager.sizes["at"]
    assert int(stage.difference_event_time_floor.count()) == eager.sizes["occurrence"]
    late = '[events.late]\nfunction = "t - 9*second"\naction = "record"\n'
    longer = [
        xd.simulate(xd.Model.from_text(OSCILLATOR.to_toml() + late), **asked)
        for asked in ({"step": h, "until": "1 s", "compute": False, "sizes": {"step": 200}} for h in ("20 ms", "10 ms"))
    ]
    never = xd.compare(*longer, [0.5], compute=False, occurrences=2).compute()
    assert np.isnan(never.difference_event_time_late.values).tolist() == [True, True]
    assert np.isnan(float(never.difference_scale_event_time_late))
    assert "occurrence" not in xd.compare(*longer, [0.5], compute=False, occurrences=0).dims
    xd.report(tmp_path, comparison=stage)
    assert verified(tmp_path / "comparison.nc") == xd.content_digest(eager)


def test_a_comparison_shares_its_runs_and_travels() -> None:
    """Assert that runs are marched once for two stages, in another process too, and that marched ones are not again."""
    first, second = pair(compute=False)
    shown: dict[str, Any] = {"sizes": {"at": 200}, "occurrences": 5}
    stages = [
        xd.compare(first, second, compute=False, **shown),
        xd.compare(second, first, compute=False, **shown),
    ]
    with marches() as begun:
        sent = pickle.loads(pickle.dumps(stages))
        found = compute_datasets(*sent)
    assert len(begun) == 2
    assert xd.content_digest(found[1]) == xd.content_digest(xd.compare(*pair(compute=True)[::-1]))
    runs = pair(compute=True)
    with marches() as begun:
        stage = xd.compare(*runs, compute=False)
        assert_same_bits(stage, eager := xd.compare(*runs))
        assert not begun
        half = xd.compare(runs[0], second, [0.5], compute=False, occurrences=3)
        assert float(half.difference_y[0]) == float(xd.compare(*runs, [0.5]).difference_y[0])
        assert len(begun) == 1
    assert stage.sizes["occurrence"] == eager.sizes["occurrence"]


def test_a_run_to_be_marched_beside_measured_data() -> None:
    """Assert the description and the bits beside a record of a bench, and that a time beyond the run fails when computed."""
    model, data = (
        xd.Model.from_toml(MODELS / "bench_pendulum.toml"),
        ROOT / "pipelines" / "pendulum_period" / "bench.csv",
    )
    sizes = {"step": 20_000}
    with no_march():
        stage = xd.compare(xd.simulate(model, compute=False, sizes=sizes), data, compute=False)
        assert stage.measured_theta.chunks is None
    eager = xd.compare(xd.simulate(model), data)
    assert [*stage.variables] == [*eager.variables]
    assert all(repr(stage[name].attrs) == repr(eager[name].attrs) for name in eager.variables)
    with marches() as begun:
        assert_same_bits(stage, eager)
        assert xd.content_digest(compute_datasets(stage)[0]) == xd.content_digest(eager)
    assert len(begun) == 1
    short = xd.compare(xd.simulate(model, until="1 s", compute=False, sizes=sizes), data, compute=False)
    with pytest.raises(xd.InputError, match="is outside the run, from"):
        short.difference_theta.compute()


@pytest.mark.dear
@pytest.mark.parametrize(
    "name", ["truss", "heat", "coupled_masses", "stick_slip_belt", "relay_oscillator", "woodpecker"]
)
def test_every_variable_of_a_record_is_foreseen(name: str) -> None:
    """Assert the table of variables of models with dimensions, contacts, frictions and events, in order."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    runs = [xd.simulate(model, until=until, compute=False, sizes={"step": 4}) for until in ("1 ms", "2 ms")]
    eager = xd.compare(*(xd.simulate(model, until=until) for until in ("1 ms", "2 ms")), times=["0.5 ms"])
    with no_march():
        count = eager.sizes.get("occurrence", 0)
        stage = xd.compare(*runs, times=["0.5 ms"], compute=False, occurrences=count)
    assert stage["name"].values.tolist() == eager["name"].values.tolist()
    assert [key for key in stage.variables if "_event_time_" not in key and key not in LATER] == [
        key for key in eager.variables if "_event_time_" not in key
    ]
    assert_same_bits(stage, eager)


@pytest.mark.parametrize(
    ("asked", "times", "message"),
    [
        ({"occurrences": 3}, None, r"known only once they are marched; give times=…, a number, sizes=\{'at': 5000\}"),
        (
            {"sizes": {"at": 5}},
            None,
            r"how often floor will be met is known only once the runs are marched; .* occurrences=10",
        ),
        ({"sizes": {"at": 5}}, [0.5], "sizes have 5 for 'at', and the times are known already; leave it out"),
        ({"sizes": {"at": 0}}, None, "sizes have 0 for 'at', need a positive whole number"),
        ({"occurrences": -1}, [0.5], "occurrences is -1, needs a non-negative whole number"),
        ({"sizes": {"step": 5}}, None, "sizes name 'step'; there is at"),
        ({"sizes": {"occurrence": 5}}, None, "how many events are compared is said by occurrences=10"),
        ({"sizes": 5}, None, "sizes are 5, need numbers by dimension"),
    ],
)
def test_sizes_that_only_marching_tells_have_to_be_stated(asked: Any, times: Any, message: str) -> None:
    """Assert one line each, before anything is marched."""
    runs = pair(compute=False)
    with no_march(), pytest.raises(xd.InputError, match=message):
        xd.compare(*runs, times, compute=False, **asked)


def test_sizes_are_for_what_is_lazy() -> None:
    """Assert that a comparison at once has none."""
    with pytest.raises(xd.InputError, match="for compute=False: what is compared at once has its own"):
        xd.compare(*pair(compute=True), sizes={"at": 5})


def test_diagnoses_of_dask_arrays_are_told_apart() -> None:
    """Assert that runs in chunks of which no digest is known are no one task, whose result would be remembered."""
    runs = [
        xd.simulate(OSCILLATOR.replace(initial={"x": x}), method="rk4", step="20 ms", until="1 s")
        for x in ("1 m", "2 m")
    ]
    found = [xd.diagnose(run.chunk(), occurrences=1, companion=False, compute=False) for run in runs]
    assert [float(diagnosis.maximum_x) for diagnosis in found] == [1.0, 2.0]
