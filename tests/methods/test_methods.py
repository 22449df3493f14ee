"""Methods: exact limits, discrete laws, observed orders, refusals. Everything runs over the registry.

Digits that others have published: Arenstorf's orbit, Kepler at e = 0.9, the Pleiades.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from adaptive_problems import PROBLEMS
from numpy.typing import NDArray

import xdynamics as xd
from cases.problems import (
    EPS,
    MODELS,
    Problem,
    coupled_springs,
    damped,
    driven_decay,
    free,
    oscillator,
    pushed,
    springs,
)
from xdynamics.kernels import Layout
from xdynamics.methods.scheme import RULES, Scheme
from xdynamics.record.provenance import interpolation_orders

METHODS = list(xd.METHODS.values())
EXACT_SUBSTEPS = (
    "forward_euler",
    "euler_cromer",
    "averaged_velocity",
    "midpoint",
    "velocity_verlet",
    "position_verlet",
    "heun",
    "rk4",
    "implicit_midpoint",
    "implicit_velocity_verlet",
)
ROUNDED = 6e-14  # error below which rounding takes part, 3e-14 of it in the longest runs here
W, H = 2.0, 0.01  # of the oscillator, 1/s and s


def runs(problem: Problem, method: object, step: float, until: float) -> object:
    """March a problem without samples."""
    return xd.simulate(problem.model, method=method.name, step=step, until=until, force_samples="none")


def at_rest_or_pushed(push: float) -> xd.Model:
    """The springs without springs: free, or under a constant force."""
    return springs().replace(parameters={"F": push})


@pytest.mark.every(13)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_zero_force_keeps_velocity(method: object) -> None:
    """Assert that with zero force the velocity never changes and the position is linear to rounding."""
    run = xd.simulate(at_rest_or_pushed(0.0), method=method.name, step=0.125, until=100.0)
    assert (run.v_x == 3.0).all()
    # every number here is exact in binary, but the sub-steps of compositions round, some 40 times a step of 301 at most
    bound = 0 if method.name in EXACT_SUBSTEPS else 800 * 40 * EPS * 301
    assert np.abs(run.x - (1 + 3 * run.time)).max() <= bound


@pytest.mark.every(3)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_constant_acceleration_follows_discrete_law(method: object) -> None:
    """Assert the exact position of every method under constant acceleration: Euler's a t (t-h)/2 and its kin."""
    h, until = 1e-2, 2.0
    run = xd.simulate(at_rest_or_pushed(2.5), method=method.name, step=h, until=until)
    t = run.time.values
    half_square = {"forward_euler": t * (t - h), "euler_cromer": t * (t + h)}.get(method.name, t * t) / 2
    # each sub-step rounds x and v some three times: 200 steps of numbers below 16
    bound = 4 * 20 * 200 * EPS * 16
    assert np.abs(run.x - (1 + 3 * t + 2.5 * half_square)).max() < bound
    assert np.abs(run.v_x - (3 + 2.5 * t)).max() < bound


@pytest.mark.parametrize(("name", "factor"), [("forward_euler", 1 + (W * H) ** 2), ("midpoint", 1 + (W * H) ** 4 / 4)])
def test_energy_of_an_oscillator_grows_by_its_factor(name: str, factor: float) -> None:
    """Assert that it grows by 1 + (wh)**2 a step of Euler's, and by 1 + (wh)**4/4 of the midpoint rule's."""
    energy = runs(oscillator(), xd.METHODS[name], H, 10.0).total_energy.values
    assert np.abs(energy[1:] / energy[:-1] / factor - 1).max() < 16 * EPS


@pytest.mark.parametrize(
    ("name", "squared", "mixed"), [("velocity_verlet", 1 - (W * H) ** 2 / 4, 0.0), ("euler_cromer", 1.0, W**2 * H)]
)
def test_a_symplectic_step_keeps_its_invariant(name: str, squared: float, mixed: float) -> None:
    """Assert to rounding v**2 + w**2 x**2 (1 - (wh)**2/4), or v**2 + w**2 x**2 - w**2 h x v: kick before drift."""
    run = runs(oscillator(), xd.METHODS[name], H, 100.0)
    kept = run.v_x**2 + (W * run.x) ** 2 * squared - mixed * run.x * run.v_x
    assert np.abs(kept / kept[0] - 1).max() < 4 * EPS * np.sqrt(run.sizes["step"]) * 4


