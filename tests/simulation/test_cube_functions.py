# ruff: noqa: ARG001
"""Right-hand sides that join bodies by pairs, sum along an axis, or have three axes: one expression, in loops."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd
from xdynamics.expressions import text_of
from xdynamics.model.switches import are_too_many, jumping_switches
from xdynamics.simulation.scipy_interface import model_of_function

BODIES = 54  # 324 numbers, more than are written out one by one
KNOWN = np.cos(np.arange(324.0).reshape(18, 18) ** 2)
MASSES = np.linspace(0.5, 1.5, BODIES)


def bodies(t: Any, y: Any) -> Any:
    """All pairs by broadcasting, in three dimensions."""
    x, v = y[: 3 * BODIES].reshape(BODIES, 3), y[3 * BODIES :].reshape(-1, 3)
    apart = x[None, :, :] - x[:, None, :]
    square = (apart**2).sum(axis=-1) + 0.1
    pull = (MASSES[None, :, None] * apart / square[..., None] ** 1.5).sum(axis=1)
    return np.concatenate([v.ravel(), pull.ravel()])


def vortices(t: Any, y: Any) -> Any:
    """Rows of x and of y, pairs by new axes, a norm along one, results stacked."""
    x, z = y.reshape(2, -1)
    apart = np.stack([x[:, None] - x, z[:, None] - z], axis=-1)
    square = np.linalg.norm(apart, axis=2) ** 2 + 0.05
    return np.vstack([-(apart[..., 1] / square).sum(axis=1), np.sum(apart[..., 0] / square, 1)]).ravel() / 200


def oscillators(t: Any, theta: Any, k: Any) -> Any:
    """Kuramoto's phases, each drawn by the mean of all."""
    return np.linspace(0.1, 0.5, 310) + k * np.sin(theta[None, :] - theta[:, None]).mean(axis=1)


def bands(t: Any, y: Any) -> Any:
    """Means along either axis, kept and put back; columns rolled; a drive."""
    u = y.reshape(16, 24)
    d = -0.1 * (u - u.mean(axis=1, keepdims=True)) - 0.2 * u.mean(axis=0) + np.roll(u, 2, axis=1) - u
    d[3:5, 1:-1] += np.sin(t) * u.T[1:-1, 3:5].T.sum(0)
    return d.reshape(-1)


def block(t: Any, y: Any) -> Any:
    """Diffusion in three dimensions, each with edges of its own."""
    u = y.reshape(6, 7, 8)
    d = np.zeros_like(u)
    d[1:-1] += u[2:] - 2 * u[1:-1] + u[:-2]
    d[:, 1:] -= np.diff(u, axis=1)
    d[:, :, 0] = 0.1 * (u.max() - u.min()) * 0 - u[..., 0]
    return np.transpose(d, (0, 1, 2)).ravel()


def picked(t: Any, y: Any) -> Any:
    """Columns by a list that is no slice, rows by a mask and by `take`, some of them twice."""
    u = y.reshape(16, 21)
    shares = u[:, [4, 0, 1, 2, 20, 20, 5]].sum(axis=1) - u[np.arange(16) % 5 == 2].mean()
    return (np.take(u, [*range(1, 16), 0], axis=0) - u + shares[:, None] / 10).ravel()


def products(t: Any, y: Any) -> Any:
    """Products of matrices, known and not, by letters and by operators; a trace, a dyad."""
    u = y.reshape(18, 18)
    turned = np.einsum("ij,kj->ik", KNOWN, u) + 0.1 * KNOWN @ u @ u - np.tensordot(u, KNOWN, axes=([0], [1]))
    return (turned / 9 - np.trace(u) * np.outer(u[0], np.einsum("ii->i", u)) / 50).ravel()


def waves(n: int) -> Any:
    """Return numbers between -1 and 1, no two alike."""
    return np.sin(np.arange(n) ** 2 + 1.0)


