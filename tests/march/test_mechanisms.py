"""Mechanisms whose motions were published, or are those of a pendulum.

Impacts and friction of mechanisms that constraints hold together: clearances, steps of a walker, moving guides.
Links that slide and wedge, so that no forces exist: slow slips are stopped by an impulse, fast ones end the run.

A bounce that is low, and would wedge were it skipped, is not: the link lands, and that impact stops the slip.

A rod whose lower end slides on a rough floor (P. Painlevé, C. R. Acad. Sci. 121, 1895, 112): with friction above
(1 + 3 cos² theta)/(3 sin theta cos theta) the floor would have to press ever more.
Bodies at rest that others shift, as closed links are put back on their gaps: they stop at a wall, and do not sink into it.
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases.plain import made_by_hand, plain
from cases.problems import MODELS
from xdynamics.march.assembly.broad_phase import NEEDED, OUTSIDE, OUTSIDE_LINK, OUTSIDE_OF, TALLIES
from xdynamics.march.assembly.impact import DRAGS, FORCE, HALTED, NUMBERS, SLIP_ENDED, STATIC
from xdynamics.march.assembly.link_forces import check_cone
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import IMPACT

CASES = Path(__file__).parents[1] / "cases"
# Mazzia, Magherini 2008, Test Set for Initial Value Problem Solvers, release 2.4, University of Bari: reference solutions
CAR_AXIS = {
    "xl": 0.4934557842755629e-1,
    "yl": 0.4969894602303324,
    "xr": 0.1041742524885400e1,
    "yr": 0.3739110272652214,
    "v_xl": -0.7705836840321485e-1,
    "v_yl": 0.7446866596327776e-2,
    "v_xr": 0.1755681574942899e-1,
    "v_yr": 0.7703410437794031,
}
SQUEEZER = {
    "beta": 0.1581077119629904e2,
    "Theta": -0.1575637105984298e2,
    "gamma": 0.4082224013073101e-1,
    "phi": -0.5347301163226948,
    "delta": 0.5244099658805304,
    "Omega": 0.5347301163226948,
    "epsilon": 0.1048080741042263e1,
}
# opposite in sign to those of the test set, where M a + G^T u = F
FORCES = (
    0.1991753333731910e3,
    -0.2975531228015052e2,
    0.2306654119098399e2,
    0.3145271365475927e2,
    0.2264249232082739e2,
    0.1161740700019673e2,
)


def test_the_car_axis_ends_where_others_found_it() -> None:
    """Assert that positions and velocities are the published ones, and that both multipliers balance the forces."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "car_axis.toml"))
    for name, value in CAR_AXIS.items():
        assert run[name].values[-1] == pytest.approx(value, rel=0, abs=1e-10)
    # the published ones, -0.4736886750784630e-2 and -0.1104680411345730e-2, miss the equations in the eighth digit
    assert run.constraint_force_upright.values[-1] == pytest.approx(-0.47368866e-2, rel=1e-6)
    assert run.constraint_force_axle.values[-1] == pytest.approx(-0.11046804e-2, rel=1e-6)
    across = run.m * run.a_xl - run.force_springs_xl
    bar = np.sqrt(run.l**2 - (run.bump * np.sin(run.pace * run.time)) ** 2)
    held = run.constraint_force_upright * bar + run.constraint_force_axle * 2 * (run.xl - run.xr)
    assert abs(across - held).max() < 1e-15


