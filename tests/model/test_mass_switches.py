"""Jumps and kinks in masses, mass matrices and energies: located as those of forces, with the velocity kept.

Switches of many elements that are declared smooth.
"""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.model.switches import STEPPED_OVER, are_too_many, smooth_switches, switches

JUMP = "where(t < 10*second, 50*kilogram, 10*kilogram)"
METHODS = ("dormand_prince", "rk4", "radau_iia", "taylor", "velocity_verlet", "implicit_midpoint")


def steps(method: str) -> dict[str, object]:
    """Return given steps for the methods of low order, of which none ends at the jump."""
    return {"rtol": 1e-10} if method in ("dormand_prince", "radau_iia", "taylor") else {"step": "0.03 s"}


def cart(**sections: object) -> xd.Model:
    """A cart that 100 N push from rest."""
    whole = {
        "name": "cart",
        "parameters": {"F": "100 N"},
        "coordinates": {"x": "m"},
        "mass": {"x": JUMP},
        "forces": {"push": {"x": "F"}},
        "initial": {"x": "0 m", "v_x": "0 m s-1"},
    }
    return xd.Model(**{key: entry for key, entry in (whole | sections).items() if entry is not None})


LAGRANGIAN = {"mass": None, "forces": None, "lagrangian": {"kinetic": f"{JUMP}*v_x**2/2", "potential": "-F*x"}}


@pytest.mark.parametrize("sections", [{}, LAGRANGIAN], ids=["mass", "lagrangian"])
@pytest.mark.parametrize("method", METHODS)
def test_a_mass_that_jumps_keeps_the_velocity(method: str, sections: dict[str, object]) -> None:
    """Assert 2 m/s2 for 10 s, then 10 m/s2: 70 m/s and 325 m, to rounding where the method is exact."""
    run = xd.simulate(cart(**sections), method=method, until="15 s", **steps(method))
    assert run["event_time"].values.tolist() == pytest.approx([10.0], abs=1e-10)
    assert float(run["v_x"][-1]) == pytest.approx(70.0, abs=1e-9)
    assert float(run["x"][-1]) == pytest.approx(325.0, abs=1e-8)
    before, after = int(run["event_row_before"][0]), int(run["event_row_after"][0])
    assert float(run["v_x"][before]) == float(run["v_x"][after])
    assert (float(run["a_x"][before]), float(run["a_x"][after])) == pytest.approx((2.0, 10.0))


SWITCHED = {
    "kinetic": {"kinetic": f"{JUMP}*v_x**2/2", "potential": "-F*x"},
    "kinetic kink": {"kinetic": "(50*kilogram + 1*kilogram*abs(x/(1*metre) - 1))*v_x**2/2", "potential": "-F*x"},
    "potential": {"kinetic": "50*kilogram*v_x**2/2", "potential": "F*abs(x - 1*metre)"},
}


@pytest.mark.parametrize("energies", SWITCHED.values(), ids=SWITCHED)
def test_elements_have_the_switches_of_one(energies: dict[str, str]) -> None:
    """Assert that energies along a dimension switch where those of one body do, in each element or for all of them."""
    alone = cart(mass=None, forces=None, lagrangian=energies)
    wide = {"dimensions": {"body": 2}, "coordinates": {"x": {"unit": "m", "dims": ["body"]}}}
    of_two = cart(mass=None, forces=None, lagrangian=energies, **wide)
    (one,), many = switches(alone), switches(of_two)
    assert {switch.owner for switch in many} == {one.owner}
    assert {switch.jumps for switch in many} == {one.jumps}
    ends = [xd.simulate(model, method="midpoint", until="15 s", rtol=1e-6) for model in (alone, of_two)]
    assert np.allclose(ends[1]["v_x"][-1], ends[0]["v_x"][-1], rtol=1e-4)
    assert ends[1].sizes["event"] == ends[0].sizes["event"] * len(many) > 0


FRICTION = {
    "gap": "y",
    "restitution": "0",
    "tangential": "coulomb",
    "slip": "v_x",
    "friction": "where(x > 3*metre, 0.5, 0.1)",
    "static": "where(t > 3*second, 0.6, 0.5)",
}


def test_friction_of_a_contact_switches_in_each_element() -> None:
    """Assert that a contact along a dimension has the switches of its coefficients."""
    sections = {
        "coordinates": {name: {"unit": "m", "dims": ["body"]} for name in "xy"},
        "dimensions": {"body": 2},
        "mass": {"x": "1*kilogram", "y": "1*kilogram"},
        "forces": {"weight": {"y": "-10*newton"}},
        "initial": {"x": "0 m", "y": "0 m", "v_x": "10 m s-1", "v_y": "0 m s-1"},
        "contacts": {"floor": FRICTION},
    }
    assert [switch.owner for switch in switches(cart(**sections))] == ["floor"] * 3  # two places, one clock