@pytest.mark.parametrize("name", ["velocity_verlet", "euler_cromer"])
def test_numeric_frequency(name: str) -> None:
    """Assert the numeric frequency arccos(1 - (wh)**2/2)/h, from the recurrence x+ - 2 cos x + x- = 0."""
    x = runs(oscillator(), xd.METHODS[name], H, 100.0).x.values
    cosine = 1 - (W * H) ** 2 / 2
    assert np.abs(x[2:] - 2 * cosine * x[1:-1] + x[:-2]).max() < 16 * EPS


@pytest.mark.every(5)
@pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")  # the longest steps are far off
@pytest.mark.parametrize("problem", [coupled_springs, damped], ids=lambda one: one.__name__)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_observed_order(method: object, problem: Callable[[], Problem]) -> None:
    """Assert that the slope of the error on the grid is within 0.1 of the method's own order."""
    if method.refusals(problem().model):
        pytest.skip(f"{method.name} refuses {problem.__name__}")
    solved = problem()
    found = fitted_order(lambda step: grid_errors(marched(solved, method, step), solved.exact))
    assert abs(found - method.order) < 0.1


@pytest.mark.every(7)
@pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")  # the longest steps are far off
@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_observed_order_between_steps(method: object, rule: str) -> None:
    """Assert that between steps no component falls slower than method and rule promise together."""
    problem = coupled_springs()
    sampled = lru_cache(None)(lambda step: sampled_inside(problem, method, step, rule))
    for name, order in interpolation_orders(Scheme(method), Layout(problem.model), rule).items():
        expected = min(method.order, order + 1)
        found = fitted_order(lambda step, one=name: largest_error(sampled(step), problem.exact, one))
        assert found > expected - 0.1, name


@pytest.mark.every(7)
@pytest.mark.parametrize("problem", ["kepler", "double_pendulum", "damped", "driven_decay"])
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_error_inside_steps_is_that_at_their_ends(method: object, problem: str) -> None:
    """Assert that between steps no component is twice as far from the solution as at any accepted state."""
    models = {"damped": lambda: damped().model, "driven_decay": lambda: driven_decay().model}
    model = models.get(problem, lambda: xd.Model.from_toml(MODELS / f"{problem}.toml"))()
    if method.refusals(model):
        pytest.skip(f"{method.name} refuses {problem}")
    if problem == "kepler":
        model = model.replace(initial={"x": 0.5, "v_y": 3**0.5})  # e = 0.5
    step = {"kepler": 0.1, "double_pendulum": 0.02, "damped": 0.1, "driven_decay": 0.1}[problem] / {1: 16, 2: 4}.get(
        method.order, 1
    )
    run = xd.simulate(model, method=method.name, step=step, until=20 * step)
    starts, parts = run.time.values[:-1, None], np.array([0.0, 0.03, 0.2, 0.4, 0.6, 0.8, 0.97])
    times = np.append((starts + parts * step).ravel(), run.time.values[-1])
    reference = xd.simulate(model, method="dop853", step=np.diff(times), until=20 * step)
    found, ends = xd.sample(run, times), np.arange(times.size) % parts.size == 0
    assert np.abs(reference.time - times).max() < 8 * EPS
    for name in Layout(model).used:
        off = np.abs(found[name].values - reference[name].values)
        assert off[~ends].max() <= 2 * off[ends].max(), name


def grid_errors(run: object, exact: object) -> float:
    """The largest scaled error of any component at accepted states."""
    return max(
        float(np.abs(run[name] - value).max() / np.abs(value).max()) for name, value in exact(run.time.values).items()
    )


def marched(problem: Problem, method: object, step: float) -> object:
    """March a problem for 2 s."""
    return xd.simulate(problem.model, method=method.name, step=step, until=2.0)


def sampled_inside(problem: Problem, method: object, step: float, rule: str) -> object:
    """The states within steps."""
    run = marched(problem, method, step)
    time = run.time.values
    return xd.sample(run, np.concatenate([time[:-1] + part * np.diff(time) for part in (0.3, 0.55, 0.8)]), rule=rule)


def largest_error(inner: object, exact: object, name: str) -> float:
    """The largest scaled error of one component within steps."""
    one = exact(inner.at_time.values)[name]
    return float(np.abs(inner[name] - one).max() / np.abs(one).max())


def fitted_order(measure: Callable[[float], float]) -> float:
    """Fit the order to the smallest errors that rounding does not touch, over steps that halve: to the last two."""
    steps, errors = [], []
    for n in range(1, 10):
        error = measure(2.0**-n)
        if error < ROUNDED and len(errors) > 3:
            break
        steps.append(2.0**-n)
        errors.append(error)
    kept = [i for i, error in enumerate(errors) if error > ROUNDED][-2:]
    return float(np.polyfit(np.log([steps[i] for i in kept]), np.log([errors[i] for i in kept]), 1)[0])


