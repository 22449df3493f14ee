"""Tables that libraries read: netCDF, Parquet, Feather, HDF5, MATLAB's files, by a process of their own."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.io import savemat

import xdynamics as xd
from xdynamics.model import file_access

T, PULL = np.array([0.0, 0.5, 1.5]), np.array([0.0, 5.0, 6.0])
UNITS = {"units": '{ t = "s", pull = "N" }'}
MODEL = """
name = "log"
[coordinates]
x = "m"
[mass]
x = "kilogram"
[initial]
x = "0 m"
v_x = "0 m/s"
[drives.pull]
"""


def drive(folder: Path, file: str, **keys: str) -> Any:
    """Return the table of a drive that reads a file."""
    written = "".join(f"{key} = {value}\n" for key, value in keys.items())
    (folder / "model.toml").write_text(f'{MODEL}table = "{file}"\n{written}')
    return xd.Model.from_toml(folder / "model.toml").drives["pull"].table


def group_of_hdf5(path: Path) -> None:
    """Write the table into a group, with the attribute `units`."""
    with netCDF4.Dataset(path, "w") as data:
        data.createDimension("n", 3)
        data.createDimension("one", 1)
        group = data.createGroup("log")
        for name, values, unit in (("time", T, "s"), ("pull", PULL, "N")):
            variable = group.createVariable(name, "f8", ("n", "one"))
            variable[:] = values[:, None]
            variable.setncattr("units", unit)


def netcdf(path: Path) -> None:
    """Write a Dataset that has other variables, too."""
    xr.Dataset(
        {"pull": ("t", PULL, {"units": "N"}), "note": ("t", ["a", "b", "c"]), "grid": (("t", "y"), np.zeros((3, 2)))},
        coords={"t": ("t", T, {"units": "s"})},
    ).to_netcdf(path)


STAMPS = pd.DatetimeIndex(pd.Timestamp("2021-01-01") + pd.to_timedelta(T, "s"), name="time")
FRAME = pd.DataFrame({"t [s]": T, "pull [N]": PULL})
BARE = {"t": T, "pull": PULL}
FILES: dict[str, tuple[Callable[[Path], object], dict[str, str]]] = {
    "a.parquet": (FRAME.to_parquet, {}),
    "b.feather": (FRAME.to_feather, {}),
    "bare.parquet": (pd.DataFrame(BARE).to_parquet, UNITS),
    "dates.parquet": (pd.DataFrame({"pull [N]": PULL}, index=STAMPS).to_parquet, {}),
    "c.nc": (netcdf, {}),
    "d.mat": (
        lambda path: savemat(path, {"gains": np.arange(7.0)} | BARE | {"name": "bench", "matrix": np.zeros((3, 3))}),
        UNITS,
    ),
    "e.h5": (group_of_hdf5, {"column": '"pull"'}),
}


@pytest.mark.parametrize("name", FILES)
def test_the_three_points_are_read(name: str, tmp_path: Path) -> None:
    """Assert the same table from each, which the model's text then holds as CSV."""
    write, keys = FILES[name]
    write(tmp_path / name)
    table = drive(tmp_path, name, **keys)
    assert (table.argument.tolist(), table.value_unit.text) == (T.tolist(), "N")
    again = xd.Model.from_text(xd.Model.from_toml(tmp_path / "model.toml").to_toml())
    assert again.drives["pull"].table.argument.tolist() == T.tolist()


def test_compare_reads_them_too(tmp_path: Path) -> None:
    """Assert that measured data may be such a file."""
    FILES["d.mat"][0](tmp_path / "d.mat")
    free = xd.Model.from_text(MODEL.replace("[drives.pull]", "").replace("x =", "pull ="))
    run = xd.simulate(free, method="rk4", step="0.5 s", until="2 s")
    found = xd.compare(run, tmp_path / "d.mat", reading={"units": {"t": "s", "pull": "m"}})
    assert found.sizes["at"] == 3
    assert found.difference_pull.values.tolist() == PULL.tolist()


