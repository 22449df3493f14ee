"""Taylor series beside heyoka, in one run: six problems at equal errors of the final state, and what compiling costs.

python tests/benchmarks/taylor_speed.py [--quick] [--only compiling | bodies | kepler_06 | arenstorf | …]

heyoka is to be installed. Ours keeps every state and its uncertainty: `loop` is the march into a log that is there,
the next line the march from a posed run, its blocks made as it goes, `Dataset` the whole of `simulate`. heyoka keeps
the last state alone, or each step's polynomial (`c_output`), or states at as many times as it made steps
(`propagate_grid`). Both in double precision, one thread, the least of many repeats, over tolerances of 1e-4 to 3e-15,
interpolated in the logarithms of the error; a reference is heyoka's in 80 bits at 1e-19. Compiling is of a problem
that neither has seen: from its statement to the first step, for heyoka in compact mode and not; several chains of
springs show how that grows with the number of masses. Bodies are planets about a star, 6 to 60, whose pairs all
attract each other; ours keeps all states there too.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any

import heyoka
import numpy as np
from adaptive_problems import PROBLEMS, Benchmark, Words
from adaptive_speed import Point, Points, at_error, our_runs, spent
from many_bodies import CHAIN
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
NAMES = ("kepler_06", "arenstorf", "pleiades", "double_pendulum", "henon_heiles", "duffing")
TOLERANCES = (*(10.0**-k for k in range(4, 15)), 3e-15)
TARGETS = (1e-6, 1e-9, 1e-12)
WORDS = Words(heyoka.sin, heyoka.cos, lambda r2: r2**-1.5)
CHAINS = (3, 30, 300)
MOST_STEPS = 100_000  # of heyoka, which makes steps without end of the double pendulum at 1e-6
BODIES = {6: 2000.0, 20: 400.0, 60: 100.0}  # to which time
PLANETS = """
name = "planets"
[dimensions]
body = {n}
axis = 3
[coordinates]
r = {{ unit = "m", dims = ["body", "axis"] }}
[parameters]
G = "1 m3 kg-1 s-2"
m = {{ dims = ["body"], value = {masses}, unit = "kg" }}
[mass]
r = "m"
[relations.pair]
of = "body"
[forces.gravity]
over = "pair"
potential = "-G*first(m, pair)*second(m, pair)/norm(second(r, pair) - first(r, pair), axis)"
[initial]
r = {{ value = {r}, unit = "m" }}
v_r = {{ value = {v}, unit = "m/s" }}
"""
OURS = ("xdynamics taylor, loop", "xdynamics taylor", "xdynamics taylor, Dataset")
THEIRS = ("heyoka, last state alone", "heyoka, polynomials kept", "heyoka, on a grid")


def _henon_heiles() -> Benchmark:
    statement = {
        "name": "Henon and Heiles",
        "coordinates": {"x": "m", "y": "m"},
        "parameters": {"m": "1 kg", "k": "1 N m-1", "c": "1 N m-2"},
        "mass": {"x": "m", "y": "m"},
        "forces": {"well": {"potential": "k*(x**2 + y**2)/2 + c*(x**2*y - y**3/3)"}},
        "initial": {"x": "0 m", "y": "0.1 m", "v_x": "0.49 m/s", "v_y": "0 m/s"},
    }
    return Benchmark(
        "Henon and Heiles",
        statement,
        ("x", "y", "v_x", "v_y"),
        (0.0, 0.1, 0.49, 0.0),
        200.0,
        (),
        lambda s, _words: [s[2], s[3], -s[0] - 2.0 * s[0] * s[1], -s[1] - s[0] * s[0] + s[1] * s[1]],
        "Henon, Heiles (1964), Astron. J. 69, 73, energy 0.12",
    )


def _duffing() -> Benchmark:
    statement = {
        "name": "Duffing",
        "coordinates": {"x": "m"},
        "parameters": {"m": "1 kg", "k": "1 N m-1", "b": "1 N m-3"},
        "mass": {"x": "m"},
        "forces": {"spring": {"x": "k*x - b*x**3"}},
        "initial": {"x": "0.5 m", "v_x": "1 m/s"},
    }
    return Benchmark(
        "Duffing, two wells",
        statement,
        ("x", "v_x"),
        (0.5, 1.0),
        100.0,
        (),
        lambda s, _words: [s[1], s[0] - s[0] * s[0] * s[0]],
        "Hamiltonian, no damping",
    )


def _kepler_06() -> Benchmark:
    of_d5, start = PROBLEMS["kepler"], (0.4, 0.0, 0.0, 2.0)
    initial = {"x": "0.4 m", "y": "0 m", "v_x": "0 m/s", "v_y": "2 m/s"}
    statement = of_d5.statement | {"name": "Kepler ellipse of eccentricity 0.6", "initial": initial}
    return replace(of_d5, title="Kepler, e = 0.6", statement=statement, start=start, end=60.0, reference=())


MORE = {"kepler_06": _kepler_06(), "henon_heiles": _henon_heiles(), "duffing": _duffing()}


def system_of(problem: Benchmark) -> list[Any]:
    """Return the rates as heyoka takes them."""
    symbols = heyoka.make_vars(*(f"s{i}" for i in range(len(problem.start))))
    return list(zip(symbols, problem.rates(symbols, WORDS), strict=True))


def refer(name: str) -> None:
    """Add a problem to those that are measured, with the state that 80 bits come to."""
    problem = MORE.get(name) or PROBLEMS[name]
    wide = np.longdouble
    march = heyoka.taylor_adaptive(
        system_of(problem), [wide(one) for one in problem.start], tol=wide(1e-19), fp_type=wide
    )
    march.propagate_until(wide(problem.end))
    PROBLEMS[name] = replace(problem, reference=tuple(float(one) for one in march.state))


def theirs(name: str, tolerance: float) -> dict[str, Point]:
    """March by heyoka: nothing kept, the polynomials of all steps, states on a grid."""
    problem = PROBLEMS[name]
    march, start = (
        heyoka.taylor_adaptive(system_of(problem), list(problem.start), tol=tolerance),
        np.array(problem.start),
    )

    def begun() -> None:
        march.time = 0.0
        march.state[:] = start

    def until(**more: Any) -> Any:
        begun()
        return march.propagate_until(problem.end, **more)

    outcome = until(max_steps=MOST_STEPS)
    if outcome[0] != heyoka.taylor_outcome.time_limit:
        return {}
    steps, error = int(outcome[3]), problem.error(march.state)
    grid = np.linspace(0.0, problem.end, steps + 1)

    def on_grid() -> Any:
        begun()
        return march.propagate_grid(grid)

    ways: dict[str, Callable[[], Any]] = dict(zip(THEIRS, (until, lambda: until(c_output=True), on_grid), strict=True))
    found = {}
    for way, run in ways.items():
        times = spent(run, budget=0.2)
        found[way] = Point(min(times), sorted(times)[len(times) // 2], steps, None, None, error)
    return found


def rows(points: Points, names: Iterable[str]) -> Iterator[str]:
    """Yield nanoseconds a step at 1e-12, then microseconds at equal errors with their ratios to heyoka's ways."""
    for name in names:
        yield f"{PROBLEMS[name].title}, to t = {PROBLEMS[name].end:g}"
        best = {way: [at_error(points, name, way, target) for target in TARGETS] for way in (*OURS, *THEIRS)}
        kept = [min(pair) for pair in zip(best[THEIRS[1]], best[THEIRS[2]], strict=True)]
        for way, seconds in best.items():
            at = points.get((name, way, 1e-12))
            step = 1e9 * at.least / at.steps if at else nan
            cells = " ".join(
                f"{1e6 * one:9.1f} {one / alone:5.2f} {one / grid:5.2f}"
                for one, alone, grid in zip(seconds, best[THEIRS[0]], kept, strict=True)
            )
            yield f"  {way:28} {step:7.0f} ns {at.steps if at else 0:6} {cells}"


