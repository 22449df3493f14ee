"""States inside steps of runs whose bodies lie on each other, or slide, by contacts of many links."""

from __future__ import annotations

from math import atan, cos, sin
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS

G = 9.81
METHODS: list[dict[str, Any]] = [
    {"method": "velocity_verlet", "step": "50 ms"},
    {"method": "dop853", "rtol": 1e-9},
]


def stack(count: int) -> xd.Model:
    """Return discs that lie on each other."""
    return xd.Model(
        name="stack",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"g": f"{G} m s-2", "m": "2 kg", "radius": "0.5 m"},
        mass={"r": "m"},
        forces={"weight": {"r": "-m*g*index(axis)"}},
        contacts={
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 2*radius", "restitution": 0.5},
            "floor": {"gap": "r - radius", "restitution": 0.5},
        },
        initial={"r": {"unit": "m", "value": [[2.0, k + 0.5] for k in range(count)]}},
    )


def blocks(friction: list[float], slope: float) -> xd.Model:
    """Return blocks on an incline, each with friction of its own."""
    return xd.Model(
        name="blocks",
        dimensions={"block": len(friction)},
        coordinates={"x": {"unit": "m", "dims": ["block"]}, "y": {"unit": "m", "dims": ["block"]}},
        parameters={
            "g": f"{G} m s-2",
            "m": "1 kg",
            "mu": {"dims": ["block"], "value": friction, "unit": "1"},
            "s": repr(sin(slope)),
            "c": repr(cos(slope)),
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"x": "m*g*s", "y": "-m*g*c"}},
        contacts={
            "incline": {
                "gap": "y",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "mu",
                "static": "mu",
            }
        },
        initial={"x": "0 m", "y": "0 m"},
    )


@pytest.mark.parametrize("asked", METHODS)
@pytest.mark.parametrize("rule", ["interpolant", "reintegrate"])
def test_discs_at_rest_stay_where_they_are_inside_steps(rule: str, asked: dict[str, Any]) -> None:
    """Assert that no disc falls between rows, where their contacts hold them."""
    run = xd.simulate(stack(10), until="1 s", **asked)
    inside = xd.sample(run, np.linspace(0.013, 0.97, 7), rule=rule)
    assert np.abs(inside.r.values - run.r.values[0]).max() < 1e-13
    assert np.abs(inside.v_r.values).max() < 1e-12
    assert np.nanmax(inside.error_r.values) < 1e-12


@pytest.mark.parametrize("asked", METHODS)
def test_blocks_stick_or_slide_inside_steps(asked: dict[str, Any]) -> None:
    """Assert that those with friction below the slope slide by its closed form, and the others stay."""
    slope = atan(0.5)
    friction = [0.1 + 0.03 * k for k in range(26)]  # 14 below
    run = xd.simulate(blocks(friction, slope), until="1 s", **asked)
    times = np.linspace(0.013, 0.97, 5)
    inside = xd.sample(run, times)
    rate = np.maximum(0.0, G * (sin(slope) - np.array(friction) * cos(slope)))
    assert inside.x.values == pytest.approx(rate * times[:, np.newaxis] ** 2 / 2, abs=1e-9)
    assert np.abs(inside.y.values).max() < 1e-12


@pytest.mark.parametrize("name", ["granular_box", "rough_pile"])
def test_steps_of_heaps_lead_to_their_next_rows(name: str) -> None:
    """Assert that a state a last bit before the end of a step is the row that it led to, as long as no impact follows."""
    run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), log="full")
    place = "r" if "r" in run else "y"
    time = run.time.values
    rows = np.flatnonzero(np.diff(time) > 1e-6)[::40]
    late = xd.sample(run, np.nextafter(time[rows + 1], 0.0))
    assert np.abs(late[place].values - run[place].values[rows + 1]).max() < 1e-12