def bomb(path: Path) -> None:
    """Write a vector of 3e9 numbers that takes no room."""
    with netCDF4.Dataset(path, "w") as data:
        data.createDimension("n", 3_000_000_000)
        data.createVariable("time", "f8", ("n",), chunksizes=(1_000_000,))


@pytest.mark.parametrize(
    ("name", "write", "said"),
    [
        ("a.parquet", lambda path: path.write_bytes(b"PAR1 and no more"), "cannot be read: Parquet magic bytes"),
        ("a.nc", lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n and no more"), "cannot be read: .*HDF error"),
        ("a.mat", lambda path: path.write_bytes(b"nothing" * 99), "cannot be read: "),
        ("a.mat", lambda path: savemat(path, {"name": "bench"}), "it has no vectors of numbers"),
        ("a.h5", bomb, "it has 3000000000 rows and 1 columns, 2000000 and 256 at most"),
        ("a.nc", bomb, "it has 3000000000 rows"),
        ("a.mat", lambda path: savemat(path, BARE), "column 't': it has no unit"),
        ("a.nc", lambda path: xr.Dataset({"x": ("t", T)}).to_netcdf(path), "0 variables with units"),
        ("a.feather", lambda path: path.mkdir(), "is a directory|Is a directory|cannot be read"),
    ],
)
def test_what_is_no_table_is_refused(name: str, write: Callable[[Path], object], said: str, tmp_path: Path) -> None:
    """Assert one error that names the file and what is wrong with it."""
    write(tmp_path / name)
    with pytest.raises(xd.ModelError, match=said) as caught:
        drive(tmp_path, name)
    assert name in str(caught.value) or "column 't'" in str(caught.value)


def test_a_reader_that_crashes_or_lasts_is_no_end_of_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a process that is killed, and one that does not end, are told as what the file cannot be read for."""
    FILES["a.parquet"][0](tmp_path / "a.parquet")
    monkeypatch.setattr(file_access, "PATIENCE", 0.01)
    with pytest.raises(xd.ModelError, match=r"it was not read within 0\.01 s; save what is needed as CSV"):
        drive(tmp_path, "a.parquet")
    monkeypatch.undo()
    monkeypatch.setattr(file_access.sys, "executable", "/bin/false")
    with pytest.raises(xd.ModelError, match="takes too much time or memory, or it is damaged"):
        drive(tmp_path, "a.parquet")


def test_what_is_no_table_says_the_way(tmp_path: Path) -> None:
    """Assert the line to write for JSON and Zarr, and that units which arrays carry are taken."""
    measured = xr.Dataset({"F": ("t", [0.0, 5.0, 4.0], {"units": "N"})}, {"t": ("t", [0.0, 0.1, 1.0], {"units": "s"})})
    measured.to_zarr(tmp_path / "pull.zarr", zarr_format=2)
    (tmp_path / "pull.json").write_text('{"t [s]": [0, 1], "F [N]": [1, 2]}')
    for name, said in (
        ("pull.json", r'pandas.read_json\("pull.json"\)'),
        ("pull.zarr", r'xarray.open_zarr\("pull.zarr"\)'),
    ):
        with pytest.raises(xd.ModelError, match=said):
            pulled(table=str(tmp_path / name))
    pytest.importorskip("pint_xarray")
    import pint_xarray  # noqa: F401 - the accessor

    assert np.array_equal(
        xd.simulate(pulled(table=measured.pint.quantify()), method="rk4", step="10 ms", until="0.2 s").x,
        xd.simulate(pulled(table=measured), method="rk4", step="10 ms", until="0.2 s").x,
    )


def pulled(**drive: Any) -> xd.Model:
    """A block that a measured force pulls."""
    return xd.Model(
        name="pulled",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        drives={"F": drive},
        forces={"pull": {"x": "F"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
