"""States between steps: time an instant, and the error there over that at accepted states; SciPy's dense output beside.

At the end a long run is evaluated from its file and from memory.

python tests/benchmarks/sampling_speed.py [instants]
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr
from scipy.integrate import solve_ivp

import xdynamics as xd

MODEL = Path(__file__).parents[2] / "data" / "models" / "kepler.toml"
UNTIL, ROUNDS, CHECKED = 6.0, 5, 300
ORBIT = {"x": 0.5, "v_y": 3**0.5}  # e = 0.5
STEPS = {
    "velocity_verlet": 0.01,
    "dormand_prince": 0.1,
    "yoshida8": 0.1,
    "kahan_li8": 0.1,
    "dop853": 0.1,
    "radau_iia": 0.1,
}
NAMES = ("x", "y", "v_x", "v_y")

States = np.ndarray


def main(instants: int) -> None:
    """Print a line for each method and rule."""
    model = xd.Model.from_toml(MODEL).replace(initial=ORBIT)
    times = np.random.default_rng(1).uniform(0.0, UNTIL, instants)
    print("method            rule          us an instant   largest error between / at steps")
    for method, step in STEPS.items():
        run = xd.simulate(model, method=method, step=step, until=UNTIL, force_samples="none")
        for rule in ("reintegrate", "interpolant"):

            def between(t: States, run: object = run, rule: str = rule) -> States:
                found = xd.sample(run, t, rule=rule)
                return np.array([found[name] for name in NAMES])

            at_steps = np.array([run[name] for name in NAMES])
            line(method, rule, between, times, (run.time.values[1:], at_steps[:, 1:]))
    start = [0.5, 0.0, 0.0, 3**0.5]
    solved = solve_ivp(attracted, (0.0, UNTIL), start, "DOP853", rtol=1e-9, atol=1e-9, dense_output=True)
    line("SciPy's DOP853", "its own", solved.sol, times, (solved.t[1:], solved.y[:, 1:]))
    from_file(model, instants)


def from_file(model: xd.Model, instants: int) -> None:
    """Print what states between and a diagnosis of a long run cost from its file, over the same in memory."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "orbit.nc"
        run = xd.simulate(model, method="yoshida8", step=0.01, until=0.01 * instants, force_samples="none", path=path)
        times = np.random.default_rng(2).uniform(0.0, float(run.time[-1]), instants)
        stages = {"sample": lambda one: xd.sample(one, times), "diagnose": xd.diagnose}
        for name, stage in stages.items():
            rounds = range(2 if name == "diagnose" else ROUNDS)
            loaded, opened = (min(column) for column in zip(*(evaluated(path, stage) for _ in rounds), strict=True))
            print(
                f"{name:9} of {run.sizes['step']} rows: {opened:.3g} s from a file, {opened / loaded:.2f} times as in memory"
            )


def evaluated(path: Path, stage: Callable[[xr.Dataset], object]) -> list[float]:
    """Return the seconds that a stage takes with a run in memory and from its file."""
    seconds = []
    for load in (True, False):
        with xd.open_run(path) as opened:
            run = opened.load() if load else opened
            before = time.perf_counter()
            stage(run)
            seconds.append(time.perf_counter() - before)
    return seconds


def line(
    method: str, rule: str, between: Callable[[States], States], times: States, accepted: tuple[States, States]
) -> None:
    """Measure and print one way of coming between steps."""
    between(times)
    seconds = []
    for _ in range(ROUNDS):
        before = time.perf_counter()
        between(times)
        seconds.append(time.perf_counter() - before)
    inside, at_steps = np.sort(times)[:: max(1, times.size // CHECKED)], accepted[0]
    ratio = np.abs(between(inside) - exact(inside)).max() / np.abs(accepted[1] - exact(at_steps)).max()
    print(f"{method:17} {rule:13} {min(seconds) / times.size * 1e6:10.2f}      {ratio:12.3g}")


def exact(times: States) -> States:
    """The orbit from Kepler's equation, from the pericentre, semi-major axis and mean motion being one."""
    e, anomaly = 0.5, times.copy()
    for _ in range(50):
        anomaly -= (anomaly - e * np.sin(anomaly) - times) / (1 - e * np.cos(anomaly))
    sine, cosine, width = np.sin(anomaly), np.cos(anomaly), np.sqrt(1 - e * e)
    rate = 1 / (1 - e * cosine)
    return np.array([cosine - e, width * sine, -sine * rate, width * cosine * rate])


def attracted(_: float, y: States) -> list[float]:
    """The rates of the orbit."""
    cubed = (y[0] ** 2 + y[1] ** 2) ** 1.5
    return [y[2], y[3], -y[0] / cubed, -y[1] / cubed]


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100_000)
