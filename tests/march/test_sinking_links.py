"""Bodies at rest that others shift, as closed links are put back on their gaps: they stop at a wall, and do not sink into it."""

from __future__ import annotations

import numpy as np
import xarray as xr

import xdynamics as xd

RADIUS, AWAY, ANGLE, SPEED = 0.1, 1e-9, np.deg2rad(50.0), 0.8  # m, m, of the upper disc on the lower one, m/s


def slid() -> xr.Dataset:
    """Return the run of a disc that slides up over a heavy one, which friction holds 1 nm from a wall; six stand apart."""
    side, up = 2.0 * RADIUS * np.cos(ANGLE), 2.0 * RADIUS * np.sin(ANGLE)
    rest, far = [0.0] * 6, [5.0 + k for k in range(6)]
    model = xd.Model(
        name="slide",
        dimensions={"disc": 8},
        relations={"pair": {"of": "disc"}},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        parameters={
            "radius": f"{RADIUS} m",
            "wall": f"{-RADIUS - AWAY!r} m",
            "m": {"unit": "kg", "dims": ["disc"], "value": [30.0] + [1.0] * 7},
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-9.80665*m*metre/second**2"}},
        contacts={
            "floor": {"gap": "y - radius", "tangential": "coulomb", "slip": "v_x", "friction": "0.9", "restitution": 0},
            "left": {"gap": "x - radius - wall", "restitution": 0},
            "discs": {
                "gap": "hypot(second(x, pair) - first(x, pair), second(y, pair) - first(y, pair)) - 2*radius",
                "restitution": 0,
            },
        },
        initial={
            "x": {"unit": "m", "value": [0.0, side, *far]},
            "y": {"unit": "m", "value": [RADIUS, RADIUS + up, *[RADIUS] * 6]},
            "v_x": {"unit": "m s-1", "value": [0.0, -SPEED * np.sin(ANGLE), *rest]},
            "v_y": {"unit": "m s-1", "value": [0.0, SPEED * np.cos(ANGLE), *rest]},
        },
    )
    return xd.simulate(model, method="velocity_verlet", step="5 ms", until="50 ms")


def test_a_disc_at_rest_that_is_shifted_stops_at_a_wall() -> None:
    """Assert that it touches the wall in the first step and stays there, by one event; unhindered it would go 0.2 um on."""
    run = slid()
    assert run.attrs["run_outcome"] == "completed"
    gap = run["x"].values[:, 0] + AWAY
    assert gap[0] == AWAY
    assert np.abs(gap[2:]).max() <= 1e-16
    assert gap[1] >= -4e-12  # as far as a time of 1e-12 s goes at the speed of the other disc
    assert np.abs(run["v_x"].values[:, 0]).max() <= 1e-18
    words = [run[name].attrs["flag_meanings"].split() for name in ("event_detector", "event_kind")]
    named = zip(run["event_detector"].values, run["event_kind"].values, strict=True)
    assert [(words[0][d], words[1][k]) for d, k in named] == [("left", "rest")]
