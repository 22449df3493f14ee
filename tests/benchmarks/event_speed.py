"""What looking for events costs: marches beside each other in one run, without their records.

    python tests/benchmarks/event_speed.py

Where nothing happens, a step with one and ten armed detectors over one without; where they fire, substeps an event with
one to forty detectors in a step; impacts a second of rows of balls.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import xdynamics as xd
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

MODEL = Path(__file__).parents[2] / "data" / "models" / "double_pendulum.toml"
FUNCTIONS = {"a position": "x - {0}*metre", "a sine": "(sin(x/(1*metre)) - {0})*metre"}
STEPS: dict[str, dict[str, Any]] = {
    "dop853": {"method": "dop853", "rtol": 1e-8, "until": 20_000.0},
    "rk4": {"method": "rk4", "step": 0.05, "until": 10_000.0},
}
COUNTS = 0, 1, 10
TIMES = 5


def oscillator(function: str = "", levels: Any = ()) -> xd.Model:
    """A mass on a spring with detectors at some levels."""
    return xd.Model(
        name="oscillator",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={f"e{i}": {"function": function.format(float(level))} for i, level in enumerate(levels)},
    )


def row_of_balls(count: int) -> xd.Model:
    """Balls on a line between two walls, elastic, each with a velocity of its own."""
    names = [f"q{i}" for i in range(count)]
    speeds = np.random.default_rng(3).uniform(-2, 2, count)
    contacts = {
        "left": {"gap": "q0", "restitution": 1},
        "right": {"gap": f"{count}*metre - q{count - 1}", "restitution": 1},
    }
    contacts |= {f"c{i}": {"gap": f"q{i + 1} - q{i} - 0.1*metre", "restitution": 1} for i in range(count - 1)}
    return xd.Model(
        name="row",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg"},
        mass=dict.fromkeys(names, "m"),
        forces={},
        initial={f"q{i}": f"{i + 0.5} m" for i in range(count)}
        | {f"v_q{i}": f"{float(v)!r} m s-1" for i, v in enumerate(speeds)},
        contacts=contacts,
    )


def marched(model: xd.Model, **asked: Any) -> float:
    """Seconds of the processor that a march takes, its record not made: other work on the machine counts for nothing."""
    march = March(model, settings_for(model, **asked, force_samples="none"))
    begin = time.process_time()
    for _ in march.blocks():
        pass
    return time.process_time() - begin


def quickest(marches: dict[Any, Callable[[], float]]) -> dict[Any, float]:
    """Seconds of the quickest of some runs of each, in turns."""
    found: dict[Any, float] = {}
    for _ in range(TIMES):
        for name, march in marches.items():
            found[name] = min(found.get(name, np.inf), march())
    return found


def quiet_steps() -> None:
    """Print what a detector costs that nothing reaches."""
    for name, asked in STEPS.items():
        for words, function in FUNCTIONS.items():
            models = {count: oscillator(function, 1.5 + np.arange(count)) for count in COUNTS}
            runs = {count: xd.simulate(model, **asked, force_samples="none") for count, model in models.items()}
            assert all(run.sizes["event"] == 0 for run in runs.values())
            steps = runs[0].sizes["step"]
            marches = {count: partial(marched, model, **asked) for count, model in models.items()}
            spent = quickest(marches)
            own = [(spent[count] - spent[0]) / steps * 1e9 for count in COUNTS]
            print(
                f"{name}, {words}: {spent[0] / steps * 1e9:.0f} ns a step without; one detector {own[1]:+.1f} ns"
                f" ({100 * (spent[1] / spent[0] - 1):+.0f} %), ten {own[2]:+.1f} ns ({100 * (spent[10] / spent[0] - 1):+.0f} %)"
            )


def substeps() -> None:
    """Print how many substeps an event costs, beside how many others in its step."""
    for count in (1, 2, 10, 40):
        model = oscillator(FUNCTIONS["a position"], 0.1 + 0.01 * np.arange(count))
        said = []
        for rule in ("earliest first", "one by one"):
            run = xd.simulate(model, method="dop853", rtol=1e-8, atol=1e-8, until=300.0, event_root_method=rule)
            said.append(
                f"{rule} {run.event_substeps.values.mean():.1f} ({run.sizes['trial'] / run.sizes['event']:.1f} trial rows)"
            )
        print(f"{count} detectors within a step: substeps an event, {'; '.join(said)}")


def impacts() -> None:
    """Print how many impacts a second rows of balls have."""
    for count in (5, 20):
        model = row_of_balls(count)
        asked = {"method": "dop853", "rtol": 1e-8, "until": 2000.0 / count}
        run = xd.simulate(model, **asked)
        spent = quickest({0: partial(marched, model, **asked)})[0]
        print(
            f"{count} balls: {run.sizes['event']} impacts, {run.sizes['event'] / spent:.0f} a second; {run.attrs['run_outcome']}"
        )


def main() -> None:
    """Print the ratios."""
    substeps()
    quiet_steps()
    impacts()


if __name__ == "__main__":
    sys.exit(main())
