"""Impacts and friction of mechanisms that constraints hold together: clearances, steps of a walker, moving guides."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.record.flag_words import words_of_flag

CLEARANCE = """
name = "slider crank with clearance"
[coordinates]
x1 = "m"
y1 = "m"
x2 = "m"
y2 = "m"
s = "m"
[parameters]
m = "0.5 kg"
M = "1 kg"
r = "0.1 m"
l = "0.3 m"
c = "1 mm"
w = "20 rad s-1"
e = "0.5"
g = "9.81 m s-2"
[mass]
x1 = "m"
y1 = "m"
x2 = "m"
y2 = "m"
s = "M"
[forces.weight]
potential = "m*g*(y1+y2)"
[constraints.crank]
holds = "(x1**2 + y1**2 - r**2)/(2*r)"
[constraints.turning]
holds = "x1*sin(w*t/(1*radian)) - y1*cos(w*t/(1*radian))"
[constraints.rod]
holds = "((x2-x1)**2 + (y2-y1)**2 - l**2)/(2*l)"
[contacts.bush]
gap = "c - sqrt((x2 - s)**2 + y2**2)"
restitution = "e"
[initial]
x1 = "r"
y1 = "0 m"
x2 = "r + l"
y2 = "0 m"
s = "r + l - c/2"
v_y1 = "r*w/(1*radian)"
v_y2 = "0 m s-1"
"""
WALKER = """
name = "walker"
[coordinates]
xh = "m"
yh = "m"
x1 = "m"
y1 = "m"
x2 = "m"
y2 = "m"
[parameters]
M = "10 kg"
m = "1 kg"
l = "1 m"
g = "9.81 m s-2"
mu = "1"
w = "1.2 rad s-1"
[mass]
xh = "M"
yh = "M"
x1 = "m"
y1 = "m"
x2 = "m"
y2 = "m"
[forces.weight]
potential = "g*(M*yh + m*y1 + m*y2)"
[constraints.leg1]
holds = "((xh-x1)**2 + (yh-y1)**2 - l**2)/(2*l)"
[constraints.leg2]
holds = "((xh-x2)**2 + (yh-y2)**2 - l**2)/(2*l)"
[contacts.foot1]
gap = "y1"
restitution = 0
tangential = "coulomb"
slip = "v_x1"
friction = "mu"
[contacts.foot2]
gap = "y2"
restitution = 0
tangential = "coulomb"
slip = "v_x2"
friction = "mu"
[initial]
xh = "l*sin(0.2)"
yh = "l*cos(0.2)"
x1 = "0 m"
y1 = "0 m"
x2 = "l*(sin(0.2) + sin(0.25))"
y2 = "l*(cos(0.2) - cos(0.25))"
v_xh = "w*l*cos(0.2)/(1*radian)"
v_yh = "-w*l*sin(0.2)/(1*radian)"
v_x2 = "w*l*cos(0.2)/(1*radian)"
v_y2 = "-w*l*sin(0.2)/(1*radian)"
"""


def groups(run: xr.Dataset, kind: str) -> list[tuple[int, int]]:
    """The rows before and behind events of a kind."""
    rows = zip(run.event_row_before.values.tolist(), run.event_row_after.values.tolist(), strict=True)
    return [pair for pair, word in zip(rows, words_of_flag(run.event_kind), strict=True) if word == kind]


def test_a_pin_strikes_its_bush_by_the_law_of_impacts() -> None:
    """Assert that a slider crank with clearance keeps its rods and its gap, and halves every approach of its pin."""
    run = xd.simulate(xd.Model.from_text(CLEARANCE), method="dop853", rtol=1e-9, until="0.4 s")
    across, along = run.x2 - run.s, run.y2
    rates = -(across * (run.v_x2 - run.v_s) + along * run.v_y2) / np.hypot(across, along)
    impacts = groups(run, "impact")
    assert len(impacts) > 20
    for before, behind in impacts:
        assert float(rates[behind] / rates[before]) == pytest.approx(-0.5, rel=1e-9)
    assert run.contact_gap_bush.min() > -1e-14
    for name in ("crank", "turning", "rod"):
        assert abs(run[f"constraint_residual_{name}"]).max() < 1e-14
        assert abs(run[f"constraint_rate_{name}"]).max() < 1e-12


def test_impulses_of_moving_constraints_do_work() -> None:
    """Assert what a shock of a led mechanism takes: the energy beside that of the drive, which keeps its pace."""
    run = xd.simulate(xd.Model.from_text(CLEARANCE), method="dop853", rtol=1e-10, until="0.05 s")
    rates = {"x1": run.m, "y1": run.m, "x2": run.m, "y2": run.m, "s": run.M}
    impacts = groups(run, "impact")
    events = [k for k, word in enumerate(words_of_flag(run.event_kind)) if word == "impact"]
    assert impacts
    for event, (before, behind) in zip(events, impacts, strict=True):
        gained = float(run.kinetic_energy[behind] - run.kinetic_energy[before])
        led = 0.0  # work of the crank's impulse: momentum that contacts do not explain, on its mean velocity
        for name, mass in rates.items():
            change = mass * (run[f"v_{name}"][behind] - run[f"v_{name}"][before])
            mean = (run[f"v_{name}"][behind] + run[f"v_{name}"][before]) / 2.0
            led += float((change - run[f"event_impulse_{name}"][event]) * mean)
        assert abs(led) > 1e-6
        assert gained == pytest.approx(led - float(run.event_energy_lost[event]), rel=1e-9)


def test_a_step_of_a_walker_keeps_its_angular_momentum() -> None:
    """Assert that a foot lands without slip, that the other lifts, and what both legs have about the new support."""
    run = xd.simulate(xd.Model.from_text(WALKER), method="dop853", rtol=1e-10, until="0.3 s")
    kinds = list(zip(words_of_flag(run.event_kind), words_of_flag(run.event_detector), strict=True))
    assert kinds == [("impact", "foot2"), ("takeoff", "foot1"), ("rest", "foot2")]
    before, behind = groups(run, "impact")[0]
    x, y = float(run.x2[behind]), float(run.y2[behind])

    def about_the_foot(row: int) -> float:
        """Angular momentum of hip and feet about the foot that lands."""
        points = ((run.M, "xh", "yh"), (run.m, "x1", "y1"), (run.m, "x2", "y2"))
        at: Any = {name: run[name][row] for _, *names in points for q in names for name in (q, f"v_{q}")}
        return float(sum(mass * ((at[a] - x) * at[f"v_{b}"] - (at[b] - y) * at[f"v_{a}"]) for mass, a, b in points))

    assert about_the_foot(behind) == pytest.approx(about_the_foot(before), rel=1e-13)
    assert math.hypot(float(run.v_x2[behind]), float(run.v_y2[behind])) < 1e-14
    pushed, pressed = (float(run[f"event_impulse_{name}"][0]) for name in ("x2", "y2"))
    assert abs(pushed) < pressed
    lost = float(run.kinetic_energy[before] - run.kinetic_energy[behind])
    assert float(run.event_energy_lost[0]) == pytest.approx(lost, rel=1e-12)
    assert all(late >= early for early, late in pairwise(run.y1.values[behind:][:3]))
