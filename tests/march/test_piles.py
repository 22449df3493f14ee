"""Contacts of many bodies at rest: forces of stacks and piles in closed form, rest, take-off, and what a record has of them."""

from __future__ import annotations

from functools import lru_cache
from math import asin, pi, sqrt
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.march import March
from xdynamics.march.assembly.broad_phase import (
    CULPRIT,
    CULPRIT_LINK,
    FAULT,
    IDLE,
    STRAIN,
    STRAINED,
    TOGETHER,
    UNDECIDED,
    WHOLE_STEP,
)
from xdynamics.march.assembly.phases import note_idleness
from xdynamics.march.configuration import settings_for
from xdynamics.march.contact_failures import assembly_dispute

Floats = NDArray[np.float64]
G = 9.81
DISCS = "norm(second(r, pair) - first(r, pair), axis) - first(radius, pair) - second(radius, pair)"
VERLET: dict[str, Any] = {"method": "velocity_verlet", "step": "2 ms"}


def heap(places: Floats, mass: Floats, contacts: dict[str, Any], radius: float = 0.5, **more: Any) -> xd.Model:
    """Return discs of one size under gravity that touch each other, and other things."""
    count = len(places)
    sections: dict[str, Any] = {
        "name": "heap",
        "dimensions": {"disc": count, "axis": ["x", "y"]} | more.pop("dimensions", {}),
        "relations": {"pair": {"of": "disc"}} | more.pop("relations", {}),
        "coordinates": {"r": {"unit": "m", "dims": ["disc", "axis"]}},
        "parameters": {
            "g": f"{G} m s-2",
            "m": {"dims": ["disc"], "value": mass.tolist(), "unit": "kg"},
            "radius": {"dims": ["disc"], "value": [radius] * count, "unit": "m"},
        }
        | more.pop("parameters", {}),
        "mass": {"r": "m"},
        "forces": {"weight": {"r": "-m*g*index(axis)"}},
        "contacts": {"discs": {"gap": DISCS, "restitution": 0.5}} | contacts,
        "initial": {
            "r": {"unit": "m", "value": places.tolist()},
            "v_r": {"unit": "m s-1", "value": np.zeros((count, 2)).tolist()},
        },
    }
    return xd.Model(**sections | more)


def points(heights: Floats, gap: str, **more: Any) -> xd.Model:
    """Return points that fall, each by itself, on something that may move."""
    return xd.Model(
        name="points",
        dimensions={"ball": len(heights)},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "g": f"{G} m s-2"} | more.pop("parameters", {}),
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts=more.pop("contacts", {"floor": {"gap": gap, "restitution": 0.5} | more.pop("floor", {})}),
        initial={"y": {"unit": "m", "value": heights.tolist()}} | more.pop("initial", {}),
        **more,
    )


def at_end(run: xr.Dataset, contact: str) -> xr.Dataset:
    """Return the closed links of a contact in the last row."""
    number = run.closed_contact.attrs["flag_meanings"].split().index(contact)
    wanted = (run.closed_step == run.sizes["step"] - 1) & (run.closed_contact == number)
    return run[[name for name in run.variables if str(name).startswith("closed_")]].isel(closed=wanted.values)


def kinds(run: xr.Dataset, kind: str) -> NDArray[np.bool_]:
    """Return which events are of a kind."""
    words = run.event_kind.attrs["flag_meanings"].split()
    return np.asarray(run.event_kind.values == run.event_kind.attrs["flag_values"][words.index(kind)])


