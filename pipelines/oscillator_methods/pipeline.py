"""Energy, phase, amplitude and phase-space area of an oscillator by three methods.

python pipelines/oscillator_methods/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """March by each method, and diagnose each run beside the closed form; the report computes all in one graph."""
    model = xd.Model.from_toml(ROOT / study["model"])
    period = float(xd.modes(model).period[0])
    asked = {"step": study["step"], "until": study["until"], "compute": False}
    runs = {name: xd.simulate(model, method=name, **asked) for name in study["methods"]}
    sought = {"reference": period, "exact": study.get("exact"), "occurrences": study["cycles"], "compute": False}
    diagnoses = {name: xd.diagnose(run, **sought) for name, run in runs.items()}
    return xd.report(folder, run=runs, diagnosis=diagnoses)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
