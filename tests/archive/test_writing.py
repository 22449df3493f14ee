"""How a new file is checked before it takes its name, and which name that is."""

from __future__ import annotations

import os
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.archive import writing
from xdynamics.archive.integrity_checks import Examination
from xdynamics.archive.sandboxed_reading import is_known
from xdynamics.archive.seals import tail_of


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A small run."""
    return xd.simulate(oscillator().model, step=0.1, until=1.0)


@pytest.mark.parametrize("stem", ["run", "n" * 252, "ä" * 126])
def test_a_name_beside_is_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stem: str) -> None:
    """Assert that a name is free or a bad end's, keeps its ending and is no longer than names may be."""
    path, ends = tmp_path / f"{stem}.nc", {}
    monkeypatch.setattr(writing, "examine_sandboxed", lambda path, _tail: Examination((), "", ends[path]))
    assert writing.partial_run_location(path) == path
    path.touch()
    ends[path] = "interrupted"
    assert writing.partial_run_location(path) == path
    ends[path] = "completed"
    other = writing.partial_run_location(path)
    room = len(os.fsencode(stem)) + len(".partial.nc") - len(os.fsencode(other.name))
    assert (len(os.fsencode(other.name)) <= 255, 0 <= room < 14) == (True, True)
    assert other.name.endswith(".partial.nc")
    assert other.name[:100] == path.name.removesuffix(".nc")[:100] or stem == "run"
    if stem == "run":
        other.touch()
        ends[other] = "completed"
        assert writing.partial_run_location(path).name == "run.partial.partial.nc"


def test_what_reads_otherwise_takes_no_name(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a new file is compared with what was written before it takes its name."""
    monkeypatch.setattr(writing, "compare_file", lambda *_: Examination(("a is other", "b is other")))
    with pytest.raises(xd.ArchiveError, match="what was written reads otherwise: a is other; b is other"):
        xd.save(run, tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_large_file_is_opened_only(run: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file over the limit is not read again, a smaller one is, and that both are known from then on."""
    compare, read = writing.compare_file, []
    monkeypatch.setattr(writing, "compare_file", lambda *given: read.append(given) or compare(*given))
    small = xd.save(run, tmp_path / "small.nc")
    size = small.stat().st_size
    for limit, looks in ((size, 2), (size - 1, 2)):
        monkeypatch.setattr(writing, "READ_BACK", limit)
        path = xd.save(run, tmp_path / f"{limit}.nc")
        assert path.stat().st_size == size
        assert len(read) == looks
        assert is_known(tail_of(path))


def test_what_lies_along_the_steps_says_when(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that variables along a dimension name its times as their coordinate, and one of them all that describes the run."""
    xd.save(run, tmp_path / "saved.nc")
    xd.simulate(oscillator().model, step=0.1, until=1.0, path=tmp_path / "streamed.nc").close()
    times = {"step": "time", "event": "event_time", "trial": "trial_time", "sample": "sample_time"}
    along = {
        str(name): times[str(variable.dims[0])]
        for name, variable in run.variables.items()
        if variable.dims[:1] != () and variable.dims[0] in times and name != times[str(variable.dims[0])]
    }
    along |= {"step_size": "time step_number m k", "model_toml": "force_source", "force_source": "model_toml"}
    for name in ("saved", "streamed"):
        with netCDF4.Dataset(tmp_path / f"{name}.nc") as file:
            found = {
                variable.name: variable.coordinates
                for variable in file.variables.values()
                if "coordinates" in variable.ncattrs()
            }
        assert found == along


@pytest.mark.parametrize("what", [5, "run.nc", {"x": np.zeros(3)}, xr.DataArray([1.0])])
def test_what_is_no_dataset_is_told(tmp_path: Path, what: object) -> None:
    """Assert one sentence with the beginning of what was given."""
    with pytest.raises(xd.InputError, match="a run record is to be saved, got .") as caught:
        xd.save(what, tmp_path / "no.nc")
    assert len(str(caught.value)) < 80


def test_derived_data_are_a_record(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that what was made from a run is looked at as a run is, values too."""
    turned = run.assign_coords(time=run.time.copy(data=run.time.values[::-1].copy()))
    for derived in (None, "turned round"):
        with pytest.raises(xd.InputError, match="it must increase"):
            xd.save(turned, tmp_path / "no.nc", derived=derived)


def test_derived_data_of_nothing_known(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert that data say so whose run is not known, and how they were made, blanks around it left out."""
    unknown = run.assign_attrs(origin="lost")
    kept = xd.open_run(xd.save(unknown, tmp_path / "derived.nc", derived=" made up "))
    assert (kept.attrs["derived"], kept.attrs["derived_from"]) == ("made up", "unknown")


@pytest.mark.parametrize(
    ("text", "tables"),
    [
        ('[drives.a]\ncsv = "t,a"\n[drives.b]\ncsv = 5\n[drives.c]\nvalue = "1"\n', ["t,a", "5"]),
        ("[model]\n", []),
        ("no = ", []),
        ("drives = 5\n", []),
        ("[drives]\na = 5\n", []),
        ("a = " + "[" * 5000, []),
    ],
)
def test_tables_are_found_in_any_text(text: str, tables: list[str]) -> None:
    """Assert the texts of tables, and none of what is no model; derived data may hold anything."""
    assert writing._table_texts(xr.Dataset({"model_toml": ((), text)})) == tables
    assert writing._table_texts(xr.Dataset()) == []


def test_one_element_of_a_run_is_no_run(tmp_path: Path) -> None:
    """Assert that a run of one element is said to be cut, and not that attributes of all elements are no numbers."""
    run = xd.simulate(
        xd.Model(
            name="two",
            dimensions={"body": ["a", "b"]},
            coordinates={"u": {"unit": "m", "dims": ["body"]}},
            parameters={"m": {"dims": ["body"], "value": [1.0, 2.0], "unit": "kg", "uncertainty": [0.1, 0.2]}},
            mass={"u": "m"},
            initial={"u": "1 m"},
        ),
        method="rk4",
        step="1 s",
        until="1 s",
    )
    with pytest.raises(xd.InputError, match="the run was cut: it has a single one of its 2 elements along 'body'"):
        xd.save(run.sel(body="b"), tmp_path / "b.nc")
