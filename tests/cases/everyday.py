"""A hundred small models that people write first, each with what it comes to, and a table of how every method does on them.

    python tests/cases/everyday.py [--whole] [--case NAME] [--method NAME]

What is expected is a closed form, or a number that scipy gave, marched piece by piece between the zeros of its events at
1e-13. What is written of a model is what a person would write. A method that cannot take a model says so in words, which
is as right as the number.
"""

from __future__ import annotations

import argparse
import signal
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from math import acos, atan, cos, cosh, exp, hypot, log, pi, sin, sqrt, tanh
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import beta, ellipk

import xdynamics as xd

G = 9.81
STANDARD_G = 9.80665


@dataclass(frozen=True)
class Everyday:
    """A model, and what it comes to at the end of its run.

    Attributes
    ----------
    name : str
    model : dict
        Arguments of `xd.Model` but for its name.
    until : str
    expects : dict of str to float
        By quantity, in its declared unit, or s: a variable of the record at its last row (`y`, `contact_force_floor`),
        the first time of an event (`event_time_ground`) or of a kind of event (`takeoff_time_floor`), or an attribute of
        the record (`accumulation_time`).
    source : str
        The closed form in words, or where the number is from.
    step : str
        The first of given steps; no jump in time is a multiple of it.
    outcome : str
        `run_outcome`.
    rtol, within : float
        Tolerance of methods of fifth order and above, and the relative error they may have; see `shares`.
    axis : tuple of str
        What a sweep varies: its name, the model's own value, another one; by default the first parameter and 5/4 of it.
    """

    name: str
    model: dict[str, Any]
    until: str
    expects: dict[str, float]
    source: str
    step: str = "7 ms"
    outcome: str = "completed"
    rtol: float = 1e-9
    within: float = 1e-7
    axis: tuple[str, str, str] | None = None

    def __str__(self) -> str:
        return self.name


# ------------------------------------------------------------------------------------------------- statements, in short


def line(
    q: str, forces: dict[str, Any], start: str = "0 m", speed: str = "0 m s-1", m: str = "1 kg", **sections: Any
) -> dict[str, Any]:
    """State a body on a line: `forces` are components along it, or whole terms; `g` is there for whoever needs it."""
    return {
        "coordinates": {q: "m"},
        "parameters": {"g": "9.81 m s-2", "m": m} | sections.pop("parameters", {}),
        "mass": {q: "m"},
        "forces": {name: {q: term} if isinstance(term, str) else term for name, term in forces.items()},
        "initial": {q: start, f"v_{q}": speed} | sections.pop("initial", {}),
    } | sections


def rotor(inertia: str, forces: dict[str, str], speed: str = "0 rad s-1", **sections: Any) -> dict[str, Any]:
    """State a body that turns about an axis, from the angle 0."""
    return {
        "coordinates": {"q": "rad"},
        "parameters": {"J": inertia} | sections.pop("parameters", {}),
        "mass": {"q": "J"},
        "forces": {name: {"q": term} for name, term in forces.items()},
        "initial": {"q": "0 rad", "v_q": speed},
    } | sections


def flows(rates: dict[str, tuple[str, str]], parameters: dict[str, str], **sections: Any) -> dict[str, Any]:
    """State quantities with a start and a rate each."""
    return {
        "parameters": parameters,
        "states": {
            name: {"unit": start.partition(" ")[2] or "1", "rate": rate} for name, (start, rate) in rates.items()
        },
        "initial": {name: start for name, (start, _) in rates.items()},
    } | sections


def floor(q: str = "y", restitution: float = 0, **more: Any) -> dict[str, Any]:
    """State a contact with a floor at 0."""
    return {"floor": {"gap": q, "restitution": restitution} | more}


def reset(function: str, direction: str = "either", **values: str) -> dict[str, Any]:
    """State an event that sets values anew."""
    return {"function": function, "direction": direction, "action": "reset", "set": values}


def switch(function: str, direction: str, to: str) -> dict[str, Any]:
    """State an event that goes over to a regime."""
    return {"function": function, "direction": direction, "action": "switch", "to": to}


def stop(function: str, direction: str = "either") -> dict[str, Any]:
    """State an event that ends the run."""
    return {"function": function, "direction": direction, "action": "stop"}


# ------------------------------------------------------------------------------------------- solutions that recur below


def relaxed(value: float, tau: float, pieces: Iterable[tuple[float, float]]) -> float:
    """Return where a quantity is that nears the level of each piece (how long, level) with a time constant."""
    for duration, level in pieces:
        value = level + (value - level) * exp(-duration / tau)
    return value


def pushed(pieces: Iterable[tuple[float, float]], x: float = 0.0, v: float = 0.0) -> tuple[float, float]:
    """Return position and speed after pieces (how long, acceleration)."""
    for duration, a in pieces:
        x, v = x + v * duration + a * duration**2 / 2, v + a * duration
    return x, v


def swung(w: float, pieces: Iterable[tuple[float, float]], x: float = 0.0, v: float = 0.0) -> tuple[float, float]:
    """Return position and speed of a spring after pieces (how long, where it would rest)."""
    for duration, rest in pieces:
        c, s = cos(w * duration), sin(w * duration)
        x, v = rest + (x - rest) * c + v / w * s, v * c - (x - rest) * w * s
    return x, v


def linear(matrix: list[list[float]], start: list[float], t: float) -> list[float]:
    """Return exp(matrix t) start, of a matrix with different eigenvalues."""
    values, vectors = np.linalg.eig(np.array(matrix, complex))
    return list((vectors @ (np.exp(values * t) * np.linalg.solve(vectors, np.array(start, complex)))).real)


# fmt: off
# ------------------------------------------------------------------------------------ boxes, lifts, stops: contacts
GRAVITY = "-m*g"
LIFT = "where(t < 1*second, 0*newton, 20*newton)"
LIFTED_Y, LIFTED_V = pushed([(2.0, 20 - G)])


