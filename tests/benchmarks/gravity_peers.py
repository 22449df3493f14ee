"""Gravity beside its best-known codes, in one run: REBOUND (leapfrog, IAS15) and heyoka (Taylor series).

python tests/benchmarks/gravity_peers.py [steps | planets]

Both are to be installed.
Steps: nanoseconds for every two of N bodies in one evaluation of our forces, and in a step of the same leapfrog, both
without energies.
Planets: the outer solar system over 100 years, and twenty bodies. Every code marches with a ladder of tolerances or
steps; what counts is the least time at which all positions are within an error of a reference, heyoka's in extended
precision. Ours keeps every state (`Dataset`: and makes its record of them); IAS15 keeps none and is taken with each of
its step controls; heyoka, in compact mode, keeps none or each step's polynomial. Times are of the processor, the least of
some rounds; compiling and the building of models and simulations are left out.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

import heyoka
import numpy as np
import rebound
from numpy.typing import NDArray

import xdynamics as xd

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from many_bodies import ABREAST, CLUSTER, bodies, program
from taylor_speed import PLANETS, planets

from cases.array_programs import bound
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

MODELS = Path(__file__).resolve().parents[2] / "data" / "models"
BODIES, INTERACTIONS, ROUNDS = (30, 100, 1000), 4_000_000, 5
DAY = 86400.0  # s
TARGETS = (1e-9, 1e-12)
PEERS, HEADS = ("IAS15", "heyoka, each", "heyoka, last"), "    IAS15     kept     last"
State = NDArray[np.float64]
Run = Callable[[], object]
Way = tuple[Callable[[], Run], Callable[[], State]]  # what makes a march ready to be timed, and its last positions


@dataclass(frozen=True)
class Problem:
    """Bodies that attract each other, in units of length and time in which G is 1."""

    title: str
    model: xd.Model
    time: str
    end: float
    mu: State
    r: State
    v: State
    longest: float  # step of those that are equal


def least(call: Run, rounds: int = ROUNDS) -> float:
    """Return the least processor time of some calls."""
    return least_of(lambda: call, rounds)


def least_of(made: Callable[[], Run], rounds: int = ROUNDS) -> float:
    """Return the least processor time of some marches, each made ready before."""
    found = inf
    for _ in range(rounds):
        call = made()
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


def outer_planets() -> Problem:
    """Return the outer solar system over 100 years, in days and astronomical units."""
    model = xd.Model.from_toml(MODELS / "outer_solar_system.toml")
    run = xd.simulate(model, method="velocity_verlet", step="1 day", until="1 day")
    mu, r, v = run.mu.values, run.r.values[0], run.v_r.values[0] * DAY
    return Problem("Outer solar system over 100 years, errors in au", model, "day", 36525.0, mu, r, v, 300.0)


def star_and_planets() -> Problem:
    """Return twenty bodies, a star and 19 light planets, over 31 periods of the innermost."""
    n, end = 20, 400.0
    masses, r, v = planets(n)
    model = xd.Model.from_text(PLANETS.format(n=n, masses=masses, r=r.tolist(), v=v.tolist()))
    return Problem("20 bodies to t = 400 s, errors in m", model, "s", end, np.array(masses), r, v, 2.5)


def of_ours(problem: Problem) -> Iterator[tuple[str, Way]]:
    """Yield our ways: the march from a posed run, its states kept, and the whole of `simulate`."""

    def ways(**more: Any) -> Iterator[tuple[str, Way]]:
        asked: dict[str, Any] = {"until": f"{problem.end} {problem.time}", "log": "states", "force_samples": "none"}
        settings = settings_for(problem.model, **asked, **more)

        def alone() -> Run:
            march = March(problem.model, settings)
            assert march.run.address  # posed, its law compiled
            return lambda: [*march.blocks()]

        def last() -> State:
            return xd.simulate(problem.model, **asked, **more).r.values[-1]

        what = ", 31 digits" if "precision" in more else ", compensated" if "summation" in more else ""
        yield f"xdynamics {more['method']}{what}", (alone, last)
        if "precision" not in more:
            yield f"xdynamics {more['method']}{what}, Dataset", (lambda: last, last)

    for tolerance in 10.0 ** np.arange(-8, -15.6, -0.5):
        for method in ("taylor", "dop853"):
            yield from ways(method=method, rtol=float(max(tolerance, 3e-15)))
    for tolerance in (1e-13, 1e-14, 3e-15):
        for order in (14, 16, 20):
            yield from ways(method="taylor", order=order, rtol=tolerance, summation="compensated")
    for tolerance in (3e-13, 1e-13):
        yield from ways(method="dop853", rtol=tolerance, precision="double_double")
    for step in problem.longest * 1.5 ** -np.arange(8.0):
        for more in ({}, {"summation": "compensated"}):
            yield from ways(method="kahan_li8", step=f"{step} {problem.time}", estimator="none", **more)


def of_rebound(problem: Problem) -> Iterator[tuple[str, Way]]:
    """Yield IAS15 with steps chosen in both its ways, and with equal ones."""

    def way(mode: int, epsilon: float, step: float) -> Way:
        def made() -> rebound.Simulation:
            peer = rebound.Simulation()
            peer.G, peer.integrator, peer.dt = 1.0, "ias15", step
            peer.integrator.epsilon, peer.integrator.adaptive_mode = epsilon, mode
            for mass, (x, y, z), (vx, vy, vz) in zip(problem.mu, problem.r, problem.v, strict=True):
                peer.add(m=mass, x=x, y=y, z=z, vx=vx, vy=vy, vz=vz)
            return peer

        def alone() -> Run:
            peer = made()
            return lambda: peer.integrate(problem.end)

        def last() -> State:
            peer = made()
            peer.integrate(problem.end)
            return np.array([body.xyz for body in peer.particles])

        return alone, last

    for epsilon in 10.0 ** np.arange(-1, -12, -0.5):
        yield "IAS15, new step control", way(2, float(epsilon), 1e-2)
        yield "IAS15, old step control", way(1, float(epsilon), 1e-2)
    for step in problem.longest * 1.5 ** -np.arange(-3.0, 6.0):
        yield "IAS15, equal steps", way(2, 0.0, float(step))


def of_heyoka(problem: Problem) -> Iterator[tuple[str, Way]]:
    """Yield heyoka's ways, in compact mode: the last state alone, or each step's kept by a function of Python."""
    system = heyoka.model.nbody(len(problem.mu), masses=problem.mu.tolist(), Gconst=1.0)
    start = np.concatenate([problem.r, problem.v], axis=1).ravel()

    def way(tolerance: float, *, kept: bool) -> Way:
        code = heyoka.taylor_adaptive(system, start.tolist(), tol=tolerance, compact_mode=True)
        states: list[State] = []
        more = {"c_output": True} if kept else {}

        def alone() -> Run:
            states.clear()
            code.time, code.state[:] = 0.0, start
            return lambda: code.propagate_until(problem.end, **more)

        def last() -> State:
            alone()()
            return code.state.reshape(-1, 6)[:, :3].copy()

        return alone, last

    for tolerance in 10.0 ** np.arange(-8, -16.6, -0.5):
        yield "heyoka, last state alone", way(float(tolerance), kept=False)
        yield "heyoka, each step kept", way(float(tolerance), kept=True)


def reference(problem: Problem) -> State:
    """Return positions at the end, by heyoka in extended precision."""
    wide = np.longdouble
    system = heyoka.model.nbody(len(problem.mu), masses=[wide(m) for m in problem.mu], Gconst=wide(1.0))
    start = np.concatenate([problem.r, problem.v], axis=1).ravel().astype(wide)
    code = heyoka.taylor_adaptive(system, start, tol=wide(1e-19), fp_type=wide, compact_mode=True)
    code.propagate_until(wide(problem.end))
    return code.state.reshape(-1, 6)[:, :3].astype(float)


def equal_errors(problem: Problem) -> None:
    """Print the least times at equal errors, over those of the peers, and the least error that was met."""
    exact, best, nearest = reference(problem), {}, {}
    for name, (alone, last) in (*of_ours(problem), *of_rebound(problem), *of_heyoka(problem)):
        error = float(np.abs(last() - exact).max())  # compiled now
        nearest[name] = min(error, nearest.get(name, inf))
        own = best.setdefault(name, dict.fromkeys(TARGETS, inf))
        if error <= max(TARGETS):
            seconds = least_of(alone)
            best[name] = {t: min(known, seconds if error <= t else inf) for t, known in own.items()}
    peers = {
        head: {t: min(own[t] for name, own in best.items() if name.startswith(head)) for t in TARGETS} for head in PEERS
    }
    print(f"\n{problem.title}\n{'':27}least error" + "".join(f"{f'at {t:g}, over':>16}{HEADS}" for t in TARGETS))
    for name, own in best.items():
        cells = (
            f"{1e3 * own[t]:13.3f} ms" + "".join(ratio(own[t], bar[t]) for bar in peers.values())
            if own[t] < inf
            else f"{'not met':>16}" + 27 * " "
            for t in TARGETS
        )
        print(f"{name:28}{nearest[name]:10.1e}" + "".join(cells).rstrip(), flush=True)


def ratio(ours: float, theirs: float) -> str:
    """Return a ratio as text; a dash where there is nothing to compare with."""
    return f"{ours / theirs:9.2f}" if theirs < inf else f"{'-':>9}"


def main() -> None:
    """Print what is asked for."""
    asked = sys.argv[1:] or ["steps", "planets"]
    if "steps" in asked:
        steps()
    if "planets" in asked:
        for problem in (outer_planets(), star_and_planets()):
            equal_errors(problem)


if __name__ == "__main__":
    main()
