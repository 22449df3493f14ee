# ruff: noqa: ARG001, ARG005 - functions of t and y, as scipy takes them
"""Functions written with arrays stay so: one state along a dimension, one expression, however many numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse
from scipy.integrate import solve_ivp

import xdynamics as xd
from cases import scipy_scripts as scripts
from xdynamics.expressions import text_of
from xdynamics.simulation.scipy_interface import model_of_function


def bump(n: int) -> Any:
    """A hill in a row of n numbers."""
    return np.exp(-(((np.arange(n) - n / 2) / (n / 10)) ** 2))


def heat(t: Any, u: Any) -> Any:
    """Slices, and ends by themselves."""
    d = np.zeros_like(u)
    d[1:-1] = u[2:] - 2 * u[1:-1] + u[:-2]
    d[0], d[-1] = u[1] - u[0], u[-2] - u[-1]
    return d


def advected(t: Any, u: Any) -> Any:
    """A ring."""
    return -(u - np.roll(u, 1)) - 0.1 * u * (np.roll(u, -2) + 1)


def two_fields(t: Any, y: Any) -> Any:
    """Two halves, which react."""
    n = len(y) // 2
    u, v = y[:n], y[n:]
    reaction = u * v**2
    return np.concatenate([0.16 * np.roll(u, 1) - reaction, 0.08 * np.roll(v, -1) + reaction - 0.1 * v])


def wave(t: Any, y: Any) -> Any:
    """Second differences."""
    u, v = y.reshape(2, -1)
    a = np.zeros(len(u))
    a[1:-1] = np.diff(u, 2)
    return np.hstack((v, a))


def burgers(t: Any, u: Any) -> Any:
    """Slopes, limits, choices."""
    return (
        -u * np.gradient(u, 0.5)
        + np.clip(np.where(u > 0.5, 0.5 - u, 0.0), -0.2, 0.2)
        + 0.1 * np.pad(u, 1, "edge")[1:-1]
    )


def mean_field(t: Any, theta: Any, K: Any) -> Any:
    """Sums over all, and a row of numbers."""
    return np.linspace(-1, 1, len(theta)) + K * (
        np.sin(theta).mean() * np.cos(theta) - np.mean(np.cos(theta)) * np.sin(theta)
    )


def shortened(t: Any, y: Any) -> Any:
    """A length, a largest number, a product of rows, part of a row."""
    return -y / np.linalg.norm(y) + 0.1 * np.max(y[2:]) - 0.01 * (y @ y) + y[:3].sum()


def chosen(t: Any, y: Any) -> Any:
    """Elements that conditions choose, set in place."""
    d = 0.2 - y
    d[(y > 0.4) & (y < 0.8)] = 0.05 * t
    d[~(y > -5) | (y > 0.9)] = 7.0
    return d


def chosen_of_plane(t: Any, y: Any) -> Any:
    """The same of two axes."""
    d = y.reshape(2, -1) / 9
    d[d > 0.06] = 0.5
    return d.ravel()


SECOND = np.eye(14, k=1) + np.eye(14, k=-1) - 2 * np.eye(14)
DENSE = np.random.default_rng(1).normal(size=(14, 14)) / 9
CASES: dict[str, tuple[Any, Any, tuple[Any, ...]]] = {
    "heat": (heat, bump(30), ()),
    "ring": (advected, bump(30), ()),
    "two fields": (two_fields, np.r_[bump(9), 1 - bump(9)], ()),
    "wave": (wave, np.r_[bump(12), 0 * bump(12)], ()),
    "burgers": (burgers, bump(20), ()),
    "mean field": (mean_field, np.linspace(0, 3, 15), (1.5,)),
    "shortened": (shortened, bump(12) + 1, ()),
    "chosen": (chosen, np.r_[np.linspace(0.5, 0.75, 12), 0.3, 0.95], ()),
    "chosen of a plane": (chosen_of_plane, np.linspace(0.3, 0.7, 14), ()),
    "diagonals": (lambda t, y, A: A @ y, bump(14), (SECOND,)),
    "sparse": (lambda t, y, A: A @ y, bump(14), (scipy.sparse.csr_matrix(SECOND),)),
    "dense": (lambda t, y: DENSE.dot(y), bump(14), ()),
    "powers": (
        lambda t, y: -(y**3) - y**2 / 9 + y**18 - y**19 + (y + 3.0) ** -2 - (y - 1.9) ** -18,
        np.linspace(-1, 1, 14),
        (),
    ),
    "turned round": (lambda t, y: -y * np.sum(np.arange(1.0, 15.0) * y[::-1]) / 99, bump(14) + 1, ()),
    "three bodies": (
        scripts.three_bodies_broadcast,
        [0.97, -0.243, -0.97, 0.243, 0, 0, 0.466, 0.432, 0.466, 0.432, -0.932, -0.865],
        (),
    ),
}


@pytest.mark.every(3)
@pytest.mark.filterwarnings("ignore:.*switches are hidden")  # one for each element
@pytest.mark.parametrize("name", CASES)
def test_rows_have_scipys_numbers(name: str) -> None:
    """Assert one variable along y_index, one expression of the model, and the state at the end."""
    fun, y0, args = CASES[name]
    run = xd.solve(fun, (0, 1), y0, "DOP853", args=args, rtol=1e-9, atol=1e-11, switches="stepped over", max_step=0.05)
    assert run.y.dims == ("step", "y_index")
    right = solve_ivp(fun, (0, 1), y0, "DOP853", args=args, rtol=1e-9, atol=1e-11, max_step=0.05)
    assert run.y.values[-1] == pytest.approx(right.y[:, -1], rel=1e-6, abs=1e-7)
    assert run.dynamics.solution.y.shape == (len(y0), run.sizes["step"])


@pytest.mark.parametrize("fun", [heat, advected, wave, chosen, chosen_of_plane])
def test_a_model_is_as_long_for_any_number(fun: Any) -> None:
    """Assert that the expression of a thousand numbers is that of forty."""
    models = [model_of_function(fun, (0, 1), bump(n), (), None, None, None) for n in (40, 1000)]
    rates = [text_of(model.statement.states["y"].rate) for model in models]
    assert len(rates[1]) < len(rates[0]) + 30


def test_events_units_and_names_of_rows() -> None:
    """Assert an event of elements, a unit, a name, and an archive that is one of a model with a dimension."""

    def cooled(t: Any, T: Any) -> Any:
        return T.max() - 40.0

    cooled.terminal = True  # type: ignore[attr-defined]
    run = xd.solve(
        lambda t, T: -0.5 * T, (0, 9), 80 * bump(12), "dop853", units="K", names="T", events=cooled, rtol=1e-9
    )
    assert (run.T.dims, run.T.attrs["units"]) == (("step", "T_index"), "K")
    assert float(run.event_time[0]) == pytest.approx(2 * np.log(2.0), rel=1e-8)
    again = xd.simulate(xd.Model.from_text(run.model_toml.item()), method="dop853", rtol=1e-9, until="9 s")
    assert np.array_equal(again.T, run.T)


@pytest.mark.dear
def test_what_is_no_row_is_written_out() -> None:
    """Assert views that are filled, elements by a list, loops, and numbers by name where a list is returned."""

    def filled(t: Any, y: Any) -> Any:
        d = np.zeros(12)
        first = d[:6]
        first[:] = y[6:]
        d[6:] = -y[[0, 1, 2, 5, 4, 3]]
        return d

    for fun in (filled, lambda t, y: np.array([y[i - 1] - y[i] for i in range(12)]), lambda t, y: -y[::-1][::-1]):
        run = xd.solve(fun, (0, 1), bump(12), "DOP853", rtol=1e-9)
        right = solve_ivp(fun, (0, 1), bump(12), "DOP853", rtol=1e-10, atol=1e-12)
        assert run.y.values[-1] == pytest.approx(right.y[:, -1], rel=1e-7, abs=1e-9)
    listed = xd.solve(lambda t, y: [-one for one in y], (0, 1), bump(12), rtol=1e-6)
    assert {"y0", "y11"} <= {*listed.data_vars}


def test_tolerances_and_events_of_another_length() -> None:
    """Assert that as many tolerances as numbers are taken, and no others; an event is one number."""
    run = xd.solve(heat, (0, 1), bump(12), atol=[1e-9] * 11 + [1e-7])
    assert run.y.attrs["units"] == "1"
    with pytest.raises(xd.InputError, match="atol has 3 numbers, and y0 12"):
        xd.solve(heat, (0, 1), bump(12), atol=[1e-9] * 3)
    with pytest.raises(xd.InputError, match="returns 12 numbers, needs one; write an event for each"):
        xd.solve(heat, (0, 1), bump(12), events=lambda t, y: y - 0.5)


@pytest.mark.parametrize(
    ("fun", "said"),
    [
        (lambda t, y: y[1:], "returns 11 rates, and y0 has 12 numbers"),
        (lambda t, y: y[12] * y, "index 12 is out of bounds"),
        (lambda t, y: y[1:] + y, "broadcast"),
        (lambda t, y: y * np.nan, "needs finite numbers"),
        (lambda t, y: np.fft.fft(y), "calls numpy.fft.fft, which"),
        (lambda t, y: np.sum(y, where=y > 0) * y, "numpy.sum with where, which"),
        (lambda t, y: np.subtract.reduceat(y, [0, 1]), "numpy.subtract.reduceat, which"),
        (lambda t, y: y[y > 0], r"is written np\.where\(condition, value, row\)"),
    ],
)
def test_faults_of_arrays_are_named(fun: Any, said: str) -> None:
    """Assert one sentence for each, with the module, the method and the options of what was called."""
    with pytest.raises(xd.InputError, match=said):
        xd.solve(fun, (0, 1), bump(12))


def test_a_shape_is_given_by_name() -> None:
    """Assert `np.zeros(shape=…)`, of a row and of a few numbers."""

    def decay(t: float, y: Any) -> Any:
        a = np.zeros(shape=len(y))
        a[:] = -y
        return a

    assert xd.solve(decay, (0, 1), np.ones(12), rtol=1e-8).y.values[-1] == pytest.approx(np.exp(-1.0), rel=1e-7)
    assert float(xd.solve(decay, (0, 1), [1.0, 2.0], rtol=1e-8).y1[-1]) == pytest.approx(2.0 * np.exp(-1.0), rel=1e-7)


def test_results_are_written_where_numpy_is_told() -> None:
    """Assert `out=` of a function of numpy, and that arrays of no numbers are joined with others."""

    def limited(t: float, y: Any) -> Any:
        rates = np.empty_like(y)
        np.clip(y, -0.5, 0.5, out=rates)
        return -np.concatenate((rates[:1], y[2:], rates[1:]))

    run = xd.solve(limited, (0, 1), [2.0, 0.25], rtol=1e-9)
    assert run.dynamics.solution.y[:, -1] == pytest.approx([1.5, 0.25 * np.exp(-1.0)], rel=1e-8)


def _universal(t: Any, y: Any) -> Any:
    """Methods of numpy's functions: forces of springs, given to both ends, and a mass matrix."""
    i, j = np.array([0, 3, 5]), np.array([1, 4, 5])
    d = np.zeros(6)
    np.add.at(d, i, y[j] - y[i])
    np.subtract.at(d, [1, 1, 4], y[:3])
    ratio = np.maximum.outer(np.arange(6), np.arange(6)) * np.subtract.outer(y, y)
    return d + 0.01 * ratio.sum(1) - np.add.reduce(y) * 0.1 - np.add.accumulate(y) * 0.1


