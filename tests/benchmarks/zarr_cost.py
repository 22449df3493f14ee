"""CPU time of a sweep of a million members into a Zarr store, over that of the same sweep in memory.

python tests/benchmarks/zarr_cost.py [members]
"""

from __future__ import annotations

import resource
import statistics
import sys
import tempfile
from pathlib import Path

import dask

import xdynamics as xd

MODEL = xd.Model.from_toml(Path(__file__).parents[2] / "data" / "models" / "harmonic_oscillator.toml")
KEEP = {"keep": ["end", "x", "v_x"], "times": [0.25, 0.5]}  # ten numbers with time, counts and state at the end


def cpu() -> float:
    """Processor time of this process so far, s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Take both by turns, and print the median of the ratios."""
    members = int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000
    asked = {"axes": {"k": f"1:2:{members} N m-1"}, "method": "rk4", "step": "20 ms", "until": "1 s", **KEEP}
    xd.sweep(MODEL, **(asked | {"axes": {"k": "1:2:1000 N m-1"}})).compute()
    ratios = []
    with dask.config.set(scheduler="threads", num_workers=2):
        for turn in range(3):
            begin = cpu()
            xd.sweep(MODEL, **asked).compute()
            between = cpu()
            with tempfile.TemporaryDirectory() as folder:
                xd.sweep(MODEL, **asked, path=Path(folder) / "grid.zarr")
                end = cpu()
            ratios.append((end - between) / (between - begin))
            print(f"{turn}: {between - begin:.2f} s in memory, {end - between:.2f} s into a store: {ratios[-1]:.3f}")
    print(f"median {statistics.median(ratios):.3f}")


if __name__ == "__main__":
    main()
