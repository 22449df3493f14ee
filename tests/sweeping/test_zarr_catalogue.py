"""Sweeps in a Zarr store: written by blocks, verified by digests, opened by plain xarray."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.sweeping import zarr_catalogue

pytest.importorskip("zarr")
MODEL = oscillator().model
ASKED: dict[str, Any] = {
    "axes": {"k": "1:2:5 N m-1", "method": ["rk4", "heun"]},
    "step": 0.1,
    "until": 1.0,
    "keep": ["end", "x"],
    "times": [0.5],
}


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    """The sweep in memory."""
    return xd.sweep(MODEL, **ASKED).compute()


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """A sweep in a store, of six blocks."""
    xd.sweep(MODEL, **ASKED, path=tmp_path / "grid.zarr", members_per_task=2)
    return tmp_path / "grid.zarr"


def test_a_store_has_what_a_sweep_has(stored: Path, whole: xr.Dataset) -> None:
    """Assert all values, texts too, lazily, units, the same members, and one digest for all of it."""
    sweep = xd.open_sweep(stored)
    assert sweep.end_x.chunks == ((2, 2, 1), (1, 1))
    for name in whole.data_vars:
        np.testing.assert_array_equal(sweep[name].values, whole[name].values)
        assert sweep[name].attrs["units"] == whole[name].attrs["units"]
    assert xd.verify(stored) == sweep.attrs["content_digest"]
    run = xd.member(sweep, k="2 N m-1", method="heun")
    assert float(run.x[-1]) == float(whole.end_x[4, 1])
    assert xd.sweep(MODEL, **ASKED, path=stored).attrs["content_digest"] == sweep.attrs["content_digest"]


def test_plain_xarray_opens_it(stored: Path, whole: xr.Dataset) -> None:
    """Assert that without this package there are lazy numbers with units, labels and the meanings of flags."""
    plain = xr.open_zarr(stored)
    assert plain.end_x.chunks is not None
    assert float(plain.end_x.sel({"k": 2.0, "method": "heun"})) == float(whole.end_x[4, 1])
    assert (plain.end_x.attrs["units"], plain.k.attrs["units"]) == ("m", "N m-1")
    words = plain.run_outcome.attrs["flag_meanings"].split()
    assert {words[code] for code in plain.run_outcome.values.ravel()} == {"completed"}


def test_what_was_begun_goes_on(tmp_path: Path, whole: xr.Dataset) -> None:
    """Assert that a sweep which broke off is told, goes on with the blocks that are missing or hurt, and is whole then."""
    folder, keep, kept = tmp_path / "grid.zarr", zarr_catalogue._keep, []

    def broken(plan: Any, block: Any, where: Any) -> None:
        if len(kept) == 4:
            raise KeyboardInterrupt
        kept.append(block)
        keep(plan, block, where)

    import dask

    one_by_one = dask.config.set(scheduler="synchronous")
    with mock.patch.object(zarr_catalogue, "_keep", broken), one_by_one, pytest.raises(KeyboardInterrupt):
        xd.sweep(MODEL, **ASKED, path=folder, members_per_task=2)
    with pytest.raises(xd.InputError, match="grid.zarr' is not finished; call the same sweep again, and it goes on"):
        xd.open_sweep(folder)
    first = "_".join(f"{extent.start}-{extent.stop}" for extent in kept[0])
    note = folder / ".xdynamics" / f"{first}.json"
    note.write_text(note.read_text().replace('"end_x": "', '"end_x": "0'))
    again = []
    with mock.patch.object(zarr_catalogue, "_keep", lambda *given: again.append(given[1]) or keep(*given)):
        sweep = xd.sweep(MODEL, **ASKED, path=folder, members_per_task=2)
    assert len(again) == 3
    assert sweep.end_x.values.tolist() == whole.end_x.values.tolist()
    assert xd.verify(folder)


def test_damage_is_named(stored: Path) -> None:
    """Assert that a chunk that is hurt, an axis that was edited and other metadata are found and named."""
    chunk = stored / "end_x" / "c" / "1" / "0"
    whole = chunk.read_bytes()
    chunk.write_bytes(whole[:-3])
    with pytest.raises(xd.ArchiveError, match="array 'end_x' cannot be read in block 2-4_0-1"):
        xd.verify(stored)
    chunk.write_bytes((stored / "end_x" / "c" / "0" / "0").read_bytes())
    with pytest.raises(xd.ArchiveError, match="array 'end_x' differs in block 2-4_0-1"):
        xd.verify(stored)
    chunk.write_bytes(whole)
    values = stored / "k" / "c" / "0"
    values.rename(values.with_name("1"))
    with pytest.raises(xd.ArchiveError, match="array 'k' differs"):
        xd.verify(stored)
    metadata = stored / "zarr.json"
    metadata.write_text(metadata.read_text().replace("N m-1", "N m-2"))
    with pytest.raises(xd.ArchiveError, match="zarr.json' differs from its digest"):
        xd.open_sweep(stored)


def test_what_a_store_does_not_take(stored: Path) -> None:
    """Assert that another sweep, further members and whole runs are refused with the remedy."""
    with pytest.raises(
        xd.InputError, match="grid.zarr' holds another sweep, and members are not added to a Zarr store"
    ):
        xd.sweep(MODEL, **(ASKED | {"until": 2.0}), path=stored)
    with pytest.raises(
        xd.InputError, match=r"which has no files of runs: name a folder, path='.*/grid'; or leave 'log' out, and march"
    ):
        xd.sweep(MODEL, **(ASKED | {"keep": ["log"], "times": None}), path=stored)
    with pytest.raises(xd.InputError, match="none.zarr' holds no sweep: there is no '.xdynamics/digests.json' in it"):
        xd.open_sweep(stored.with_name("none.zarr"))


def test_a_digest_says_nothing_of_the_machine() -> None:
    """Assert that metadata, in which processor and versions are, change no digest, and that values do."""
    facts = {"sweep": "a", "axes": {"k": "b"}, "blocks": {"0": {"x": "c"}}, "metadata": "d"}
    digest = zarr_catalogue._content_digest(facts)
    assert zarr_catalogue._content_digest(facts | {"metadata": "e"}) == digest
    for name, other in (("sweep", "b"), ("axes", {"k": "c"}), ("blocks", {"0": {"x": "d"}})):
        assert zarr_catalogue._content_digest(facts | {name: other}) != digest


def test_a_killed_sweep_goes_on() -> None:
    """Assert that kill -9 at random moments loses no finished block, and leaves nothing beside the digest of the whole."""
    script = Path(__file__).parents[1] / "cases" / "killed_sweeps.py"
    done = subprocess.run([sys.executable, script, "2"], capture_output=True, text=True, timeout=300, check=False)
    assert done.stderr == ""
    found = re.fullmatch(r"2 of 2 equal, (\d+) kills, (\d+) behind a finished block, left (.*)\n", done.stdout)
    assert found is not None, done.stdout
    assert int(found[1]) > 0
    assert found[3] == "blocks.json digests.json"


def test_what_was_left_behind_the_end_is_cleared(stored: Path) -> None:
    """Assert that digests of blocks, which a process was killed while it removed, are removed by the next call."""
    left = stored / ".xdynamics" / "0-2_0-1.json"
    left.write_text("{}")
    digest = xd.verify(stored)
    assert xd.sweep(MODEL, **ASKED, path=stored).attrs["content_digest"] == digest
    assert sorted(entry.name for entry in left.parent.iterdir()) == ["blocks.json", "digests.json"]
