"""Time to open a run of some hundred megabytes from a web server and read 100 rows, over that of plain xarray.

python tests/benchmarks/remote_cost.py [rows]
"""

from __future__ import annotations

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import xarray as xr

import xdynamics as xd

sys.path.insert(0, str(Path(__file__).parents[1]))

from cases.web_server import web_server

MODEL = xd.Model.from_toml(Path(__file__).parents[2] / "data" / "models" / "harmonic_oscillator.toml")
PLACE = slice(500_000, 500_100)


def timed(read: Callable[[], Any]) -> float:
    """Seconds that a call takes."""
    begun = time.perf_counter()
    read()
    return time.perf_counter() - begun


def main() -> None:
    """Take both by turns, and print the medians."""
    rows = int(sys.argv[1]) if len(sys.argv) > 1 else 3_000_000
    with tempfile.TemporaryDirectory() as folder, web_server(Path(folder)) as server:
        xd.simulate(MODEL, method="rk4", step="10 ms", until=f"{rows / 100} s", path=Path(folder) / "run.zarr")
        size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
        address, ours, plain = f"{server.address}/run.zarr", [], []
        for _ in range(5):
            ours.append(timed(lambda: xd.open_run(address).x[PLACE].values))
            plain.append(timed(lambda: xr.open_zarr(address, chunks=None).x[PLACE].values))
    here, there = statistics.median(ours), statistics.median(plain)
    print(
        f"{size / 1e6:.0f} MB: open_run and 100 rows {here:.3f} s, xarray.open_zarr {there:.3f} s, ratio {here / there:.2f}"
    )


if __name__ == "__main__":
    main()
