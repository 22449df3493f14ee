"""A thousand rockets with their flights in a folder or an object store, the extreme ones refined, the lowest budgeted.

python pipelines/cluster_study/pipeline.py [folder or s3://bucket/folder] [tcp://scheduler, or a number of processes]
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
    """March the members into the folder; refine the lowest and the highest, budget the lowest, report in one graph."""
    model = xd.Model.from_toml(ROOT / study["model"])
    built = xd.Draws(study["members"], study["drawn"], design="declared", seed=1)
    asked = {"keep": study["keep"], "log": study["log"], **study["march"]}
    rockets = xd.sweep(model, {"rocket": built}, path=f"{folder}/rockets", **asked)
    flights = xd.open_logs(rockets, study["times"], names=["y", "v_y"])
    heights = rockets.maximum_y.values
    extreme = {"lowest": int(heights.argmin()), "highest": int(heights.argmax())}
    models = {
        name: xd.Model.from_text(str(xd.member(rockets, rocket=k).model_toml.values)) for name, k in extreme.items()
    }
    refinements = {name: xd.refine(model, **study["refine"], compute=False) for name, model in models.items()}
    lowest = xd.error_budget(models["lowest"], **study["budget"], **study["march"], compute=False)
    return xd.report(folder, rockets=rockets, flights=flights, extremes=refinements, lowest=lowest)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
