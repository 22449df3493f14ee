"""CPU seconds for a frame of films: of one body on a moving table, of two rods, of discs in a box.

python tests/benchmarks/film_speed.py
"""

from __future__ import annotations

import time
import warnings
from pathlib import Path

import xdynamics as xd

MODELS = Path(__file__).parents[2] / "data" / "models"
FRAMES = 100
FILMS = {"moving_table": "1 s", "double_pendulum": "2 s", "balls_in_box": "4 s"}


def main() -> None:
    """Print a line for each film."""
    warnings.simplefilter("ignore")
    for name, until in FILMS.items():
        run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), until=until)
        xd.animate(run, seconds=0.1)  # fonts, the states between rows
        begin = time.process_time()
        xd.animate(run, seconds=FRAMES / 25)
        print(f"{name:16} {(time.process_time() - begin) / FRAMES:.4f} CPU s a frame")


if __name__ == "__main__":
    main()
