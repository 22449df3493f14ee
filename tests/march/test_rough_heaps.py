"""Discs that fall into a box whose floor and walls rub, as they do on each other: laws that hold in every row.

Rough discs that bounce and spin in a box whose walls move: against an event-driven solution, few links and many.
Jumps and kinks in the expressions of friction, located like those of forces.
Contacts over few links are written out, those over many are found as the march goes: two programs, one motion.
Rows of balls by moreau_jean: Newton's cradle by the simultaneous law, and balls beside others that are far away.
Links that approach since others have come to rest at the same time: struck then, and not a moment later.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.rough_discs import WALLS, RoughDiscs
from xdynamics.documenting.summary import summary
from xdynamics.schema import REST, STICK

HEAP = (MODELS / "rough_pile.toml").read_text()


@lru_cache
def heap() -> xr.Dataset:
    """Return the run of twenty-four discs until several layers slide, roll and stick."""
    return xd.simulate(xd.Model.from_text(HEAP), until="0.26 s", log="full", force_samples="none")


@pytest.mark.dear
def test_discs_do_not_sink_into_each_other() -> None:
    """Assert, in every row, no overlap beyond rounding: one that lies on another and lets go is found when it comes back."""
    run = heap()
    x, y, radius = run.x.values, run.y.values, run.radius.values
    first, second = run.pair_first.values, run.pair_second.values
    gaps = np.hypot(x[:, second] - x[:, first], y[:, second] - y[:, first]) - radius[first] - radius[second]
    assert run.attrs["run_outcome"] == "completed"
    assert gaps.min() > -1e-11
    assert min(run.contact_gap_floor.values.min(), run.contact_gap_left.values.min()) > -1e-11


def test_friction_stays_within_its_cone() -> None:
    """Assert at steps' ends that no link pulls, friction is at most mu times the force, and that many stick and many slide."""
    run = heap()
    of_steps = run.row_kind.values[run.closed_step.values] == 1  # at an event, bounds are what it is about
    force, rubs = run.closed_force.values[of_steps], np.abs(run.closed_friction_force.values[of_steps])
    size = force.max()
    assert force.min() > -1e-9 * size
    assert (rubs - 0.4 * force).max() < 1e-8 * size
    slides = rubs > 0.4 * force - 1e-8 * size
    assert min(np.count_nonzero(slides), np.count_nonzero(~slides)) > 100


