"""Contacts of many bodies: against closed forms of balls that pass through each other, and what impacts conserve.

A thousand elastic balls, of which none loses energy; of rough discs `test_rough_heaps` has an event-driven solution.
Impacts of many bodies with friction: each law against single bodies in closed form, and energy that is created.
Boxes of coordinates, by which links that are too far to meet are left out: what is proven to stay in one does.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from functools import reduce
from math import comb
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

import xdynamics as xd
from cases.balls import balls
from cases.impacts import Rod, random_rod, rods_together
from cases.plain import between_states, made_by_hand, plain
from xdynamics.march import March
from xdynamics.march.assembly.broad_phase import ASSEMBLY, FIRST, LINK, NARROW, NEAR, SECOND, WIDE, stays_in_narrow_box
from xdynamics.march.configuration import settings_for
from xdynamics.march.force_evaluation import nan_maximum
from xdynamics.march.run import Run
from xdynamics.model.parts import IMPACT_LAWS

Floats = NDArray[np.float64]
LAWS = ("newton", "poisson", "sequential")


def row(places: Floats, speeds: Floats, *, law: str = "newton", e: float = 1.0, contact: Any = None) -> xd.Model:
    """Return points on a line, each of which can hit the next and the one after it."""
    return xd.Model(
        name="row",
        dimensions={"ball": len(places)},
        relations={"pair": {"of": "ball"}},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        contacts={"balls": {"gap": "second(x, pair) - first(x, pair)", "restitution": e, "law": law} | (contact or {})},
        initial={
            "x": {"unit": "m", "value": places.tolist()},
            "v_x": {"unit": "m s-1", "value": speeds.tolist()},
        },
    )


def sizes(count: int, seed: int) -> dict[str, Any]:
    """Return random masses and radii of discs."""
    random, side = np.random.default_rng(seed + 100), int(np.ceil(np.sqrt(count)))
    return {
        "m": {"dims": ["disc"], "value": random.uniform(1.0, 2.0, count).tolist(), "unit": "kg"},
        "radius": {"dims": ["disc"], "value": (random.uniform(0.2, 0.35, count) / side).tolist(), "unit": "m"},
    }


def discs(count: int, seed: int, **more: Any) -> xd.Model:
    """Return elastic discs on a lattice in a box, with random velocities and masses."""
    side = int(np.ceil(np.sqrt(count)))
    random = np.random.default_rng(seed)
    places = (np.stack(np.divmod(np.arange(count), side), axis=1) + 0.5) / side
    contact = {"restitution": 1} | more.pop("contact", {})
    sections: dict[str, Any] = {
        "name": "discs in a box",
        "dimensions": {"disc": count, "axis": ["x", "y"]},
        "relations": {"pair": {"of": "disc"}},
        "coordinates": {"r": {"unit": "m", "dims": ["disc", "axis"]}},
        "parameters": sizes(count, seed),
        "mass": {"r": "m"},
        "contacts": {
            "low": {"gap": "r - radius", **contact},
            "high": {"gap": "metre - radius - r", **contact},
            "discs": {
                "gap": "norm(second(r, pair) - first(r, pair), axis) - first(radius, pair) - second(radius, pair)",
                **contact,
            },
        },
        "initial": {
            "r": {"unit": "m", "value": places.tolist()},
            "v_r": {"unit": "m s-1", "value": random.normal(size=(count, 2)).tolist()},
        },
    }
    return xd.Model(**sections | more)


def overlaps(run: Any) -> Iterator[float]:
    """Yield the least gap of every row."""
    first, second = run.pair_first.values, run.pair_second.values
    radius = run.radius.values
    for r in run.r.values:
        apart = np.hypot(*(r[second] - r[first]).T) - radius[first] - radius[second]
        yield min(apart.min(), (r - radius[:, None]).min(), (1.0 - radius[:, None] - r).min())


@pytest.mark.parametrize("law", LAWS)
def test_equal_balls_pass_through_each_other(law: str) -> None:
    """Assert that equal elastic balls are where balls that pass through each other are, sorted."""
    random = np.random.default_rng(3)
    places, speeds = np.sort(random.uniform(0.0, 1.0, 12)), random.normal(size=12)
    run = xd.simulate(row(places, speeds, law=law), method="velocity_verlet", step="10 ms", until="2 s")
    ghosts = np.sort(places + np.outer(run.time.values, speeds), axis=1)
    crossings = sum(
        0.0 < (places[j] - places[i]) / (speeds[i] - speeds[j]) < 2.0 for i in range(12) for j in range(i + 1, 12)
    )
    assert run.attrs["run_outcome"] == "completed"
    assert run.sizes["event"] == crossings > 16
    assert np.abs(run.x.values - ghosts).max() < 1e-10
    assert np.abs(np.sort(run.v_x.values[-1]) - np.sort(speeds)).max() < 1e-12


@pytest.mark.every(3)
@pytest.mark.parametrize("method", ["velocity_verlet", "dop853", "radau_iia"])
def test_energy_and_momentum_are_kept(method: str) -> None:
    """Assert, through hundreds of impacts, kinetic energy and momenta of pairs to rounding, and gaps that stay open."""
    steps = {"rtol": 1e-9} if method == "dop853" else {"step": "4 ms"}
    run = xd.simulate(discs(36, 1), method=method, until="300 ms", **steps)
    energy = run.kinetic_energy.values
    paired = run.event_pair.values >= 0
    assert run.attrs["run_outcome"] == "completed"
    assert paired.sum() > 40
    assert (~paired).sum() > 20
    assert np.abs(energy / energy[0] - 1.0).max() < 1e-12
    assert min(overlaps(run)) > -1e-11
    both = run.event_impulse_first_r + run.event_impulse_second_r
    assert float(abs(both[paired]).max()) == 0.0
    assert float(abs(run.event_energy_lost).max()) < 1e-12 * energy[0]


def test_impulses_are_changes_of_momentum() -> None:
    """Assert that each recorded impulse is what the velocities of its two bodies changed by, and of no other one."""
    run = xd.simulate(discs(36, 5), method="velocity_verlet", step="4 ms", until="200 ms")
    for e in range(run.sizes["event"]):
        before, after = int(run.event_row_before[e]), int(run.event_row_after[e])
        change = run.m.values[:, None] * (run.v_r.values[after] - run.v_r.values[before])
        link = int(run.event_pair[e])
        if link >= 0:
            first, second = int(run.event_first[e]), int(run.event_second[e])
            assert (first, second) == (int(run.pair_first[link]), int(run.pair_second[link]))
            change[second] -= run.event_impulse_second_r.values[e]
        else:
            first = int(run.event_disc[e])
        change[first] -= run.event_impulse_first_r.values[e]
        assert np.abs(change).max() < 1e-13


def test_it_is_the_march_of_contacts_that_are_written_out() -> None:
    """Assert that bodies are where single contacts have them, whose number is below what is written out."""
    places, speeds = np.linspace(0.0, 1.0, 8), np.array([2.0, -0.3, 0.4, 0.0, -0.5, 0.1, 0.2, -2.5])
    settings: dict[str, Any] = {"method": "velocity_verlet", "step": "10 ms", "until": "900 ms"}
    chosen = row(places, speeds, e=0.7)
    model = xd.Model.from_text(chosen.to_toml().replace('of = "ball"', 'of = "ball"\nneighbours = 1'))
    many, few = xd.simulate(chosen, **settings), xd.simulate(model, **settings)
    assert (len(chosen.elements.contacts), len(model.elements.contacts)) == (0, 7)
    assert "contact_force_balls" in few
    times = np.linspace(0.0, 0.9, 50)
    one, other = (xd.sample(run, times=times).x.values for run in (many, few))
    assert np.abs(one - other).max() < 1e-10


def test_each_contact_takes_the_energy_of_its_restitution() -> None:
    """Assert Newton's law at every impact: what an impact takes is 1 - e**2 of the energy of approach."""
    run = xd.simulate(discs(36, 2, contact={"restitution": 0.5}), method="velocity_verlet", step="4 ms", until="100 ms")
    lost = np.concatenate([[0.0], np.cumsum(run.event_energy_lost.values)])
    energy = run.kinetic_energy.values
    assert run.sizes["event"] > 20
    assert energy[0] - energy[-1] == pytest.approx(lost[-1], rel=1e-12)
    assert (run.event_energy_lost.values > 0.0).all()


