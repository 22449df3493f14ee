"""Sweeps on a cluster of processes, and sweeps whose processes are killed: the same bits, nothing lost, nothing twice."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS

AXES: dict[str, Any] = {"v_y": "10:30:40 m s-1", "vt": "20:60:5 m s-1", "method": ["heun", "dop853"]}
ASKED: dict[str, Any] = {"keep": ["end", "event_time_ground", "y"], "times": [0.5, 1.0], "rtol": 1e-6, "until": "6 s"}
PROGRAM = """
import sys, xdynamics as xd
model = xd.Model.from_toml(sys.argv[1])
xd.sweep(model, {axes!r}, path=sys.argv[2], members_per_task=4, **{asked!r})
"""


@pytest.fixture(scope="module")
def here() -> xr.Dataset:
    """The sweep in this process."""
    return xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, **ASKED).compute(scheduler="synchronous")


def assert_same(found: xr.Dataset, expected: xr.Dataset) -> None:
    """Assert every variable that was kept, bit for bit; texts by their letters."""
    for name, one in expected.data_vars.items():
        mine = found[name].values
        if one.dtype.kind in "UO":
            assert mine.astype(str).tolist() == one.values.astype(str).tolist(), name
        else:
            assert mine.tobytes() == one.values.tobytes(), name


def test_two_processes_give_the_same_bits(here: xr.Dataset, tmp_path: Path) -> None:
    """Assert a lazy sweep, and one into a folder, on a cluster of two workers."""
    distributed = pytest.importorskip("distributed")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of a dashboard's port
        cluster = distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0")
        with cluster, distributed.Client(cluster):
            model = xd.Model.from_toml(MODELS / "ball_drag.toml")
            assert_same(xd.sweep(model, AXES, members_per_task=20, **ASKED).compute(), here)
            assert_same(xd.sweep(model, AXES, members_per_task=20, path=tmp_path / "s", **ASKED), here)


def test_a_killed_sweep_goes_on(here: xr.Dataset, tmp_path: Path) -> None:
    """Assert that kill -9 at random moments loses no finished block, and that the catalogue is that of a run without."""
    program = PROGRAM.format(axes=AXES, asked=ASKED)
    kills(program, tmp_path / "s", random.Random(0), most=3)
    found = xd.open_sweep(tmp_path / "s")
    assert_same(found, here)
    digests = found.run_digest.values.astype(str).ravel()
    assert len(np.unique(digests)) == digests.size
    assert [one.name for one in (tmp_path / "s").iterdir()] == ["catalogue.nc"]


def kills(program: str, folder: Path, chance: random.Random, *, most: int) -> int:
    """Kill a sweep at random moments from its first block on, then let it end; return how often it was killed."""
    killed = 0
    for _ in range(most):
        process = subprocess.Popen([sys.executable, "-c", program, str(MODELS / "ball_drag.toml"), str(folder)])
        while process.poll() is None and not list(folder.glob(".unfinished/*/*.nc")):
            time.sleep(0.01)
        time.sleep(chance.random() * 1.5)
        if process.poll() is None:
            process.send_signal(signal.SIGKILL)
            killed += 1
        process.wait()
    subprocess.run(
        [sys.executable, "-c", program, str(MODELS / "ball_drag.toml"), str(folder)], check=True, timeout=300
    )
    return killed


if __name__ == "__main__":
    import tempfile

    found = 0
    while found < 20:
        with tempfile.TemporaryDirectory() as name:
            found += kills(PROGRAM.format(axes=AXES, asked=ASKED), Path(name) / "s", random.Random(found), most=5)
            whole = xd.sweep(xd.Model.from_toml(MODELS / "ball_drag.toml"), AXES, **ASKED).compute()
            assert_same(xd.open_sweep(Path(name) / "s"), whole)
    print(f"{found} of {found} kills survived")
