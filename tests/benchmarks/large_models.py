"""What a model costs as it grows: the first run of a chain of N masses, its memory, and the time of a step.

python tests/benchmarks/large_models.py [folder]

Compiled code is kept in the folder, which is to be a private one; without it in a new one, and the engine is compiled
there first. Every row is a process of its own that finds no law in the folder: seconds from before its imports to its
first record, of them those of the model, and the largest memory it held then. Then steps by themselves: two lengths of
run without force samples, the longer less the shorter, for each step and coordinate; the least of some rounds.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

SIZES = (1, 3, 10, 30, 100, 300, 1000)
METHODS = ("velocity_verlet", "dop853")
COORDINATE_STEPS = {"velocity_verlet": 2_000_000, "dop853": 400_000}  # of the longer run
STEP, ROUNDS = 0.05, 5
ENVIRONMENT = "XDYNAMICS_CACHE"


def measured(n: int, method: str) -> dict[str, Any]:
    """Run the chain in this process, for the first time and again."""
    begin = time.perf_counter()
    from large_problems import chain

    import xdynamics as xd

    model = chain(n)
    stated = time.perf_counter()
    xd.simulate(model, method=method, step=STEP, until=20 * STEP)
    first = time.perf_counter()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024

    def seconds(steps: int) -> float:
        start = time.perf_counter()
        xd.simulate(model, method=method, step=STEP, until=steps * STEP, estimator="none", force_samples="none")
        return time.perf_counter() - start

    many = max(200, COORDINATE_STEPS[method] // n)
    few = many // 10
    seconds(few)
    least = [min(seconds(steps) for _ in range(ROUNDS)) for steps in (few, many)]
    return {
        "model": stated - begin,
        "first": first - begin,
        "memory": memory,
        "step": (least[1] - least[0]) / (many - few) / n,
    }


def in_a_process(n: int, method: str) -> dict[str, Any]:
    """Measure in a process of its own, which finds no law."""
    from first_run import remove_laws

    remove_laws()
    words = [sys.executable, str(Path(__file__).resolve()), "--as-row", str(n), method]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def main() -> None:
    """Print the table."""
    if sys.argv[1:2] == ["--as-row"]:
        print(json.dumps(measured(int(sys.argv[2]), sys.argv[3])))
        return
    with tempfile.TemporaryDirectory() as folder:
        os.environ[ENVIRONMENT] = sys.argv[1] if len(sys.argv) > 1 else folder
        in_a_process(1, "dop853")  # compiles the engine where it is not at hand
        print(f"{'masses':>6} {'':16} {'model':>8} {'first run':>11} {'memory':>9} {'a step and coordinate':>24}")
        for method in METHODS:
            for n in SIZES:
                one = in_a_process(n, method)
                print(
                    f"{n:6} {method:16} {one['model']:6.2f} s {one['first']:9.2f} s {one['memory']:6.0f} MB"
                    f" {1e9 * one['step']:21.1f} ns",
                    flush=True,
                )


if __name__ == "__main__":
    main()
