"""A run has the elementary functions of one set, records its name, and is marched again with that set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import ROOT
from xdynamics.elementary import NAME, SETS
from xdynamics.faults import InputError, ResumeWarning

FIRST = "xdynamics 1"
GOLDEN = ROOT / "data" / "golden" / "0.2" / "tan_and_atan2_dop853.nc"
SPRING = xd.open_run(GOLDEN)["model_toml"].values.item()
MODEL = xd.Model.from_text(SPRING + '[observables]\nangle = "atan2(y, x)"\nslope = "tan(y/(1*metre))"\n').replace(
    parameters={"l": "0.35 m", "k": "1000 N m-1"}
)
ASKED = {"method": "rk4", "step": "10 ms", "until": "5 s"}


@pytest.fixture(scope="module")
def runs() -> dict[str, xr.Dataset]:
    """The same march with each set."""
    return {name: xd.simulate(MODEL, **ASKED, math_functions=name) for name in SETS}


def test_what_was_used_is_recorded(runs: dict[str, xr.Dataset]) -> None:
    """Assert that the record names the set, and that another set gives other bits but the same motion to rounding."""
    assert [run.attrs["math_functions"] for run in runs.values()] == list(SETS)
    first, second = runs.values()
    assert first.x.values.tobytes() != second.x.values.tobytes()
    np.testing.assert_allclose(first.x, second.x, rtol=0, atol=1e-12)


def test_the_newest_is_the_default(runs: dict[str, xr.Dataset]) -> None:
    """Assert that a run for which nothing is asked has the newest set."""
    run = xd.simulate(MODEL, **ASKED)
    assert run.attrs["math_functions"] == NAME
    assert run.x.values.tobytes() == runs[NAME].x.values.tobytes()


@pytest.mark.parametrize("name", SETS)
def test_an_archive_is_reproduced_with_its_set(name: str, runs: dict[str, xr.Dataset], tmp_path: Path) -> None:
    """Assert that an archive is marched again with the set that it names, to the bit, and that nothing is said of sets."""
    table = xd.reproduce(xd.save(runs[name], tmp_path / "run.nc"))
    assert table.attrs["identical"] == 1
    assert "elementary functions" not in table.attrs["arithmetic"]


@pytest.mark.parametrize("name", SETS)
def test_states_and_observables_between_have_the_set_of_the_run(name: str, runs: dict[str, xr.Dataset]) -> None:
    """Assert that what is sampled at accepted states, observables too, has the bits that the run recorded there."""
    from xdynamics.evidence.observables import observe

    run = runs[name]
    found = observe(run, MODEL, ["x", "angle", "slope"], run.time.values)
    assert {key: value[0].tobytes() == run[key].values.tobytes() for key, value in found.items()} == dict.fromkeys(
        found, True
    )


@pytest.mark.every(2)
@pytest.mark.parametrize("name", SETS)
def test_lanes_have_the_bits_of_a_run_alone(name: str) -> None:
    """Assert that a sweep with a set, marched in lanes, gives each member what it has alone, and names the set."""
    starts = np.linspace(0.5, 1.5, 40)
    found = xd.sweep(MODEL, {"x": starts}, keep=["end", "angle"], times=[1.0], **ASKED, math_functions=name)
    assert found.attrs["math_functions"] == name
    for k in (0, 17, 39):
        alone = xd.simulate(MODEL.replace(initial={"x": f"{float(starts[k])!r} m"}), **ASKED, math_functions=name)
        assert float(found.end_x[k]) == float(alone.x[-1])
        assert float(found.angle[k, 0]) == float(alone.angle[100])
    assert xd.member(found, x=float(starts[3])).attrs["math_functions"] == name


def test_a_longer_run_keeps_its_set(runs: dict[str, xr.Dataset]) -> None:
    """Assert that a run is extended with its own set."""
    longer = xd.extend(runs[FIRST], until="6 s")
    assert longer.attrs["math_functions"] == FIRST
    assert longer.x.values[:501].tobytes() == runs[FIRST].x.values.tobytes()


def test_a_resumed_run_is_of_the_set_that_is_asked_for(tmp_path: Path) -> None:
    """Assert that a finished archive with one set is not taken for a run with another."""
    path = tmp_path / "run.nc"
    xd.simulate(MODEL, **ASKED, math_functions=FIRST, path=path).close()
    with pytest.warns(ResumeWarning, match="computed from its start"):
        again = xd.simulate(MODEL, **ASKED, path=path, resume=True)
    assert again.attrs["math_functions"] == NAME


@pytest.mark.parametrize("name", ["xdynamics 3", "libm", "1"])
def test_a_set_that_is_not_there_is_refused(name: str) -> None:
    """Assert that the message has the value and what there is."""
    with pytest.raises(InputError, match=f"math_functions is '{name}'; there are 'xdynamics 1', 'xdynamics 2'"):
        xd.simulate(MODEL, **ASKED, math_functions=name)