@pytest.mark.parametrize("count", [20, 60])
def test_a_cradle_hands_on_one_speed(count: int) -> None:
    """Assert that of touching balls, struck one by one, the last one alone leaves; beyond the reach of Lemke's method too."""
    run = xd.simulate(touching(count, "sequential"), method="velocity_verlet", step="0.1 s", until="1 s")
    assert np.abs(run.v_x.values[-1] - np.eye(count)[-1]).max() < 1e-13


@pytest.mark.parametrize("count", [20, 60])
def test_all_at_once_solves_the_complementarity_problem(count: int) -> None:
    """Assert Newton's law for all touching balls together: energy kept, no gap closing, by Lemke's method or by sweeps."""
    run = xd.simulate(touching(count, "newton"), method="velocity_verlet", step="0.1 s", until="1 s")
    v = run.v_x.values[-1]
    assert run.attrs["run_outcome"] == "completed"
    assert np.diff(v).min() > -1e-12
    assert v.sum() == pytest.approx(1.0, abs=1e-12)
    assert 0.0 < float(run.event_impulse_residual.max()) < 1e-12 or count == 20
    # the first gap opens as fast as it closed, and the others stay closed
    assert v[1] - v[0] == pytest.approx(1.0, abs=1e-12)
    assert np.ptp(v[1:]) < 1e-12


