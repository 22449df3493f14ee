"""Mechanisms whose motions were published, or are those of a pendulum."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases.problems import MODELS

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
        for name in xd.Model.from_toml(CASES / "andrews_squeezer.toml").constraints
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
