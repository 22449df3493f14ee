"""Speed of adaptive marches, in one run: hand-written C with the same method and log; scipy, diffrax and heyoka.

python tests/benchmarks/adaptive_speed.py [--peers-python PYTHON] [--json FILE] [--quick]

PYTHON is the interpreter of an environment with diffrax and heyoka (this one, where it is not given). Times are of
the whole march from the start, compiled before, in one thread; the least of many repeats stands first, for other work
may disturb the machine, then the median. Every solver keeps every accepted step, but where its name says otherwise.
The same tolerance, relative and absolute, is asked of all; their norms differ, so the second table compares the times
at equal error of the final state, interpolated in the logarithms over tolerances of 1e-4 to 1e-13.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from adaptive_problems import PLAIN, PROBLEMS, Words

HERE = Path(__file__).parent
NAMES = ("arenstorf", "kepler", "double_pendulum")
METHODS = ("dormand_prince", "dop853")
SCIPY = {"dormand_prince": "RK45", "dop853": "DOP853"}
DIFFRAX = {"dormand_prince": "Dopri5", "dop853": "Dopri8"}
SHOWN = (1e-6, 1e-8, 1e-10)
TOLERANCES = tuple(10.0**-k for k in range(4, 14))
TARGETS = (1e-3, 1e-5, 1e-7)
MOST_STEPS = 50_000
LONG = 2000.0  # end of the long Kepler run, where what a run costs at its start does not count


@dataclass(frozen=True)
class Point:
    """One solver at one tolerance: seconds, work and error."""

    least: float
    median: float
    steps: int
    rejected: int | None
    evaluations: int | None
    error: float


Key = tuple[str, str, float]  # problem, solver, tolerance
Points = dict[Key, Point]


def spent(
    march: Callable[[], Any], budget: float = 0.4, most: int = 500, before: Callable[[], Any] | None = None
) -> list[float]:
    """Return the seconds of repeated marches, three at least; one before them, and what is `before`, do not count."""
    march()
    times: list[float] = []
    start = time.perf_counter()
    while len(times) < 3 or (len(times) < most and time.perf_counter() - start < budget):
        if before:
            before()
        begin = time.perf_counter()
        march()
        times.append(time.perf_counter() - begin)
    return times


# ------------------------------------------------------------------------------------------------------- xdynamics


def our_lack() -> str:
    """Say why xdynamics cannot take part; nothing if it can."""
    from xdynamics.methods import METHODS as known

    missing = [method for method in METHODS if method not in known]
    return f"xdynamics has no method {' and '.join(missing)}" if missing else ""


def our_runs(problem: str, method: str, tolerance: float, end: float | None = None) -> dict[str, Point]:
    """March by xdynamics: the engine into a log that is there, like C; with blocks of its own; to the Dataset."""
    import xdynamics as xd
    from xdynamics.march import OUTCOMES, March
    from xdynamics.march.configuration import settings_for
    from xdynamics.march.engine import engine
    from xdynamics.march.log import allocate
    from xdynamics.march.memory import changing_arrays, put_back

    one = PROBLEMS[problem]
    model = one.model()
    asked: dict[str, Any] = {
        "method": method,
        "rtol": tolerance,
        "atol": tolerance,
        "until": end or one.end,
        "force_samples": "none",
    }
    settings = settings_for(model, **asked)
    run = xd.simulate(model, **asked)

    def alone() -> float:
        march = March(model, settings)
        assert march.run.address  # posed, its law compiled
        begin = time.perf_counter()
        for _ in march.blocks():
            pass
        return time.perf_counter() - begin

    march = March(model, settings)
    loop, posed = engine().march, march.run
    allocate(march.layout, run.sizes["step"] + 5, sampled=0).lend(posed)
    memory = changing_arrays(posed)
    looped = spent(lambda: loop(posed, 1 << 30), most=2000, before=lambda: put_back(posed, memory))
    assert OUTCOMES[int(march.now.status)].word == run.attrs["run_outcome"]
    assert march.now.rows == run.sizes["step"]
    steps, rejected = run.attrs["run_accepted_steps"], run.attrs["run_rejected_trials"]
    counts = (steps, rejected, run.attrs["run_force_evaluations"], one.error(one.last_of(run)))
    whole, inner = spent(lambda: xd.simulate(model, **asked)), [alone() for _ in range(100)]
    return {
        f"xdynamics {method}, loop": Point(min(looped), median(looped), *counts),
        f"xdynamics {method}": Point(min(inner), median(inner), *counts),
        f"xdynamics {method}, Dataset": Point(min(whole), median(whole), *counts),
    }


# --------------------------------------------------------------------------------------------------------------- C


def compiled_c(folder: Path) -> Path:
    """Compile the C program as one would for speed, with IEEE arithmetic."""
    program = folder / "adaptive"
    flags = ["-std=c99", "-D_POSIX_C_SOURCE=199309L", "-O3", "-march=native", "-ffp-contract=off"]
    subprocess.run(["cc", *flags, HERE / "adaptive.c", "-o", program, "-lm"], check=True)
    return program


def c_run(program: Path, problem: str, method: str, tolerance: float, end: float | None = None) -> Point:
    """March in C."""
    words = [program, problem, method, repr(tolerance), *([repr(end)] if end else [])]
    told = subprocess.run(words, capture_output=True, text=True, check=True).stdout.split()
    counts = [int(one) for one in told[2:5]]
    return Point(float(told[0]), float(told[1]), *counts, PROBLEMS[problem].error([float(one) for one in told[5:]]))


# ----------------------------------------------------------------------------------------------------------- peers


def scipy_run(problem: str, method: str, tolerance: float) -> Point:
    """March by solve_ivp with rates in plain Python."""
    from scipy.integrate import solve_ivp

    one = PROBLEMS[problem]
    stages = {"dormand_prince": 6, "dop853": 12}[method]  # of a trial, kept or not

    def march() -> Any:
        return solve_ivp(
            lambda _t, y: one.rates(y.tolist(), PLAIN),
            (0.0, one.end),
            one.start,
            method=SCIPY[method],
            rtol=tolerance,
            atol=tolerance,
        )

    times, found = spent(march), march()
    steps = len(found.t) - 1
    rejected = (found.nfev - 2) // stages - steps
    return Point(min(times), median(times), steps, rejected, int(found.nfev), one.error(found.y[:, -1]))


def diffrax_run(problem: str, method: str, tolerance: float) -> Point:
    """March by diffrax, jitted, with room for the power of two of steps above the needed ones."""
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    one, words = PROBLEMS[problem], Words(jnp.sin, jnp.cos, lambda r2: 1.0 / (r2 * jnp.sqrt(r2)))
    term = diffrax.ODETerm(lambda _t, y, _args: jnp.stack(one.rates(y, words)))
    start = jnp.array(one.start)

    def solver(room: int, saveat: Any) -> Callable[[], Any]:
        def solve(y: Any) -> Any:
            control = diffrax.PIDController(rtol=tolerance, atol=tolerance)
            chosen = getattr(diffrax, DIFFRAX[method])()
            return diffrax.diffeqsolve(
                term,
                chosen,
                0.0,
                one.end,
                None,
                y,
                stepsize_controller=control,
                saveat=saveat,
                max_steps=room,
                adjoint=diffrax.ForwardMode(),
            )

        compiled = jax.jit(solve)
        return lambda: jax.block_until_ready(compiled(start))

    found = solver(1 << 18, diffrax.SaveAt(t1=True))()
    steps, rejected = int(found.stats["num_accepted_steps"]), int(found.stats["num_rejected_steps"])
    times = spent(solver(1 << (steps + rejected).bit_length(), diffrax.SaveAt(steps=True)))
    stages = {"dormand_prince": 6, "dop853": 13}[method]
    evaluations = 2 + stages * (steps + rejected)
    return Point(min(times), median(times), steps, rejected, evaluations, one.error(np.asarray(found.ys[-1])))


def heyoka_marches(problem: str, tolerance: float) -> dict[str, Point]:
    """March by heyoka's Taylor series, keeping the last state alone, and keeping each by a callback.

    Its step follows from the last two Taylor coefficients, which nearly vanish for the double pendulum at rest at
    1e-6: that first step is of 6.7 s, and steps of 1e-8 s follow. Nothing is returned where the end is not reached.
    """
    import heyoka

    one = PROBLEMS[problem]
    symbols = heyoka.make_vars(*(f"s{i}" for i in range(len(one.start))))
    words = Words(heyoka.sin, heyoka.cos, lambda r2: r2**-1.5)
    system = list(zip(symbols, one.rates(symbols, words), strict=True))
    march = heyoka.taylor_adaptive(system, list(one.start), tol=tolerance)
    start = np.array(one.start)

    def plain(**more: Any) -> Any:
        march.time = 0.0
        march.state[:] = start
        return march.propagate_until(one.end, max_steps=MOST_STEPS, **more)

    def kept() -> list[Any]:
        states: list[Any] = []

        def keep(now: Any) -> bool:
            states.append((now.time, now.state.copy()))
            return True

        plain(callback=keep)
        return states

    if plain()[0] != heyoka.taylor_outcome.time_limit:
        return {}
    found = {}
    for name, run in {"heyoka, last state alone": plain, "heyoka, each state kept": kept}.items():
        times = spent(run)
        found[name] = Point(min(times), median(times), len(kept()), None, None, one.error(march.state))
    return found


def peer_points(tolerances: tuple[float, ...]) -> dict[str, Any]:
    """Measure diffrax and heyoka, those that can be imported; return versions and points as plain data."""
    versions: dict[str, str] = {}
    rows: list[Any] = []
    for name in ("diffrax", "heyoka"):
        try:
            versions[name] = __import__(name).__version__
        except ImportError as error:
            versions[name] = f"left out: {error}"
            continue
        for problem in NAMES:
            for tolerance in tolerances:
                if name == "heyoka":
                    found = heyoka_marches(problem, tolerance)
                else:
                    found = {
                        f"diffrax {DIFFRAX[method]}": diffrax_run(problem, method, tolerance) for method in METHODS
                    }
                rows += [[problem, solver, tolerance, asdict(point)] for solver, point in found.items()]
    return {"versions": versions, "rows": rows}


def asked_peers(python: str, *, quick: bool) -> tuple[dict[str, str], Points]:
    """Have another interpreter measure diffrax and heyoka."""
    words = [python, str(Path(__file__).resolve()), "--as-peer", *(["--quick"] if quick else [])]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        return {"diffrax and heyoka": f"left out: {done.stderr.strip().splitlines()[-1]}"}, {}
    told = json.loads(done.stdout.splitlines()[-1])
    return told["versions"], {(p, s, t): Point(**point) for p, s, t, point in told["rows"]}


# ---------------------------------------------------------------------------------------------------------- tables


def measured(program: Path, tolerances: tuple[float, ...], *, ours: bool) -> Points:
    """Measure C, scipy and, where they can, xdynamics' own marches."""
    points: Points = {}
    for problem in NAMES:
        for method in METHODS:
            for tolerance in tolerances:
                points[problem, f"C {method}", tolerance] = c_run(program, problem, method, tolerance)
                if ours:
                    found = our_runs(problem, method, tolerance)
                    points |= {(problem, solver, tolerance): point for solver, point in found.items()}
                points[problem, f"scipy {SCIPY[method]}", tolerance] = scipy_run(problem, method, tolerance)
    return points


