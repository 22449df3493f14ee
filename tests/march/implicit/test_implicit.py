"""Implicit methods: the laws they keep, stiff problems, Newton's iterations in the record.

Implicit steps from rest, where the derivative of v*hypot(v, w) by v is nought over nought and the force smooth.
Implicit steps of what large forces leave when they cancel: it has no digits by which equations could be solved.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from adaptive_problems import PROBLEMS

import xdynamics as xd
from cases.problems import EPS, MODELS, oscillator, particle
from xdynamics.methods.steppers import NEWTON, SIMPLIFIED

W, H = 2.0, 0.1


def test_implicit_midpoint_keeps_quadratic_invariants() -> None:
    """Assert that the oscillator's energy stays to rounding, which is this method's law."""
    energy = xd.simulate(oscillator().model, method="implicit_midpoint", step=H, until=100.0).total_energy.values
    assert np.abs(energy / energy[0] - 1).max() < 8 * EPS * np.sqrt(energy.size) * 8


def test_implicit_midpoint_frequency() -> None:
    """Assert the numeric frequency 2 arctan(wh/2)/h by its recurrence."""
    x = xd.simulate(oscillator().model, method="implicit_midpoint", step=H, until=50.0).x.values
    cosine = np.cos(2 * np.arctan(W * H / 2))
    assert np.abs(x[2:] - 2 * cosine * x[1:-1] + x[:-2]).max() < 64 * EPS


def test_implicit_verlet_without_velocity_forces_is_verlet() -> None:
    """Assert that without a velocity in the force it walks as velocity Verlet, to the rounding of the solve."""
    both = [
        xd.simulate(oscillator().model, method=name, step=0.01, until=10.0)
        for name in ("implicit_velocity_verlet", "velocity_verlet")
    ]
    assert np.abs(both[0].x - both[1].x).max() < 1000 * 16 * EPS


def test_implicit_verlet_solves_for_the_new_velocity() -> None:
    """Assert its discrete law under linear drag: v1 = v (1 - gh/2)/(1 + gh/2), the trapezoidal rule."""
    model = particle("-d*v_x", parameters={"m": "2 kg", "d": "6 N s m-1"})
    v = xd.simulate(model, method="implicit_velocity_verlet", step=H, until=2.0).v_x.values
    assert v[1:] / v[:-1] == pytest.approx((1 - 3 * H / 2) / (1 + 3 * H / 2), rel=16 * EPS)


def test_newton_iterations_and_tolerance_are_recorded() -> None:
    """Assert that the record says how the equations were solved, and how many iterations each step took."""
    run = xd.simulate(
        xd.Model.from_toml(MODELS / "double_pendulum.toml"), method="implicit_midpoint", step=0.01, until=1.0
    )
    iterations = run.newton_iterations.values
    assert iterations[0] == 0
    assert (iterations[1:] >= 2).all()
    assert (iterations[1:] <= 5).all()
    assert run.attrs["solver_newton_tolerance"] == 1e-10
    assert "exact Jacobians" in run.attrs["solver_equations_solved_by"]


def test_equations_without_a_solution_end_the_run() -> None:
    """Assert that a step whose equations Newton's method cannot solve is an outcome and a rejected trial."""
    model = particle("-F*(exp(20*second*v_x/(1*metre)) - 1)", v="1 m s-1")
    run = xd.simulate(model, method="implicit_midpoint", step=1e6, until=2e6)
    assert run.attrs["run_outcome"] in ("equations_unsolved", "nonfinite_state", "nonfinite_force")
    assert run.sizes["step"] == 1


def test_robertson_by_radau() -> None:
    """Assert the stiff reaction's published-type reference to the tolerance, in few steps."""
    problem = PROBLEMS["robertson"]
    run = xd.simulate(problem.model(), method="radau_iia", rtol=1e-8, atol=1e-12, until=problem.end)
    assert run.attrs["run_outcome"] == "completed"
    assert "stiff" not in run.attrs["run_outcome_text"]
    assert problem.error(problem.last_of(run)) < 1e-7
    assert run.sizes["step"] < 2000


def test_van_der_pol_by_radau() -> None:
    """Assert that the stiff van der Pol oscillator reaches its reference."""
    problem = PROBLEMS["van_der_pol"]
    run = xd.simulate(
        problem.model(), method="radau_iia", rtol=1e-9, atol=1e-9, until=problem.end, force_samples="none"
    )
    assert problem.error(problem.last_of(run)) < 1e-6


def test_python_forces_are_refused_by_name() -> None:
    """Assert that a force without derivatives is refused by implicit methods, which name what fits."""

    def push(x: float) -> float:
        return -x

    model = particle("0*newton")
    statement = {
        "name": "p",
        "coordinates": {"x": "m"},
        "parameters": {"m": "2 kg"},
        "mass": {"x": "m"},
        "forces": {"push": {"x": push}},
        "initial": {"x": "1 m", "v_x": "0 m s-1"},
    }
    with pytest.raises(
        xd.InputError,
        match="forces written in Python, which have no derivatives .function push.; these fit: forward_euler",
    ):
        xd.simulate(xd.Model(**statement), method="radau_iia", step=0.1, until=1.0)
    assert not xd.METHODS["radau_iia"].refusals(model)