def touching(count: int, law: str) -> xd.Model:
    """Return a row of balls of which all but the first touch, and the first comes along."""
    places = np.concatenate([[-1.5], np.arange(count - 1.0)])
    return xd.Model.from_text(
        row(places, np.eye(count)[0], law=law)
        .to_toml()
        .replace("second(x, pair) - first(x, pair)", "second(x, pair) - first(x, pair) - d")
        .replace("[parameters]", '[parameters]\nd = "1 m"')
    )


@pytest.mark.dear
def test_the_march_goes_on_as_if_it_had_not_stopped(tmp_path: Any) -> None:
    """Assert that what is saved is what was marched, can be verified, and be extended with the same bits."""
    model, settings = discs(36, 1), {"method": "velocity_verlet", "step": "4 ms", "time_tolerance": "1e-13 s"}
    whole = xd.simulate(model, until="120 ms", nodes=["80 ms"], **settings)
    half = xd.simulate(model, until="80 ms", **settings)
    longer = xd.extend(half, until="120 ms")
    for name in ("time", "r", "v_r", "event_time", "event_pair", "event_impulse_first_r"):
        assert np.array_equal(longer[name].values, whole[name].values), name
    xd.save(whole, tmp_path / "discs.nc")
    with xd.open_run(tmp_path / "discs.nc") as read:
        for name in whole.variables:
            assert np.array_equal(read[name].values, whole[name].values), name


@pytest.mark.dear
def test_an_event_inside_a_step_comes_before_later_impacts() -> None:
    """Assert that a run stops at an event although bodies meet later in the step, and knows of all impacts before."""
    settings: dict[str, Any] = {"method": "velocity_verlet", "step": "50 ms", "until": "200 ms"}
    whole = xd.simulate(discs(36, 1), **settings)
    between = float(whole.event_time[5:7].mean())
    stop = {"stop": {"function": "t - moment", "action": "stop"}}
    text = discs(36, 1, events=stop, parameters=sizes(36, 1) | {"moment": f"{between!r} s"})
    run = xd.simulate(text, **settings)
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert float(run.time[-1]) == pytest.approx(between, abs=1e-11)
    assert run.sizes["event"] == 7
    assert np.array_equal(run.event_pair.values[:6], whole.event_pair.values[:6])


