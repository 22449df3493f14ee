"""What sums of two floats cost: CPU time of a step, of a whole run, and of compiling, over those of floats.

    python tests/benchmarks/precision_cost.py

The time of a step is the difference of two runs, one twice as long as the other, over the steps that it has more: what a
run costs whatever its length counts for the whole run alone. Both precisions make the same steps, in one process. Of
several runs the fastest counts. Compiling is timed without the cache.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import xdynamics as xd
from xdynamics.kernels import Law, layout_of, machine
from xdynamics.methods.scheme import PRECISIONS, Scheme
from xdynamics.methods.taylor import of_order

LORENZ = {"x": "10*(y - x)", "y": "28*x - x*z - y", "z": "x*y - 8/3*z"}
METHODS: dict[str, dict[str, Any]] = {"rk4": {}, "dop853": {}, "taylor": {"order": 20}}
STEPS = 3_000
REPEATS = 5


def problems() -> dict[str, tuple[xd.Model, float]]:
    """Return models with a step, s, that keeps all three methods on the motion."""
    orbit = xd.Model(
        name="Kepler 0.6",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "mu": "1 m3 s-2"},
        mass={"x": "m", "y": "m"},
        forces={"gravity": {"potential": "-m*mu/sqrt(x**2 + y**2)"}},
        initial={"x": "0.4 m", "y": "0 m", "v_y": "2 m s-1"},
    )
    pendulum = xd.Model(
        name="driven pendulum",
        coordinates={"theta": "rad"},
        parameters={"m": "1 kg", "l": "1 m", "g": "9.81 m s-2", "b": "0.1 kg m2 s-1"},
        mass={"theta": "m*l**2/radian**2"},
        forces={
            "gravity": {"potential": "-m*g*l*cos(theta)"},
            "bearing": {"theta": "-b*v_theta/radian**2"},
            "drive": {"theta": "newton*metre*sin(2*t/second)/radian"},
        },
        initial={"theta": "1 rad"},
    )
    lorenz = xd.Model(
        name="Lorenz",
        states={name: {"unit": "1", "rate": f"({rate})/(1*second)"} for name, rate in LORENZ.items()},
        initial={"x": "1", "y": "0", "z": "0"},
    )
    return {model.name: (model, step) for model, step in ((orbit, 1e-3), (pendulum, 1e-3), (lorenz, 1e-4))}


def fastest(act: Callable[[], object], repeats: int = REPEATS) -> float:
    """Return the CPU time of the fastest of several calls, s."""
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        act()
        times.append(time.process_time() - begin)
    return min(times)


def run_times(model: xd.Model, step: float, **asked: Any) -> tuple[float, float]:
    """Return the CPU times of a step and of a run of 6,000 of them, s."""
    asked |= {"step": step, "force_samples": "none"}
    once, twice = (fastest(lambda n=n: xd.simulate(model, until=n * STEPS * step, **asked)) for n in (1, 2))
    return (twice - once) / STEPS, twice


def compile_time(model: xd.Model, precision: str, method: str, *, order: int | None = None) -> tuple[float, int]:
    """Return the CPU time of printing and compiling what a march needs, s, and the lines of that as Python."""
    chosen = xd.METHODS[method] if order is None else of_order(order)
    estimator = "embedded" if chosen.estimate else "none"
    layout = layout_of(model, Scheme(chosen, estimator, precision=precision))
    laws: list[Law] = []

    def build() -> None:
        law = Law(layout, sampled=False)
        machine.build_object(law.text(excluded=[entry for entry in law.entries if entry.name == "inside"]))
        laws.append(law)

    return fastest(build, 2), len(laws[0].source.splitlines())


def main() -> None:
    """Print a line for each problem and method."""
    print(f"{'problem':<16}{'method':<8}{'a step':>8}{'of sums':>10}{'ratio':>7}{'run':>6}   compiling, lines of text")
    for name, (model, step) in problems().items():
        for method, more in METHODS.items():
            times = [run_times(model, step, method=method, precision=kind, **more) for kind in PRECISIONS]
            built = [compile_time(model, kind, method, **more) for kind in PRECISIONS]
            texts = ", ".join(f"{seconds:.2f} s ({lines})" for seconds, lines in built)
            steps, runs = zip(*times, strict=True)
            print(
                f"{name:<16}{method:<8}{steps[0] * 1e9:>5.0f} ns{steps[1] * 1e9:>7.0f} ns{steps[1] / steps[0]:>7.1f}"
                f"{runs[1] / runs[0]:>6.1f}   {texts}",
                flush=True,
            )


if __name__ == "__main__":
    main()
