"""Implicit methods: the laws they keep, stiff problems, Newton's iterations in the record."""

from __future__ import annotations

import numpy as np
import pytest
from adaptive_problems import PROBLEMS

import xdynamics as xd
from cases.problems import EPS, MODELS, oscillator, particle

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