@pytest.mark.every(2)
@pytest.mark.parametrize(("method", "count"), [("velocity_verlet", 30), ("dop853", 8), ("radau_iia", 6)])
def test_stacked_discs_stand(method: str, count: int) -> None:
    """Assert that a stack stays where it is, and each contact carries the weight above it."""
    mass = np.linspace(2.0, 1.0, count)
    places = np.stack([np.full(count, 2.0), np.arange(count) + 0.5], axis=1)
    model = heap(places, mass, {"floor": {"gap": "r - radius", "restitution": 0.5}})
    steps = {"rtol": 1e-9} if method == "dop853" else {"step": "5 ms"}
    run = xd.simulate(model, method=method, until="20 ms", log="full", **steps)
    above = G * np.cumsum(mass[::-1])[::-1]
    between, floor = at_end(run, "discs"), at_end(run, "floor")
    assert run.attrs["run_outcome"] == "completed"
    assert run.closed_force_residual.attrs["units"] == "m s-2"
    assert np.abs(run.closed_force_residual.values).max() < 1e-13 * above[0]
    assert (between.closed_first.values.tolist(), between.closed_second.values.tolist()) == (
        [*range(count - 1)],
        [*range(1, count)],
    )
    assert between.closed_force.values == pytest.approx(above[1:], rel=1e-11)
    assert floor.closed_force.values == pytest.approx(above[:1], rel=1e-11)
    assert np.abs(run.r.values - places).max() < 1e-13
    assert np.abs(run.closed_gap.values).max() < 1e-13


def test_forces_of_a_pyramid_on_pegs() -> None:
    """Assert that along each lattice line of a pyramid forces grow by m*g/(2*cos(30 degrees)) at every disc."""
    rows, spacing = 5, 1.0
    count = rows * (rows + 1) // 2
    level = np.concatenate([np.full(rows - k, k) for k in range(rows)])
    column = np.concatenate([np.arange(rows - k) for k in range(rows)])
    # rows are a little wider than the discs, so that neighbours of a row do not touch
    wide = 1.1 * spacing
    high = sqrt(spacing**2 - wide**2 / 4)
    places = np.stack([wide * (column + level / 2 + 0.5), high * (level + 1.0)], axis=1)
    pegs = np.stack([wide * np.arange(rows + 1), np.zeros(rows + 1)], axis=1)
    model = heap(
        places,
        np.ones(count),
        {"pegs": {"gap": "norm(second(peg, hold) - first(r, hold), axis) - 2*first(radius, hold)", "restitution": 0.5}},
        dimensions={"pin": rows + 1},
        relations={"hold": {"from": "disc", "to": "pin"}},
        parameters={
            "g": f"{G} m s-2",
            "m": {"dims": ["disc"], "value": [1.0] * count, "unit": "kg"},
            "radius": {"dims": ["disc"], "value": [0.5] * count, "unit": "m"},
            "peg": {"dims": ["pin", "axis"], "value": pegs.tolist(), "unit": "m"},
        },
    )
    run = xd.simulate(model, until="20 ms", **VERLET)
    share = G / (2 * high / spacing)
    between, held = at_end(run, "discs"), at_end(run, "pegs")
    assert (between.sizes["closed"], held.sizes["closed"]) == (rows * (rows - 1), 2 * rows)
    for lower, upper, force in zip(
        between.closed_pair_first.values, between.closed_pair_second.values, between.closed_force.values, strict=True
    ):
        # a disc passes on what comes along either line, and half of its own weight: as many as are above on the line
        leans_left = column[lower] == column[upper]
        discs = rows - level[upper] - column[upper] if leans_left else column[upper] + 1
        assert force == pytest.approx(share * discs, rel=1e-10)
    assert np.abs(run.v_r.values).max() < 1e-12


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_bounces_end_when_their_series_does(e: float) -> None:
    """Assert the time at which balls come to rest, sqrt(2*h/g)*(1 + e)/(1 - e), within its uncertainty, and their energy."""
    heights = np.linspace(0.1, 0.2, 30)
    run = xd.simulate(
        points(heights, "y", floor={"restitution": e}), until="1 s", method="velocity_verlet", step="10 ms"
    )
    rest = kinds(run, "rest")
    order = np.argsort(run.event_ball.values[rest])
    series = np.sqrt(2 * heights / G) * (1 + e) / (1 - e)
    away = np.abs(run.event_time.values[rest][order] - series)
    assert rest.sum() == 30
    assert (away <= run.event_time_uncertainty.values[rest][order] * (1 + 1e-6) + 1e-11).all()
    assert away.max() < 1e-4
    # an impact is located within 1 ps, in which a ball falls by its speed
    late = 30 * G * np.sqrt(2 * G * heights.max()) * 1e-12
    assert float(run.event_energy_lost.sum()) == pytest.approx(G * heights.sum(), abs=late)
    assert at_end(run, "floor").closed_force.values == pytest.approx(np.full(30, G), rel=1e-14)
    assert np.abs(run.y.values[-1]).max() < 1e-15


