"""Normal modes of two coupled masses: one at a time, superposed, and without the coupling.

python pipelines/coupled_modes/pipeline.py [folder] [tcp://scheduler, or a number of processes]
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
    """Excite one mode at a time and diagnose it beside its own period; refine the superposition; take the coupling away."""
    model = xd.Model.from_toml(ROOT / study["model"])
    asked = {"method": study["method"], "until": study["until"], "compute": False}
    periods = xd.modes(model).period.values
    excited = [model.replace(initial=excitation) for excitation in study["excitations"].values()]
    runs = [xd.simulate(one, **asked, step=study["refine"]["steps"][-1]) for one in excited]
    names = study["excitations"]
    listed = {"occurrences": study["cycles"], "compute": False}
    modes = {
        name: xd.diagnose(run, reference=float(T), **listed) for name, run, T in zip(names, runs, periods, strict=True)
    }
    superposition = xd.refine(model, **asked, **study["refine"])
    uncoupled = xd.limiting(model, **study["limit"], **asked | {"method": "dop853", "rtol": 1e-11})
    return xd.report(folder, modes=modes, superposition=superposition, uncoupled=uncoupled)


if __name__ == "__main__":
    folder, *workers = sys.argv[1:] or ["results"]
    with xd.cluster(*workers):
        print(main(folder))