def boxes() -> Iterator[Everyday]:
    """What lies, is lifted, bounces, or moves between stops."""
    up = {"y": LIFTED_Y, "v_y": LIFTED_V}  # 20.38 m
    yield Everyday(
        "box_lifted_by_a_jump", line("y", {"gravity": GRAVITY, "lift": LIFT}, contacts=floor()), "3 s", up,
        "(F/m - g) (t - 1 s)^2/2",
    )
    yield Everyday(
        "box_lifted_by_a_sign",
        line("y", {"gravity": GRAVITY, "lift": "10*newton*(1 + sign(t - 1*second))"}, contacts=floor()),
        "3 s", up, "(F/m - g) (t - 1 s)^2/2",
    )
    y, v = pushed([(1, 10 - G), (1, 15 - G)])
    yield Everyday(
        "box_lifted_by_stairs",
        line("y", {"gravity": GRAVITY, "lift": "5*newton*floor(t/(1*second))"}, contacts=floor()),
        "4 s", {"y": y, "v_y": v}, "10 N of the second stair are the first beyond m g",
    )
    yield Everyday(
        "box_lifted_as_a_cart_passes",
        {
            "coordinates": {"y": "m", "x": "m"},
            "parameters": {"m": "1 kg", "g": "9.81 m s-2"},
            "mass": {"y": "m", "x": "m"},
            "forces": {"gravity": {"y": "-m*g"}, "lift": {"y": "where(x < 1*metre, 0*newton, 20*newton)"}},
            "contacts": floor(),
            "initial": {"y": "0 m", "v_y": "0 m s-1", "x": "0 m", "v_x": "1 m s-1"},
        },
        "3 s", up | {"x": 3.0}, "the cart is at 1 m at 1 s",
    )
    y, v = pushed([(1, 20 - G), (0.5, -G)])
    yield Everyday(
        "box_lifted_by_half_waves",
        line("y", {"gravity": GRAVITY, "lift": "20*newton*max(0, sign(sin(pi*t/(1*second))))"}, contacts=floor()),
        "1.5 s", {"y": y, "v_y": v}, "the sign's argument is zero at the start",
    )
    y, v = pushed([(0.4, 12 - G)])
    first_y, first_v = pushed([(0.5, 12 - G)])
    yield Everyday(
        "hopper_thrown_by_pulses",
        line("y", {"gravity": GRAVITY, "coil": "where(mod(t, 1*second) < 0.5*second, 0*newton, 12*newton)"},
             contacts=floor()),
        "1.9 s",
        {"y": y, "v_y": v, "impact_time_floor": 1 + (first_v + sqrt(first_v**2 + 2 * G * first_y)) / G,
         "takeoff_time_floor": 0.5},
        "thrown at 0.5 s, back on the floor before 1.5 s",
    )
    start = 20 * STANDARD_G / 150
    crate = {"m": "20 kg", "parameters": {"g": "9.80665 m s-2", "k": "150 N s-1"}, "contacts": floor("z")}
    yield Everyday(
        "crate_under_a_growing_lift", line("z", {"gravity": GRAVITY, "lift": "k*t"}, **crate),
        "2 s", {"z": 150 * (2 - start) ** 3 / 120, "takeoff_time_floor": start}, "takes off at m g/k = 1.3075533 s",
        rtol=1e-8, within=1e-6,
    )
    table = {"table": "lift.csv", "csv": "t [s],lift [N]\n0,0\n0.5,75\n1.5,225\n3,450\n"}
    yield Everyday(
        "crate_lifted_by_a_measured_force",
        line("z", {"gravity": GRAVITY, "pull": "lift"}, **crate | {"parameters": {"g": "9.80665 m s-2"}},
             drives={"lift": table}),
        "2 s", {"z": 150 * (2 - start) ** 3 / 120, "takeoff_time_floor": start}, "the same force as a table",
    )
    start = 3 * G / 15
    yield Everyday(
        "pile_of_two_lifted_from_below",
        {
            "coordinates": {"low": "m", "up": "m"},
            "parameters": {"m1": "2 kg", "m2": "1 kg", "g": "9.81 m s-2", "h": "0.5 m", "k": "15 N s-1"},
            "mass": {"low": "m1", "up": "m2"},
            "forces": {"gravity": {"low": "-m1*g", "up": "-m2*g"}, "lift": {"low": "k*t"}},
            "contacts": floor("low") | {"lid": {"gap": "up - low - h", "restitution": 0}},
            "initial": {"low": "0 m", "up": "0.5 m"},
        },
        "3 s", {"low": 15 * (3 - start) ** 3 / 18, "up": 0.5 + 15 * (3 - start) ** 3 / 18, "takeoff_time_floor": start},
        "both take off together at (m1 + m2) g/k", axis=("k", "15 N s-1", "16 N s-1"),
    )
    yield Everyday(
        "box_that_rests", line("y", {"gravity": GRAVITY}, contacts=floor()), "5 s",
        {"y": 0.0, "contact_force_floor": G}, "the floor carries m g",
    )
    yield Everyday(
        "box_let_fall", line("y", {"gravity": GRAVITY}, "1 m", contacts=floor()), "1 s",
        {"y": 0.0, "v_y": 0.0, "event_time_floor": sqrt(2 / G)}, "sqrt(2 h/g), and stays",
    )
    yield Everyday(
        "ball_that_bounces_to_rest", line("y", {"gravity": GRAVITY}, "1 m", contacts=floor(restitution=0.5)), "2 s",
        {"y": 0.0, "v_y": 0.0, "rest_time_floor": 3 * sqrt(2 / G)}, "sqrt(2 h/g) (1 + e)/(1 - e)",
    )
    walls = {"left": {"gap": "x", "restitution": 1}, "right": {"gap": "L - x", "restitution": 1}}
    yield Everyday(
        "ball_between_walls", line("x", {}, "0.25 m", "3 m s-1", parameters={"L": "1 m"}, contacts=walls),
        "2.5 s", {"x": 0.25, "v_x": -3.0, "event_time_right": 0.25}, "7.75 m of a path that folds at 0 and 1 m",
    )
    stops = {"left": {"gap": "x", "restitution": 0}, "right": {"gap": "L - x", "restitution": 0}}
    yield Everyday(
        "cylinder_between_stops",
        line("x", {"air": "where(t < 1*second, -10*newton, 10*newton)"}, parameters={"L": "0.5 m"}, contacts=stops),
        "2 s", {"x": 0.5, "event_time_right": 1 + sqrt(0.1), "contact_force_right": 10.0},
        "half a metre at 10 m s-2 from 1 s on",
    )
    yield Everyday(
        "magnet_valve",
        line("x", {"spring": "-k*(x + x0)", "coil": "where(t < 1e-3*second, 0*newton, F)"}, m="10 g",
             parameters={"k": "1 kN m-1", "x0": "5 mm", "F": "10 N", "L": "2 mm"},
             contacts={"seat": {"gap": "x", "restitution": 0}, "core": {"gap": "L - x", "restitution": 0}}),
        "6 ms", {"x": 0.002, "event_time_core": 1e-3 + acos(0.6) / sqrt(1e5), "contact_force_core": 3.0},
        "(F/k - x0) (1 - cos w t) = L", step="17 us",
    )
    yield Everyday(
        "weight_caught_by_a_string",
        line("x", {"gravity": "m*g"}, parameters={"L": "2 m"}, contacts={"string": {"gap": "L - x", "restitution": 0}}),
        "2 s", {"x": 2.0, "event_time_string": sqrt(4 / G), "contact_force_string": G}, "falls 2 m, then hangs",
    )


# --------------------------------------------------------------------------------------- brakes, clutches, belts: friction