def test_a_column_that_falls_bounces_as_one() -> None:
    """Assert of thirty balls that touch, at a fall of h, that all leave with e*sqrt(2*g*h), in one row for each link.

    They lose m*(1 - e**2)*g*h each.
    """
    height, e, count = 0.1, 0.5, 30
    model = points(
        height + np.arange(count) * 0.1,
        "",
        relations={"pair": {"of": "ball", "neighbours": 1}},
        contacts={
            "floor": {"gap": "y[0]", "restitution": e},
            "balls": {"gap": "second(y, pair) - first(y, pair) - 0.1*metre", "restitution": e},
        },
    )
    run = xd.simulate(model, until="0.15 s", method="velocity_verlet", step="10 ms")
    speed, struck = sqrt(2.0 * G * height), np.unique(run.event_time.values)
    after = run.v_y.values[run.event_row_after.values[0]]
    assert (run.attrs["run_outcome"], run.sizes["event"], len(struck)) == ("completed", count, 1)
    assert np.abs(after / (e * speed) - 1.0).max() < 1e-11
    lost = count * (1.0 - e * e) * G * height
    assert run.event_energy_lost.values.sum() == pytest.approx(lost, rel=1e-10)


def test_a_table_that_shakes_lets_go_when_it_pulls() -> None:
    """Assert that points leave an oscillating table where it accelerates downward with g, and its force until then."""
    size, omega = 0.05, 20.0
    move = {"size": f"{size} m", "omega": f"{omega} s-1"}
    start = {"v_y": {"unit": "m s-1", "value": [size * omega] * 25}}
    model = points(np.zeros(25), "y - size*sin(omega*t)", parameters=move, initial=start)
    run = xd.simulate(model, until="35 ms", method="velocity_verlet", step="1 ms")
    leave = asin(G / (size * omega**2)) / omega
    offs = kinds(run, "takeoff")
    pressed = run.closed_force.values.reshape(-1, 25)
    t = run.time.values[run.closed_step.values].reshape(-1, 25)
    assert offs.sum() == 25
    assert np.abs(run.event_time.values[offs] - leave).max() < 1e-9
    assert np.abs(pressed - (G - size * omega**2 * np.sin(omega * t))).max() < 1e-9
    free = run.time.values > leave
    path = size * np.sin(omega * leave) + size * omega * np.cos(omega * leave) * (run.time.values - leave)
    assert np.abs(run.y.values[free, 0] - (path - G / 2 * (run.time.values - leave) ** 2)[free]).max() < 1e-6


@lru_cache
def pile() -> xr.Dataset:
    """Return the run of the granular box."""
    return xd.simulate(xd.Model.from_toml(MODELS / "granular_box.toml"), log="full")


def test_a_pile_comes_to_rest() -> None:
    """Assert, of discs that fell into a box, no motion, no overlap, and forces that balance every disc's weight."""
    run = pile()
    r, radius = run.r.values, run.radius.values
    first, second = run.pair_first.values, run.pair_second.values
    gaps = np.linalg.norm(r[:, second] - r[:, first], axis=2) - radius[first] - radius[second]
    assert run.attrs["run_outcome"] == "completed"
    assert np.abs(run.v_r.values[-1]).max() < 1e-12
    assert min(gaps.min(), (r - radius[:, None]).min()) > -1e-11
    weight = 25 * pi * radius**2 * 9.80665
    total = np.stack([np.zeros(10), -weight], axis=1)
    for contact, way in (("walls", 1.0), ("far_walls", -1.0)):
        closed = at_end(run, contact)
        total[closed.closed_disc.values, closed.closed_axis.values] += way * closed.closed_force.values
    between = at_end(run, "discs")
    one, other = between.closed_first.values, between.closed_second.values
    normal = r[-1, other] - r[-1, one]
    push = between.closed_force.values[:, None] * normal / np.linalg.norm(normal, axis=1)[:, None]
    np.add.at(total, one, -push)
    np.add.at(total, other, push)
    assert np.abs(total).max() < 1e-9 * weight.sum()
    floor = at_end(run, "walls")
    below = floor.closed_axis.values == 1
    assert floor.closed_force.values[below].sum() == pytest.approx(weight.sum(), rel=1e-11)


