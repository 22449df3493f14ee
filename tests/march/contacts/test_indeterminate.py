"""Bodies that rest on more than holds them: how forces are shared, when they slip, and that nothing else moves."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray

import xdynamics as xd
from xdynamics.evidence.observables import evaluate_at_states
from xdynamics.expressions import Name
from xdynamics.march.configuration import settings_for
from xdynamics.march.memory import final_numbers, go_on_from_end
from xdynamics.march.runner import March

Floats = NDArray[np.float64]
METHODS = [("dormand_prince", {"rtol": 1e-8}), ("rk4", {"step": "2 ms"}), ("taylor", {"rtol": 1e-8})]
G, MASS = 9.81, 2.0
SEEDS = [0, 1, 2, 13, *(pytest.param(seed, marks=pytest.mark.dear) for seed in range(3, 40) if seed != 13)]


def table(feet: Floats, load: str, at: tuple[str, str], restitution: float = 0.0) -> xd.Model:
    """A plate of 2 kg and 1 kg m2 on feet, whose positions are rows of two numbers in m, with a load at a place that may move."""
    (u, w) = (f"({x})*metre" for x in at)
    return xd.Model(
        name="table",
        coordinates={"z": "m", "p": "rad", "q": "rad"},
        parameters={"m": "2 kg", "g": "9.81 m s-2", "J": "1 kg m2", "F": load},
        mass={"z": "m", "p": "J/radian**2", "q": "J/radian**2"},
        forces={"weight": {"z": "-m*g"}, "load": {"z": "-F", "p": f"-F*{u}/radian", "q": f"-F*{w}/radian"}},
        contacts={
            f"foot{i}": {"gap": f"z + {x!r}*p*metre/radian + {y!r}*q*metre/radian", "restitution": restitution}
            for i, (x, y) in enumerate(feet.tolist())
        },
        initial={"z": "0 m", "p": "0 rad", "q": "0 rad"},
    )


def shares(feet: Floats, load: float, at: tuple[float, float]) -> Floats:
    """Forces of feet that all give way alike: those of least norm, in the scale of what each answers to itself."""
    balance = np.vstack([np.ones(len(feet)), feet.T])
    give = 1 / MASS + (feet**2).sum(axis=1)
    wanted = np.array([MASS * G + load, load * at[0], load * at[1]])
    return balance.T / give[:, np.newaxis] @ np.linalg.solve(balance / give @ balance.T, wanted)


def forces(run: Any, count: int) -> Floats:
    return np.stack([run[f"contact_force_foot{i}"].values for i in range(count)])


@pytest.mark.parametrize(("method", "settings"), METHODS)
def test_each_of_four_feet_bears_a_quarter(method: str, settings: dict[str, Any]) -> None:
    feet = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
    run = xd.simulate(table(feet, "0 N", ("0", "0")), method=method, until="0.5 s", **settings)
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["event"] == 0
    assert_allclose(forces(run, 4), MASS * G / 4, rtol=1e-14)
    assert not run["z"].any()
    assert "least norm" in run.attrs["solver_contact_arithmetic"]


def test_shares_are_of_least_norm_in_any_order_in_rows_and_between() -> None:
    feet = np.array([[-1.0, 0.1], [0.2, 0.7], [0.5, -0.6], [1.0, 0.3], [-0.2, -0.5]])
    at, times = ("0.3*sin(3*t/second)", "0.2*cos(2*t/second)"), np.array([0.111, 0.5, 0.77])
    for order in ([0, 1, 2, 3, 4], [3, 0, 4, 2, 1]):
        model = table(feet[order], "30 N", at)
        run = xd.simulate(model, method="dormand_prince", rtol=1e-8, until="1 s")
        assert run.attrs["run_outcome"] == "completed"
        assert run.sizes["event"] == 0
        for t, found in zip(run["time"].values, forces(run, 5).T, strict=True):
            place = 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t)
            assert_allclose(found, shares(feet[order], 30.0, place), rtol=1e-12)
        states = xd.sample(run, times)
        inside = evaluate_at_states(
            run,
            model,
            [Name(f"contact_force_foot{i}") for i in range(5)],
            {name: states[name].values for name in ("z", "p", "q", "v_z", "v_p", "v_q")},
            times,
            np.searchsorted(run["time"].values, times) - 1,
        )
        for t, found in zip(times, np.array(inside).T, strict=True):
            place = 0.3 * np.sin(3 * t), 0.2 * np.cos(2 * t)
            assert_allclose(found, shares(feet[order], 30.0, place), rtol=1e-12)


def test_a_foot_that_bears_nothing_takes_off_where_its_share_ends() -> None:
    feet = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
    model = table(feet, "30 N", ("t/second", "t/second"))
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="0.45 s")
    assert run.attrs["run_outcome"] == "completed"
    # the far foot bears (m g + F)/4 - F t/s
    ends = (MASS * G + 30) / 120
    assert_allclose(run["event_time"].values[0], ends, rtol=1e-11)
    assert run["event_kind"].values[0] == run["event_kind"].attrs["flag_meanings"].split().index("takeoff")
    assert not run["contact_force_foot2"].values[run["time"].values > ends + 1e-9].any()
    assert (forces(run, 4) >= -1e-9).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_tables_rest_under_loads_that_move(seed: int) -> None:
    random = np.random.default_rng(seed)
    count, turns = int(random.integers(4, 8)), random.uniform(0, 2 * np.pi)
    angles = turns + 2 * np.pi * np.arange(count) / count + random.uniform(-0.2, 0.2, count)
    feet = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    load, reach, rate = random.uniform(5, 30), random.uniform(0.1, 0.35), random.uniform(1, 8)
    at = f"{reach}*cos({rate}*t/second)", f"{reach}*sin({rate}*t/second)"
    model = table(feet, f"{load} N", at, float(random.choice([0.0, 0.5])))
    for method, settings in METHODS[:2]:
        run = xd.simulate(model, method=method, until="1.5 s", **settings)
        assert run.attrs["run_outcome"] == "completed", run.attrs["run_outcome_text"]
        assert run.sizes["event"] < 30
        assert abs(run["z"]).max() < 1e-12
        assert abs(run["p"]).max() < 1e-12
        pressing = forces(run, count)
        assert (pressing >= -1e-8).all()
        assert_allclose(pressing.sum(axis=0), MASS * G + load, rtol=1e-12)


def block(places: list[float], kinetic: float, static: float) -> xd.Model:
    """A block of 2 kg on corners, pushed harder and harder at a height of its own."""
    height, above = 0.1, 0.05
    return xd.Model(
        name="block",
        coordinates={"x": "m", "y": "m", "phi": "rad"},
        parameters={"m": "2 kg", "g": "9.81 m s-2", "J": "0.4 kg m2"},
        mass={"x": "m", "y": "m", "phi": "J/radian**2"},
        forces={
            "weight": {"y": "-m*g"},
            "push": {"x": "20*newton*t/second", "phi": f"-20*newton*t/second*{above}*metre/radian"},
        },
        contacts={
            f"corner{i}": {
                "gap": f"y + {c}*metre*sin(phi) - {height}*metre*cos(phi)",
                "slip": f"v_x + v_phi/radian*({c}*metre*(-sin(phi)) + {height}*metre*cos(phi))",
                "restitution": 0,
                "tangential": "coulomb",
                "friction": kinetic,
                "static": static,
            }
            for i, c in enumerate(places)
        },
        initial={"x": "0 m", "y": f"{height} m", "phi": "0 rad"},
    )


@pytest.mark.parametrize(("method", "settings"), METHODS[:2])
@pytest.mark.parametrize(("kinetic", "static"), [(0.5, 0.5), (0.4, 0.6)])
@pytest.mark.parametrize("places", [[-0.5, 0.5], [0.5, -0.5, -0.1], [-0.5, -0.2, 0.1, 0.5]])
def test_a_block_slips_when_all_its_corners_do(
    places: list[float], kinetic: float, static: float, method: str, settings: dict[str, Any]
) -> None:
    run = xd.simulate(block(places, kinetic, static), method=method, until="1.2 s", **settings)
    assert run.attrs["run_outcome"] == "completed", run.attrs["run_outcome_text"]
    start = static * MASS * G / 20
    moves = run["time"].values > start + 1e-9
    assert not (abs(run["v_x"].values[~moves]) > 1e-12).any()
    # 2 kg dv/dt = 20 N/s t - kinetic m g
    expected = (10 * (1.2**2 - start**2) - kinetic * MASS * G * (1.2 - start)) / MASS
    assert_allclose(run["v_x"].values[-1], expected, rtol=1e-12)
    assert run.sizes["event"] < 12


def test_dry_frictions_beside_each_other_hold_together() -> None:
    model = xd.Model(
        name="brakes",
        coordinates={"x": "m"},
        parameters={"m": "2 kg"},
        mass={"x": "m"},
        forces={"push": {"x": "5*newton*t/second"}},
        frictions={name: {"slip": "v_x", "kinetic": f"{most}*newton"} for name, most in (("left", 1), ("right", 3))},
        initial={"x": "0 m"},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="1 s")
    assert run.attrs["run_outcome"] == "completed"
    assert_allclose(run["v_x"].values[-1], (2.5 * (1 - 0.64) - 4 * 0.2) / MASS, rtol=1e-12)
    pulls = run["friction_force_left"].values, run["friction_force_right"].values
    held = run["time"].values < 0.4
    assert_allclose(pulls[0][held], pulls[1][held])


def test_what_shares_goes_on_and_is_made_again_to_the_bit(tmp_path: Any) -> None:
    feet = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
    model = table(feet, "30 N", ("0.4*sin(3*t/second)", "0.4*cos(2*t/second)"))
    settings: dict[str, Any] = {"method": "rk4", "step": "10 ms"}
    whole, begun = (xd.simulate(model, until=until, **settings) for until in ("2 s", "1 s"))
    xd.save(whole, tmp_path / "table.nc")
    assert xd.reproduce(tmp_path / "table.nc").attrs["identical"] == 1
    longer = xd.extend(begun, until="2 s")
    assert_array_equal(longer["contact_force_foot0"].values, whole["contact_force_foot0"].values)
    assert whole.attrs["run_outcome"] == "completed"


def test_what_shares_nothing_yet_goes_on_from_all_its_numbers() -> None:
    """Assert that the numbers of a table in flight, kept without shares, come back each to its place."""
    feet = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])
    dropped = table(feet, "0 N", ("0", "0"), 0.5).replace(initial={"z": "0.1 m", "p": "0.05 rad"})
    march, fresh = (March(dropped, settings_for(dropped, method="rk4", step="10 ms", until="0.25 s")) for _ in range(2))
    for _ in march.blocks(24):
        pass
    names, numbers = final_numbers(march.run)
    assert march.run.modes.size == 8 + 6
    assert "modes[8]" in names
    go_on_from_end(fresh.run, names, numbers)
    again, numbers_again = final_numbers(fresh.run)
    assert again == names
    differing = np.flatnonzero(numbers_again != numbers)
    assert differing.size <= 2  # the march runs again, from before the node it ended at
