"""Scripts as people write them for scipy's solve_ivp: each gives scipy's numbers, or a sentence that names the remedy."""

from __future__ import annotations

import inspect
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint, solve_ivp

import xdynamics as xd
from cases import scipy_scripts as scripts

BODIES = [0.97, -0.243, -0.97, 0.243, 0.0, 0.0, 0.466, 0.432, 0.466, 0.432, -0.932, -0.865]
BUMP = np.exp(-((np.arange(9) - 4.0) ** 2))
SCRIPTS: dict[str, dict[str, Any]] = {
    "exponential_decay": {"t": [0, 10], "y0": [2, 4, 8]},
    "upward_cannon": {"t": [0, 100], "y0": [0, 10], "events": (scripts.hit_ground, scripts.apex), "dense_output": True},
    "lotkavolterra": {"t": [0, 5], "y0": [10, 5], "args": (1.5, 1, 3, 1), "dense_output": True},
    "deriv_vec": {"t": (0, 5), "y0": np.array([10.0, 20.0, 30.0]), "vectorized": True},
    "pend": {"t": [0, 5], "y0": [np.pi - 0.1, 0.0], "args": (0.25, 5.0)},
    "lorenz": {"t": (0, 2), "y0": (0.0, 1.0, 1.05)},
    "rossler": {"t": (0, 5), "y0": [1, 1, 1], "args": (0.2, 0.2, 5.7), "max_step": np.inf},
    "vdp": {"t": [0, 20], "y0": [2, 0], "args": (50.0,), "method": "Radau"},
    "robertson": {"t": (0, 40), "y0": [1, 0, 0], "method": "Radau", "atol": 1e-10},
    "brusselator": {"t": (0, 5), "y0": [1.5, 3.0], "args": (1, 3), "method": "DOP853"},
    "sir": {"t": [0, 30], "y0": [999, 1, 0], "args": (1000, 0.4, 0.1)},
    "fitzhugh": {"t": (0, 30), "y0": [-1, 1]},
    "double_pendulum": {"t": (0, 1), "y0": [2.0, 0, 1.0, 0], "first_step": None},
    "double_pendulum_matrix": {"t": (0, 1), "y0": [1.0, 0.5, 0, 0]},
    "kepler": {"t": (0, 6), "y0": [1, 0, 0, 1.2], "method": "DOP853"},
    "cannonball": {"t": (0, 100), "y0": [0, 20, 1e-3, 30], "events": scripts.landed},
    "coupled_springs": {"t": (0, 3), "y0": [1.0, 0, 0, 0, 0, 0], "args": (3,)},
    "heat_loop": {"t": (0, 0.5), "y0": BUMP, "method": "Radau"},
    "heat_slices": {"t": (0, 1), "y0": BUMP, "jac": lambda t, y: None},  # noqa: ARG005 - scipy's
    "advection_roll": {"t": (0, 2), "y0": BUMP},
    "gray_scott": {"t": (0, 5), "y0": np.r_[1 - BUMP, BUMP]},
    "kuramoto": {"t": (0, 5), "y0": [0.0, 1, 2, 3, 4], "args": (1.5,)},
    "three_bodies": {"t": (0, 1), "y0": BODIES, "args": ([1.0, 1.0, 1.0],)},
    "three_bodies_broadcast": {"t": (0, 1), "y0": BODIES},
    "predator_where": {"t": (0, 8), "y0": [0.2, 0.5], "knots": 400},
    "chirped": {"t": (0, 3), "y0": [0, 0], "knots": 300},
    "force_curve": {"t": (0, 5), "y0": [1.5, 0], "knots": 400},
    "saturated": {"t": (0, 4), "y0": [2.0, 0], "knots": 400},
    "step_input": {"t": (0, 2), "y0": [0.0], "knots": 200},
    "square_wave": {"t": (0, 2), "y0": [0.0], "knots": 200},
    "dosing": {"t": (0, 4), "y0": [1.0], "knots": 400},
    "branching": {"t": (0, 2), "y0": [2.0], "knots": 400},
    "relu": {"t": (0, 5), "y0": [1.5, 2.0], "knots": 400},
    "diode": {"t": (0, 2), "y0": [0.0]},
    "decades": {"t": (0, 2), "y0": [1.0, 2.0]},
    "motor.rhs": {"t": (0, 3), "y0": [1.0, 0.0]},
    "linear_system": {"t": (0, 4), "y0": [1, 0, 0], "args": (scripts.A3, np.array([0.0, 0.0, 1.0]))},
    "thermostat_a": {"t": (0, 5), "y0": [15.0], "knots": 500},
}
REFUSED = {
    "odeint_style": (
        {"args": (1.0,)},
        "y before t, as odeint takes it; .* write xd.solve.lambda t, y, .args: odeint_style.y, t, .args.",
    ),
    "transformed": ({}, "calls numpy.fft.*; write it with arithmetic, sums and numpy's elementary functions"),
    "backwards": ({}, r"goes back, from 2 to 1 s, .*; integrate -f over the mirrored span: xd.solve.*-2, -1"),
}


