"""Basins of attraction of a magnetic pendulum: a million starts, and a look closer.

python pipelines/pendulum_basins/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """March every start until the pendulum hangs over one magnet; look closer; take one start out as a whole run."""
    model = xd.Model.from_toml(ROOT / study["model"])
    asked = {"keep": study["keep"], "until": study["until"]}
    basins = xd.sweep(model, {"initial_x": study["x"], "initial_y": study["y"]}, **asked)
    closer = xd.sweep(model, {f"initial_{name}": value for name, value in study["close"].items()}, **asked)
    start = {name: float(closer[name][0]) for name in ("initial_x", "initial_y")}
    return xd.report(folder, basins=basins, closer=closer, one=xd.member(closer, **start))


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
