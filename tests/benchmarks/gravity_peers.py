"""Gravity beside its best-known codes, in one run: REBOUND (leapfrog, IAS15) and heyoka (Taylor series).

python tests/benchmarks/gravity_peers.py [steps | planets]

Steps: nanoseconds for every two of N bodies in one evaluation of our forces, and in a step of the same leapfrog, ours
with the energies that every row of a record has, and the peer's, which has none.
Planets: the outer solar system over 100 years. Every code marches with a ladder of tolerances or steps; what counts is
the least time at which all positions are within an error of a reference, heyoka's in extended precision. Ours keeps every
state, as a record, and of the march alone what a record of three rows costs is taken off; the peers keep none, heyoka
also each. Times are of the processor, the least of some rounds, and
compiling and the building of models are left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import heyoka
import numpy as np
import rebound
from numpy.typing import NDArray

import xdynamics as xd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from many_bodies import ABREAST, CLUSTER, bodies, program

from cases.array_programs import bound

MODELS = Path(__file__).resolve().parents[2] / "data" / "models"
BODIES, INTERACTIONS, ROUNDS = (30, 100, 1000), 4_000_000, 5
DAY = 86400.0  # s
SPAN, TARGETS = 36525.0, (1e-9, 1e-12)  # day, astronomical units
State = NDArray[np.float64]
Way = Callable[[], State]


def least(call: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Return the least processor time of some calls."""
    found = np.inf
    for _ in range(rounds):
        begin = time.process_time()
        call()
        found = min(found, time.process_time() - begin)
    return found


def evaluation_time(n: int) -> float:
    """Return the seconds of one evaluation of our forces."""
    shapes, potential, dims, pairs = bodies(n)
    random, many = np.random.default_rng(n), max(1, int(INTERACTIONS / pairs))
    numbers = {"p": random.normal(size=4 * n + 1), "z": np.zeros(3 * n)}
    call = bound(program(shapes, potential, dims), abreast=ABREAST, **numbers)
    return least(lambda: [call() for _ in range(many)]) / many


