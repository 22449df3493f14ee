# ruff: noqa: ARG001, ARG005, B008 - functions of t and y, as scipy takes them, with numbers of their own
"""`solve` refuses functions that give something else when they are called again, and no others."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.simulation.scipy_interface import model_of_function

Function = Callable[[Any, Any], Any]
Make = Callable[[np.random.Generator], tuple[Function, list[Function]]]


def rates(y: Any, change: Any) -> list[Any]:
    """A driven oscillator, in which a number stands that may change."""
    return [y[1], -y[0] * (1.0 + 0.1 * np.sin(y[1])) - change * y[1]]


def of(change: Callable[[Any, Any], Any], *events: Function) -> tuple[Function, list[Function]]:
    """The oscillator with a number that a function gives."""
    return lambda t, y: rates(y, change(t, y)), list(events)


def counting(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """One number in the first calls, another in those behind: as long as calls with names come before."""
    calls, last = [], int(draw.integers(1, 4))
    return of(lambda t, y: calls.append(0) or float(len(calls) > last))


def emptied(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Takes its numbers from a list, one in each call."""
    left = draw.uniform(0, 1, 50).tolist()
    return of(lambda t, y: left.pop())


def of_an_event(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Reads what an event changes."""
    shared = {"c": 0.1}

    def event(t: Any, y: Any) -> Any:
        shared["c"] += 0.1
        return y[0]

    return of(lambda t, y: shared["c"], event)


def random_event(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Has an event at a level that is drawn."""
    return of(lambda t, y: 0.1, lambda t, y: y[0] - 0.5, lambda t, y: y[0] - draw.normal())


def with_names(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Does something else with numbers than with names."""
    size = float(draw.uniform(1e-4, 1.0))
    return of(lambda t, y: size if isinstance(y[0], float) else 0.0)


def sometimes(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Adds noise to numbers alone."""
    return of(lambda t, y: 0.1 + (draw.normal() if isinstance(t, float) else 0.0))


CHANGING: dict[str, Make] = {
    "numpy's draws": lambda draw: of(lambda t, y: draw.normal()),
    "old draws of numpy": lambda _: of(lambda t, y: np.random.rand()),  # noqa: NPY002
    "Python's draws": lambda _: of(lambda t, y: random.random()),
    "small draws": lambda draw: of(lambda t, y: 1e-12 * draw.uniform()),
    "drawn exponents": lambda draw: of(lambda t, y: abs(y[0]) ** float(draw.integers(1, 10**9) / 1e8)),
    "clocks": lambda _: of(lambda t, y: time.time() % 1.0),
    "counters of time": lambda _: of(lambda t, y: time.perf_counter_ns() % 10**9),
    "counters": counting,
    "lists": emptied,
    "what an event changes": of_an_event,
    "random events": random_event,
    "numbers and names": with_names,
    "noise on numbers": sometimes,
}


@lru_cache
def remembered(k: int) -> float:
    """A number that is computed once."""
    return float(np.cos(k))


def logging(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Writes its calls down, and does not read them."""
    calls: list[Any] = []
    return of(lambda t, y: calls.append(t) or 0.1)


def in_a_copy(draw: np.random.Generator) -> tuple[Function, list[Function]]:
    """Works in a copy of the array that it is given."""

    def right(t: Any, y: Any) -> Any:
        y = np.array(y)
        y[0] = 2.0 * y[0]
        return rates(y, 0.1)

    return right, [lambda t, y: y[0] - 0.1]


STEADY: dict[str, Make] = {
    "plain": lambda draw: of(lambda t, y, c=float(draw.uniform()): c),
    "seeded": lambda _: of(lambda t, y: np.random.default_rng(7).normal()),
    "remembered": lambda draw: of(lambda t, y, k=int(draw.integers(9)): remembered(k)),
    "logging": logging,
    "in a copy": in_a_copy,
    "cancelling": lambda _: of(lambda t, y: np.sin(y[0]) ** 2 + np.cos(y[0]) ** 2 - 1.0),
    "large angles": lambda draw: of(lambda t, y, w=float(10.0 ** draw.uniform(0, 10)): np.sin(w * t + w * y[0])),
    "no number beside the start": lambda _: of(lambda t, y: np.sqrt(0.5000001 - y[0]), lambda t, y: 1 / t),
    "an error with numbers": lambda _: of(lambda t, y: 0.1 + 0 / (not isinstance(t, float))),
    "sums of many": lambda draw: of(lambda t, y, a=draw.normal(size=(400, 2)): (a @ np.array([y[0], y[1]])).sum()),
    "branches": lambda draw: of(lambda t, y, c=float(draw.normal()): np.where(y[1] > c, 1.0, np.abs(y[0] - c))),
}


@pytest.mark.cases(400)
def test_what_changes_is_refused(case: int) -> None:
    """Assert that a function with randomness, a counter or a clock is refused, and the message names what helps."""
    draw = np.random.default_rng(case)
    fun, events = list(CHANGING.values())[case % len(CHANGING)](draw)
    with pytest.raises(xd.InputError, match=r"(called again|wrote down|for numbers).*hand them over in args"):
        model_of_function(fun, (0.0, 10.0), draw.uniform(0.2, 1.0, 2), (), events, None, None)


@pytest.mark.cases(400)
def test_what_does_not_change_is_taken(case: int) -> None:
    """Assert that a function that gives the same again becomes a model, whatever else it does, in any units."""
    draw = np.random.default_rng(case)
    fun, events = list(STEADY.values())[case % len(STEADY)](draw)
    units = None if case % 3 else ["mm", "mm s-1"]
    starts = draw.choice([0.0, 0.5, 1e-30, 1e30], 2) if case % 4 == 0 else [0.5, float(draw.normal())]
    assert len(model_of_function(fun, ("1 s", "3 s"), starts, (), events, None, units).elements.statement.states) == 2


def test_both_draws_are_shown() -> None:
    """Assert that the message has what was written down at each call, and where."""
    values = iter([0.25, 0.75, 0.5, 0.5])

    def noisy(t: Any, y: Any) -> Any:
        return [y[1], -y[0] - next(values)]

    said = r"noisy gives the rate of 'v' as '.*0\.25.*' and, called again, as '.*0\.75.*'"
    with pytest.raises(xd.InputError, match=said):
        xd.solve(noisy, (0, 1), [1.0, 0.0], names=["x", "v"])


def test_numbers_apart_are_shown() -> None:
    """Assert that where numbers are not those of the expression, both are told, with the time."""

    def other(t: Any, y: Any) -> Any:
        return [-y[0] * (2.0 if isinstance(t, float) else 1.0)]

    with pytest.raises(
        xd.InputError, match=r"gives -2\.0 for the rate of 'y0' at t = 0 s, and the expression .* gives -1\.0 there"
    ):
        xd.solve(other, (0, 1), [1.0])


def test_a_mutable_argument_is_seen() -> None:
    """Assert that a function that changes what it is given in args is refused."""

    def worn(t: Any, y: Any, wear: Any) -> Any:
        wear[0] += 1.0
        return [-wear[0] * y[0]]

    with pytest.raises(xd.InputError, match="called again"):
        xd.solve(worn, (0, 1), [1.0], args=([1.0],))
