"""Members compared along an axis, with what differences are uncertain by; sweeps put together; work against precision."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.record.flag_words import words_of_flag
from xdynamics.sweeping.ensemble_analysis import _pareto_mask

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
LEVELS = ["40 ms", "20 ms", "10 ms"]
ENDS = {"keep": ["end_x", "end_v_x"], "until": "2 s"}


@pytest.fixture(scope="module")
def methods() -> xr.Dataset:
    """Two methods of order two, and one of order four, at three steps, of a motion whose end is cos 4."""
    return xd.sweep(OSCILLATOR, {"method": ["velocity_verlet", "heun", "rk4"], "step": LEVELS}, **ENDS).compute()


def test_methods_that_converge_to_one_solution_do_not_differ(methods: xr.Dataset) -> None:
    """Assert that all differences are within their uncertainty, which covers the true errors, from the levels themselves."""
    found = xd.contrast(methods, "method", reference="rk4")
    for name, exact in (("end_x", np.cos(4.0)), ("end_v_x", -2.0 * np.sin(4.0))):
        assert {*words_of_flag(found[f"verdict_{name}"])} == {"within"}
        errors = abs(methods[name] - exact)
        both = errors + errors.sel(solver_method="rk4")
        assert (both <= found[f"uncertainty_{name}"]).all()
        assert found[f"uncertainty_{name}"].attrs["units"] == methods[name].attrs["units"]


def test_a_real_difference_is_told_from_numerical_error() -> None:
    """Assert that a spring stiffer by a hundredth differs at every step, and one stiffer by 1e-9 at none."""
    axes = {"k": [4.0, 4.0 + 4e-9, 4.04], "step": LEVELS}
    grid = xd.sweep(OSCILLATOR, axes, method="rk4", **ENDS)
    verdicts = words_of_flag(xd.contrast(grid, "k", reference="4 N m-1").compute().verdict_end_x)
    assert verdicts == ["within"] * 6 + ["differs"] * 3


def test_without_levels_nothing_is_claimed() -> None:
    """Assert `unknown` where no axis tells an uncertainty, and what was kept where something was."""
    grid = xd.sweep(BALL, {"vt": [20.0, 40.0]}, keep=["end_v_y", "maximum_y"], rtol=1e-6, until="3 s").compute()
    found = xd.contrast(grid, "vt")
    assert words_of_flag(found.verdict_end_v_y) == ["unknown", "within"]
    assert words_of_flag(found.verdict_maximum_y)[0] == "differs"
    assert found.difference_maximum_y.attrs["long_name"] == "largest y of the run, minus that of vt = 40.0 m s-1"
    kept = grid.maximum_y_uncertainty
    assert found.uncertainty_maximum_y.values.tolist() == (kept + kept[1]).values.tolist()


def test_what_convergence_found_is_contrasted(methods: xr.Dataset) -> None:
    """Assert differences of the finest levels, with the sum of both uncertainties, lazily too."""
    judged = xd.convergence(methods, "step")
    assert judged.end_x.values.tolist() == methods.end_x.sel(solver_step=10.0).values.tolist()
    found = xd.contrast(judged, "method", reference="rk4")
    np.testing.assert_array_equal(found.difference_end_x, judged.end_x - judged.end_x[2])
    np.testing.assert_array_equal(found.uncertainty_end_x, judged.uncertainty_end_x + judged.uncertainty_end_x[2])
    assert {*words_of_flag(found.verdict_end_x)} == {"within"}
    lazy = xd.contrast(xd.convergence(methods.chunk(), "step"), "method", reference="rk4")
    assert lazy.difference_end_x.chunks is not None
    assert lazy.difference_end_x.values.tolist() == found.difference_end_x.values.tolist()


@pytest.mark.parametrize("name", ["solver_rtol", "tolerance"])
def test_sweeps_put_together_are_a_sweep(name: str) -> None:
    """Assert that sweeps of three tolerances, along a dimension of any name, are judged as one that varied them."""
    axes, tolerances = {"v_y": "10:20:2 m s-1"}, [1e-4, 1e-6, 1e-8]
    asked: dict[str, Any] = {"keep": ["end_y"], "method": "dormand_prince", "until": "1 s"}
    whole = xd.sweep(BALL, {"rtol": tolerances} | axes, **asked).compute()
    parts = [xd.sweep(BALL, axes, rtol=rtol, **asked).compute() for rtol in tolerances]
    put = xr.concat(parts, name)
    assert xd.member(put, v_y=20.0, **{name: 1e-6 if name == "solver_rtol" else 1}).attrs["solver_rtol"] == 1e-6
    if name == "solver_rtol":
        judged, expected = xd.convergence(put, "rtol"), xd.convergence(whole, "rtol")
        for key in ("end_y", "uncertainty_end_y", "verdict_end_y", "order_end_y"):
            np.testing.assert_array_equal(judged[key], expected[key])
        assert xd.compare(put, whole).attrs["cause"] == ""
        assert {*words_of_flag(xd.contrast(put, "rtol").verdict_end_y)} <= {"within", "differs"}
    xd.member(put.isel(v_y=1), **{name: 1e-6 if name == "solver_rtol" else 1})
    again = xd.sweep(put, keep=["y"], times=[0.5])
    assert again.y.shape == (3, 2, 1)


def test_settings_that_all_members_share_are_coordinates() -> None:
    """Assert words and numbers with what they are, none of an absolute tolerance for each variable, and none for an axis."""
    asked: dict[str, Any] = {"rtol": 1e-6, "atol": {"y": "1 um"}, "max_step": "0.1 s", "until": "1 s"}
    found = xd.sweep(BALL, {"v_y": [10.0], "method": ["heun"]}, **asked)
    assert float(found.solver_rtol) == 1e-6
    assert float(found.solver_max_step) == 0.1
    assert found.solver_max_step.attrs["units"] == "s"
    assert found.solver_method.dims == ("solver_method",)
    assert "solver_atol" not in found.variables


@pytest.mark.parametrize("engine", ["netcdf4", "h5netcdf"])
def test_a_catalogue_that_plain_xarray_opened_gives_its_members(tmp_path: Path, engine: Any) -> None:
    """Assert the member, its table and a survey of a catalogue whose texts plain xarray leaves as numbers."""
    axes = {"v_y": "10:20:3 m s-1", "method": ["heun", "dop853"]}
    asked: dict[str, Any] = {"keep": ["end_v_y"], "rtol": 1e-6, "until": "1 s"}
    own = xd.sweep(BALL, axes, path=tmp_path / "s", **asked).compute()
    with xr.open_dataset(tmp_path / "s" / "catalogue.nc", engine=engine) as plain:
        assert plain.run_digest.dtype.kind == "u"
        run = xd.member(plain, v_y=15.0, method="heun")
        assert float(run.v_y[-1]) == float(own.end_v_y.sel(v_y=15.0, solver_method="heun"))
        xd.member(plain.isel(v_y=1), method="heun")
        assert plain.dynamics.table().run_outcome.tolist() == ["completed"] * 6
        found = xd.contrast(plain, "method")
        assert found.outcome_differs.values.sum() == 0
        assert xd.compare(plain, own).attrs["identical"] == 1


def test_the_pareto_front_is_of_the_runs_that_none_betters(methods: xr.Dataset) -> None:
    """Assert the front against a search over all pairs, from one call, lazily too."""
    axes = {"method": ["velocity_verlet", "heun", "rk4"], "step": LEVELS}
    found = xd.precision(OSCILLATOR, axes, exact={"end_x": np.cos(4.0)}, **ENDS)
    assert found.front_end_x.chunks is not None
    off, work = found.off_end_x.values.ravel(), found.run_force_evaluations.values.ravel()
    assert off.tolist() == abs(methods.end_x.values - np.cos(4.0)).ravel().tolist()
    better = (off <= off[:, None]) & (work <= work[:, None]) & ((off < off[:, None]) | (work < work[:, None]))
    assert found.front_end_x.values.ravel().tolist() == (~better.any(axis=1)).astype(int).tolist()
    assert 0 < found.front_end_x.values.sum() < 9


def test_a_run_that_costs_more_and_is_no_nearer_is_on_no_front() -> None:
    """Assert rows by hand: a little worse, as good for more work, as cheap and worse, not finite."""
    errors = np.array([[1.0, 0.5, 0.7, 0.1, 0.1, 2.0, np.nan], [4.0, 3.0, 2.0, 1.0, 0.0, 5.0, 6.0]])
    works = np.array([[1, 2, 3, 4, 5, 1, 0], [1, 2, 3, 4, 5, 6, 0]])
    front = _pareto_mask(errors, works, is_exact=False, dim_count=1)
    assert front[0].tolist() == [1, 1, 0, 1, 0, 0, 0]
    assert front[1].tolist() == [1, 1, 1, 1, 0, 0, 1]
    assert _pareto_mask(errors, works, is_exact=True, dim_count=1)[1].tolist() == [1, 1, 1, 1, 1, 0, 1]


def test_what_is_taken_for_exact_betters_none(methods: xr.Dataset) -> None:
    """Assert that without exact values the finest run of the highest order, off by nothing, is on no front."""
    found = xd.precision(methods)
    assert float(found.off_end_x.sel(solver_method="rk4", solver_step=10.0)) == 0.0
    assert int(found.front_end_x.sel(solver_method="rk4", solver_step=10.0)) == 0
    assert found.front_end_x.values.any()


WRONG: dict[str, tuple[Any, str]] = {
    "a model without axes": (lambda: xd.precision(OSCILLATOR, "step"), "of a model give all axes"),
    "axes of a sweep": (lambda: xd.precision(xd.sweep(BALL, {"vt": [20.0]}), {"step": LEVELS}), "are for a model"),
    "settings of a sweep": (lambda: xd.precision(xd.sweep(BALL, {"vt": [20.0]}), until="1 s"), "until are for a model"),
    "no steps": (lambda: xd.precision(BALL, {"vt": [20.0]}, until="1 s"), "has no axis 'step'; there are vt"),
    "no such axis": (lambda: xd.contrast(xd.sweep(BALL, {"vt": [20.0]}), "speed"), "has no axis 'speed'"),
    "no such value": (
        lambda: xd.contrast(xd.sweep(BALL, {"vt": [20.0]}), "vt", reference="1 m"),
        "vt has 1.0 m, needs the unit",
    ),
    "a run": (lambda: xd.contrast(xd.simulate(BALL, until="1 s"), "vt"), "Dataset is no sweep"),
    "a number": (lambda: xd.contrast(3, "vt"), "int is no sweep"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_input_is_named(case: str) -> None:
    """Assert one clear error for each."""
    call, words = WRONG[case]
    with pytest.raises(xd.InputError) as caught:
        call()
    assert words in str(caught.value)


def test_values_are_added_to_an_axis_while_the_result_is_open(tmp_path: Path) -> None:
    """Assert that what was opened before goes on with its own numbers, read after, and that files are closed with it."""
    asked: dict[str, Any] = {"rtol": 1e-6, "until": "1 s", "path": tmp_path / "s"}
    small = xd.sweep(BALL, {"v_y": [10.0, 15.0]}, **asked)
    other = xd.open_sweep(tmp_path / "s")
    whole = xd.sweep(BALL, {"v_y": [10.0, 15.0, 20.0]}, **asked)
    assert small.end_y.values.tolist() == other.end_y.values.tolist() == whole.end_y.values.tolist()[:2]
    longest = xd.sweep(BALL, {"v_y": [10.0, 15.0, 20.0, 25.0]}, **asked)
    assert whole.end_v_y.values.tolist() == longest.end_v_y.values.tolist()[:3]
    assert small.end_v_y.values.tolist() == longest.end_v_y.values.tolist()[:2]
    assert str(xd.verify(tmp_path / "s").verdict.values) == "verified"
    for opened in (small, other, whole, longest):
        opened.close()
    xd.sweep(BALL, {"v_y": [10.0, 15.0, 20.0, 25.0, 30.0]}, **asked)