def step_times(n: int) -> tuple[float, float]:
    """Return the seconds of a step of n bodies, ours and REBOUND's."""
    start = np.random.default_rng(n).uniform(-1.0, 1.0, (n, 3)) * n
    model = xd.Model.from_text(CLUSTER.format(n=n, start=start.tolist()))
    many = max(20, int(INTERACTIONS / (n * (n - 1) / 2)))

    def ours(steps: int) -> Callable[[], object]:
        settings = {"estimator": "none", "force_samples": "none", "log": "states", "keep_every": steps}
        return lambda: xd.simulate(model, method="velocity_verlet", step=1e-3, until=steps * 1e-3, **settings)

    peer = rebound.Simulation()
    peer.integrator, peer.dt = "leapfrog", 1e-3
    for x, y, z in start:
        peer.add(m=1.0, x=x, y=y, z=z)
    ours(many)()
    own = (least(ours(many)) - least(ours(many // 10))) / (many - many // 10)
    return own, least(lambda: peer.steps(many)) / many


def steps() -> None:
    """Print nanoseconds of steps."""
    print(f"{'bodies':>6}{'forces':>12}{'step':>12}{'REBOUND':>12}{'over forces':>14}{'over a step':>14}   ns")
    for n in BODIES:
        forces, (own, peer) = evaluation_time(n), step_times(n)
        each = (f"{1e9 * seconds / (n * (n - 1) / 2):12.2f}" for seconds in (forces, own, peer))
        print(f"{n:6}{''.join(each)}{peer / forces:14.2f}{peer / own:14.2f}", flush=True)


def planets() -> tuple[xd.Model, NDArray[np.float64], State, State]:
    """Return the model, its gravitational parameters, positions and velocities at the start, in days and units."""
    model = xd.Model.from_toml(MODELS / "outer_solar_system.toml")
    run = xd.simulate(model, method="velocity_verlet", step="1 day", until="1 day")
    return model, run.mu.values, run.r.values[0], run.v_r.values[0] * DAY


def of_ours(model: xd.Model) -> Iterator[tuple[str, Way]]:
    """Yield our ways to march."""
    until = f"{SPAN} day"

    def march(**settings: object) -> Way:
        return lambda: xd.simulate(model, until=until, log="states", force_samples="none", **settings).r.values[-1]

    for rtol in 10.0 ** np.arange(-9, -14.6, -0.5):
        yield "dop853", march(method="dop853", rtol=float(rtol), step=None)
    for days in (250, 160, 100, 60, 40, 25, 16, 10):
        yield "kahan_li8", march(method="kahan_li8", step=f"{days} day", estimator="none")


def of_rebound(mu: NDArray[np.float64], r: State, v: State) -> Iterator[tuple[str, Way]]:
    """Yield REBOUND's ways."""

    def march(epsilon: float) -> Way:
        def done() -> State:
            peer = rebound.Simulation()
            peer.G, peer.integrator = 1.0, "ias15"
            peer.integrator.epsilon = epsilon
            for mass, (x, y, z), (vx, vy, vz) in zip(mu, r, v, strict=True):
                peer.add(m=mass, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
            peer.integrate(SPAN)
            return np.array([body.xyz for body in peer.particles])

        return done

    for epsilon in 10.0 ** np.arange(-3, -12, -1.0):
        yield "IAS15", march(float(epsilon))


def of_heyoka(mu: NDArray[np.float64], r: State, v: State) -> Iterator[tuple[str, Way]]:
    """Yield heyoka's ways."""
    system = heyoka.model.nbody(len(mu), masses=mu.tolist(), Gconst=1.0)
    start = np.concatenate([r, v], axis=1).ravel()

    def march(tolerance: float, *, kept: bool) -> Way:
        code = heyoka.taylor_adaptive(system, start.tolist(), tol=tolerance, compact_mode=True)

        def done() -> State:
            code.time, code.state[:] = 0.0, start
            states: list[State] = []
            each = {"callback": lambda own: states.append(own.state.copy()) is None} if kept else {}
            code.propagate_until(SPAN, **each)
            return code.state.reshape(-1, 6)[:, :3].copy()

        return done

    for tolerance in 10.0 ** np.arange(-9, -17, -1.0):
        yield "heyoka, last state alone", march(float(tolerance), kept=False)
        yield "heyoka, each state kept", march(float(tolerance), kept=True)


def reference(mu: NDArray[np.float64], r: State, v: State) -> State:
    """Return positions at the end, by heyoka in extended precision."""
    wide = np.longdouble
    system = heyoka.model.nbody(len(mu), masses=[wide(m) for m in mu], Gconst=wide(1.0))
    start = np.concatenate([r, v], axis=1).ravel().astype(wide)
    code = heyoka.taylor_adaptive(system, start, tol=wide(1e-19), fp_type=wide, compact_mode=True)
    code.propagate_until(wide(SPAN))
    return code.state.reshape(-1, 6)[:, :3].astype(float)


def equal_errors() -> None:
    """Print the least times at equal errors."""
    model, mu, r, v = planets()
    exact = reference(mu, r, v)
    best: dict[str, dict[float, float]] = {}
    for name, way in (*of_ours(model), *of_rebound(mu, r, v), *of_heyoka(mu, r, v)):
        error = float(np.abs(way() - exact).max())  # compiled now
        seconds = least(way, 3)
        for target in TARGETS:
            own = best.setdefault(name, {})
            own[target] = min(own.get(target, np.inf), seconds if error <= target else np.inf)
    settings = {"rtol": 1e-11, "log": "states", "force_samples": "none"}
    record = least(lambda: xd.simulate(model, method="dop853", until="1 day", **settings))
    best |= {"dop853, march alone": {target: best["dop853"][target] - record for target in TARGETS}}
    ours = best["dop853, march alone"]
    print(f"{'at errors of':28}" + "".join(f"{target:>14g} au{'over ours':>12}" for target in TARGETS))
    for name, own in best.items():
        cells = (f"{1e3 * own[target]:14.2f} ms{own[target] / ours[target]:12.2f}" for target in TARGETS)
        print(f"{name:28}" + "".join(cells))


def main() -> None:
    """Print what is asked for."""
    asked = sys.argv[1:] or ["steps", "planets"]
    if "steps" in asked:
        steps()
    if "planets" in asked:
        equal_errors()


if __name__ == "__main__":
    main()
