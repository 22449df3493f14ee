"""Steps that methods bear, against their stability functions in closed form."""

from __future__ import annotations

import math
import warnings
from itertools import pairwise

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, oscillator, particle
from xdynamics.methods import Evaluation, Method
from xdynamics.methods.lines import spread_over_vectors
from xdynamics.model import Trait
from xdynamics.model.linearisation import initial_state, linearise
from xdynamics.stability import limits
from xdynamics.stability.amplification import LinearSystem, amplification, amplification_factors
from xdynamics.stability.limits import (
    OSCILLATOR,
    decay_limit,
    largest_step,
    oscillator_limit,
    stable_step,
    stiffness,
    treats_alike,
)

RK4 = """
    y2 = y + h/2*k
    k2 = f(t + h/2, y2)
    y3 = y + h/2*k2
    k3 = f(t + h/2, y3)
    y4 = y + h*k3
    k4 = f(t1, y4)
    y1 = y + h/6*(k + 2*k2 + 2*k3 + k4)
    k1 = f(t1, y1)
"""
IMPLICIT_MIDPOINT = """
    vm = v + h/2*a
    xm = x + h/2*r
    solve vm, xm:
        qm = q + h/2*vm
        am, rm = f(t + h/2, qm, vm, xm)
        vm = v + h/2*am
        xm = x + h/2*rm
    q1 = q + h*vm
    v1 = v + h*am
    x1 = x + h*rm
    a1, r1 = f(t1, q1, v1, x1)
"""


def made(update: str) -> Method:
    """A method of which only the update counts."""
    return Method("made", 1, symplectic=False, evaluations=1, update=update, words="", reference="")


def theta(weight: float) -> Method:
    """The theta method: its real interval is 2/(1 - 2 theta), all of it from 1/2 on."""
    lines = [
        "solve v1, x1:",
        "    q1 = q + h*(W*v1 + (1 - W)*v)",
        "    a1, r1 = f(t1, q1, v1, x1)",
        "    v1 = v + h*(W*a1 + (1 - W)*a)",
        "    x1 = x + h*(W*r1 + (1 - W)*r)",
    ]
    return made("\n".join(lines).replace("W", repr(weight)))


LIMITS = {
    "forward_euler": (xd.METHODS["forward_euler"], 0.0, 2.0),
    "euler_cromer": (xd.METHODS["euler_cromer"], 2.0, 2.0),
    "velocity_verlet": (xd.METHODS["velocity_verlet"], 2.0, math.nan),
    "midpoint": (xd.METHODS["midpoint"], 0.0, 2.0),
    "rk4": (made(spread_over_vectors(RK4)), math.sqrt(8.0), 2.785293563405282),
    "implicit_midpoint": (made(IMPLICIT_MIDPOINT), math.inf, math.inf),
    "backward_euler": (theta(1.0), math.inf, math.inf),
    "theta_quarter": (theta(0.25), 0.0, 4.0),
}


@pytest.mark.parametrize("name", LIMITS)
def test_limits_are_those_of_the_literature(name: str) -> None:
    """Assert the imaginary and the real interval of stability, to a billionth."""
    method, of_oscillator, of_decay = LIMITS[name]
    assert oscillator_limit(method) == pytest.approx(of_oscillator, rel=1e-9, abs=0)
    assert decay_limit(method) == pytest.approx(of_decay, rel=1e-9, abs=0, nan_ok=True)


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=list(xd.METHODS))
def test_a_step_is_the_power_series_of_the_flow(method: Method) -> None:
    """Assert that one step differs from the exact rotation by O(h**(order + 1))."""
    h = np.array([0.4, 0.2])
    exact = np.array([[[math.cos(z), math.sin(z)], [-math.sin(z), math.cos(z)]] for z in h])
    coarse, fine = np.abs(amplification(method, OSCILLATOR, h) - exact).max(axis=(1, 2))
    assert coarse / fine > 2.0 ** (method.order + 0.5)


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=list(xd.METHODS))
def test_a_step_ends_with_the_forces_of_its_end(method: Method) -> None:
    """Assert what the amplification needs: a1 and r1 at the end, or no forces that would tell."""
    last = [
        statement
        for statement in method.statements
        if isinstance(statement, Evaluation) and statement.acceleration == "a1"
    ]
    whole = any((one.position, one.velocity, one.state) == ("q1", "v1", "x1") for one in last)
    assert method.solves or whole or {Trait.VELOCITY_DEPENDENT, Trait.COUPLED_STATES} <= set(method.refuses)


@pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")
@pytest.mark.parametrize("name", ["euler_cromer", "velocity_verlet", "rk4"])
def test_a_march_blows_up_beyond_the_limit_only(name: str) -> None:
    """Assert that marches of an oscillator stay bounded just below the limit, and not above it."""
    limit = oscillator_limit(xd.METHODS[name]) / 2.0  # w = 2 s-1
    runs = [xd.simulate(oscillator().model, method=name, step=limit * part, until=400.0) for part in (0.99, 1.05)]
    below, above = (float(np.abs(run.x).max()) for run in runs)
    assert below < 50.0
    assert above > 1e4


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=list(xd.METHODS))
def test_a_mode_grows_right_beyond_the_limit_and_nowhere_before(method: Method) -> None:
    """Assert the size of the factors on both sides of the limit, from 1e-3 of it on."""
    limit = oscillator_limit(method)
    steps = np.linspace(0.001, 0.9999, 3000) * (limit if 0.0 < limit < math.inf else 1.0)
    growth = (
        np.abs(
            amplification_factors(amplification(method, OSCILLATOR, np.append(steps, 1.0001 * min(limit, 10.0))))
        ).max(axis=1)
        - 1.0
    )
    assert (growth[:-1] <= 1e-11).all() == (limit > 0.0)
    assert limit in (0.0, math.inf) or growth[-1] > 1e-9


def test_runge_kutta_methods_treat_all_vectors_alike() -> None:
    """Assert that the shortcut by single eigenvalues is taken where it holds, and only there."""
    alike = [name for name, (method, *_) in LIMITS.items() if treats_alike(method)]
    assert alike == ["forward_euler", "midpoint", "rk4", "implicit_midpoint", "backward_euler", "theta_quarter"]


def test_the_scaling_of_time_is_exact() -> None:
    """Assert that a system in other units of time is amplified alike at the same h over its time scale."""
    slow, fast = (LinearSystem.from_jacobian(np.array([[0.0, 1.0], [-w * w, -0.2 * w]]), 1) for w in (0.5, 512.0))
    assert fast.fastest == 1024.0 * slow.fastest
    method = xd.METHODS["euler_cromer"]
    assert (amplification(method, slow, np.array([0.7])) == amplification(method, fast, np.array([0.7]))).all()


@pytest.mark.parametrize(
    ("name", "step"),
    [("forward_euler", 0.04), ("euler_cromer", math.sqrt(4.0016) - 0.04), ("velocity_verlet", math.nan)],
)
def test_a_damped_oscillator_has_its_closed_form(name: str, step: float) -> None:
    """Assert h = c/k for Euler, the root of k h**2 + 2 c h - 4 for Euler-Cromer; k = 1 s-2 and c = 0.04 s-1."""
    model = particle("-(2*x + 0.08*v_x*second)*newton/metre")
    assert stable_step(model, xd.METHODS[name], initial_state(model)) == pytest.approx(step, rel=1e-8, nan_ok=True)


