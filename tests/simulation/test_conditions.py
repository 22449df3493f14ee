"""Conditions, tables with ends and first steps of right-hand sides, as scipy's users write them, against scipy."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline, interp1d

import xdynamics as xd

TIMES = np.linspace(0.0, 5.0, 11)
FORCES = np.cos(TIMES)
FINE: dict[str, Any] = {"rtol": 1e-9, "atol": 1e-11}


def masked(t: Any, x: Any) -> Any:
    """Set in place what a condition chooses."""
    row = -x
    row[(x > 0) & (t > 1)] = 0.1
    return row[0] + row[1]


@pytest.mark.every(7)
@pytest.mark.parametrize(
    "pull",
    [
        lambda t, x: np.interp(t, TIMES, FORCES, left=0.5, right=-1.0) - x,
        lambda t, x: np.interp(t, TIMES, FORCES, right=0.0) - x,
        lambda _, x: np.interp(x, [-1, 0, 1], [1, 0, -1], left=5, right=-5),
        lambda t, x: np.interp(t, [0, 1, 2, 4], [0, 1, -1, 0.5], period=5) - x,
        lambda t, x: np.interp(t, [4, 0, 2, 1], [0.5, 0, -1, 1], period=-5) - x,
        lambda t, x: np.where((x > 0) & (t > 1), -x, 0.1),
        lambda t, x: np.where((x < 0) | (t > 1), -x, -0.1),
        lambda t, x: np.where(~((x < 0) | (t > 1)), -x, 0.1),
        lambda t, x: np.where(np.logical_or(np.logical_not(t > 1), x > 2), -x, 0.1),
        lambda t, x: -x * (t > 1),
        lambda t, x: -1.0 * (x > 0) - 0.5 * (t > 1),
        lambda t, x: np.where((t > 1) & True, -x, 0.0),
        lambda t, x: masked(t, np.array([x, -x])),
    ],
)
def test_conditions_and_ends_of_tables_are_scipys(pull: Callable[..., Any]) -> None:
    """Assert the state at the end, against scipy landing by small steps on what jumps."""
    at_jumps = [-0.5, 0.0, 1.0, 5.0, 6.0]
    right = np.array([1.3, 0.0])
    for begin, end in pairwise(at_jumps):
        span = (np.nextafter(begin, end), np.nextafter(end, begin))
        right = solve_ivp(lambda t, y: [y[1], pull(t, y[0])], span, right, "DOP853", max_step=0.02, **FINE).y[:, -1]
    run = xd.solve(lambda t, y: [y[1], pull(t, y[0])], (-0.5, 6.0), [1.3, 0.0], "DOP853", **FINE)
    assert run.dynamics.solution.y[:, -1] == pytest.approx(right, abs=2e-4)


def test_a_first_step_is_not_a_fixed_one() -> None:
    """Assert that steps grow from the first one, and stay below the largest, without tolerances too."""
    for settings, most in (
        ({"first_step": 1e-3}, np.inf),
        ({"max_step": 0.1}, 0.1),
        ({"max_step": 0.1, "first_step": 0.01}, 0.1),
    ):
        run = xd.solve(lambda _t, y: [y[1], -y[0]], (0, 4), [1, 0], **settings)
        steps = np.diff(run.time.values)
        assert steps[0] == pytest.approx(settings.get("first_step", steps[0]), rel=1e-12)
        assert 5.0 * steps[0] < steps.max() or "first_step" not in settings
        assert steps.max() <= most * (1.0 + 1e-12)
        assert float(run.y0[-1]) == pytest.approx(np.cos(4.0), abs=5e-6)


@pytest.mark.parametrize(
    ("pull", "said"),
    [
        (lambda _, x: np.where(x & 1, 1, 0), r"joins by & what is no comparison; put each in parentheses: \(a > 0\)"),
        (lambda _, x: np.where(~x, 1, 0), "takes ~ of what is no comparison"),
        (lambda t, _: np.interp(t, TIMES, FORCES, period=0), "period = 0, needs another number"),
        (
            lambda t, _: CubicSpline(TIMES, FORCES)(t),
            r"numpy.interp\(t, x, y\) in the place of an interpolator of scipy",
        ),
        (lambda t, _: interp1d(TIMES, FORCES)(t), r"numpy.interp\(t, x, y\) in the place of an interpolator of scipy"),
    ],
)
def test_what_cannot_be_written_down_is_named(pull: Callable[..., Any], said: str) -> None:
    """Assert one clear error for each, with what to write."""
    with pytest.raises(xd.InputError, match=said):
        xd.solve(lambda t, y: [y[1], pull(t, y[0])], (0, 1), [1, 0])
