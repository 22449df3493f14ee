"""Boxes thrown on a floor at random, smooth or rough: what anyone writes first of a rigid body with contacts."""

from __future__ import annotations

from typing import Any

import numpy as np

import xdynamics as xd


def thrown_box(seed: int) -> xd.Model:
    """A box of 1 m by 0.6 m with a contact at each corner; every second one is rough, and two of four are pushed aside."""
    random = np.random.default_rng(seed)
    contacts: dict[str, dict[str, Any]] = {}
    for i, (x, y) in enumerate([(-1, -1), (1, -1), (1, 1), (-1, 1)]):
        height = f"({x}*a*sin(phi) + {y}*b*cos(phi))"
        contacts[f"corner{i}"] = {"gap": f"y + {height}", "restitution": "e"}
        if seed % 2:
            contacts[f"corner{i}"] |= {
                "tangential": "coulomb",
                "slip": f"v_x - v_phi/radian*{height}",
                "friction": "mu",
            }
    e, mu = random.choice([0.0, 0.2, 0.5, 0.8]), random.choice([0.1, 0.3, 0.6, 1.0])
    return xd.Model(
        name="box",
        coordinates={"x": "m", "y": "m", "phi": "rad"},
        parameters={"m": "2 kg", "a": "0.5 m", "b": "0.3 m", "e": repr(float(e)), "mu": repr(float(mu))},
        mass={"x": "m", "y": "m", "phi": "m*(a**2 + b**2)/3/radian**2"},
        forces={
            "weight": {"y": "-m*9.81*newton/kilogram"},
            "push": {"x": f"m*{0.5 * (seed % 4 > 1)}*newton/kilogram"},
        },
        contacts=contacts,
        initial={
            "x": "0 m",
            "y": f"{random.uniform(0.7, 1.2)} m",
            "phi": f"{random.uniform(-3, 3)} rad",
            "v_x": f"{random.normal()} m/s",
            "v_y": f"{random.normal()} m/s",
            "v_phi": f"{2 * random.normal()} rad/s",
        },
    )
