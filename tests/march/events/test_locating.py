"""The bracket of an event, narrowed by values and rates: where it looks, and what two events make of each other's looks."""

from __future__ import annotations

import math

import pytest

from cases.plain import Seen, plain, watching
from xdynamics.elementary.bounds import BREAKS, EPS, SMOOTH, UNBOUNDED
from xdynamics.march.events import root_finding, zero_tests
from xdynamics.schema import CLUSTER, CROSSING, JUMP, POLE, TOUCH

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
