"""The same answer in any units and scales; what the tolerances did not control is said."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import EPS
from xdynamics.cli import main

ADAPTIVE = ("dormand_prince", "dop853", "radau_iia")


def spring(unit: str = "m", rate: float = 1.0, **initial: str) -> xd.Model:
    """A mass on a spring, at rest a length unit from where it rests."""
    return xd.Model(
        name="spring",
        coordinates={"x": {"unit": unit}},
        parameters={"m": "1 kg", "k": f"{rate**2!r} N m-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": f"1 {unit}", "v_x": f"0 {unit} s-1"} | initial,
    )


def charge() -> xd.Model:
    """A capacitor of 5 pC that discharges."""
    return xd.Model(
        name="capacitor",
        parameters={"tau": "1 s"},
        states={"q": {"unit": "C", "rate": "-q/tau"}},
        initial={"q": "5 pC"},
    )


def marched(model: xd.Model, **asked: Any) -> xr.Dataset:
    return xd.simulate(model, **{"method": "dop853", "until": "20 s", "force_samples": "none"} | asked)


def test_what_tolerances_do_not_control_is_said() -> None:
    """Assert that an oscillation of 1 nm within a given 1e-6 m is called what it is, with both numbers; none at rest, none by defaults."""
    model = spring("m", x="1 nm")
    said = r"did not control x \(largest value .*e-0[789] m, atol 1e-06 m\), v_x \(.* m s-1, atol 1e-06 m s-1\)"
    with pytest.warns(xd.AccuracyWarning, match=said):
        run = marched(model, atol=1e-6)
    assert run.attrs["run_outcome"] == "completed"
    assert "; the tolerances did not control x (" in run.attrs["run_outcome_text"]
    with pytest.warns(xd.AccuracyWarning, match=r"control q \(largest value .* C, atol 1e-06 C\)"):
        marched(charge(), atol=1e-6)
    for controlled in (marched(spring("m", x="0 m"), atol=1e-6), marched(model), marched(charge())):
        assert controlled.attrs["run_outcome_text"] == "reached t = 20 s"


def test_the_command_says_it_once(tmp_path: Path) -> None:
    """Assert one line with the outcome, by `run` and by `show`, and none on the error stream."""
    (tmp_path / "small.toml").write_text(spring("m", x="1 nm").to_toml())
    archive = str(tmp_path / "small.nc")
    done = CliRunner().invoke(
        main,
        ["run", str(tmp_path / "small.toml"), "-o", archive, "--method", "dop853", "--until", "9 s", "--atol", "1e-6"],
    )
    shown = CliRunner().invoke(main, ["show", archive])
    assert done.output.count("did not control") == shown.output.count("did not control") == 1
    assert done.stderr == ""


def test_loose_tolerances_are_meant_so() -> None:
    """Assert that a value a hundred times its absolute tolerance is no surprise where the relative one is as loose."""
    assert marched(spring(), rtol=1e-2, atol=1e-2).attrs["run_outcome_text"] == "reached t = 20 s"


@pytest.mark.parametrize(("unit", "factor"), [("nm", 1e-9), ("mm", 1e-3), ("km", 1e3)])
def test_bare_tolerances_are_in_declared_units(unit: str, factor: float) -> None:
    """Assert that a run of one unit of length is the same in every unit but for rounding, by default and by a bare number."""
    metres = marched(spring("m"))
    given = marched(spring("m"), rtol=1e-6, atol=1e-6)
    for asked in ({}, {"rtol": 1e-6, "atol": 1e-6}, {"rtol": 1e-6, "atol": {"x": "1e-6", "v_x": f"1e-6 {unit} s-1"}}):
        run, same = marched(spring(unit), **asked), given if asked else metres
        # by default it is the relative one times the size, which is the largest value of all rows
        sizes = [1.0, 1.0] if asked else [float(np.abs(run[name]).max()) for name in ("x", "v_x")]
        used = [run[name].attrs["atol"] for name in ("x", "v_x")]
        assert used == pytest.approx([1e-6 * size for size in sizes], rel=4 * EPS)
        assert run.x.attrs["atol_si"] == pytest.approx(1e-6 * factor, rel=EPS)
        assert run.sizes["step"] == same.sizes["step"]
        assert float(run.x[-1]) == pytest.approx(float(same.x[-1]), abs=1e-11)


def test_bare_tolerances_are_in_the_scales_of_a_march(tmp_path: Path) -> None:
    """Assert that a bare number counts in scaled units, and that its archive is reproduced."""
    scales = {"length": "4 m", "time": "0.5 s"}
    run = xd.simulate(spring(), method="dop853", until="20 s", scales=scales, path=tmp_path / "run.nc", atol=1e-9)
    assert run.x.attrs["atol_si"] == 4e-9
    assert run.v_x.attrs["atol_si"] == pytest.approx(8e-9, rel=EPS)
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


def test_archives_in_other_units_are_reproduced(tmp_path: Path) -> None:
    """Assert that tolerances are taken from an archive to the bit, whatever the unit of the variable."""
    xd.simulate(spring("nm"), method="dormand_prince", until="20 s", rtol=3e-7, path=tmp_path / "run.nc")
    assert xd.reproduce(tmp_path / "run.nc").attrs["identical"] == 1


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("x", [1.0, 0.0])
def test_steps_do_not_depend_on_the_time_scale(method: str, x: float) -> None:
    """Assert the same steps, to the bit, of motions a millionfold slower and faster by powers of two."""
    found = []
    for rate in (2.0**-20, 1.0, 2.0**20):
        model = spring("m", rate, x=f"{x} m", v_x=f"{(1 - x) * rate!r} m s-1")
        atol = {"x": 2.0**-20, "v_x": 2.0**-20 * rate}
        run = marched(model, method=method, rtol=1e-6, atol=atol, until=8.0 / rate)
        found.append(run.step_size.values * rate)
    assert found[0].tolist() == found[1].tolist() == found[2].tolist()


@pytest.mark.parametrize("scales", [{"time": "1 us"}, {"time": "1000 s"}, {"length": "1 nm", "mass": "1e6 kg"}])
def test_steps_do_not_depend_on_scales(scales: dict[str, str]) -> None:
    """Assert the same steps but for rounding with scales, where the tolerances have units."""
    asked = {"rtol": 1e-8, "atol": {"x": "1e-8 m", "v_x": "1e-8 m s-1"}}
    plain, scaled = marched(spring(), **asked), marched(spring(), scales=scales, **asked)
    # the estimate of the first step is rounding alone, and the next step follows from it
    assert scaled.step_size.values == pytest.approx(plain.step_size.values, rel=1e-3)
    assert float(scaled.x[-1]) == pytest.approx(float(plain.x[-1]), abs=1e-12)


def test_first_steps_do_not_depend_on_the_end() -> None:
    """Assert it for motions that begin with a slope."""
    first, second = (marched(spring(), rtol=1e-8, until=until) for until in (10.0, 1000.0))
    assert first.attrs["solver_first_step"] == second.attrs["solver_first_step"]
    assert np.array_equal(first.x.values[:20], second.x.values[:20])


def test_a_start_at_rest_finds_its_time_scale() -> None:
    """Assert a first step near those that follow, though the velocity's tolerance is far too small for it."""
    run = marched(spring("m", 1e6), rtol=1e-8, until=2e-5)
    assert run.step_size.values[1] > 1e-3 * run.step_size.values.max()