def test_bodies_that_overlap_at_the_start_are_named() -> None:
    """Assert that the pair inside one another is named with its gap."""
    model = discs(36, 1)
    r = model.statement.starting["r"].numbers
    model = discs(
        36,
        1,
        initial={
            "r": {"unit": "m", "value": [[0.25, 0.26], *np.reshape(r, (36, 2)).tolist()[1:]]},
            "v_r": {"unit": "m s-1", "value": np.zeros((36, 2)).tolist()},
        },
    )
    run = xd.simulate(model, method="velocity_verlet", step="4 ms", until="10 ms")
    assert run.attrs["run_outcome"] == "contact_penetrated"
    assert "contact 'discs' of disc 0 and 7 is -0." in run.attrs["run_outcome_text"]


def test_a_gap_that_differs_from_link_to_link_is_refused() -> None:
    """Assert that a gap with the number of its element in it is refused, with what to write instead."""
    model = discs(36, 1)
    text = model.to_toml().replace('gap = "r - radius"', 'gap = "r - radius*(1 - index(disc)/100)"')
    with pytest.raises(xd.InputError, match="write what differs as a parameter with that dimension"):
        xd.simulate(xd.Model.from_text(text), method="velocity_verlet", step="4 ms", until="10 ms")


@pytest.mark.dear
def test_a_thousand_balls_keep_their_energy() -> None:
    """Assert that over 10,000 impacts of 1,000 elastic balls energy is kept to rounding, and none is in another."""
    radius, impacts, energies = 0.03, 0, []
    model = balls(10, radius=radius, seed=1)
    settings = settings_for(model, method="velocity_verlet", step="0.5 ms", until="1 s", force_samples="none")
    march = March(model, settings)
    places, speeds = (march.layout.row.index(name) for name in ("r·0·x", "v_r·0·x"))
    first, second = np.triu_indices(1000, 1)
    for block in march.blocks(1 << 9):
        impacts += block.events
        rows = block.log.rows[:, : block.rows]
        energies.append((rows[speeds : speeds + 3000] ** 2).sum(axis=0))
        r = rows[places : places + 3000, -1].reshape(1000, 3)
        v = rows[speeds : speeds + 3000, -1].reshape(1000, 3)
        depth = 2.0 * radius - np.linalg.norm(r[second] - r[first], axis=1).min()
        assert depth <= 2.0 * np.linalg.norm(v, axis=1).max() * float(march.run.assemblies["tolerance"].max())
        if impacts >= 10_000:
            break
    assert impacts >= 10_000
    energy = np.concatenate(energies)
    assert np.abs(energy / energy[0] - 1.0).max() <= 1e-13


PARADOX = Rod(1.0, 1 / 12, 0.5, math.pi / 4, 0.5, 1.0, (0.5, -1.0, 0.0))  # see `contacts.test_impact_laws`
COUNT = 40


def struck(rods: list[Rod], law: str, **more: Any) -> xr.Dataset:
    """Return the run of rods until each has been struck once, or more often."""
    last = max(rod.before for rod in rods)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", xd.AccuracyWarning)
        return xd.simulate(
            rods_together(rods, law), method="velocity_verlet", step=last / 2.9, until=1.01 * last, **more
        )


def first_impact(run: xr.Dataset, k: int) -> int:
    """Return the number of the first event of a rod."""
    return int(np.flatnonzero(run.event_rod.values == k)[0])


def after(run: xr.Dataset, k: int) -> np.ndarray:
    """Return the velocities of a rod in the row behind its first impact."""
    row = int(run.event_row_after[first_impact(run, k)])
    return np.array([float(run[f"v_{name}"][row, k]) for name in ("x", "y", "theta")])


