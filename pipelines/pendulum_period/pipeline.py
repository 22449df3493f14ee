"""Fit a pendulum to a bench record, and budget the end of its tenth swing with what was found.

python pipelines/pendulum_period/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Fit, march the fitted model, compare it with the record, and budget one time by its correlated parameters."""
    model = xd.Model.from_toml(ROOT / study["model"])
    fit = xd.fit(model, HERE / study["record"], study["parameters"])
    fitted = xd.Model.from_text(fit.model_toml.values.item())
    run = xd.simulate(fitted, sizes=study["sizes"], compute=False)
    comparison = xd.compare(run, HERE / study["record"], compute=False)
    period = xd.error_budget(fitted, **study["number"], compute=False)
    return xd.report(folder, fit=fit, comparison=comparison, period=period, run=run)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
