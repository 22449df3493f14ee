"""Thousands of random event functions whose roots are known: none is missed, none is seen that is not there."""

from __future__ import annotations

import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

import xdynamics as xd
from cases.problems import particle
from xdynamics.schema import CROSSING, EVENT_KINDS

T = "t/(1*second)"
STEP, TOGETHER = 0.1, 20  # s; events of one model
DIRECTIONS = {"rising": 1, "falling": -1, "either": 0}
FACTORS = (
    "1",
    f"exp(sin(7*{T}))",
    f"(2 + cos(5*{T}))",
    f"(1/(1 + ({T})**2))",
    "1e-150",
    "1e150",
    f"cosh({T})",
    f"sqrt(1 + ({T})**2)",
    f"(3 + tanh(20*({T} - 0.4)))",
)


class Case(NamedTuple):
    """An event function of time, its roots from the first on, and whether it rises or falls there."""

    function: str
    roots: list[float]
    ways: list[int]
    direction: str


def case(random: np.random.Generator) -> Case:
    """One of the three sorts."""
    function, roots, ways = (product, product, pair, waves)[random.integers(4)](random)
    direction = str(random.choice(list(DIRECTIONS)))
    watched = [i for i, way in enumerate(ways) if DIRECTIONS[direction] in (0, way)]
    return Case(function, [roots[i] for i in watched], [ways[i] for i in watched], direction)


def _product(random: np.random.Generator, roots: list[float]) -> tuple[str, list[float], list[int]]:
    text = "*".join(f"({T} - {one!r})" for one in random.permutation(roots).tolist())
    side = int(random.choice([-1, 1]))
    last = side  # behind all roots
    ways = [last * (-1) ** (len(roots) - 1 - i) for i in range(len(roots))]
    return f"{'' if side > 0 else '-1*'}{random.choice(FACTORS)}*{text}", sorted(roots), ways


def product(random: np.random.Generator) -> tuple[str, list[float], list[int]]:
    """Up to five roots inside one step, and some anywhere."""
    start = STEP * random.integers(0, 9)
    roots = start + STEP * random.uniform(0.01, 0.99, random.integers(1, 6))
    return _product(random, [*roots.tolist(), *random.uniform(0.01, 1, random.integers(3)).tolist()])


def pair(random: np.random.Generator) -> tuple[str, list[float], list[int]]:
    """Roots as near to each other as a thousandth to a billionth of a step."""
    first = random.uniform(0.01, 0.98)
    return _product(random, [first, first + STEP * 10.0 ** random.uniform(-9, -3)])


def waves(random: np.random.Generator) -> tuple[str, list[float], list[int]]:
    """A sum of sines; one that nearly touches zero would have roots that nobody knows, and is drawn again."""
    while True:
        size, rate, phase = random.uniform(0.3, 2, 3), random.uniform(1, 60, 3), random.uniform(0, 6, 3)

        def function(t: Any, size: Any = size, rate: Any = rate, phase: Any = phase) -> Any:
            return sum(a * np.sin(w * t + p) for a, w, p in zip(size, rate, phase, strict=True)) - 0.2

        t = np.linspace(0, 1, 20_001)
        value = function(t)
        turns = (np.diff(value)[1:] * np.diff(value)[:-1]) <= 0
        if np.abs(value[1:-1][turns]).min(initial=1) > 1e-3 and abs(value[0]) > 1e-3 and abs(value[-1]) > 1e-3:
            break
    at = np.flatnonzero(value[:-1] * value[1:] < 0)
    roots = [brentq(function, t[i], t[i + 1], xtol=1e-15, rtol=1e-15) for i in at]
    text = " + ".join(
        f"{a!r}*sin({w!r}*{T} + {p!r})" for a, w, p in zip(size.tolist(), rate.tolist(), phase.tolist(), strict=True)
    )
    return f"{text} - 0.2", roots, [int(np.sign(value[i + 1])) for i in at]


def faults(cases: list[Case], **asked: Any) -> tuple[list[str], int, int]:
    """March once past all of them; say what is missing, a ghost or elsewhere, and count events and substeps."""
    model = particle(
        name="random",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={f"e{i}": {"function": one.function, "direction": one.direction} for i, one in enumerate(cases)},
    )
    run = xd.simulate(model, until=1.0, **asked)
    found = [] if run.attrs["run_outcome"] == "completed" else [run.attrs["run_outcome_text"]]
    for i, one in enumerate(cases):
        mine = run.isel(event=run.event_detector.values == i)
        times, doubts = mine.event_time.values, mine.event_time_uncertainty.values
        kinds = {EVENT_KINDS[kind] for kind in mine.event_kind.values}
        if len(times) != len(one.roots):
            found.append(f"{len(times)} events for {len(one.roots)} roots: {one}, at {times.tolist()}")
        elif (np.abs(times - one.roots) > doubts + 1e-15).any():
            found.append(f"off by {np.abs(times - one.roots).max()} with {doubts.tolist()}: {one}")
        elif mine.event_direction.values.tolist() != one.ways or kinds > {EVENT_KINDS[CROSSING]}:
            found.append(f"{mine.event_direction.values.tolist()}, {kinds}: {one}")
    return found, run.sizes["event"], int(run.event_substeps.values.sum())


