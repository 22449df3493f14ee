"""Links that approach since others have come to rest at the same time: struck then, and not a moment later."""

from __future__ import annotations

import numpy as np

import xdynamics as xd

PLATES, HEIGHT, G, RISE = 13, 0.05, 9.81, 0.5
FALL = np.sqrt(2 * HEIGHT / G)  # the time that plates fall


def lifted() -> xd.Model:
    """Return plates that fall on a floor, and rams as heavy that rise to them from below, all at one time."""
    start = {"x": 0.0, "y": HEIGHT, "z": -RISE * FALL - HEIGHT, "v_x": 0.0, "v_y": 0.0, "v_z": RISE + G * FALL}
    return xd.Model(
        name="plates lifted from below as they land",
        dimensions={"plate": PLATES},
        coordinates={name: {"unit": "m", "dims": ["plate"]} for name in "xyz"},
        parameters={"m": "1 kg", "g": f"{G} m s-2"},
        mass=dict.fromkeys("xyz", "m"),
        forces={"weight": {"potential": "m*g*(y + z)"}},
        contacts={
            "floor": {
                "gap": "y",
                "restitution": 0.5,
                "rest_height": "0.1 m",
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": 0.3,
            },
            "lift": {"gap": "y - z", "restitution": 0.1, "rest_height": "1e-12 m"},
        },
        initial={
            name: {"unit": "m s-1" if name[0] == "v" else "m", "value": [value] * PLATES}
            for name, value in start.items()
        },
    )


def test_rams_strike_plates_that_come_to_rest() -> None:
    """Assert that plates and rams rest after one event, at its closed-form time, which takes all their kinetic energy.

    The floor's bounces are low enough to be skipped. A plate that it stops is struck again by its ram, which has risen with
    it, and so on, each time at 0.45 of the speed before.
    """
    run = xd.simulate(lifted(), method="velocity_verlet", step="60 ms", until="0.12 s", log="full")
    after = int(run.event_row_after.values[0])
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(run.event_time.values - FALL).max() < 1e-12
    assert np.unique(run.event_row_after.values).size == 1
    assert max(np.abs(run.v_y.values[after]).max(), np.abs(run.v_z.values[after]).max()) < 1e-12
    energy = PLATES * ((G * FALL) ** 2 + RISE**2) / 2
    assert abs(run.event_energy_lost.values.sum() - energy) < 1e-11 * energy
    assert np.abs(run.v_z.values[-1] + G * (0.12 - FALL)).max() < 1e-12
