"""Coulomb's friction in contacts of many bodies: slopes, wheels, belts and pyramids in closed form, or as written out."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import ArrayLike, NDArray

import xdynamics as xd

Floats = NDArray[np.float64]
G = 9.81
RUBS = {"restitution": 0.0, "tangential": "coulomb"}
STEPS: dict[str, Any] = {"method": "velocity_verlet", "step": "5 ms"}


def each(unit: str, values: ArrayLike, dim: str = "disc") -> dict[str, Any]:
    """Return a parameter with a value for each element."""
    return {"dims": [dim], "value": np.asarray(values).tolist(), "unit": unit}


def given(unit: str, values: ArrayLike) -> dict[str, Any]:
    """Return starting values."""
    return {"unit": unit, "value": np.asarray(values, float).tolist()}


def blocks(tilt: Floats, mu: float, static: float, speed: float = 0.0, **more: Any) -> xd.Model:
    """Return blocks on slopes, x along each."""
    count = len(tilt)
    return xd.Model(
        name="slopes",
        dimensions={"disc": count},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        parameters={"m": "2 kg", "g": f"{G} m s-2", "mu": str(mu), "mu_s": str(static), "tilt": each("1", tilt)},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"x": "m*g*sin(tilt)", "y": "-m*g*cos(tilt)"}} | more.pop("forces", {}),
        contacts={
            "floor": {"gap": "y", "slip": "v_x", "friction": "mu", "static": "mu_s"} | RUBS | more.pop("floor", {})
        },
        initial={"x": given("m", 0 * tilt), "y": given("m", 0 * tilt), "v_x": given("m s-1", 0 * tilt + speed)},
        **more,
    )


def discs(x: ArrayLike, y: ArrayLike, floor: ArrayLike, pair: ArrayLike, **more: Any) -> xd.Model:
    """Return discs of radius 0.5 m and mass 1 kg that may turn, with friction on the floor and on each other."""
    count = len(np.asarray(x))
    turning = "R*(first(v_theta, pair) + second(v_theta, pair))"
    slip = f"((second(v_y, pair) - first(v_y, pair))*dx - (second(v_x, pair) - first(v_x, pair))*dy)/d - {turning}"
    return xd.Model(
        name="discs",
        dimensions={"disc": count},
        relations={"pair": {"of": "disc"}},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"}
        | {"theta": {"unit": "rad", "dims": ["disc"]}},
        parameters={"m": "1 kg", "g": f"{G} m s-2", "R": "0.5 m", "inertia": "0.125 kg m2"}
        | {"mu": each("1", floor), "mu_pair": each("1", pair)},
        mass={"x": "m", "y": "m", "theta": "inertia"},
        definitions={
            "dx": "second(x, pair) - first(x, pair)",
            "dy": "second(y, pair) - first(y, pair)",
            "d": "hypot(dx, dy)",
        },
        forces={"weight": {"y": "-m*g"}},
        contacts={
            "floor": {"gap": "y - R", "slip": "v_x + R*v_theta", "friction": "mu"} | RUBS | more.pop("floor_law", {}),
            "discs": {"gap": "d - 2*R", "slip": slip, "friction": "first(mu_pair, pair)"} | RUBS,
        },
        initial={"x": given("m", x), "y": given("m", y), "theta": given("rad", [0.0] * count)}
        | more.pop("initial", {}),
        **more,
    )


def in_row(run: xr.Dataset, row: int) -> xr.Dataset:
    """Return the links that are closed in a row."""
    return run[["closed_force", "closed_friction_force", "closed_force_residual"]].isel(
        closed=(run.closed_step == row % run.sizes["step"]).values
    )


def kinds(run: xr.Dataset, kind: str) -> NDArray[np.bool_]:
    """Return which events are of a kind."""
    words = run.event_kind.attrs["flag_meanings"].split()
    return np.asarray(run.event_kind.values == run.event_kind.attrs["flag_values"][words.index(kind)])


@pytest.mark.parametrize(("mu", "static"), [(0.5, 0.5), (0.4, 0.5)])
def test_blocks_on_slopes_stay_or_slide(mu: float, static: float) -> None:
    """Assert that a block stays up to atan(static), and beyond it accelerates with g*(sin - mu*cos), with its friction."""
    tilt = np.append(np.linspace(0.0, 0.9, 30), np.arctan(static) * np.array([1 - 1e-6, 1 + 1e-6]))
    run = xd.simulate(blocks(tilt, mu, static), until="0.2 s", log="full", **STEPS)
    slides = np.tan(tilt) > static
    pull = np.where(slides, G * (np.sin(tilt) - mu * np.cos(tilt)), 0.0)
    assert np.abs(run.x.values - pull * run.time.values[:, None] ** 2 / 2).max() < 1e-15
    last = in_row(run, -1)
    assert last.closed_force.values == pytest.approx(2 * G * np.cos(tilt), rel=1e-15)
    rubs = np.where(slides, mu * np.cos(tilt), np.sin(tilt))
    assert last.closed_friction_force.values == pytest.approx(-2 * G * rubs, rel=1e-14)
    assert np.abs(last.closed_force_residual.values).max() < 1e-14


def test_blocks_that_slide_come_to_rest() -> None:
    """Assert time and way of braking on a slope, after which blocks stick."""
    tilt = np.linspace(-0.3, 0.3, 26)
    run = xd.simulate(blocks(tilt, 0.5, 0.5, speed=1.0), until="0.6 s", log="full", **STEPS)
    brake = G * (0.5 * np.cos(tilt) - np.sin(tilt))
    sticks = kinds(run, "stick")
    assert sticks.sum() == 26
    order = np.argsort(run.event_disc.values[sticks])
    assert np.abs(run.event_time.values[sticks][order] - 1 / brake).max() < 2e-12
    assert np.abs(run.x.values[-1] - 1 / (2 * brake)).max() < 1e-12
    assert np.abs(run.v_x.values[-1]).max() == 0.0


@pytest.mark.dear
def test_wheels_that_slide_roll() -> None:
    """Assert that a sliding disc rolls with 2/3 of its speed after v/(3*mu*g), or backward with enough spin."""
    speed, mu = 2.0, 0.3
    spin = np.linspace(0.0, 18.0, 8)  # backward: v_x + R*v_theta is the slip
    start = {"v_x": given("m s-1", [speed] * 8), "v_theta": given("rad s-1", spin)}
    model = discs(3.0 * np.arange(8), [0.5] * 8, [mu] * 8, [mu] * 8, initial=start)
    run = xd.simulate(model, until="1.3 s", method="velocity_verlet", step="20 ms")
    sticks = kinds(run, "stick")
    order = np.argsort(run.event_disc.values[sticks])
    assert run.event_time.values[sticks][order] == pytest.approx((speed + spin / 2) / (3 * mu * G), abs=1e-11)
    # friction acts along the line of contact: v - R*omega/2 is kept
    rolls = (speed - spin / 4) * 2 / 3
    assert run.v_x.values[-1] == pytest.approx(rolls, abs=1e-12)
    assert run.v_theta.values[-1] == pytest.approx(-2 * rolls, abs=1e-12)


def test_discs_strike_a_rough_floor() -> None:
    """Assert the impulse of a disc that falls on a floor: mu times the normal one, or what lets it roll."""
    speed = np.linspace(0.2, 5.0, 8)
    mu, e, fall = 0.2, 0.5, 1.0
    start = {"v_x": given("m s-1", speed), "v_y": given("m s-1", [-fall] * 8)}
    law = {"restitution": e}
    model = discs(5.0 * np.arange(8), [0.5] * 8, [mu] * 8, [mu] * 8, initial=start, floor_law=law)
    run = xd.simulate(model, until="20 ms", method="velocity_verlet", step="20 ms")
    order = np.argsort(run.event_disc.values)
    assert kinds(run, "impact").sum() == 8
    normal = (1 + e) * fall
    rubs = np.minimum(mu * normal, speed / 3)
    assert run.event_impulse_first_y.values[order] == pytest.approx(normal, rel=1e-12)
    assert run.event_impulse_first_x.values[order] == pytest.approx(-rubs, rel=1e-12)
    assert run.event_impulse_first_theta.values[order] == pytest.approx(-rubs / 2, rel=1e-12)
    lost = fall**2 * (1 - e**2) / 2 + speed * rubs - rubs**2 * 3 / 2
    assert run.event_energy_lost.values[order] == pytest.approx(lost, rel=1e-11)
    assert float(run.event_impulse_residual.max()) < 1e-13


@pytest.mark.dear
def test_a_pyramid_stands_by_friction_alone() -> None:
    """Assert that three discs stand from friction tan(15 degrees) on each other and a third of that on the floor on."""
    height, apart = sqrt(3) / 2, np.repeat(5.0 * np.arange(3), 3)
    x, y = apart + np.tile([0.0, 1.0, 0.5], 3), np.tile([0.5, 0.5, 0.5 + height], 3)
    pair = 2 - sqrt(3)
    floor, between = pair / 3 * np.array([1.001, 0.999, 1.001]), pair * np.array([1.001, 1.001, 0.999])
    run = xd.simulate(discs(x, y, floor.repeat(3), between.repeat(3)), until="50 ms", log="full", **STEPS)
    moved = np.abs(run.x.values[-1] - x)
    assert moved[:3].max() < 1e-15
    assert moved[[3, 4, 6, 7]].min() > 1e-7
    stands = in_row(run, 0)
    assert stands.closed_force.values[:2] == pytest.approx(1.5 * G, rel=1e-13)
    assert np.abs(stands.closed_friction_force.values[:2]) == pytest.approx(1.5 * G * pair / 3, rel=1e-12)


@pytest.mark.dear
def test_a_pyramid_falls_as_one_that_is_written_out() -> None:
    """Assert that discs slide, roll and part as by contacts of few bodies, whose forces are solved for by elimination."""
    height = sqrt(3) / 2
    x, y = np.array([0.0, 1.0, 0.5]), np.array([0.5, 0.5, 0.5 + height])
    run = xd.simulate(
        discs([*x, 9.0, 11.0], [*y, 0.5, 0.5], [0.05] * 5, [0.1] * 5), until="0.1 s", method="dop853", rtol=1e-10
    )
    few = xd.simulate(discs(x, y, [0.05] * 3, [0.1] * 3), until="0.1 s", method="dop853", rtol=1e-10)
    assert "closed" in xd.complete(run).dims
    assert "closed_force_residual" not in few  # solved by elimination
    for name in ("x", "y", "theta", "v_x", "v_theta"):
        assert np.abs(run[name].values[-1, :3] - few[name].values[-1]).max() < 1e-10, name


def test_wheels_in_grooves_share_forces_of_least_norm() -> None:
    """Assert of thirty wheels in grooves of 45 degrees, where four forces hold three motions: N cos + T sin = m g/2, 3 T = N.

    Scaled by what each answers to itself, 1/m and 3/m, forces of least norm make N**2 + 3*T**2 least.
    """
    mass, half = np.geomspace(0.1, 10.0, 30), sqrt(0.5)
    at_rest, rubs = np.zeros(30), {"friction": "0.4"} | RUBS
    model = xd.Model(
        name="grooves",
        dimensions={"disc": 30},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"}
        | {"theta": {"unit": "rad", "dims": ["disc"]}},
        parameters={"m": each("kg", mass), "R": "0.5 m", "g": f"{G} m s-2", "c": repr(half)},
        mass={"x": "m", "y": "m", "theta": "m*R**2/2/radian**2"},
        forces={"weight": {"y": "-m*g"}},
        contacts={
            "left": {"gap": "c*(x + y)", "slip": "c*(v_x - v_y) + R*v_theta/radian"} | rubs,
            "right": {"gap": "c*(y - x)", "slip": "c*(v_x + v_y) + R*v_theta/radian"} | rubs,
        },
        initial={"x": given("m", at_rest), "y": given("m", at_rest), "theta": given("rad", at_rest)},
    )
    run = xd.simulate(model, until="15 ms", log="full", **STEPS)
    presses, rubbing = mass * G * 0.75 * half, mass * G * 0.25 * half
    for name, way in (("left", -1.0), ("right", 1.0)):
        assert np.abs(run[f"contact_force_{name}"].values[-1] / presses - 1.0).max() < 1e-12
        assert np.abs(way * run[f"friction_force_{name}"].values[-1] / rubbing - 1.0).max() < 1e-12
    assert max(np.abs(run[name].values).max() for name in ("x", "y", "theta")) < 1e-15


@pytest.mark.dear
def test_blocks_on_a_belt_stick_and_slip() -> None:
    """Assert every time at which blocks that springs hold back slip and stick again, with static above kinetic friction."""
    belt, k, m, mu, static = 0.1, 50.0, 2.0, 0.3, 0.4
    more = {"forces": {"spring": {"x": "-(50 * newton/metre)*x"}}, "floor": {"slip": "v_x - 0.1*metre/second"}}
    run = xd.simulate(blocks(np.zeros(25), mu, static, speed=belt, **more), until="3 s", method="dop853", rtol=1e-10)
    omega, far, middle = sqrt(k / m), static * m * G / k, mu * m * G / k
    # from x = far with the belt's velocity, an arc about `middle` until the velocity is that of the belt again
    ahead, half = far - middle, np.arctan2(far - middle, belt / omega)
    slip = 2 * (np.pi - half) / omega
    grip = 2 * ahead / belt
    begins = far / belt + np.arange(3) * (slip + grip)
    slips, sticks = kinds(run, "slip"), kinds(run, "stick")
    first = run.event_disc.values == 0
    ends = (begins + slip)[begins + slip < 3]
    assert run.event_time.values[slips & first] == pytest.approx(begins[begins < 3], abs=1e-8)
    assert run.event_time.values[sticks & first] == pytest.approx(ends, abs=1e-8)


@pytest.mark.dear
def test_a_run_with_friction_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    """Assert that blocks of which some slide are extended, saved and reproduced with the same friction."""
    model = blocks(np.linspace(-0.3, 0.3, 26), 0.4, 0.5, speed=0.3)
    fixed: dict[str, Any] = STEPS | {"log": "full", "time_tolerance": "1e-12 s"}
    whole = xd.simulate(model, until="0.1 s", nodes=["50 ms"], **fixed)
    longer = xd.extend(xd.simulate(model, until="50 ms", **fixed), until="0.1 s")
    assert 0 < kinds(whole, "stick").sum() < 26
    for name in ("x", "closed_force", "closed_friction_force", "closed_force_residual", "event_time"):
        assert np.array_equal(longer[name].values, whole[name].values), name
    xd.save(whole, tmp_path / "blocks.nc")
    assert xd.reproduce(tmp_path / "blocks.nc").attrs["identical"] == 1


def test_friction_below_zero_is_refused_in_words() -> None:
    """Assert the message on coefficients that friction cannot have."""
    run = xd.simulate(
        blocks(np.zeros(30), 0.5, 0.5, floor={"friction": "0.5 - x/metre", "static": "0.1"}), until="1 s", **STEPS
    )
    assert "the friction of contact 'floor' of disc 0 is 0.5" in run.attrs["run_outcome_text"]
