"""Work against precision: the error of the final state over force evaluations and over time, as a picture.

python tests/benchmarks/work_precision.py [picture.png] [--problems kepler pleiades …] [--methods midpoint …]

Adaptive methods are swept over tolerances, fixed-step methods over steps; a method that is not registered or that
refuses a problem is left out with a sentence. Time is that of `March.blocks` of a march whose law is compiled, the
least of three: the compiled march with its log, without the Dataset made of it. Errors are against the references of
`adaptive_problems.py`.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from adaptive_problems import PROBLEMS, Benchmark

import xdynamics as xd
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.methods import METHODS

if TYPE_CHECKING:
    import xarray as xr

ADAPTIVE = ("bogacki_shampine", "dormand_prince", "dop853", "dprkn6", "radau_iia")
STIFF = "radau_iia"  # left to the stiff problems
FIXED = ("velocity_verlet", "kahan_li8")
TOLERANCES = tuple(10.0**-k for k in range(3, 14, 2))
STEPS = tuple(100 * 4**k for k in range(7))  # of a whole run, 100 to 409 600
MOST_STEPS = 30_000  # that an explicit method may take on a stiff problem
MOST_SECONDS = 0.3  # of one march: a sweep ends with the first that takes longer
WORST = 1.0  # larger errors are not shown


@dataclass(frozen=True)
class Point:
    """One march: its error, force evaluations and seconds."""

    error: float
    evaluations: int
    seconds: float


def adaptive_settings(benchmark: Benchmark, method: str, tolerance: float) -> dict[str, object]:
    """Return the keywords of an adaptive march."""
    asked: dict[str, object] = {"method": method, "rtol": tolerance, "atol": tolerance, "until": benchmark.end}
    return asked | {"max_steps": MOST_STEPS}


def fixed_settings(benchmark: Benchmark, method: str, steps: int) -> dict[str, object]:
    """Return the keywords of a march in equal steps."""
    return {"method": method, "step": benchmark.end / steps, "until": benchmark.end}


def evaluations_of(run: xr.Dataset, method: str) -> int:
    """Return the force evaluations of a run, those of rejected trials included where the record tells them."""
    told = run.attrs.get("run_force_evaluations")
    return int(told) if told is not None else (run.sizes["step"] - 1) * METHODS[method].evaluations


def march_seconds(model: xd.Model, asked: dict[str, object]) -> float:
    """Return the seconds of the compiled march alone, its law compiled before."""
    march = March(model, settings_for(model, force_samples="none", **asked))
    assert march.run.address  # posed, its law compiled
    begin = time.perf_counter()
    for _ in march.blocks():
        pass
    return time.perf_counter() - begin


def point(benchmark: Benchmark, model: xd.Model, asked: dict[str, object]) -> Point | None:
    """March once for the record and three times for the time; nothing where the run does not end well."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.StabilityWarning)  # the longest steps are meant to be too long
        run = xd.simulate(model, force_samples="none", **asked)
    if run.attrs["run_outcome"] != "completed":
        return None
    seconds = min(march_seconds(model, asked) for _ in range(3))
    return Point(benchmark.error(benchmark.last_of(run)), evaluations_of(run, str(asked["method"])), seconds)


def sweep(benchmark: Benchmark, method: str) -> list[Point]:
    """March from the coarsest to the finest, until one takes too long.

    Raises
    ------
    InputError
        If the method refuses the model.
    """
    model, points = benchmark.model(), []
    if method in ADAPTIVE:
        asked: Iterable[dict[str, object]] = (
            adaptive_settings(benchmark, method, tolerance) for tolerance in TOLERANCES
        )
    else:
        asked = (fixed_settings(benchmark, method, step) for step in STEPS)
    for one in asked:
        found = point(benchmark, model, one)
        if found is None or not math.isfinite(found.error):
            continue
        points.append(found)
        if found.seconds > MOST_SECONDS:
            break
    return points


def lack(method: str) -> str:
    """Say why a method cannot be swept at all; nothing if it can."""
    return "" if method in METHODS else "is not registered"


def sweeps(problems: Iterable[str], methods: Iterable[str]) -> dict[str, dict[str, list[Point]]]:
    """Sweep every method over every problem, saying what is left out."""
    methods = list(methods)
    for method in methods:
        if lack(method):
            print(f"{method} {lack(method)}: left out")
    ready = [method for method in methods if not lack(method)]
    found: dict[str, dict[str, list[Point]]] = {}
    for problem in problems:
        found[problem] = {}
        for method in ready:
            if method == STIFF and not PROBLEMS[problem].stiff:
                continue
            try:
                found[problem][method] = sweep(PROBLEMS[problem], method)
            except InputError as error:
                print(f"{problem}: {method} is left out: {error}")
    return found


def report(found: dict[str, dict[str, list[Point]]]) -> None:
    """Print every point."""
    print(f"{'':34} {'error':>9} {'evaluations':>12} {'us':>11}")
    for problem, methods in found.items():
        for method, points in methods.items():
            for one in points:
                print(f"{problem:16} {method:17} {one.error:9.1e} {one.evaluations:12} {one.seconds * 1e6:11.1f}")


def draw(found: dict[str, dict[str, list[Point]]], path: Path) -> None:
    """Draw a row of two diagrams for every problem: over evaluations and over time."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    figure, axes = plt.subplots(
        len(found), 2, figsize=(9, 3.2 * len(found)), squeeze=False, sharey="row", layout="constrained"
    )
    colours = {method: f"C{i}" for i, method in enumerate((*ADAPTIVE, *FIXED))}
    for row, (problem, methods) in zip(axes, found.items(), strict=True):
        for method, points in methods.items():
            shown = [one for one in points if 0.0 < one.error < WORST]
            look = {"label": method, "color": colours.get(method), "marker": "o", "ms": 3, "lw": 1}
            look["ls"] = "-" if method in ADAPTIVE else "--"
            row[0].loglog([one.evaluations for one in shown], [one.error for one in shown], **look)
            row[1].loglog([one.seconds * 1e3 for one in shown], [one.error for one in shown], **look)
        row[0].set(title=PROBLEMS[problem].title, ylabel="error of the final state", xlabel="force evaluations")
        row[1].set(xlabel="time / ms")
        row[1].xaxis.set_minor_formatter(NullFormatter())
        for one in row:
            one.grid(alpha=0.3)
    handles = {label: line for row in axes for line, label in zip(*row[0].get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles, loc="outside upper center", ncols=5, frameon=False)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Sweep, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", type=Path, default=Path("work_precision.png"))
    parser.add_argument("--problems", nargs="+", choices=PROBLEMS, default=list(PROBLEMS))
    parser.add_argument("--methods", nargs="+", default=[*ADAPTIVE, *FIXED])
    asked = parser.parse_args()
    found = sweeps(asked.problems, asked.methods)
    report(found)
    draw(found, asked.picture)


if __name__ == "__main__":
    main()