@pytest.mark.parametrize("name", ["euler_cromer", "averaged_velocity", "implicit_velocity_verlet", "rk4"])
@pytest.mark.parametrize("growth", [0.0, 1e-3])
@pytest.mark.parametrize("lowest", [0.2, 0.0, -0.3])
def test_modes_that_are_damped_apart_have_the_step_of_the_whole(
    name: str, growth: float, lowest: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert the limit of all at once, for damping by mass and by stiffness, of which a mode is free or grows, too."""
    random = np.random.default_rng(5)
    root = np.sqrt(random.uniform(0.5, 2.0, 4))
    turned = np.linalg.qr(random.normal(size=(4, 4)))[0]
    stiffness = (turned * [lowest, 1.0, 2.5, 7.0]) @ turned.T * root / root[:, None]
    jacobian = np.block([[np.zeros((4, 4)), np.eye(4)], [-stiffness, -0.05 * np.eye(4) - 0.02 * stiffness]])
    system, method = LinearSystem.from_jacobian(jacobian, 4), xd.METHODS[name]
    assert system.modes is not None
    apart, together = (np.sort_complex(1j * one.eigenvalues.ravel()) for one in (system.modes, system))
    assert apart == pytest.approx(together, abs=1e-12)
    step = largest_step(method, system, growth)
    monkeypatch.setattr(LinearSystem, "modes", None)
    whole = LinearSystem.from_jacobian(jacobian, 4)  # another, as the first one keeps its modes
    assert whole.modes is None
    assert step == pytest.approx(largest_step(method, whole, growth), rel=1e-8)


def test_damping_that_joins_modes_keeps_them_together() -> None:
    """Assert that a damper at one end, and gyroscopic forces, leave no systems of one coordinate."""
    stiffness = np.array([[2.0, -1.0], [-1.0, 2.0]])
    for damping in (np.diag([0.1, 0.0]), np.array([[0.0, 0.3], [-0.3, 0.0]])):
        assert (
            LinearSystem.from_jacobian(np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]]), 2).modes
            is None
        )


@pytest.mark.parametrize("masses", [2, 15])
@pytest.mark.parametrize("fixed", [True, False])
@pytest.mark.parametrize("name", ["velocity_verlet", "euler_cromer", "midpoint"])
def test_the_fastest_mode_of_a_chain_sets_the_step(name: str, masses: int, fixed: bool) -> None:
    """Assert limit/w of the shortest wave, with and without a mode at rest; w = 2 sin(pi k/(2(N + 1))) or /(2N)."""
    model, method = chain(masses, fixed=fixed), xd.METHODS[name]
    waves = masses / (masses + 1) if fixed else (masses - 1) / masses
    expected = oscillator_limit(method) / (2.0 * math.sin(math.pi / 2.0 * waves))
    assert stable_step(model, method, initial_state(model)) == pytest.approx(expected, rel=1e-9)


def test_growth_that_is_let_pass_makes_a_step_usable() -> None:
    """Assert that forward Euler grows by w**2 h/2: a rate of 1/(100 s) allows h = 0.005 s where w = 2 s-1."""
    model, method = oscillator().model, xd.METHODS["forward_euler"]
    assert stable_step(model, method, initial_state(model)) == 0.0
    assert stable_step(model, method, initial_state(model), growth=0.01) == pytest.approx(0.005, rel=1e-4)


def test_growth_of_the_model_is_no_instability() -> None:
    """Assert that a pendulum standing on its head bears every step of the implicit midpoint rule, Verlet's too."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml").replace(initial={"theta": "180 degree"})
    for method in (made(IMPLICIT_MIDPOINT), xd.METHODS["velocity_verlet"]):
        assert stable_step(model, method, initial_state(model)) == math.inf


def test_a_falling_mode_with_drag_may_fall() -> None:
    """Assert that where whole steps are looked at the mode that grows in the model is left out: q'' = q - 0.04 v."""
    model = particle("(2*x - 0.08*v_x*second)*newton/metre")
    assert stable_step(model, xd.METHODS["euler_cromer"], initial_state(model)) == math.inf


def test_an_oscillation_that_grows_by_itself_is_held_to_its_frequency() -> None:
    """Assert 2/Im(l) for a double pendulum let go from high up, whose four eigenvalues spiral out and in."""
    model = xd.Model.from_toml(MODELS / "double_pendulum.toml")
    state = initial_state(model)
    frequency = np.linalg.eigvals(linearise(model, state).jacobian).imag.max()
    assert stable_step(model, xd.METHODS["euler_cromer"], state) == pytest.approx(2.0 / frequency, rel=1e-9)


def test_a_fast_decay_at_the_edge_is_stiff() -> None:
    """Assert the fraction of rows whose step is held by the decay: 1/tau = 1000 s-1, of four rows two at 2 tau."""
    model = particle("-2000*v_x*newton*second/metre")
    states = [initial_state(model)] * 5
    assert stiffness(model, xd.METHODS["forward_euler"], states, [0.0, 1e-4, 2e-3, 1.8e-3, 1e-2]) == 0.5
    assert stiffness(model, made(IMPLICIT_MIDPOINT), states, [2e-3] * 5) == 0.0


def chain(masses: int, *, fixed: bool) -> xd.Model:
    """Masses of 1 kg and springs of 1 N/m between them, and between two walls if fixed."""
    names = [f"q{i}" for i in range(masses)]
    springs = [f"k*({b} - {a})**2/2" for a, b in pairwise(names)]
    springs += [f"k*{names[0]}**2/2", f"k*{names[-1]}**2/2"] if fixed else []
    return xd.Model(
        name="chain",
        coordinates=dict.fromkeys(names, "m"),
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass=dict.fromkeys(names, "m"),
        forces={f"spring{i}": {"potential": spring} for i, spring in enumerate(springs)},
        initial=dict.fromkeys(names, "0 m") | {f"v_{name}": "0 m s-1" for name in names},
    )


ROW = """
name = "row"
[dimensions]
site = {}
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[mass]
u = "kilogram*(1 + index(site))"
[forces.springs]
potential = "0.5*newton/metre*(u - shift(u, site, 1, 0*u))**2"
[initial]
u = {{ unit = "m", value = 0.1 }}
"""


def test_the_limit_of_a_model_with_dimensions_is_found_by_differences() -> None:
    """Assert that it is that of exact derivatives, and that a record tells where it was not looked for."""
    small, large = (xd.Model.from_text(ROW.format(n)) for n in (20, 121))
    exact = stable_step(small, xd.METHODS["velocity_verlet"], initial_state(small))
    for step, warned in ((0.999 * exact, False), (1.001 * exact, True)):
        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            record = xd.simulate(small, method="velocity_verlet", step=step, until="10 s")
        assert bool(seen) == warned
        assert "solver_stability_rule" not in record.attrs
    record = xd.simulate(large, method="velocity_verlet", step="10 ms", until="1 s")
    assert record.attrs["solver_stability_rule"] == "not looked at: the state has more than 240 numbers"


WARMED = """
name = "masses that warm"
[dimensions]
site = 24
[coordinates]
u = {{ unit = "m", dims = ["site"] }}
[states]
q = {{ unit = "1", dims = ["site"], rate = "(u**2/metre**2 - q)/second" }}
[mass]
u = "1*kilogram"
[forces.springs]
u = "-{}*newton/metre*(1 + q)*(u - 0.3*roll(u, site, 1))"
[initial]
u = {{ unit = "m", value = 0.1 }}
q = 0.2
"""


@pytest.mark.parametrize(("stiffness", "warned"), [(1, False), (1000, True)])
def test_a_step_that_is_stable_is_looked_at_alone(
    stiffness: int, warned: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that the limit of many masses with states is looked for, by hundreds of matrices, where errors grow at the step."""
    looked = []

    def counted(matrices: np.ndarray) -> np.ndarray:
        looked.extend(matrix for matrix in matrices if len(matrix) == 3 * 24)
        return amplification_factors(matrices)

    monkeypatch.setattr(limits, "amplification_factors", counted)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        xd.simulate(
            xd.Model.from_text(WARMED.format(stiffness)), method="implicit_velocity_verlet", step="0.3 s", until="0.3 s"
        )
    assert [str(one.message)[:41] for one in seen] == ["step 0.3 s is beyond the stability limit "] * warned
    assert len(looked) > 20 if warned else len(looked) == 1


@pytest.mark.parametrize("edge", [1.0, math.pi / 2.0, 1.999])
def test_halvings_at_once_are_halvings(edge: float) -> None:
    """Assert the bracket that halving one by one gives, bit for bit, in a quarter of the calls."""
    calls = []

    def growth(steps: np.ndarray) -> np.ndarray:
        calls.append(steps.size)
        return steps / edge

    low, high = 0.9, 2.1
    while high - low > 1e-13 * high:
        middle = (low + high) / 2.0
        low, high = (low, middle) if middle / edge > 1.0 else (middle, high)
    assert limits._bisect_bracket(growth, 0.9, 2.1) == (low, high)  # no public name shows the bits of a bracket
    assert len(calls) <= 12


def test_the_bound_on_rates_is_the_squared_matrix() -> None:
    """Assert the root of its largest row sum, of matrices with few entries (also rows of none) and with many, and not less than any eigenvalue."""
    random = np.random.default_rng(5)
    for n, filled in ((1, 1.0), (6, 0.3), (40, 0.05), (40, 0.9)):
        matrix = random.normal(size=(n, n)) * (random.random((n, n)) < filled)
        for row in range(n):  # each in turn the largest
            large = np.where(np.arange(n)[:, None] == row, 100.0 * matrix, matrix)
            wanted = np.sqrt(np.abs(large @ large).sum(axis=1).max())
            assert limits.fastest_rate(large) == pytest.approx(wanted, rel=1e-13, abs=0.0)
        bound = limits.fastest_rate(matrix)
        assert bound >= np.abs(np.linalg.eigvals(matrix)).max(initial=0.0) * (1.0 - 1e-12)
    assert limits.fastest_rate(np.zeros((3, 3))) == limits.fastest_rate(np.zeros((0, 0))) == 0.0
