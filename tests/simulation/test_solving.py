# ruff: noqa: ARG001, ARG005 - functions of t and y, as scipy takes them
"""`solve` beside scipy's solve_ivp: the same functions, the same numbers, and a record."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd

MATRIX = np.array([[-1.0, 2.0, 0.0], [0.0, -0.5, 1.0], [-2.0, 0.0, -0.3]])


def lorenz(t: Any, y: Any, sigma: Any, rho: Any, beta: Any) -> Any:
    """Lorenz's equations."""
    return [sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]]


def linear(t: Any, y: Any) -> Any:
    """A matrix times a vector, driven."""
    return MATRIX @ y + np.array([0.0, np.sin(t), 1.0])


def chain(t: Any, y: Any) -> Any:
    """Slices and sums of arrays."""
    q, v = y[:4], y[4:]
    force = -2.0 * q
    force[1:] += q[:-1]
    force[:-1] += q[1:]
    return np.concatenate([v, force - 0.1 * v])


def functions(t: Any, y: Any, k: Any) -> Any:
    """Most elementary functions of numpy."""
    a, b = y
    return (
        np.where(a > 0, -np.tanh(a), np.arctan(-a))
        + np.hypot(a, b) ** -2
        - k * np.sqrt(np.abs(b))
        + np.exp(-(t**2)) * np.log1p(b**2),
        np.maximum(b, -0.5) * -1.0
        + np.minimum(a, 0.3)
        + np.arctan2(a, 2 + b)
        + np.sign(t + 1) * np.cos(3 * a) / 2 ** (b / 4),
    )


def swing(t: Any, y: Any) -> Any:
    """A pendulum."""
    return y[1], -9.81 * np.sin(y[0])


CASES = [
    (lorenz, [1.0, 1.0, 1.0], (10.0, 28.0, 8 / 3), 2.0),
    (linear, [1.0, 0.0, -1.0], (), 5.0),
    (chain, [0.1 * k for k in range(8)], (), 6.0),
    (functions, [0.4, -0.2], (0.3,), 3.0),
    (swing, [2.0, 0.0], (), 4.0),
]


@pytest.mark.every(3)
@pytest.mark.parametrize(("fun", "y0", "args", "end"), CASES, ids=lambda one: getattr(one, "__name__", ""))
def test_numbers_are_those_of_scipy(fun: Any, y0: list[float], args: tuple[float, ...], end: float) -> None:
    """Assert end states against solve_ivp at its tightest."""
    run = xd.solve(fun, (0, end), y0, "DOP853", args=args, rtol=1e-11)
    right = solve_ivp(fun, (0, end), y0, "DOP853", args=args, rtol=1e-12, atol=1e-12, max_step=0.01)
    assert run.attrs["run_outcome"] == "completed"
    assert [float(run[f"y{i}"][-1]) for i in range(len(y0))] == pytest.approx(right.y[:, -1], rel=1e-8, abs=1e-9)


@pytest.mark.dear
def test_a_stiff_one_has_its_exact_derivatives() -> None:
    """Assert that scipy's Radau is ours, with the Jacobian of the expressions."""

    def oscillator(t: Any, y: Any, mu: Any) -> Any:
        return [y[1], mu * (1 - y[0] ** 2) * y[1] - y[0]]

    run = xd.solve(oscillator, (0, 2000), [2.0, 0.0], "Radau", args=(1000.0,), rtol=1e-7)
    assert (run.attrs["solver_method"], run.attrs["solver_jacobian"]) == ("radau_iia", "exact")
    right = solve_ivp(oscillator, (0, 2000), [2.0, 0.0], "Radau", args=(1000.0,), rtol=1e-9, atol=1e-9)
    assert float(run.y0[-1]) == pytest.approx(right.y[0, -1], rel=1e-4)


def test_the_record_is_one_like_any_other(tmp_path: Path) -> None:
    """Assert units, names, parameters, bits from the file alone, and a budget's slopes of what was a Python function."""
    given: dict[str, Any] = {"args": (10.0, 28.0, 8 / 3), "names": ["x", "y", "z"], "rtol": 1e-9}
    path = tmp_path / "lorenz.nc"
    run = xd.solve(lorenz, ("0 s", "1 s"), [1.0, 1.0, 1.0], path=path, **given)
    assert (float(run.rho), run.attrs["title"], run.x.attrs["units"]) == (28.0, "lorenz, by dormand_prince", "1")
    assert xd.reproduce(path).attrs["identical"] == 1
    found = xd.solve(lorenz, (0, 1), [1.0, 1.0, 1.0], t_eval="0:1:11 s", **given)
    assert found.sizes == {"at": 11}