CASES: dict[str, tuple[Any, Any, tuple[float, ...]]] = {
    "bodies": (bodies, waves(6 * BODIES), ()),
    "vortices": (vortices, waves(320), ()),
    "oscillators": (oscillators, 3 * waves(310), (0.7,)),
    "bands": (bands, waves(384), ()),
    "block": (block, waves(336), ()),
    "picked": (picked, waves(336), ()),
    "products": (products, waves(324), ()),
}


@pytest.mark.every(5)
@pytest.mark.parametrize("name", CASES)
def test_cubes_have_scipys_numbers(name: str) -> None:
    """Assert one variable along y_index, an expression whose length no number of elements is in, and scipy's state."""
    fun, y0, args = CASES[name]
    model = model_of_function(fun, (0, 0.2), y0, args, None, None, None)
    assert [*model.statement.states] == ["y"]
    assert len(text_of(model.statement.states["y"].rate)) < 3000
    how = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "args": args}
    run = xd.solve(fun, (0, 0.2), y0, **how)
    right = solve_ivp(fun, (0, 0.2), y0, **how)
    last = run.y.values[-1]
    assert last == pytest.approx(right.y[:, -1], rel=1e-9, abs=1e-10)


def test_the_largest_of_a_row_is_one_loop() -> None:
    """Assert that numbers that decay by their largest follow the closed form, and that few of their switches are made.

    Each of 400 has a switch for each of the other 399 in its rate; none is located.
    """

    def decay(t: Any, y: Any) -> Any:
        return -y * y.max()

    y0 = 2.0 + waves(400)
    model = model_of_function(decay, (0, 2), y0, (), None, None, None)
    assert are_too_many(model)
    assert dict.__len__(model.elements.statement.states) == 1
    assert jumping_switches(model) == ()
    with pytest.warns(xd.AccuracyWarning, match=r"over 100 switches are hidden in 'y' \(abs"):
        run = xd.solve(decay, (0, 2), y0, rtol=1e-10, atol=1e-13)
    assert run.y.values[-1] == pytest.approx(y0 / (1 + 2 * y0.max()), rel=1e-9)


def test_elements_that_are_not_there_are_refused() -> None:
    """Assert that a list that goes beyond the end is refused in numpy's own words."""

    def wrong(t: Any, y: Any) -> Any:
        return (y.reshape(18, 18)[:, [0, 3, 18]].sum() + y).ravel()

    with pytest.raises(xd.InputError, match="index 18 is out of bounds for axis 1 with size 18"):
        model_of_function(wrong, (0, 1), waves(324), (), None, None, None)


def test_pairs_are_as_long_for_any_number() -> None:
    """Assert that three times as many bodies have an expression as long, in a model that is read from its own text."""
    texts = []
    for count in (60, 120):

        def pairs(t: Any, y: Any, count: int = count) -> Any:
            x, v = y.reshape(2, count, 3)
            apart = x[None] - x[:, None]
            return np.array([v, (apart / (1 + (apart**2).sum(-1, keepdims=True))).sum(1)]).ravel()

        model = model_of_function(pairs, (0, 1), waves(6 * count), (), None, None, None)
        texts.append(text_of(model.statement.states["y"].rate))
    assert len(texts[1]) < len(texts[0]) + 30
    assert len(texts[0]) < 1500
    assert xd.Model.from_text(model.to_toml()) == model


@pytest.mark.dear
def test_an_event_of_an_array() -> None:
    """Assert that an event may sum along axes too: the time at which the mean of a decaying field passes a level."""

    def decay(t: Any, y: Any) -> Any:
        return (-y.reshape(4, 80, 1).sum(axis=2)).ravel()

    def half(t: Any, y: Any) -> Any:
        return y.reshape(8, -1).mean(axis=1).mean() - 0.5

    run = xd.solve(decay, (0, 1), np.full(320, 1.0) + 0.1 * waves(320), "DOP853", rtol=1e-10, atol=1e-12, events=half)
    start = np.mean(1.0 + 0.1 * waves(320))
    assert run.event_time.values == pytest.approx([np.log(2 * start)], abs=1e-9)