def test_impacts_of_a_pile_change_energy_by_what_is_recorded() -> None:
    """Assert at every event that kinetic energy falls by what impacts, and bounces that are skipped, took."""
    run = pile()
    energy, before = run.kinetic_energy.values, run.event_row_before.values
    lost = np.bincount(before, run.event_energy_lost.values, run.sizes["step"])
    events = np.unique(before)
    change = energy[events] - energy[events + 1]
    assert len(events) > 100
    assert np.abs(change - lost[events]).max() < 1e-11 * energy.max()
    assert lost.min() > -1e-14 * energy.max()


@pytest.mark.dear
def test_rows_of_closed_links_survive(tmp_path: Any) -> None:
    """Assert that a pile is saved, opened, extended, thinned and completed with the same closed links."""
    model = xd.Model.from_toml(MODELS / "granular_box.toml")
    whole = xd.simulate(model, until="320 ms", nodes=["300 ms"], log="full", time_tolerance="1e-12 s")
    half = xd.simulate(model, until="300 ms", log="full", time_tolerance="1e-12 s")
    longer = xd.extend(half, until="320 ms")
    names = [str(name) for name in whole.variables if str(name).startswith("closed_")]
    assert len(names) == 11
    assert whole.sizes["closed"] > 20
    for name in names:
        assert np.array_equal(longer[name].values, whole[name].values), name
    thin = xd.simulate(model, until="320 ms", nodes=["300 ms"], keep_every=5, log="full", time_tolerance="1e-12 s")
    rows = thin.step_number.values
    assert np.array_equal(thin.closed_step.values, whole.closed_step.values[np.isin(whole.closed_step.values, rows)])
    few = xd.simulate(model, until="320 ms", nodes=["300 ms"], log="states", time_tolerance="1e-12 s")
    assert "closed_force_residual" not in few  # solved by elimination
    complete = xd.complete(few)
    for name in names:
        assert np.array_equal(complete[name].values, whole[name].values), name
    xd.save(whole, tmp_path / "pile.nc")
    with xd.open_run(tmp_path / "pile.nc") as read:
        for name in names:
            assert np.array_equal(read[name].values, whole[name].values), name
    assert verified(tmp_path / "pile.nc")
    assert xd.reproduce(tmp_path / "pile.nc").attrs["identical"] == 1


def test_an_event_that_sets_velocities_lets_go_of_links() -> None:
    """Assert that points at rest that a reset throws up fly as thrown points do."""
    throw = {"throw": {"function": "t - moment", "action": "reset", "set": {"v_y": "speed"}}}
    model = points(np.zeros(25), "y", parameters={"moment": "50 ms", "speed": "1 m s-1"}, events=throw)
    run = xd.simulate(model, until="100 ms", method="velocity_verlet", step="10 ms")
    flown = 0.05
    assert np.abs(run.y.values[-1] - (flown - G / 2 * flown**2)).max() < 1e-9


def test_gaps_of_two_units_are_refused() -> None:
    """Assert that contacts of many links whose gaps differ in unit are named with their units: forces share a column."""
    roof = {"roof": {"gap": "1 - y/(1*metre)", "restitution": 0.5}}
    floor = {"floor": {"gap": "y", "restitution": 0.5}}
    with pytest.raises(xd.ModelError, match="their gaps are of one unit \\('floor': m, 'roof': 1\\)"):
        points(np.linspace(0.1, 0.2, 30), "y", contacts=floor | roof)


