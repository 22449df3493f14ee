"""Methods: exact limits, discrete laws, observed orders, refusals. Everything runs over the registry."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from problems import EPS, MODELS, SMOOTH, Problem, free, oscillator, pushed

METHODS = list(xd.METHODS.values())
W, H = 2.0, 0.01  # of the oscillator, 1/s and s


def runs(problem: Problem, method: object, step: float, until: float) -> object:
    """March a problem without samples."""
    return xd.simulate(problem.model, method=method.name, step=step, until=until, force_samples="none")


def fits(problem: Problem, method: object) -> bool:
    """Whether a method takes a problem."""
    return not method.refusals(problem.model)


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_zero_force_keeps_velocity(method: object) -> None:
    """Assert that with zero force the velocity never changes and the position is linear to rounding."""
    run = runs(free(), method, 0.125, 100.0)
    assert (run.v_x == 3.0).all()
    assert (run.x == 1 + 3 * run.time).all()  # every number here is exact in binary


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_constant_acceleration_follows_discrete_law(method: object) -> None:
    """Assert the exact position of every method under constant acceleration: Euler's a t (t-h)/2 and its kin."""
    h, until = 1e-3, 2.0
    run = runs(pushed(), method, h, until)
    t = run.time.values
    half_square = {"forward_euler": t * (t - h), "euler_cromer": t * (t + h)}.get(method.name, t * t) / 2
    # each step rounds x three times and v once: 2000 steps of numbers below 16
    bound = 4 * 2000 * EPS * 16
    assert np.abs(run.x - (1 + 3 * t + 2.5 * half_square)).max() < bound
    assert np.abs(run.v_x - (3 + 2.5 * t)).max() < 2000 * EPS * 16


def test_forward_euler_energy_grows_by_its_factor() -> None:
    """Assert that the oscillator's energy grows by 1 + (wh)**2 a step."""
    energy = runs(oscillator(), xd.METHODS["forward_euler"], H, 10.0).total_energy.values
    factor = 1 + (W * H) ** 2
    assert np.abs(energy[1:] / energy[:-1] / factor - 1).max() < 16 * EPS


def test_midpoint_energy_grows_by_its_factor() -> None:
    """Assert that the oscillator's energy grows by 1 + (wh)**4/4 a step."""
    energy = runs(oscillator(), xd.METHODS["midpoint"], H, 10.0).total_energy.values
    factor = 1 + (W * H) ** 4 / 4
    assert np.abs(energy[1:] / energy[:-1] / factor - 1).max() < 16 * EPS


def test_velocity_verlet_keeps_its_invariant() -> None:
    """Assert that v**2 + w**2 x**2 (1 - (wh)**2/4) stays to rounding."""
    run = runs(oscillator(), xd.METHODS["velocity_verlet"], H, 100.0)
    kept = run.v_x**2 + (W * run.x) ** 2 * (1 - (W * H) ** 2 / 4)
    assert np.abs(kept / kept[0] - 1).max() < 4 * EPS * np.sqrt(run.sizes["step"]) * 4


def test_euler_cromer_keeps_its_invariant() -> None:
    """Assert that v**2 + w**2 x**2 - w**2 h x v stays to rounding, with the sign of kick before drift."""
    run = runs(oscillator(), xd.METHODS["euler_cromer"], H, 100.0)
    kept = run.v_x**2 + (W * run.x) ** 2 - W**2 * H * run.x * run.v_x
    assert np.abs(kept / kept[0] - 1).max() < 4 * EPS * np.sqrt(run.sizes["step"]) * 4


@pytest.mark.parametrize("name", ["velocity_verlet", "euler_cromer"])
def test_numeric_frequency(name: str) -> None:
    """Assert the numeric frequency arccos(1 - (wh)**2/2)/h, from the recurrence x+ - 2 cos x + x- = 0."""
    x = runs(oscillator(), xd.METHODS[name], H, 100.0).x.values
    cosine = 1 - (W * H) ** 2 / 2
    assert np.abs(x[2:] - 2 * cosine * x[1:-1] + x[:-2]).max() < 16 * EPS


