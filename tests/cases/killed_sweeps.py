"""Sweeps into a Zarr store that are killed at random moments, then ended: the bits and the digest of one that was not.

By hand: `python tests/cases/killed_sweeps.py 50`. What is killed is a copy of a process that has loaded everything but
started no thread.
"""

from __future__ import annotations

import os
import random
import signal
import sys
import tempfile
import time
import traceback
from importlib import import_module
from pathlib import Path

import dask

import xdynamics as xd
from cases.verdicts import verified
from xdynamics.archive.store import DIGESTS, NOTES

MODELS = Path(__file__).parents[2] / "data" / "models"
AXES = {"v_y": "10:30:6 m s-1", "vt": "20:60:4 m s-1"}


def swept(model: xd.Model, path: Path) -> None:
    """March the sweep, in blocks of two members, from where it was left."""
    with dask.config.set(scheduler="synchronous"):
        xd.sweep(model, AXES, keep=["end", "y"], times=[0.5], rtol=1e-6, until="2 s", path=path, members_per_task=2)


def forked(model: xd.Model, path: Path) -> int:
    """March in a copy of this process; return its number."""
    if number := os.fork():
        return number
    status = 1
    try:
        swept(model, path)
        status = 0
    except Exception:  # noqa: BLE001 - this process shall end here, whatever happens
        traceback.print_exc()
    finally:
        os._exit(status)


def ended(number: int) -> int:
    """Wait for a process; return how it ended."""
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


def blocks_in(path: Path) -> bool:
    """Whether a block is finished."""
    return any((path / NOTES / "unfinished").glob("*/*-*.nc"))


def attempt(model: xd.Model, path: Path, moments: random.Random, whole: float) -> tuple[int, int]:
    """Kill a sweep at any moment, then twice behind its first block; return how many kills met it, and a finished block."""
    kills, behind = 0, 0
    for waits in (False, True, True):
        number = forked(model, path)
        while waits and not blocks_in(path) and not (path / NOTES / DIGESTS).exists():
            time.sleep(0.001)
        time.sleep(moments.uniform(0.0, 0.5 * whole if waits else whole))
        os.kill(number, signal.SIGKILL)
        killed = ended(number) == -signal.SIGKILL
        kills += killed
        behind += killed and blocks_in(path)
    if ended(forked(model, path)) != 0:
        raise SystemExit("a sweep that was killed did not end")
    return kills, behind


def main(count: int) -> None:
    """Kill so many sweeps, and print what came of them."""
    for name in ("dask.array", "dask.delayed", "zarr", "xdynamics.sweeping.sweep"):
        import_module(name)
    model, moments = xd.Model.from_toml(MODELS / "ball_drag.toml"), random.Random(29)
    xd.simulate(model, method="dormand_prince", rtol=1e-6, until="1 s")  # compiles
    kills = behind = 0
    with tempfile.TemporaryDirectory(dir=os.environ.get("TMPDIR")) as folder:
        begun = time.monotonic()
        assert ended(forked(model, Path(folder) / "whole.zarr")) == 0
        took = time.monotonic() - begun
        for k in range(count):
            met = attempt(model, Path(folder) / f"{k}.zarr", moments, took)
            kills, behind = kills + met[0], behind + met[1]
        digests = [verified(Path(folder) / f"{name}.zarr") for name in ("whole", *range(count))]
        equal = digests.count(digests[0]) - 1
        for k in range(count):
            swept(model, Path(folder) / f"{k}.zarr")  # clears what one that was killed in the end has left
        notes = [Path(folder) / f"{k}.zarr" / NOTES for k in range(count)]
        left = {entry.name for note in notes for entry in note.iterdir()}
    print(f"{equal} of {count} equal, {kills} kills, {behind} behind a finished block, left {' '.join(sorted(left))}")


if __name__ == "__main__":
    main(int(sys.argv[1]))
