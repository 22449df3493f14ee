"""Functions of `xd.solve` that remember what they did: refused where it counts, and left as they were."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd

warm = True


class Rocket:
    """A rocket of two stages."""

    stage = 1

    def __call__(self, t: float, y: Any) -> list[Any]:
        """Return the rates."""
        if t > 1.5 and self.stage == 1:
            self.stage = 2
        return [y[1], 20 - 9.81 if self.stage == 1 else 8 - 9.81]


class Relay:
    """A relay with a band."""

    def __init__(self) -> None:
        self.on = True

    def rates(self, _t: float, y: Any) -> list[float]:
        """Return the rate."""
        if y[0] > 22:
            self.on = False
        elif y[0] < 18:
            self.on = True
        return [1.0 if self.on else -1.0]


class Switch:
    """Something that is on."""

    on = True


def latch() -> Callable[..., Any]:
    fired = [False]

    def rates(_t: float, y: Any) -> list[float]:
        if y[0] > 0.5:
            fired[0] = True
        return [-1.0 if fired[0] else 1.0]

    return rates


def thermostat() -> Callable[..., Any]:
    state = {"on": True}

    def rates(_t: float, y: Any) -> list[float]:
        if y[0] > 21:
            state["on"] = False
        if y[0] < 19:
            state["on"] = True
        return [1.0 if state["on"] else -1.0]

    return rates


def of_a_global(_t: float, y: Any) -> list[float]:
    global warm  # noqa: PLW0603 - what a script does
    if y[0] > 21:
        warm = False
    elif y[0] < 19:
        warm = True
    return [1.0 if warm else -1.0]


def largest() -> Callable[..., Any]:
    found = np.zeros(1, object)

    def rates(t: float, y: Any) -> list[Any]:
        if y[0] > found[0]:
            found[0] = y[0]
        return [np.cos(t) - 0.1 * found[0]]

    return rates


def stages() -> Callable[..., Any]:
    memory = SimpleNamespace(number=0)

    def rates(t: float, _y: Any) -> list[float]:
        if t > 1 and memory.number == 0:
            memory.number = 1
        if t > 2 and memory.number == 1:
            memory.number = 2
        return [[1.0, -1.0, 0.5][memory.number]]

    return rates


def nonlocal_name() -> Callable[..., Any]:
    late = False

    def rates(t: float, _y: Any) -> list[float]:
        nonlocal late
        if t > 1:
            late = True
        return [-1.0 if late else 1.0]

    return rates


def of_a_class(t: float, _y: Any) -> list[float]:
    if t > 1:
        Switch.on = False
    return [1.0 if Switch.on else -1.0]


def of_its_attribute(t: float, _y: Any) -> list[float]:
    if t > 1:
        of_its_attribute.late = True  # type: ignore[attr-defined]
    return [-1.0 if getattr(of_its_attribute, "late", False) else 1.0]


def of_a_set() -> Callable[..., Any]:
    passed: set[str] = set()

    def rates(t: float, _y: Any) -> list[float]:
        if t > 1:
            passed.add("one")
        return [-1.0 if passed else 1.0]

    return rates


def of_a_helper() -> Callable[..., Any]:
    inner = latch()
    return lambda t, y: [2.0 * inner(t, y)[0]]


@pytest.mark.parametrize(
    "make",
    [
        Rocket,
        lambda: Relay().rates,
        latch,
        thermostat,
        lambda: of_a_global,
        largest,
        stages,
        nonlocal_name,
        lambda: of_a_class,
        lambda: of_its_attribute,
        of_a_set,
        of_a_helper,
    ],
)
def test_what_it_remembers_is_refused_where_it_counts(make: Callable[[], Any]) -> None:
    """Assert one line with what to write; all of these were computed wrongly, without a word, once."""
    with pytest.raises(xd.InputError, match="it remembers what it did, and a right-hand side is of t and y alone"):
        xd.solve(make(), (0, 4), [0.0, 0.0] if make is Rocket else [0.0])
    assert warm is True
    assert Switch.on is True
    assert not hasattr(of_its_attribute, "late")


def test_an_event_that_remembers_is_refused() -> None:
    """Assert the same of events."""
    seen = [0.0]

    def passed(_t: float, y: Any) -> Any:
        if y[0] > 1:
            seen[0] = 1.0
        return y[0] - 2.0 + seen[0]

    with pytest.raises(xd.InputError, match="it remembers what it did"):
        xd.solve(lambda _t, _y: [1.0], (0, 4), [0.0], events=passed)
    assert seen == [0.0]


def test_what_does_not_count_is_left_as_it_was() -> None:
    """Assert that histories, counters, buffers and caches are taken, and that none of them keeps a traced number."""
    history: list[Any] = []
    calls, cache, buffer = [0], dict[str, float](), np.zeros(2, object)

    def rates(t: float, y: Any) -> Any:
        history.append((t, y[0]))
        calls[0] += 1
        if "k" not in cache:
            cache["k"] = 2.0
        buffer[0], buffer[1] = y[1], -cache["k"] * y[0]
        if t > 1e3:
            return [0.0, 0.0]
        return buffer

    run = xd.solve(rates, (0, 3), [1.0, 0.0], rtol=1e-10)
    assert float(run.y0[-1]) == pytest.approx(np.cos(3.0 * np.sqrt(2.0)), rel=1e-8)
    assert (history, calls, cache) == ([], [0], {})
    assert buffer.tolist() == [0, 0]


def test_a_table_of_a_million_numbers_is_no_memory() -> None:
    """Assert that long data beside a function are left alone, and that it is fast enough to do so."""
    data = np.linspace(0.0, 1.0, 3_000_000)
    run = xd.solve(lambda _t, y: [-data[-1] * y[0]], (0, 1), [1.0], rtol=1e-10)
    assert float(run.y0[-1]) == pytest.approx(np.exp(-1.0), rel=1e-9)


def test_states_at_chosen_times_with_those_between() -> None:
    """Assert scipy's `dense_output` beside `t_eval`, its counts, and `args=None`."""
    found = xd.solve(
        lambda _t, y: [y[1], -y[0]], (0, 3), [1.0, 0.0], t_eval=[1.0, 2.0], dense_output=True, args=None, rtol=1e-10
    ).dynamics.solution
    assert found.y.shape == (2, 2)
    assert found.sol(1.2) == pytest.approx([np.cos(1.2), -np.sin(1.2)], abs=1e-8)
    assert found.nfev > 10