STEPS: list[dict[str, Any]] = [
    {"method": "rk4", "step": STEP},
    {"method": "velocity_verlet", "step": 0.037},
    {"method": "dop853", "rtol": 1e-6},
    {"method": "rk4", "step": 1.0},
]


@pytest.mark.every(3)
@pytest.mark.parametrize("asked", STEPS, ids=lambda one: f"{one['method']} {one.get('step', 'adaptive')}")
def test_random_functions_of_time(asked: dict[str, Any]) -> None:
    """Assert number, times, directions and kind of every event of random functions of time."""
    random = np.random.default_rng(10)
    assert faults([case(random) for _ in range(TOGETHER * 3)], **asked)[0] == []


def levels(random: np.random.Generator) -> tuple[float, float, float, float]:
    """An event function (x - c)*(a*x + b*v - d) of an oscillator: its coefficients, c often right below the crest."""
    c = 1 - 10.0 ** random.uniform(-6, -1) if random.integers(2) else random.uniform(-1, 1)
    a, b, d = random.uniform(-1, 1, 3).tolist()
    return float(c), a, b, d


def surprises(coefficients: list[tuple[float, float, float, float]], step: float) -> list[str]:
    """March an oscillator by rk4, whose steps are Taylor polynomials: compare the roots of those with the events."""
    model = particle(
        name="swing",
        parameters={"m": "1 kg", "k": "4 N m-1"},
        forces={"spring": {"x": "-k*x"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={
            f"e{i}": {"function": f"(x - {c!r}*metre)*({a!r}*x + {b!r}*v_x*second - {d!r}*metre)"}
            for i, (c, a, b, d) in enumerate(coefficients)
        },
    )
    run, found = xd.simulate(model, method="rk4", step=step, until=12.0), []
    events = set(zip(run.event_row_before.values.tolist(), run.event_detector.values.tolist(), strict=True))
    for row, (x, v, h) in enumerate(zip(run.x.values, run.v_x.values, run.step_size.values[1:], strict=False), 1):
        place = np.polynomial.Polynomial([x, v, -4 * x / 2, -4 * v / 6, 16 * x / 24])
        speed = np.polynomial.Polynomial([v, -4 * x, -4 * v / 2, 16 * x / 6, 16 * v / 24])
        for i, (c, a, b, d) in enumerate(coefficients if h else ()):
            roots = np.concatenate([(place - c).roots(), (a * place + b * speed - d).roots()])
            roots = roots[np.abs(roots.imag) < 1e-9].real
            inside = roots[(roots > 1e-8) & (roots < h - 1e-8)]
            at_end = (np.abs(roots - h) < 1e-7).any()
            crossed = [root for root in inside if ((place - c) * (a * place + b * speed - d)).deriv()(root) != 0]
            if crossed or ((row, i) in events) > at_end:
                found.append(f"row {row}, event {i}: roots {crossed}, ends at one: {at_end}, {coefficients[i]}")
    return found


@pytest.mark.every(3)
@pytest.mark.parametrize("step", [0.05, 0.3, 0.7])
def test_random_functions_of_the_state(step: float) -> None:
    """Assert that between two rows no event function has a root, and that each event is at one."""
    random = np.random.default_rng(12)
    assert surprises([levels(random) for _ in range(12)], step) == []


def test_a_rejected_trial_leaves_no_trace() -> None:
    """Assert that what a trial behind which the model ends showed of an event is not taken for its past."""
    found = xd.simulate(
        xd.Model(
            name="border",
            states={"s": {"unit": "1", "rate": f"sqrt(1 - {T})/second"}},
            initial={"s": "0"},
            events={
                "e": {
                    "function": f"(2 + cos(5*{T}))*({T} - 0.9403053134165189)*({T} - 0.9403053298763914)",
                    "direction": "falling",
                }
            },
        ),
        method="dop853",
        rtol=1e-2,
        until=2.0,
    )
    assert found.event_time.values == pytest.approx([0.9403053134165189], rel=1e-12)


def main(seed: int, count: int) -> None:
    """March past many more than a test has time for."""
    random, events, substeps, found = np.random.default_rng(seed), 0, 0, []
    for k in range(count // TOGETHER):
        more, located, tried = faults([case(random) for _ in range(TOGETHER)], **STEPS[k % len(STEPS)])
        found += more
        events, substeps = events + located, substeps + tried
        for one in more[:3]:
            print(k, STEPS[k % len(STEPS)], one, flush=True)
    print(f"{count} functions: {len(found)} faults, {events} events, {substeps / max(1, events):.1f} substeps each")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
