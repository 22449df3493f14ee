"""Slow slips beside links that strike in bursts: what friction ends at once stops, and nothing else does.

Thirty blocks on slopes or belts of their own; some fall, all others move slowly and may not be stopped by it.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan, cos, sin, sqrt, tan
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.documenting.summary import summary
from xdynamics.schema import STICK

G = 9.80665
HEIGHT = 1e-6  # m: of bounces that may be skipped
FALLING = np.arange(30) >= 10  # the blocks that strike, in bursts of ten, 1 us after one another
RUBS: dict[str, Any] = {"restitution": 0.0, "tangential": "coulomb", "slip": "v_x", "friction": "mu"}


def each(unit: str, values: Any, **more: Any) -> dict[str, Any]:
    """Return a value for each block."""
    return {"unit": unit, "value": np.broadcast_to(values, 30).tolist(), **more}


def heights() -> Any:
    """Return from where blocks fall, so that ten land within 10 us, at 5 and at 15 ms."""
    k = np.arange(20)
    times = 5e-3 + 10e-3 * (k // 10) + 1e-6 * (k % 10)
    return np.concatenate([np.zeros(10), G * times**2 / 2.0])


def moved(mu: Any, slip: Any, across: str = "0*newton", until: str = "30 ms", **more: Any) -> xr.Dataset:
    """Return the run of blocks of 1 kg that slip at first, under a force along the floor."""
    model = xd.Model(
        name="blocks",
        dimensions={"block": 30},
        coordinates={name: {"unit": "m", "dims": ["block"]} for name in "xy"},
        parameters={"mu": each("1", mu, dims=["block"])} | more.pop("parameters", {}),
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"x": across, "y": f"-{G}*newton"}},
        contacts={"floor": {"gap": "y", "rest_height": f"{HEIGHT!r} m", **RUBS, **more.pop("floor", {})}}
        | more.pop("contacts", {}),
        initial={"x": each("m", 0.0), "y": each("m", more.pop("start", heights())), "v_x": each("m s-1", slip)},
    )
    run = xd.simulate(model, method="velocity_verlet", step="1 ms", until=until, log="full", force_samples="none")
    assert run.run_outcome == "completed"
    return run


def test_blocks_strike_in_bursts() -> None:
    """Assert that twenty blocks strike, eighteen of them within 1 us of the one before."""
    run = moved(0.3, 0.0)
    assert np.count_nonzero(np.abs(np.diff(np.unique(run.event_time.values)) - 1e-6) < 1e-9) == 18


def test_slips_that_speed_up_go_on() -> None:
    """Assert of blocks on slopes a millionth over the angle of friction, from rest and from 1e-5 m/s: x = v t + a t²/2."""
    slip = np.where(FALLING, 0.0, np.linspace(0.0, 1e-5, 30))
    push = 0.3 * (1.0 + 1e-6) * G
    run = moved(0.3, slip, f"{push!r}*newton")
    slow = run.isel(block=slice(0, 10))
    t, speeds_up = run.time.values[:, None], 0.3e-6 * G
    wanted = slip[:10] * t + speeds_up * t * t / 2.0
    assert np.abs(slow.x.values - wanted).max() < 1e-13
    assert np.abs(slow.v_x.values - slip[:10] - speeds_up * t).max() < 1e-13


def test_slips_that_weak_brakes_end_go_on_until_then() -> None:
    """Assert of blocks just below the angle of friction that each slip lasts v/a, up to 0.1 s for 0.5 um, and then ends."""
    slip, brake = np.where(FALLING, 0.0, 1e-5 * (1 + np.arange(30))), 1e-3
    run = moved(0.3, slip, f"{0.3 * G - brake!r}*newton")
    t, v = run.time.values[:, None], slip[:10]
    lasts = np.minimum(t, v / brake)
    assert np.abs(run.x.values[:, :10] - (v * lasts - brake * lasts**2 / 2.0)).max() < 1e-12
    ends = (run.event_kind.values == STICK) & (run.event_block.values < 3)
    assert run.event_time.values[ends] == pytest.approx(v[:2] / brake, rel=1e-7)


@pytest.mark.parametrize(("mu", "push"), [(1e-6, 1.4e-4), (0.3, 0.3 * G - 5e-4)], ids=["speed up", "weak brake"])
def test_slips_that_an_impact_leaves_go_on(mu: float, push: float) -> None:
    """Assert that blocks that are struck slide on from 1e-5 m/s where they speed up, and where a brake would take 20 ms."""
    lands = sqrt(2e-3 / G)
    run = moved(mu, mu * G * lands + 1e-5 - push * lands, f"{push!r}*newton", start=np.full(30, 1e-3))
    on = float(run.time.values[-1]) - lands
    assert run.v_x.values[-1] == pytest.approx(np.full(30, 1e-5 + (push - mu * G) * on), rel=1e-8)


@lru_cache
def landed() -> xr.Dataset:
    """Return the run of blocks that fall with slips of which impacts leave 1e-5 m/s."""
    fall = sqrt(2.0 * G * 1e-3)
    return moved(0.3, 0.3 * fall + 1e-5, start=np.full(30, 1e-3))


def test_slips_that_friction_ends_at_once_are_skipped_and_told() -> None:
    """Assert that slips of 1e-5 m/s, which friction ends within 17 pm, end at the impact, with their energy in rows and summary."""
    run = landed()
    sticks = run.event_kind.values == STICK
    assert np.count_nonzero(sticks | (run.event_energy_lost.values > 0.0)) > 0
    lost = run.event_energy_lost.values
    stops = lost[(lost > 0.0) & (lost < 1e-9)]
    assert stops == pytest.approx(0.5e-10, rel=1e-6)
    assert run.v_x.values[-1] == pytest.approx(0.0, abs=1e-20)
    assert np.unique(run.event_time.values).size == 1  # no event of its own for any slip
    assert any(line.startswith("stopped   30 motions") for line in summary(run))


def test_blocks_ride_on_a_belt_that_creeps() -> None:
    """Assert that blocks move with a belt of 1e-5 m/s, and those that a wall holds slip on it for ever, with all its friction."""
    held = np.arange(30) < 5
    run = moved(
        0.3,
        np.where(held | FALLING, 0.0, 1e-5),
        floor={"slip": "v_x - 1e-5*metre/second"},
        contacts={"wall": {"gap": "place - x", "restitution": 0.0}},
        parameters={"place": each("m", np.where(held, 0.0, 1.0), dims=["block"])},
    )
    t = run.time.values[:, None]
    assert np.abs(run.x.values[:, :5]).max() < 1e-15
    assert np.abs(run.x.values[:, 5:10] - 1e-5 * t).max() < 1e-15
    ends = run.row_kind.values == 1
    assert run.friction_force_floor.values[ends][:, :5] == pytest.approx(0.3 * G, rel=1e-9)


def test_blocks_in_a_box_that_tilts_slowly_slip_when_they_should() -> None:
    """Assert that with 0.01 rad/s a block slips from atan(mu)/rate on, as slowly as it speeds up then."""
    rate, mu = 0.01, np.where(FALLING, 0.5, 1e-4 * (0.5 + np.arange(30) / 10.0))
    run = moved(mu, 0.0, f"{G}*newton*sin({rate}*t/second)")
    begins, end = np.arctan(mu[:10]) / rate, float(run.time.values[-1])
    t = np.maximum(end - begins, 0.0)
    # v' = g (sin(rate t) - mu), where the floor carries all the weight
    speed = G * ((np.cos(rate * begins) - np.cos(rate * (begins + t))) / rate - mu[:10] * t)
    assert run.v_x.values[-1, :10] == pytest.approx(speed, rel=1e-3, abs=1e-12)
    assert (speed[:5] > 0.0).all()


def test_discs_roll_slowly_down() -> None:
    """Assert of discs that roll down a slope of 1e-4 rad from 1e-5 m/s, while others strike: two thirds of what slides."""
    tilt, speed = 1e-4, np.where(FALLING, 0.0, 1e-5)
    model = xd.Model(
        name="discs",
        dimensions={"disc": 30},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"}
        | {"theta": {"unit": "rad", "dims": ["disc"]}},
        parameters={"R": "0.1 m", "mu": "0.3"},
        mass={"x": "1*kilogram", "y": "1*kilogram", "theta": "0.5*kilogram*R**2/radian**2"},
        forces={"weight": {"x": f"{G * sin(tilt)!r}*newton", "y": f"-{G * cos(tilt)!r}*newton"}},
        contacts={"floor": {"gap": "y - R", "rest_height": f"{HEIGHT!r} m", **RUBS, "slip": "v_x - R*v_theta/radian"}},
        initial={"x": each("m", 0.0), "y": each("m", 0.1 + heights()), "theta": each("rad", 0.0)}
        | {"v_x": each("m s-1", speed), "v_theta": each("rad s-1", speed / 0.1)},
    )
    run = xd.simulate(model, method="velocity_verlet", step="1 ms", until="30 ms", log="full", force_samples="none")
    t, down = run.time.values[:, None], 2.0 / 3.0 * G * sin(tilt)
    assert np.abs(run.x.values[:, :10] - speed[:10] * t - down * t * t / 2.0).max() < 1e-13
    assert tan(tilt) / 3.0 < 0.3
    assert atan(0.3) > tilt