def rubbing() -> Iterator[Everyday]:
    """What sticks and slips."""
    push = "where(t < 1*second, 0*newton, 10*newton)"
    yield Everyday(
        "block_pushed_past_static",
        line("x", {"push": push}, frictions={"pad": {"slip": "v_x", "kinetic": "4*newton", "static": "5*newton"}}),
        "3 s", {"x": 12.0, "v_x": 12.0, "slip_time_pad": 1.0}, "(10 N - 4 N)/m for 2 s",
    )
    x, v = pushed([(2, 10 - 0.4 * G)])
    plane = {
        "coordinates": {"x": "m", "y": "m"},
        "parameters": {"m": "1 kg", "g": "9.81 m s-2"},
        "mass": {"x": "m", "y": "m"},
        "initial": {"x": "0 m", "y": "0 m"},
    }
    coulomb = floor(tangential="coulomb", slip="v_x", friction=0.4, static=0.5)
    yield Everyday(
        "block_pushed_on_a_rough_floor",
        plane | {"forces": {"gravity": {"y": "-m*g"}, "push": {"x": push}}, "contacts": coulomb},
        "3 s", {"x": x, "v_x": v, "y": 0.0}, "(F/m - mu g) for 2 s",
    )
    start = 0.5 * 1.3 * G / 3
    pull = plane["parameters"] | {"m": "1.3 kg", "k": "3 N s-1"}
    ramp = {"forces": {"gravity": {"y": "-m*g"}, "pull": {"x": "k*t"}}, "parameters": pull}
    s, v = 3 - start, 0.1 * G
    yield Everyday(
        "book_under_a_growing_pull", plane | ramp | {"contacts": coulomb}, "3 s",
        {"x": s**3 / 2.6 + v * s**2 / 2, "v_x": 3 * s**2 / 2.6 + v * s, "slip_time_floor": start},
        "slips at mu_s m g/k; from there k t - mu m g", axis=("k", "3 N s-1", "3.2 N s-1"),
    )
    start = 0.3 * 20 * STANDARD_G / 30
    yield Everyday(
        "block_under_a_growing_pull",
        line("x", {"pull": "30*newton*t/(1*second)"}, m="20 kg", parameters={"g": "9.80665 m s-2", "mu": "0.3"},
             frictions={"ground": {"slip": "v_x", "kinetic": "mu*m*g"}}),
        "3 s", {"x": 30 * (3 - start) ** 3 / 120, "slip_time_ground": start}, "slips at mu m g/k = 1.961330 s",
    )
    x, v = pushed([(2, 5 - G)])
    yield Everyday(
        "load_whose_rope_is_cut",
        line("y", {"gravity": GRAVITY, "rope": "where(t < 1*second, m*g, 0*newton)"},
             frictions={"guide": {"slip": "v_y", "kinetic": "5*newton"}}),
        "3 s", {"y": x, "v_y": v, "slip_time_guide": 1.0}, "falls by m g less the 5 N of its guide",
    )
    yield Everyday(
        "motor_with_a_bearing",
        rotor("0.01 kg m2", {"motor": "where(t < 1*second, 0*newton*metre, 0.5*newton*metre)"},
              frictions={"bearing": {"slip": "v_q", "kinetic": "0.01*newton*metre"}}),
        "3 s", {"v_q": 98.0, "q": 98.0}, "(0.5 - 0.01) N m/J for 2 s",
    )
    discs = {
        "coordinates": {"a": "rad", "b": "rad"},
        "parameters": {"J": "1 kg m2"},
        "mass": {"a": "J", "b": "J"},
        "initial": {"a": "0 rad", "b": "0 rad"},
    }
    plates = {"slip": "v_a - v_b", "kinetic": "where(t < 1*second, 0*newton*metre, 5*newton*metre)"}
    yield Everyday(
        "clutch_engaged",
        discs | {"forces": {"motor": {"a": "2*newton*metre"}}, "frictions": {"clutch": plates}},
        "3 s", {"v_a": 3.0, "v_b": 3.0, "stick_time_clutch": 1.25}, "2 - 3 s = 5 s, then 1 rad s-2 together",
    )
    torque = "where(t < 1*second, 1*newton*metre, 20*newton*metre)"
    yield Everyday(
        "clutch_torn_open",
        discs | {"forces": {"motor": {"a": torque}}, "frictions": {"clutch": plates | {"kinetic": "5*newton*metre"}}},
        "2 s", {"v_a": 15.5, "v_b": 5.5, "slip_time_clutch": 1.0}, "together to 0.5 rad s-1, then 15 and 5 rad s-2",
    )
    yield Everyday(
        "hinge_with_friction",
        rotor("2.5 kg m2", {"motor": "k*t"}, parameters={"k": "3 N m s-1"},
              frictions={"hinge": {"slip": "v_q", "kinetic": "1.5*newton*metre"}}),
        "2 s", {"q": 3 * 1.5**3 / 15, "v_q": 3 * 1.5**2 / 5, "slip_time_hinge": 0.5}, "k (t - 0.5 s)^3/(6 J)",
    )
    w, a = 0.1, atan(0.5)
    b = 6 * w
    yield Everyday(
        "slope_that_tilts",
        line("x", {"gravity": "m*g*sin(w*t)"}, parameters={"w": "0.1 s-1", "mu": "0.5"},
             frictions={"slope": {"slip": "v_x", "kinetic": "mu*m*g*cos(w*t)"}}),
        "6 s",
        {"x": G / w**2 * ((cos(a) + 0.5 * sin(a)) * (b - a) - sin(b) + sin(a) + 0.5 * (cos(b) - cos(a))),
         "slip_time_slope": a / w},
        "slips at tan(w t) = mu; g (sin w t - mu cos w t) twice integrated",
    )
    wave = "3*newton*max(0, sign(sin(pi*t/(1*second))))"
    yield Everyday(
        "half_waves_against_static",
        line("x", {"push": wave}, frictions={"pad": {"slip": "v_x", "kinetic": "2*newton"}}),
        "2 s", {"x": 0.75, "v_x": 0.0}, "1 m s-2 for 1 s, stopped by 2 m s-2 in 0.5 s",
    )
    yield Everyday(
        "block_that_slides_to_rest",
        line("x", {}, "0 m", "3 m s-1", frictions={"pad": {"slip": "v_x", "kinetic": "2*newton"}}),
        "3 s", {"x": 2.25, "v_x": 0.0, "stick_time_pad": 1.5}, "v0^2/(2 f/m)",
    )
    yield Everyday(
        "block_laid_on_a_belt",
        line("x", {}, frictions={"belt": {"slip": "v_x - 1*metre/second", "kinetic": "0.3*m*g"}}),
        "2 s", {"x": 2 - 1 / (2 * 0.3 * G), "v_x": 1.0, "stick_time_belt": 1 / (0.3 * G)},
        "mu g up to the belt's speed",
    )
    yield Everyday(
        "block_that_stays_on_a_slope",
        line("x", {"gravity": "m*g*sin(0.3)"}, frictions={"slope": {"slip": "v_x", "kinetic": "0.4*m*g*cos(0.3)"}}),
        "3 s", {"x": 0.0, "friction_force_slope": -G * sin(0.3)}, "tan 0.3 < 0.4",
    )
    yield Everyday(
        "spring_that_sticks_aside",
        line("x", {"spring": "-100*newton/metre*x"}, "0.1 m",
             frictions={"pad": {"slip": "v_x", "kinetic": "2*newton", "static": "2.5*newton"}}),
        "2 s", {"x": 0.02, "v_x": 0.0, "event_time_pad": pi / 10}, "4 cm less each half swing: 10, -6, 2 cm",
        step="3 ms",
    )
    yield Everyday(
        "flywheel_braked",
        rotor("0.5 kg m2", {}, "10 rad s-1",
              frictions={"brake": {"slip": "v_q", "kinetic": "where(t < 1*second, 0*newton*metre, 2*newton*metre)"}}),
        "5 s", {"q": 22.5, "v_q": 0.0, "stick_time_brake": 3.5}, "10 rad, then 10^2/(2*4)",
    )
    yield Everyday(
        "car_braked_to_a_stop",
        line("x", {"brake": "-2*newton"}, "0 m", "20 m s-1", events={"halt": stop("v_x", "falling")}),
        "20 s", {"x": 100.0, "event_time_halt": 10.0}, "v0^2/(2 a)", outcome="stopped_by_event", step="70 ms",
    )


# -------------------------------------------------------------------- regimes, resets, stops: events that change a motion


