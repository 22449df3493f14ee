"""Refine a ball with drag: heights at common times, apex, landing with its budget, and the limit without drag.

python pipelines/ball_with_drag/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Refine over given steps, then until the landing is known; march that once more, and without drag."""
    model = xd.Model.from_toml(ROOT / study["model"])
    refinement = xd.refine(model, method=study["method"], **study["refine"], occurrences=1, compute=False)
    landing = xd.refine(model, method=study["method"], **study["landing"])
    asked = {"method": study["method"], "step": float(landing.step_size[-1]), "compute": False}
    ball = xd.simulate(model, sizes=study["sizes"], **asked)
    diagnosis = xd.diagnose(ball, occurrences=study["cycles"], compute=False)
    limit = xd.limiting(model, **study["limit"], method="dop853", rtol=1e-12, compute=False)
    known = xd.error_budget(model, **study["budget"], **asked)
    return xd.report(
        folder, refinement=refinement, landing=landing, ball=ball, diagnosis=diagnosis, limit=limit, budget=known
    )


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