def swing(rate: float, length: float) -> xd.Model:
    """A pendulum of any length and time scale, by the arc it goes."""
    return xd.Model(
        name="swing",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "k": f"{rate**2!r} N m-1", "L": f"{length!r} m"},
        mass={"x": "m"},
        forces={"gravity": {"x": "-k*L*sin(x/L)"}},
        initial={"x": f"{length!r} m", "v_x": "0 m s-1"},
    )


@pytest.mark.every(5)
@pytest.mark.parametrize("method", xd.METHODS)
def test_every_method_is_blind_to_units(method: str) -> None:
    """Assert the same bits of a motion of nanometres in microseconds, and of gigametres in megaseconds, by powers of two."""
    found = set()
    for rate, length in ((1.0, 1.0), (2.0**20, 2.0**-30), (2.0**-20, 2.0**30)):
        asked = {"method": method, "until": 3.0 / rate, "force_samples": "none"}
        tolerances = {"rtol": 1e-4, "atol": {"x": 1e-4 * length, "v_x": 1e-4 * length * rate}}
        fixed = xd.simulate(swing(rate, length), step=2.0**-6 / rate, **asked)
        chosen = xd.simulate(swing(rate, length), **tolerances, **asked)
        found.add(((fixed.x.values / length).tobytes(), (chosen.x.values / length).tobytes()))
    assert len(found) == 1
