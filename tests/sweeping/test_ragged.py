"""All rows of many runs in one Dataset: saved, verified, opened in chunks, and described before any run is marched."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.stages import assert_described, assert_same_bits, marches
from cases.verdicts import verified
from xdynamics.record import faults_of

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


@pytest.fixture(scope="module")
def swept() -> xr.Dataset:
    """A grid of balls by two methods, whose runs have rows of different numbers."""
    return xd.sweep(BALL, {"v_y": [10.0, 30.0], "method": ["heun", "rk4"]}, step=0.1, until="2 s")


@pytest.fixture(scope="module")
def rows(swept: xr.Dataset) -> xr.Dataset:
    """All of their rows."""
    return xd.ragged(swept)


@pytest.mark.dear
def test_rows_of_many_runs_are_saved_and_opened(rows: xr.Dataset, tmp_path: Path) -> None:
    """Assert the same bits from the file, whole and in chunks, the digest of what was saved, and times as coordinates."""
    xd.save(rows, tmp_path / "rows.nc")
    assert verified(tmp_path / "rows.nc") == xd.content_digest(rows)
    with xd.open_run(tmp_path / "rows.nc") as kept, xd.open_run(tmp_path / "rows.nc", chunks={"row": 7}) as chunked:
        assert_same_bits(
            kept.assign(run_solver_method=kept.run_solver_method.astype(rows.run_solver_method.dtype)), rows
        )
        assert {*kept.coords} == {*rows.coords} == {"time", "step_number"}
        assert len(chunked.y.chunks[0]) > 2
        xd.save(chunked, tmp_path / "again.nc")
    assert verified(tmp_path / "again.nc") == xd.content_digest(rows)


def test_lazy_rows_are_described_and_saved_as_many_as_there_are(
    swept: xr.Dataset, rows: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert names and units while no run can be marched, rows beyond the last of no value, and the archive of the eager."""
    count, marched = rows.sizes["row"], []
    march = xd.sweeping.grid.march_many
    with monkeypatch.context() as patch:
        patch.setattr("xdynamics.sweeping.grid.march_many", lambda *_, **__: pytest.fail("marched"))
        exact, longer = (xd.ragged(swept, compute=False, sizes={"row": n}) for n in (count, count + 3))
        assert_described(exact, rows)
    monkeypatch.setattr("xdynamics.sweeping.grid.march_many", lambda *a, **k: marched.append(1) or march(*a, **k))
    with marches():
        assert np.isnan(longer.y.values[count:]).all()
        assert longer.y.values[:count].tobytes() == rows.y.values.tobytes()
        assert_same_bits(exact, rows)
        xd.save(longer, tmp_path / "rows.nc")
        assert len(marched) == 2  # of each method all runs, once
    assert verified(tmp_path / "rows.nc") == xd.content_digest(rows)
    xd.save(exact.compute(), tmp_path / "rows.nc")
    with xd.open_run(tmp_path / "rows.nc") as kept:
        assert_same_bits(kept, rows.drop_vars("run_solver_method"))


@pytest.mark.parametrize("sizes", [None, {"step": 5}, {"row": 0}, {"row": True}, 5])
def test_how_many_rows_there_are_has_to_be_stated(swept: xr.Dataset, sizes: Any) -> None:
    """Assert that rows of unknown number, none, or of another dimension are refused, and those of marched runs too."""
    with pytest.raises(xd.InputError, match=r"known only once they are marched; give a number, sizes=\{'row': 4000\}"):
        xd.ragged(swept, compute=False, sizes=sizes)
    if sizes is not None:
        with pytest.raises(xd.InputError, match="for compute=False: runs that are marched have their own"):
            xd.ragged(swept, sizes=sizes)


def test_fewer_rows_than_there_are(swept: xr.Dataset, rows: xr.Dataset) -> None:
    """Assert that too few are an error that names the right number."""
    few = xd.ragged(swept, compute=False, sizes={"row": 3})
    with pytest.raises(xd.InputError, match=rf"were stated: sizes=\{{'row': {rows.sizes['row']}\}}"):
        few.y.compute()


def test_times_of_each_run_increase(rows: xr.Dataset) -> None:
    """Assert that times may begin again where a run does and nowhere else, and that rows are counted."""
    assert faults_of(rows) == []
    whole, inside = rows.row_size.values, int(rows.row_size[0]) + 3
    times = rows.time.values.copy()
    times[inside] = times[inside - 1]
    (fault,) = faults_of(rows.assign_coords(time=("row", times, rows.time.attrs)))
    assert f"at row {inside}: it must increase" in fault
    for counts in (whole + np.eye(4, dtype=int)[0], whole[:-1], [0, whole[0] + whole[1], *whole[2:]]):
        other = rows.drop_vars([name for name in rows.variables if rows[name].dims == ("run",)])
        (fault,) = faults_of(other.assign(row_size=("run", np.array(counts), rows.row_size.attrs)))
        assert fault.startswith(f"variable 'row_size' counts {sum(counts)} rows of {len(counts)} runs, and there are")


def test_padded_rows_are_not_saved(swept: xr.Dataset, rows: xr.Dataset, tmp_path: Path) -> None:
    """Assert that rows that were computed with room for more are refused, and counted."""
    longer = xd.ragged(swept, compute=False, sizes={"row": rows.sizes["row"] + 3}).compute()
    with pytest.raises(xd.InputError, match="'row_size' counts .* rows of 4 runs, and there are"):
        xd.save(longer, tmp_path / "rows.nc")
    assert not (tmp_path / "rows.nc").exists()