def switched() -> Iterator[Everyday]:
    """What acts where something is met: also at the start, also where what follows pushes back to it."""
    yield Everyday(
        "block_of_two_regimes",
        line("x", {"ahead": "-2*newton", "back": "2*newton"}, "0 m", "1 m s-1",
             regimes={"forward": {"forces": ["ahead"]}, "backward": {"forces": ["back"]}},
             events={"turn": switch("v_x", "falling", "backward"), "again": switch("v_x", "rising", "forward")}),
        "3 s", {"x": 0.25, "v_x": 0.0, "event_time_turn": 0.5}, "v0^2/(2 a), at rest",
    )
    yield Everyday(
        "block_braked_by_a_sign", line("x", {"friction": "-2*newton*sign(v_x)"}, "0 m", "1 m s-1"),
        "3 s", {"x": 0.25, "v_x": 0.0}, "v0^2/(2 a), at rest",
    )
    room = "-(T - 280*kelvin)/tau"
    heat = f"{room} + h*0.5*kelvin/second"
    reached = 100 * log(40 / 35)
    yield Everyday(
        "thermostat_without_hysteresis",
        flows({"T": ("290 K", heat), "h": ("1", "0/second")}, {"tau": "100 s"},
              events={"cold": reset("T - 295*kelvin", "falling", h="1"),
                      "warm": reset("T - 295*kelvin", "rising", h="0")}),
        "600 s", {"T": 295.0, "accumulation_time": reached}, "330 K - 40 K exp(-t/tau) = 295 K, and held there",
        outcome="event_accumulation", step="0.7 s",
    )
    yield Everyday(
        "thermostat_by_where",
        flows({"T": ("290 K", f"{room} + where(T < 295*kelvin, 0.5, 0)*kelvin/second")}, {"tau": "100 s"}),
        "600 s", {"T": 295.0}, "330 K - 40 K exp(-t/tau) = 295 K, and held there", step="0.7 s",
    )
    off, on = 280.0, 330.0
    times = [100 * log(40 / 34), 100 * log(16 / 14), 100 * log(36 / 34), 100 * log(16 / 14), 100 * log(36 / 34)]
    yield Everyday(
        "thermostat_with_hysteresis",
        flows({"T": ("290 K", heat), "h": ("1", "0/second")}, {"tau": "100 s"},
              events={"cold": reset("T - 294*kelvin", "falling", h="1"),
                      "warm": reset("T - 296*kelvin", "rising", h="0")}),
        "60 s",
        {"T": relaxed(290, 100, zip([*times, 60 - sum(times)], [on, off, on, off, on, off], strict=True)), "h": 0.0,
         "event_time_warm": times[0]},
        "exponentials between 294 K and 296 K", step="0.7 s",
    )
    yield Everyday(
        "control_by_two_regimes",
        line("x", {"pull": "-1*newton", "push": "1*newton", "drag": "-2*newton*second/metre*v_x"}, "0.3 m",
             regimes={"right": {"forces": ["pull", "drag"]}, "left": {"forces": ["push", "drag"]}},
             events={"down": switch("x + 0.5*second*v_x", "falling", "left"),
                     "up": switch("x + 0.5*second*v_x", "rising", "right")}),
        "3 s", {"x": 0.25 * (1 - exp(-1.2)) * exp(-4.8), "event_time_down": 0.6},
        "from x + v/2 = 0 on the motion is held there, and x' = -2 x",
    )
    bounce = {"floor": reset("y", "falling", v_y="-0.5*v_y")}
    yield Everyday(
        "ball_by_reset_through_its_zeno_time", line("y", {"gravity": GRAVITY}, "1 m", events=bounce),
        "3 s", {"y": 0.0, "v_y": 0.0, "accumulation_time": 3 * sqrt(2 / G)}, "sqrt(2 h/g) (1 + e)/(1 - e)",
        outcome="event_accumulation",
    )
    t, v = sqrt(2 / G), G * sqrt(2 / G) / 2
    y, v = pushed([(1 - 2 * t, -G)], 0, v / 2)
    yield Everyday(
        "ball_by_reset", line("y", {"gravity": GRAVITY}, "1 m", events={"floor": reset("y", v_y="-0.5*v_y")}),
        "1 s", {"y": y, "v_y": v, "event_time_floor": t}, "bounces at 1 and 2 times sqrt(2 h/g)",
    )
    feed = {"dry_1": reset("h1", "falling", feed="1"), "dry_2": reset("h2", "falling", feed="0")}
    yield Everyday(
        "two_tanks_and_one_hose",
        flows({"h1": ("1 m", "w*feed - v"), "h2": ("1 m", "w*(1 - feed) - v"), "feed": ("1", "0/second")},
              {"w": "0.75 m s-1", "v": "0.5 m s-1"}, events=feed),
        "10 s", {"h1": 0.0, "h2": 0.0, "accumulation_time": 8.0},
        "both together lose 0.25 m s-1 of 2 m: Zeno's automaton",
        outcome="event_accumulation", step="70 ms",
    )
    kick = {"kick": reset("t - tr", "rising", v_x="v_x + 1*metre/second")}
    yield Everyday(
        "kick_at_the_start", line("x", {}, parameters={"tr": "0 s"}, events=kick),
        "3 s", {"x": 3.0, "event_time_kick": 0.0}, "1 m s-1 from tr = 0 on", axis=("tr", "0 s", "1 s"),
    )
    ground = {"ground": stop("y", "falling")}
    yield Everyday(
        "ball_let_go_on_the_ground", line("y", {"gravity": GRAVITY}, events=ground),
        "2 s", {"y": 0.0, "event_time_ground": 0.0}, "it falls at once", outcome="stopped_by_event",
    )
    ground = {"ground": stop("y")}
    yield Everyday(
        "ball_thrown_from_the_ground", line("y", {"gravity": GRAVITY}, "0 m", "5 m s-1", events=ground),
        "2 s", {"v_y": -5.0, "event_time_ground": 10 / G}, "2 v/g: its start is no passage", outcome="stopped_by_event",
    )
    t, v = sqrt(30 / G), sqrt(30 * G)
    s = 2 - t
    yield Everyday(
        "parachute",
        line("y", {"gravity": GRAVITY, "drag": "-2*kilogram/second*v_y"}, "20 m",
             regimes={"fall": {"forces": ["gravity"]}, "open": {"forces": ["gravity", "drag"]}},
             events={"cord": switch("y - 5*metre", "falling", "open")}),
        "2 s", {"y": 5 - G / 2 * s + (G / 2 - v) * (1 - exp(-2 * s)) / 2, "v_y": -G / 2 + (G / 2 - v) * exp(-2 * s),
                "event_time_cord": t},
        "free for 15 m, then by linear drag",
    )
    yield Everyday(
        "pendulum_released",
        rotor("1 kg m2", {"gravity": "-9.81*newton*metre*sin(q)"},
              events={"turn": {"function": "v_q"}})
        | {"initial": {"q": "1 rad"}},
        "2 s", {"event_time_turn": 2 * ellipk(sin(0.5) ** 2) / sqrt(G)},
        "half a period: 2 sqrt(l/g) K(sin^2(q0/2)); at rest at the start",
    )
    bell = {"bell": {"every": "1 s", "phase": "0 s", "action": "reset", "set": {"v_x": "v_x + 1*metre/second"}}}
    yield Everyday(
        "push_every_second_from_now_on", line("x", {}, events=bell),
        "2.5 s", {"x": 4.5, "v_x": 3.0, "event_time_bell": 0.0}, "1, 2, 3 m s-1 from 0, 1, 2 s on",
    )
    dose = {"dose": {"every": "6 hour", "action": "reset", "set": {"c": "c + 1e-4*kilogram"}}}
    c = ((100 * exp(-0.75) + 100) * exp(-0.75) + 100) * exp(-0.75) + 100
    yield Everyday(
        "doses_by_the_clock", flows({"c": ("100 mg", "-c/tau")}, {"tau": "8 hour"}, events=dose),
        "20 hour", {"c": c * exp(-0.25)}, "a dose at 0, 6, 12, 18 hours, each decaying", step="170 s",
    )
    y, v = pushed([(2, 30 - G), (5, -G)])
    yield Everyday(
        "rocket_of_two_regimes",
        line("y", {"gravity": GRAVITY, "thrust": "30*newton"},
             regimes={"boost": {"forces": ["gravity", "thrust"]}, "coast": {"forces": ["gravity"]}},
             events={"burnout": switch("t - 2*second", "rising", "coast"),
                     "apogee": {"function": "v_y", "direction": "falling"}}),
        "7 s", {"y": y, "v_y": v, "event_time_apogee": 2 + 2 * (30 - G) / G},
        "two parabolas", axis=("m", "1 kg", "1.1 kg"),
    )


# ---------------------------------------------------------------- tanks, Hertz, roots and broken powers behind a switch
HERTZ = {"x": 0.66267798319334, "v_x": -2.57259751414145}  # scipy, DOP853 at 1e-14 between contacts, parabolas outside