def test_units_and_events_of_scipy() -> None:
    """Assert units in which the function has its numbers, and terminal, counted, directed and plain events."""

    def fall(t: Any, y: Any) -> Any:
        return [y[1], -9810.0]

    def ground(t: Any, y: Any) -> Any:
        return y[0]

    def apex(t: Any, y: Any) -> Any:
        return y[1]

    ground.terminal, ground.direction = True, -1  # type: ignore[attr-defined]
    run = xd.solve(fall, (0, 9), ["1 m", 2000.0], "dop853", units=["mm", "mm s-1"], events=[ground, apex], rtol=1e-9)
    assert run.y0.attrs["units"] == "mm"
    assert float(run["event_time"][0]) == pytest.approx(2.0 / 9.81, rel=1e-9)
    assert float(run["event_time"][1]) == pytest.approx((2.0 + math.sqrt(4 + 2 * 9.81)) / 9.81, rel=1e-9)
    assert run.attrs["run_outcome"] == "stopped_by_event"

    def third(t: Any, y: Any) -> Any:
        return y[0]

    third.terminal = 3  # type: ignore[attr-defined]
    run = xd.solve(swing, (0, 9), [1.0, 0.0], "dop853", events=third, rtol=1e-9)
    assert run.sizes["event"] == 3


def test_scipys_tolerances_and_first_step() -> None:
    """Assert that a row of absolute tolerances is one for each number, and first_step the first step."""
    run = xd.solve(swing, (0, 1), [1.0, 0.0], "DOP853", rtol=1e-6, atol=[1e-9, 1e-8], first_step=0.01)
    assert (float(run.y0.attrs["atol"]), float(run.y1.attrs["atol"])) == (1e-9, 1e-8)
    assert run.attrs["solver_first_step"] == 0.01


def endless(t: Any, y: Any) -> Any:
    """Decides by a value, again and again."""
    while y[0] > 0:
        y = y - 1.0
    return [y[0]]


def unlike(t: Any, y: Any) -> Any:
    """Returns as many numbers as it likes."""
    return [1.0] if t < 1.0 else [1.0, 2.0]


def many(t: Any, y: Any) -> Any:
    """Has many ways."""
    return [sum(1.0 if y[0] > k else 0.0 for k in range(9))]


def nested(t: Any, y: Any) -> Any:
    """A force in three phases, the second of which asks for the state."""
    force = 0.0
    if 1 < t < 3:
        force = 1.0 if y[0] > 0.5 else 2.0
    elif t >= 5 and not y[0] >= 3:
        force = -1.0
    return [force - 0.1 * y[0]]


def pulsed(t: float, y: Any) -> Any:
    """Returns a number, not a list, and an array elsewhere."""
    if t < 2.0:
        return 1.0
    return -y


@pytest.mark.parametrize("fun", [nested, pulsed])
def test_branches_are_followed_both_ways(fun: Any) -> None:
    """Assert scipy's numbers by short steps, and that each switch is located, whatever the step is."""
    run = xd.solve(fun, (0.0, 10.0), [0.0], rtol=1e-10, atol=1e-12)
    theirs = solve_ivp(fun, (0.0, 10.0), [0.0], rtol=1e-10, atol=1e-12, max_step=1e-3).y[0, -1]
    assert float(run.y0[-1]) == pytest.approx(theirs, abs=1e-7)
    assert run.sizes["event"] >= 1


def test_a_way_that_is_not_taken_is_not_evaluated() -> None:
    """Assert a root and a logarithm outside their domain on the other way: a tank that empties, and a force that sets in."""
    tank = xd.solve(lambda t, y: [-np.sqrt(y[0])] if y[0] > 0 else [0.0], (0.0, 5.0), [1.0], rtol=1e-9, atol=1e-12)
    assert float(tank.y0[-1]) == pytest.approx(0.0, abs=1e-12)
    late = xd.solve(lambda t, y: [math.log(t - 1.0)] if t > 1 else [0.0], (0.0, 3.0), [0.0], rtol=1e-9, atol=1e-12)
    assert float(late.y0[-1]) == pytest.approx(2.0 * math.log(2.0) - 2.0, abs=1e-7)
    assert {tank.attrs["run_outcome"], late.attrs["run_outcome"]} == {"completed"}