def test_closed_is_a_name_of_records_of_many_bodies_alone() -> None:
    """Assert that a parameter may be called as the dimension of closed links where there are none."""
    text = 'name = "valve"\n[coordinates]\ny = "m"\n[parameters]\nm = "1 kg"\nclosed = "1 N"\n[mass]\ny = "m"\n'
    text += '[forces.push]\ny = "closed"\n[initial]\ny = "0 m"\nv_y = "0 m s-1"\n'
    assert "closed" in xd.Model.from_text(text).parameters
    with pytest.raises(xd.ModelError, match="parameter 'closed' and the record both claim the name"):
        points(np.linspace(0.1, 0.2, 30), "y", parameters={"closed": "1"})


def flying(heights: Floats, speed: float = -1.0, **more: Any) -> xd.Model:
    """Return points that fly without weight, each by itself, to a floor whose impacts are located to a millisecond."""
    floor = {"gap": "y", "restitution": 1.0, "time_tolerance": "1 ms"}
    start = {"v_y": {"unit": "m s-1", "value": [speed] * len(heights)}}
    return points(
        heights, "y", contacts={"floor": floor} | more.pop("contacts", {}), initial=start, parameters={"g": "0 m s-2"}
    )


def test_links_that_touch_are_those_within_the_location_of_an_impact() -> None:
    """Assert which points are struck together: those that are nearer than twice the way flown while a time is located."""
    heights = 0.1 + 1e-3 * np.array([0.0, 1.9, 2.9, *(20.0 * np.arange(2, 24))])
    run = xd.simulate(flying(heights), method="velocity_verlet", step="70 ms", until="0.12 s")
    first, near, far = (run.event_time.values[run.event_ball.values == k][0] for k in range(3))
    assert 0.1 < first < 0.101  # located to a millisecond, so that gaps of 2 mm may be closed
    assert near == first
    assert 0.1029 < far < 0.1039


def test_a_storm_of_events_ends_in_words() -> None:
    """Assert that 1,001 impacts, each within what the time of the one before is located to, end a run and say so."""
    roof = {"roof": {"gap": "3e-3*metre - y", "restitution": 1.0, "time_tolerance": "1 ms"}}
    run = xd.simulate(flying(np.full(25, 1.5e-3), contacts=roof), method="velocity_verlet", step="1 s", until="100 s")
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert (
        "1001 events of links followed each other within what their times are located to"
        in run.attrs["run_outcome_text"]
    )
    assert np.unique(run.event_row_before.values).size == 1000


def test_links_that_only_seem_to_let_go_end_in_words() -> None:
    """Assert that landings soon after one another, at which nothing changes, are counted, and what is said of them."""
    model = flying(np.full(25, 1e-3))
    march = March(model, settings_for(model, method="velocity_verlet", step="1 s", until="100 s"))
    run, count = march.run, getattr(note_idleness, "py_func", note_idleness)
    run.spans[WHOLE_STEP] = 1.0
    for h, changes, counted in ((1e-3, False, 1), (1e-3, False, 2), (0.5, False, 0), (1e-3, False, 1), (1e-3, True, 0)):
        run.trial[0].h = h
        count(run, changes)
        assert run.counters[IDLE] == counted
    for place, number in ((FAULT, UNDECIDED), (CULPRIT, 0), (CULPRIT_LINK, 7), (IDLE, 101)):
        run.counters[place] = number
    assert "101 times in a row" in assembly_dispute(march)
    assert "seemed to let go of one, now contact 'floor' of ball 7, and" in assembly_dispute(march)


@pytest.mark.parametrize(
    ("method", "law", "advised"),
    [("velocity_verlet", "newton", True), ("velocity_verlet", "sequential", False), ("moreau_jean", "newton", False)],
)
def test_forces_that_are_not_found_end_in_words(method: str, law: str, advised: bool) -> None:
    """Assert what is left, what to change, and that Moreau's method is named where it takes the model and is another."""
    floor = {"gap": "y", "restitution": 1.0, "law": law}
    model = flying(np.full(25, 1e-3), contacts={"floor": floor})
    march = March(model, settings_for(model, method=method, step="1 s", until="100 s"))
    march.run.counters[FAULT], march.run.counters[TOGETHER], march.run.spans[STRAIN] = STRAINED, 21, 3.04e-6
    text = assembly_dispute(march)
    assert text.startswith("no forces were found that hold the 21 links that touch: with the best of them bodies still")
    assert "by 3.0e-06 of what the forces give, and 1e-9 is allowed" in text
    assert ("or take method = 'moreau_jean', which is for heaps: it steps over impacts" in text) == advised


