# ruff: noqa: ARG001, ARG005 - functions of t and y, as scipy takes them
"""Complex initial values: marched as real and imaginary parts, and complex again under scipy's names."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd

H = np.array([[1.0, 0.3 - 0.2j, 0.0], [0.3 + 0.2j, -0.5, 0.1], [0.0, 0.1, 2.0]])


def rabi(t: Any, y: Any, frequency: Any, detuning: Any) -> Any:
    """A two-level system under a drive."""
    a, b = y
    return [
        -1j * frequency / 2 * np.exp(1j * detuning * t) * b,
        -1j * frequency / 2 * np.exp(-1j * detuning * t) * a,
    ]


def stuart_landau(t: Any, z: Any) -> Any:
    """A limit cycle of radius sqrt(0.5)."""
    return (0.5 + 2j) * z - np.abs(z) ** 2 * z


def filled(t: Any, z: Any) -> Any:
    """Rates that are written into an array, of real parts, imaginary parts and conjugates."""
    dz = np.empty(2, dtype=complex)
    dz[0] = 1j * z[0] * np.conj(z[1]) + np.real(z[0]) * 0.2
    dz[1] = -z[1] / (1 + abs(z[0]) ** 2) + np.cos(t) + 1 / (2 + 1j * t) + 1j * z.imag[0]
    return dz


CASES: dict[str, tuple[Any, Any, tuple[float, ...]]] = {
    "a list": (rabi, [1 + 0j, 0], (1.0, 0.5)),
    "a matrix": (lambda t, psi: -1j * (H @ psi), [1, 0, 0j], ()),
    "sizes": (stuart_landau, [0.1 + 0.1j], ()),
    "an array that is filled": (filled, [1j, 0.5], ()),
    "one number": (lambda t, z: 1j * z, 1 + 0j, ()),
    "powers and functions": (lambda t, z: z - z**3 + np.exp(z * 0.1) + np.sin(z) - np.cos(z) / (3 + z), [0.2j], ()),
    "sums": (lambda t, z: -1j * z * np.sum(np.abs(z) ** 2) + z.sum() / 10, np.array([1j, 0.5, 0.3 + 0.2j]), ()),
    "a norm": (lambda t, z: -1j * z * np.linalg.norm(z), [1j, 0.5], ()),
}


@pytest.mark.parametrize("case", CASES)
def test_complex_numbers_are_those_of_scipy(case: str) -> None:
    """Assert the end, the states between, and the states at chosen times."""
    fun, y0, args = CASES[case]
    exact = solve_ivp(fun, (0, 3), np.atleast_1d(y0), "DOP853", args=args, rtol=1e-11, atol=1e-13, dense_output=True)
    run = xd.solve(fun, (0, 3), y0, "DOP853", args=args, rtol=1e-11, atol=1e-13)
    found = run.dynamics.solution
    assert found.y.dtype == complex
    assert abs(found.y[:, -1] - exact.y[:, -1]).max() < 3e-10
    assert abs(found.sol(1.3) - exact.sol(1.3)).max() < 3e-10
    assert float(run.y0_real[-1]) == found.y[0, -1].real
    at = xd.solve(fun, (0, 3), y0, "DOP853", [0.0, 1.0, 3.0], args=args, rtol=1e-11, atol=1e-13).dynamics.solution
    assert abs(at.y - exact.sol([0.0, 1.0, 3.0])).max() < 3e-10


def test_a_turn_of_the_plane_is_that_of_the_closed_form() -> None:
    """Assert exp(2 i t) by two methods, with names, units, a tolerance for each, and by `refine`."""
    for method in ("taylor", "radau_iia"):
        run = xd.solve(
            lambda t, z: 2j * z, (0, 5), [1 + 0j, 2j], method, names=["a", "b"], units="V", rtol=1e-11, atol=[1e-13] * 2
        )
        assert run.a_real.attrs["units"] == "V"
        found = run.dynamics.solution
        assert found.names == ("a", "b")
        assert abs(found.y[:, -1] - np.exp(10j) * np.array([1, 2j])).max() < 1e-8
    model = xd.Model.from_record(run)
    study = xd.refine(model, method="dop853", rtols=[1e-6, 1e-8, 1e-10], until=5.0)
    assert "difference_a_real" in study


def test_events_of_complex_numbers_are_located() -> None:
    """Assert the times of a real part and of a size, and complex states there."""

    def passes(t: Any, z: Any) -> Any:
        return z[0].real - 0.3

    def grown(t: Any, z: Any) -> Any:
        return np.abs(z[0]) - 0.6

    grown.terminal = True  # type: ignore[attr-defined]
    asked = {"rtol": 1e-11, "atol": 1e-13, "events": [passes, grown]}
    exact = solve_ivp(stuart_landau, (0, 9), [0.1 + 0.1j], "DOP853", **asked)
    found = xd.solve(stuart_landau, (0, 9), [0.1 + 0.1j], "DOP853", **asked).dynamics.solution
    assert found.status == exact.status == 1
    for times, states, exact_times, exact_states in zip(
        found.t_events, found.y_events, exact.t_events, exact.y_events, strict=True
    ):
        assert times == pytest.approx(exact_times, abs=1e-9)
        assert abs(states - exact_states).max() < 1e-9


def written(t: Any, z: Any) -> Any:
    """Write into the argument."""
    z[0] = 0
    return z


@pytest.mark.parametrize(
    ("fun", "asked", "said"),
    [
        (lambda t, z: np.sqrt(z), {}, "calls numpy.sqrt of complex numbers, which is not traced"),
        (lambda t, z: z**0.5, {}, "to the power 0.5, needs a whole one from 1 to 16"),
        (lambda t, z: [float(z[0])], {}, "takes a real number of a complex one, as float"),
        (lambda t, z: 1j * z if z[0] else z, {}, "takes a real number of a complex one"),
        (lambda t, z: np.where(z == 0, 1j, z), {}, "calls numpy.equal of complex numbers"),
        (
            lambda t, z: 0 * z if z[0] == 0 else z,
            {},
            "compares complex numbers; compare their real and imaginary parts",
        ),
        (lambda t, z: [1j * z[0], 0], {}, "returns 2 rates, and y0 has 1 numbers"),
        (written, {}, "written writes into its argument"),
        (lambda t, z: z, {"y0": [complex("nan")]}, r"y0\[0\] is nan, needs a finite number"),
        (lambda t, z: z, {"y0": [[1j]]}, r"y0 has shape \(1, 1\), needs one axis"),
        (lambda t, z: z, {"names": ["a", "b"]}, "names are 2, and y0 has 1"),
        (lambda t, z: z, {"atol": [1e-9, 1e-9]}, "atol has 2 numbers, and y0 1"),
        (lambda t, z: 1j * z, {"y0": [1.0]}, r"complex numbers of real ones; begin with complex ones, y0 \+ 0j"),
    ],
)
def test_what_cannot_be_traced_is_one_line(fun: Any, asked: dict[str, Any], said: str) -> None:
    """Assert what is said, with the way on."""
    with pytest.raises(xd.InputError, match=said):
        xd.solve(fun, (0, 1), asked.get("y0", [1 + 0j]), **{key: value for key, value in asked.items() if key != "y0"})