def test_a_branch_that_drives_back_slides() -> None:
    """Assert a relay by `if`: from 0 to 1 in a second, and then at 1 by the share of both ways."""
    run = xd.solve(lambda t, y: [-1.0] if y[0] > 1.0 else [1.0], (0.0, 3.0), [0.0])
    assert float(run.y0[-1]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("method", ["BDF", "LSODA"])
def test_stiff_methods_of_scipy_are_taken_by_radau(method: str) -> None:
    """Assert the warning, the method in the record, and scipy's number of a stiff problem."""
    stiff = lambda t, y: [-1000.0 * (y[0] - np.cos(t))]  # noqa: E731
    with pytest.warns(UserWarning, match=f"{method} is not here, and radau_iia is taken in its place"):
        run = xd.solve(stiff, (0.0, 1.0), [0.0], method, np.array([0.5, 1.0]), rtol=1e-8)
    theirs = solve_ivp(stiff, (0.0, 1.0), [0.0], "BDF", np.array([0.5, 1.0]), rtol=1e-10, atol=1e-12).y[0]
    np.testing.assert_allclose(run.y0.values, theirs, rtol=1e-7)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"fun": endless}, r"decides by a value that is not known yet; write numpy.where"),
        ({"fun": unlike}, "the branches of the function return 1 and 2 numbers"),
        ({"fun": many}, "has over 64 ways through its branches; write numpy.where"),
        ({"fun": lambda t, y: [int(y[0])]}, "takes a number of a value that is not known yet"),
        ({"fun": lambda t, y: [y[0], y[0]]}, "returns 2 rates, and y0 has 1 numbers"),
        ({"fun": lambda t, y: [y[3]]}, "ends with IndexError: index 3 is out of bounds"),
        ({"fun": lambda t, y: [np.arcsinh(y[0])]}, "calls numpy.arcsinh, which the language of expressions has not"),
        ({"fun": lambda t, y: [np.linalg.norm(y) * "a"]}, "makes .a., needs numbers"),
        ({"fun": lambda t, y: [float("nan")]}, "makes nan, needs finite numbers"),
        ({"fun": lambda t, y: None}, "returns nothing; it has to return rates, 1 of them"),
        ({"fun": 5}, "fun is 5, needs a function"),
        ({"y0": [1j, "2 m"]}, "needs a real number"),
        ({"y0": ["1 kg"], "units": ["m"]}, "y0.0. is '1 kg', and its unit 'm'"),
        ({"units": ["m", "s"]}, "units are 2, and y0 has 1"),
        ({"names": ["a", "b"]}, "names are 2, and y0 has 1"),
        ({"names": ["t"]}, "'t' is"),
        ({"t_span": (0, 1, 2)}, "t_span has 3 times"),
        ({"t_span": (1, 0)}, "until"),
        ({"method": "euler"}, "scipy's RK45, RK23"),
        ({"events": [5]}, r"events\[0\] is 5"),
    ],
)
def test_what_cannot_be_solved_is_named(given: dict[str, Any], said: str) -> None:
    """Assert that functions and arguments of another kind are refused in one sentence."""
    asked = {"fun": lambda t, y: [-y[0]], "t_span": (0, 1), "y0": [1.0], "rtol": 1e-6} | given
    with pytest.raises(xd.InputError, match=said):
        xd.solve(**asked)


def test_times_that_are_evaluated_have_the_events_beside_them() -> None:
    """Assert that scipy's t_events and y_events do not depend on t_eval, with states and times of scipy's own."""

    def fall(t: Any, y: Any) -> Any:
        return [y[1], -9.81]

    def ground(t: Any, y: Any) -> Any:
        return y[0]

    def apex(t: Any, y: Any) -> Any:
        return y[1]

    ground.terminal, ground.direction = True, -1  # type: ignore[attr-defined]
    times = np.linspace(0.0, 9.0, 31)
    found = xd.solve(fall, (0, 9), [1.0, 2.0], "dop853", t_eval=times, events=[ground, apex], rtol=1e-9)
    solution = found.dynamics.solution
    theirs = solve_ivp(fall, (0, 9), [1.0, 2.0], "DOP853", t_eval=times, events=[ground, apex], rtol=1e-9, atol=1e-12)
    assert solution.t.tolist() == theirs.t.tolist()
    assert solution.y == pytest.approx(theirs.y, abs=1e-8)
    for ours, other in zip(solution.t_events + solution.y_events, theirs.t_events + theirs.y_events, strict=True):
        assert ours == pytest.approx(other, abs=1e-8)
    assert solution.status == theirs.status == 1


@pytest.mark.parametrize("events", [True, False])
def test_a_stop_before_the_first_wanted_time_leaves_none(*, events: bool) -> None:
    """Assert an empty solution, as scipy has it, of a run that ends before the first of t_eval."""

    def fall(t: Any, y: Any) -> Any:
        return [y[1], -9.81] if events else [y[1], -9.81 / np.sqrt(0.25 - t)]

    def ground(t: Any, y: Any) -> Any:
        return y[0]

    ground.terminal = True  # type: ignore[attr-defined]
    chosen = {"events": ground} if events else {}
    found = xd.solve(fall, (0, 9), [1.0, 0.0], "dop853", t_eval=[5.0, 6.0], rtol=1e-9, **chosen)
    solution = found.dynamics.solution
    assert solution.t.size == 0
    assert solution.y.shape == (2, 0)
    assert solution.status == (1 if events else -1)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"terminal": "no"}, "terminal is 'no', needs True, False, or the number"),
        ({"terminal": -1}, "terminal is -1, needs"),
        ({"terminal": 1.5}, "terminal is 1.5, needs"),
        ({"terminal": float("nan")}, "terminal is nan, needs"),
        ({"direction": "up"}, "direction is 'up', needs a number"),
        ({"direction": float("nan")}, "direction is nan, needs a number"),
    ],
)
def test_attributes_of_events_that_scipy_does_not_take(attributes: dict[str, Any], words: str) -> None:
    """Assert one line for each."""

    def passes(t: Any, y: Any) -> Any:
        return y[0] - 0.5

    vars(passes).update(attributes)
    with pytest.raises(xd.InputError, match=words):
        xd.solve(swing, (0, 1), [1.0, 0.0], events=passes)
