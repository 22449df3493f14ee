"""Steps that methods bear, against their stability functions in closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest

import xdynamics as xd
from problems import MODELS, oscillator, particle
from xdynamics.methods import Evaluation, Method
from xdynamics.methods.amplification import LinearSystem, amplification
from xdynamics.methods.method import spread
from xdynamics.methods.stability import OSCILLATOR, decay_limit, oscillator_limit, stable_step, stiffness, treats_alike
from xdynamics.model import Trait
from xdynamics.model.linearisation import initial_state

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
THETA = """
    solve y1:
        k1 = f(t1, y1)
        y1 = y + h*({theta}*k1 + (1 - {theta})*k)
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
    lines = ["solve v1, x1:", "    q1 = q + h*(W*v1 + (1 - W)*v)", "    a1, r1 = f(t1, q1, v1, x1)",
             "    v1 = v + h*(W*a1 + (1 - W)*a)", "    x1 = x + h*(W*r1 + (1 - W)*r)"]  # fmt: skip
    return made("\n".join(lines).replace("W", repr(weight)))


LIMITS = {
    "forward_euler": (xd.METHODS["forward_euler"], 0.0, 2.0),
    "euler_cromer": (xd.METHODS["euler_cromer"], 2.0, 2.0),
    "velocity_verlet": (xd.METHODS["velocity_verlet"], 2.0, math.nan),
    "midpoint": (xd.METHODS["midpoint"], 0.0, 2.0),
    "rk4": (made(spread(RK4)), math.sqrt(8.0), 2.785293563405282),
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


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=str)
def test_a_step_is_the_power_series_of_the_flow(method: Method) -> None:
    """Assert that one step differs from the exact rotation by O(h**(order + 1))."""
    h = np.array([0.2, 0.1])
    exact = np.array([[[math.cos(z), math.sin(z)], [-math.sin(z), math.cos(z)]] for z in h])
    error = np.abs(amplification(method, OSCILLATOR, h) - exact).max(axis=(1, 2))
    assert error[0] < 1e-14 or error[0] / error[1] > 2.0 ** (method.order + 0.7) or error[0] < 2e-13


@pytest.mark.parametrize("method", xd.METHODS.values(), ids=str)
def test_a_step_ends_with_the_forces_of_its_end(method: Method) -> None:
    """Assert what the amplification needs: a1 and r1 at the end, or no forces that would tell."""
    last = [one for one in method.statements if isinstance(one, Evaluation) and one.acceleration == "a1"]
    whole = any((one.position, one.velocity, one.state) == ("q1", "v1", "x1") for one in last)
    assert method.implicit or whole or {Trait.VELOCITY_DEPENDENT, Trait.COUPLED_STATES} <= set(method.refuses)


@pytest.mark.parametrize("name", [name for name in LIMITS if 0.0 < LIMITS[name][1] < math.inf])
def test_a_march_blows_up_beyond_the_limit_only(name: str) -> None:
    """Assert that marches of an oscillator stay bounded just below the limit, and not above it."""
    if name not in xd.METHODS:
        pytest.skip("not registered")
    limit = oscillator_limit(xd.METHODS[name]) / 2.0  # w = 2 s-1
    ends = [np.abs(xd.simulate(oscillator().model, method=name, step=limit * part, until=200.0).x).max() for part in (0.99, 1.05)]  # fmt: skip
    assert ends[0] < 50.0
    assert ends[1] > 1e6


def test_runge_kutta_methods_treat_all_vectors_alike() -> None:
    """Assert that the shortcut by single eigenvalues is taken where it holds, and only there."""
    alike = [name for name, (method, *_) in LIMITS.items() if treats_alike(method)]
    assert alike == ["forward_euler", "midpoint", "rk4", "implicit_midpoint", "backward_euler", "theta_quarter"]


def test_the_scaling_of_time_is_exact() -> None:
    """Assert that a system in other units of time is amplified alike at the same h over its time scale."""
    slow, fast = (LinearSystem.of(np.array([[0.0, 1.0], [-w * w, -0.2 * w]]), 1) for w in (0.5, 512.0))
    assert fast.fastest == 1024.0 * slow.fastest
    method = xd.METHODS["euler_cromer"]
    assert (amplification(method, slow, np.array([0.7])) == amplification(method, fast, np.array([0.7]))).all()


@pytest.mark.parametrize(
    ("name", "step"),
    [
        ("forward_euler", 0.04),
        ("euler_cromer", (-0.04 + math.sqrt(0.0016 + 16.0)) / 2.0),
        ("velocity_verlet", math.nan),
    ],
)
def test_a_damped_oscillator_has_its_closed_form(name: str, step: float) -> None:
    """Assert h = c/k for Euler, the root of k h**2 + 2 c h - 4 for Euler-Cromer; m = 1, k = 1 and c = 0.04."""
    model = damped("-4*x*newton/metre/2 - 0.08*v_x*newton*second/metre", x="2*newton")
    assert stable_step(model, xd.METHODS[name], initial_state(model)) == pytest.approx(step, rel=1e-8, nan_ok=True)


def damped(force: str, x: str) -> xd.Model:
    """A particle of 2 kg under a force."""
    return particle(force) if x else particle()
