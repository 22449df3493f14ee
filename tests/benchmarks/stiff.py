"""Radau IIA against scipy's Radau on stiff problems and a chain of masses, in one run: work, error and time.

python tests/benchmarks/stiff.py

Of ours the first run of a model in this process is printed besides the best of three, with the law compiled anew if the
cache is an empty folder. scipy differentiates by differences; of the chain it is given the matrix besides.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from adaptive_problems import PLAIN, Benchmark
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from stiff_problems import STIFF, chain

import xdynamics as xd
from xdynamics.march.engine import engine

ABSOLUTE = {"hires": 1e-4, "robertson": 1e-8, "van_der_pol": 1.0}  # over the relative tolerance
HEAD = f"{'':24} {'tolerance':>9} {'error':>9} {'steps':>7} {'Jacobians':>10} {'LU':>7} {'forces':>8} {'best':>10} {'first':>9}"
MASSES, END = 50, 5.2
Counts = tuple[float, int, int, int, int, float]


def best(run: Any, times: int = 3) -> tuple[Any, float, float]:
    """Return what it gives, the least seconds it takes, and those of the first time."""
    seconds, found = [], None
    for _ in range(times):
        begin = time.perf_counter()
        found = run()
        seconds.append(time.perf_counter() - begin)
    return found, min(seconds), seconds[0]


def ours(one: Benchmark, tolerance: float, absolute: float, exact: Any) -> tuple[Counts, float]:
    """March a problem by Radau IIA."""
    asked = {"rtol": tolerance, "atol": absolute, "until": one.end, "force_samples": "none"}
    model = one.model()
    run, seconds, first = best(lambda: xd.simulate(model, method="radau_iia", **asked))
    counts = [int(run.attrs[f"run_{name}"]) for name in ("jacobian_evaluations", "factorisations", "force_evaluations")]
    return (error(one.last_of(run), exact), run.sizes["step"] - 1, *counts, seconds), first


def theirs(one: Benchmark, tolerance: float, absolute: float, exact: Any, matrix: Any = None) -> Counts:
    """March it by scipy; of a linear one the matrix is given."""

    def rates(_t: float, y: Any) -> Any:
        return one.rates(y, PLAIN) if matrix is None else matrix @ y

    def run() -> Any:
        return solve_ivp(rates, (0.0, one.end), one.start, "Radau", rtol=tolerance, atol=absolute, jac=matrix)

    found, seconds, _ = best(run)
    return error(found.y[:, -1], exact), len(found.t) - 1, found.njev, found.nlu, found.nfev, seconds


def error(last: Any, exact: Any) -> float:
    """The largest error, over the component where it is larger than 1e-3 of the largest in the chain."""
    exact = np.array(exact)
    scale = np.abs(exact) if len(exact) < MASSES else np.abs(exact).max()
    return float(np.max(np.abs(last - exact) / scale))


def compared(name: str, one: Benchmark, tolerance: float, absolute: float, exact: Any, matrix: Any = None) -> None:
    """Print both and their ratios, scipy's seconds over ours."""
    (mine, first), other = ours(one, tolerance, absolute, exact), theirs(one, tolerance, absolute, exact, matrix)
    for title, counts, began in ((name, mine, f"{first:8.3f} s"), ("  scipy", other, "")):
        found, steps, jacobians, factors, forces, seconds = counts
        print(
            f"{title:24} {tolerance:9.0e} {found:9.1e} {steps:7} {jacobians:10} {factors:7} {forces:8} {1e3 * seconds:7.1f} ms {began}"
        )
    ratios = [f"{a / max(b, 1):.2f}" for a, b in zip(mine[1:5], other[1:5], strict=True)]
    print(
        f"{'  ratios':24} {'':9} {'':9} {ratios[0]:>7} {ratios[1]:>10} {ratios[2]:>7} {ratios[3]:>8} {other[5] / mine[5]:6.1f} times faster"
    )


def main() -> None:
    """Print the table."""
    engine()
    print(HEAD)
    for name, one in STIFF.items():
        for tolerance in (1e-4, 1e-6, 1e-8, 1e-10):
            compared(one.title, one, tolerance, tolerance * ABSOLUTE[name], one.reference)
    one, matrix = chain(MASSES, END), np.zeros((2 * MASSES, 2 * MASSES))
    matrix[:MASSES, MASSES:] = np.eye(MASSES)
    matrix[MASSES:, :MASSES] = 100.0 * (np.eye(MASSES, k=1) - 2.0 * np.eye(MASSES) + np.eye(MASSES, k=-1))
    exact = expm(matrix * END) @ np.array(one.start)
    compared(f"chain of {MASSES}", one, 1e-6, 1e-6, exact)
    compared("  scipy given its matrix", one, 1e-6, 1e-6, exact, matrix)


if __name__ == "__main__":
    main()
