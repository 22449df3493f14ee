"""The bracket of an event, narrowed by values and rates: where it looks, and what two events make of each other's looks.

How near to the zero of its function the state of an event is, where that is asked for.
Events located on shortened steps, or on the interpolant of the whole one.
"""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball, words
from cases.plain import Seen, plain, watching
from cases.problems import particle
from xdynamics.elementary.bounds import BREAKS, EPS, SMOOTH, UNBOUNDED
from xdynamics.march.events import root_finding, zero_tests
from xdynamics.schema import CLUSTER, CROSSING, EVENT_POSITIONS, JUMP, POLE, TOUCH

TOLERANCE = 1e-9


def inverse_cubic(root: float, side: float, h: float) -> Seen:
    """Return a function whose time is a cubic of its value v: root + (v + b v**2 + c v**3)/a, solved for v by Newton."""
    a, b, c = -2.0 * side, 0.2 / side, 0.3

    def value(s: float) -> float:
        v = a * (s - root)
        for _ in range(50):
            v -= (root + (v + b * v * v + c * v**3) / a - s) / ((1.0 + 2.0 * b * v + 3.0 * c * v * v) / a)
        return v

    def rate(s: float) -> float:
        v = value(s)
        return a / (1.0 + 2.0 * b * v + 3.0 * c * v * v)

    return Seen(lambda s: value(s) * h, lambda s: rate(s) * h)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(("low", "high"), [(0.0, 1.0), (0.25, 0.875), (-3.0, 2.0)])
def test_hermite_is_exact_where_time_is_a_cubic_of_the_value(side: float, low: float, high: float) -> None:
    """Assert the root by values and rates at both ends, wherever it lies; the middle where a rate goes the other way."""
    search = plain(root_finding.hermite)
    for share in (0.1, 0.37, 0.8):
        root = low + share * (high - low)
        one = inverse_cubic(root, side, 3.0)
        ends = [one.value(low), one.value(high)]
        assert search(low, high, *ends, one.rate(low), one.rate(high)) == pytest.approx(root, abs=1e-13)
        for rates in ((-one.rate(low), one.rate(high)), (one.rate(low), -one.rate(high)), (0.0, one.rate(high))):
            assert search(low, high, *ends, *rates) == (low + high) / 2.0
    assert search(low, high, side, -side, -side * 1e-3, -side * 1e3) == (low + high) / 2.0  # beyond the bracket


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("t", [0.0, -3.0, 7.0])
def test_a_smooth_root_is_found_by_two_looks(side: float, t: float) -> None:
    """Assert where it is looked: a hair behind the root that values and rates give, and just inside the tolerance before it."""
    root, h = 0.3, 1.5
    run, looks = watching(inverse_cubic(root, side, 3.0), t=t, h=h)
    plain(root_finding.locate_events)(run)
    hair = 2.0 * EPS * max(abs(t), abs(t + h)) / 16.0
    assert len(looks) == 2
    assert looks[0] == pytest.approx(root + hair, abs=4 * EPS)
    assert looks[1] == pytest.approx(looks[0] - 0.9 * TOLERANCE, abs=4 * EPS)
    assert (run.trial[0].h, run.watches[0].left) == (looks[0], looks[1])
    assert run.watches[0].before == inverse_cubic(root, side, 3.0).value(looks[1])


SHAPES = {
    "steep": Seen(lambda s: math.expm1(9.0 * (s - 0.7)), lambda s: 9.0 * math.exp(9.0 * (s - 0.7))),
    "wave": Seen(lambda s: math.sin(2.5 * (0.4 - s)), lambda s: -2.5 * math.cos(2.5 * (0.4 - s))),
    "flat": Seen(lambda s: (0.6 - s) ** 3, lambda s: -3.0 * (0.6 - s) ** 2),
    "bow": Seen(lambda s: s * s - 1e-6, lambda s: 2.0 * s),
}
LOOKS = {"steep": 11, "wave": 6, "flat": 64, "bow": 40}  # bisection takes 30


