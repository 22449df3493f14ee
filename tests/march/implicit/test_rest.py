"""Implicit steps from rest, where the derivative of v*hypot(v, w) by v is nought over nought and the force smooth."""

from __future__ import annotations

import math

import pytest

import xdynamics as xd
from xdynamics.methods.steppers import NEWTON, SIMPLIFIED

IMPLICIT = [name for name, method in xd.METHODS.items() if method.solver in (NEWTON, SIMPLIFIED)]
FALL = xd.Model(
    name="two bodies, one of which falls",
    dimensions={"body": 2, "axis": 2},
    coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
    parameters={"m": "1 kg", "c": "0.2 kg m-1", "g": "9 m s-2"},
    mass={"r": "m"},
    forces={
        "drag": {"r": "-c*v_r*norm(v_r, axis)"},
        "weight": {"r": "-m*g*index(axis)*index(body)"},
    },
    initial={"r": {"unit": "m", "value": [[0, 0], [1, 0]]}, "v_r": {"unit": "m s-1", "value": [[0, 0], [0, 0]]}},
)


def fallen(c: float, t: float) -> float:
    """How far a body of 1 kg falls from rest in a time, under 9 m/s2 and c v**2."""
    limit = math.sqrt(9.0 / c)
    return -(limit**2) / 9.0 * math.log(math.cosh(9.0 * t / limit))


@pytest.mark.parametrize("name", IMPLICIT)
def test_a_body_falls_from_rest_with_drag(name: str) -> None:
    """Assert the order of given steps from rest, by the closed form, beside a body that stays at rest."""
    errors = []
    for step in (1 / 8, 1 / 16):
        run = xd.simulate(FALL, method=name, step=step, until=1.0)
        assert run.attrs["run_outcome"] == "completed"
        assert not run.r.sel(body=0).any()
        errors.append(abs(float(run.r[-1, 1, 1]) - fallen(0.2, 1.0)))
    assert math.log2(errors[0] / errors[1]) > xd.METHODS[name].order - 0.1


def test_chosen_steps_fall_from_rest_in_lanes_as_alone() -> None:
    """Assert that runs side by side have the bits of each alone, and both the digits of the tolerance."""
    c = [0.1, 0.2, 0.3, 0.4]
    sweep = xd.sweep(FALL, {"c": c}, method="radau_iia", rtol=1e-8, until=1.0)
    for i, value in enumerate(c):
        run = xd.simulate(FALL.replace(parameters={"c": value}), method="radau_iia", rtol=1e-8, until=1.0)
        assert float(run.r[-1, 1, 1]) == pytest.approx(fallen(value, 1.0), rel=1e-8)
        assert float(sweep.end_r[i, 1, 1]) == float(run.r[-1, 1, 1])
