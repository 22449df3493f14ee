"""Budget the calibration of a mass to first order, and by drawing: the worked example of JCGM 101:2008.

python pipelines/mass_calibration/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Budget the mass difference without draws and with them, and look at what each density does alone and together."""
    model = xd.Model.from_toml(ROOT / study["model"])
    linear = xd.error_budget(model, study["quantity"], at=study["at"], compute=False)
    drawn = xd.error_budget(model, study["quantity"], at=study["at"], draws=study["draws"], compute=False)
    return xd.report(folder, linear=linear, drawn=drawn, run=xd.simulate(model, compute=False))


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