@pytest.mark.parametrize(("loops", "bound"), [(1, 1e-9), (2, 1e-8)])
def test_four_bars_pass_positions_where_all_rods_are_in_line(loops: int, bound: float) -> None:
    """Assert that parallel cranks swing as one pendulum, through positions where constraints imply each other."""
    model = xd.Model.from_toml(MODELS / "four_bar.toml") if loops == 1 else xd.Model.from_text(TWO_LOOPS)
    run = xd.simulate(model, method="dop853", rtol=1e-12, until="5 s")
    moment, weight = (loops + 1) / 3 + loops, 9.81 * ((loops + 1) / 2 + loops)
    pendulum = solve_ivp(
        lambda _, y: [y[1], -weight / moment * np.cos(y[0])],
        (0.0, 5.0),
        [np.pi / 2, -1.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        dense_output=True,
    )
    angle = pendulum.sol(run.time.values)[0]
    assert abs(run.x0 - np.cos(angle)).max() < bound
    assert abs(run.y0 - np.sin(angle)).max() < bound
    assert np.diff(np.sign(run.y0)).any()


@pytest.mark.dear
def test_andrews_squeezer_ends_where_others_found_it() -> None:
    """Assert that angles, forces, energy and rates of seven bodies in three loops are the published ones, or balance."""
    run = xd.simulate(xd.Model.from_toml(CASES / "andrews_squeezer.toml"))
    for name, value in SQUEEZER.items():
        assert run[name].values[-1] == pytest.approx(value, rel=1e-9)
    forces = [
        run[f"constraint_force_{name}"].values[-1]
        for name in xd.Model.from_toml(CASES / "andrews_squeezer.toml").elements.constraints
    ]
    assert forces == pytest.approx([-force for force in FORCES], rel=0, abs=2e-5)
    assert run.a_beta.values[0] == pytest.approx(14222.4439199541138705911625887, rel=1e-12)
    done = run.M * (run.beta - run.beta[0])
    missing = run.total_energy - run.total_energy[0] - done
    assert abs(missing).max() < 1e-12 * abs(run.kinetic_energy).max()
    for name in ("rocker_x", "rocker_y", "upper_x", "upper_y", "lower_x", "lower_y"):
        assert abs(run[f"constraint_rate_{name}"]).max() < 1e-12


def test_a_slider_crank_of_bodies_is_that_of_one_freedom() -> None:
    """Assert stroke, pin and the force on the piston of three bodies in four joints by the equation of the crank's angle.

    J(a) a'' + J'(a) a'**2/2 + V'(a) = 0, with the energies of a crank, a rod and a piston by one angle.
    """
    r, l, g, crank, rod, piston = 0.15, 0.4, 9.81, 1.0, 0.8, 0.5

    def shape(a: complex) -> tuple[complex, complex, complex, complex]:
        """The inertia of the angle, the potential, the stroke and its derivative."""
        s, c = np.sin(a), np.cos(a)
        lean = np.sqrt(l**2 - r**2 * s**2)
        stroke, turn = -r * s - r**2 * s * c / lean, r * c / lean  # by the angle
        centre = (-r * s - r**2 * s * c / (2 * lean)) ** 2 + (r * c / 2) ** 2
        inertia = crank * r**2 / 3 + rod * (centre + l**2 / 12 * turn**2) + piston * stroke**2
        return inertia, g * (crank + rod) * r / 2 * s, r * c + lean, stroke

    def second(a: float, rate: float) -> float:
        """The acceleration of the angle, with derivatives by a complex step."""
        inertia, potential, _, _ = shape(a + 1e-30j)
        return float(-(inertia.imag * rate**2 / 2 + potential.imag) / 1e-30 / inertia.real)

    run = xd.simulate(xd.Model.from_toml(MODELS / "slider_crank.toml"), until="0.6 s")
    exact = solve_ivp(
        lambda _, y: [y[1], second(*y)],
        (0.0, 0.6),
        [0.0, 16.0],
        method="DOP853",
        rtol=1e-13,
        atol=1e-13,
        dense_output=True,
    )
    angle, rate = exact.sol(run.time.values)
    assert angle[-1] > 4.0
    assert abs(run.stroke - shape(angle)[2]).max() < 1e-10
    pushed = [
        piston * ((shape(a + 1e-30j)[3].imag / 1e-30) * w**2 + shape(a)[3] * second(a, w))
        for a, w in zip(angle, rate, strict=True)
    ]
    assert abs(run.joint_force_wrist.sel(axis="x") + pushed).max() < 1e-8
    assert abs(run.total_energy - run.total_energy[0]).max() < 1e-11
    assert (run.constraint_rank == 17).all()


# Meijaard, Papadopoulos, Ruina, Schwab, Proc. R. Soc. A 463, 2007: M, C1, K0, K2 of the benchmark, and Table 2 at 5 m/s
BICYCLE_EIGENVALUES = (
    -14.07838969279822,
    -0.77534188219585 - 4.46486771378823j,
    -0.77534188219585 + 4.46486771378823j,
    -0.32286642900409,
)


@pytest.mark.dear
def test_the_bicycle_has_the_published_eigenvalues() -> None:
    """Assert that lean and steer after a small push follow from one another, step by step, as Table 2 says."""
    model = xd.Model.from_toml(MODELS / "bicycle.toml").replace(parameters={"push": 1e-4})
    run = xd.simulate(model, method="dop853", step="10 ms", until="2 s")
    states = np.array([run.leaning.values, run.steer.values]).T / 1e-4
    pairs = np.hstack([states[:-1], states[1:]])
    propagator = np.linalg.lstsq(pairs[:-1], pairs[1:], rcond=None)[0]
    found = np.log(np.linalg.eigvals(propagator).astype(complex)) / 0.01
    assert sorted(found, key=lambda value: (value.real, value.imag)) == pytest.approx(BICYCLE_EIGENVALUES, rel=1e-7)
    assert (run.constraint_rank == 21).all()
    for name in ("rear_ground", "front_ground"):
        assert abs(run[f"constraint_residual_{name}"]).max() < 1e-13


TWO_LOOPS = """
name = "two loops"
[coordinates]
x0 = "m"
y0 = "m"
x1 = "m"
y1 = "m"
x2 = "m"
y2 = "m"
[parameters]
m = "1 kg"
l = "1 m"
g = "9.81 m s-2"
[mass]
matrix = [
    ["2*m/3", "0", "m/6", "0", "0", "0"],
    ["0", "2*m/3", "0", "m/6", "0", "0"],
    ["m/6", "0", "m", "0", "m/6", "0"],
    ["0", "m/6", "0", "m", "0", "m/6"],
    ["0", "0", "m/6", "0", "2*m/3", "0"],
    ["0", "0", "0", "m/6", "0", "2*m/3"],
]
[forces.weight]
potential = "m*g*(y0 + 1.5*y1 + y2)"
[constraints]
crank0 = "x0**2 + y0**2 - l**2"
crank1 = "(x1 - l)**2 + y1**2 - l**2"
crank2 = "(x2 - 2*l)**2 + y2**2 - l**2"
coupler1 = "(x1 - x0)**2 + (y1 - y0)**2 - l**2"
coupler2 = "(x2 - x1)**2 + (y2 - y1)**2 - l**2"
[initial]
x0 = "0 m"
y0 = "1 m"
v_x0 = "1 m s-1"
x1 = "1 m"
y1 = "1 m"
v_x1 = "1 m s-1"
x2 = "2 m"
y2 = "1 m"
v_x2 = "1 m s-1"
"""


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


RODS = """
name = "rods on a rough floor"
[dimensions]
rod = 30
[coordinates]
x = {{ unit = "m", dims = ["rod"] }}
y = {{ unit = "m", dims = ["rod"] }}
theta = {{ unit = "rad", dims = ["rod"] }}
[parameters]
g = "9.80665 m s-2"
length = "1 m"
mu = "{mu}"
start = "1.1071487177940904 rad"
[mass]
x = "1*kilogram"
y = "1*kilogram"
theta = "kilogram*length**2/12/radian**2"
[forces.weight]
y = "-g*kilogram"
[contacts.floor]
gap = "y - length/2*sin(theta)"
restitution = 0
tangential = "coulomb"
slip = "v_x + length/2*sin(theta)*v_theta/radian"
friction = "mu"
rest_height = "1e-7 m"
[initial]
x = "3*metre*index(rod)"
y = "length/2*sin(start)"
theta = "start"
v_x = "-{slip}*metre/second"
[run]
method = "velocity_verlet"
step = "1 ms"
until = "5 ms"
"""
ANGLE = np.arctan(2.0)


def test_a_slow_slip_that_wedges_stops() -> None:
    """Assert that the end sticks after the first step at the latest, and that the rod then turns about it, as a pendulum upside down does."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.8, slip=1e-3)))
    assert run.run_outcome == "completed"
    assert run.a_theta.values[0] == pytest.approx(-1.5 * 9.80665 * np.cos(ANGLE), rel=1e-12)
    effects = np.array([[1.6, -1.2], [-1.2, 3.4]])  # of a unit pressing and rubbing at the end on its rates
    pressing, rubbing = np.linalg.solve(effects, [0.0, 1e-3])
    turned = 6.0 * (np.sin(ANGLE) * rubbing - np.cos(ANGLE) * pressing)  # by the impulse that stops the end
    fallen = turned - 1.5 * 9.80665 * np.cos(ANGLE) * 5e-3
    assert run.v_theta.values[-1] == pytest.approx(fallen, rel=2e-4)
    ends = run.x.values[-1] - np.cos(run.theta.values[-1]) / 2
    assert ends == pytest.approx(run.x.values[0] - np.cos(ANGLE) / 2, abs=1.001e-6)  # a step of the slip


def test_a_slow_slip_that_has_forces_goes_on() -> None:
    """Assert that with less friction than wedges the end slides, however slowly, and is braked as forces have it."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.2, slip=1e-3)))
    pressed = 9.80665 / (1.6 - 1.2 * 1.2)  # m s-2: of the floor, for a mass
    assert run.a_x.values[0] == pytest.approx(1.2 * pressed, rel=1e-9)


def test_a_fast_slip_that_wedges_ends_the_run() -> None:
    """Assert the outcome in words where an impulse would take more than what may be skipped."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.8, slip=1.0)))
    assert run.run_outcome == "contact_undetermined"
    assert "forces" in run.run_outcome_text


def test_a_low_bounce_that_would_wedge_is_not_skipped() -> None:
    """Assert that ends that leave at 0.1 mm/s, which would wedge on the floor, land 2 v/g later, and stick by that impact."""
    text = RODS.format(mu=1.8, slip=1.0)
    text = text.replace("v_x =", 'v_y = "1e-4*metre/second"\nv_x =')
    run = xd.simulate(xd.Model.from_text(text))
    assert run.run_outcome == "completed"
    strikes = run.event_kind.values == IMPACT
    assert np.count_nonzero(strikes) == 30
    assert run.event_time.values[strikes] == pytest.approx(np.full(30, 2e-4 / 9.80665), rel=1e-9)
    pressing, rubbing = np.linalg.solve([[1.6, -1.2], [-1.2, 3.4]], [1e-4, 1.0])
    assert rubbing < 1.8 * pressing  # so that ends stick
    turned = 6.0 * (np.sin(ANGLE) * rubbing - np.cos(ANGLE) * pressing)
    after = run.isel(step=run.event_row_after.values[strikes])
    assert after.v_theta.values == pytest.approx(np.full((30, 30), turned), rel=1e-9)


def test_links_beside_one_that_wedges_slide_on() -> None:
    """Assert that where one rod wedges, those beside it that no impulse within their cone stops slide on, as forces have it."""
    text = RODS.format(mu=1.8, slip=1e-3).replace('mu = "1.8"', 'mu = "where(index(rod) > 0.5, 1.2, 1.8)"')
    text = text.replace('mu = "', 'mu = { dims = ["rod"], value = "').replace('1.8)"', '1.8)" }')
    run = xd.simulate(xd.Model.from_text(text))
    assert run.run_outcome == "completed"
    assert run.a_theta.values[0, 0] == pytest.approx(-1.5 * 9.80665 * np.cos(ANGLE), rel=1e-12)
    pressed = 9.80665 / (1.6 - 1.2 * 1.2)
    assert run.a_x.values[0, 1:] == pytest.approx(np.full(29, 1.2 * pressed), rel=1e-9)


def test_impulses_outside_a_cone_are_counted() -> None:
    """Assert of three impulses that stopped slips, with a coefficient of 0.5, that one in the cone is not, and the worst is kept."""
    arrays = {"touching": np.zeros((1, NUMBERS)), "candidates": np.array([[3, 7, 0, 0, 1]])}
    run = made_by_hand(n=1, **arrays, counters=np.zeros(TALLIES, np.int64), spans=np.zeros(16))
    run.touching[0, STATIC], run.touching[0, HALTED] = 0.5, SLIP_ENDED
    run.touching[0, FORCE], run.touching[0, DRAGS] = 10.0, 2.0
    for rubbing, lasting in ((0.9, 0.2), (2.0, 0.2), (1.0, 0.0)):  # over 0.5*(pressing + 10*0.2) with 2*0.2 more
        plain(check_cone)(run, 0, 1.0, rubbing, lasting)
    assert run.counters[OUTSIDE] == 2
    assert run.spans[NEEDED] == pytest.approx(2.0, rel=1e-15)  # the last, of which no force helps
    assert run.counters[OUTSIDE_OF] == 3
    assert run.counters[OUTSIDE_LINK] == 7


RADIUS, AWAY, TILT, SPEED = 0.1, 1e-9, np.deg2rad(50.0), 0.8  # m, m, of the upper disc on the lower one, m/s


def slid() -> xr.Dataset:
    """Return the run of a disc that slides up over a heavy one, which friction holds 1 nm from a wall; six stand apart."""
    side, up = 2.0 * RADIUS * np.cos(TILT), 2.0 * RADIUS * np.sin(TILT)
    rest, far = [0.0] * 6, [5.0 + k for k in range(6)]
    model = xd.Model(
        name="slide",
        dimensions={"disc": 8},
        relations={"pair": {"of": "disc"}},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        parameters={
            "radius": f"{RADIUS} m",
            "wall": f"{-RADIUS - AWAY!r} m",
            "m": {"unit": "kg", "dims": ["disc"], "value": [30.0] + [1.0] * 7},
        },
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-9.80665*m*metre/second**2"}},
        contacts={
            "floor": {"gap": "y - radius", "tangential": "coulomb", "slip": "v_x", "friction": "0.9", "restitution": 0},
            "left": {"gap": "x - radius - wall", "restitution": 0},
            "discs": {
                "gap": "hypot(second(x, pair) - first(x, pair), second(y, pair) - first(y, pair)) - 2*radius",
                "restitution": 0,
            },
        },
        initial={
            "x": {"unit": "m", "value": [0.0, side, *far]},
            "y": {"unit": "m", "value": [RADIUS, RADIUS + up, *[RADIUS] * 6]},
            "v_x": {"unit": "m s-1", "value": [0.0, -SPEED * np.sin(TILT), *rest]},
            "v_y": {"unit": "m s-1", "value": [0.0, SPEED * np.cos(TILT), *rest]},
        },
    )
    return xd.simulate(model, method="velocity_verlet", step="5 ms", until="50 ms")


def test_a_disc_at_rest_that_is_shifted_stops_at_a_wall() -> None:
    """Assert that it touches the wall in the first step and stays there, by one event; unhindered it would go 0.2 um on."""
    run = slid()
    assert run.attrs["run_outcome"] == "completed"
    gap = run["x"].values[:, 0] + AWAY
    assert gap[0] == AWAY
    assert np.abs(gap[2:]).max() <= 1e-16
    assert gap[1] >= -4e-12  # as far as a time of 1e-12 s goes at the speed of the other disc
    assert np.abs(run["v_x"].values[:, 0]).max() <= 1e-18
    words = [run[name].attrs["flag_meanings"].split() for name in ("event_detector", "event_kind")]
    named = zip(run["event_detector"].values, run["event_kind"].values, strict=True)
    assert [(words[0][d], words[1][k]) for d, k in named] == [("left", "rest")]