@pytest.mark.dear
@pytest.mark.every(5)
@pytest.mark.parametrize("law", IMPACT_LAWS)
def test_rods_are_struck_as_each_alone(law: str) -> None:
    """Assert velocities and energies of rods of all shapes that strike a rough floor by each law, those of single rods."""
    rods = [random_rod(case) for case in range(100, 100 + COUNT)]
    run = struck(rods, law)
    assert run.attrs["run_outcome"] == "completed"
    for k, rod in enumerate(rods[::4]):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", xd.AccuracyWarning)
            one = rod.struck(law)
        row = int(one.event_row_after[0])
        alone = np.array([float(one[f"v_{name}"][row]) for name in ("x", "y", "theta")])
        size = np.abs(alone).max() + np.abs(rod.speeds).max()
        assert np.abs(after(run, 4 * k) - alone).max() <= 1e-10 * size
        lost = float(run.event_energy_lost[first_impact(run, 4 * k)])
        assert lost == pytest.approx(float(one.event_energy_lost[0]), abs=1e-9 * rod.kinetic(np.array(rod.speeds)))


@pytest.mark.parametrize("law", ["newton", "sequential"])
def test_energy_that_many_create_is_spoken_against(law: str) -> None:
    """Assert Kane's paradox of one rod among others that lose more: the rod, the time and 7/64 J are named."""
    calm = Rod(*{**vars(PARADOX), "e": 0.0}.values())
    rods = [calm] * COUNT
    rods[17] = PARADOX
    model, asked = rods_together(rods, law), {"method": "velocity_verlet", "step": "100 us", "log": "full"}
    said = (
        r"energy was created in an impact at event 17 \('floor' of rod 17, t = 5e-05 s, event_energy_lost = -0\.109 J\)"
    )
    with pytest.warns(xd.AccuracyWarning, match=said):
        run = xd.simulate(model, until="100 us", time_tolerance="1e-15 s", **asked)
    assert float(run.event_energy_lost[17]) == pytest.approx(-7 / 64, rel=1e-10)
    assert float(run.event_energy_lost.sum()) > 7.0
    assert "law = 'poisson' and law = 'energetic' do not" in run.attrs["run_outcome_text"]
    with pytest.warns(xd.AccuracyWarning, match="energy was created"):
        longer = xd.extend(run, until="200 us")
    assert longer.attrs["run_outcome_text"].partition(";")[2] == run.attrs["run_outcome_text"].partition(";")[2]


def test_links_that_share_an_impact_are_refused_the_energetic_law() -> None:
    """Assert that three balls in a row are named, with laws that have an answer, where two links are struck at once."""
    places = [*np.arange(3) * 1.0, *(10.0 + 2.0 * np.arange(27))]
    speeds = [1.0, 0.0, -1.0, *[0.0] * 27]
    model = xd.Model(
        name="row",
        dimensions={"ball": 30},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={},
        contacts={
            "balls": {
                "gap": "second(x, pair) - first(x, pair) - 1*metre",
                "restitution": 0.5,
                "law": "energetic",
            }
        },
        initial={"x": {"unit": "m", "value": places}, "v_x": {"unit": "m s-1", "value": speeds}},
    )
    run = xd.simulate(model, until="1 ms", method="velocity_verlet", step="1 ms")
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert "'balls' of ball 1 and 2 and another one touch at once" in run.attrs["run_outcome_text"]
    assert "choose law = 'poisson' or 'sequential'" in run.attrs["run_outcome_text"]


def stepped(random: np.random.Generator, degree: int) -> tuple[Run, Polynomial, float]:
    """Return a run with the states at both ends of a step along a polynomial, with the polynomial and its width."""
    run, w = made_by_hand(n=1), 10.0 ** random.uniform(-3, 1)
    s, motion = Polynomial([0.0, 1.0 / w]), Polynomial([10.0 ** random.uniform(-3, 3)])
    for k in range(degree + 1):  # each of Bernstein's coefficients may be the least or the greatest
        motion += random.normal() * comb(degree, k) * s**k * (1.0 - s) ** (degree - k)
    for state, t in ((run.y, 0.0), (run.z, w)):
        state[:3] = motion(t), motion.deriv()(t), motion.deriv(2)(t)
    return run, motion, w


def boxed(low: float, high: float) -> NDArray[np.float64]:
    """Return a narrow box of one coordinate, in a wide one that is everywhere."""
    return np.array([[-np.inf], [np.inf], [low], [high]])