def rooted() -> Iterator[Everyday]:
    """What has a root, a logarithm or a power of 1.5 of something that ends."""
    on_hertz = {
        "hertz": "k*(max(-x, 0*metre)/L)**1.5",
        "hertz_by_where": "where(x < 0*metre, k*(-x/L)**1.5, 0*newton)",
        "hertz_by_abs": "k*((abs(x) - x)/2/L)**1.5",
        "hertz_potential": {"potential": "0.4*k*L*(max(-x, 0*metre)/L)**2.5"},
    }
    for name, law in on_hertz.items():
        yield Everyday(
            f"ball_on_{name}",
            line("x", {"gravity": GRAVITY, "floor": law}, "1 m", parameters={"k": "1 MN", "L": "1 m"}),
            "3 s", HERTZ, "scipy by pieces; x = 0.66267798 m", step="0.1 ms", within=1e-5,
        )
    yield Everyday(
        "ball_on_hunt_and_crossley",
        line("x", {"gravity": GRAVITY, "floor": "k*(max(-x, 0*metre)/L)**1.5*(1 - c*v_x)"}, "1 m",
             parameters={"k": "10 kN", "L": "1 m", "c": "0.2 s m-1"}),
        "2 s", {"x": 0.05049930853870206, "v_x": 0.15999226110072762}, "scipy by pieces", step="1 ms", within=1e-5,
    )
    drain = flows({"h": ("1 m", "-a*sqrt(2*g*max(h, 0*metre))")}, {"a": "0.1", "g": "9.81 m s-2"})
    yield Everyday(
        "tank_half_drained", drain, "2 s", {"h": (1 - 0.2 * sqrt(G / 2)) ** 2}, "Torricelli: (1 - a t sqrt(g/2))^2",
    )
    yield Everyday("tank_drained", drain, "6 s", {"h": 0.0}, "Torricelli: empty at sqrt(2/g)/a = 4.515 s")
    yield Everyday(
        "tank_that_fills",
        flows({"h": ("0 m", "q - c*sqrt(max(h, 0*metre)*1*metre)")}, {"q": "1 m s-1", "c": "1 s-1"},
              events={"quarter": {"function": "h - 0.25*metre"}}),
        "1 s", {"event_time_quarter": 2 * log(2) - 1}, "-2 sqrt h - 2 ln(1 - sqrt h), from an empty tank",
    )
    funnel = {"h": ("1 m", "-c*where(h > 0*metre, sqrt(max(h, 0*metre)/(1*metre))/(h/(1*metre))**2, 0)")}
    yield Everyday(
        "funnel", flows(funnel, {"c": "1 m s-1"}), "0.2 s", {"h": 0.5**0.4}, "h^2.5 = 1 - 2.5 c t", step="1 ms",
    )
    yield Everyday(
        "two_vessels_level_out",
        flows({"h1": ("1 m", "-c*sign(h1 - h2)*sqrt(abs(h1 - h2)*1*metre)"),
               "h2": ("0 m", "c*sign(h1 - h2)*sqrt(abs(h1 - h2)*1*metre)")},
              {"c": "0.5 s-1"}),
        "3 s", {"h1": 0.5, "h2": 0.5}, "h1 - h2 = (1 - c t)^2, level at 2 s",
    )
    yield Everyday(
        "brake_by_a_root", line("x", {"brake": "-c*sign(v_x)*sqrt(abs(v_x)*1*metre/second)"}, "0 m", "1 m s-1",
                                parameters={"c": "1 kg s-1"}),
        "3 s", {"x": 2 / 3, "v_x": 0.0}, "(1 - t/2)^2: at rest at 2 s",
    )
    yield Everyday(
        "drag_of_power_three_halves",
        line("x", {"drag": "-c*v_x*sqrt(abs(v_x)/(1*metre/second))"}, "0 m", "1 m s-1", parameters={"c": "1 kg s-1"}),
        "2 s", {"x": 1.0, "v_x": 0.25}, "v = (1 + t/2)^-2",
    )
    yield Everyday(
        "spring_of_power_three_halves",
        line("x", {"spring": "-k*sign(x)*abs(x/(1*metre))**1.5"}, "1 m", parameters={"k": "1 N"},
             events={"middle": {"function": "x"}}),
        "2 s", {"event_time_middle": 0.4 * beta(0.4, 0.5) / sqrt(0.8)},
        "a quarter of a period, by Euler's beta function", within=1e-6,
    )
    yield Everyday(
        "bungee_of_logarithmic_cord",
        line("x", {"gravity": "m*g", "cord": "-where(x > L, k*L*log(x/L), 0*newton)"}, m="70 kg",
             parameters={"k": "200 N m-1", "L": "10 m"}),
        "4 s", {"x": 17.772734039186, "v_x": -14.450410516224}, "scipy by pieces", within=1e-6,
    )


# ------------------------------------------------------------- square waves, kinks in the mass, first steps from zero


def waves() -> Iterator[Everyday]:
    """What is on and off by the clock, or by an angle; masses that jump."""
    yield Everyday(
        "rc_on_a_square_wave",
        flows({"u": ("0 V", "(where(mod(t, T) < T/2, U, 0*volt) - u)/tau")}, {"tau": "10 ms", "T": "2 ms", "U": "5 V"}),
        "20 ms", {"u": relaxed(0, 10, [(1, 5), (1, 0)] * 10)}, "an exponential for each half period", step="0.07 ms",
    )
    yield Everyday(
        "day_and_night",
        flows({"T": ("280 K", "(280*kelvin - T)/tau + where(mod(t, 24*hour) < 12*hour, 2, 0)*kelvin/hour")},
              {"tau": "10 hour"}),
        "60 hour", {"T": relaxed(280, 10, [(12, 300), (12, 280), (12, 300), (12, 280), (12, 300)])},
        "an exponential for each half day", step="700 s",
    )
    yield Everyday(
        "rl_by_duty_cycle",
        flows({"i": ("0 A", "(where(t/T - floor(t/T) < D, U, 0*volt) - R*i)/L")},
              {"R": "2 ohm", "L": "10 mH", "T": "1 ms", "D": "0.3", "U": "12 V"}),
        "10 ms", {"i": relaxed(0, 5, [(0.3, 6), (0.7, 0)] * 10)}, "an exponential for each piece", step="0.03 ms",
    )
    w = sqrt(2 * pi)
    yield Everyday(
        "rotor_pushed_half_of_each_turn",
        rotor("1 kg m2", {"push": "where(mod(q, 2*pi) < pi, 1*newton*metre, 0*newton*metre)"},
              events={"turn": {"function": "q - 2*pi"}}),
        "5 s", {"q": 3 * pi + sqrt(2) * w * (5 - 1.5 * w - (sqrt(2) - 1) * w), "event_time_turn": 1.5 * w},
        "J w^2/2 gains pi N m in each first half",
    )
    duty = {"unit": "V", "start": "0 V", "value": "where(mod(t, 20e-6*second) < 10e-6*second, 12*volt, 0*volt)"}
    pwm = {"every": "4 us", "outputs": {"u": duty}}
    yield Everyday(
        "pwm_by_ticks", flows({"c": ("0 V", "(u - c)/tau")}, {"tau": "100 us"}, controllers={"pwm": pwm}),
        "400 us", {"c": relaxed(0, 100, [(12, 12), (8, 0)] * 20)}, "ticks at 0, 4, 8 us of each 20 us are on",
        step="1.7 us",
    )
    mass = "where(t < 10*second, 50*kilogram, 10*kilogram)"
    x, v = pushed([(10, 2), (5, 10)])
    shed = line("x", {"push": "100*newton"}) | {"mass": {"x": mass}}
    yield Everyday("mass_that_drops", shed, "15 s", {"x": x, "v_x": v}, "2 m s-2, then 10 m s-2: 70 m/s", step="70 ms")
    yield Everyday(
        "mass_matrix_that_drops", shed | {"mass": {"matrix": [[mass]]}}, "15 s", {"x": x, "v_x": v},
        "2 m s-2, then 10 m s-2", step="70 ms",
    )
    energy = {key: value for key, value in shed.items() if key != "mass"}
    energy |= {"lagrangian": {"kinetic": f"{mass}*v_x**2/2"}}
    yield Everyday(
        "lagrangian_whose_mass_drops", energy, "15 s", {"x": x, "v_x": v},
        "2 m s-2, then 10 m s-2: the velocity stays", step="70 ms",
    )
    power = {"F": "2 N", "P": "4 W"}
    yield Everyday(
        "car_of_limited_power", line("x", {"engine": "min(F, P/v_x)"}, parameters=power),
        "2 s", {"x": 1 + (12**1.5 - 8) / 12, "v_x": sqrt(12)}, "2 m s-2 to 2 m/s, then m v^2/2 = P t",
        axis=("F", "2 N", "3 N"),
    )
    yield Everyday(
        "car_of_given_power", line("x", {"engine": "P/v_x"}, "0 m", "1 um s-1", parameters={"P": "4 W"}),
        "2 s", {"x": 16 / 3, "v_x": 4.0}, "v^2 = v0^2 + 2 P t/m", axis=("P", "4 W", "5 W"),
    )
    yield Everyday(
        "push_of_a_saw", line("x", {"push": "1*newton*mod(t, 1*second)/(1*second)"}),
        "2.5 s", {"x": 65 / 48, "v_x": 1.125}, "t^2/2 for each tooth",
    )
    x, v = swung(2, [(1, 0.25), (1, -0.25), (1, 0.25), (1, -0.25), (0.5, 0.25)])
    yield Everyday(
        "spring_on_a_square_wave",
        line("x", {"spring": "-4*newton/metre*x", "drive": "1*newton*sign(sin(pi*t/(1*second)))"}),
        "4.5 s", {"x": x, "v_x": v}, "turns about 25 cm and -25 cm", step="3 ms",
    )
    yield Everyday(
        "push_of_a_triangle", line("x", {"push": "1*newton*abs(mod(t/(1*second), 2) - 1)"}),
        "3 s", {"x": 7 / 3, "v_x": 1.5}, "cubics between kinks and jumps of the argument",
    )
    yield Everyday(
        "push_by_round", line("x", {"push": "1*newton*round(t/(1*second))"}),
        "3 s", {"x": 4.375, "v_x": 4.5}, "1 N more at 0.5, 1.5, 2.5 s",
    )
    yield Everyday(
        "infusions", flows({"c": ("0 mg", "where(mod(t, 8*hour) < 1*hour, D, 0*kilogram/hour) - c/tau")},
                           {"D": "5 mg hour-1", "tau": "4 hour"}),
        "24 hour", {"c": relaxed(0, 4, [(1, 20), (7, 0)] * 3)}, "an exponential for each piece", step="170 s",
    )
    x, v = pushed([(1, 10)], 5 / 3, 5)
    yield Everyday(
        "force_that_ramps_up", line("x", {"push": "10*newton*min(t/(1*second), 1)"}), "2 s", {"x": x, "v_x": v},
        "a cubic, then a parabola",
    )