def test_states_at_chosen_times_say_how_the_run_is_had() -> None:
    """Assert the remedy of what needs the whole run."""
    states = xd.solve(lambda _t, y: [-y[0]], (0, 3), [1.0], t_eval=[1.0, 2.0])
    with pytest.raises(xd.InputError, match="leave times, or t_eval, out"):
        states.dynamics.events()
    with pytest.raises(xd.InputError, match="leave times, or t_eval, out"):
        xd.plot(states)
    with pytest.raises(xd.InputError, match="path='run.nc' beside times, or t_eval"):
        xd.save(states, "states.nc")


def test_a_period_whose_ends_are_one_point() -> None:
    """Assert `np.interp` with a period where the table has both its ends."""
    run = xd.solve(lambda t, y: [np.interp(t, [0, 0.5, 1], [0, 1, 0], period=1) + 0 * y[0]], (0, 2), [0.0], rtol=1e-10)
    assert float(run.y0[-1]) == pytest.approx(1.0, rel=1e-9)


def test_a_function_without_global_names_leaves_its_module_alone() -> None:
    """Assert that what else a module holds is neither looked at nor put back."""
    from xdynamics.expressions.memory import Remembered

    scope: dict[str, Any] = {"__name__": "__main__"}
    exec("def rates(t, y):\n    return [-y[0]]\n\nclass Empty: pass\n", scope)
    memory = Remembered((scope["rates"], scope["Empty"]))
    scope["later"] = 1.0
    memory.note()
    memory.recall()
    assert memory.seen == []
    assert scope["later"] == 1.0
