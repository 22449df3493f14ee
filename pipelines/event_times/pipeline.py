"""Locate crossings of an oscillator with other steps, other root tolerances and another rule, each varied alone.

python pipelines/event_times/pipeline.py [folder]
"""

import sys
import tomllib
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import xdynamics as xd

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STUDY = tomllib.loads((HERE / "study.toml").read_text())


def errors(step: str, tolerance: str, rule: str) -> tuple[float, float, float]:
    """Largest error of an event time, and the largest parts of its uncertainty: bracket and interpolant."""
    statement = tomllib.loads((ROOT / STUDY["model"]).read_text()) | {"observables": {}}
    statement["events"] = {"c": {"function": STUDY["function"], "time_tolerance": tolerance, "root_state": rule}}
    run = xd.simulate(xd.Model(**statement), method=STUDY["method"], step=step, until=STUDY["until"])
    phase = np.arccos(0.3)
    exact = np.sort(np.concatenate([phase + 2 * np.pi * np.arange(9), -phase + 2 * np.pi * np.arange(1, 9)])) / 2
    off = np.abs(run.event_time.values - exact[: run.sizes["event"]]).max()
    return float(off), *(float(run[f"event_time_uncertainty_{part}"].max()) for part in ("bracket", "interpolation"))


def main(folder: Path) -> None:
    """Print three tables, and draw them."""
    steps, tolerances, rules = STUDY["steps"], STUDY["time_tolerances"], STUDY["rules"]
    by_rule = {rule: [errors(step, tolerances[-1], rule) for step in steps] for rule in rules}
    by_tolerance = [errors(steps[-1], one, rules[0]) for one in tolerances]
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.6), layout="constrained", sharey=True)
    sizes = [float(one.split()[0]) for one in steps]
    for rule, marker in zip(rules, "o^", strict=True):
        for step, (off, bracket, drift) in zip(steps, by_rule[rule], strict=True):
            print(f"step {step:7} {rule:12} error {off:.2e} s, bracket {bracket:.1e} s, interpolant {drift:.1e} s")
        left.loglog(sizes, [one[0] for one in by_rule[rule]], f"{marker}-", label=f"error, {rule}")
    left.loglog(sizes, [one[2] for one in by_rule[rules[1]]], "^:", color="grey", label="part of the interpolant")
    left.set_xticks(sizes, [one.split()[0] for one in steps], minor=False)
    left.set_xticks([], minor=True)
    left.set(xlabel="step (s)", ylabel="event time (s)", title="step and rule")
    for tolerance, (off, bracket, _) in zip(tolerances, by_tolerance, strict=True):
        print(f"time tolerance {tolerance:8} error {off:.2e} s, bracket {bracket:.1e} s")
    wide = [float(one.split()[0]) for one in tolerances]
    right.loglog(wide, [one[0] for one in by_tolerance], "o-", label="error")
    right.loglog(wide, [one[1] for one in by_tolerance], ":", color="grey", label="part of the bracket")
    right.set(xlabel="time tolerance (s)", title=f"time tolerance, step {steps[-1]}")
    for axes in (left, right):
        axes.legend(fontsize=8, frameon=False)
        axes.grid(visible=True, color="#e5e5e5")
    figure.savefig(folder / "event_times.png", dpi=130)


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    target.mkdir(parents=True, exist_ok=True)
    main(target)
