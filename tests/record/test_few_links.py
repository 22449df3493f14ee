"""What a record has of contacts over a relation whose few links are written out: the same as of many."""

from __future__ import annotations

from math import cos, sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS

G = 9.81
STEPS: dict[str, Any] = {"method": "rk4", "step": "2 ms"}


def balls(heights: list[float], contacts: dict[str, Any], **more: Any) -> xd.Model:
    """Return balls of radius 0.5 m above one another, each of which meets the next."""
    return xd.Model(
        name="balls",
        dimensions={"ball": len(heights)},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={
            "g": f"{G} m s-2",
            "m": {"dims": ["ball"], "value": [1.0 + k for k in range(len(heights))], "unit": "kg"},
        },
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts={"between": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 0.5}} | contacts,
        initial={"y": {"unit": "m", "value": heights}} | more.pop("initial", {}),
        **more,
    )


FLOOR = {"floor": {"gap": "y - 0.5*metre", "restitution": 0.5}}


def discs(count: int, **more: Any) -> xd.Model:
    """Return discs on a line, of which the first flies at the others, a little beside their middles."""
    return xd.Model(
        name="discs",
        dimensions={"disc": count, "axis": ["x", "y"]},
        relations={"pair": {"of": "disc"}},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        parameters={"m": "2 kg"} | more.pop("parameters", {}),
        mass=more.pop("mass", {"r": "m"}),
        contacts={
            "discs": {"gap": "norm(second(r, pair) - first(r, pair), axis) - 0.2*metre", "restitution": 1}
            | more.pop("rubs", {})
        },
        initial={
            "r": {"unit": "m", "value": [[0.5 * k, 0.02 * k] for k in range(count)]},
            "v_r": {"unit": "m s-1", "value": [[float(k == 0), 0.0] for k in range(count)]},
        },
        **more,
    )


def test_a_stack_has_its_closed_links_as_rows() -> None:
    """Assert that each link of each row carries the weight above it, and is said with its elements."""
    run = xd.simulate(balls([0.5, 1.5, 2.5], FLOOR), until="20 ms", **STEPS)
    rows = run.sizes["step"]
    above = G * np.array([5.0, 3.0, 6.0])
    assert run.closed_step.values.tolist() == np.repeat(np.arange(rows), 3).tolist()
    assert run.closed_contact.values.reshape(rows, 3)[-1].tolist() == [0, 0, 1]
    assert run.closed_contact.attrs["flag_meanings"] == "between floor"
    for name, wanted in (("first", [0, 1, -1]), ("second", [1, 2, -1]), ("pair", [0, 1, -1]), ("ball", [-1, -1, 0])):
        assert run[f"closed_{name}"].values.reshape(rows, 3)[-1].tolist() == wanted
    assert run.closed_force.values.reshape(rows, 3) == pytest.approx(np.tile(above, (rows, 1)), rel=1e-12)
    assert np.abs(run.closed_gap.values).max() < 1e-12
    assert run.closed_force.attrs["units"] == "N"


def test_friction_of_a_few_links_is_in_rows() -> None:
    """Assert that a disc that slides along the one beside it has their friction, and one that lies still has none."""
    model = xd.Model(
        name="slide",
        dimensions={"block": 2},
        relations={"pair": {"of": "block"}},
        coordinates={"x": {"unit": "m", "dims": ["block"]}, "y": {"unit": "m", "dims": ["block"]}},
        parameters={"m": "1 kg", "g": f"{G} m s-2"},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-m*g"}},
        contacts={
            "between": {
                "gap": "second(y, pair) - first(y, pair) - 1*metre",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "second(v_x, pair) - first(v_x, pair)",
                "friction": 0.25,
                "static": 0.5,
            },
            "floor": {"gap": "y", "restitution": 0},
        },
        initial={
            "x": {"unit": "m", "value": [0.0, 0.0]},
            "y": {"unit": "m", "value": [0.0, 1.0]},
            "v_x": {"unit": "m s-1", "value": [0.0, 1.0]},
            "v_y": {"unit": "m s-1", "value": [0.0, 0.0]},
        },
    )
    run = xd.simulate(model, until="20 ms", **STEPS)
    between = run.isel(closed=run.closed_contact.values == 0)
    assert between.closed_friction_force.values == pytest.approx(-0.25 * G, rel=1e-12)
    assert (run.closed_friction_force.values[run.closed_contact.values == 1] == 0.0).all()