def chain(n: int) -> list[Any]:
    """Return the chain of springs of `many_bodies` as heyoka takes it."""
    u, v = heyoka.make_vars(*(f"u{i}" for i in range(n))), heyoka.make_vars(*(f"v{i}" for i in range(n)))
    pulls = [4.0 * (b - a) for a, b in pairwise(u)]
    forces = [(pulls[i] if i < n - 1 else 0.0) - (pulls[i - 1] if i else 0.0) for i in range(n)]
    return [*zip(u, v, strict=True), *zip(v, forces, strict=True)]


def compiling() -> Iterator[str]:
    """Yield seconds from a statement to the first step, of laws that nobody has compiled."""
    import os

    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o700)
        os.environ["XDYNAMICS_CACHE"] = folder
        import xdynamics as xd

        def ours(model: Any) -> float:
            begin = time.perf_counter()
            xd.simulate(model(), method="taylor", rtol=3e-15, atol=3e-15, until=1e-3)
            return time.perf_counter() - begin

        def heyokas(system: Any, start: list[float], **more: Any) -> float:
            begin = time.perf_counter()
            heyoka.taylor_adaptive(system, start, tol=3e-15, **more).step()
            return time.perf_counter() - begin

        ours(PROBLEMS["kepler"].model)  # the engine, which every model has
        for name in NAMES:
            problem = PROBLEMS[name]
            system, start = system_of(problem), list(problem.start)
            yield f"  {name:20} ours {ours(problem.model):6.2f} s, heyoka {heyokas(system, start):6.2f} s"
        for n in CHAINS:
            start = [0.1 * np.sin(np.pi * (i + 1) / (n + 1)) for i in range(n)] + [0.0] * n
            mine = ours(lambda n=n: xd.Model.from_text(CHAIN.format(n=n)))
            yield (
                f"  chain of {n:4}        ours {mine:6.2f} s, heyoka {heyokas(chain(n), start, compact_mode=True):6.2f} s"
                " in compact mode"
            )


