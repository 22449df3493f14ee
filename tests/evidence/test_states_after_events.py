"""Refinements compare the states of all elements at the event of each, in bounded numbers."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from scipy.optimize import brentq

import xdynamics as xd
from xdynamics.evidence.refining import subjects
from xdynamics.evidence.refining.refinement import refinement_lines
from xdynamics.faults import DOT
from xdynamics.methods import METHODS

G, C, STARTS, SPEEDS = 9.81, 0.8, np.array([1.0, 2.0, 3.5]), np.array([0.5, -0.3, 1.0])
BALLS = f"""
name = "Balls that fall alone"
[dimensions]
ball = ["a", "b", "c"]
[coordinates]
y = {{ unit = "m", dims = ["ball"] }}
[parameters]
m = "1 kg"
g = "{G} m s-2"
c = "{C} kg s-1"
[mass]
y = "m"
[forces.weight]
y = "-m*g - c*v_y"
[initial]
y = {{ value = {STARTS.tolist()}, unit = "m" }}
v_y = {{ value = {SPEEDS.tolist()}, unit = "m s-1" }}
[events.ground]
function = "y"
direction = "falling"
[run]
method = "rk4"
until = "1.5 s"
"""
STEPS = ["100 ms", "50 ms", "25 ms", "12.5 ms"]
GRID = """
name = "Sites on a grid, a pair of them, and a wall"
[dimensions]
row = 2
axis = ["x", "z"]
[relations.pair]
of = "row"
[coordinates]
r = { unit = "m", dims = ["row", "axis"] }
[parameters]
k = "4 N m-1"
[mass]
r = "1*kilogram"
[forces.spring]
r = "-k*r"
[initial]
r = { value = [[1, 0.5], [0.7, -0.2]], unit = "m" }
[events.each]
function = "r"
[events.far]
function = "norm(r, axis) - 0.4*metre"
[events.apart]
function = "norm(second(r, pair) - first(r, pair), axis) - 0.3*metre"
[events.once]
function = "r[0, x]"
[run]
method = "rk4"
step = "10 ms"
until = "1 s"
"""


def heights(times: np.ndarray | float) -> np.ndarray:
    """Return where the balls are, shape (..., 3)."""
    t, end = np.asarray(times)[..., None], G / C
    return STARTS - end * t + (SPEEDS + end) * (1.0 - np.exp(-C * t)) / C


def speeds(times: np.ndarray | float) -> np.ndarray:
    """Return how fast they are, shape (..., 3)."""
    end = G / C
    return (SPEEDS + end) * np.exp(-C * np.asarray(times)[..., None]) - end


@pytest.fixture(scope="module")
def falls() -> xr.Dataset:
    return xd.refine(xd.Model.from_text(BALLS), steps=STEPS)


def test_all_elements_are_told_at_the_event_of_each(falls: xr.Dataset) -> None:
    """Assert the closed form of every ball's motion when each meets the ground, with the method's order in the step."""
    landings = np.array([brentq(lambda t, k=k: heights(t)[k], 0.1, 1.5, xtol=1e-15) for k in range(3)])
    order, apart = METHODS["rk4"].order, ~np.eye(3, dtype=bool)
    for name, exact in (("y", heights(landings)), ("v_y", speeds(landings))):
        found = falls[f"all_after_ground_{name}"]
        assert found.dims == ("level", "occurrence", "event_ball", "ball")
        errors = np.abs(found.isel(occurrence=0).values - exact)
        limits = np.abs(falls[f"limit_all_after_ground_{name}"].values[0] - exact)
        chosen = apart if name == "y" else np.ones((3, 3), bool)  # at its own event a ball is at 0, to rounding
        assert (np.abs(np.log2(errors[:-1] / errors[1:]) - order) < 0.1)[-1][chosen].all()
        assert (np.abs(falls[f"order_all_after_ground_{name}"].values[-2, 0] - order) < 0.1)[chosen].all()
        assert (errors[-1] <= falls[f"uncertainty_all_after_ground_{name}"].values[0] + 1e-15).all()
        assert (limits < errors[-1] / 3.0)[chosen].all()


def test_labels_select_the_event_and_the_element(falls: xr.Dataset) -> None:
    """Assert that labels of either dimension are indexes, and that the event's own element is told alone too."""
    both = falls.all_after_ground_v_y.sel(event_ball="c", ball="a")
    assert both.dims == ("level", "occurrence")
    for k in "abc":
        own = falls.all_after_ground_v_y.sel(event_ball=k, ball=k)
        np.testing.assert_array_equal(own, falls.after_ground_v_y.sel(ball=k))
    assert falls.event_ball.attrs["long_name"] == "label of the ball that the event is of"
    lines = [line for line in refinement_lines(falls) if line.startswith("all_after_ground_v_y[b, a] [1] = ")]
    assert len(lines) == 1
    assert "asymptotic" in lines[0]


def test_lazy_refinements_have_the_same_states_after_events(falls: xr.Dataset) -> None:
    """Assert names, dimensions and bits of a lazy refinement against one that is marched at once."""
    lazy = xd.refine(xd.Model.from_text(BALLS), steps=STEPS, occurrences=1, compute=False)
    assert lazy.all_after_ground_y.chunks is not None
    assert {name: one.dims for name, one in lazy.variables.items()} == {
        name: one.dims for name, one in falls.variables.items()
    }
    xr.testing.assert_identical(lazy.compute().drop_attrs(), falls.drop_attrs())


