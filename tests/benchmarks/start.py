"""What a user waits for: start-up, each verb of the command line, and small calls again, in one run.

python tests/benchmarks/start.py

Processes are told in ms and as ratios to importing what they cannot do without, small calls in ms and as ratios to scipy's
`solve_ivp` of the same problem.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from math import inf
from pathlib import Path
from statistics import median
from typing import Any

from scipy.integrate import solve_ivp

import xdynamics as xd

MODEL = Path(__file__).parents[2] / "data" / "models" / "ball_drag.toml"
OSCILLATOR = """
name = "oscillator"
[coordinates]
x = "m"
[parameters]
k = "4 N m-1 ± 0.1 N m-1"
[mass]
x = "1*kilogram"
[forces.spring]
x = "-k*x"
[initial]
x = "1 m"
v_x = "0 m s-1"
"""
ROUNDS = 7
CALLS = 200


def seconds(*command: str) -> float:
    """Time a process."""
    begin = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - begin


def least_of_many(call: Callable[[], object]) -> float:
    """Return the least wall-clock time of many calls, s."""
    best = inf
    for _ in range(CALLS):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return best


def processes() -> None:
    """Print what processes take: the root, the help, and each verb on a small archive."""
    python = sys.executable
    program = str(Path(python).with_name("xdynamics"))
    with tempfile.TemporaryDirectory() as folder:
        archive = f"{folder}/ball.nc"
        verbs = {
            "run, second time": ["run", str(MODEL), "-o", archive],
            "check": ["check", str(MODEL)],
            "show": ["show", archive],
            "table": ["table", archive],
            "diagnose": ["diagnose", archive],
            "reproduce": ["reproduce", archive],
            "compare": ["compare", archive, archive],
            "plot": ["plot", archive, "-o", f"{folder}/ball.png"],
        }
        timed = {
            "bare Python": [python, "-c", "pass"],
            "import click": [python, "-c", "import click"],
            "import xarray, netCDF4": [python, "-c", "import xarray, netCDF4"],
            "import xdynamics": [python, "-c", "import xdynamics"],
            "xdynamics --help": [program, "--help"],
        } | {f"xdynamics {name}": [program, *words] for name, words in verbs.items()}
        for command in timed.values():  # compile, and fill the caches of files
            seconds(*command)
        rounds = [[seconds(*command) for command in timed.values()] for _ in range(ROUNDS)]
    took = dict(zip(timed, (median(column) for column in zip(*rounds, strict=True)), strict=True))
    print(f"median of {ROUNDS} rounds")
    for name, length in took.items():
        print(f"  {name:28}{1e3 * length:6.0f} ms, {length / took['import xarray, netCDF4']:.2f} x xarray and netCDF4")


def small_calls() -> None:
    """Print what a small job takes when it is asked for again, beside scipy."""
    model = xd.Model.from_text(OSCILLATOR)
    given: dict[str, Any] = {"method": "dormand_prince", "until": "1 s", "rtol": 1e-6}
    xd.simulate(model, **given)
    ours = least_of_many(lambda: xd.simulate(model, **given))
    solved = least_of_many(lambda: xd.solve(lambda _t, y: [y[1], -4.0 * y[0]], (0.0, 1.0), [1.0, 0.0], rtol=1e-6))
    theirs = least_of_many(lambda: solve_ivp(lambda _t, y: [y[1], -4.0 * y[0]], (0.0, 1.0), [1.0, 0.0], rtol=1e-6))
    print(f"least of {CALLS} calls, an oscillator for 1 s")
    for name, length in (("simulate again", ours), ("solve again", solved), ("scipy's solve_ivp", theirs)):
        print(f"  {name:28}{1e3 * length:6.2f} ms, {length / theirs:.2f} x scipy")


if __name__ == "__main__":
    processes()
    small_calls()
