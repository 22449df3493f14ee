"""Refine a model rocket's flight, compare its two finest runs, budget its apogee, and reproduce the finest from its file.

python pipelines/rocket_flight/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Refine over the steps; march the two finest, compare them, and march the finest again from its archive."""
    model = xd.Model.from_toml(ROOT / study["model"])
    refinement = xd.refine(model, method=study["method"], steps=study["steps"], occurrences=1, compute=False)
    asked = {"method": study["method"], "compute": False}
    coarse, rocket = (xd.simulate(model, step=step, sizes=study["flight"], **asked) for step in study["steps"][-2:])
    comparison = xd.compare(coarse, rocket, **study["compared"], compute=False)
    apogee = xd.error_budget(model, step=study["steps"][-1], **study["apogee"], **asked)
    page = xd.report(folder, refinement=refinement, comparison=comparison, apogee=apogee, rocket=rocket)
    again = xd.reproduce(f"{folder}/rocket.nc").attrs["identical"]
    return f"{page}\nrocket.nc {'is reproduced to the bit' if again else 'differs'} from the file alone"


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
