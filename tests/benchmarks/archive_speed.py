"""Streaming speed and memory: a long march to disk against netCDF4 writing the same bytes, in turn.

    python tests/benchmarks/archive_speed.py [steps] [folder]

Each is a process of its own, so that peak memory is its own; both end with the file synced to the disk.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

MODEL = Path(__file__).parents[2] / "data" / "models" / "harmonic_oscillator.toml"

OURS = """
import resource, sys, time
import xdynamics as xd
model = xd.Model.from_toml(sys.argv[1])
xd.simulate(model, step=1e-3, until=0.1, force_samples="none")
begin = time.perf_counter()
xd.simulate(model, step=1e-3, until=int(sys.argv[2]) * 1e-3, force_samples="none", path=sys.argv[3])
print(time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""
PLAIN = """
import os, resource, sys, time
import netCDF4, numpy as np
steps, block = int(sys.argv[2]) + 1, 131072
floats, bytes_ = [np.random.default_rng(i).random(block) for i in range(10)], np.zeros(block, np.int8)
begin = time.perf_counter()
with netCDF4.Dataset(sys.argv[3], "w") as file:
    file.createDimension("step", None)
    names = [(f"f{i}", "f8", floats[i]) for i in range(10)] + [(f"b{i}", "i1", bytes_) for i in range(2)]
    variables = [(file.createVariable(name, kind, ("step",), chunksizes=(block,), fill_value=False), values) for name, kind, values in names]
    for start in range(0, steps, block):
        n = min(block, steps - start)
        for variable, values in variables:
            variable[start : start + n] = values[:n]
handle = os.open(sys.argv[3], os.O_RDONLY)
os.fsync(handle)
print(time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def measured(script: str, steps: int, path: Path) -> tuple[float, float, float]:
    """Run one of the two; return seconds, peak MiB, file MiB."""
    path.unlink(missing_ok=True)
    done = subprocess.run(
        [sys.executable, "-c", script, str(MODEL), str(steps), str(path)], capture_output=True, text=True, check=True
    )
    seconds, peak = map(float, done.stdout.split())
    return seconds, peak / 1024, path.stat().st_size / 2**20


def main() -> None:
    """Print the table."""
    steps = int(float(sys.argv[1])) if len(sys.argv) > 1 else 10**8
    with tempfile.TemporaryDirectory(dir=sys.argv[2] if len(sys.argv) > 2 else None) as folder:
        for turn in range(2):
            plain = measured(PLAIN, steps, Path(folder) / "plain.nc")
            ours = measured(OURS, steps, Path(folder) / "run.nc")
            print(f"turn {turn + 1}: {steps:.0e} steps, {ours[2]:.0f} MiB")
            print(f"  plain netCDF4   {plain[2] / plain[0]:7.0f} MiB/s, peak memory {plain[1]:5.0f} MiB")
            print(f"  xdynamics       {ours[2] / ours[0]:7.0f} MiB/s, peak memory {ours[1]:5.0f} MiB")
            print(f"  rate, of plain  {ours[2] / ours[0] / (plain[2] / plain[0]):7.2f}")


if __name__ == "__main__":
    main()
