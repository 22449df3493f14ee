"""Elements of stored variables chosen by their numbers: NumPy's answer, by few reads, and the same runs opened and in memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.archive.netcdf_library import opened_file
from xdynamics.archive.stored_values import read_elements


class Watched:
    """A variable of a file that keeps what is asked of it."""

    def __init__(self, variable: Any) -> None:
        self._variable = variable
        self.keys: list[tuple[Any, ...]] = []
        self.read = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._variable, name)

    def __getitem__(self, key: tuple[Any, ...]) -> Any:
        self.keys.append(key)
        found = self._variable[key]
        self.read += np.size(found)
        return found


def any_key(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """A number, a slice or a list for each dimension."""
    key: list[Any] = []
    for length in shape:
        kind = rng.integers(4)
        if kind == 0:
            key.append(int(rng.integers(length)))
        elif kind == 1:
            first, last = sorted(rng.integers(0, length + 1, 2).tolist())
            key.append(slice(first, last, int(rng.integers(1, 4))))
        else:
            rows = rng.integers(-length, length, rng.integers(0, 12))
            key.append(np.sort(rows % length) if kind == 2 else rows)
    return tuple(key)


@pytest.mark.cases(400)
def test_any_choice_is_that_of_numpy(case: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that numbers, slices and lists choose what they choose of an array, whatever the chunks and the stretches."""
    rng = np.random.default_rng(case)
    shape = tuple(rng.integers(1, 40, rng.integers(1, 4)).tolist())
    values = rng.integers(0, 120, shape).astype(rng.choice(["f8", "i1", "i8"]))
    chunks = None if case % 3 == 0 else [int(rng.integers(1, length + 1)) for length in shape]
    monkeypatch.setattr("xdynamics.archive.stored_values.LARGEST", int(rng.integers(1, 4000)))
    with opened_file(tmp_path / "any.nc", "w") as file:
        names = [file.createDimension(f"d{i}", length).name for i, length in enumerate(shape)]
        stored = file.createVariable("any", values.dtype, names, chunksizes=chunks, contiguous=chunks is None)
        stored.set_auto_maskandscale(False)
        stored[...] = values
        for _ in range(5):
            key, watched = any_key(rng, shape), Watched(stored)
            expected = values
            for axis in reversed(range(len(shape))):  # one dimension after the other: each list along its own
                expected = expected[(slice(None),) * axis + (key[axis],)]
            found = np.asarray(read_elements(watched, key))
            assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
            assert np.array_equal(found, expected)
            assert not any(isinstance(one, np.ndarray) for each in watched.keys for one in each)


def test_few_rows_of_a_long_run_cost_few_reads(tmp_path: Path) -> None:
    """Assert that neighbours are read together, and what lies between far rows is not read."""
    with opened_file(tmp_path / "long.nc", "w") as file:
        file.createDimension("step", 1_000_000)
        stored = file.createVariable("y", "f8", ("step",), chunksizes=[1000])
        stored[:] = np.arange(1e6)
        near, far = Watched(stored), Watched(stored)
        read_elements(near, (np.arange(0, 5000, 7),))
        read_elements(far, (np.array([999_999, 0, 1, 500_000]),))
    assert (len(near.keys), near.read) == (1, 4999)
    assert (len(far.keys), far.read) == (3, 4)


def test_a_row_beyond_the_end_is_an_error(tmp_path: Path) -> None:
    """Assert that it is named, and is not the last one."""
    with opened_file(tmp_path / "short.nc", "w") as file:
        file.createDimension("step", 4)
        stored = file.createVariable("y", "f8", ("step",))
        stored[:] = np.arange(4.0)
        with pytest.raises(IndexError, match="index 4 is out of bounds for a dimension of 4"):
            read_elements(stored, (np.array([1, 4]),))


@pytest.mark.dear
def test_evidence_of_an_opened_run_is_that_of_the_run(tmp_path: Path) -> None:
    """Assert that states between, a diagnosis and a comparison have the same bits from a file as from memory."""
    model = xd.Model.from_toml(Path(__file__).parents[2] / "data" / "models" / "kepler.toml")
    run = xd.simulate(model, method="dop853", rtol=1e-8, until="20 s")
    path = xd.save(run, tmp_path / "orbit.nc")
    kept, times = xd.open_run(path), np.random.default_rng(3).uniform(0.0, 20.0, 200)
    stages = [lambda one, side=side: xd.sample(one, times, side=side) for side in ("before", "after")]
    stages += [xd.diagnose, lambda one: xd.compare(one, run, times=times)]
    for stage in stages:
        found, expected = (stage(one).drop_attrs(deep=False) for one in (kept, run))
        xr.testing.assert_identical(found, expected)
