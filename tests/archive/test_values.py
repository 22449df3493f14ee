"""Values of archives as xarray asks for them: what is stored, and of that what is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from xdynamics.archive.netcdf_library import opened_file
from xdynamics.archive.shared_handles import SharedArchive
from xdynamics.archive.stored_values import StoredValues, VariableStore

TABLE = np.arange(12, dtype="i2").reshape(4, 3)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file whose variables ask for more than to be read."""
    with opened_file(tmp_path / "odd.nc", "w") as file:
        file.createDimension("n", 4)
        file.createDimension("m", 3)
        scaled = file.createVariable("scaled", "i2", ("n", "m"), fill_value=5)
        scaled.set_auto_maskandscale(False)
        scaled[:] = TABLE
        scaled.setncatts({"scale_factor": 10.0, "units": "m"})
        text = file.createVariable("text", "S1", ("n",))
        text[:] = np.frombuffer("größ".encode()[:4], "S1")
        text.setncattr("_Encoding", "utf-8")
    return tmp_path / "odd.nc"


def test_values_are_those_that_are_stored(path: Path) -> None:
    """Assert that no scale is applied, nothing is masked, and letters stay apart."""
    one = SharedArchive(path)
    store = VariableStore(one, mode="r")
    found = store.open_store_variable("scaled", store.ds.variables["scaled"])
    assert (found.dims, found.shape, found.dtype, found.attrs["units"]) == (("n", "m"), (4, 3), np.dtype("i2"), "m")
    assert "chunksizes" in found.encoding
    text = store.open_store_variable("text", store.ds.variables["text"])
    for _ in range(2):
        values = found.values
        assert type(values) is np.ndarray
        assert values.tolist() == TABLE.tolist()
        assert text.values.tobytes() == "größ".encode()[:4]
        one.close()  # and opened again, by nobody that xarray knows


def test_only_what_is_asked_for_is_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that rows and columns are chosen by the library, and points of the little that it read."""
    keys = []
    read = StoredValues._read_by_key
    monkeypatch.setattr(StoredValues, "_read_by_key", lambda one, key: keys.append(key) or read(one, key))
    store = VariableStore(SharedArchive(path), mode="r")
    array = xr.DataArray(store.open_store_variable("scaled", store.ds.variables["scaled"]))
    assert keys == []
    assert array[1:3, 0].values.tolist() == TABLE[1:3, 0].tolist()
    assert array[[3, 1], [0, 2]].values.tolist() == TABLE[np.ix_([3, 1], [0, 2])].tolist()
    assert len(keys) == 2
    assert keys[0] == (slice(1, 3, 1), 0)
    assert [np.size(one) for one in keys[1]] == [2, 2]
