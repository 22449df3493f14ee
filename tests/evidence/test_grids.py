"""Two sweeps compared member by member: aligned by label, with the uncertainty of each difference and its cause by name."""

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
from xdynamics.evidence.comparing.grids import DIFFERS, UNKNOWN, WITHIN, sweep_comparison_lines

BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
KEPT: dict[str, Any] = {"until": 1.0, "keep": ["end"]}


def swept(model: xd.Model = BALL, axes: dict[str, Any] | None = None, **asked: Any) -> xr.Dataset:
    """Return a small sweep."""
    axes = axes or {"e": [0.8, 0.9]}
    step = {} if "step" in axes else {"step": 0.01}
    made = xd.sweep(model, axes, **(KEPT | {"method": "velocity_verlet"} | step | asked))
    return made.compute()


def test_members_are_found_by_what_their_axes_say() -> None:
    """Assert labels in another order and other units, and that values of one sweep alone are named with it."""
    first = swept(axes={"e": [0.8, 0.9], "step": ["20 ms", "10 ms", "5 ms"]})
    second = swept(axes={"step": ["0.005 s", "0.01 s"], "e": [0.9, 0.7, 0.8]}, method="rk4")
    found = xd.compare(first, second)
    assert found.e.values.tolist() == [0.8, 0.9]
    assert found.solver_step.values.tolist() == [10.0, 5.0]
    for e in (0.8, 0.9):
        for step in (10.0, 5.0):
            pair = [float(sweep.end_y.sel(e=e, solver_step=h)) for sweep, h in ((first, step), (second, step / 1000))]
            assert float(found.difference_end_y.sel(e=e, solver_step=step)) == pair[1] - pair[0]
    assert found.attrs["alone_in_first"] == "solver_step = 20.0 ms"
    assert found.attrs["alone_in_second"] == "e = 0.7"
    assert found.attrs["units"] == "solver_step: ms | s"
    assert found.attrs["cause"] == "settings: method: velocity_verlet | rk4"
    assert found.attrs["identical"] == 0


def test_the_error_of_a_method_is_within_its_uncertainty() -> None:
    """Assert that Heun's known error is less than what its levels tell, and that another frequency is not."""
    axes = {"m": [1.0, 2.0], "step": [0.04, 0.02, 0.01]}
    rough = swept(OSCILLATOR, axes, method="heun")
    exact = swept(OSCILLATOR, axes, method="dop853")
    found = xd.compare(rough, exact)
    for name in ("end_x", "end_v_x"):
        assert (np.abs(found[f"difference_{name}"]) <= found[f"uncertainty_{name}"]).all()
        assert (np.abs(found[f"difference_{name}"]) > 0).any()
        assert (found[f"verdict_{name}"] == WITHIN).all()
    stiffer = xd.compare(rough, swept(OSCILLATOR.replace(parameters={"k": 4.4}), axes, method="heun"))
    assert (stiffer.verdict_end_x == DIFFERS).all()
    assert stiffer.attrs["cause"] == "parameters: k: 4.0 N m-1 | 4.4 N m-1"


def test_the_uncertainty_is_that_of_a_method_of_first_order() -> None:
    """Assert Roache's estimate of numbers that differ from their limit by just the step, in any order of the levels."""
    sweep = swept(axes={"e": [0.8, 0.9], "step": [0.01, 0.04, 0.02]})
    made = sweep.assign(end_y=sweep.end_y.copy(data=np.tile(sweep.solver_step.values, (2, 1))))
    doubt = xd.compare(made, made).uncertainty_end_y
    assert doubt.isel(e=0).values.tolist() == pytest.approx([2.5 * 0.01, 2.5 * 0.04, 2.5 * 0.02], rel=1e-12)
    two = made.isel(solver_step=[1, 2])
    assert xd.compare(two, two).uncertainty_end_y.isel(e=0).values.tolist() == pytest.approx(
        [6 * 0.04, 6 * 0.02], rel=1e-12
    )


CAUSES: dict[str, tuple[dict[str, Any], str]] = {
    "parameter": ({"model": BALL.replace(parameters={"g": 9.9})}, "parameters: g: 9.81 m s-2 | 9.9 m s-2"),
    "start": ({"model": BALL.replace(initial={"y": "2 m"})}, "initial: y: 1.0 m | 2.0 m"),
    "method": ({"method": "rk4"}, "settings: method: velocity_verlet | rk4"),
    "step": ({"step": 0.02}, "settings: step: 0.01 | 0.02"),
    "law": ({"model": BALL.replace(forces={"wind": {"y": "0.1*newton"}})}, "model: forces.wind.y: absent | 0.1*newton"),
}


@pytest.mark.parametrize("cause", CAUSES)
def test_the_cause_has_its_name(cause: str) -> None:
    """Assert the first of what differs, and that without levels nothing is claimed of more than rounding leaves."""
    asked, words = CAUSES[cause]
    found = xd.compare(swept(), swept(**asked))
    assert found.attrs["cause"] == words
    differing = abs(found.difference_end_y) > 1e-12
    assert (found.verdict_end_y == xr.where(differing, UNKNOWN, WITHIN)).all()


