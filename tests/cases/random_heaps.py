"""Heaps of rough discs at random, marched by time-stepping, and the laws that any of them obeys in every step."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

import xdynamics as xd

Floats = NDArray[np.float64]
PILE = Path(__file__).parents[2] / "data/models/rough_pile.toml"
G, DENSITY = 9.80665, 25.0
STEP, UNTIL = 1e-3, 0.6


@dataclass(frozen=True)
class Heap:
    """Rough discs above the floor of a box, each with its radius, in rows that are a little off."""

    radius: Floats
    x: Floats
    y: Floats
    speed: Floats
    width: float
    mu: float

    @classmethod
    def at_random(cls, seed: int) -> Heap:
        """Between 20 and 90 discs, whose masses differ by a factor of up to eight."""
        random = np.random.default_rng(seed)
        count, across = int(random.integers(20, 90)), int(random.integers(4, 10))
        pitch, places = 0.115, np.arange(count)
        x = pitch * (places % across + 0.55) + random.uniform(-5e-3, 5e-3, count)
        y = pitch * (places // across + 0.55) + random.uniform(-5e-3, 5e-3, count)
        return cls(
            radius=random.uniform(0.025, 0.05, count),
            x=x,
            y=y,
            speed=random.normal(size=(3, count)),
            width=pitch * (across + 0.1),
            mu=float(random.choice([0.0, 0.1, 0.4, 0.9])),
        )

    @property
    def mass(self) -> Floats:
        """Of each disc, in kg."""
        return DENSITY * np.pi * self.radius**2

    def mirrored(self) -> Heap:
        """The heap as a mirror shows it."""
        return replace(self, x=self.width - self.x, speed=self.speed * np.array([[-1.0], [1.0], [-1.0]]))

    def permuted(self, order: NDArray[np.int64]) -> Heap:
        """The heap with its discs in another order."""
        return replace(self, radius=self.radius[order], x=self.x[order], y=self.y[order], speed=self.speed[:, order])

    def run(self) -> xr.Dataset:
        """Its motion."""
        statement = tomllib.loads(PILE.read_text())

        def of_discs(unit: str, values: Floats) -> dict[str, Any]:
            return {"unit": unit, "value": values.tolist()}

        statement["dimensions"] = {"disc": len(self.radius)}
        statement["parameters"] |= {
            "mu": repr(self.mu),
            "width": f"{self.width!r} m",
            "radius": {"dims": ["disc"], **of_discs("m", self.radius)},
        }
        statement["initial"] = {
            "x": of_discs("m", self.x),
            "y": of_discs("m", self.y),
            "theta": of_discs("rad", 0.0 * self.x),
            "v_x": of_discs("m s-1", self.speed[0]),
            "v_y": of_discs("m s-1", self.speed[1]),
            "v_theta": of_discs("rad s-1", self.speed[2]),
        }
        del statement["run"], statement["figure"]
        model = xd.Model(**statement)
        return xd.simulate(
            model, method="moreau_jean", step=f"{STEP!r} s", until=f"{UNTIL!r} s", log="full", force_samples="none"
        )
