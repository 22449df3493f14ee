"""Impacts of a bouncing ball by other steps, other root tolerances and another rule, each varied alone.

python pipelines/bouncing_ball_events/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Vary one thing after the other, and draw the ball itself."""
    model = xd.Model.from_toml(ROOT / study["model"])
    common = {key: study[key] for key in ("until", "observables", "at", "occurrences")}
    step, tolerance, rule = (
        xd.refine(model, **study[what], **common, compute=False) for what in ("step", "tolerance", "rule")
    )
    ball = xd.simulate(model, until=study["until"], sizes=study["sizes"], compute=False)
    return xd.report(folder, step=step, tolerance=tolerance, rule=rule, ball=ball)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