def test_versions_units_and_what_an_axis_says() -> None:
    """Assert the version by name, numbers in the unit of the first, and no parameter that is an axis among the causes."""
    first, second = swept(), swept(BALL.replace(parameters={"e": 0.5}))
    second.attrs["xdynamics_version"] = "0.1.0"
    assert (
        xd.compare(first, second).attrs["cause"]
        == f"versions: xdynamics_version: {first.attrs['xdynamics_version']} | 0.1.0"
    )
    milli = second.assign(end_y=second.end_y * 1000.0)
    milli.end_y.attrs["units"] = "mm"
    found = xd.compare(first, milli)
    assert np.abs(found.difference_end_y).max() < 1e-12
    assert found.attrs["units"] == "end_y: m | mm"
    levels = swept(axes={"e": [0.8, 0.9], "step": [0.02, 0.01]}, method="forward_euler")
    milli = levels.assign(end_y=levels.end_y * 1000.0)
    milli.end_y.attrs["units"] = "mm"
    doubts = [xd.compare(levels, other).uncertainty_end_y.values for other in (levels, milli)]
    assert doubts[1].ravel().tolist() == pytest.approx(doubts[0].ravel().tolist(), rel=1e-9)


def test_a_sweep_is_itself_and_a_lazy_one_is_not_marched() -> None:
    """Assert one line for the same members, dask arrays of lazy ones with the same numbers, and an archive of what is found."""
    sweep = swept()
    same = xd.compare(sweep, sweep)
    assert [*sweep_comparison_lines(same)] == ["the same sweep: 2 members, bit for bit"]
    lazy = xd.sweep(BALL, {"e": [0.8, 0.9]}, step=0.02, method="velocity_verlet", **KEPT)
    found = xd.compare(sweep, lazy)
    assert found.difference_end_y.chunks is not None
    assert "identical" not in found.attrs
    whole = xd.compare(sweep, lazy.compute())
    assert found.difference_end_y.values.tolist() == whole.difference_end_y.values.tolist()
    assert found.verdict_end_y.values.tolist() == whole.verdict_end_y.values.tolist()


def test_a_member_that_failed_in_one_alone_differs() -> None:
    """Assert that a number that is missing in one differs, and in both does not."""
    sweep = swept()
    failed = sweep.assign(end_y=sweep.end_y.where(sweep.e < 0.85))
    assert xd.compare(sweep, failed).verdict_end_y.values.tolist() == [WITHIN, DIFFERS]
    assert xd.compare(failed, failed).verdict_end_y.values.tolist() == [WITHIN, WITHIN]


def test_the_command_compares_folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert a line for each number and the cause, an archive, its table with a row a member, and exit codes."""
    monkeypatch.chdir(tmp_path)
    for name, step in (("a", 0.01), ("b", 0.02)):
        xd.sweep(BALL, {"e": [0.8, 0.9]}, step=step, method="velocity_verlet", path=name, **KEPT)
    done = CliRunner().invoke(main, ["compare", "a", "b", "-o", "apart.nc"])
    assert done.exit_code == 1, done.output
    assert "setting   step: 0.01 | 0.02" in done.output
    assert "members   2 in both" in done.output
    assert "end_y: " in done.output
    assert CliRunner().invoke(main, ["compare", "a", "a"]).exit_code == 0
    shown = CliRunner().invoke(main, ["show", "apart.nc"])
    assert "setting   step: 0.01 | 0.02" in shown.output
    table = CliRunner().invoke(main, ["table", "apart.nc"]).output.splitlines()
    assert table[0].split()[0] == "e"
    assert [line.split()[0] for line in table[1:3]] == ["0.8", "0.9"]


WRONG: dict[str, tuple[Any, str]] = {
    "a run": (lambda sweep: xd.compare(sweep, xd.simulate(BALL, until=0.1)), "one is a sweep and the other is none"),
    "another axis": (
        lambda sweep: xd.compare(sweep, swept(axes={"g": [9.8]})),
        "the second sweep has no axis like 'e'",
    ),
    "an axis more": (
        lambda sweep: xd.compare(swept(axes={"e": [0.8], "g": [9.8]}), sweep),
        r"the second sweep has no axis like 'g'; .* sweep.isel\(g=0\)",
    ),
    "a member": (lambda sweep: xd.compare(sweep, sweep.isel(e=0)), "no axis like 'e'"),
    "nothing in common": (
        lambda sweep: xd.compare(sweep, swept(axes={"e": [0.7]})),
        "no value of 'e' is in both sweeps: e = 0.8, e = 0.9 there, e = 0.7 here",
    ),
    "times": (
        lambda sweep: xd.compare(sweep, sweep, times=[0.1]),
        "times, compute, sizes and occurrences are for runs",
    ),
    "another dimension": (
        lambda sweep: xd.compare(sweep, sweep.assign(end_y=sweep.end_y.assign_attrs(units="kg"))),
        "'end_y' has the unit 'm' in the first sweep and 'kg' in the second",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line(case: str) -> None:
    """Assert one error that names it and the way on."""
    made, words = WRONG[case]
    with pytest.raises(xd.InputError, match=words):
        made(swept())


def test_a_table_that_differs_is_named_by_its_first_row(tmp_path: Path) -> None:
    """Assert the name of a measured table, of its file, and the first of its rows that differ, with their number."""
    text, rows = ((MODELS / f"cart_spring.{end}").read_text() for end in ("toml", "csv"))
    (tmp_path / "a.csv").write_text(rows)
    (tmp_path / "b.csv").write_text(rows.replace("-17.5,11.82", "-17.5,11.83").replace("-15,9.04", "-15,9.05"))
    models = []
    for name in ("a", "b"):
        (tmp_path / f"{name}.toml").write_text(text.replace("cart_spring.csv", f"{name}.csv"))
        models.append(xd.Model.from_toml(tmp_path / f"{name}.toml"))
    grids = [xd.sweep(model, {"x": "0.1:0.12:2 m"}, until="0.1 s").compute() for model in models]
    found = xd.compare(*grids)
    assert found.attrs["cause"] == "model: drives.restoring.table: a.csv | b.csv, and 1 more"
    assert found.attrs["model"].splitlines()[1] == (
        "drives.restoring.csv: row 6: -17.5,11.82 | -17.5,11.83, and 1 more"
    )
