"""Tubes beside rigorous intervals that others have published."""

from __future__ import annotations

from typing import Any

import mpmath as mp
import pytest
import xarray as xr

import xdynamics as xd
from cases.smooth_models import lorenz
from xdynamics import Model

SIDES = {  # of the orbit, on the section: where they return to it
    "0.9208034913207385": {
        "x": (0.95228712767825907, 0.95228712767837564),
        "v_x": (-5.4453340632418458e-13, -3.6066379435840335e-15),
    },
    "0.9208034913207485": {
        "x": (0.9522871276784185, 0.95228712767853274),
        "v_x": (3.7447292693664613e-14, 5.685078317048184e-13),
    },
}
MU, JACOBI = "0.0009537", "3.03"  # of Jupiter and of the comet Oterma


def three_bodies(x: Any, v_y: Any) -> Model:
    """Return the planar restricted problem of three bodies in the rotating frame, from y = 0."""
    sun, jupiter = "(1 - mu)/((x + mu)**2 + y*y)**1.5", "mu/((x - 1 + mu)**2 + y*y)**1.5"
    return Model(
        name="restricted three bodies",
        coordinates={"x": {"unit": "1"}, "y": {"unit": "1"}},
        parameters={"mu": MU},
        mass={"x": "1*second**2", "y": "1*second**2"},
        definitions={"sun": sun, "jupiter": jupiter},
        forces={
            "rotating": {
                "x": "x - (x + mu)*sun - (x - 1 + mu)*jupiter + 2*v_y*second",
                "y": "y*(1 - sun - jupiter) - 2*v_x*second",
            }
        },
        events={"section": {"function": "y", "action": "record"}},
        initial={"x": x, "y": "0", "v_x": "0 s-1", "v_y": v_y},
    )


def speed(x: str) -> mp.mpf:
    """Return v_y at a point of the section by Jacobi's constant, to 40 digits."""
    with mp.workdps(40):
        place, mu = mp.mpf(x), mp.mpf(MU)
        potential = (1 - mu) / abs(place + mu) + mu / abs(place - 1 + mu)
        return mp.sqrt(place**2 + 2 * potential + mu * (1 - mu) - mp.mpf(JACOBI))


def returned(x: Any, v_y: Any) -> xr.Dataset:
    """Return the tube of a motion that comes back to the section once."""
    tube = xd.enclose(three_bodies(x, v_y), until="1.6 s")
    assert tube.sizes["event"] == 1
    return tube.isel(event=0)


def bounds(tube: xr.Dataset, name: str) -> tuple[float, float]:
    """Return what lies between."""
    return float(tube[f"lower_event_{name}"]), float(tube[f"upper_event_{name}"])


@pytest.mark.dear
def test_lyapunov_orbit_at_the_first_libration_point() -> None:
    """Assert that Oterma's orbit returns where the CAPD library proves it to, from both sides of it, and that both meet in time.

    Intervals that its example of this orbit prints, the orbit being that of
    Wilczak, Zgliczynski 2003, Comm. Math. Phys. 234, 37.
    """
    for x, published in SIDES.items():
        tube = returned(x, f"{mp.nstr(speed(x), 25)} s-1")
        for name, (low, high) in published.items():
            least, most = bounds(tube, name)
            assert least <= high, (x, name)
            assert low <= most, (x, name)
            assert most - least < 1e-11
    ends = [speed(x) for x in SIDES]
    v_y = {"value": f"{mp.nstr(sum(ends) / 2, 25)} s-1", "half_width": 1.001 * float(abs(ends[0] - ends[1])) / 2.0}
    least, most = bounds(returned({"value": "0.9208034913207435", "half_width": 5.001e-15}, v_y), "time")
    assert least <= 1.5410595631933541 <= 1.5410595631986368 <= most
    assert most - least < 2e-11


def test_periodic_orbit_of_lorenz() -> None:
    """Assert that the shortest orbit closes within what Isabelle/HOL has proven, and where double precision has it.

    Immler, examples of Ordinary_Differential_Equations, Archive of Formal Proofs: ``lorenz_c0``; start and period of Barrio, Dena,
    Tucker 2015, Comput. Phys. Commun. 194, 76.
    """
    start = {"x": "-2.147367631", "y": "2.078048211", "z": "27"}
    tube = xd.enclose(lorenz(**start), at="1.558652210 s")
    proven = {"x": (-2.1515, -2.1434), "y": (2.0738, 2.0824), "z": (26.992, 27.009)}
    for name, (low, high) in proven.items():
        least, most = (float(tube[f"{side}_{name}"][0]) for side in ("lower", "upper"))
        assert low <= least <= most <= high, name
        assert most - least < 1e-10
        assert abs(least - float(start[name])) < 1e-6


@pytest.mark.dear
def test_periodic_orbit_of_roessler() -> None:
    """Assert that Roessler's motion returns to x = 0 where it began, at the periodic point that the CAPD library publishes.

    Its examples integrate.cpp and 02-hyperbolic-periodic-orbit prove an orbit within 1e-10 of these digits.
    """
    model = Model(
        name="Roessler",
        states={
            "x": {"unit": "1", "rate": "-(y + z)/second"},
            "y": {"unit": "1", "rate": "(x + 0.2*y)/second"},
            "z": {"unit": "1", "rate": "(0.2 + z*(x - 5.7))/second"},
        },
        initial={"x": "0", "y": "-8.3809417428298", "z": "0.029590060630665"},
        events={"section": {"function": "x", "direction": "rising", "action": "record"}},
    )
    tube = xd.enclose(model, until="5.9 s")
    assert tube.sizes["event"] == 1
    for name, published in (("y", -8.3809417428298), ("z", 0.029590060630665)):
        low, high = float(tube[f"lower_event_{name}"][0]), float(tube[f"upper_event_{name}"][0])
        assert low - 1e-13 <= published <= high + 1e-13, name
        assert high - low < 1e-11
    assert float(tube.upper_event_time[0] - tube.lower_event_time[0]) < 1e-12