# ----------------------------------------------------------------------------------- what forces cancel, and what holds


def balanced() -> Iterator[Everyday]:
    """What stays where it is."""
    yield Everyday(
        "three_forces_that_cancel", line("x", {"a": "0.1*k*t", "b": "0.2*k*t", "c": "-0.3*k*t"},
                                         parameters={"k": "1 N s-1"}),
        "3 s", {"x": 0.0, "v_x": 0.0}, "nothing is left of them", axis=("k", "1 N s-1", "2 N s-1"),
    )
    yield Everyday(
        "weight_at_rest_on_a_spring", line("x", {"gravity": GRAVITY, "spring": "-k*x"}, "-m*g/k",
                                           parameters={"k": "100 N m-1"}),
        "5 s", {"x": -G / 100, "v_x": 0.0}, "m g = k x",
    )
    yield Everyday(
        "mass_on_a_rod_pulled_along_it",
        {
            "coordinates": {"x": "m", "y": "m"},
            "parameters": {"m": "1 kg", "g": "9.81 m s-2", "L": "1 m", "k": "100 N s-1"},
            "mass": {"x": "m", "y": "m"},
            "forces": {"gravity": {"y": "-m*g"}, "load": {"y": "-k*t"}},
            "constraints": {"rod": "hypot(x, y) - L"},
            "initial": {"x": "0 m", "y": "-1 m"},
        },
        "2 s", {"x": 0.0, "y": -1.0, "constraint_force_rod": -G - 200}, "the rod holds m g + k t",
        axis=("k", "100 N s-1", "110 N s-1"),
    )


# ---------------------------------------------------------------------------------------- smooth, or with a kink or two


def plain() -> Iterator[Everyday]:
    """The first chapters: falls, springs, strings, rockets, circuits, populations."""
    x, v = pushed([(1, -G)], 2, 5)
    yield Everyday("ball_thrown_up", line("y", {"gravity": {"potential": "m*g*y"}}, "2 m", "5 m s-1"), "1 s",
                   {"y": x, "v_y": v}, "a parabola")
    yield Everyday(
        "ball_thrown_with_drag",
        {
            "coordinates": {"x": "m", "y": "m"},
            "parameters": {"m": "1 kg", "g": "9.81 m s-2", "c": "0.05 kg m-1"},
            "mass": {"x": "m", "y": "m"},
            "definitions": {"speed": "hypot(v_x, v_y)"},
            "forces": {"gravity": {"y": "-m*g"}, "drag": {"x": "-c*v_x*speed", "y": "-c*v_y*speed"}},
            "initial": {"x": "0 m", "y": "0 m", "v_x": "10 m s-1", "v_y": "10 m s-1"},
        },
        "1.5 s", {"x": 10.738764855580, "y": 1.576368401857}, "scipy, DOP853 at 3e-14",
    )
    yield Everyday(
        "fall_with_drag", line("y", {"gravity": GRAVITY, "drag": "-c*v_y*abs(v_y)"}, parameters={"c": "0.0981 kg m-1"}),
        "2 s", {"y": -100 / G * log(cosh(0.2 * G)), "v_y": -10 * tanh(0.2 * G)}, "-vt tanh(g t/vt), vt = 10 m/s",
    )
    w = sqrt(4 - 0.25)
    yield Everyday(
        "spring_with_damper", line("x", {"spring": "-k*x", "damper": "-c*v_x"}, "1 m",
                                   parameters={"k": "4 N m-1", "c": "1 N s m-1"}),
        "3 s", {"x": exp(-1.5) * (cos(3 * w) + sin(3 * w) / (2 * w))}, "exp(-t/2) (cos w t + sin w t/(2 w))",
    )
    rocket_mass = {"mass": {"y": "dry + max(fuel, 0*kilogram)"}}
    burning = "where(fuel > 0*kilogram, flow, 0*kilogram/second)"
    burnt, speed = 2000 * (1 - log(2)), 1000 * log(2)
    yield Everyday(
        "rocket_that_burns_out",
        line("y", {"gravity": "-(dry + max(fuel, 0*kilogram))*g", "thrust": f"{burning}*1000*metre/second"},
             parameters={"dry": "1 kg", "flow": "0.5 kg s-1"}, states={"fuel": {"unit": "kg", "rate": f"-{burning}"}},
             initial={"fuel": "1 kg"}) | rocket_mass,
        "3 s", {"y": burnt + speed - 4.5 * G, "v_y": speed - 3 * G, "fuel": 0.0}, "Tsiolkovsky: u ln 2 - g t",
        axis=("g", "9.81 m s-2", "9.8 m s-2"),
    )
    yield Everyday(
        "predator_and_prey",
        flows({"prey": ("10", "(1 - 0.1*hunters)*prey/second"), "hunters": ("5", "(0.075*prey - 1.5)*r*hunters")},
              {"r": "1 s-1"}),
        "10 s", {"prey": 8.006579917321, "hunters": 11.416191414572}, "scipy, DOP853 at 3e-14", within=1e-6,
    )
    q, i = linear([[0, 1], [-4, -1]], [-0.25, 0], 3)
    yield Everyday(
        "rlc_at_a_battery",
        flows({"q": ("0 C", "i"), "i": ("0 A", "(U - R*i - q/C)/L")},
              {"U": "1 V", "R": "1 ohm", "L": "1 H", "C": "0.25 F"}),
        "3 s", {"q": q + 0.25, "i": i}, "the exponential of its matrix",
    )
    speed, current = linear([[-0.1, 1], [-1, -2]], [-10 / 1.2, -1 / 1.2], 2)
    yield Everyday(
        "motor_on_a_battery",
        rotor("1 kg m2", {"torque": "K*i*newton*metre/ampere", "bearing": "-b*v_q"},
              parameters={"K": "1", "b": "0.1 N m s", "R": "2 ohm", "L": "1 H", "U": "10 V"},
              states={"i": {"unit": "A", "rate": "(U - R*i - K*v_q*volt*second)/L"}})
        | {"initial": {"q": "0 rad", "i": "0 A"}},
        "2 s", {"v_q": speed + 10 / 1.2, "i": current + 1 / 1.2}, "the exponential of its matrix",
    )
    w, fall = sqrt(100 / 70), sqrt(20 * G)
    yield Everyday(
        "bungee", line("x", {"gravity": "m*g", "cord": "-k*max(x - L, 0*metre)"}, m="70 kg",
                       parameters={"k": "100 N m-1", "L": "10 m"},
                       events={"lowest": stop("v_x", "falling")}),
        "5 s", {"x": 10 + G / w**2 + hypot(G / w**2, fall / w),
                "event_time_lowest": sqrt(20 / G) + (pi - atan(fall * w / G)) / w},
        "a fall of 10 m, then an arc of a circle in x, v/w", outcome="stopped_by_event",
    )
    yield Everyday(
        "planet_on_a_circle",
        {
            "coordinates": {"x": "m", "y": "m"},
            "parameters": {"m": "1 kg", "GM": "1 m3 s-2"},
            "mass": {"x": "m", "y": "m"},
            "forces": {"gravity": {"potential": "-GM*m/hypot(x, y)"}},
            "initial": {"x": "1 m", "y": "0 m", "v_x": "0 m s-1", "v_y": "1 m s-1"},
        },
        "5 s", {"x": cos(5), "y": sin(5)}, "once round in 2 pi", axis=("GM", "1 m3 s-2", "1.1 m3 s-2"),
    )
    lowest = sqrt(10 * (2 - sqrt(2)))
    yield Everyday(
        "three_beads_on_a_string",
        {
            "coordinates": {"a": "m", "b": "m", "c": "m"},
            "parameters": {"m": "0.1 kg", "F": "1 N", "d": "1 m"},
            "mass": {"a": "m", "b": "m", "c": "m"},
            "forces": {"string": {"a": "F*(b - 2*a)/d", "b": "F*(a - 2*b + c)/d", "c": "F*(b - 2*c)/d"}},
            "initial": {"a": "1 cm", "b": {"value": sqrt(2), "unit": "cm"}, "c": "1 cm"},
        },
        "2 s", {"a": 0.01 * cos(2 * lowest), "b": 0.01 * sqrt(2) * cos(2 * lowest)},
        "its lowest mode: w^2 = F/(m d) (2 - sqrt 2)",
    )
    w = 10.0
    period = 0.4 + 2 * pi / w
    yield Everyday(
        "mass_with_play_between_springs",
        line("x", {"springs": "-k*(max(x - d, 0*metre) - max(-x - d, 0*metre))"}, "0 m", "1 m s-1",
             parameters={"d": "0.1 m", "k": "100 N m-1"}),
        "1.5 s", {"x": 0.1 - (1.5 - period - 0.1 - pi / w), "v_x": -1.0}, "free for 0.1 s, half a swing in pi/10 s",
        step="3 ms",
    )
    speed = sqrt(10 * G)
    yield Everyday(
        "skier_below_the_slope", line("x", {"slope": "where(x < L, 0.5*m*g, 0*newton)"}, parameters={"L": "10 m"}),
        "4 s", {"x": 10 + speed * (4 - 2 * speed / G), "v_x": speed}, "v = sqrt(g L) at the bottom, then evenly",
    )
    yield Everyday(
        "tank_that_overflows", flows({"h": ("0 m", "q - c*max(h - H, 0*metre)")},
                                     {"q": "0.5 m s-1", "c": "2 s-1", "H": "1 m"}),
        "4 s", {"h": 1 + 0.25 * (1 - exp(-4))}, "fills in 2 s, then nears H + q/c",
    )
    yield Everyday(
        "pulled_back_by_a_sign", line("x", {"pull": "-1*newton*sign(x)"}, "1 m"),
        "4 s", {"x": -1 + (4 - 2 * sqrt(2)) ** 2 / 2, "v_x": 4 - 2 * sqrt(2)}, "parabolas of sqrt 2 s",
    )
    yield Everyday(
        "control_that_saturates",
        line("x", {"motor": "max(-1*newton, min(1*newton, -k*x - c*v_x))"}, "1 m",
             parameters={"k": "4 N m-1", "c": "2 N s m-1"}),
        "4 s", {"x": 0.022412789396, "v_x": 0.006508592064}, "scipy by pieces", within=1e-6,
    )
    governor = {"unit": "N", "start": "0 N", "value": "5*newton*second/metre*(1*metre/second - v_x)"}
    yield Everyday(
        "speed_under_sampled_control",
        line("x", {"motor": "u"}, controllers={"governor": {"every": "0.1 s", "outputs": {"u": governor}}}),
        "1 s", {"v_x": 1 - 0.5**10, "x": 1 - 0.15 * (1 - 0.5**10)}, "half of what is missing, each tick",
    )