def test_both_that_met_have_their_impulses() -> None:
    """Assert the impulses of a shot at a disc in closed form, at its first and its second end."""
    run = xd.simulate(discs(2), method="dop853", rtol=1e-10, until="0.8 s")
    sine = 0.02 / 0.2
    along = 2.0 * cos(np.arcsin(sine))  # 2 m/(1 + 1) times the speed along the normal
    normal = np.array([sqrt(1 - sine**2), sine])
    assert run.event_impulse_first_r.dims == ("event", "axis")
    assert run.event_impulse_second_r.values[0] == pytest.approx(along * normal, rel=1e-9)
    assert run.event_impulse_first_r.values.tolist() == (-run.event_impulse_second_r.values).tolist()
    assert (int(run.event_first[0]), int(run.event_second[0])) == (0, 1)


def test_few_and_many_links_are_recorded_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the record has the variables that it has where links are found as those of many bodies."""
    few = xd.simulate(discs(3), method="dop853", rtol=1e-11, until="2 s")
    monkeypatch.setattr("xdynamics.model.elements.MOST_REACTIONS", 0)
    many = xd.simulate(discs(3, mass={"r": "1*m"}), method="dop853", rtol=1e-11, until="2 s")
    assert "contact_force_discs" in few
    assert "contact_force_discs" not in many
    every = [str(name) for name in many.variables if str(name).startswith(("event_", "closed_"))]
    assert {name for name in every if "residual" not in name} <= {*few.variables}
    for name in ("event_impulse_first_r", "event_impulse_second_r"):
        assert few[name].values == pytest.approx(many[name].values, abs=1e-9)
        assert few[name].attrs == many[name].attrs
    for name in ("event_pair", "event_first", "event_second"):
        assert few[name].variable.identical(many[name].variable)


def test_few_links_may_have_gaps_of_their_own() -> None:
    """Assert that links written out whose gaps read their own number are recorded as those that read a parameter: the same bits."""
    gap = "norm(second(r, pair) - first(r, pair), axis) - "
    size = {"d": {"dims": ["pair"], "value": "0.1*metre*(index(pair) + 1)"}}
    ways = [discs(3, rubs={"gap": f"{gap}{size['d']['value']}"}), discs(3, parameters=size, rubs={"gap": f"{gap}d"})]
    one, other = (xd.simulate(model, until="1.5 s", **STEPS) for model in ways)
    assert one.sizes["event"] > 1
    for name in ("event_time", "event_pair", "event_impulse_first_r", "event_impulse_second_r", "contact_gap_discs"):
        assert (one[name].values == other[name].values).all(), name


def test_rows_are_the_same_however_a_run_is_kept(tmp_path: Path) -> None:
    """Assert that a run written as it marches, opened, thinned or marched again has the links of one in memory."""
    model = balls([0.5, 1.6, 2.8], FLOOR)
    whole = xd.simulate(model, until="0.5 s", **STEPS)
    xd.simulate(model, until="0.5 s", path=tmp_path / "stack.nc", **STEPS)
    kept = xd.open_run(tmp_path / "stack.nc").load()
    thin = xd.simulate(model, until="0.5 s", keep_every=10, **STEPS)
    closed = [name for name in whole.variables if str(name).startswith(("closed_", "event_impulse"))]
    assert 0 < whole.sizes["closed"] < 3 * whole.sizes["step"]
    for name in closed:
        assert kept[name].identical(whole[name])
    assert thin.closed_step.values.tolist() == [
        step for step in whole.closed_step.values.tolist() if step in thin.step_number.values
    ]
    assert int(xd.reproduce(tmp_path / "stack.nc").attrs["identical"]) == 1


def test_a_log_of_states_is_completed_with_closed_links() -> None:
    """Assert that what a log of states leaves out of links is added to the bits."""
    model = balls([0.5, 1.6, 2.8], FLOOR)
    whole = xd.simulate(model, until="0.2 s", log="full", **STEPS)
    states = xd.simulate(model, until="0.2 s", log="states", **STEPS)
    assert "closed_force" not in states
    assert xd.complete(states).closed_force.identical(whole.closed_force)
    alone = xd.simulate(model, until="0.2 s", log=["y", "closed_step", "closed_force"], **STEPS)
    assert alone.closed_force.identical(whole.closed_force)
    assert (alone.closed_time.values == alone.time.values[alone.closed_step.values]).all()
    assert "closed_gap" not in alone


def test_gaps_of_several_units_say_theirs() -> None:
    """Assert that a contact whose gap is an angle has its unit by name beside one whose gap is a length."""
    rubs = {"tangential": "coulomb", "slip": "v_psi", "friction": 0.3, "static": 0.4}
    stop = {"stop": {"gap": "phi", "restitution": 0} | rubs}
    model = xd.Model(
        name="stops",
        dimensions={"ball": 2},
        relations={"pair": {"of": "ball"}},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}, "phi": "rad", "psi": "rad"},
        parameters={"m": "1 kg", "I": "1 kg m2 rad-2"},
        mass={"y": "m", "phi": "I", "psi": "I"},
        forces={"down": {"y": "-1*newton", "phi": "-2*newton*metre/radian"}},
        contacts={"between": {"gap": "second(y, pair) - first(y, pair) - 1*metre", "restitution": 0}} | FLOOR | stop,
        initial={"y": {"unit": "m", "value": [0.5, 1.5]}, "phi": "0 rad", "psi": "0 rad", "v_psi": "1 rad/s"},
    )
    run = xd.simulate(model, until="6 ms", **STEPS)
    assert run.closed_gap.attrs["units"] == "1"
    assert run.closed_force.attrs["comment"] == "unit by contact: between N, floor N, stop N m"
    assert run.contact_force_stop.attrs["units"] == "N m"
    assert run.closed_friction_force.attrs["units"] == run.friction_force_stop.attrs["units"] == "N m"
    own = run.closed_contact.attrs["flag_meanings"].split().index("stop")
    assert run.closed_friction_force.values[run.closed_contact.values == own] == pytest.approx(-0.6, rel=1e-12)
    assert run.closed_force.values[run.closed_contact.values == own] == pytest.approx(2.0, rel=1e-12)


@pytest.mark.parametrize("count", [3, 9])
def test_a_piston_without_a_dimension_meets_many(count: int) -> None:
    """Assert that a coordinate without dimensions takes part in contacts over bodies, few or many, by their impulses."""
    model = xd.Model(
        name="piston",
        dimensions={"ball": count},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}, "X": "m"},
        parameters={"m": "2 kg", "M": "20 kg"},
        mass={"x": "m", "X": "M"},
        contacts={
            "piston": {"gap": "X - x", "restitution": 1},
            "wall": {"gap": "x", "restitution": 1},
            **(
                {}
                if count < 9
                else {
                    "far": {"gap": "x + 9*metre", "restitution": 1},
                    "further": {"gap": "x + 8*metre", "restitution": 1},
                }
            ),
        },
        initial={
            "x": {"unit": "m", "value": [0.2 + 0.05 * k for k in range(count)]},
            "X": "1 m",
            "v_x": {"unit": "m s-1", "value": [1.0 + 0.3 * k for k in range(count)]},
            "v_X": "-0.5 m s-1",
        },
    )
    run = xd.simulate(model, method="dop853", rtol=1e-10, until="2 s", log="full")
    assert run.sizes["event"] > count
    energy = (run.v_x**2).sum("ball").values + 10.0 * run.v_X.values**2
    assert np.abs(energy - energy[0]).max() < 1e-13 * energy[0]
    impulse = run["event_impulse_first_X" if "event_impulse_first_X" in run else "event_impulse_X"]
    assert 20.0 * float(run.v_X[-1] - run.v_X[0]) == pytest.approx(float(impulse.sum()), rel=1e-12)


def test_scalar_contacts_have_no_rows() -> None:
    """Assert that a model without relations has the record that it had."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    run: xr.Dataset = xd.simulate(model, until="1 s", method="rk4", step="10 ms")
    assert "closed" not in run.dims
    assert not [name for name in run.variables if str(name).startswith(("closed_", "event_impulse_first"))]
