"""Range, height and time of flight of a thrown ball over its angle and its drag, and what they depend on.

python pipelines/drag_grid/pipeline.py [folder] [tcp://scheduler, or a number of processes]
"""

import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

import xdynamics as xd

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
STUDY = tomllib.loads((HERE / "study.toml").read_text())


def main(folder: str, study: dict[str, Any] = STUDY) -> str:
    """March every angle with every drag; look at slopes, and at whose share of the range's variance is whose."""
    model = xd.Model.from_toml(ROOT / study["model"])
    angles, drags = (np.linspace(one["first"], one["last"], one["count"]) for one in (study["angle"], study["drag"]))
    speeds = [study["speed"] * turned(np.radians(angles)) for turned in (np.cos, np.sin)]
    throws = {"angle": angles, "v_x": speeds[0], "v_y": speeds[1]}
    grid = xd.sweep(model, {"angle": throws, "c": drags}, keep=study["keep"], rtol=study["rtol"], check=0.01)
    slopes, shares = xd.sensitivities(grid), xd.influences(grid, compute=False)
    indices = xd.sobol_indices(model, study["indices"], "end_x", draws=512, rtol=study["rtol"], compute=False)
    return xd.report(folder, ranges=grid, slopes=slopes, shares=shares, indices=indices)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