def solvers_of(points: Points) -> list[str]:
    """Return the solvers in the order of the tables: each family after the other."""
    families = [
        [
            f"C {method}",
            f"xdynamics {method}, loop",
            f"xdynamics {method}",
            f"xdynamics {method}, Dataset",
            f"scipy {SCIPY[method]}",
            f"diffrax {DIFFRAX[method]}",
        ]
        for method in METHODS
    ]
    known = [solver for family in families for solver in family]
    found = {solver for _, solver, _ in points}
    return [one for one in known if one in found] + sorted(found - set(known))


def rival(solver: str) -> str:
    """Return the C march that a solver is compared with: that of its family; DOP853 for Taylor series."""
    fifth = any(name in solver for name in ("dormand_prince", "RK45", "Dopri5"))
    return f"C {METHODS[0] if fifth else METHODS[1]}"


def rows_at_equal_tolerance(points: Points) -> Iterator[str]:
    """Yield the first table."""
    yield f"{'':35} {'tol':>7} {'us least':>10} {'us median':>10} {'steps':>6} {'rej.':>5} {'evals':>7} {'error':>8} {'/ C':>7}"
    for problem in NAMES:
        yield PROBLEMS[problem].title
        for solver in solvers_of(points):
            for tolerance in SHOWN:
                one = points.get((problem, solver, tolerance))
                if one is None:
                    continue
                ratio = one.least / points[problem, rival(solver), tolerance].least
                rejected, evaluations = ("-" if n is None else str(n) for n in (one.rejected, one.evaluations))
                yield (
                    f"  {solver:33} {tolerance:7.0e} {one.least * 1e6:10.1f} {one.median * 1e6:10.1f} {one.steps:6}"
                    f" {rejected:>5} {evaluations:>7} {one.error:8.1e} {ratio:7.2f}"
                )