# fmt: on


def models() -> Iterator[Everyday]:
    """Yield all hundred of them."""
    for subject in (boxes, rubbing, switched, rooted, waves, balanced, plain):
        yield from subject()


EVERYDAY = {case.name: case for case in models()}

# ------------------------------------------------------------------------------------------------------- marches, judged

STEPPED_OVER = frozenset({"moreau_jean"})  # of first order over what others locate
# how a run may end short of its end, which its record and a warning say
UNFINISHED = {
    "element": {"sliding_mode"},  # along a switch of several elements at once
}
DIVERGED = {"nonfinite_state", "nonfinite_observable"}  # a series over a given step that is longer than its radius
FIRST_ORDER = {"step_below_spacing", "step_limit"}  # from rest in the middle of a run; steps as many as are allowed
# what methods of first order come to as they do, not as the motion does
AS_THEY_ARE = {
    ("ball_that_bounces_to_rest", "forward_euler"): "each flight gains the speed of a step's fall: it never rests",
    ("ball_by_reset_through_its_zeno_time", "forward_euler"): "each flight gains, too: it never accumulates",
    ("ball_on_hunt_and_crossley", "forward_euler"): "12 % at steps for 4e-3",
    ("control_by_two_regimes", "euler_cromer"): "5 % at steps for 4e-3, by two hundred switches",
}
AGREEMENT = 3.0  # error of the finer of two steps, in their difference: 1 of first order, less of higher, more at roots
HALVINGS = 7
SPARSE = {"keep_every": 1_000_000, "force_samples": "none"}
PATIENCE = 10  # s
MOST_STEPS = 100_000


@dataclass(frozen=True)
class Finding:
    """What a method made of a case.

    Attributes
    ----------
    case : Everyday
    method, mode : str
    values : dict of str to float
        Of the quantities that the case expects, as many as the mode has.
    bounds : dict of str to float
        What each may differ by.
    outcome : str
        `run_outcome`; empty where the method refused.
    words : str
        Why it refused, or how the run ended.
    warning : str
        What a run of given steps was warned of: stability, accuracy. Steps too long for an implicit method to solve are
        such a warning, too.
    """

    case: Everyday
    method: str
    mode: str
    values: dict[str, float] = field(default_factory=dict)
    bounds: dict[str, float] = field(default_factory=dict)
    outcome: str = ""
    words: str = ""
    warning: str = ""

    @property
    def errors(self) -> dict[str, float]:
        """By quantity, relative to what is expected; absolute where that is 0."""
        return {key: differs(value, self.case.expects[key]) for key, value in self.values.items()}

    @property
    def worst(self) -> str:
        """The quantity that is furthest beyond its bound, or nearest to it."""
        return max(
            self.errors, key=lambda key: np.nan_to_num(self.errors[key] / self.bounds[key], nan=np.inf), default=""
        )

    @property
    def verdict(self) -> str:
        """`right`, `refused`, `warned` of given steps, `WRONG`, or the outcome that was not expected."""
        order = xd.METHODS[self.method].order
        short = UNFINISHED.get(self.mode, set()) | (FIRST_ORDER if order < 2 else set())
        short = short | (DIVERGED if (self.method, self.mode) == ("taylor", "fixed") else set())
        if not self.outcome or self.outcome in short:
            return "refused"
        if self.mode == "fixed" and self.outcome == "equations_unsolved":
            return "warned"
        if self.outcome == "completed" != self.case.outcome and self.warning:
            return "warned"
        if self.outcome != self.case.outcome:
            return self.outcome
        if all(self.errors[key] <= self.bounds[key] for key in self.values):
            return "right"
        return "warned" if self.mode == "fixed" and self.warning else "WRONG"

    @property
    def is_sound(self) -> bool:
        """Whether it is right, or refused in words."""
        return (
            self.verdict in ("right", "warned")
            or (self.verdict == "refused" and len(self.words.split()) > 3)
            or (self.outcome == "completed" and (self.case.name, self.method) in AS_THEY_ARE)
        )

    def __str__(self) -> str:
        key = self.worst
        row = f"{self.case.name:36} {self.method:24} {self.mode:9} "
        if key:
            row += f"{key} = {self.values[key]:.12g} for {self.case.expects[key]:.12g}, {self.errors[key]:.1e}: "
        return f"{row}{self.verdict}" + (
            "" if self.verdict in ("right", "WRONG") else f": {self.warning or self.words}"
        )


def differs(value: float, expected: float) -> float:
    """Return the difference of two values relative to the second, absolute where that is 0."""
    return abs(value - expected) / (abs(expected) or 1.0)