def planets(n: int) -> tuple[list[float], Numbers, Numbers]:
    """Return masses, positions and velocities of a star and of light planets on circles about it."""
    radius, angle = 1.0 + 0.6 * np.arange(1, n), np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, n - 1)
    r, v, masses = np.zeros((n, 3)), np.zeros((n, 3)), [1.0, *[1e-6] * (n - 1)]
    r[1:, 0], r[1:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    v[1:, 0], v[1:, 1] = -np.sin(angle) / np.sqrt(radius), np.cos(angle) / np.sqrt(radius)
    return masses, r, v


def bodies() -> Iterator[str]:
    """Yield milliseconds of whole runs of planets about a star, ours with records of all states, and of the first of all."""
    import xdynamics as xd

    for n, end in BODIES.items():
        masses, r, v = planets(n)
        model = xd.Model.from_text(PLANETS.format(n=n, masses=masses, r=r.tolist(), v=v.tolist()))
        asked: dict[str, Any] = {"method": "taylor", "rtol": 3e-15, "atol": 3e-15, "log": "states"}
        begin = time.perf_counter()
        xd.simulate(model, until=1e-3 * end, **asked)
        first = time.perf_counter() - begin
        own = min(spent(lambda model=model, end=end, asked=asked: xd.simulate(model, until=end, **asked)))
        system, start = heyoka.model.nbody(n, masses=masses), np.hstack([r, v]).ravel()
        begin = time.perf_counter()
        march = heyoka.taylor_adaptive(system, start.tolist(), tol=3e-15, compact_mode=True)
        made = time.perf_counter() - begin

        def peer(march: Any = march, start: Any = start, end: float = end) -> None:
            march.time = 0.0
            march.state[:] = start
            march.propagate_until(end)

        his = min(spent(peer))
        yield (
            f"  {n:2} bodies, t = {end:5g}   ours {1e3 * own:7.1f} ms, heyoka {1e3 * his:7.1f} ms, ratio {own / his:5.2f};"
            f" first run {first:5.2f} s, heyoka made in {made:5.2f} s"
        )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="every second tolerance")
    parser.add_argument("--only", choices=("compiling", "bodies", *NAMES), help="one of the tables, or one problem")
    asked = parser.parse_args()
    tolerances = TOLERANCES[:: 2 if asked.quick else 1]
    names = tuple(name for name in NAMES if asked.only in (None, name))
    for name in NAMES if asked.only in (None, "compiling") else names:
        refer(name)
    print(f"heyoka {heyoka.__version__}", flush=True)
    if asked.only in (None, "compiling"):
        print("\nSeconds from a statement to the first step", *compiling(), sep="\n", flush=True)
    if asked.only in (None, "bodies"):
        print("\nWhole runs at a tolerance of 3e-15", *bodies(), sep="\n", flush=True)
    if not names:
        return
    points: Points = {}
    for name in names:
        for tolerance in tolerances:
            ours = {way: point for way, point in our_runs(name, "taylor", tolerance).items() if way in OURS}
            for way, point in (ours | theirs(name, tolerance)).items():
                points[name, way, tolerance] = point
    head = " ".join(f"{f'us at {target:.0e}':>12} {'/last':>3} {'/kept':>3}" for target in TARGETS)
    print(f"\n{'':30} a step at 1e-12, steps {head}", *rows(points, names), sep="\n")


if __name__ == "__main__":
    main()
