"""Modes of motions that are kept by constraints, against those of the same motions in free coordinates."""

from __future__ import annotations

import math

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS

ROLLING = """
name = "disc on a spring"
[coordinates]
x = "m"
theta = "rad"
[parameters]
m = "3 kg"
R = "0.2 m"
k = "8 N m-1"
[mass]
x = "m"
theta = "m*R**2/2"
[forces.spring]
potential = "k*x**2/2"
[constraints.contact]
rolls = "v_x - R*v_theta/(1*radian)"
[initial]
x = "0 m"
theta = "0 rad"
"""
HANGING = """
name = "hanging body"
[bodies.rod]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.3 kg m2", "0.15 kg m2"]
points = { top = ["0 m", "0 m", "0.5 m"] }
[bodies.rod.initial]
position = ["0 m", "0 m", "-0.5 m"]
[parameters]
g = "9.81 m s-2"
[forces.weight]
potential = "rod_mass*g*rod_r[z]"
[constraints.pin]
holds = "point(rod, top)"
"""


def two_rods(copies: int = 1) -> xd.Model:
    """Two masses on rods, hanging, in Cartesian coordinates; the second rod perhaps written several times."""
    rods = {"upper": {"holds": "(x1**2 + y1**2 - l1**2)/(2*l1)"}}
    rods |= {f"lower{k}": {"holds": "((x2 - x1)**2 + (y2 - y1)**2 - l2**2)/(2*l2)"} for k in range(copies)}
    return xd.Model(
        name="rods",
        coordinates=dict.fromkeys(("x1", "y1", "x2", "y2"), "m"),
        parameters={"m1": "1 kg", "m2": "2 kg", "l1": "1 m", "l2": "0.7 m", "g": "9.8 m s-2"},
        mass={"x1": "m1", "y1": "m1", "x2": "m2", "y2": "m2"},
        forces={"weight": {"potential": "g*(m1*y1 + m2*y2)"}},
        constraints=rods,
        initial={"x1": "0 m", "x2": "0 m", "y1": "-1 m", "y2": "-1.7 m"},
    )


@pytest.mark.parametrize("copies", [1, 2])
def test_rods_have_the_modes_of_their_angles(copies: int) -> None:
    """Assert that two hanging rods have both frequencies and shapes of a double pendulum, also if one is held twice."""
    m1, m2, l1, l2, g = 1.0, 2.0, 1.0, 0.7, 9.8
    mass = np.array([[(m1 + m2) * l1**2, m2 * l1 * l2], [m2 * l1 * l2, m2 * l2**2]])
    squares, angles = np.linalg.eig(np.linalg.solve(mass, np.diag([(m1 + m2) * g * l1, m2 * g * l2])))
    order = np.argsort(squares)
    found = xd.modes(two_rods(copies))
    np.testing.assert_allclose(found.frequency, np.sqrt(squares[order]), rtol=1e-12)
    ratio = l2 / l1 * angles[1, order] / angles[0, order] + 1.0
    np.testing.assert_allclose(found.shape_x2 / found.shape_x1, ratio, rtol=1e-11)
    assert abs(found.shape_y2).max() < 1e-15
    turning = np.sort(abs(found.eigenvalue_imag))
    np.testing.assert_allclose(turning, np.repeat(np.sqrt(squares[order]), 2), rtol=1e-12)
    assert abs(found.eigenvalue_real).max() < 1e-13


def test_stable_steps_are_those_of_the_modes() -> None:
    """Assert that velocity Verlet is stable up to 2 over the faster frequency of two rods."""
    found = xd.modes(two_rods())
    names = found.method_name.attrs["flag_meanings"].split()
    limit = dict(zip(names, found.largest_stable_step.values, strict=True))
    assert limit["velocity_verlet"] == pytest.approx(2.0 / float(found.frequency[-1]), rel=1e-9)


def test_a_rolling_disc_is_half_as_heavy_again() -> None:
    """Assert that rolling couples a disc's spin to its motion: w**2 = k/(1.5 m), and one eigenvalue is a position."""
    found = xd.modes(xd.Model.from_text(ROLLING))
    frequency = math.sqrt(8.0 / 4.5)
    assert found.frequency.values == pytest.approx([frequency], rel=1e-13)
    assert float(found.shape_theta[0] / found.shape_x[0]) == pytest.approx(5.0, rel=1e-13)
    assert sorted(abs(found.eigenvalue_imag.values)) == pytest.approx([0.0, frequency, frequency], rel=1e-12, abs=1e-12)