@pytest.mark.parametrize("name", SHAPES)
def test_other_roots_take_few_looks(name: str) -> None:
    """Assert that a bracket is within its tolerance about the root, by few looks of a smooth function."""
    one, root = SHAPES[name], {"steep": 0.7, "wave": 0.4, "flat": 0.6, "bow": 1e-3}[name]
    run, looks = watching(one)
    plain(root_finding.locate_events)(run)
    assert run.watches[0].left < root <= run.trial[0].h + 1e-12
    assert run.trial[0].h - run.watches[0].left <= TOLERANCE
    assert len(looks) <= LOOKS[name]


@pytest.mark.parametrize("place", [1e-6, 1e-13])
def test_a_place_is_asked_for_at_the_far_end(place: float) -> None:
    """Assert that the value behind the root is within its tolerance, however wide that of time is; no look more than that takes."""
    run, looks = watching(SHAPES["wave"], tolerance=0.5, place=place)
    plain(root_finding.locate_events)(run)
    assert 0.0 <= -run.g1[0] <= place
    assert 0.0 < run.trial[0].h - run.watches[0].left <= 0.5
    assert len(looks) == (4 if place > 1e-10 else 5)


def test_a_side_that_is_all_that_is_known_is_looked_at_in_the_middle() -> None:
    """Assert that a value which is too small to be believed counts as one of the size at the other end."""
    run, looks = watching(Seen(lambda s: max(0.0, 0.25 - s) - 0.1 * max(0.0, s - 0.5), lambda _: -1.0))
    run.watches[0].left, run.watches[0].before = 0.0, math.nan
    run.g[0], run.watches[0].broken = 0.0, BREAKS
    plain(root_finding.narrow_bracket)(run, 0, 0.0)
    assert looks[0] == 0.5


def test_a_look_for_one_event_raises_the_bracket_of_another() -> None:
    """Assert how often two close events are looked at: each look at one that precedes the other narrows that one too."""
    early = Seen(lambda s: 0.6 - s, lambda _: -1.0)
    late = Seen(lambda s: 0.6001**5 - s**5, lambda s: -5.0 * s**4)
    for functions in ((early, late), (late, early)):
        run, looks = watching(*functions)
        plain(root_finding.locate_events)(run)
        assert looks[0] == 0.5  # of the later one, whose rate begins at 0 and so seems to be the first
        hair = EPS / 8.0
        assert looks[-2:] == pytest.approx([0.6 + hair, 0.6 + hair - 0.9 * TOLERANCE], abs=2 * EPS)
        assert len(looks) == 9
        assert run.trial[0].h == looks[-2]
        hits = {early: zero_tests.CROSSED, late: zero_tests.NONE}
        assert [watch.hit for watch in run.watches] == [hits[function] for function in functions]


def test_a_value_that_is_not_known_is_looked_at_again() -> None:
    """Assert that the left end of a bracket inside the step is looked at first, and that the step's start is not."""
    for left, first in ((0.25, 0.25), (0.0, 0.3 + EPS / 8.0)):
        run, looks = watching(inverse_cubic(0.3, 1.0, 3.0))
        run.watches[0].before = math.nan
        plain(root_finding.narrow_bracket)(run, 0, left)
        assert looks[0] == pytest.approx(first, abs=4 * EPS)


@pytest.mark.parametrize("t", [-1.0, 0.0, 1.0])
def test_events_at_one_time_but_for_rounding_are_one_group(t: float) -> None:
    """Assert that an event 6 roundings behind the first is in its trial, whatever the tolerance; one at 40 is left for later."""
    for behind, both in ((6.0, True), (40.0, False)):
        roots = [1.0, 1.0 + behind * EPS]
        one, other = (Seen(lambda s, root=root: root - s, lambda _: -1.0) for root in roots)
        run, _ = watching(one, other, t=t, h=1.5, tolerance=0.0)
        plain(root_finding.locate_events)(run)
        assert (run.watches[1].hit == zero_tests.CROSSED) == both
        assert (run.trial[0].h >= roots[1]) == both


