"""Closed contacts whose force, grip or slip falls to zero within a step at whose end it holds again: found all the same.

What rests, held by forces that cancel, ends no run: tolerances have a floor from the terms, in all ways to march.
Slow slips beside links that strike in bursts: what friction ends at once stops, and nothing else does.

Thirty blocks on slopes or belts of their own; some fall, all others move slowly and may not be stopped by it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from math import asin, atan, cos, pi, sin, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.resting import CASES, METHODS, Resting, marched, marched_absolutely, resting
from xdynamics.documenting.summary import summary
from xdynamics.march.configuration import settings_for
from xdynamics.march.ensemble import march_many
from xdynamics.march.tolerances import ATOL_FLOORS, OF_TERMS
from xdynamics.schema import STICK

G = 9.81
OMEGA = 2 * pi / 0.1


def loaded(count: int, size: float, along: str, height: float = 1.0, omega: float = OMEGA) -> xd.Model:
    """Return blocks on a rough floor, or one, under a sinusoidal load upward or along it, of a share of the weight."""
    of = {"dims": ["block"]} if count else {}
    dimensions = {"dimensions": {"block": count}} if count else {}
    start, high = ({"unit": "m", "value": [value] * count} if count else f"{value} m" for value in (0.0, height))
    return xd.Model(
        name="loaded blocks",
        coordinates={name: {"unit": "m"} | of for name in "xy"},
        parameters={"m": "2 kg", "g": f"{G} m s-2", "size": f"{size!r}", "omega": f"{omega!r} s-1"},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-m*g"}, "load": {along: "m*g*size*sin(omega*t)"}},
        contacts={
            "floor": {
                "gap": f"y - {height!r}*metre",
                "restitution": 0.0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": 0.5,
            }
        },
        initial={"x": start, "y": high} | ({} if count else {"v_x": "0 m s-1", "v_y": "0 m s-1"}),
        **dimensions,
    )


def times_of(run: xr.Dataset, kind: str) -> np.ndarray:
    """Return the times of events of a kind."""
    words = run.event_kind.attrs["flag_meanings"].split()
    wanted = run.event_kind.values == run.event_kind.attrs["flag_values"][words.index(kind)]
    return np.asarray(run.event_time.values[wanted])


STEPS = [("velocity_verlet", 0.05), ("velocity_verlet", 0.033), ("rk4", 0.05), ("dop853", 0.049)]


@pytest.mark.every(4)
@pytest.mark.parametrize("height", [1.0, 0.0])
@pytest.mark.parametrize("count", [0, 30])
@pytest.mark.parametrize(("method", "step"), STEPS)
def test_a_floor_that_pulls_for_a_part_of_a_step_lets_go(method: str, step: float, count: int, height: float) -> None:
    """Assert the time, asin(1/size)/omega, at which blocks leave a floor that presses at the start and end of the step.

    In the origin, where nothing moves, no term of a gap or of its rate has a size that rounding could be measured by.
    """
    run = xd.simulate(loaded(count, 1.05, "y", height), method=method, step=step, until=0.049)
    leave = times_of(run, "takeoff")
    assert leave.size == max(count, 1)
    assert np.abs(leave - asin(1 / 1.05) / OMEGA).max() < 1e-11


@pytest.mark.every(2)
@pytest.mark.parametrize("count", [0, 30])
@pytest.mark.parametrize(("method", "step"), STEPS)
def test_a_grip_that_breaks_for_a_part_of_a_step_slips(method: str, step: float, count: int) -> None:
    """Assert the time, asin(friction/size)/omega, at which blocks slip that would stick at both ends of the step."""
    run = xd.simulate(loaded(count, 0.52, "x"), method=method, step=step, until=0.05)
    slip = times_of(run, "slip")
    assert slip.size == max(count, 1)
    assert np.abs(slip - asin(0.5 / 0.52) / OMEGA).max() < 1e-11
    assert times_of(run, "stick").size == max(count, 1)


def test_a_floor_that_nearly_pulls_holds() -> None:
    """Assert that a force which falls to a hundredth within a step is no take-off, and the steps are those of the grid."""
    run = xd.simulate(loaded(30, 0.99, "y"), method="velocity_verlet", step=0.05, until=0.1)
    assert run.sizes["event"] == 0
    assert run.time.values.tolist() == [0.0, 0.05, 0.1]
    assert np.abs(run.y.values - 1.0).max() < 1e-15


def pushed(excess: np.ndarray, middle: np.ndarray) -> xd.Model:
    """Return discs that roll on a floor, pushed so that friction would need to exceed its bound by a parabola of time.

    A disc that rolls needs a third of the push from friction; one that slides has a slip that accelerates by the push over
    the mass, less three times what friction gives.
    """
    count, number = middle.size, np.arange(middle.size)
    radius, speed = 0.05 + 0.02 * np.sin(2 * number) ** 2, 0.3 + 0.01 * number
    of = {"dims": ["disc"]}
    start = {
        "x": 0 * number,
        "y": radius,
        "theta": 0 * number,
        "v_x": speed,
        "v_y": 0 * number,
        "v_theta": -speed / radius,
    }
    units = {"x": "m", "y": "m", "theta": "rad", "v_x": "m s-1", "v_y": "m s-1", "v_theta": "rad s-1"}
    known = {"excess": (excess, "m s-2"), "middle": (middle, "s"), "radius": (radius, "m")}
    return xd.Model(
        name="discs that are pushed along a floor",
        dimensions={"disc": count},
        coordinates={name: {"unit": units[name]} | of for name in ("x", "y", "theta")},
        parameters={"m": "2 kg", "g": f"{G} m s-2", "k": "300 m s-4"}
        | {name: {"unit": unit, "value": values.tolist()} | of for name, (values, unit) in known.items()},
        mass={"x": "m", "y": "m", "theta": "m*radius**2/2/radian**2"},
        forces={"weight": {"y": "-m*g"}, "push": {"x": "m*(1.5*g + excess - k*(t - middle)**2)"}},
        contacts={
            "floor": {
                "gap": "y - radius",
                "restitution": 0.0,
                "tangential": "coulomb",
                "slip": "v_x + radius*v_theta/radian",
                "friction": 0.5,
            }
        },
        initial={name: {"unit": units[name], "value": values.tolist()} for name, values in start.items()},
    )


def shares() -> tuple[np.ndarray, np.ndarray]:
    """Return by how much thirty discs are pushed beyond rolling, and when most."""
    number = np.arange(30)
    return 0.5 + 0.3 * np.sin(number) ** 2, 0.2 + 0.01 * np.cos(3 * number) ** 2


def test_slips_that_begin_and_end_within_a_step() -> None:
    """Assert when each of thirty discs begins to slip, and when it rolls again, all within one step.

    The slip, from s = -(excess/k)^(1/2) about the middle on, is excess (s - s0) - k (s^3 - s0^3)/3, which is zero again at
    -2 s0. In a step at whose end one slip has ended, others that began before are found, too.
    """
    excess, middle = shares()
    run = xd.simulate(pushed(excess, middle), method="rk4", step=0.42, until=0.42)
    half = np.sqrt(excess / 300)
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(times_of(run, "slip") - np.sort(middle - half)).max() < 1e-11
    assert np.abs(times_of(run, "stick") - np.sort(middle + 2 * half)).max() < 1e-11


def test_what_rounding_leaves_of_a_slip_that_begins_is_no_end_of_it() -> None:
    """Assert when each disc begins to slip, once, with a slip that is zero to rounding while those of others end."""
    excess, middle = shares()
    run = xd.simulate(pushed(excess, middle), method="velocity_verlet", step=0.14, until=0.42)
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(times_of(run, "slip") - np.sort(middle - np.sqrt(excess / 300))).max() < 1e-11
    assert times_of(run, "stick").size == 30


def test_what_rested_beside_rounding_is_let_go() -> None:
    """Assert that a book's neighbour, at rest to 1e-22 m, says nothing of sizes when one of them begins to slip."""
    ramp = {"gravity": {"y": "-m*g"}, "pull": {"x": "k*t"}}
    books = xd.Model(
        name="two books",
        dimensions={"body": 2},
        coordinates={name: {"unit": "m", "dims": ["body"]} for name in "xy"},
        parameters={
            "m": "1.3 kg",
            "g": "9.81 m s-2",
            "mu": "0.4",
            "mu_s": "0.5",
            "k": {"value": [3.0, 3.2], "unit": "N s-1", "dims": ["body"]},
        },
        mass={"x": "m", "y": "m"},
        forces=ramp,
        initial={"x": "0 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
        contacts={
            "floor": {
                "gap": "y",
                "restitution": "0",
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "mu",
                "static": "mu_s",
            }
        },
    )
    run = xd.simulate(books, method="heun", until="3 s", rtol=4e-6, max_steps=50_000)
    assert run.attrs["run_outcome"] == "completed"
    for i, k in enumerate((3.0, 3.2)):
        start = 0.5 * 1.3 * 9.81 / k
        s = 3.0 - start
        speed = k * s**2 / 2.6 + 0.1 * 9.81 * s
        assert float(run.v_x[-1, i]) == pytest.approx(speed, rel=1e-4)


SECONDS = 1e-9  # from the closed form, at most
EVER_SMALLER = (
    "bogacki_shampine"  # by which a motion from zero takes hundreds of rows for each factor e, held before or not
)


def released(run: xr.Dataset) -> int:
    """Return the number of rows before the first event; all without one."""
    kinds = np.flatnonzero(run.row_kind.values == 3)
    return int(kinds[0]) + 1 if kinds.size else run.sizes["step"]


def check(case: Resting, run: xr.Dataset, other: xr.Dataset) -> None:
    """Assert that a run rests as long as it should, in not many more rows than one with an absolute tolerance."""
    assert run.attrs["run_outcome"] == "completed", run.attrs["run_outcome_text"]
    if math.isfinite(case.release):
        assert np.abs(run.event_time.values - case.release).min() <= SECONDS
    rows, others = (
        (released(run), released(other))
        if EVER_SMALLER in run.solver_method
        else (run.sizes["step"], other.sizes["step"])
    )
    assert rows <= 3 * others + 8  # of the first steps, each ten times the one before


@pytest.mark.every(4)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASES)
def test_what_rests_is_marched_to_its_release(name: str, method: str) -> None:
    """Assert that it is released on time by every method that takes it."""
    case = resting(name)
    if (run := marched(case, method)) is not None:
        check(case, run, marched_absolutely(case, method))