def test_a_hanging_body_swings_in_two_planes() -> None:
    """Assert that a body held at a point has the eigenvalues of both its physical pendulums, and nothing else that moves."""
    found = xd.modes(xd.Model.from_text(HANGING))
    squares = np.sort(found.eigenvalue_imag.values**2)
    about = [2 * 9.81 * 0.5 / (moment + 2 * 0.25) for moment in (0.3, 0.2)]
    assert squares[-4:] == pytest.approx(np.repeat(about, 2), rel=1e-9)
    assert abs(squares[:-4]).max() < 1e-9
    assert abs(found.eigenvalue_real).max() < 1e-6
    assert found.frequency.values == pytest.approx([0.0, *np.sqrt(about)], rel=1e-12)
    shapes = found.shape_rod_turn.values
    np.testing.assert_allclose(abs(shapes), np.eye(3)[[2, 1, 0]], atol=1e-12)


def test_modes_of_a_constrained_model_are_described_before_they_are_computed() -> None:
    """Assert that sizes are known at once, and that a row of a run gives as many modes."""
    model = two_rods()
    lazily = xd.modes(model, compute=False)
    assert (lazily.sizes["mode"], lazily.sizes["eigenvalue"]) == (2, 4)
    found = xd.modes(model)
    assert lazily.compute().assign_attrs(found.attrs).identical(found)  # the date aside
    run = xd.simulate(xd.Model.from_toml(MODELS / "four_bar.toml"), until="0.5 s")
    assert xd.modes(run, row=-1).sizes["mode"] == 1


@pytest.mark.parametrize("faster", [1.0, 100.0])
def test_eigenvalues_of_what_moves_are_rates(faster: float) -> None:
    """Assert that a moving pendulum has eigenvalues of its frequency, no growth, and a hundredfold if all is as fast."""
    model = xd.Model(
        name="rod",
        coordinates={"x": "m", "y": "m"},
        parameters={"g": f"{9.8 * faster**2} m s-2"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"potential": "1*kilogram*g*y"}},
        constraints={"rod": {"holds": "hypot(x, y) - 1*metre"}},
        initial={"x": "0.6 m", "y": "-0.8 m", "v_x": f"{2.4 * faster} m s-1", "v_y": f"{1.8 * faster} m s-1"},
    )
    found = xd.modes(model)
    np.testing.assert_allclose(found.eigenvalue_imag, float(found.frequency[0]) * np.array([-1.0, 1.0]), rtol=1e-12)
    assert abs(found.eigenvalue_real).max() < 1e-12 * faster
    assert float(found.frequency[0]) == pytest.approx(faster * math.sqrt(9.8 * 0.8), rel=1e-12)  # as of the angle


def test_velocities_follow_displacements_of_what_moves() -> None:
    """Assert the eigenvalues of a moving pendulum with drag along x alone, by the linear equation of its angle."""
    model = xd.Model(
        name="rod",
        coordinates={"x": "m", "y": "m"},
        parameters={"g": "9.8 m s-2", "c": "0.5 kg s-1"},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"weight": {"potential": "1*kilogram*g*y"}, "drag": {"x": "-c*v_x"}},
        constraints={"rod": {"holds": "hypot(x, y) - 1*metre"}},
        initial={"x": "0.6 m", "y": "-0.8 m", "v_x": "2.4 m s-1", "v_y": "1.8 m s-1"},
    )
    found = xd.modes(model)
    values = found.eigenvalue_real.values + 1j * found.eigenvalue_imag.values
    # theta'' = -g sin(theta) - c cos(theta)**2 theta' at sin(theta) = 0.6, theta' = 3/s
    assert values.sum() == pytest.approx(-0.5 * 0.8**2, rel=1e-12)
    assert values.prod() == pytest.approx(9.8 * 0.8 - 0.5 * 2 * 0.6 * 0.8 * 3.0, rel=1e-12)
