"""Many detectors that fire within one step: each event costs as many substeps as it would alone, and none is missed.

A box around where the motion goes: what bounds a step in few operations, and which steps are inside.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

import xdynamics as xd
from cases.plain import between_states, made_by_hand, plain
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.events import enclosures
from xdynamics.march.events.enclosures import BOX, STANDS
from xdynamics.march.run import DETECTOR, ENCLOSE, WATCH, Run
from xdynamics.record import dataset
from xdynamics.schema import REASON_EVENT

METHODS = [
    {"method": "rk4", "step": 0.5},
    {"method": "dop853", "rtol": 1e-8},
    {"method": "velocity_verlet", "step": 0.13},
    {"method": "dormand_prince", "rtol": 1e-6, "atol": 1e-6},
    {"method": "kahan_li8", "step": 0.25},
]
DAMPED = [METHODS[0], METHODS[1], METHODS[3], {"method": "heun", "step": 0.1}]  # which take any force
MOST = 9  # substeps of an event, on the average over a run


class Detector(NamedTuple):
    """An event function of the way, and where it is zero from 0.05 to 2.95 m."""

    function: str
    roots: list[float]


def detector(random: np.random.Generator) -> Detector:
    """One of four shapes, of any size and sign."""
    root, size = float(random.uniform(0.05, 2.95)), float(10.0 ** random.uniform(-6, 6) * random.choice([-1, 1]))
    shape = random.integers(4)
    if shape == 0:
        return Detector(f"{size!r}*(x - {root!r}*metre)", [root])
    if shape == 1:
        return Detector(f"{size!r}*(exp(x/(1*metre)) - exp({root!r}))", [root])
    if shape == 2:
        other = float(random.uniform(-1, 5))
        roots = sorted(one for one in (root, other) if 0 < one < 3)
        return Detector(f"{size!r}*(x - {root!r}*metre)*(x - {other!r}*metre)", roots)
    rate = float(random.uniform(0.5, 4.0))
    turns = np.arange(-20, 20) * np.pi / rate + root
    return Detector(f"{size!r}*sin({rate!r}*(x/(1*metre) - {root!r}))", turns[(turns > 0) & (turns < 3)].tolist())


def passed_by(detectors: list[Detector], **asked: Any) -> Any:
    """March along x = t past all of them, with an oscillator beside it, so that steps are those of a motion."""
    model = xd.Model(
        name="passing",
        coordinates={"x": "m", "u": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m", "u": "m"},
        forces={"spring": {"u": "-k*u"}},
        initial={"x": "0 m", "v_x": "1 m s-1", "u": "1 m", "v_u": "0 m s-1"},
        events={f"e{i}": {"function": one.function} for i, one in enumerate(detectors)},
    )
    return xd.simulate(model, until=3.0, force_samples="none", **asked)


def substeps(run: Any) -> int:
    """All that were made; of events at one time each has the number of all."""
    _, first = np.unique(run.event_row_before.values, return_index=True)
    return int(run.event_substeps.values[first].sum())


@pytest.mark.every(3)
@pytest.mark.cases(400)
def test_detectors_of_one_step(case: int) -> None:
    """Assert every root of up to 40 detectors inside its bracket, at a cost that does not grow with how many there are."""
    random = np.random.default_rng([27, case])
    detectors, asked = [detector(random) for _ in range(random.integers(1, 41))], METHODS[case % len(METHODS)]
    run = passed_by(detectors, **asked)
    assert run.attrs["run_outcome"] == "completed"
    for i, one in enumerate(detectors):
        mine = run.isel(event=run.event_detector.values == i)
        low, high = mine.event_time_bounds.values.T
        assert mine.sizes["event"] == len(one.roots), one
        assert (low - 1e-13 <= one.roots).all(), one
        assert (one.roots <= high + 1e-13).all(), one
        assert (high - low <= 1.001e-12).all()
    assert substeps(run) <= MOST * run.sizes["event"]
    assert not (run.trial_reason.values == REASON_EVENT).any()


@pytest.mark.cases(60)
def test_the_order_of_the_search_changes_no_event(case: int) -> None:
    """Assert the events of version 0.2, which bracketed one detector after the other, and their states."""
    random = np.random.default_rng([28, case])
    detectors, asked = [detector(random) for _ in range(random.integers(2, 12))], METHODS[case % len(METHODS)]
    run, old = passed_by(detectors, **asked), passed_by(detectors, **asked, event_root_method="one by one")
    assert run.event_detector.values.tolist() == old.event_detector.values.tolist()
    assert run.event_kind.values.tolist() == old.event_kind.values.tolist()
    assert np.abs(run.event_time.values - old.event_time.values).max(initial=0.0) < 3e-12
    rows = run.event_row_after.values, old.event_row_after.values
    assert np.abs(run.u.values[rows[0]] - old.u.values[rows[1]]).max(initial=0.0) < 2e-11
    assert (old.trial_reason.values == REASON_EVENT).sum() >= substeps(old)


@pytest.mark.parametrize("rule", ["earliest first", "one by one"])
def test_location_uses_up_no_steps(rule: str) -> None:
    """Assert that a limit that rows and rejected trials keep is kept with 40 detectors, where version 0.2 used it up."""
    detectors = [Detector(f"x - {1 + 0.01 * i!r}*metre", [1 + 0.01 * i]) for i in range(40)]
    run = passed_by(detectors, method="dop853", rtol=1e-8, max_steps=200, event_root_method=rule)
    assert run.attrs["run_outcome"] == ("completed" if rule == "earliest first" else "step_limit")


def test_members_in_lanes_have_the_bits_of_runs_alone() -> None:
    """Assert that of members side by side each locates 40 events of a step as it does alone."""
    detectors = [Detector(f"x - {1 + 0.01 * i!r}*metre", [1 + 0.01 * i]) for i in range(40)]
    model = xd.Model.from_text(passed_by(detectors, **METHODS[0]).model_toml.values.item())
    asked = {"method": "rk4", "step": 0.5, "until": 3.0}
    speeds = np.linspace(0.5, 2.0, 24)
    found = xd.sweep(model, {"v_x": speeds}, keep=["end", "event_time_e7", "event_time_e39"], **asked)
    for k in (0, 11, 23):
        alone = xd.simulate(model.replace(initial={"v_x": f"{float(speeds[k])!r} m s-1"}), **asked)
        times = {i: alone.event_time.values[alone.event_detector.values == i] for i in (7, 39)}
        assert found.event_time_e7.values[k].ravel()[:1].tolist() == times[7][:1].tolist()
        assert found.end_u.values[k] == alone.u.values[-1]


def marched(model: xd.Model, asked: dict[str, Any], *, boxed: bool) -> tuple[Any, March]:
    """March with a region in which no event is looked for, or without one."""
    march = March(model, settings_for(model, **asked))
    if not boxed:
        march.run.put(box_variables=np.zeros((0, 3), np.int64))
    return dataset(march), march


@pytest.mark.cases(200)
def test_a_region_without_events_hides_none(case: int) -> None:
    """Assert the same rows and events, to the bit, whether or not steps inside a box are looked at one by one."""
    random = np.random.default_rng([29, case])
    a, b, c, w = random.uniform(-1, 1, (4, 6)).tolist()
    functions = [
        f"{a[0]!r}*u + {b[0]!r}*v_u*second - {c[0]!r}*metre",
        f"u - {1 - 10.0 ** random.uniform(-6, 0)!r}*metre",
        f"sin({5 * w[2]!r}*u/(1*metre) + {a[2]!r}) - {c[2]!r}",
        f"{a[3]!r}*q + {b[3]!r}*u - {c[3]!r}*metre",
        f"cos({3 * w[4]!r}*t/(1*second)) - {c[4]!r}*u/(1*metre)",
        f"abs(u) - {1.2 + c[5]!r}*metre",
    ]
    model = xd.Model(
        name="boxed",
        coordinates={"u": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1", "d": "0.05 N s m-1"},
        mass={"u": "m"},
        forces={"spring": {"u": "-k*u - d*v_u"}},
        states={"q": {"unit": "m", "rate": "v_u - q/(3*second)"}},
        initial={"u": "1 m", "v_u": "0 m s-1", "q": "0 m"},
        events={f"e{i}": {"function": function} for i, function in enumerate(functions[: random.integers(1, 7)])},
    )
    asked = DAMPED[case % len(DAMPED)] | {"until": 60.0, "force_samples": "none"}
    boxed, plain = (marched(model, asked, boxed=flag) for flag in (True, False))
    assert len(boxed[1].run.box_variables) > 0
    for name in ("time", "u", "v_u", "q", "event_time", "event_detector", "event_time_bounds", "event_substeps"):
        assert boxed[0][name].values.tobytes() == plain[0][name].values.tobytes(), name


def damped(function: str = "") -> xd.Model:
    """A damped oscillator that is let go, with an event function."""
    return xd.Model(
        name="damped",
        coordinates={"u": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1", "d": "0.05 N s m-1"},
        mass={"u": "m"},
        forces={"spring": {"u": "-k*u - d*v_u"}},
        initial={"u": "1 m", "v_u": "0 m s-1"},
        events={"level": {"function": function}} if function else {},
    )


@pytest.mark.cases(200)
def test_a_touch_is_found_once(case: int) -> None:
    """Assert that a function which comes as near to zero as a step is uncertain is not found to touch it again and again."""
    random = np.random.default_rng([31, case])
    a, b = random.uniform(-1, 1, 2).tolist()
    asked = {"method": ("heun", "bogacki_shampine", "midpoint", "rk4")[case % 4], "step": random.uniform(0.02, 0.1)}
    run = xd.simulate(damped(), **asked, until=60.0)
    value = a * run.u.values + b * run.v_u.values
    minima = np.flatnonzero((value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])) + 1
    level = float(value[random.choice(minima)] + random.uniform(-1, 1) * 10.0 ** random.uniform(-8, -2))
    run = xd.simulate(damped(f"{a!r}*u + {b!r}*v_u*second - {level!r}*metre"), **asked, until=60.0)
    assert run.attrs["run_outcome"] == "completed"
    sides = np.sign((value - level)[np.abs(value - level) > 0.2])  # more than a step of Heun's method is uncertain
    assert np.count_nonzero(np.diff(sides)) <= run.sizes["event"] <= 2 * len(minima) + 1
    assert np.diff(run.event_time.values).min(initial=1.0) > 1e-9


def test_a_box_stands_where_nothing_is_near() -> None:
    """Assert that the box of an oscillator stands at last, and holds all of its way."""
    model = passed_by([Detector("u - 1.5*metre", [])], method="rk4", step=0.5)
    model = xd.Model.from_text(model.model_toml.values.item())
    march = marched(model, {"method": "rk4", "step": 0.05, "until": 50.0}, boxed=True)[1]
    assert march.run.region[STANDS] == 1.0
    assert march.run.region[BOX] <= -1.0
    assert 1.0 <= march.run.region[BOX + 1] < 1.5


TURNS = {  # of a rotor at 1 rad s-2 from rest: q = t^2/2 is pi, 2 pi and 3 pi
    "mod(q, 2*pi) - pi": [np.pi, 2 * np.pi, 3 * np.pi],
    "q - 2*pi*floor(q/(2*pi)) - pi": [np.pi, 2 * np.pi, 3 * np.pi],
    "where(q < 2*pi, q, q - 2*pi) - 3": [3.0, 2 * np.pi, 3.0 + 2 * np.pi],
}
LONG = [
    *({"method": method, "step": "5 s"} for method in ("rk4", "taylor", "radau_iia", "velocity_verlet")),
    *({"method": method} for method in ("taylor", "dormand_prince", "dop853")),
]


@pytest.mark.parametrize("beside", ["", "q - 2*pi", "q - 1"])
@pytest.mark.parametrize("function", TURNS)
@pytest.mark.parametrize("how", LONG, ids=lambda how: " ".join(how.values()))
def test_a_jump_and_roots_within_one_step(how: dict[str, str], function: str, beside: str) -> None:
    """Assert that a step over a revolution finds all passages, the jump beside another event at its place too."""
    model = xd.Model(
        name="rotor",
        coordinates={"q": "rad"},
        parameters={"J": "1 kg m2"},
        mass={"q": "J"},
        forces={"motor": {"q": "1*newton*metre"}},
        initial={"q": "0 rad", "v_q": "0 rad s-1"},
        events={"turn": {"function": function}} | ({"beside": {"function": beside}} if beside else {}),
    )
    run = xd.simulate(model, until="5 s", **how)
    found = run.dynamics.events("turn")
    assert found["event_time"].values == pytest.approx(np.sqrt(2.0 * np.array(TURNS[function])), abs=5e-12)
    assert found["event_kind"].values.tolist() == [0, 2, 0]


@pytest.mark.parametrize("method", ["forward_euler", "euler_cromer", "heun"])
def test_a_ball_that_errors_carry_through_the_floor_is_told(method: str) -> None:
    """Assert that a reset which turns a motion back too late, so that it falls through, is warned of."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"gravity": {"y": "-m*g"}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
        events={"floor": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-0.5*v_y"}}},
    )
    with pytest.warns(
        xd.AccuracyWarning, match="'floor' set the motion back when errors of steps had carried it through"
    ):
        run = xd.simulate(ball, method=method, until="3 s", rtol=2.5e-4)
    assert float(run["y"][-1]) < -1.0


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
