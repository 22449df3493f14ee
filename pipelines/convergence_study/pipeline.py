"""Refine one model by several methods: observed orders, limits, uncertainties.

python pipelines/convergence_study/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Refine by each method, and hold each against the exact cases."""
    model = xd.Model.from_toml(ROOT / study["model"])
    refinements = {
        method: xd.refine(model, method=method, **study["refine"], compute=False) for method in study["methods"]
    }
    ledger = xd.validate(study["methods"], compute=False)
    return xd.report(folder, refinement=refinements, ledger=ledger)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
