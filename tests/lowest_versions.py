"""The lowest versions that pyproject.toml allows, in an environment of their own: each verb runs, and the bits are those of here.

Run as ``python tests/lowest_versions.py [FOLDER]``, before a release. It takes some minutes, as the engine is compiled anew.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
MODELS = ROOT / "data" / "models"
YANKED = {"netCDF4": "1.7.1.post1"}  # in the place of a version that its authors withdrew
COMMANDS = [
    "check {model}",
    "run {model} -o run.nc",
    "show run.nc",
    "plot run.nc -o run.png",
    "table run.nc -o run.csv",
    "diagnose run.nc",
    "validate run.nc",
    "reproduce run.nc",
    "refine {model} --step 0.01",
    "sweep {model} --axis e=0.5:0.9:3 -o sweep",
]
DIGEST = "import sys, xdynamics as xd; print(xd.content_digest(xd.simulate(xd.Model.from_toml(sys.argv[1]))))"


def lowest() -> list[str]:
    """Return each dependency at the lowest version that is declared."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    pairs = [re.split(">=", one) for one in declared]
    return [f"{name}=={YANKED.get(name, version)}" for name, version in pairs]


def main(folder: Path) -> int:
    """Install, run every verb, and compare digests; return how many failed."""
    python, model = folder / "venv" / "bin" / "python", str(MODELS / "bouncing_ball.toml")
    subprocess.run([sys.executable, "-m", "venv", str(folder / "venv")], check=True)
    subprocess.run([str(python), "-m", "pip", "install", "-q", *lowest()], check=True)
    surroundings = {**os.environ, "HOME": str(folder), "PYTHONPATH": str(ROOT / "src")}
    failed = 0
    for command in COMMANDS:
        words = command.format(model=model).split()
        done = subprocess.run(
            [str(python), "-m", "xdynamics", *words],
            cwd=folder,
            env=surroundings,
            capture_output=True,
            text=True,
            check=False,
        )
        failed += done.returncode != 0
        print(f"{'failed' if done.returncode else 'ran   '}  xdynamics {' '.join(words[:1])}")
        if done.returncode:
            print(done.stderr[-400:])
    digests = {
        subprocess.run([it, "-c", DIGEST, model], env=surroundings, capture_output=True, text=True, check=True).stdout
        for it in (str(python), sys.executable)
    }
    print("the same bits" if len(digests) == 1 else f"other bits: {digests}")
    return failed + (len(digests) != 1)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(made)))
