"""March the rocket with three steps, archive and reproduce each, compare neighbours, draw the finest.

python pipelines/rocket_flight/pipeline.py [folder]
"""

import sys
import tomllib
from itertools import pairwise
from pathlib import Path

import xdynamics as xd
from xdynamics.evidence.comparison import lines_of
from xdynamics.summary import summary

HERE = Path(__file__).parent
ROOT = HERE.parents[1]


def main(folder: Path) -> None:
    """Run the study and leave its archives and its figure in a folder."""
    study = tomllib.loads((HERE / "study.toml").read_text())
    model = xd.Model.from_toml(ROOT / study["model"])
    archives = []
    for step in study["steps"]:
        run = xd.simulate(model, method=study["method"], step=step)
        archives.append(xd.save(run, folder / f"rocket_{step.replace(' ', '_')}.nc"))
        again = xd.reproduce(archives[-1])
        print(
            f"{archives[-1].name}: {'reproduced to the bit' if again.attrs['identical'] else again.attrs['first_difference']}"
        )
    for coarse, fine in pairwise(archives):
        print(f"\n{coarse.name} and {fine.name}")
        print("\n".join(lines_of(xd.compare(xd.open_run(coarse), xd.open_run(fine)))))
    finest = xd.open_run(archives[-1])
    xd.plot(finest, folder / "rocket.png")
    print("\n" + "\n".join(summary(finest)))


if __name__ == "__main__":
    target = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    target.mkdir(parents=True, exist_ok=True)
    main(target)
