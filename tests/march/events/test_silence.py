"""A box around where the motion goes: what bounds a step in few operations, and which steps are inside."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.plain import between_states, made_by_hand, plain
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.events import enclosures
from xdynamics.march.run import DETECTOR, ENCLOSE, WATCH, Run


@pytest.mark.cases(400)
def test_the_way_of_a_step_holds_its_enclosure(case: int) -> None:
    """Assert quick bounds of a random step outside those of the enclosure, by no more than signs that differ may cost."""
    random = np.random.default_rng([26, 8, case])
    run = made_by_hand(n=2)
    h = 10.0 ** random.uniform(-3, 1)
    a = random.normal(size=2) * [0, 1, 3 / h][case % 3]  # the last ones turn within the step
    run.y[4:], run.z[4:], run.y[2:4], run.y[:2] = a, a, random.normal(size=2), random.normal(size=2)
    run.z[2:4], run.z[:2] = run.y[2:4] + h * a, run.y[:2] + h * run.y[2:4] + h * h / 2 * a
    run.z[:] += random.normal(size=6) * 10.0 ** random.uniform(-9, 1)
    run.trial[0].h = h
    for i in range(2):
        low, high = plain(enclosures.coordinate_bounds)(run, i)
        enclosure = between_states("position", run.y, run.z, (i, 2 + i, 4 + i), h)
        (q0, v0, a0), (q1, v1, a1) = run.y[i::2], run.z[i::2]
        apart = max(min(0.4 * h * abs(v0), h * h * abs(a0) / 20), min(0.4 * h * abs(v1), h * h * abs(a1) / 20))
        apart += 3e-9 * (max(abs(q0), abs(q1)) + h * (abs(v0) + abs(v1)) + h * h * (abs(a0) + abs(a1)))
        assert low < enclosure.low <= low + apart
        assert high > enclosure.high >= high - apart


def test_a_step_is_inside_by_all_that_functions_are_made_of() -> None:
    """Assert for two positions and the time that a step is inside a box, and is not once any side of it is too near."""
    model = xd.Model(
        name="plane",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass={"x": "m", "y": "m"},
        forces={"spring": {"potential": "k*(x**2 + y**2)/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1", "y": "0 m", "v_y": "0.5 m s-1"},
        events={
            "far": {"function": "x - 3*metre"},
            "wide": {"function": "y + 2*metre"},
            "late": {"function": "t - 90*second"},
        },
    )
    run, inside = (
        March(model, settings_for(model, method="rk4", step=0.05, until=0.5)).run,
        plain(enclosures.stays_in_region),
    )
    run.y[:6], run.z[:6] = (1.0, 0.0, 0.0, 0.5, -1.0, 0.0), (0.99875, 0.025, -0.05, 0.499, -0.99875, -0.025)
    run.now[0].t, run.trial[0].t, run.trial[0].h = 2.0, 2.05, 0.05
    n, first = len(run.box_variables), enclosures.BOX
    assert sorted(run.box_variables[:, 0].tolist()) == [
        enclosures.POSITION,
        enclosures.POSITION,
        enclosures.INSTANT,
    ]
    for j, (sort, k, _) in enumerate(run.box_variables.tolist()):
        bounds = (
            plain(enclosures.coordinate_bounds)(run, k)
            if sort == enclosures.POSITION
            else (run.now[0].t, run.trial[0].t)
        )
        run.region[first + j], run.region[first + n + j] = min(bounds), max(bounds)
    run.region[enclosures.STANDS] = 1.0
    assert inside(run)
    for side in range(2 * n):
        held = run.region[first + side]
        run.region[first + side] = np.nextafter(held, np.inf if side < n else -np.inf)
        assert not inside(run)
        run.region[first + side] = held
    run.region[enclosures.STANDS] = 0.0
    assert not inside(run)


@pytest.mark.parametrize(
    ("joined", "low", "high"),
    [(False, [-0.5, 8.0, -3.5], [1.5, 16.0, 0.5]), (True, [-1.0, 9.0, -3.5], [1.5, 20.0, -0.5])],
)
@pytest.mark.parametrize(
    ("armed", "guard", "asleep", "value", "silent"),
    [
        (1, 0, 0, (0.1, 2.0), True),
        (-1, 0, 0, (-2.0, -0.1), True),
        (1, 1, 0, (0.1, 2.0), True),
        (1, -1, 0, (0.1, 2.0), False),
        (-1, 0, 0, (0.1, 2.0), False),
        (1, 0, 0, (-2.0, -0.1), False),
        (1, 0, 0, (0.0, 2.0), False),
        (-1, 0, 0, (-2.0, 0.0), False),
        (0, 0, 0, (0.1, 2.0), False),
        (0, 0, 1, (-1.0, 2.0), True),
    ],
)
def test_a_box_reaches_beyond_a_step(
    monkeypatch: pytest.MonkeyPatch,
    joined: bool,
    low: list[float],
    high: list[float],
    armed: int,
    guard: int,
    asleep: int,
    value: tuple[float, float],
    silent: bool,
) -> None:
    """Assert half a width beyond bounds on every side, or where they leave the last box, if nothing is zero in it."""
    positions = np.array([[enclosures.POSITION, j, 1 + j] for j in range(3)])
    run = made_by_hand(
        box_variables=positions,
        region=np.zeros(enclosures.BOX + 12),
        under=np.zeros(4),
        over=np.zeros(4),
        detectors=np.zeros(1, DETECTOR),
        watches=np.zeros(1, WATCH),
        parts=np.zeros(4, np.int64),
        functions=np.zeros(ENCLOSE + 1, np.int64),
    )
    is_silent = plain(enclosures.is_silent)
    monkeypatch.setitem(is_silent.__globals__, "enclosed_by", lambda *_: None)
    (run.under[0], run.over[0]), watch = value, run.watches[0]
    watch.armed, watch.guard, watch.asleep = armed, guard, asleep
    before = [-1.0, 9.0, -2.0, 0.8, 20.0, -0.5]
    run.region[enclosures.BOX :] = [*before, 0.0, 10.0, -2.5, 1.0, 14.0, -0.5]
    assert is_silent(run, 0.5, joined) == silent
    wanted = [*low, *high] if silent else before
    assert run.region[enclosures.BOX :][:6].tolist() == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("before", "answers", "asked", "after"),
    [  # whether there is one, how far it reaches, the last pause and how long it still is; tries; the same behind
        ((0, 0, 0, 3), [], [], (0, 0, 0, 2)),
        ((0, 0, 0, 0), [1], [(0.5, False)], (1, 1, 1, 0)),
        ((0, 8, 4, 0), [1], [(8.0, False)], (1, 16, 1, 0)),
        ((0, 48, 4, 0), [1], [(48.0, False)], (1, 64, 1, 0)),
        ((0, 8, 4, 0), [0], [(8.0, False)], (0, 2, 8, 8)),
        ((0, 0, 0, 0), [0], [(0.5, False)], (0, 0, 2, 2)),
        ((0, 8, 12, 0), [0], [(8.0, False)], (0, 2, 16, 16)),
        ((1, 8, 1, 0), [1], [(0.5, True)], (1, 8, 1, 0)),
        ((1, 8, 1, 0), [0, 1], [(0.5, True), (0.0625, True)], (1, 8, 1, 0)),
        ((1, 8, 1, 0), [0, 0, 1], [(0.5, True), (0.0625, True), (8.0, False)], (1, 16, 1, 0)),
        ((1, 8, 1, 0), [0, 0, 0], [(0.5, True), (0.0625, True), (8.0, False)], (0, 2, 2, 2)),
    ],
)
def test_a_box_grows_or_another_one_is_tried(
    monkeypatch: pytest.MonkeyPatch,
    before: tuple[float, ...],
    answers: list[int],
    asked: list[tuple[float, bool]],
    after: tuple[float, ...],
) -> None:
    """Assert which boxes are tried, how far the next one reaches, and for how long none is tried where none would do."""
    leaves = np.array([[enclosures.POSITION, 0, 1], [enclosures.OTHER, 1, 0]])
    run = made_by_hand(
        box_variables=leaves,
        region=np.zeros(enclosures.BOX + 8),
        under=np.array([-2.0, 7.0]),
        over=np.array([3.0, 8.0]),
    )
    set_region, tried, left = plain(enclosures.set_region), [], list(answers)

    def is_silent(run: Run, reach: float, joined: bool) -> bool:
        tried.append((reach, joined, int(run.piece[0].rough)))
        return bool(left.pop(0))

    monkeypatch.setitem(set_region.__globals__, "is_silent", is_silent)
    monkeypatch.setitem(set_region.__globals__, "coordinate_bounds", lambda _run, k: (10.0 + k, 20.0 + k))
    run.region[: enclosures.BOX] = before
    set_region(run)
    assert tried == [(*one, 2) for one in asked]
    assert run.region[: enclosures.BOX].tolist() == list(after)
    assert run.piece[0].rough == 0
    assert run.region[enclosures.BOX + 4 :].tolist() == ([10.0, -2.0, 20.0, 3.0] if asked else [0.0] * 4)


def test_a_region_ends_where_there_is_one() -> None:
    """Assert that the box is forgotten of a run whose event functions have one, and that others are left alone."""
    run = made_by_hand(box_variables=np.zeros((1, 3), np.int64), region=np.ones(enclosures.BOX))
    plain(enclosures.end_region)(run)
    assert run.region[enclosures.STANDS] == 0.0
    run = made_by_hand(box_variables=np.zeros((0, 3), np.int64), region=np.ones(enclosures.BOX))
    plain(enclosures.end_region)(run)
    assert run.region[enclosures.STANDS] == 1.0
