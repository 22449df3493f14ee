"""What looking for events costs where none happens: a march with one and ten armed detectors over one without.

python tests/benchmarks/event_speed.py
"""

from __future__ import annotations

import sys
import time
import tomllib
from pathlib import Path

import xdynamics as xd

MODEL = Path(__file__).parents[2] / "data" / "models" / "double_pendulum.toml"
FUNCTIONS = {"an angle": "th1 - 100*radian", "sine times cosine": "(sin(th1)*cos(th2) - 3)*radian"}
ASKED = {"method": "dormand_prince", "rtol": 1e-8, "until": 400.0, "force_samples": "none"}


def armed(function: str, count: int) -> xd.Model:
    """The double pendulum with detectors that nothing reaches."""
    statement = tomllib.loads(xd.Model.from_toml(MODEL).to_toml())
    statement["events"] = {f"e{i}": {"function": f"{function} - {i}*radian"} for i in range(count)}
    return xd.Model(**statement)


def spent(model: xd.Model, times: int = 40) -> float:
    """Seconds of the quickest of some runs."""
    found = []
    for _ in range(times):
        begin = time.perf_counter()
        run = xd.simulate(model, **ASKED)
        found.append(time.perf_counter() - begin)
    assert run.sizes["event"] == 0
    return min(found)


def main() -> None:
    """Print the ratios."""
    for words, function in FUNCTIONS.items():
        alone = spent(armed(function, 0))
        ratios = ", ".join(f"{count} armed {spent(armed(function, count)) / alone:.2f}" for count in (1, 10))
        print(f"{words}: without {alone:.4f} s; times as long with {ratios}")


if __name__ == "__main__":
    sys.exit(main())