def test_single_elements_are_told_at_every_event(falls: xr.Dataset) -> None:
    """Assert that one ball alone has the numbers that it has among all, at each event, and under plain names."""
    alone = xd.refine(xd.Model.from_text(BALLS), steps=STEPS, observables=["v_y[b]"])
    for name in ("all_after_ground_v_y", "order_all_after_ground_v_y", "uncertainty_all_after_ground_v_y"):
        np.testing.assert_array_equal(alone[name].sel(ball="b"), falls[name].sel(ball="b"))
        assert alone[name].sel(ball="a").isnull().all()
    np.testing.assert_array_equal(alone.after_ground_v_y.sel(ball="b"), falls.after_ground_v_y.sel(ball="b"))
    assert not [name for name in alone.variables if DOT in str(name)]
    told = [line.partition(" [")[0] for line in refinement_lines(alone) if "after_" in line]
    assert told == ["after_ground_v_y[b]", *(f"all_after_ground_v_y[{event}, b]" for event in "abc")]


def test_dimensions_of_events_stand_beside_those_of_states() -> None:
    """Assert the dimensions after events of elements of the same dimensions, of fewer, of links, and of none."""
    model = xd.Model.from_text(GRID)
    study = xd.refine(model, steps=["20 ms", "10 ms"], observables=["r"], occurrences=2)
    run = xd.simulate(model)
    beside = {name: study[name].dims[2:] for name in study if str(name).startswith(("after_", "all_after_"))}
    assert beside == {
        "after_each_r": ("row", "axis"),
        "all_after_each_r": ("event_row", "event_axis", "row", "axis"),
        "after_far_r": ("row", "axis"),
        "all_after_far_r": ("event_row", "row", "axis"),
        "after_apart_r": ("pair", "row", "axis"),
        "after_once_r": ("row", "axis"),
    }
    words = np.array(run.event_detector.attrs["flag_meanings"].split())[run.event_detector.values]
    for event in range(run.sizes["event"]):
        row, axis = int(run.event_row[event]), int(run.event_axis[event])
        state, name = run.r.values[run.event_row_after[event]], words[event]
        here = {"each": (row, axis), "far": (row,), "apart": (0,), "once": ()}[name]
        among = study["after_" + name + "_r" if name in ("apart", "once") else f"all_after_{name}_r"].values[-1]
        assert any((among[(k, *here)] == state).all() for k in range(2))
    assert run.sizes["event"] > 4


def test_states_after_bounces_of_elements_stand_under_plain_names() -> None:
    """Assert rows of the finest run where contacts, which are told of elements alone, are met by every ball."""
    free = BALLS[: BALLS.index("[events")] + BALLS[BALLS.index("[run]") :]
    model = xd.Model.from_text(free + '[contacts.floor]\ngap = "y"\nrestitution = 0.5\n')
    study, run = (
        verb(model, **step) for verb, step in ((xd.refine, {"steps": STEPS[2:]}), (xd.simulate, {"step": STEPS[3]}))
    )
    assert not [name for name in study.variables if DOT in str(name)]
    assert study.all_after_floor_v_y.dims == ("level", "occurrence", "event_ball", "ball")
    for ball in range(3):
        rows = run.event_row_after.values[run.event_ball.values == ball]
        np.testing.assert_array_equal(study.all_after_floor_v_y[-1, : len(rows), ball], run.v_y.values[rows])
        np.testing.assert_array_equal(study.after_floor_v_y[-1, : len(rows), ball], run.v_y.values[rows, ball])


def test_too_many_states_after_events_are_left_out_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that numbers over the limit are left out, that an attribute says which and why, and what to ask for."""
    monkeypatch.setattr(subjects, "MOST_NUMBERS", 35)
    model = xd.Model.from_text(BALLS)
    study = xd.refine(model, steps=STEPS)
    lazy = xd.refine(model, steps=STEPS, occurrences=1, compute=False)
    said = (
        "all_after_ground_y, all_after_ground_v_y: 4 levels, 1 of each event, 3 event_ball x 3 ball: 36 numbers, more"
        " than 35; compare single elements, like observables=['y[a]'], or fewer occurrences"
    )
    assert study.attrs["left_out"] == lazy.attrs["left_out"] == said
    assert f"left out  {said}" in refinement_lines(study)
    assert not [name for name in {*study, *lazy} if "all_after" in str(name)]
    assert study.after_ground_y.dims == ("level", "occurrence", "ball")
    assert "left_out" not in xd.refine(model, steps=STEPS[:3]).attrs


def test_levels_are_added_until_an_element_changes_little_after_anothers_event() -> None:
    """Assert that changes of one ball's state at another's event are awaited under the name that lines have."""
    wanted = {"all_after_ground_y[c, a]": "1 nm"}
    study = xd.refine(xd.Model.from_text(BALLS), steps=STEPS[:1], observables=["y"], until_change=wanted)
    changes = np.abs(study.difference_all_after_ground_y.sel(event_ball="c", ball="a").values[:, 0])
    assert changes[-2] <= 1e-9 < changes[-3]
