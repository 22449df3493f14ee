"""March speed, as ratios in one run: hand-written C with the same steps and columns; scipy at equal work.

python tests/benchmarks/march_speed.py [steps]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import numpy as np
import scipy
from scipy.integrate import solve_ivp

import xdynamics as xd

HERE = Path(__file__).parent
MODEL = HERE.parents[1] / "data" / "models" / "harmonic_oscillator.toml"
OBSERVABLE = 'phase = "atan2(-v_x*sqrt(m/k), x)"\n'
ROUNDS = 7


def compiled_c(folder: Path) -> Path:
    """Compile the C program as one would for speed, with IEEE arithmetic."""
    program = folder / "oscillator"
    subprocess.run(
        ["cc", "-O3", "-march=native", "-ffp-contract=off", HERE / "oscillator.c", "-o", program, "-lm"], check=True
    )
    return program


def c_seconds(program: Path, steps: int) -> tuple[float, float]:
    """March in C; return seconds and the last position."""
    seconds, last = subprocess.run([program, str(steps)], capture_output=True, text=True, check=True).stdout.split()
    return float(seconds), float(last)


def our_seconds(model: xd.Model, steps: int, samples: str) -> tuple[float, float]:
    """March with the state log in memory; return seconds and the last position."""
    begin = time.perf_counter()
    run = xd.simulate(model, step=1e-3, until=steps * 1e-3, force_samples=samples)
    seconds = time.perf_counter() - begin
    return seconds, float(run.x[-1])


def scipy_rate(evaluations: int) -> float:
    """Force evaluations a second of solve_ivp, each step kept, from a run of about that many."""

    def rates(_t: float, s: np.ndarray) -> list[float]:
        return [s[1], -4.0 * s[0]]

    begin = time.perf_counter()
    found = solve_ivp(
        rates, (0, evaluations * 1e-3 / 6), [1.0, 0.0], method="RK45", max_step=1e-3, rtol=1e-3, atol=1e-3
    )
    return found.nfev / (time.perf_counter() - begin)


def paired(first: Callable[[], float], second: Callable[[], float]) -> tuple[list[float], list[float]]:
    """Time two things in turn."""
    pairs = [(first(), second()) for _ in range(ROUNDS)]
    return [one for one, _ in pairs], [other for _, other in pairs]


def main() -> None:
    """Print the table."""
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 10**7
    model = xd.Model.from_text(MODEL.read_text().replace(OBSERVABLE, ""))  # the state log alone
    for samples in ("none", "all"):
        our_seconds(model, 1000, samples)  # compile
    with tempfile.TemporaryDirectory() as folder:
        program = compiled_c(Path(folder))
        assert c_seconds(program, 1000)[1] == our_seconds(model, 1000, "none")[1], "C and xdynamics part"
        ours, theirs = paired(lambda: our_seconds(model, steps, "none")[0], lambda: c_seconds(program, steps)[0])
    ratios = [a / b for a, b in zip(ours, theirs, strict=True)]
    print(
        f"velocity Verlet, {steps:.0e} steps, state log of 9 float and 2 byte columns in memory; median of {ROUNDS} pairs"
    )
    print(f"  xdynamics          {median(ours) / steps * 1e9:8.1f} ns a step")
    print(f"  C, -O3             {median(theirs) / steps * 1e9:8.1f} ns a step")
    print(f"  xdynamics / C      {median(ratios):8.2f}   ({min(ratios):.2f} to {max(ratios):.2f})")
    sampled = our_seconds(model, steps, "all")[0]
    print(f"  with force samples {sampled / steps * 1e9:8.1f} ns a step")
    rate = scipy_rate(200_000)
    print(f"scipy {scipy.__version__} solve_ivp RK45, every step kept: {1e9 / rate:.0f} ns a force evaluation")
    print(f"  times slower than xdynamics at equal force evaluations: {1 / rate / (median(ours) / steps):.0f}")


if __name__ == "__main__":
    main()