@pytest.mark.cases(840)
def test_random_bodies_rest(case: int) -> None:
    """Assert the same of twelve random sizes, slopes and growths of each kind, by seven methods."""
    rest, number = divmod(case, len(METHODS))
    seed, kind = divmod(rest, len(CASES))
    one = resting([*CASES][kind], seed)
    if (run := marched(one, METHODS[number])) is not None:
        check(one, run, marched_absolutely(one, METHODS[number]))


@pytest.mark.parametrize("method", ["implicit_midpoint", "velocity_verlet", "rk4"])
def test_step_doubling_marches_what_cancels(method: str) -> None:
    """Assert that methods without an embedded formula do, too, solved ones among them."""
    run = xd.simulate(resting("three").model, method=method, rtol=1e-8, until=2.0, estimator="step_doubling")
    assert (run.attrs["run_outcome"], run.sizes["step"] < 30) == ("completed", True)


def test_the_former_rule_dies() -> None:
    """Assert that without a floor the run ends, and that its sentence names the remedy besides a singularity."""
    run = xd.simulate(resting("lift").model, method="dormand_prince", rtol=1e-8, until=2.0, atol_floor="none")
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert "give z an atol" in run.attrs["run_outcome_text"]
    assert "atol_floor_rule" not in run.attrs


