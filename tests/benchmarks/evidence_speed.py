"""How long evidence takes: refinements of a ball by every method, samples beside numpy.interp, the whole ledger.

python tests/benchmarks/evidence_speed.py [rows]

The samples are of an oscillator with so many rows, 10^7 unless told otherwise.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np

import xdynamics as xd

MODELS = Path(__file__).parents[2] / "data" / "models"
ROWS, TIMES = 10_000_000, 1_000_000


def seconds(work: Callable[[], object]) -> float:
    """Time one call; the call before it has compiled."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def main(rows: int) -> None:
    """Print seconds, and ratios to numpy in the same run."""
    warnings.simplefilter("ignore")
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    free = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"y": "0 m", "v_y": "20 m s-1"},
        events={"apex": {"function": "v_y"}, "ground": {"function": "y", "direction": "falling", "action": "stop"}},
        run={"until": "5 s"},
    )
    steps = [0.1 / 2**k for k in range(8)]
    for model in (ball, free):
        methods = [name for name, method in xd.METHODS.items() if not method.refusals(model)]
        for once in (True, False):
            spent = seconds(
                lambda methods=methods, model=model: [
                    xd.refine(model, method=method, steps=steps) for method in methods
                ]
            )  # type: ignore[misc]
            if not once:
                print(f"refine {model.name!r}: {len(methods)} methods x {len(steps)} levels in {spent:.2f} s")
    xd.validate()
    print(f"validate: {xd.validate().sizes['case']} cases in {seconds(xd.validate):.2f} s")
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    run = xd.simulate(oscillator, method="velocity_verlet", step=10.0 / rows, until=10.0, force_samples="none")
    t, x, wanted = run["time"].values, run["x"].values, np.random.default_rng(1).uniform(0.0, 10.0, TIMES)
    for name, times in (("random", wanted), ("ascending", np.sort(wanted))):
        line, step = (
            seconds(lambda times=times: np.interp(times, t, x)),
            seconds(lambda times=times: xd.sample(run, times)),
        )  # type: ignore[misc]
        print(
            f"sample {len(t)} rows at {TIMES} {name} times: {step:.2f} s, with errors; numpy.interp of one column {line:.2f} s, ratio {line / step:.2f}"
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else ROWS)
