"""A sweep of many members in a folder beside the same one in memory: processor time, and memory at its peak, of processes of their own.

python tests/benchmarks/catalogue_speed.py [members]
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from lanes_speed import DUFFING, model_of

import xdynamics as xd

ASKED: dict[str, Any] = {"method": "dop853", "rtol": 1e-6, "atol": 1e-6, "until": 5.0}
MEGABYTE = 1_000_000


def measured(members: int, place: str) -> None:
    """March, and print processor time, peak and what the Dataset holds."""
    model, stiffness = model_of(DUFFING), 8.192 * np.arange(members) / members
    xd.sweep(model, {"k": stiffness[:64]}, **ASKED).compute()  # compiled, and loaded
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        if place == "folder":
            found = xd.sweep(model, {"k": stiffness}, path=Path(folder) / "s", **ASKED)
        else:
            found = xd.sweep(model, {"k": stiffness}, **ASKED).compute()
        taken, peak = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
        sizes = [entry.stat().st_size for entry in Path(folder).rglob("*") if entry.is_file()]
        print(
            f"  {place:<8}{taken:>8.2f} s{taken / members * 1e6:>8.2f} us a member{peak / MEGABYTE:>8.0f} MB at most for {found.nbytes / MEGABYTE:.0f} MB",
            f"({sum(sizes) / MEGABYTE:.0f} MB of files)" if sizes else "",
        )
        found.close()


def main(members: int = 1_000_000) -> None:
    """Measure both."""
    print(f"{members} members")
    for place in ("memory", "folder"):
        subprocess.run(
            [sys.executable, __file__, str(members), place], check=True, env=os.environ | {"PYTHONWARNINGS": "ignore"}
        )


if __name__ == "__main__":
    measured(int(sys.argv[1]), sys.argv[2]) if len(sys.argv) > 2 else main(*map(int, sys.argv[1:]))