def test_a_mass_stepped_over_is_known_to_be() -> None:
    """Assert that only switches = "stepped over" steps over the jump, with its error."""
    run = xd.simulate(cart(), method="rk4", step="0.03 s", until="15 s", switches=STEPPED_OVER)
    assert abs(float(run["v_x"][-1]) - 70.0) > 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_an_entry_of_a_matrix_jumps(method: str) -> None:
    """Assert speeds by the inverse of either matrix."""
    matrix = [[JUMP, "1*kilogram"], ["1*kilogram", "20*kilogram"]]
    model = cart(
        coordinates={"x": "m", "y": "m"},
        mass={"matrix": matrix},
        initial={"x": "0 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
    )
    run = xd.simulate(model, method=method, until="15 s", **steps(method))
    first, second = (np.linalg.solve([[m, 1.0], [1.0, 20.0]], [100.0, 0.0]) for m in (50.0, 10.0))
    end = [float(run["v_x"][-1]), float(run["v_y"][-1])]
    assert end == pytest.approx((10 * first + 5 * second).tolist(), abs=1e-9)


def test_masses_of_elements_jump_each_at_its_time() -> None:
    """Assert both bodies' speeds and an event for each of them."""
    model = cart(
        dimensions={"body": 2},
        coordinates={"x": {"unit": "m", "dims": ["body"]}},
        mass={"x": "where(t < 10*second + index(body)*second, 50*kilogram, 10*kilogram)"},
        initial={"x": "0*metre*index(body)", "v_x": "0*metre/second*index(body)"},
    )
    run = xd.simulate(model, method="rk4", step="0.03 s", until="15 s")
    assert run["event_time"].values.tolist() == pytest.approx([10.0, 11.0], abs=1e-10)
    assert run["v_x"][-1].values.tolist() == pytest.approx([70.0, 62.0], abs=1e-9)


@pytest.mark.parametrize("method", ["dormand_prince", "radau_iia", "taylor"])
def test_a_kink_along_the_way_is_located(method: str) -> None:
    """Assert the momentum's own law where a wagon takes up more from a place on: v from the work and a frozen mass."""
    model = cart(mass={"x": "where(x < 100*metre, 50*kilogram, 10*kilogram)"})
    run = xd.simulate(model, method=method, rtol=1e-10, until="15 s")
    time = float(run["event_time"][0])
    assert time == pytest.approx(10.0, abs=1e-8)
    assert float(run["v_x"][-1]) == pytest.approx(70.0, abs=1e-7)


def test_a_force_named_mass_keeps_its_name() -> None:
    """Assert that switches of a force called `mass` and those of masses are told apart."""
    model = cart(forces={"mass": {"x": "F*sign(x - 1*metre)"}})
    assert [switch.name for switch in switches(model)] == ["mass.sign", "mass_matrix.where"]


def test_a_reset_says_what_else_is_kept() -> None:
    """Assert that the momentum is kept where a reset at the jump says so."""
    model = cart(
        events={
            "lightened": {
                "function": "t - 10*second",
                "direction": "rising",
                "action": "reset",
                "set": {"v_x": "v_x*(50/10)"},
            }
        }
    )
    run = xd.simulate(model, method="rk4", step="0.03 s", until="15 s")
    assert float(run["v_x"][-1]) == pytest.approx(150.0, abs=1e-8)


@pytest.mark.parametrize(("sites", "counted"), [(20, 19), (150, 0)])
def test_smooth_switches_of_many_elements_are_not_written_out(sites: int, counted: int) -> None:
    """Assert that those of the largest of 20 squares are counted, and that of 150 the force stays one in loops."""
    model = xd.Model(
        name="largest",
        dimensions={"site": sites},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N m-3", "m": "1 kg"},
        mass={"u": "m"},
        forces={"pull": {"u": "-k*u*max(u*u, site)", "smooth": True}},
        initial={"u": "metre*(1 + index(site))/size(site)", "v_u": "0*metre/second*index(site)"},
    )
    assert len(smooth_switches(model)) == counted
    run = xd.simulate(model, method="rk4", step="1 ms", until="2 ms")
    assert float(run.force_pull_u[0, 0]) == pytest.approx(-1.0 / sites, rel=1e-14)
    assert len(str(run.force_source.values)) < 60_000


def test_switches_are_counted_in_the_first_elements_that_have_them() -> None:
    """Assert that of a force with the largest of 60 squares one element is written out, and its 59 switches are too many."""
    model = xd.Model(
        name="largest",
        dimensions={"site": 60},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        parameters={"k": "1 N m-3", "m": "1 kg"},
        mass={"u": "m"},
        forces={"pull": {"u": "-k*u*max(u*u, site)"}},
        initial={"u": "metre*(1 + index(site))/size(site)"},
    )
    assert are_too_many(model)
    assert dict.keys(model.elements.force_components["pull"]) == {"u·0"}  # in a `dict` what was made so far