@pytest.mark.every(3)
@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_zero_coupling_leaves_the_other_alone(method: object) -> None:
    """Assert that without coupling no bit of one coordinate depends on the other."""
    model = springs().replace(parameters={"k": 4.0})
    first = xd.simulate(model, method=method.name, step=0.05, until=2.0)
    second = xd.simulate(model.replace(initial={"y": -7.0}), method=method.name, step=0.05, until=2.0)
    assert (first.x.values == second.x.values).all()
    assert (first.v_x.values == second.v_x.values).all()
    assert (first.x.values == first.y.values).all()


@pytest.mark.parametrize("method", METHODS, ids=lambda one: one.name)
def test_scales_of_powers_of_two_change_no_bit(method: object) -> None:
    """Assert that marching in nondimensional variables is undone before anything is reported."""
    scales = {"length": "4 m", "time": "0.5 s", "mass": "8 kg"}
    plain = xd.simulate(at_rest_or_pushed(2.5), method=method.name, step=0.125, until=2.0)
    scaled = xd.simulate(at_rest_or_pushed(2.5), method=method.name, step=0.125, until=2.0, scales=scales)
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


@pytest.mark.parametrize(
    ("file", "method", "said"),
    [
        (
            "linear_drag",
            "velocity_verlet",
            r"velocity-dependent forces \(force 'drag' of 'y' depends on v_y\); these fit: .*midpoint",
        ),
        ("woodpecker", "radau_iia", r"no derivatives of \(beak, lower, upper\); these fit"),  # each contact once
        ("double_pendulum", "velocity_verlet", r"mass entry \(1, 2\) depends on th1, th2"),
        ("rocket_c6", "velocity_verlet", "depends on the state fuel"),
    ],
)
def test_what_a_method_refuses_is_named_with_what_fits(file: str, method: str, said: str) -> None:
    """Assert the force, the contacts, the entry of a mass or the state that a method does not take."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(xd.Model.from_toml(MODELS / f"{file}.toml"), method=method)


def test_higher_orders_refuse_a_curved_gap_and_say_so() -> None:
    """Assert that the force of a contact on a round surface, which grows with the speed along it, is named with its reason."""
    round_floor = xd.Model(
        name="on a cylinder",
        coordinates={"x": "m", "y": "m"},
        mass=dict.fromkeys("xy", "1*kilogram"),
        forces={"weight": {"y": "-9.81*newton"}},
        contacts={"cylinder": {"gap": "hypot(x, y) - 1*metre", "restitution": 0.0}},
        initial={"x": "0 m", "y": "2 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
    )
    with pytest.raises(
        xd.InputError, match=r"\('contact_force_cylinder' along a curved gap depends on v_x, v_y\); these"
    ):
        xd.simulate(round_floor, method="forest_ruth", step=0.01, until=0.1)


def _errors(model: xd.Model, method: str, name: str, steps: list[float]) -> list[float]:
    """Return how far a state is after a second from that of tight tolerances."""
    exact = xd.simulate(model, method="dop853", rtol=1e-12, until=1)[name].values[-1]
    return [abs(xd.simulate(model, method=method, step=h, until=1)[name].values[-1] - exact) for h in steps]


def test_verlet_keeps_its_order_along_a_curved_gap() -> None:
    """Assert second order for a bead that slides down in a bowl."""
    bowl = xd.Model(
        name="bowl",
        coordinates={"x": "m", "y": "m"},
        mass=dict.fromkeys("xy", "1*kilogram"),
        forces={"weight": {"y": "-9.81*newton"}},
        contacts={"bowl": {"gap": "1*metre - hypot(x, y)", "restitution": 0}},
        initial={"x": "0.6 m", "y": "-0.8 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
    )
    coarse, fine = _errors(bowl, "velocity_verlet", "x", [0.01, 0.0025])
    assert 12 < coarse / fine < 18
    coarse, fine = _errors(bowl, "moreau_jean", "x", [0.01, 0.0025])
    assert 3.5 < coarse / fine < 4.5


def test_moreau_jean_takes_forces_of_velocities_and_of_states() -> None:
    """Assert second order where nothing touches, with drag, with a full mass, with a state; first on a floor and at a wall."""
    sled: dict[str, Any] = {
        "name": "sled",
        "coordinates": {"x": "m", "y": "m"},
        "mass": dict.fromkeys("xy", "1*kilogram"),
        "forces": {
            "weight": {"y": "-9.81*newton"},
            "drag": {"x": "-0.5*kilogram/second*v_x", "y": "-abs(v_y)*v_y*0.3*kilogram/metre"},
        },
        "contacts": {
            "floor": {"gap": "y", "restitution": 0.5, "tangential": "coulomb", "slip": "v_x", "friction": 0.2}
        },
        "initial": {"x": "0 m", "y": "0 m", "v_x": "3 m s-1", "v_y": "0 m s-1"},
    }
    thrown = sled | {"initial": {"x": "0 m", "y": "9 m", "v_x": "3 m s-1", "v_y": "1 m s-1"}}
    arms = {
        "name": "double pendulum",
        "coordinates": {"a": "rad", "b": "rad"},
        "lagrangian": {
            "kinetic": "1*kilogram*metre**2*(2*v_a**2 + v_b**2 + 2*v_a*v_b*cos(a - b))/2/radian**2",
            "potential": "-9.81*joule*(2*cos(a) + cos(b))",
        },
        "contacts": {"wall": {"gap": "(sin(a) + sin(b) + 5)*metre", "restitution": 0.6}},
        "initial": {"a": "1 rad", "b": "1.5 rad", "v_a": "0 rad s-1", "v_b": "0 rad s-1"},
    }
    warm = {
        "name": "spring that softens",
        "coordinates": {"x": "m"},
        "states": {"T": {"unit": "K", "rate": "-(T - 300*kelvin)/second + 3*kelvin/metre*v_x"}},
        "mass": {"x": "1*kilogram"},
        "forces": {"spring": {"x": "-40*newton/metre*x*T/(300*kelvin)"}},
        "initial": {"x": "1 m", "v_x": "0 m s-1", "T": "310 K"},
    }
    for statement, name, order in ((sled, "x", 1), (thrown, "y", 2), (arms, "b", 2), (warm, "T", 2)):
        coarse, fine = _errors(xd.Model(**statement), "moreau_jean", name, [0.008, 0.002])
        assert abs(np.log2(coarse / fine) / 2 - order) < 0.1, name
    arms["contacts"] = {"wall": {"gap": "(sin(a) + sin(b) + 0.5)*metre", "restitution": 0.6}}
    assert max(_errors(xd.Model(**arms), "moreau_jean", "a", [0.0005])) < 2e-3


def test_unknown_method_names_those_that_fit() -> None:
    """Assert that a wrong name is answered with the names that fit."""
    with pytest.raises(
        xd.InputError,
        match=r"method 'rk5' is not known; did you mean 'dormand_prince'\? these fit this model: forward_euler",
    ):
        xd.simulate(free().model, method="rk5", step=1, until=2)


def test_recorded_equations_are_those_that_ran() -> None:
    """Assert that the record quotes the update with the vectors the model has."""
    run = runs(free(), xd.METHODS["euler_cromer"], 0.5, 1.0)
    assert run.attrs["solver_update_equations"] == "v1 = v + h*a; q1 = q + h*v1; a1 = f(t1, q1, v1)"


def last(name: str, method: str, tolerance: float) -> NDArray[np.float64]:
    """March a problem to its end and return the last state."""
    problem = PROBLEMS[name]
    asked = {"method": method, "rtol": tolerance, "atol": tolerance, "until": problem.end, "force_samples": "none"}
    run = xd.simulate(problem.model(), **asked)
    assert run.attrs["run_outcome"] == "completed"
    return problem.last_of(run)


@pytest.mark.parametrize("method", ["dormand_prince", "dop853"])
def test_arenstorf_returns(method: str) -> None:
    """Assert that the orbit of Hairer, Norsett, Wanner, section II.0, closes after its period."""
    # the orbit multiplies an error by some 1e5 from start to end
    start = [0.994, 0.0, 0.0, -2.00158510637908252240537862224]
    assert last("arenstorf", method, 1e-13) == pytest.approx(start, abs=1e-13 * 1e5)


@pytest.mark.parametrize("method", ["dormand_prince", "dop853", "dprkn6"])
def test_kepler_at_high_eccentricity(method: str) -> None:
    """Assert x, y, x', y' at t = 20 from x = 0.1, y' = sqrt(19), by Kepler's equation."""
    exact = (-1.295266250987574, 0.4003938963792321, -0.6775390924707566, -0.1270838154278686)
    assert last("kepler", method, 1e-13) == pytest.approx(exact, abs=1e-10)


def test_pleiades() -> None:
    """Assert the seven stars' coordinates at t = 3 as the Test Set for IVP Solvers, release 2.4, publishes them."""
    assert PROBLEMS["pleiades"].error(last("pleiades", "dop853", 1e-12)) < 1e-8