def test_discs_are_moved_by_what_is_recorded() -> None:
    """Assert for every disc and row that weight, normal and friction forces make the acceleration across and upward."""
    run = heap()
    mass = 25 * np.pi * run.radius.values**2
    total = np.stack([0 * run.x.values, 0 * run.x.values - mass * 9.80665], axis=2)
    total[:, :, 0] += run.contact_force_left.values - run.contact_force_right.values + run.friction_force_floor.values
    total[:, :, 1] += run.contact_force_floor.values + run.friction_force_left.values + run.friction_force_right.values
    words = run.closed_contact.attrs["flag_meanings"].split()
    of_pairs = run.closed_contact.values == words.index("discs")
    row, one, other = (run[f"closed_{name}"].values[of_pairs] for name in ("step", "first", "second"))
    along = np.stack([run[name].values[row, other] - run[name].values[row, one] for name in "xy"], axis=1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    beside = np.stack([-along[:, 1], along[:, 0]], axis=1)
    push = run.closed_force.values[of_pairs][:, None] * along
    push += run.closed_friction_force.values[of_pairs][:, None] * beside
    np.add.at(total, (row, one), -push)
    np.add.at(total, (row, other), push)
    found = np.stack([run.a_x.values, run.a_y.values], axis=2) * mass[:, None]
    steps = run.row_kind.values == 1  # a row before an event has the forces of what was closed until then
    assert np.abs(total - found)[steps].max() < 1e-8 * np.abs(total).max()


DIGEST = """
import sys
import xdynamics as xd
print(xd.content_digest(xd.simulate(xd.Model.from_text(sys.stdin.read()), until="0.13 s", step="5 ms")))
"""


@pytest.mark.dear
def test_compiled_heaps_have_the_bits_of_plain_python() -> None:
    """Assert equal digests of six discs that strike a rough floor, and each other, with and without a compiler."""
    digests = []
    for switch in ("0", "1"):
        known = os.environ | {"NUMBA_DISABLE_JIT": switch}
        done = subprocess.run(
            [sys.executable, "-c", DIGEST],
            input=HEAP.replace("disc = 24", "disc = 6"),
            capture_output=True,
            text=True,
            env=known,
            check=True,
        )
        digests.append(done.stdout.strip())
    assert digests[0] == digests[1]


def nearly_at_rest() -> xd.Model:
    """The heap of 38 links, in which one disc still rolls on others."""
    path = Path(__file__).parent.parent / "cases" / "rough_heap.csv"
    names = [name.split()[0] for name in path.read_text().splitlines()[0].split(",")]
    columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    units = {"x": "m", "v_x": "m s-1", "y": "m", "v_y": "m s-1", "theta": "rad", "v_theta": "rad s-1"}
    start = "".join(
        f'{name} = {{ value = {values.tolist()}, unit = "{units[name]}" }}\n' for name, values in columns.items()
    )
    text = HEAP[: HEAP.index("[initial]")] + "[initial]\n" + start + HEAP[HEAP.index("[run]") :]
    return xd.Model.from_text(text)


@pytest.mark.dear
def test_a_heap_that_nearly_rests() -> None:
    """Assert that forces of 38 links go on within their cones, where shares that jumped from one to another took minutes."""
    run = xd.simulate(nearly_at_rest(), until="60 ms", log="full", force_samples="none")
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["step"] < 100  # 30 steps of 2 ms, and a few events
    last = run.closed_step.values == run.sizes["step"] - 1
    pressing, rubbing = run.closed_force.values[last], run.closed_friction_force.values[last]
    assert last.sum() > 30
    assert pressing.min() >= 0.0
    assert (np.abs(rubbing) - 0.4 * pressing).max() < 1e-10 * pressing.max()


@lru_cache
def small_heap() -> xr.Dataset:
    """Return the run of nine discs in a narrow box, whose bounces below 10 nm may be skipped, until 1 s."""
    text = (
        HEAP.replace("disc = 24", "disc = 9")
        .replace('"0.7 m"', '"0.36 m"')
        .replace("index(disc), 6)", "index(disc), 3)")
    )
    text = text.replace("index(disc)/6)", "index(disc)/3)")
    low = text.replace("restitution = 0\n", 'restitution = 0\nrest_height = "10 nm"\n')
    return xd.simulate(xd.Model.from_text(low), until="1 s", log="full", force_samples="none")


def test_a_heap_comes_to_rest() -> None:
    """Assert that motions lower than bounces of 10 nm end: no velocity, no event from 0.9 s on, each disc in balance."""
    run = small_heap()
    rests = run.time.values > 0.9
    assert run.attrs["run_outcome"] == "completed"
    assert run.event_time.values.max() < 0.9
    for name in ("v_x", "v_y", "v_theta"):
        assert np.abs(run[name].values[rests]).max() < 1e-18
    of_steps = rests[run.closed_step.values]
    force, rubs = run.closed_force.values[of_steps], np.abs(run.closed_friction_force.values[of_steps])
    assert force.min() >= 0.0
    assert (rubs - 0.4 * force).max() < 1e-9 * force.max()
    mass = 25 * np.pi * run.radius.values**2  # accelerations are what forces of all links leave of weights
    for name in ("a_x", "a_y"):
        assert (np.abs(run[name].values[rests]) * mass).max() < 1e-9 * 9.80665 * mass.min()
    assert np.abs(run.a_theta.values[rests] * run.radius.values / 2.0).max() < 1e-9 * 9.80665


def test_what_stops_slow_motions_takes_less_than_a_bounce() -> None:
    """Assert of rows of rest and stick that each took at most what a bounce of 10 nm has, and that the summary sums them up."""
    run = small_heap()
    stops = np.isin(run.event_kind.values, (REST, STICK))
    lost = run.event_energy_lost.values[stops]
    bounce = 25 * np.pi * run.radius.values.max() ** 2 * 9.80665 * 10e-9
    assert np.abs(lost).max() < bounce
    assert np.count_nonzero(lost > 1e-3 * bounce) > 10
    (line,) = [line for line in summary(run) if line.startswith("stopped")]
    assert line.startswith(f"stopped   {np.count_nonzero(lost)} motions lower than a bounce of rest_height")
    assert f"which took {lost.sum():.3g} J" in line


def test_links_that_part_are_located_with_few_forces() -> None:
    """Assert that no event of a heap takes more than 100 parts of a step: links that part at both ends of one need none."""
    assert small_heap()["event_substeps"].max() <= 100


FEW, MANY = ("floor", "left"), tuple(WALLS)
MOST = 20  # impacts, after which neighbouring motions part too far


def check(discs: RoughDiscs, few: bool) -> None:
    """Assert times of impacts, velocities and spins after each, energies that each took, and places at the end, to 1e-9."""
    exact = discs.solution(MOST)
    assert 8 <= len(exact.times) <= MOST
    assert exact.slowest > 1e-3  # m/s: none so slow that it may be skipped
    assert exact.sticks > 0 < exact.slides
    model = discs.model()
    assert bool(model.assemblies) is not few
    run = xd.simulate(model, method="rk4" if few else "velocity_verlet", step="10 ms", until=f"{discs.until} s")
    assert run.attrs["run_outcome"] == "completed"
    near = {"rtol": 0.0, "atol": 1e-9}
    np.testing.assert_allclose(run["event_time"], exact.times, **near)
    rows = run["event_row_after"].values
    for k, name in enumerate(("x", "y", "theta")):
        size = 1.0 if name != "theta" else 1.0 / discs.radii.min()  # a spin moves the rim
        np.testing.assert_allclose(run[f"v_{name}"].values[rows] / size, np.array(exact.after)[:, :, k] / size, **near)
        np.testing.assert_allclose(run[name].values[-1] / size, exact.last[:, k] / size, **near)
    np.testing.assert_allclose(run["event_energy_lost"], exact.lost, **near)


@pytest.mark.parametrize("case", [1, 2])
def test_few_rough_discs_bounce_and_spin_as_an_event_driven_solution_says(case: int) -> None:
    """Assert it of three discs, a floor and a wall, whose forces are written out."""
    check(RoughDiscs(case, 3, FEW, 0.6), few=True)


@pytest.mark.parametrize(("case", "count"), [(0, 5), (1, 8), (0, 12)])
def test_many_rough_discs_bounce_and_spin_as_an_event_driven_solution_says(case: int, count: int) -> None:
    """Assert it of discs in a box, whose links are found by cells."""
    check(RoughDiscs(case, count, MANY, 0.35), few=False)


@pytest.mark.dear
@pytest.mark.parametrize("case", range(20, 25))
def test_more_few_rough_discs(case: int) -> None:
    """Assert it of four discs and a floor."""
    check(RoughDiscs(case, 4, ("floor",), 0.7), few=True)


@pytest.mark.dear
@pytest.mark.parametrize("case", range(20, 35))
def test_more_rough_discs(case: int) -> None:
    """Assert it of 4 to 12 discs in a box."""
    check(RoughDiscs(case, 4 + case % 9, MANY, 0.6), few=False)


METHODS = (
    ("dormand_prince", {"rtol": 1e-9}),
    ("dop853", {"rtol": 1e-9}),
    ("rk4", {"step": "70 ms"}),
    ("position_verlet", {"step": "70 ms"}),
)


def wheel(kinetic: str, **more: Any) -> xd.Model:
    """A flywheel of 2 kg m2 that turns with 10 rad/s, and a brake."""
    return xd.Model(
        name="flywheel",
        coordinates={"q": "rad"},
        parameters={"J": "2 kg m2"},
        mass={"q": "J/radian**2"},
        forces={"none": {"q": "0*newton*metre/radian"}},
        frictions={"brake": {"slip": "v_q", "kinetic": kinetic}},
        initial={"q": "0 rad", "v_q": "10 rad s-1"},
        **more,
    )


@pytest.mark.parametrize(("method", "how"), METHODS)
def test_a_brake_that_is_applied_by_a_jump_stops_in_time(method: str, how: dict[str, Any]) -> None:
    """Assert 8 N m from 1 s on: at rest after 3.5 s, and 22.5 rad; the jump is an event of the brake."""
    run = xd.simulate(wheel("where(t < second, 0, 8)*newton*metre/radian"), method=method, until="5 s", **how)
    assert float(run.q[-1]) == pytest.approx(22.5, abs=1e-9)
    assert run.event_time.values == pytest.approx([1.0, 3.5], abs=1e-9)


def test_friction_of_its_own_slip_has_no_switch() -> None:
    """Assert that `abs` of the slip is no event beside the stop of the slip itself."""
    stribeck = "(4 + 4*exp(-abs(v_q)/(radian/second)))*newton*metre/radian"
    run = xd.simulate(wheel(stribeck), method="dop853", rtol=1e-9, until="5 s")
    assert run.event_detector.attrs["flag_meanings"].split() == ["brake"]


def test_friction_of_a_contact_has_its_switches_located() -> None:
    """Assert a block that slides with 2 m/s on a floor whose friction begins at 1 m: 0.2 s2 m-1 of way beyond it."""
    block = xd.Model(
        name="block",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-10*newton"}},
        contacts={
            "floor": {
                "gap": "y",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "where(x < metre, 0, 0.5)",
            }
        },
        initial={"x": "0 m", "y": "0 m", "v_x": "2 m s-1", "v_y": "0 m s-1"},
    )
    run = xd.simulate(block, method="rk4", step="70 ms", until="2 s")
    assert float(run.x[-1]) == pytest.approx(1.0 + 4.0 / (2 * 5.0), abs=1e-9)


DX, DY = "(second(x, pair) - first(x, pair))", "(second(y, pair) - first(y, pair))"
DISTANCE = f"sqrt({DX}**2 + {DY}**2)"
ALONG = f"({DX}*(second(v_y, pair) - first(v_y, pair)) - {DY}*(second(v_x, pair) - first(v_x, pair)))/{DISTANCE}"


def rough(slip: str, friction: float) -> dict[str, Any]:
    """Return the keys of Coulomb's friction."""
    return {"tangential": "coulomb", "slip": slip, "friction": friction, "static": friction + 0.1}


def box(seed: int, count: int, law: str, *, rubs: bool, falls: bool, unused: str) -> xd.Model:
    """Return discs in a square box that strike each other and its walls."""
    draw = np.random.default_rng(seed)
    places = np.array([[0.3, 0.4], [0.9, 0.5], [0.6, 1.1]])[:count] + draw.uniform(-0.1, 0.1, (count, 2))
    speeds, restitution = draw.normal(0.0, 3.0, (count, 2)), float(draw.uniform(0.4, 1.0))
    shared = {"restitution": restitution, "law": law}
    contacts = {"discs": {"gap": f"{DISTANCE} - 2*radius"} | shared | (rough(ALONG, 0.3) if rubs else {})}
    for name, across in (("x", "y"), ("y", "x")):
        for side, gap in (("low", f"{name} - radius"), ("high", f"width - radius - {name}")):
            contacts[f"{side}_{name}"] = {"gap": gap} | shared | (rough(f"v_{across}", 0.2) if rubs else {})
    columns = {"x": places[:, 0], "y": places[:, 1], "v_x": speeds[:, 0], "v_y": speeds[:, 1]}
    return xd.Model(
        name="box",
        dimensions={"disc": count},
        relations={"pair": {"of": "disc"}},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        parameters={
            "m": {"dims": ["disc"], "unit": "kg", "value": draw.uniform(0.5, 2.0, count).tolist()},
            "radius": "0.1 m",
            "width": "1.5 m",
            "g": "9.81 m s-2",
            unused: "1 m",  # laws are kept by the names that they may read
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-m*g"}} if falls else {},
        contacts=contacts,
        initial={
            name: {"unit": "m s-1" if "_" in name else "m", "value": column.tolist()}
            for name, column in columns.items()
        },
    )


CASES = [(1, 2, "newton", True, False), (2, 2, "poisson", True, True), (3, 3, "newton", False, True)]


@pytest.mark.dear
@pytest.mark.parametrize(("seed", "count", "law", "rubs", "falls"), CASES)
def test_few_links_move_as_many_do(
    seed: int, count: int, law: str, rubs: bool, falls: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that discs in a box are at the same places after a second, by the same impacts."""
    asked: dict[str, Any] = {"method": "dop853", "rtol": 1e-11, "until": "1 s"}
    few = box(seed, count, law, rubs=rubs, falls=falls, unused="few")
    monkeypatch.setattr("xdynamics.model.elements.MOST_REACTIONS", 0)
    many = box(seed, count, law, rubs=rubs, falls=falls, unused="many")
    assert not few.assemblies
    assert many.assemblies
    one, other = (xd.simulate(model, **asked) for model in (few, many))
    assert one.attrs["run_outcome"] == other.attrs["run_outcome"] == "completed"
    assert one.sizes["event"] > 2
    for name in ("x", "y", "v_x", "v_y"):
        assert np.abs(one[name].values[-1] - other[name].values[-1]).max() < 1e-8
    first = slice(3)
    assert other.event_time.values[first] == pytest.approx(one.event_time.values[first], abs=1e-9)
    for name in ("event_impulse_first_x", "event_impulse_second_y", "event_energy_lost"):
        assert other[name].values[first] == pytest.approx(one[name].values[first], abs=1e-8)


@pytest.mark.parametrize("n", [5, 40])
def test_a_cradle_has_the_simultaneous_law_of_newton(n: int) -> None:
    """Assert velocities after one elastic impact on a row at rest: the row leaves together, at 2/n of the speed."""
    model = xd.Model(
        name="cradle",
        dimensions={"ball": n},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        mass={"y": "2*kilogram"},
        contacts={"meets": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 1.0}},
        initial={
            "y": {"value": [-0.5, *np.arange(1.0, n)], "unit": "m"},
            "v_y": {"value": [1.0, *[0.0] * (n - 1)], "unit": "m s-1"},
        },
    )
    run = xd.simulate(model, method="moreau_jean", step="10 ms", until="1 s")
    np.testing.assert_allclose(run.v_y[-1], [2.0 / n - 1.0, *[2.0 / n] * (n - 1)], rtol=1e-12)


def test_balls_far_away_change_nothing() -> None:
    """Assert rows and events of three balls that bounce and are kicked, written out, and among 37 that meet nothing."""
    runs = []
    for n in (3, 40):
        places = [0.7, 1.9, 3.2, *(1e3 + 10.0 * i for i in range(n - 3))]
        model = xd.Model(
            name="row",
            dimensions={"ball": n},
            relations={"pair": {"of": "ball", "neighbours": 1}},
            coordinates={"y": {"unit": "m", "dims": ["ball"]}},
            mass={"y": "2*kilogram"},
            forces={"weight": {"y": "-19.62*newton"}},
            contacts={
                "meets": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 0.6},
                "floor": {"gap": "y - 0.5*metre", "restitution": 0.6},
            },
            events={
                "kick": {
                    "function": "y - 0.6*metre",
                    "direction": "falling",
                    "action": "reset",
                    "set": {"v_y": "1.5*metre/second"},
                }
            },
            initial={
                "y": {"value": places, "unit": "m"},
                "v_y": {"value": [0.0, -0.5, -1.0, *[0.0] * (n - 3)], "unit": "m s-1"},
            },
        )
        runs.append(xd.simulate(model, method="moreau_jean", step="2 ms", until="1 s"))
    few, many = runs
    assert few.sizes["event"] > 5
    np.testing.assert_array_equal(few.time, many.time)
    np.testing.assert_array_equal(few.event_time, many.event_time)
    np.testing.assert_allclose(many.y[:, :3], few.y, rtol=1e-13)
    np.testing.assert_allclose(many.v_y[:, :3], few.v_y, rtol=0.0, atol=1e-12)


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