def test_the_rule_is_recorded_and_followed_again(tmp_path: Path) -> None:
    """Assert that a record says by which rule it was made, and is reproduced and extended by it."""
    case = resting("pull")
    for rule in ATOL_FLOORS:
        path = tmp_path / f"{len(ATOL_FLOORS[rule])}.nc"
        run = xd.simulate(
            case.model, method="dop853", rtol=1e-8, until=0.9 * case.release, atol_floor=rule, max_steps=100, path=path
        )
        assert run.attrs.get("atol_floor_rule", "") == ATOL_FLOORS[rule]
        assert xd.reproduce(path).attrs["identical"] == 1
    whole = xd.extend(path.with_stem(str(len(ATOL_FLOORS[OF_TERMS]))), until=case.until)
    assert whole.attrs["atol_floor_rule"] == ATOL_FLOORS[OF_TERMS]
    assert np.abs(whole.event_time.values - case.release).min() <= SECONDS


def test_given_tolerances_have_no_floor() -> None:
    """Assert that a record does not name the rule where no tolerance follows."""
    run = marched_absolutely(resting("lift"), "dop853")
    assert "atol_floor_rule" not in run.attrs


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
@pytest.mark.parametrize("name", ["three", "tank"])
def test_lanes_have_the_same_bits(name: str, method: str) -> None:
    """Assert that runs side by side are those alone, to the bit."""
    case, count = resting(name), 40
    settings = settings_for(case.model, method=method, rtol=1e-8, until=case.until)
    given = {"parameters": {"k": np.linspace(0.1, 8.0, count)}}
    alone, abreast = (march_many(case.model, settings, lanes=lanes, **given) for lanes in (1, 4))
    for result in ("time", "state", "status", "rows", "trials", "evaluations", "largest", "ends"):
        assert getattr(abreast, result).tobytes() == getattr(alone, result).tobytes(), result
    assert abreast.log_block.log.rows.tobytes() == alone.log_block.log.rows.tobytes()
    assert alone.ends["rows"].max() < 20


