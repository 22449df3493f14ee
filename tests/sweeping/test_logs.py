"""The whole runs of a sweep together, at common times."""

from __future__ import annotations

from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import sandboxed_reading
from xdynamics.evidence.stages import compute_datasets
from xdynamics.sweeping import logs

MODEL = oscillator().model
ASKED: dict[str, Any] = {"axes": {"k": "1:2:2 N m-1", "until": [1.0, 2.0]}, "method": "rk4", "step": 0.1}


@pytest.fixture(scope="module")
def grid(tmp_path_factory: pytest.TempPathFactory) -> xr.Dataset:
    """A sweep with whole runs, two of which end early."""
    return xd.sweep(MODEL, **ASKED, keep=["log", "end"], path=tmp_path_factory.mktemp("logs") / "grid")


def test_logs_are_what_sample_gives(grid: xr.Dataset) -> None:
    """Assert along axes and times the states of every member, nan after its end, with units."""
    opened = xd.open_logs(grid, "0:2:5 s")
    assert dict(opened.sizes) == {"k": 2, "solver_until": 2, "at": 5}
    assert opened.x.attrs["units"] == "m"
    states = xd.sample(xd.member(grid, k="2 N m-1", until="2 s"), "0:2:5 s")
    for name in ("x", "v_x"):
        assert opened[name][1, 1].values.tolist() == states[name].values.tolist()
    assert np.isnan(opened.x[:, 0].values).tolist() == [[False] * 3 + [True] * 2] * 2


def test_files_are_read_when_they_are_used(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that nothing is read to open them, and one file once for both variables of one member."""
    read = counted(monkeypatch)
    lazy = xd.open_logs(grid, [0.5, 1.0])
    assert read == []
    lazy.isel(k=0, solver_until=0).compute()
    assert len(read) == 1


def counted(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Note the files that logs are read from."""
    read: list[Any] = []
    columns_of = logs.read_columns
    monkeypatch.setattr(logs, "read_columns", lambda *given: read.append(given[0]) or columns_of(*given))
    return read


@pytest.mark.dear
def test_saving_logs_reads_each_file_once(grid: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that logs which a report computes are archived without being read again, and that an edit is noticed."""
    read = counted(monkeypatch)
    page = xd.report(tmp_path, logs=xd.open_logs(grid, [0.5, 1.0]))
    assert len(read) == len({*read}) == 4
    assert f"logs.nc, {verified(tmp_path / 'logs.nc')}" in page
    (held,) = compute_datasets(xd.open_logs(grid, [0.5]))
    held["x"] = held.x + 1.0
    with pytest.raises(xd.InputError, match="variable 'x' is .* in row 0, .*in the run"):
        xd.save(held, tmp_path / "edited.nc")


@pytest.mark.dear
def test_logs_of_files_of_others_are_those_of_own(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same bits where the files' bytes are not known to the process, and that all of them are examined then."""
    own = xd.open_logs(grid, "0:2:5 s").compute()
    monkeypatch.setattr(sandboxed_reading, "_known_seals", OrderedDict())
    asked: list[Path] = []
    examine = sandboxed_reading._EXAMINER.examine
    monkeypatch.setattr(
        sandboxed_reading._EXAMINER, "examine", lambda *given: asked.append(given[0]) or examine(*given)
    )
    assert xd.open_logs(grid, "0:2:5 s").compute().identical(own)
    assert len({*asked}) == 4


def test_who_reads_for_another_need_not_examine_again(grid: xr.Dataset, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that tasks carry what is known of the files where they are described, for workers that know nothing."""
    lazy = xd.open_logs(grid, [0.5])
    monkeypatch.setattr(sandboxed_reading, "_known_seals", OrderedDict())
    monkeypatch.setattr(sandboxed_reading._EXAMINER, "examine", lambda *_: pytest.fail("examined"))
    assert np.isfinite(lazy.compute().x.values).all()


def test_logs_of_a_part_are_those_of_its_members(grid: xr.Dataset) -> None:
    """Assert the same numbers of a part, its axes turned round or one of them gone."""
    whole = xd.open_logs(grid, [0.5, 1.0])
    turned = xd.open_logs(grid.transpose("solver_until", "k"), [0.5, 1.0])
    assert turned.x.transpose("k", "solver_until", "at").values.tolist() == whole.x.values.tolist()
    assert xd.open_logs(grid.isel(k=1), [0.5, 1.0]).x.values.tolist() == whole.x[1].values.tolist()


@pytest.mark.dear
def test_a_run_that_is_hurt_is_named(tmp_path: Path) -> None:
    """Assert that a damaged file is an error where it is read, and not before."""
    grid = xd.sweep(MODEL, **ASKED, keep=["log"], path=tmp_path / "grid")
    file = tmp_path / "grid" / str(grid.run_file[0, 0].values)
    file.write_bytes(file.read_bytes()[:-9])
    lazy = xd.open_logs(tmp_path / "grid", [0.5], names=["x"])
    lazy.isel(k=1).compute()
    with pytest.raises(xd.ArchiveError, match=f"{file.name}' is damaged or no run archive"):
        lazy.isel(k=0, solver_until=0).compute()


def test_what_has_no_logs_is_refused(grid: xr.Dataset) -> None:
    """Assert one line with the remedy."""
    with pytest.raises(xd.InputError, match="has no archived runs: give sweep keep="):
        xd.open_logs(xd.sweep(MODEL, **ASKED), [0.5])
    with pytest.raises(xd.InputError, match="names have 'y'; there are x, v_x"):
        xd.open_logs(grid, [0.5], names=["y"])
    with pytest.raises(xd.InputError, match="no times of its own; give times"):
        xd.open_logs(grid)