def test_events_within_a_tolerance_are_one_group() -> None:
    """Assert that an event that follows within its own tolerance is in the trial, and is as near to its place as it asks."""
    one, other = Seen(lambda s: 0.5 - s, lambda _: -1.0), Seen(lambda s: 0.5 + 4e-9 - s, lambda _: -1.0)
    for place, both in ((math.inf, True), (1e-10, False)):
        run, _ = watching(one, other, tolerance=1e-8)
        run.detectors[0].tolerance, run.detectors[0].position = 1e-13, place
        plain(root_finding.locate_events)(run)
        assert (run.watches[1].hit == zero_tests.CROSSED) == both


@pytest.mark.parametrize("t", [-0.5, 0.0, 20.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_what_is_left_of_a_gap_is_rounding(side: float, t: float) -> None:
    """Assert that the end of a bracket is moved next to the zero by the secant of its ends."""
    root, high = 0.5, 0.5 + 7e-10
    run, looks = watching(Seen(lambda s: side * (0.5 - s), lambda _: -side), t=t)
    watch = run.watches[0]
    watch.left, watch.right, watch.before = 0.5 - 3e-10, high, side * 3e-10
    plain(root_finding.polish)(run, 0, -side * 7e-10)
    hair = 2.0 * EPS * max(abs(t), abs(t + high))
    assert looks == [pytest.approx(root + hair, abs=2 * EPS)]
    assert watch.right == run.located[0].h == looks[0]
    watch.right = high
    plain(root_finding.polish)(run, 0, 0.0)  # without a value to go by, it is the left end
    assert looks[1:] == [pytest.approx(watch.left + hair, abs=EPS)]
    assert watch.right == high  # where it has not happened yet


@pytest.mark.parametrize(
    ("before", "after", "change", "kind"),
    [
        (1.0, -1.0, {}, CROSSING),
        (1.0, -1.0, {"hit": zero_tests.FORCED}, CLUSTER),
        (1.0, -1.0, {"hit": zero_tests.TOUCHED}, TOUCH),
        (1.0, -1.0, {"hit": zero_tests.ENDED}, TOUCH),
        (1.0, -1.0, {"broken": BREAKS}, JUMP),
        (1e-8, -1e-8, {"broken": BREAKS}, CROSSING),
        (1e-8, -0.9e-7, {"broken": BREAKS}, CROSSING),
        (1e-8, -1.1e-7, {"broken": BREAKS}, JUMP),
        (1e5, -1e5, {"broken": UNBOUNDED}, POLE),
        (1e5, -10.0, {"broken": UNBOUNDED}, JUMP),
    ],
)
def test_kinds_go_by_what_a_slope_explains(before: float, after: float, change: dict[str, int], kind: int) -> None:
    """Assert the kind of an event by its values on both sides, with a slope of 1 over a bracket of 1e-9."""
    run, _ = watching(Seen(lambda s: 0.5 - s, lambda _: -1.0))
    watch = run.watches[0]
    watch.left, watch.right, watch.before, watch.greatest, watch.broken = 0.5, 0.5 + 1e-9, before, 1.0, SMOOTH
    for name, value in change.items():
        run.watches[name] = value
    run.g1[0], run.slopes[0] = after, -1.0
    assert plain(root_finding.event_kind)(run, 0) == kind


@pytest.mark.parametrize(
    ("jump", "up", "full", "kind"),
    [(0.9e-3, 8.0, 1.0, CROSSING), (1.1e-3, 8.0, 1.0, JUMP), (0.75, 8e6, 1e-6, CROSSING), (0.85, 8e6, 1e-6, JUMP)],
)
def test_kinds_of_sampled_functions_go_by_looks(jump: float, up: float, full: float, kind: int) -> None:
    """Assert that a change is a jump if it is more than a thousandth of that between looks, and than its slope explains."""
    run, _ = watching(Seen(lambda s: 0.5 - s, lambda _: -1.0))
    watch = run.watches[0]
    run.detectors[0].sampled, run.piece[0].full = 1, full
    watch.left, watch.right, watch.before, watch.greatest, watch.up = 0.5, 0.5 + 1e-9, jump / 2.0, 1.0, up
    run.g1[0] = -jump / 2.0
    assert plain(root_finding.event_kind)(run, 0) == kind


def test_slack_is_a_power_of_two_tolerances() -> None:
    """Assert the first halving that leaves a bracket within its tolerance."""
    reach = plain(root_finding.bisection_reach)
    assert [reach(width, 0.25) for width in (0.2, 0.25, 0.3, 0.5, 1.9, 2.0, 2.1)] == [
        0.25,
        0.25,
        0.5,
        0.5,
        2.0,
        2.0,
        4.0,
    ]


def test_points_at_the_ends_go_inside() -> None:
    """Assert a tolerance, or the middle where that is nearer."""
    inside = plain(root_finding.point_inside)
    assert [inside(s, 1.0, 2.0, 0.25) for s in (0.5, 1.0, 1.1, 2.0, 3.0)] == [1.25, 1.25, 1.1, 1.75, 1.75]
    assert [inside(s, 1.0, 2.0, 0.75) for s in (1.0, 2.0)] == [1.5, 1.5]


def swing(events: dict[str, Any]) -> xd.Model:
    """A mass on a spring, x = sin(t), whose events are looked for no better than to 1 ms, or as they say."""
    return particle(
        name="swing",
        parameters={"m": "1 kg", "k": "1 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={name: {"time_tolerance": "1 ms"} | event for name, event in events.items()},
    )


@pytest.mark.cases(300)
def test_events_are_as_near_as_is_asked(case: int) -> None:
    """Assert |x - level| in the rows themselves, whatever the time tolerance, also of levels passed within it of each other."""
    random = np.random.default_rng(case)
    level, asked = random.uniform(-0.9, 0.9), float(10.0 ** random.uniform(-12, -2))
    beside = level + float(10.0 ** random.uniform(-9, -3))
    within = {"position_tolerance": f"{asked!r} m", "root_state": ("reintegrate", "interpolant")[case % 2]}
    model = swing(
        {
            "one": {"function": f"x - ({level!r}*metre)"} | within,
            "other": {"function": f"x - ({beside!r}*metre)"} | within,
            "free": {"function": "x + 0.95*metre"},
        }
    )
    method = ("rk4", "dop853", "velocity_verlet", "dormand_prince")[case // 2 % 4]
    run = xd.simulate(model, method=method, step=float(random.uniform(0.05, 0.4)), until=7.0)
    names = [name for name, _ in words(run)]
    levels = {"one": level, "other": beside, "free": -0.95}
    off = np.abs(run.x.values[run.event_row_before.values] - [levels[name] for name in names])
    mine = np.array([name != "free" for name in names])
    assert mine.sum() >= 4
    assert (off[mine] <= asked + 1e-15).all()
    assert np.abs(run.event_residual.values) == pytest.approx(off, abs=1e-15)
    met = run.event_position.attrs["flag_meanings"].split()
    assert [met[one] for one in run.event_position.values] == ["met" if one else "not_asked" for one in mine]
    width = (run.event_time_bounds[:, 1] - run.event_time_bounds[:, 0]).values
    assert (width <= 2e-3).all()  # one that follows within the time tolerance is waited for


@pytest.mark.cases(100)
def test_impacts_are_as_near_as_is_asked(case: int) -> None:
    """Assert the gap at every impact of a ball, located to 1 ms or to micrometres and less, and what the ball then does."""
    random = np.random.default_rng(case)
    asked, e = float(10.0 ** random.uniform(-13, -4)), float(random.uniform(0.3, 0.9))
    tolerances = {"time_tolerance": "1 ms", "position_tolerance": f"{asked!r} m"}
    run = xd.simulate(ball(e, **tolerances), method="rk4", step=float(random.uniform(0.01, 0.2)), until=1.2)
    impacts = np.array([kind == "impact" for _, kind in words(run)])
    gaps = run.contact_gap_floor.values[run.event_row_before.values[impacts]]
    assert impacts.sum() >= 1
    assert (np.abs(gaps) <= asked).all()
    fall = math.sqrt(2 * 9.81)
    assert float(run.v_y[int(run.event_row_after[0])]) == pytest.approx(e * fall, abs=2 * asked * 9.81 / fall + 1e-12)


def test_what_rounding_forbids_is_said() -> None:
    """Assert that the best state is taken, with a warning, the outcome and a flag that say so; to be extended too."""
    model = ball(0.5, position_tolerance="1e-40 m")
    asked = {"method": "rk4", "step": 0.05, "time_tolerance": 1e-12}
    with pytest.warns(xd.AccuracyWarning, match="the position tolerance of 'floor' was not met by every event"):
        run = xd.simulate(model, until=2.0, nodes=[1.0], **asked)
    assert "event_position says where" in run.attrs["run_outcome_text"]
    assert np.abs(run.event_residual.values).max() < 1e-14
    assert EVENT_POSITIONS.index("not_met") in run.event_position.values
    with pytest.warns(xd.AccuracyWarning, match="position tolerance"):
        longer = xd.extend(xd.simulate(model, until=1.0, **asked), until=2.0)
    assert xd.content_digest(longer) == xd.content_digest(run)


def test_where_it_is_not_asked_for_nothing_changes() -> None:
    """Assert the same numbers with a tolerance that is met anyway, and no variable of it without one."""
    run, same = (
        xd.simulate(one, method="rk4", step=0.05, until=2.0) for one in (ball(), ball(position_tolerance="1 m"))
    )
    assert run.y.values.tolist() == same.y.values.tolist()
    assert run.event_time.values.tolist() == same.event_time.values.tolist()
    assert "event_position" not in run
    assert "event_position" in same


def test_runs_side_by_side_are_located_alike() -> None:
    """Assert that members of a sweep have the events that they have alone."""
    model = ball(0.5, time_tolerance="1 ms", position_tolerance="1 nm")
    grid = xd.sweep(
        model,
        {"y": ["0.5 m", "1 m", "2 m", "3 m"]},
        keep=["event_time_floor"],
        method="dop853",
        rtol=1e-8,
        until="1.5 s",
    )
    for height in (0.5, 1.0, 2.0, 3.0):
        alone = xd.simulate(
            ball(0.5, height, time_tolerance="1 ms", position_tolerance="1 nm"),
            method="dop853",
            rtol=1e-8,
            until="1.5 s",
        )
        assert float(grid.event_time_floor.sel(y=height)) == float(alone.event_time[0])


def test_it_stands_in_model_and_record() -> None:
    """Assert the round trip through a file, and what the record says of events and contacts, defaults included."""
    events = {"apex": {"function": "v_y", "position_tolerance": "1 mm s-1"}, "half": {"function": "y - 0.5*metre"}}
    model = xd.Model(**tomllib.loads(ball(0.5, position_tolerance="1 nm").to_toml()) | {"events": events})
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model, method="rk4", step=0.05, until=1.0)
    about = run.event_detector.attrs
    assert about["position_tolerances"] == "apex: 1.0 mm s-1; half: none, what the time tolerance leaves"
    assert about["contact_position_tolerances"] == "floor: 1.0 nm"
    assert run.contact_force_floor.attrs["position_tolerance"] == "1.0 nm"
    assert np.abs(run.event_residual.values[[name == "apex" for name, _ in words(run)]]).max() <= 1e-3


@pytest.mark.parametrize(
    ("owner", "given", "said"),
    [
        ("events", "1 s", "event 'low': position_tolerance is '1.0 s', needs the unit of the function, 'm'"),
        ("contacts", "1 s", "contact 'floor': position_tolerance is '1.0 s', needs the unit of the gap, 'm'"),
        ("contacts", "0 m", "position_tolerance is '0.0 m', needs a positive quantity"),
        ("events", "-1 um", "needs a positive quantity"),
        ("events", 1e-6, "needs the unit of the function, 'm'"),
        ("contacts", "near", "does not start with a finite number"),
        ("frictions", "1 um", "key 'position_tolerance' is not known"),
    ],
)
def test_wrong_tolerances_are_named(owner: str, given: Any, said: str) -> None:
    """Assert one clear fault for each, with its value and what is needed."""
    table = tomllib.loads(ball(0.5).to_toml())
    table["events"] = {"low": {"function": "y"}}
    table["frictions"] = {"air": {"slip": "v_y", "kinetic": "1*newton"}}
    (table[owner][next(iter(table[owner]))])["position_tolerance"] = given
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(**table)


def test_rules_of_contacts_stand_where_those_of_detectors_do() -> None:
    """Assert gap, law, restitution, tangential rule and tolerances of contacts, and the rule of dry friction."""
    table = tomllib.loads(ball(0.5, law="poisson", rest_height="1 nm", time_tolerance="1 ps").to_toml())
    table["contacts"]["floor"] |= {"tangential": "coulomb", "slip": "v_x", "friction": 0.3, "static": 0.4}
    table["contacts"]["roof"] = {"gap": "9*metre - y", "restitution": "0.1", "law": "poisson"}
    table["frictions"] = {"rail": {"slip": "v_x", "kinetic": "1*newton"}}
    table["coordinates"]["x"], table["mass"]["x"] = {"unit": "m"}, "m"
    table["initial"] |= {"x": "0 m", "v_x": "1 m s-1"}
    about = xd.simulate(xd.Model(**table), method="rk4", step=0.1, until=0.2).event_detector.attrs
    assert {key: value for key, value in about.items() if key.startswith(("contact", "friction"))} == {
        "contact_gaps": "floor: y; roof: 9*metre - y",
        "contact_laws": "floor: poisson; roof: poisson",
        "contact_restitutions": "floor: 0.5; roof: 0.1",
        "contact_tangential_rules": "floor: coulomb, slip v_x, friction 0.3, static 0.4; roof: frictionless",
        "contact_rest_heights": "floor: 1.0 nm; roof: 1e-9 of the largest gap so far",
        "contact_time_tolerances": "floor: 1.0 ps; roof: solver_time_tolerance",
        "contact_position_tolerances": "floor: none, what the time tolerance leaves; roof: none, what the time tolerance leaves",
        "friction_rules": "rail: slip v_x, kinetic 1*newton, static 1*newton",
        "friction_time_tolerances": "rail: solver_time_tolerance",
    }


def crossing(root_state: str, **more: Any) -> xd.Model:
    """An oscillator that crosses 0.3 m."""
    return particle(
        name="oscillator",
        parameters={"m": "1 kg", "k": "4 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={"c": {"function": "x - 0.3*metre", "root_state": root_state} | more},
    )


def times(count: int) -> np.ndarray:
    """When it does."""
    phase = math.acos(0.3)
    return (
        np.sort(np.concatenate([phase + 2 * np.pi * np.arange(99), -phase + 2 * np.pi * np.arange(1, 99)]))[:count] / 2
    )


@pytest.mark.parametrize("method", ["dop853", "dormand_prince", "bogacki_shampine", "radau_iia"])
def test_the_interpolant_is_part_of_the_uncertainty(method: str) -> None:
    """Assert that both find every crossing, apart by no more than the part that is recorded, which only one of them has."""
    runs = {
        name: xd.simulate(crossing(name), method=method, rtol=1e-7, until=1.0)
        for name in ("reintegrate", "interpolant")
    }
    one, other = runs["reintegrate"], runs["interpolant"]
    assert one.sizes["event"] == other.sizes["event"] == 1
    assert (one.event_time_uncertainty_interpolation.values == 0).all()
    drift = float(other.event_time_uncertainty_interpolation[0])
    assert 0 < drift < 1e-5
    assert abs(float(one.event_time[0] - other.event_time[0])) <= 1.5 * drift + 1e-11
    assert float(other.event_time_uncertainty[0]) >= drift
    assert int(other.event_substeps[0]) < int(one.event_substeps[0])


@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "pefrl"])
def test_every_crossing_is_found_on_the_interpolant(method: str) -> None:
    """Assert times within the method's own error, for fixed steps of half a second."""
    run = xd.simulate(crossing("interpolant"), method=method, step=0.02, until=20.0)
    assert run.event_time.values == pytest.approx(times(run.sizes["event"]), abs=3e-3)
    assert run.sizes["event"] == 13
    assert np.abs(run.event_residual.values).max() < 1e-11


def test_the_word_is_kept_and_others_are_refused() -> None:
    """Assert the file's word, and the choice in the error."""
    model = crossing("interpolant")
    assert xd.Model.from_text(model.to_toml()) == model
    with pytest.raises(xd.ModelError, match="root_state 'guess' is not known; there are reintegrate, interpolant"):
        crossing("guess")
