"""Start-up, as ratios in one run: the package root, the help, a whole second run of the ball.

python tests/benchmarks/start.py
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

MODEL = Path(__file__).parents[2] / "data" / "models" / "ball_drag.toml"
ROUNDS = 7


def seconds(*command: str) -> float:
    """Time a process."""
    begin = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - begin


def main() -> None:
    """Print the table."""
    python = sys.executable
    program = str(Path(python).with_name("xdynamics"))
    with tempfile.TemporaryDirectory() as folder:
        run = [program, "run", str(MODEL), "-o", f"{folder}/ball.nc"]
        seconds(*run)  # compile
        rounds = [
            (
                seconds(python, "-c", "pass"),
                seconds(python, "-c", "import xdynamics"),
                seconds(python, "-c", "import click"),
                seconds(program, "--help"),
                seconds(python, "-c", "import xarray, netCDF4, numba"),
                seconds(*run),
            )
            for _ in range(ROUNDS)
        ]
    bare, root, click, shown, imports, ball = (median(column) for column in zip(*rounds, strict=True))
    print(f"median of {ROUNDS} rounds")
    print(f"  import xdynamics            {1e3 * (root - bare):6.0f} ms over bare Python's {1e3 * bare:.0f} ms")
    print(f"  xdynamics --help            {1e3 * shown:6.0f} ms, {shown / click:.2f} times click's bare start")
    print(
        f"  xdynamics run, second time  {1e3 * ball:6.0f} ms, {ball / imports:.2f} times importing xarray, netCDF4 and numba"
    )


if __name__ == "__main__":
    main()