def _spreads(t: Any, y: Any) -> Any:
    """Spreads of a row: each is one sum."""
    return -y * np.std(y) - np.var(y) - np.ptp(y) * np.full(len(y), 0.5) * y


@pytest.mark.parametrize(
    ("fun", "n"), [(_universal, 6), (_spreads, 5), (lambda t, y: [-k * x for k, x in enumerate(y)], 12)]
)
def test_methods_of_functions_spreads_and_lists_have_scipys_numbers(fun: Any, n: int) -> None:
    """Assert that they are traced, with scipy's digits, and that one name is one array."""
    start = np.cos(np.arange(n))
    run = xd.solve(fun, (0, 1), start, "DOP853", names="u", rtol=1e-10, atol=1e-12)
    exact = solve_ivp(fun, (0, 1), start, "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    assert run.u.dims == ("step", "u_index")
    np.testing.assert_allclose(run.u.values[-1], exact, rtol=1e-8, atol=1e-10)


def test_spreads_of_a_row_are_short() -> None:
    """Assert that a spread is a sum of a sum, and not one written out for each element."""
    text = model_of_function(_spreads, (0, 1), np.cos(np.arange(1000)), (), None, "u", None).to_toml()
    assert len(next(line for line in text.split("\n") if line.startswith("rate"))) < 400


@pytest.mark.parametrize(
    "fun",
    [lambda t, y, n: -np.roll(y, n - 1), lambda t, y, n: -y * np.arange(n), lambda t, y, n: -np.tile(y[: n // 2], 2)],
)
def test_whole_arguments_say_how_many(fun: Any) -> None:
    """Assert that an argument that numpy needs as a whole number is one, and no parameter."""
    run = xd.solve(fun, (0, 1), np.arange(12.0), "DOP853", names="y", args=(12,), rtol=1e-10)
    exact = solve_ivp(fun, (0, 1), np.arange(12.0), "DOP853", args=(12,), rtol=1e-12, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(run.y.values[-1], exact, rtol=1e-8, atol=1e-9)


def test_elements_of_a_state_have_tolerances() -> None:
    """Assert that a tolerance for each number, of a function that stays one expression, is that of each element."""
    run = xd.solve(lambda t, y: -y, (0, 1), np.arange(12.0), names="y", rtol=1e-6, atol=np.linspace(1e-9, 1e-6, 12))
    assert run.y.values[-1] == pytest.approx(np.arange(12.0) * np.exp(-1.0), rel=1e-5)
    with pytest.raises(xd.InputError, match="atol has 11 numbers, and y0 12; give one, or one for each"):
        xd.solve(lambda t, y: -y, (0, 1), np.arange(12.0), names="y", rtol=1e-6, atol=[1e-9] * 11)


@pytest.mark.parametrize("size", [2, 12])
@pytest.mark.parametrize(
    "fun",
    [
        lambda t, y: 1j * y,
        lambda t, y: np.full(len(y), 1j) * y,
        lambda t, y: [1j * x for x in y],
    ],
)
def test_imaginary_parts_are_not_dropped(fun: Any, size: int) -> None:
    """Assert that complex rates are refused in every way of tracing: numpy would march their real parts, zero."""
    with pytest.raises(
        xd.InputError, match=r"makes (0\+1j, needs real numbers|complex numbers of real ones; begin with .* y0 \+ 0j)"
    ):
        xd.solve(fun, (0, 1), np.ones(size), names="y")


@pytest.mark.parametrize(
    ("start", "said"),
    [
        ([], r"y0 has shape \(0,\), needs one axis"),
        (np.ones((2, 3)), r"y0 has shape \(2, 3\), needs one axis of at least one number; give y0.ravel\(\)"),
        ([1.0, np.nan], r"y0\[1\] is nan, needs a finite number"),
        (np.broadcast_to(1.0, 10**6 + 1), "y0 has 1000001 numbers, needs 1 to 1000000"),
        (
            np.broadcast_to(1.0, 30_001),
            "y0 has 30001 numbers, .* write the model with .dimensions., as `xdynamics help",
        ),
    ],
)
def test_starts_of_no_row_are_named(start: Any, said: str) -> None:
    """Assert that a start that is none of a state is refused by its shape or number."""
    with pytest.raises(xd.InputError, match=said):
        xd.solve(lambda t, y: y, (0, 1), start)