@pytest.mark.parametrize("name", SMOOTH)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_observed_order(method: object, name: str) -> None:
    """Assert that the slope of the error over four steps is within 0.1 of the method's own order."""
    problem = SMOOTH[name]()
    if not fits(problem, method):
        pytest.skip(f"{method.name} refuses {name}")
    steps = np.array([2.0**-n for n in (7, 8, 9, 10)])
    errors = [largest_error(problem, method, step) for step in steps]
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert abs(slope - method.order) < 0.1


def largest_error(problem: Problem, method: object, step: float) -> float:
    """The largest scaled error of any component over the first second."""
    run = runs(problem, method, step, 1.0)
    exact = problem.exact(run.time.values)
    return max(float(np.abs(run[name] - one).max() / np.abs(one).max()) for name, one in exact.items())


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_zero_coupling_is_two_separate_runs(method: object) -> None:
    """Assert that uncoupled masses move bit for bit as each does alone."""
    coupled = xd.Model.from_toml(MODELS / "coupled_masses.toml").replace(parameters={"kc": 0.0}, initial={"x2": 0.5})
    both = xd.simulate(coupled, method=method.name, step=H, until=5.0)
    alone = xd.simulate(oscillator().model, method=method.name, step=H, until=5.0)
    assert (both.x1.values == alone.x.values).all()
    assert (both.x2.values == alone.x.values / 2).all()


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_scales_of_powers_of_two_change_no_bit(method: object) -> None:
    """Assert that marching in nondimensional variables is undone before anything is reported."""
    problem = pushed() if fits(pushed(), method) else free()
    scales = {"length": "4 m", "time": "0.5 s", "mass": "8 kg"}
    plain = xd.simulate(problem.model, method=method.name, step=0.125, until=2.0)
    scaled = xd.simulate(problem.model, method=method.name, step=0.125, until=2.0, scales=scales)
    for name in ("time", "x", "v_x", "a_x", "force_push_x", "kinetic_energy", "sample_x", "step_size"):
        assert (plain[name].values == scaled[name].values).all(), name
    assert scaled.attrs["solver_time_scale"] == 0.5


def test_samples_hold_time_and_state_of_every_stage() -> None:
    """Assert that midpoint samples its half step at t + h/2 with the half-step state."""
    run = xd.simulate(pushed().model, method="midpoint", step=0.25, until=1.0)
    assert run.sizes["sample"] == 1 + 2 * 4
    half = run.isel(sample=np.flatnonzero(run.sample_stage == 1))
    assert half.sample_time.values.tolist() == [0.125, 0.375, 0.625, 0.875]
    assert (half.sample_v_x == run.v_x.values[:-1] + 0.125 * 2.5).all()
    assert half.sample_step.values.tolist() == [1, 2, 3, 4]


def test_verlet_refuses_drag_and_names_what_fits() -> None:
    """Assert that a velocity-dependent force is refused with the term and the methods that fit."""
    with pytest.raises(
        xd.InputError, match=r"velocity-dependent forces \(force 'drag' of 'y' depends on v_y\); these fit: .*midpoint"
    ):
        xd.simulate(SMOOTH["linear_drag"]().model, method="velocity_verlet")


def test_verlet_refuses_angle_dependent_mass() -> None:
    """Assert that a full mass matrix that depends on coordinates is refused."""
    model = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    with pytest.raises(xd.InputError, match=r"mass entry \(1, 2\) depends on th1, th2"):
        xd.simulate(model, method="velocity_verlet")


def test_verlet_refuses_coupled_states() -> None:
    """Assert that a mass that falls with the fuel is refused."""
    model = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    with pytest.raises(xd.InputError, match="depends on the state fuel"):
        xd.simulate(model, method="velocity_verlet")


def test_unknown_method_names_those_that_fit() -> None:
    """Assert that a wrong name is answered with the names that fit."""
    with pytest.raises(xd.InputError, match="method 'rk5' is not known; these fit this model: forward_euler"):
        xd.simulate(free().model, method="rk5", step=1, until=2)


def test_recorded_equations_are_those_that_ran() -> None:
    """Assert that the record quotes the update with the vectors the model has."""
    run = runs(free(), xd.METHODS["euler_cromer"], 0.5, 1.0)
    assert run.attrs["solver_update_equations"] == "v1 = v + h*a; q1 = q + h*v1; a1 = f(t1, q1, v1)"
