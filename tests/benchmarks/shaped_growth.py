"""What models with dimensions cost as they grow: building and compiling, a step, and the record of a run.

python tests/benchmarks/shaped_growth.py

Chains of springs and bodies that all attract each other. Building is reading, writing down and compiling a law that no
cache holds, without the march; a step is the longer of two runs less the shorter, for each coordinate. Then a record of 300
coordinates and 1,000 rows with all columns is saved, opened and verified. Times are of the processor, the least of some
rounds but for building, which is done once a process: each row is one of its own. Compiled code is kept in a new folder; or
in $XDYNAMICS_CACHE, which is to be a private one, as the laws in it are removed. Last, the largest memory of a process
that reads and marches a million sites, or cells of a rod, for a few steps, over that before, beside what the record and
its log hold: by logs, then by methods, and what a march is told to take.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from many_bodies import CHAIN, CLUSTER

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record.run_dataset import sizes_of_march

SIZES = {"chain": (10, 30, 100, 1000, 10_000), "bodies": (10, 30, 100, 300, 1000)}
STEPS = {"chain": 2_000_000, "bodies": 200_000}  # times coordinates, of the longer run
ROUNDS = 3
LOGS = ("states", "full")
MILLION = 1_000_000
# how a million sites are marched, or by methods for first-order states a million cells
MARCHES: dict[str, dict[str, object]] = {
    "velocity_verlet": {"step": 1e-3, "until": 3e-3},
    "rk4": {"step": 1e-3, "until": 3e-3},
    "dormand_prince": {"rtol": 1e-4, "until": 0.05},
    "dop853": {"rtol": 1e-6, "until": 0.05},
    "radau_iia": {"rtol": 1e-4, "until": 0.5},
    "radau_iia, atol given": {"rtol": 1e-4, "atol": 1e-6, "until": 0.5},
}
ROD = """
name = "rod"
[dimensions]
cell = {n}
[states.T]
unit = "K"
dims = ["cell"]
rate = "(shift(T, cell, -1, 0*kelvin) - 2*T + shift(T, cell, 1, 0*kelvin))/second"
[initial]
T = "kelvin*sin(pi*(index(cell) + 1)/(size(cell) + 1))"
"""


def text_of(kind: str, n: int) -> str:
    """Return a model as text."""
    if kind == "chain":
        return CHAIN.format(n=n)
    return CLUSTER.format(n=n, start=(np.random.default_rng(n).uniform(-1.0, 1.0, (n, 3)) * n).tolist())


def least(call: Callable[[], object]) -> float:
    """Return the least processor time of some calls."""
    found = np.inf
    for _ in range(ROUNDS):
        begin = time.process_time()
        call()
        found = min(found, time.process_time() - begin)
    return found


def measured(kind: str, n: int) -> dict[str, float]:
    """Measure in this process."""
    text, width = text_of(kind, n), n if kind == "chain" else 3 * n
    xd.simulate(xd.Model.from_text(text_of("chain", 3)), method="velocity_verlet", step=1e-3, until=1e-3)  # imports
    begin = time.process_time()
    model = xd.Model.from_text(text)

    def run(steps: int) -> object:
        return xd.simulate(
            model,
            method="velocity_verlet",
            step=1e-3,
            until=steps * 1e-3,
            log="states",
            keep_every=steps,
            estimator="none",
            force_samples="none",
        )

    run(1)
    built = time.process_time() - begin
    again = least(lambda: run(1))
    many = max(20, STEPS[kind] // width)
    return {"built": built - again, "again": again, "step": (least(lambda: run(many)) - again) / (many - 1) / width}


def in_a_process(kind: str, n: int) -> dict[str, float]:
    """Measure in a process of its own, which finds no law."""
    from first_run import remove_laws

    remove_laws()
    words = [sys.executable, str(Path(__file__).resolve()), "--as-row", kind, str(n)]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def memory(columns: str) -> dict[str, float]:
    """Return the megabytes that a million sites take in this process, of its record, and of the log in that."""
    xd.simulate(xd.Model.from_text(CHAIN.format(n=1000)), method="velocity_verlet", step=1e-3, until=3e-3)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    model = xd.Model.from_text(CHAIN.format(n=1_000_000))
    run = xd.simulate(model, method="velocity_verlet", step=1e-3, until=3e-3, log=columns, estimator="none")
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before
    log = sum(values.nbytes for values in run.variables.values() if "step" in values.dims)
    return {"taken": taken, "record": run.nbytes / 2**20, "log": log / 2**20}


def memory_by(marched: str) -> dict[str, float]:
    """Return the megabytes that a million elements take by a method, of the record, and what is told of the march."""
    method, text = marched.partition(",")[0], ROD if marched.startswith("radau") else CHAIN
    settings: dict[str, Any] = {"method": method, "log": "states"} | MARCHES[marched]
    xd.simulate(xd.Model.from_text(text.format(n=1000)), **settings)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    model = xd.Model.from_text(text.format(n=MILLION))
    told = sum(sizes_of_march(March(model, settings_for(model, **settings))).values())
    run = xd.simulate(model, **settings)
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024 - before
    return {"taken": taken, "record": run.nbytes / 2**20, "told": told / 2**20}


def record() -> None:
    """Print what saving, opening and verifying takes."""
    model = xd.Model.from_text(CHAIN.format(n=300))
    run = xd.simulate(model, method="velocity_verlet", step=1e-3, until=0.999, log="full", force_samples="none")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.nc"
        verbs: dict[str, Callable[[], object]] = {
            "save": lambda: xd.save(run, path),
            "open": lambda: xd.open_run(path).close(),
            "verify": lambda: xd.verify(path),
        }
        times = ", ".join(f"{name} {least(call):.3f} s" for name, call in verbs.items())
        print(f"300 coordinates, {run.sizes['step']} rows: {times}, {path.stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """Print the tables."""
    if sys.argv[1:2] == ["--as-row"]:
        asked = sys.argv[2]
        measure = memory if asked in LOGS else memory_by if asked in MARCHES else partial(measured, n=int(sys.argv[3]))
        print(json.dumps(measure(asked)))
        return
    record()
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("XDYNAMICS_CACHE", folder)
        for kind, sizes in SIZES.items():
            print(f"{kind:>8}{'built in':>12}{'a run again':>14}{'a step and coordinate':>26}")
            for n in sizes:
                one = in_a_process(kind, n)
                row = f"{n:8}{one['built']:10.3f} s{one['again']:12.4f} s{1e9 * one['step']:23.2f} ns"
                print(row, flush=True)
        for columns in LOGS:
            one = in_a_process(columns, 0)
            print(
                f"10^6 sites, log = {columns!r}: {one['taken']:.0f} MB, of which the record {one['record']:.0f} and in it"
                f" the log {one['log']:.0f}"
            )
        for marched in MARCHES:
            one = in_a_process(marched, 0)
            print(
                f"10^6 elements by {marched}: {one['taken'] - one['record']:.0f} MB over the record of {one['record']:.0f};"
                f" about {one['told']:.0f} were told before the run"
            )


if __name__ == "__main__":
    main()