def script(name: str) -> Any:
    """The function of a script, or the method of an object."""
    head, _, method = name.partition(".")
    return getattr(getattr(scripts, head), method) if method else getattr(scripts, head)


def test_as_many_scripts_as_were_collected() -> None:
    """Assert that 38 that differ run, and three more are told what to write."""
    texts = {inspect.getsource(script(name)) for name in SCRIPTS}
    assert len(texts) == 38
    assert len(REFUSED) == 3


@pytest.mark.every(5)
@pytest.mark.parametrize("name", SCRIPTS)
def test_scripts_give_scipys_numbers(name: str) -> None:
    """Assert the state at the end, and events, against solve_ivp at its tightest."""
    fun = script(name)
    asked = dict(SCRIPTS[name])
    span, y0, knots = asked.pop("t"), asked.pop("y0"), asked.pop("knots", 0)
    solution = xd.solve(fun, span, y0, rtol=1e-8, **{"atol": 1e-10} | asked).dynamics.solution
    own = {key: asked[key] for key in ("args", "events") if key in asked}
    expected = scipys(fun, span, y0, knots, asked.get("method", "DOP853"), own)
    assert solution.status == expected.status, solution.message
    assert solution.y[:, -1] == pytest.approx(expected.y[:, -1], rel=1e-5, abs=2e-6)
    for times, right in zip(solution.t_events, expected.t_events or (), strict=False):
        assert times == pytest.approx(right[right > 0], rel=1e-7)


def scipys(fun: Any, span: Any, y0: Any, knots: int, method: str, own: dict[str, Any]) -> Any:
    """Return scipy's own solution; of what has kinks and jumps by small steps, which bound what it steps over."""
    step = {"max_step": (span[1] - span[0]) / knots} if knots else {}
    return solve_ivp(fun, span, y0, method, rtol=1e-10, atol=1e-12, **own, **step)


@pytest.mark.parametrize("name", REFUSED)
def test_others_are_told_what_to_write(name: str) -> None:
    """Assert the remedy in the sentence."""
    given, said = REFUSED[name]
    span = (2, 1) if name == "backwards" else (0, 1)
    with pytest.raises(xd.InputError, match=said):
        xd.solve(getattr(scripts, name, scripts.exponential_decay), span, [1.0], **given)


def test_the_remedies_work() -> None:
    """Assert that what the sentences say to write gives odeint's numbers, and those of a span that goes back."""
    run = xd.solve(lambda t, y, *args: scripts.odeint_style(y, t, *args), (0, 1), [2.0], args=(0.5,), rtol=1e-9)
    assert float(run.y0[-1]) == pytest.approx(odeint(scripts.odeint_style, [2.0], [0, 1], (0.5,))[-1, 0], rel=1e-6)
    back = xd.solve(lambda t, y: -np.asarray(scripts.exponential_decay(-t, y)), (-2, -1), [1.0], rtol=1e-9)
    assert float(back.y0[-1]) == pytest.approx(np.exp(0.5), rel=1e-8)


def test_functions_without_a_module() -> None:
    """Assert that what `exec` made, as a notebook may, is solved."""
    scope: dict[str, Any] = {}
    exec("import math\nfun = lambda t, y: [-math.tanh(y[0])]", scope)
    scope["fun"].__module__ = None
    assert xd.solve(scope["fun"], (0, 1), [1.0], rtol=1e-6).attrs["run_outcome"] == "completed"
