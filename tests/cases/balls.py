"""Elastic balls in a box."""

from __future__ import annotations

import numpy as np

import xdynamics as xd


def balls(side: int, *, radius: float, seed: int) -> xd.Model:
    """Return equal elastic balls of 1 kg on a cubic lattice in a box of 1 m, with random velocities of some 1 m/s."""
    count, contact = side**3, {"restitution": 1}
    places = (np.stack(np.unravel_index(np.arange(count), (side,) * 3), axis=1) + 0.5) / side
    speeds = np.random.default_rng(seed).normal(size=(count, 3))
    return xd.Model(
        name="balls",
        dimensions={"ball": count, "axis": ["x", "y", "z"]},
        relations={"pair": {"of": "ball"}},
        coordinates={"r": {"unit": "m", "dims": ["ball", "axis"]}},
        parameters={"m": "1 kg", "radius": f"{radius!r} m"},
        mass={"r": "m"},
        contacts={
            "low": {"gap": "r - radius", **contact},
            "high": {"gap": "metre - radius - r", **contact},
            "balls": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", **contact},
        },
        initial={
            "r": {"unit": "m", "value": places.tolist()},
            "v_r": {"unit": "m s-1", "value": speeds.tolist()},
        },
    )