def at_error(points: Points, problem: str, solver: str, target: float) -> float:
    """Return the least seconds at a final error, interpolated in the logarithms; nan outside what was measured."""
    known = [
        one for (p, s, _), one in sorted(points.items(), key=lambda item: -item[0][2]) if (p, s) == (problem, solver)
    ]
    errors, seconds = [], []
    for one in known:  # towards tighter tolerances; an error that grows again is rounding or luck
        if one.error > 0 and (not errors or one.error < errors[-1]):
            errors.append(one.error)
            seconds.append(one.least)
    if len(errors) < 2:
        return float("nan")
    logs = np.log(errors)[::-1], np.log(seconds)[::-1]
    return float(np.exp(np.interp(np.log(target), *logs, left=np.nan, right=np.nan)))


def rows_at_equal_error(points: Points) -> Iterator[str]:
    """Yield the second table: microseconds at an error, and as a ratio to the family's C."""
    yield f"{'':35} " + " ".join(f"{f'us at {target:.0e}':>12} {'/ C':>7}" for target in TARGETS)
    for problem in NAMES:
        yield PROBLEMS[problem].title
        for solver in solvers_of(points):
            pairs = [
                (at_error(points, problem, solver, target), at_error(points, problem, rival(solver), target))
                for target in TARGETS
            ]
            yield f"  {solver:33} " + " ".join(f"{a * 1e6:12.1f} {a / b:7.2f}" for a, b in pairs)


