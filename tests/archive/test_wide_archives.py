"""Records of many variables: what saving and opening them costs does not grow with the square of their number."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pytest

import xdynamics as xd
from xdynamics.archive.netcdf_library import opened_file, with_library_lock


def springs(count: int) -> xd.Model:
    """Return bodies on springs, each with scalars of its own, and no events."""
    return xd.Model(
        name="springs",
        coordinates={f"x{i}": "m" for i in range(count)},
        mass={f"x{i}": "kilogram" for i in range(count)},
        parameters={"k": "10 N/m"},
        forces={"spring": {f"x{i}": f"-k*x{i}" for i in range(count)}},
        initial={f"x{i}": "0.1 m" for i in range(count)} | {f"v_x{i}": "0 m/s" for i in range(count)},
    )


def test_lengths_of_dimensions_are_asked_for_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the library is asked as often for a length, which takes it a look at every variable, however many these are."""
    asked = []

    def counted(dimension: Any) -> int:
        asked.append(dimension.name)
        return len(dimension)

    monkeypatch.setattr("xdynamics.archive.netcdf_library.len", counted, raising=False)
    sums = []
    for count in (5, 20):
        run, path = xd.simulate(springs(count), method="rk4", step=0.01, until=0.1), tmp_path / f"{count}.nc"
        asked.clear()
        xd.save(run, path)
        xd.open_run(path).close()
        sums.append(len(asked))
    assert sums[0] == sums[1] > 0


def test_a_measured_dimension_is_one_of_the_librarys(tmp_path: Path) -> None:
    """Assert length, name, kind and shapes along dimensions without rows, as the library has them."""
    path = tmp_path / "run.nc"
    xd.save(xd.simulate(springs(2), method="rk4", step=0.01, until=0.1), path)
    with opened_file(path) as file, netCDF4.Dataset(path) as plain:
        for name, dimension in file.dimensions.items():
            other = plain.dimensions[name]
            assert (len(dimension), dimension.name, dimension.isunlimited()) == (len(other), name, other.isunlimited())
        shapes = with_library_lock(lambda: {name: variable.shape for name, variable in file.variables.items()})()
        assert shapes == {name: variable.shape for name, variable in plain.variables.items()}
        assert (0,) in shapes.values()
    run = xd.open_run(path)
    np.testing.assert_array_equal(run.x1.values[:1], [0.1])
