"""What members of a sweep cost, over those of which the end alone is kept: CPU time, best of some, interleaved.

The others keep extremes or states at times, have drives of many points, events or contacts, or solve equations.

python tests/benchmarks/sweep_speed.py [members]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from lanes_speed import DUFFING, PENDULUM, model_of, varied

import xdynamics as xd

MODELS = Path(__file__).parents[2] / "data" / "models"
END, ROUNDS = 50.0, 3
ASKED: dict[str, Any] = {"method": "dop853", "rtol": 1e-9, "atol": 1e-9, "until": END}


def observed(family: str) -> xd.Model:
    """Return a family with an observable."""
    return xd.Model.from_text(model_of(family).to_toml() + '\n[observables]\npower = "x*v_x"\n')


def driven(points: int) -> xd.Model:
    """Return an oscillator that a measured force with so many points pushes."""
    rows = "".join(f"{t:.6f},{np.sin(1.3 * t):.6f}\n" for t in np.linspace(0.0, END, points))
    return xd.Model(
        name="driven",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"spring": {"potential": "newton/metre*x**2/2"}, "push": {"x": "push"}},
        drives={"push": {"table": "p.csv", "csv": f"t [s],p [N]\n{rows}"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


def swept(model: xd.Model, name: str, values: Any, **more: Any) -> Callable[[], Any]:
    """Set up a sweep in one task of one thread."""
    found = xd.sweep(model, {name: values}, members_per_task=len(values), **ASKED | more)
    return lambda: found.compute(scheduler="synchronous")


def with_detectors(count: int) -> xd.Model:
    """Return the oscillators with so many detectors, a tenth of the first start apart."""
    events = {f"e{i}": {"function": f"x - {0.1 * i!r}*metre"} for i in range(count)}
    return xd.Model.from_text(
        model_of(DUFFING).to_toml()
        + "".join(f'\n[events.{name}]\nfunction = "{event["function"]}"\n' for name, event in events.items())
    )


def kinds(members: int) -> None:
    """Print what members cost that are more than a step of lines: microseconds, and plain members."""
    values = varied(DUFFING, members)
    ways = {"dop853, plain": swept(model_of(DUFFING), "k", values)}
    ways["radau_iia, its own tolerances"] = swept(
        model_of(DUFFING), "k", values, method="radau_iia", rtol=None, atol=None
    )
    ways["radau_iia, those of dop853"] = swept(model_of(DUFFING), "k", values, method="radau_iia")
    for count in (1, 10):
        ways[f"dop853, {count} detectors"] = swept(with_detectors(count), "k", values)
    for name in ("bouncing_ball", "impact_oscillator"):
        model = xd.Model.from_toml(MODELS / f"{name}.toml")
        first = next(iter(model.coordinates))
        starts = model.initial[first].si + np.linspace(0.0, 0.1, members)
        ways[name] = swept(model, f"initial_{first}", starts, until=None)
    table("kinds of members", ways, members)


def table(title: str, ways: dict[str, Callable[[], Any]], members: int) -> None:
    """Measure, and print microseconds a member, and over the first."""
    least = dict.fromkeys(ways, np.inf)
    for way in ways.values():
        way()
    for _ in range(ROUNDS):
        for name, way in ways.items():
            begun = time.process_time()
            way()
            least[name] = min(least[name], (time.process_time() - begun) / members * 1e6)
    first = next(iter(least.values()))
    print(f"\n{members} {title}{'us a member':>20}{'/ first':>9}")
    for name, cost in least.items():
        print(f"  {name:<34}{cost:>12.2f}{cost / first:>9.2f}")


def main(members: int = 4096) -> None:
    """Print one table for each family, one for drives, and one for kinds of members."""
    for family in (DUFFING, PENDULUM):
        model, values = observed(family), varied(family, members)
        name = "initial_x" if family == PENDULUM else "k"
        ways = {"end": swept(model, name, values)}
        for word in ("maximum_x", "minimum_x", "maximum_v_x", "maximum_power"):
            ways[word] = swept(model, name, values, keep=[word])
        for count in (10, 100):
            ways[f"x at {count} times"] = swept(model, name, values, keep=["x"], times=np.linspace(0.0, END, count))
        table(family, ways, members)
    starts = np.linspace(-1.0, 1.0, members)
    table(
        "oscillators", {f"a drive of {n} points": swept(driven(n), "initial_x", starts) for n in (2, 20, 200)}, members
    )
    kinds(members)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
