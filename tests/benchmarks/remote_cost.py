"""Time to open a run of some hundred megabytes from a web server and read 100 rows, over that of plain xarray.

python tests/benchmarks/remote_cost.py [rows]
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from urllib.request import urlretrieve

import xarray as xr

import xdynamics as xd

sys.path.insert(0, str(Path(__file__).parents[1]))

from cases.web_server import web_server

MODEL = xd.Model.from_toml(Path(__file__).parents[2] / "data" / "models" / "harmonic_oscillator.toml")
PLACE = slice(500_000, 500_100)
TURNS = 5


def timed(read: Callable[[], Any]) -> float:
    """Seconds that a call takes."""
    begun = time.perf_counter()
    read()
    return time.perf_counter() - begun


def main() -> None:
    """Take both by turns for either format, and print the medians; no copy here is read twice."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 3_000_000
    with tempfile.TemporaryDirectory() as name, web_server(Path(name)) as server:
        folder = Path(name)
        run = xd.simulate(MODEL, method="rk4", step="10 ms", until=f"{rows / 100} s", path=folder / "run.zarr")
        size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
        address, ours, plain = f"{server.address}/run.zarr", [], []
        for _ in range(TURNS):
            ours.append(timed(lambda: xd.open_run(address).x[PLACE].values))
            plain.append(timed(lambda: xr.open_zarr(address, chunks=None).x[PLACE].values))
        print_ratio(f"Zarr, {size / 1e6:.0f} MB", ours, "xarray.open_zarr", plain)

        xd.save(run, folder / "0.nc")
        for turn in range(1, TURNS):
            (folder / f"{turn}.nc").hardlink_to(folder / "0.nc")
        addresses = [f"{server.address}/{turn}.nc" for turn in range(TURNS)]
        ours = [timed(partial(open_rows, address)) for address in addresses]
        plain = [timed(partial(download_rows, address)) for address in addresses]
        size = (folder / "0.nc").stat().st_size
        print_ratio(f"netCDF, {size / 1e6:.0f} MB", ours, "download and xarray.open_dataset", plain)


def open_rows(address: str) -> Any:
    """Open a run and read some rows."""
    return xd.open_run(address).x[PLACE].values


def download_rows(address: str) -> Any:
    """Download a file, open it and read some rows."""
    with tempfile.NamedTemporaryFile(suffix=".nc") as copy:
        urlretrieve(address, copy.name)
        with xr.open_dataset(copy.name, engine="netcdf4") as dataset:
            return dataset.x[PLACE].values


def print_ratio(what: str, ours: list[float], peer: str, theirs: list[float]) -> None:
    """Print medians and their ratio."""
    here, there = statistics.median(ours), statistics.median(theirs)
    print(
        f"{what}: open_run and 100 rows {here:.3f} s (the first {ours[0]:.2f} s), {peer} {there:.3f} s, ratio {here / there:.2f}"
    )


if __name__ == "__main__":
    main()