def row_of_three(count: int) -> xd.Model:
    """Return springs between walls, each as long as it is drawn, whose pulls cancel at every body."""
    return xd.Model(
        name="row",
        dimensions={"body": count},
        coordinates={"u": {"unit": "m", "dims": ["body"]}},
        parameters={"m": "2 kg", "k": "3 N s-1"},
        mass={"u": "m"},
        forces={"pulls": {"u": "(0.1*k*t + 0.2*k*t - 0.3*k*t)*(1 + index(body))"}},
        initial={"u": "0*metre", "v_u": "0*metre/second"},
    )


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
def test_elements_of_loops_rest(method: str) -> None:
    """Assert that forces that cancel at every element of a dimension end no run either."""
    run = xd.simulate(row_of_three(60), method=method, rtol=1e-8, until=2.0)
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] < 30


@pytest.mark.parametrize("rtol", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "taylor", "radau_iia"])
def test_nothing_loosens_where_motion_is_real(method: str, rtol: float) -> None:
    """Assert the bits of the former rule where of pulls that cancel a thousandth is left."""
    model = xd.Model(
        name="pulled",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg", "F": "1000 N", "k": "1 N m-1"},
        mass={"x": "m"},
        forces={"pulls": {"x": "F - 0.999*F - k*x"}},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    run, former = (xd.simulate(model, method=method, rtol=rtol, until=10.0, atol_floor=rule) for rule in ATOL_FLOORS)
    assert (run.sizes["step"], run.x.values.tobytes()) == (former.sizes["step"], former.x.values.tobytes())


GRAVITY = 9.80665
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
    return np.concatenate([np.zeros(10), GRAVITY * times**2 / 2.0])


def moved(mu: Any, slip: Any, across: str = "0*newton", until: str = "30 ms", **more: Any) -> xr.Dataset:
    """Return the run of blocks of 1 kg that slip at first, under a force along the floor."""
    model = xd.Model(
        name="blocks",
        dimensions={"block": 30},
        coordinates={name: {"unit": "m", "dims": ["block"]} for name in "xy"},
        parameters={"mu": each("1", mu, dims=["block"])} | more.pop("parameters", {}),
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"x": across, "y": f"-{GRAVITY}*newton"}},
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
    push = 0.3 * (1.0 + 1e-6) * GRAVITY
    run = moved(0.3, slip, f"{push!r}*newton")
    slow = run.isel(block=slice(0, 10))
    t, speeds_up = run.time.values[:, None], 0.3e-6 * GRAVITY
    wanted = slip[:10] * t + speeds_up * t * t / 2.0
    assert np.abs(slow.x.values - wanted).max() < 1e-13
    assert np.abs(slow.v_x.values - slip[:10] - speeds_up * t).max() < 1e-13