IMPLICIT = [name for name, method in xd.METHODS.items() if method.solver in (NEWTON, SIMPLIFIED)]
FALL = xd.Model(
    name="two bodies, one of which falls",
    dimensions={"body": 2, "axis": 2},
    coordinates={"r": {"unit": "m", "dims": ["body", "axis"]}},
    parameters={"m": "1 kg", "c": "0.2 kg m-1", "g": "9 m s-2"},
    mass={"r": "m"},
    forces={
        "drag": {"r": "-c*v_r*norm(v_r, axis)"},
        "weight": {"r": "-m*g*index(axis)*index(body)"},
    },
    initial={"r": {"unit": "m", "value": [[0, 0], [1, 0]]}, "v_r": {"unit": "m s-1", "value": [[0, 0], [0, 0]]}},
)


def fallen(c: float, t: float) -> float:
    """How far a body of 1 kg falls from rest in a time, under 9 m/s2 and c v**2."""
    limit = math.sqrt(9.0 / c)
    return -(limit**2) / 9.0 * math.log(math.cosh(9.0 * t / limit))


@pytest.mark.parametrize("name", IMPLICIT)
def test_a_body_falls_from_rest_with_drag(name: str) -> None:
    """Assert the order of given steps from rest, by the closed form, beside a body that stays at rest."""
    errors = []
    for step in (1 / 8, 1 / 16):
        run = xd.simulate(FALL, method=name, step=step, until=1.0)
        assert run.attrs["run_outcome"] == "completed"
        assert not run.r.sel(body=0).any()
        errors.append(abs(float(run.r[-1, 1, 1]) - fallen(0.2, 1.0)))
    assert math.log2(errors[0] / errors[1]) > xd.METHODS[name].order - 0.1


def test_chosen_steps_fall_from_rest_in_lanes_as_alone() -> None:
    """Assert that runs side by side have the bits of each alone, and both the digits of the tolerance."""
    c = [0.1, 0.2, 0.3, 0.4]
    sweep = xd.sweep(FALL, {"c": c}, method="radau_iia", rtol=1e-8, until=1.0)
    for i, value in enumerate(c):
        run = xd.simulate(FALL.replace(parameters={"c": value}), method="radau_iia", rtol=1e-8, until=1.0)
        assert float(run.r[-1, 1, 1]) == pytest.approx(fallen(value, 1.0), rel=1e-8)
        assert float(sweep.end_r[i, 1, 1]) == float(run.r[-1, 1, 1])


HUNG = """
name = "A mass between two stiff springs"

[coordinates]
x = "m"
y = "m"

[parameters]
m = "5 kg"
k = "1e6 N/m"
g = "9.81 m s-2"
at_left = "-0.6 m"
at_right = "0.8 m"
length = "0.91 m"

[mass]
x = "m"
y = "m"

[forces.left]
potential = "k*(sqrt((x - at_left)**2 + y**2) - length)**2/2"

[forces.right]
potential = "k*(sqrt((x - at_right)**2 + y**2) - length)**2/2"

[forces.weight]
y = "-m*g"

[initial]
x = "0.1 m"
y = "-0.58 m"
v_x = "0 m/s"
v_y = "0 m/s"
"""
NET = """
name = "A net"

[dimensions]
row = 9
column = 9
axis = ["x", "y", "z"]

[relations.along]
of = "row"
neighbours = 1

[relations.across]
of = "column"
neighbours = 1

[coordinates]
r = { unit = "m", dims = ["row", "column", "axis"] }

[parameters]
m = "0.1 kg"
k = "1e5 N/m"
k_ground = "2e3 N/m"
length = "0.1 m"
g = "9.81 m s-2"
down = { dims = ["axis"], values = { x = "0", y = "0", z = "-1" } }
place_x = { dims = ["row"], value = "index(row)*0.1*metre" }
place_y = { dims = ["column"], value = "index(column)*0.1*metre" }
ex = { dims = ["axis"], values = { x = "1", y = "0", z = "0" } }
ey = { dims = ["axis"], values = { x = "0", y = "1", z = "0" } }

[mass]
r = "m"

[forces.threads]
over = "along"
potential = "k*sum((norm(second(r, along) - first(r, along), axis) - length)**2, column)/2"

[forces.weft]
over = "across"
potential = "k*sum((norm(second(r, across) - first(r, across), axis) - length)**2, row)/2"

[forces.ground]
potential = "k_ground*sum((r - place_x*ex - place_y*ey)**2, axis)/2"

[forces.weight]
potential = "-m*g*sum(r*down, axis)"

[initial]
r = "place_x*ex + place_y*ey"
v_r = "0*metre/second*(1 + 0*index(row))"
"""


STEPS = ("10 us", "0.5 ms", "1 ms")


@pytest.mark.parametrize("text", [HUNG, NET], ids=["hung", "net"])
@pytest.mark.parametrize(("method", "order"), [("radau_iia", 5), ("implicit_midpoint", 2)])
def test_steps_are_solved_as_far_as_the_forces_tell(text: str, method: str, order: int) -> None:
    """Assert that all steps have a solution, and that the error falls as the method's order says, down to rounding."""
    model, asked = xd.Model.from_text(text), {"until": "4 ms", "log": "states", "force_samples": "none"}
    exact = xd.simulate(model, method="dop853", rtol=1e-13, **asked)
    errors = []
    for step in STEPS:
        run = xd.simulate(model, method=method, step=step, **asked)
        assert run.attrs["run_outcome"] == "completed"
        names = [name for name in ("x", "y", "r") if name in run]
        errors.append(max(float(abs(run[name][-1] - exact[name][-1]).max()) for name in names))
    assert errors[2] < 1e-4
    assert np.log2(errors[2] / errors[1]) > order - 0.2
    assert errors[0] <= max(errors[1] / 50.0**order * 1.1, 1e-14)
