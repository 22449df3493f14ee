"""Work against precision: methods x steps x problems.

python pipelines/method_comparison/pipeline.py [folder] [tcp://scheduler, or a number of processes]
"""

import sys
import tomllib
from math import cos
from pathlib import Path
from typing import Any

import xdynamics as xd

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STUDY = tomllib.loads((HERE / "study.toml").read_text())
CLOSED = {"cos(16)": cos(16.0)}


def main(folder: str, study: dict[str, Any] = STUDY) -> str:
    """Sweep methods and steps over every problem; set errors against force evaluations, and judge each method's levels."""
    axes, found = {"method": study["methods"], "step": study["steps"]}, {}
    for name, problem in study["problems"].items():
        grid = xd.sweep(xd.Model.from_toml(ROOT / problem["model"]), axes, until=problem["until"])
        exact = {number: CLOSED[closed] for number, closed in problem["exact"].items()}
        found |= {f"{name}_work": xd.precision(grid, exact=exact), f"{name}_orders": xd.convergence(grid, "step")}
        found[f"{name}_methods"] = xd.contrast(grid, "method", reference=study["methods"][-1])
    return xd.report(folder, **found)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