def test_contacts_of_bodies_have_their_forces_along_them() -> None:
    """Assert that contact_force of a floor over points is the weight of those that rest, and 0 of those that fly."""
    heights = np.where(np.arange(25) % 2 == 0, 0.0, 5.0)
    run = xd.simulate(points(heights, "y"), method="velocity_verlet", step="10 ms", until="50 ms", log="full")
    force = run.contact_force_floor
    assert force.dims == ("step", "ball")
    assert force.attrs["units"] == "N"
    assert force.values == pytest.approx(np.broadcast_to(np.where(heights == 0.0, G, 0.0), force.shape), rel=1e-14)
    rows, balls = run.closed_step.values, run.closed_ball.values
    assert np.array_equal(force.values[rows, balls], run.closed_force.values)
    thin = xd.simulate(
        points(heights, "y"), method="velocity_verlet", step="10 ms", until="50 ms", log="full", keep_every=2
    )
    assert np.array_equal(thin.contact_force_floor.values, force.values[thin.step_number.values])


@pytest.mark.parametrize("unit", ["m", "mm"])
def test_contacts_of_bodies_have_their_gaps_along_them(unit: str) -> None:
    """Assert the gap of every body in every row, open ones too, from the record's own states, in the unit of the floor."""
    heights = np.where(np.arange(25) % 2 == 0, 0.0, 5.0)
    model = xd.Model(
        name="points",
        dimensions={"ball": 25, "axis": ["x", "y"]},
        coordinates={"r": {"unit": unit, "dims": ["ball", "axis"]}},
        parameters={"m": "1 kg", "g": f"{G} m s-2", "rise": "0.1 m s-1"}
        | {"up": {"dims": ["axis"], "value": [0, 1], "unit": "1"}}
        | {"width": {"dims": ["ball"], "value": [1e-3 * k for k in range(25)], "unit": "m"}},
        mass={"r": "m"},
        forces={"weight": {"r": "-m*g*index(axis)"}},
        contacts={"floor": {"gap": "r - width + rise*t*up", "restitution": 0.5}},
        initial={
            "r": {"unit": "m", "value": (heights[:, None] + 1e-3 * np.arange(25.0)[:, None] + [[1.0, 0.0]]).tolist()}
        },
    )
    run = xd.simulate(model, method="velocity_verlet", step="10 ms", until="50 ms", log="full")
    gap, t = run.contact_gap_floor, run.time.values[:, None, None]
    assert (gap.dims, gap.attrs["units"], gap.attrs["role"]) == (("step", "ball", "axis"), "m", "gap")
    places = run.r.values * (1e-3 if unit == "mm" else 1.0)
    wanted = places - run.width.values[:, None] + 0.1 * t * np.array([0.0, 1.0])
    assert np.abs(gap.values - wanted).max() < 1e-15
    closed = gap.values[run.closed_step.values, run.closed_ball.values, run.closed_axis.values]
    assert np.abs(closed - run.closed_gap.values).max() < 1e-17


def test_discs_that_rest_have_no_size_of_their_own() -> None:
    """Assert that given steps of radau_iia are solved where links hold velocities that are but rounding about zero."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "granular_box.toml"), method="radau_iia", step="2 ms", until="0.28 s")
    assert run.attrs["run_outcome"] == "completed"
    held = np.abs(run.v_r.values[-1])
    assert 0.0 < held[held > 0.0].min() < 1e-12 < held.max()


@pytest.mark.dear
def test_steps_of_discs_that_rest_are_solved_anew() -> None:
    """Assert that `diagnose` makes all of them again, and from states that are a spacing off, too."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "granular_box.toml"), method="radau_iia", step="2 ms", until="0.28 s")
    found = xd.diagnose(run)
    assert found.attrs["continuity_rule"] == f"each of {int(found.continuity_steps)} steps was recomputed"
    assert int(found.continuity_verdict) == 0
