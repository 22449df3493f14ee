"""Bifurcation diagram of an impact oscillator: stroboscopic sections over the driving frequency.

python pipelines/impact_oscillator_bifurcation/pipeline.py [folder] [tcp://scheduler, or a number of processes]
"""

import sys
import tomllib
from pathlib import Path
from typing import Any

import xdynamics as xd

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STUDY = tomllib.loads((HERE / "study.toml").read_text())


def main(folder: str, study: dict[str, Any] = STUDY) -> str:
    """Sweep the frequency, keep the sections behind the transient; take one member out, whole, and refine it."""
    model = xd.Model.from_toml(ROOT / study["model"])
    kept = {"keep": study["keep"], "occurrences": tuple(study["occurrences"])}
    diagram = xd.sweep(model, {"w": study["frequencies"]}, **kept, until=study["until"], check=0.02)
    one = model.replace(parameters={"w": study["looked_at"]})
    orbit = xd.simulate(one, until="20 s", sizes=study["sizes"], compute=False)
    refined = xd.refine(one, method="dop853", **study["refine"], compute=False)
    return xd.report(folder, diagram=diagram, orbit=orbit, refined=refined)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