def test_slips_that_weak_brakes_end_go_on_until_then() -> None:
    """Assert of blocks just below the angle of friction that each slip lasts v/a, up to 0.1 s for 0.5 um, and then ends."""
    slip, brake = np.where(FALLING, 0.0, 1e-5 * (1 + np.arange(30))), 1e-3
    run = moved(0.3, slip, f"{0.3 * GRAVITY - brake!r}*newton")
    t, v = run.time.values[:, None], slip[:10]
    lasts = np.minimum(t, v / brake)
    assert np.abs(run.x.values[:, :10] - (v * lasts - brake * lasts**2 / 2.0)).max() < 1e-12
    ends = (run.event_kind.values == STICK) & (run.event_block.values < 3)
    assert run.event_time.values[ends] == pytest.approx(v[:2] / brake, rel=1e-7)


@pytest.mark.parametrize(("mu", "push"), [(1e-6, 1.4e-4), (0.3, 0.3 * GRAVITY - 5e-4)], ids=["speed up", "weak brake"])
def test_slips_that_an_impact_leaves_go_on(mu: float, push: float) -> None:
    """Assert that blocks that are struck slide on from 1e-5 m/s where they speed up, and where a brake would take 20 ms."""
    lands = sqrt(2e-3 / GRAVITY)
    run = moved(mu, mu * GRAVITY * lands + 1e-5 - push * lands, f"{push!r}*newton", start=np.full(30, 1e-3))
    on = float(run.time.values[-1]) - lands
    assert run.v_x.values[-1] == pytest.approx(np.full(30, 1e-5 + (push - mu * GRAVITY) * on), rel=1e-8)


@lru_cache
def landed() -> xr.Dataset:
    """Return the run of blocks that fall with slips of which impacts leave 1e-5 m/s."""
    fall = sqrt(2.0 * GRAVITY * 1e-3)
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
    assert run.friction_force_floor.values[ends][:, :5] == pytest.approx(0.3 * GRAVITY, rel=1e-9)


def test_blocks_in_a_box_that_tilts_slowly_slip_when_they_should() -> None:
    """Assert that with 0.01 rad/s a block slips from atan(mu)/rate on, as slowly as it speeds up then."""
    rate, mu = 0.01, np.where(FALLING, 0.5, 1e-4 * (0.5 + np.arange(30) / 10.0))
    run = moved(mu, 0.0, f"{GRAVITY}*newton*sin({rate}*t/second)")
    begins, end = np.arctan(mu[:10]) / rate, float(run.time.values[-1])
    t = np.maximum(end - begins, 0.0)
    # v' = g (sin(rate t) - mu), where the floor carries all the weight
    speed = GRAVITY * ((np.cos(rate * begins) - np.cos(rate * (begins + t))) / rate - mu[:10] * t)
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
        forces={"weight": {"x": f"{GRAVITY * sin(tilt)!r}*newton", "y": f"-{GRAVITY * cos(tilt)!r}*newton"}},
        contacts={"floor": {"gap": "y - R", "rest_height": f"{HEIGHT!r} m", **RUBS, "slip": "v_x - R*v_theta/radian"}},
        initial={"x": each("m", 0.0), "y": each("m", 0.1 + heights()), "theta": each("rad", 0.0)}
        | {"v_x": each("m s-1", speed), "v_theta": each("rad s-1", speed / 0.1)},
    )
    run = xd.simulate(model, method="velocity_verlet", step="1 ms", until="30 ms", log="full", force_samples="none")
    t, down = run.time.values[:, None], 2.0 / 3.0 * GRAVITY * sin(tilt)
    assert np.abs(run.x.values[:, :10] - speed[:10] * t - down * t * t / 2.0).max() < 1e-13
    assert tan(tilt) / 3.0 < 0.3
    assert atan(0.3) > tilt