def rows_of_long_runs(program: Path, *, ours: bool) -> Iterator[str]:
    """Yield nanoseconds a step of a Kepler run so long that what it costs at its start does not count."""
    for method in METHODS:
        theirs = c_run(program, "kepler", method, 1e-8, LONG)
        line = f"  {method:24} C {theirs.least / theirs.steps * 1e9:7.1f} ns a step of {theirs.steps}"
        if ours:
            mine = our_runs("kepler", method, 1e-8, LONG)[f"xdynamics {method}"]
            rate = mine.least / mine.steps
            line += f"; xdynamics {rate * 1e9:7.1f} ns, {rate / (theirs.least / theirs.steps):.2f} times C"
        yield line


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--peers-python", default=sys.executable, help="interpreter that has diffrax and heyoka")
    parser.add_argument("--json", type=Path, help="also write every point to this file")
    parser.add_argument("--quick", action="store_true", help="only the tolerances of the first table")
    parser.add_argument("--as-peer", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    tolerances = SHOWN if asked.quick else TOLERANCES
    if asked.as_peer:
        print(json.dumps(peer_points(tolerances)))
        return
    import scipy

    lack = our_lack()
    with tempfile.TemporaryDirectory() as folder:
        program = compiled_c(Path(folder))
        points = measured(program, tolerances, ours=not lack)
        long = list(rows_of_long_runs(program, ours=not lack))
    versions, peers = asked_peers(asked.peers_python, quick=asked.quick)
    points |= peers
    print(
        "peers: " + "; ".join(f"{name} {version}" for name, version in {"scipy": scipy.__version__, **versions}.items())
    )
    if lack:
        print(f"xdynamics left out: {lack}")
    print("\nEqual tolerance", *rows_at_equal_tolerance(points), sep="\n")
    print("\nEqual error of the final state", *rows_at_equal_error(points), sep="\n")
    print(f"\nKepler, e = 0.9, to t = {LONG:.0f} at 1e-8", *long, sep="\n")
    if asked.json:
        asked.json.write_text(json.dumps([[*key, asdict(point)] for key, point in points.items()], indent=1))


if __name__ == "__main__":
    main()