@pytest.mark.cases(200)
def test_boxes_hold_the_polynomials_that_stay_inside(case: int) -> None:
    """Assert for random cubics and quintics that those proven to stay in a box are in it at each of 500 places."""
    random, proven = np.random.default_rng([30, 1, case]), 0
    run, motion, w = stepped(random, 5 if case % 2 else 3)
    values = motion(np.linspace(0.0, w, 500))
    reach = values.max() - values.min()
    for _ in range(40):
        out, up = 1e3 * reach * random.uniform([-0.2, -0.2], [1.0, 1.0]) ** 5
        low, high = values.min() - out, values.max() + up
        run.boxes = boxed(low, high)
        if plain(stays_in_narrow_box)(run, 0, w):
            proven += 1
            assert low <= values.min()
            assert high >= values.max()
    assert proven > 0


@pytest.mark.cases(200)
def test_boxes_are_as_narrow_as_bounds_of_steps(case: int) -> None:
    """Assert that a motion stays in a box a billionth wider than the bounds of its step, and in none that is narrower."""
    random = np.random.default_rng([30, 2, case])
    run, _, w = stepped(random, 5 if case % 2 else 3)
    bounds = between_states("position", run.y, run.z, (0, 1, 2), w)
    near = 1e-9 * max(abs(bounds.low), abs(bounds.high))
    run.boxes = boxed(bounds.low - near, bounds.high + near)
    assert plain(stays_in_narrow_box)(run, 0, w)
    for low, high in ((near, 0.0), (0.0, near)):
        run.boxes = boxed(bounds.low + low, bounds.high - high)
        assert not plain(stays_in_narrow_box)(run, 0, w)


def test_what_boxes_leave_out_is_apart_all_over_them() -> None:
    """Assert for 27 balls that pairs which wide or narrow boxes leave out are farther apart than they can meet in them."""
    model = balls(3, radius=0.1, seed=2)
    settings = settings_for(model, method="velocity_verlet", step="5 ms", until="2 s", force_samples="none")
    march, radius, left_out = March(model, settings), 0.1, 0
    first, second = np.triu_indices(27, 1)
    for block in march.blocks(16):
        run = march.run
        places = run.y[:81].reshape(27, 3)
        for row in (WIDE, NARROW):
            low, high = run.boxes[row : row + 2].reshape(2, 27, 3)
            assert ((low <= places) & (places <= high)).all()
            away = np.maximum(np.maximum(low[first] - high[second], low[second] - high[first]), 0.0)
            may_meet = np.linalg.norm(away, axis=1) <= 2.0 * radius
            listed = [c for c in run.candidates[: run.counters[0]] if row == WIDE or c[NEAR] == 1]
            pairs = {(c[FIRST], c[SECOND]) for c in listed if c[ASSEMBLY] == 2}
            assert pairs >= set(zip(first[may_meet], second[may_meet], strict=True))
            left_out += len(first) - len(pairs)
            walls = [{c[LINK] for c in listed if c[ASSEMBLY] == wall} for wall in (0, 1)]
            assert walls[0] >= set(np.flatnonzero(low.ravel() <= radius))
            assert walls[1] >= set(np.flatnonzero(high.ravel() >= 1.0 - radius))
        assert (run.boxes[WIDE] <= run.boxes[NARROW]).all()
        assert (run.boxes[NARROW + 1] <= run.boxes[WIDE + 1]).all()
        del block
    assert left_out > 0


@pytest.mark.parametrize("place", range(3))
def test_a_nan_stays_the_largest_of_numbers(place: int) -> None:
    """Assert that numbers after a nan do not take its place, and the largest of numbers without one."""
    # where numba has compiled the engine, the function has no entry from Python, and a call of it ends the process
    numbers, maximum = [1.0, 3.0, 2.0], plain(nan_maximum)
    assert reduce(maximum, numbers, 0.0) == 3.0
    numbers[place] = math.nan
    assert math.isnan(reduce(maximum, numbers, 0.0))
