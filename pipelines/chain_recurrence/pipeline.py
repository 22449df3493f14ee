"""The recurrence of a nonlinear chain: where its energy goes, how sure that is, and the linear chain beside it.

python pipelines/chain_recurrence/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """March a chain past its recurrence, refine the energies of its modes there, and take what couples them away."""
    model = xd.Model.from_toml(ROOT / study["model"])
    asked = {"method": study["method"], "until": study["until"], "compute": False}
    there = {"at": [study["recurrence"]], "observables": study["observables"]}
    chain = xd.simulate(model, **asked, step=study["step"], sizes={"step": study["rows"]})
    recurrence = xd.refine(model, **asked, **there, **study["refine"])
    linear = xd.limiting(model, **asked, **there, **study["limit"], step=study["step"])
    return xd.report(folder, chain=chain, recurrence=recurrence, linear=linear)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
