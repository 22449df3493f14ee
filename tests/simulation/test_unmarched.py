"""Runs that are described before they are marched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import marches, no_march
from cases.verdicts import verified

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
FIXED: dict[str, Any] = {"method": "rk4", "step": "20 ms", "until": "1 s"}
OUTCOME = {"run_outcome", "run_outcome_text"}


@pytest.mark.parametrize("until", ["1 s", "1.01 s", "1e-3 s"])
def test_a_run_on_a_grid_is_described_and_has_the_bits_of_the_marched_one(until: str) -> None:
    """Assert names, units, sizes and settings while every march fails, then one march, and the same bits."""
    asked = FIXED | {"until": until}
    with no_march():
        run = xd.simulate(OSCILLATOR, compute=False, **asked)
    eager = xd.simulate(OSCILLATOR, **asked)
    along = {name for name, variable in eager.variables.items() if {*variable.dims} <= {"step", "document"}}
    assert {*run.variables} == along | OUTCOME
    assert {
        name: value for name, value in run.attrs.items() if name.startswith("solver_")
    }.items() <= eager.attrs.items()
    with marches() as begun:
        computed = run.compute()
    assert len(begun) == 1
    for name in sorted(map(str, along)):
        assert repr(run[name].attrs) == repr(eager[name].attrs)
        assert computed[name].values.tobytes() == eager[name].values.tobytes(), name
    assert str(computed.run_outcome.values) == eager.attrs["run_outcome"]


@pytest.mark.dear
def test_verbs_take_it_as_the_run_that_it_will_be(tmp_path: Path) -> None:
    """Assert that its archive has the digest of the marched run's, and that several verbs march it once."""
    run, eager = xd.simulate(OSCILLATOR, compute=False, **FIXED), xd.simulate(OSCILLATOR, **FIXED)
    xd.save(eager, tmp_path / "eager.nc")
    with marches() as begun:
        xd.save(run, tmp_path / "run.nc")
        xd.plot(run)
        assert xd.content_digest(run) == xd.content_digest(eager)
        assert float(xd.sample(run, 0.5).x[0]) == float(xd.sample(eager, 0.5).x[0])
    assert len(begun) == 1
    assert verified(tmp_path / "run.nc") == verified(tmp_path / "eager.nc")


def test_sizes_are_stated_where_only_marching_tells_them() -> None:
    """Assert nan and -1 behind the end, a refusal of what is longer, and the whole record for verbs all the same."""
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-6, "until": "1 s"}
    eager = xd.simulate(OSCILLATOR, **asked)
    n = eager.sizes["step"]
    run = xd.simulate(OSCILLATOR, compute=False, sizes={"step": n + 3, "event": 2}, **asked)
    assert run.x.values[:n].tobytes() == eager.x.values.tobytes()
    assert np.isnan(run.x.values[n:]).all()
    assert run.row_kind.values[n:].tolist() == [-1] * 3
    assert np.isnan(run.event_time.values).tolist() == [True, True]
    short = xd.simulate(OSCILLATOR, compute=False, sizes={"step": 2}, **asked)
    with pytest.raises(xd.InputError, match=rf"has {n} values along step, and 2 were stated: sizes=\{{'step': {n}\}}"):
        short.x.compute()
    assert xd.content_digest(short) == xd.content_digest(eager)


def test_states_at_wanted_times_are_lazy_too(tmp_path: Path) -> None:
    """Assert states at times, their coordinate known before, with and without a file that the run is streamed to."""
    times = [0.25, 0.5]
    eager = xd.simulate(OSCILLATOR, times=times, **FIXED)
    for path in (None, tmp_path / "run.nc"):
        with no_march():
            states = xd.simulate(OSCILLATOR, times=times, path=path, compute=False, **FIXED)
            assert states.at_time.values.tolist() == times
        assert states.x.values.tobytes() == eager.x.values.tobytes()
    assert (tmp_path / "run.nc").exists()


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"step": None, "rtol": 1e-6}, r"known only once it is computed.*sizes=\{'step': 5000\}"),
        ({"keep_every": 10}, "known only once it is computed"),
        ({"nodes": [0.5]}, "known only once it is computed"),
        ({"sizes": {"steps": 3}}, "sizes name 'steps'; there are step, event, trial, sample"),
        ({"sizes": {"step": 0}}, "sizes have 0 for 'step', need a positive whole number"),
        ({"sizes": {"step": True}}, "sizes have True for 'step'"),
        ({"sizes": 3}, "sizes are 3, need numbers by dimension"),
        ({"sizes": {"step": 3}, "times": [0.5]}, "times say already how many"),
        ({"sizes": {"step": 3}, "compute": True}, "and are for compute=False"),
        ({"resume": True, "path": "run.nc"}, "progress and resume are for compute=True"),
        ({"times": [1.5]}, "times have 1.5 s, and the run goes"),
        ({"step": -1.0}, "step"),
    ],
)
def test_what_cannot_be_described_is_refused_at_once(asked: dict[str, Any], message: str) -> None:
    """Assert one line each while every march fails."""
    with no_march(), pytest.raises(xd.InputError, match=message):
        xd.simulate(OSCILLATOR, **FIXED | {"compute": False} | asked)


def test_a_part_of_an_unmarched_run_is_no_record(tmp_path: Path) -> None:
    """Assert that a selection, a change and what xarray computed are refused by verbs, and nothing else is lost."""
    run = xd.simulate(OSCILLATOR, compute=False, **FIXED)
    for other in (run.isel(step=slice(3)), run.assign(x=2 * run.x), run.compute(), run.assign_attrs(title="mine")):
        with pytest.raises(xd.InputError, match="a part of a run that is still to be computed"):
            xd.save(other, tmp_path / "run.nc")
    assert not list(tmp_path.iterdir())
    assert float(run.isel(step=slice(3)).x[0]) == 1.0