def shares(case: Everyday, method: str) -> tuple[float, float]:
    """Return the tolerance by which a method of low order takes about as many steps as one of fourth, and its bound.

    Steps are as rtol**(1/(p + 1)), errors at the end as their p-th power.
    """
    order = min(xd.METHODS[method].order, 5)
    return case.rtol ** min((order + 1) / 5, 1.0), case.within ** (order / 5)


def value_of(run: xr.Dataset, key: str, dim: str | None = None) -> float:
    """Return a quantity that a case expects from a record, of its first element; nan where it has none."""
    if key in run.variables:
        last = run[key].isel(step=-1)
        return float(last.isel({dim: 0}) if dim in last.dims else last)
    if key in run.attrs:
        return float(run.attrs[key])
    kind, _, detector = key.partition("_time_")
    if not detector:
        return float("nan")
    events = run.dynamics.events(detector)
    rows = np.ones(events.sizes["event"], bool)
    if dim is not None and f"event_{dim}" in events:
        rows &= events[f"event_{dim}"].values == 0
    if kind != "event":
        meanings = run.event_kind.attrs["flag_meanings"].split()
        rows &= events.event_kind.values == run.event_kind.attrs["flag_values"][meanings.index(kind)]
    times = events.event_time.values[rows]
    return float(times[0]) if len(times) else float("nan")


class Unended(KeyboardInterrupt):
    """A march has taken far longer than any should."""


def _interrupt() -> None:
    raise Unended


@contextmanager
def bounded() -> Iterator[None]:
    """Interrupt a march that takes far longer than any should, as a person would: its record says so."""
    before = signal.signal(signal.SIGALRM, lambda *_: _interrupt())
    signal.alarm(PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def is_located(case: Everyday, method: str, key: str) -> bool:
    """Whether what is expected is no time of a contact or friction, of a method that steps over these."""
    detector = key.partition("_time_")[2]
    return method not in STEPPED_OVER or not detector or detector in case.model.get("events", {})


def march(case: Everyday, method: str, mode: str, dim: str | None = None, **how: Any) -> Finding:
    """March a case's model once, and read what it expects."""
    try:
        with bounded(), warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            run = xd.simulate(statement_of(case, dim), method=method, until=case.until, **how)
    except xd.InputError as refusal:
        return Finding(case, method, mode, words=str(refusal))
    except Unended:
        return Finding(case, method, mode, outcome="unended", words=f"took longer than {PATIENCE} s")
    values = {key: value_of(run, key, dim) for key in case.expects if is_located(case, method, key)}
    bounds = dict.fromkeys(values, shares(case, method)[1])
    words = [str(warning.message) for warning in said if warning.category in (xd.StabilityWarning, xd.AccuracyWarning)]
    return Finding(
        case, method, mode, values, bounds, run.attrs["run_outcome"], run.attrs["run_outcome_text"], "; ".join(words)
    )


def alone(case: Everyday, method: str, mode: str = "adaptive") -> Finding:
    """March by chosen steps, or by given ones: these are halved until two runs differ by little.

    The finer one's error is judged by that difference, so that no tolerance is stated for a method. Little is 3e-2 of
    first order, 1e-3 of second, 1e-6 of fourth and above: halving leads there, unless a jump was stepped over.
    """
    if mode == "adaptive":
        return march(case, method, mode, rtol=shares(case, method)[0], max_steps=MOST_STEPS)
    order = 1 if method in STEPPED_OVER else xd.METHODS[method].order
    little = 10.0 ** -min(1.5 * order, 6.0)
    length, _, unit = case.step.partition(" ")
    fine = march(case, method, mode, step=case.step, **SPARSE)
    for halving in range(1, HALVINGS + 1):
        coarse, fine = fine, march(case, method, mode, step=f"{float(length) / 2**halving!r} {unit}", **SPARSE)
        if fine.outcome != case.outcome or coarse.outcome != case.outcome:
            return fine
        gaps = {key: differs(value, coarse.values[key]) for key, value in fine.values.items()}
        if method not in STEPPED_OVER and all(gap <= little for gap in gaps.values()):
            break
    each = {
        key: little if method in STEPPED_OVER else AGREEMENT * min(gap, little) + case.within
        for key, gap in gaps.items()
    }
    return replace(fine, bounds=each)


def in_a_sweep(case: Everyday, method: str) -> Finding:
    """March beside another value of a parameter; what a sweep does not keep is not judged."""
    name, own, other = case.axis or beside(case)
    ends = {key: key if key.startswith("event_time_") else f"end_{key}" for key in case.expects}
    events = [key for key in case.expects if key.startswith("event_time_")]
    try:
        with bounded(), warnings.catch_warnings(action="ignore"):
            members = xd.sweep(
                statement_of(case),
                {name: [own, other]},
                keep=["end", *events],
                method=method,
                until=case.until,
                rtol=shares(case, method)[0],
                max_steps=MOST_STEPS,
            ).compute()
    except xd.InputError as refusal:
        return Finding(case, method, "sweep", words=str(refusal))
    except Unended:
        return Finding(case, method, "sweep", outcome="unended", words=f"took longer than {PATIENCE} s")
    first = members.isel({name: 0})
    outcome = str(first.run_outcome.item())
    values = {
        key: float(first[end])
        for key, end in ends.items()
        if end in first and (outcome == "completed" or not end.startswith("end_"))  # no end of a run that fell short
    }
    return Finding(
        case,
        method,
        "sweep",
        values,
        dict.fromkeys(values, shares(case, method)[1]),
        outcome,
        f"{outcome} in the sweep",
        "events strayed" if int(first.get("run_events_strayed", 0)) else "",
    )


def as_an_element(case: Everyday, method: str) -> Finding:
    """March as the first of two bodies along a dimension."""
    return march(case, method, "element", "body", rtol=shares(case, method)[0], max_steps=MOST_STEPS)


def beside(case: Everyday) -> tuple[str, str, str]:
    """Return the first parameter of a case, its value, and 5/4 of it."""
    name, own = next(iter(case.model["parameters"].items()))
    value, _, unit = own.partition(" ")
    return name, own, f"{float(value) * 1.25!r} {unit}".strip()


def statement_of(case: Everyday, dim: str | None = None) -> xd.Model:
    """Return the model, or that of two such bodies: every coordinate and state gets the dimension.

    The second one differs by the parameter that a sweep varies, unless what happens to one happens to both.
    """
    model = dict(case.model)
    if dim is not None:
        model["dimensions"] = {dim: 2}
        for section in {"coordinates", "states"} & model.keys():
            model[section] = {
                name: ({"unit": entry} if isinstance(entry, str) else entry) | {"dims": [dim]}
                for name, entry in model[section].items()
            }
        if case.outcome == "completed" and "regimes" not in model:
            name, *both = case.axis or beside(case)
            (own, unit), (other, _) = ((float(value), rest) for value, _, rest in (one.partition(" ") for one in both))
            each = {"value": [own, other], "unit": unit or "1", "dims": [dim]}
            model["parameters"] = model["parameters"] | {name: each}
    return xd.Model(name=case.name, **model)


# -------------------------------------------------------------------------------------------------------------- the table
THIN = ("dormand_prince", "rk4")
MODES = {
    "adaptive": alone,
    "fixed": lambda case, method: alone(case, method, "fixed"),
    "sweep": in_a_sweep,
    "element": as_an_element,
}


def main() -> None:
    """Print what methods make of each case, and how often each verdict was given."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--whole", action="store_true", help="every method, not dormand_prince and rk4 alone")
    parser.add_argument("--case", choices=EVERYDAY, help="one case")
    parser.add_argument("--method", choices=xd.METHODS, help="one method")
    parser.add_argument("--mode", choices=MODES, help="one way to march")
    asked = parser.parse_args()
    warnings.simplefilter("ignore")  # what a run warns of is said by its verdict here
    methods = [asked.method] if asked.method else xd.METHODS if asked.whole else THIN
    counts: Counter[str] = Counter()
    for case in [EVERYDAY[asked.case]] if asked.case else EVERYDAY.values():
        for method in methods:
            for mode in [asked.mode] if asked.mode else MODES:
                finding = MODES[mode](case, method)
                counts[finding.verdict] += 1
                print(finding, flush=True)
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()))


if __name__ == "__main__":
    main()
