"""What values, slopes and sides tell of an event function on a piece of a trial, as plain Python on a run made by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from cases.plain import Seen, plain, watching
from xdynamics.elementary.bounds import BREAKS, EPS, SMOOTH, UNBOUNDED
from xdynamics.march.events import departures, isolation, zero_tests
from xdynamics.march.events.zero_tests import CLEAR, CROSSED, ENDED, FORCED, MONOTONE, MURKY, NONE, OPEN, TOUCHED
from xdynamics.march.run import ENCLOSE, TOUCH, Run
from xdynamics.model.detectors import GAP, OCCASION

RISING = Seen(lambda s: s - 0.5, lambda _: 1.0)


def on_a_piece(before: float = 1.0, after: float = 1.0, width: float = 0.5, **watched: Any) -> Run:
    """Return a run that looks at a piece of a step of 1 s from 2 s on, with values at its ends."""
    run, _ = watching(RISING, t=2.0)
    run.put(far=np.array([0.75, 1.0, 0.0]), far_g=np.array([after]), lingering=np.zeros(1), full=np.zeros(3))
    run.near[:] = 0.25, 1.0, 0.0
    run.near_g[0], piece, watch = before, run.piece[0], run.watches[0]
    piece.start, piece.end, piece.width, piece.full = 2.25, 2.25 + width, width, 1.0
    watch.hit, watch.zone, watch.greatest, watch.flaw, watch.broken = NONE, -1.0, 1.0, SMOOTH, SMOOTH
    for name, value in watched.items():
        run.watches[name] = value
    return run


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_tent_under_values_and_slopes(side: float) -> None:
    """Assert that a function is known to keep its sign just where the lines through both ends meet on its side of zero."""
    random = np.random.default_rng(7)
    clears, answers = plain(zero_tests.cannot_reach_zero), set()
    for _ in range(300):
        before, after = random.uniform(0.01, 2.0, 2).tolist()
        w, slack = random.uniform(0.1, 2.0), random.uniform(0.1, 4.0, 2)
        steepest, least = (after - before) / w + slack[0], (after - before) / w - slack[1]
        s = np.linspace(0.0, w, 2_001)
        lowest = float(np.maximum(before + least * s, after - steepest * (w - s)).min())
        if abs(lowest) > 1e-2:
            slopes = (least, steepest) if side > 0 else (-steepest, -least)
            assert clears(side * before, side * after, *slopes, w) == (lowest > 0.0)
            answers.add(lowest > 0.0)
    assert answers == {True, False}
    assert not clears(side, -side, -3.0, 3.0, 1.0)
    assert not clears(0.0, side, -3.0, 3.0, 1.0)
    assert not clears(side, side, -2.0, 2.0, 1.0)  # it touches


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("size", "low", "high", "flaw", "slopes", "within"),
    [
        (1.0, -0.9, 0.9, SMOOTH, (0.0, 1.0), True),
        (1.0, -1.0, 1.0, SMOOTH, (0.0, 1.0), True),
        (1.0, -0.9, 1.1, SMOOTH, (0.0, 1.0), False),
        (1.0, -1.1, 0.9, SMOOTH, (0.0, 1.0), False),
        (1.0, -50.0, 50.0, SMOOTH, (-1.0, 1.0), True),  # from 0.5 and 0.6 no farther than 0.8 and 0.3
        (1.0, -50.0, 50.0, BREAKS, (-1.0, 1.0), False),
        (0.79, -50.0, 50.0, SMOOTH, (-1.0, 1.0), False),
        (0.81, -50.0, 50.0, SMOOTH, (-1.0, 1.0), True),
        (0.81, -0.82, 50.0, SMOOTH, (-8.0, 1.0), False),
    ],
)
def test_small_by_values_or_by_slopes(
    side: float, size: float, low: float, high: float, flaw: int, slopes: tuple[float, float], within: bool
) -> None:
    """Assert the tighter of both bounds, at both ends."""
    ends, rates = sorted((side * low, side * high)), sorted(side * slope for slope in slopes)
    run = on_a_piece(side * 0.5, side * 0.6, low=ends[0], high=ends[1], flaw=flaw, down=rates[0], up=rates[1])
    assert plain(zero_tests.stays_within)(run, 0, size, 0.5) == within


@pytest.mark.parametrize(
    ("before", "after", "slope", "sampled", "known"),
    [
        (1.0, 1.0, (-1.0, 1.0), 0, CLEAR),
        (1.0, 1.0, (-9.0, 9.0), 0, OPEN),
        (1.0, -1.0, (-9.0, -2.0), 0, MONOTONE),
        (-1.0, 1.0, (2.0, 9.0), 0, MONOTONE),
        (1e-13, -1e-13, (-9.0, -2.0), 0, OPEN),  # what is never told from zero
        (1e-13, -1e-8, (-9.0, -2.0), 0, MONOTONE),
        (1.0, -1.0, (0.0, 0.0), 1, MONOTONE),
        (1.0, 0.6, (0.0, 0.0), 1, CLEAR),
        (1.0, 0.4, (0.0, 0.0), 1, OPEN),
        (-0.4, -1.0, (0.0, 0.0), 1, OPEN),
        (0.0, 1.0, (0.0, 0.0), 1, MONOTONE),
    ],
)
def test_what_is_known_on_a_piece(
    before: float, after: float, slope: tuple[float, float], sampled: int, known: int
) -> None:
    """Assert what enclosures and slopes tell, or of a function that is only sampled its values."""
    run = on_a_piece(before, after, 0.5, low=-5.0, high=5.0, down=slope[0], up=slope[1], floor=1e-12)
    run.detectors[0].sampled, run.located[0].h = sampled, 4.0
    assert plain(zero_tests.classify_function)(run, 0) == known
    if sampled:
        assert run.watches[0].down == run.watches[0].up == abs(after - before) / 0.5
        run.located[0].h = 3.9  # of which this piece is more than an eighth
        assert plain(zero_tests.classify_function)(run, 0) == OPEN


@pytest.mark.parametrize(
    ("low", "high", "known"), [(0.1, 5.0, CLEAR), (-5.0, -0.1, CLEAR), (0.0, 5.0, OPEN), (-5.0, 0.0, OPEN)]
)
def test_values_alone_may_do(low: float, high: float, known: int) -> None:
    """Assert that bounds beyond zero are enough, of a function with jumps too, and bounds at zero are not."""
    run = on_a_piece(1.0, 1.0, low=low, high=high, flaw=BREAKS, down=0.5, up=0.6)
    assert plain(zero_tests.classify_function)(run, 0) == known


@pytest.mark.parametrize(
    ("bend", "flaw", "alive", "slopes"),
    [
        (0, SMOOTH, 1, (-2.0, 2.5)),
        (-1, SMOOTH, 1, (-5.0, 7.0)),
        (0, BREAKS, 1, (-5.0, 7.0)),
        (0, SMOOTH, 0, (-5.0, 7.0)),
    ],
)
def test_slopes_of_gaps_are_those_at_the_start_and_their_change(
    monkeypatch: pytest.MonkeyPatch, bend: int, flaw: int, alive: int, slopes: tuple[float, float]
) -> None:
    """Assert bounds by slopes from -1 to 1 at the start and bends from -2 to 3 over half a second, where both are known."""
    run = on_a_piece(down=-5.0, up=7.0, least_bend=-2.0, most_bend=3.0, flaw=flaw, alive=alive)
    run.put(
        under=np.array([9.0, -1.0]),
        over=np.array([9.0, 1.0]),
        parts=np.zeros(4, np.int64),
        functions=np.zeros(ENCLOSE + 1, np.int64),
    )
    run.detectors[0].bend, run.detectors[0].slope = bend, 1
    tighten, seen = plain(zero_tests.tighten_slopes), []
    monkeypatch.setitem(
        tighten.__globals__, "enclosed_by", lambda *_: seen.append((run.piece[0].end, run.piece[0].width))
    )
    tighten(run)
    assert seen == [(2.25, 0.0)]
    assert (run.piece[0].end, run.piece[0].width) == (2.75, 0.5)
    assert (run.watches[0].down, run.watches[0].up) == pytest.approx(slopes, rel=1e-15)
    for name in ("least_bend", "most_bend"):
        run.watches[name], run.watches["down"], run.watches["up"] = 0.5 if name == "least_bend" else -0.5, -5.0, 7.0
    tighten(run)  # of a slope that only rises at least, the start's is the least
    assert (run.watches[0].down, run.watches[0].up) == (
        (-1.0, 1.0) if bend == 0 and flaw == SMOOTH and alive else (-5.0, 7.0)
    )


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_turns_come_nearer_and_leave(side: float) -> None:
    """Assert that a function with one side turns if it approaches zero first and leaves it then, or where nothing is known."""
    for rates, expected in (
        ((-1.0, 1.0), True),
        ((1.0, 1.0), False),
        ((-1.0, -1.0), False),
        ((1.0, -1.0), False),
        ((0.0, 1.0), False),
        ((-1.0, 0.0), False),
    ):
        run, _ = watching(Seen(lambda _: side, lambda s, rates=rates: side * (rates[0] if s == 0.25 else rates[1])))
        run.put(far=np.array([0.75, 1.0, 0.0]), far_g=np.array([side]))
        run.near[0], run.near_g[0] = 0.25, side
        assert plain(zero_tests.turns_back)(run, 0) == expected
        for end, flaw in ((-side, SMOOTH), (side, BREAKS)):
            run.far_g[0], run.watches[0].flaw = end, flaw
            assert plain(zero_tests.turns_back)(run, 0)
        run.near_g[0] = 0.0
        assert plain(zero_tests.turns_back)(run, 0)


def doubted(monkeypatch: pytest.MonkeyPatch, function: Any, murk: float, uncertainty: float = 0.0) -> Any:
    """Return a phase with doubts of given size."""
    phase = plain(function)
    monkeypatch.setitem(phase.__globals__, "noise_floor", lambda *_: murk)
    monkeypatch.setitem(phase.__globals__, "function_uncertainty", lambda *_: uncertainty)
    return phase


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("guard", "armed", "far", "expected"),
    [
        (1, 1, -0.1, True),
        (0, 1, -0.1, False),
        (1, 0, -0.1, False),
        (-1, 1, -0.1, False),
        (1, 1, 0.1, False),
        (1, 1, -0.01, False),
    ],
)
def test_a_trespass_is_beyond_doubt(
    monkeypatch: pytest.MonkeyPatch, side: int, guard: int, armed: int, far: float, expected: bool
) -> None:
    """Assert that a guarded function is where it may not be by more than its murk."""
    run = on_a_piece(side, side * far, guard=side * guard, armed=side * armed)
    assert doubted(monkeypatch, zero_tests.trespasses, 0.05)(run, 0, 0.75) == expected


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("guard", "armed", "came", "far", "rate", "expected"),
    [
        (1, 0, -1, -0.1, -1.0, True),
        (0, 0, -1, -0.1, -1.0, False),
        (1, 1, -1, -0.1, -1.0, False),
        (1, 0, 1, -0.1, -1.0, False),
        (1, 0, -1, -0.01, -1.0, False),
        (1, 0, -1, 0.1, -1.0, False),
        (1, 0, -1, -0.1, 1.0, False),
        (1, 0, -1, -0.1, 0.0, False),
    ],
)
def test_a_function_leaves_to_where_it_may_not_be(
    monkeypatch: pytest.MonkeyPatch,
    side: int,
    guard: int,
    armed: int,
    came: int,
    far: float,
    rate: float,
    expected: bool,
) -> None:
    """Assert that it is there beyond doubt, and goes on."""
    run, _ = watching(Seen(lambda _: side, lambda _: side * rate))
    run.put(far=np.array([0.75, 1.0, 0.0]), far_g=np.array([side * far]))
    run.watches["guard"], run.watches["armed"] = side * guard, side * armed
    assert doubted(monkeypatch, zero_tests.moves_past_guard, 0.05)(run, 0, side * came) == expected


@pytest.mark.parametrize(
    ("near", "broken", "slopes", "expected"),
    [
        (9.0, SMOOTH, (0.0, 0.0), True),
        (0.9, BREAKS, (-0.01, 0.5), True),
        (1.1, BREAKS, (-0.01, 0.5), False),
        (1.1, BREAKS, (-0.6, 0.5), True),
        (5.0, UNBOUNDED, (-9.0, 9.0), False),
        (0.9, UNBOUNDED, (-0.01, 0.5), True),
        (-0.9, BREAKS, (-0.01, 0.5), True),
        (-1.1, BREAKS, (-0.5, 0.01), False),
    ],
)
def test_a_kink_reaches_zero_if_its_slope_explains_it(
    monkeypatch: pytest.MonkeyPatch, near: float, broken: int, slopes: tuple[float, float], expected: bool
) -> None:
    """Assert for a piece of 0.02 s that a hundred times the larger slope is what is explained, and no infinite value is."""
    run = on_a_piece(near, near, broken=broken, down=slopes[0], up=slopes[1], greatest=2.0, zone=0.0)
    assert doubted(monkeypatch, isolation.reaches_zero, 0.0)(run, 0, 0.0, 0.02) == expected
    if near == 1.1 and slopes[1] == 0.5 and not expected:
        assert doubted(monkeypatch, isolation.reaches_zero, 0.0, 0.026)(run, 0, 0.0, 0.02)
        assert not doubted(monkeypatch, isolation.reaches_zero, 0.0, 0.024)(run, 0, 0.0, 0.02)


@pytest.mark.parametrize(
    ("far", "slopes", "doubt", "expected"),
    [
        (1e-3, (-1e-9, 1e-9), 1.0, False),
        (5e-10, (1.0, 2.0), 0.0, False),
        (5e-10, (1.0, 2.0), 1e-10, False),
        (5e-10, (1.0, 2.0), 2e-10, False),
        (5e-10, (1.0, 2.0), 1.1e-9, True),
        (5e-10, (0.1, 0.2), 1.26e-10, True),
        (5e-10, (0.1, 0.2), 1.24e-10, False),
        (0.0, (1e-10, 1.0), 0.0, True),
        (0.0, (-1.0, -1e-10), 0.0, True),
        (0.0, (3e-9, 1.0), 0.0, False),
        (0.0, (-1.0, -3e-9), 0.0, False),
    ],
)
def test_a_slow_end_near_zero_lingers(
    monkeypatch: pytest.MonkeyPatch, far: float, slopes: tuple[float, float], doubt: float, expected: bool
) -> None:
    """Assert for a tolerance of 1e-9 s that doubt or bend hides the side that a monotone function ends on."""
    run = on_a_piece(1.0, far, down=slopes[0], up=slopes[1])
    assert doubted(monkeypatch, zero_tests.ends_near_zero, 0.0, doubt)(run, 0) == expected


@pytest.mark.parametrize(
    ("role", "lingering", "guard", "armed", "near", "expected"),
    [
        (OCCASION, 0.0, 1, 0, 0.1, True),
        (OCCASION, 0.0, 0, 0, 0.1, False),
        (OCCASION, 0.0, 1, 1, 0.1, False),
        (OCCASION, 0.0, 1, 0, -0.3, False),
        (OCCASION, 0.0, 1, 0, -0.2, True),
        (GAP, 0.0, 1, 0, 0.1, False),
        (GAP, 0.1, 1, 0, 0.1, True),
    ],
)
def test_what_presses_nothing_idles(
    role: int, lingering: float, guard: int, armed: int, near: float, expected: bool
) -> None:
    """Assert a guarded function on no side that is small at both ends, of a gap only while its contact lingers."""
    for ends in ((near, 0.0), (0.0, near)):
        run = on_a_piece(*ends, guard=guard, armed=armed)
        run.detectors[0].role, run.detectors[0].reaction, run.lingering[0] = role, 0, lingering
        assert plain(zero_tests.idles)(run, 0, 0.2) == expected


def test_what_is_never_told_from_zero() -> None:
    """Assert the floor of a function, and of a gap what is left of it; four of its uncertainties, if that is more."""
    run = on_a_piece(floor=1e-9)
    run.detectors[0].reaction, run.lingering[0] = 0, 1e-6
    assert plain(zero_tests.gap_floor)(run, 0) == 1e-9
    run.detectors[0].role = GAP
    assert plain(zero_tests.gap_floor)(run, 0) == 1e-6


def test_how_large_a_function_may_be_and_count_as_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert four uncertainties, or the floor."""
    run = on_a_piece(floor=1e-9)
    murk = plain(zero_tests.noise_floor)
    for doubt, size in ((1e-9, 4e-9), (1e-10, 1e-9)):
        monkeypatch.setitem(murk.__globals__, "function_uncertainty", lambda *_, doubt=doubt: doubt)
        assert murk(run, 0, run.near) == size


@pytest.mark.parametrize(
    ("t", "s", "width"), [(0.0, 1.0, 1e-9), (1e8, 1.0, 2 * EPS * (1e8 + 1)), (-1e8, 1.0, 2 * EPS * 1e8)]
)
def test_pieces_are_not_cut_below_the_spacing_of_t(t: float, s: float, width: float) -> None:
    """Assert the tolerance, or twice the rounding of the later time."""
    run = on_a_piece()
    run.now[0].t = t
    assert plain(zero_tests.event_resolution)(run, 0, s) == width


def test_sides_are_armed_away_from_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the side of a value beyond its murk and beyond a billionth of the largest; none for one that sleeps."""
    for value, murk, greatest, asleep, armed, ever in (
        (0.2, 0.1, 1.0, 0, 1, 1),
        (-0.2, 0.1, 1.0, 0, -1, 1),
        (0.1, 0.2, 1.0, 0, 0, 0),
        (-0.1, 0.2, 1.0, 0, 0, 0),
        (0.1, 0.0, 1.01e8, 0, 0, 0),
        (0.1, 0.0, 0.99e8, 0, 1, 1),
        (0.2, 0.1, 1.0, 1, 0, 0),
    ):
        run = on_a_piece(armed=7, ever=0, greatest=greatest, asleep=asleep)
        doubted(monkeypatch, departures.arm_event, murk)(run, 0, value)
        assert (run.watches[0].armed, run.watches[0].ever) == (armed, ever)
    run.watches["armed"], run.watches["began"] = -1, 1
    plain(departures.rearm_rejected)(run)
    assert run.watches[0].armed == 1


@pytest.mark.parametrize(
    ("under", "over", "armed", "guard", "asleep", "silent"),
    [
        (0.1, 2.0, 1, 0, 0, True),
        (-2.0, -0.1, -1, 0, 0, True),
        (0.0, 2.0, 1, 0, 0, False),
        (-2.0, 0.0, -1, 0, 0, False),
        (0.1, 2.0, -1, 0, 0, False),
        (-2.0, -0.1, 1, 0, 0, False),
        (0.1, 2.0, 0, 0, 0, False),
        (0.1, 2.0, 1, 1, 0, True),
        (-2.0, -0.1, -1, 1, 0, False),
        (-1.0, 1.0, 1, 0, 1, True),
    ],
)
def test_a_trial_is_quiet_on_the_armed_side(
    monkeypatch: pytest.MonkeyPatch, under: float, over: float, armed: int, guard: int, asleep: int, silent: bool
) -> None:
    """Assert which bounds over a trial leave no zero in it; of a gap the largest least value is kept."""
    run = on_a_piece(armed=armed, guard=guard, asleep=asleep)
    run.put(
        box_variables=np.zeros((0, 3), np.int64),
        under=np.array([under]),
        over=np.array([over]),
        parts=np.zeros(4, np.int64),
        functions=np.zeros(ENCLOSE + 1, np.int64),
        touches=np.zeros(1, TOUCH),
    )
    run.detectors[0].role, run.detectors[0].reaction, run.touches[0].largest = GAP, 0, 0.05
    quiet = plain(isolation.is_event_free)
    monkeypatch.setitem(quiet.__globals__, "enclosed_by", lambda *_: None)
    assert quiet(run) == silent
    assert run.watches[0].alive == (not silent)
    assert run.touches[0].largest == max(under, 0.05)


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("silent", [True, False])
def test_a_region_is_put_around_what_is_quiet(monkeypatch: pytest.MonkeyPatch, silent: bool, inside: bool) -> None:
    """Assert that a step inside the region is quiet without a look, and that one that was looked at has a new region if it is."""
    run = on_a_piece(armed=1 if silent else -1)
    run.put(
        box_variables=np.zeros((1, 3), np.int64),
        under=np.array([0.1]),
        over=np.array([2.0]),
        parts=np.zeros(4, np.int64),
        functions=np.zeros(ENCLOSE + 1, np.int64),
    )
    quiet, seen = plain(isolation.is_event_free), []
    for name, answer in (("stays_in_region", inside), ("set_region", None), ("enclosed_by", None)):
        monkeypatch.setitem(
            quiet.__globals__, name, lambda *_, name=name, answer=answer: (seen.append(name), answer)[1]
        )
    assert quiet(run) == (silent or inside)
    assert seen == [
        "stays_in_region",
        *([] if inside else ["enclosed_by"]),
        *(["set_region"] if silent and not inside else []),
    ]


@pytest.mark.parametrize(
    ("direction", "armed", "hit"),
    [(0, 1, True), (0, -1, True), (-1, 1, True), (1, -1, True), (1, 1, False), (-1, -1, False)],
)
@pytest.mark.parametrize(
    ("left", "what", "known"), [(0.25, CROSSED, True), (0.125, CROSSED, False), (0.25, TOUCHED, False)]
)
def test_an_event_is_struck_in_its_direction(
    direction: int, armed: int, hit: bool, left: float, what: int, known: bool
) -> None:
    """Assert the bracket of one that is watched for, with the value at its left end where that is the piece's."""
    run = on_a_piece(0.75, armed=armed)
    run.watches[0].before, run.detectors[0].direction = 9.0, direction
    plain(isolation.note_event_in_piece)(run, 0, left, 0.875, what)
    watch = run.watches[0]
    if not hit:
        assert (watch.hit, watch.before) == (NONE, 9.0)
        return
    assert (watch.hit, watch.left, watch.right) == (what, left, 0.875)
    assert watch.before == 0.75 if known else math.isnan(watch.before)


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    ("watched", "near", "far", "border", "outcome"),
    [
        ({"state": MONOTONE, "armed": 1}, 0.3, -0.3, False, (CROSSED, 0.25, 0.75, 1)),
        ({"state": MONOTONE, "armed": 1}, 0.3, 0.2, False, (NONE, None, None, 1)),
        ({"state": MONOTONE, "armed": 0}, 0.0, 0.2, False, (NONE, None, None, 1)),
        ({"state": MONOTONE, "armed": 0}, 0.0, -0.2, False, (NONE, None, None, -1)),
        ({"state": CLEAR, "armed": 1}, 0.3, 0.2, False, (NONE, None, None, 1)),
        ({"state": CLEAR, "armed": 1, "zone": 0.125}, -0.3, -0.2, False, (CROSSED, 0.125, 0.75, 1)),
        ({"state": CLEAR, "armed": 1, "zone": 0.125, "forced": 1}, -0.3, -0.2, False, (FORCED, 0.125, 0.75, 1)),
        ({"state": CLEAR, "armed": 1, "zone": 0.125}, 0.3, 0.2, False, (TOUCHED, 0.125, 0.25, 1)),
        ({"state": CLEAR, "armed": 0, "zone": 0.125}, 0.3, 0.2, False, (NONE, None, None, 1)),
        ({"state": MURKY, "armed": 1}, 0.0, 0.0, False, (NONE, None, None, 1)),
        ({"state": MURKY, "armed": 1}, 0.0, 0.0, True, (ENDED, 0.25, 0.75, 1)),
        ({"state": MURKY, "armed": 0}, 0.0, 0.0, True, (NONE, None, None, 0)),
        ({"state": MURKY, "armed": 1, "zone": 0.125}, 0.0, 0.0, True, (ENDED, 0.125, 0.75, 1)),
        ({"state": MURKY, "armed": 1, "guard": 1}, 0.0, -0.3, False, (FORCED, 0.25, 0.75, 1)),
        ({"state": MONOTONE, "armed": 1, "alive": 0}, 0.3, -0.3, False, (NONE, None, None, 1)),
    ],
)
def test_what_is_decided_on_a_piece(
    monkeypatch: pytest.MonkeyPatch,
    side: int,
    watched: dict[str, Any],
    near: float,
    far: float,
    border: bool,
    outcome: tuple[Any, ...],
) -> None:
    """Assert the event of a piece, its bracket and the side behind it, for what is known of its function there."""
    decide = plain(isolation.decide_piece)
    monkeypatch.setitem(plain(zero_tests.trespasses).__globals__, "noise_floor", lambda *_: 1e-6)
    run = on_a_piece(
        side * near,
        side * far,
        **(watched | {name: side * watched[name] for name in ("armed", "guard") if name in watched}),
    )
    monkeypatch.setitem(decide.__globals__, "trespasses", plain(zero_tests.trespasses))
    hit, left, right, armed = outcome
    assert decide(run, 0.25, 0.75, border) == (hit != NONE)
    watch = run.watches[0]
    assert (watch.hit, side * watch.armed) == (hit, armed)
    assert run.entered[0] == side * watched["armed"]
    if hit != NONE:
        assert (watch.left, watch.right) == (left, right)
    if watched["state"] == MURKY:
        assert (watch.zone, watch.clear) == (watched.get("zone", 0.25), 0.75)
    elif hit == NONE and watch.alive:
        assert watch.zone == -1.0


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize(
    ("value", "rate", "armed", "hit"),
    [
        (0.9e-9, -1.0, 1, True),
        (1.1e-9, -1.0, 1, False),
        (1.9e-9, -2.0, 1, True),
        (0.9e-9, 1.0, 1, False),
        (0.9e-9, -1.0, 0, False),
    ],
)
def test_a_model_that_ends_beside_an_event_arrives(
    side: float, value: float, rate: float, armed: int, hit: bool
) -> None:
    """Assert for a tolerance of 1e-9 s that an event is met whose function would be zero within it, and until when it may be."""
    run, _ = watching(Seen(lambda _: side * value, lambda _: side * rate))
    run.watches["armed"], run.watches["hit"] = int(side) * armed, NONE
    assert plain(isolation.ends_near_event)(run) == hit
    watch = run.watches[0]
    assert watch.hit == (ENDED if hit else NONE)
    if hit:
        rest = abs(value / rate)
        assert (watch.left, watch.right) == (1.0, 1.0)
        assert (watch.zone, watch.clear) == (1.0 - rest, 1.0 + rest)


def test_others_stay_on_the_side_that_they_entered_on() -> None:
    """Assert side and bracket of a function without an event in the piece of another's; none by the rule of 0.2."""
    for apart, zone, hit, armed, left in (
        (0, -1.0, NONE, 1, 0.25),
        (0, 0.125, NONE, 1, 0.125),
        (1, -1.0, NONE, -1, 0.5),
        (0, -1.0, CROSSED, -1, 0.5),
    ):
        run = on_a_piece(armed=-1, left=0.5, zone=zone, hit=hit)
        run.entered[0], run.plan[0].apart = 1, apart
        plain(isolation.hold_other_sides)(run, 0.25)
        assert (run.watches[0].armed, run.watches[0].left) == (armed, left)


def test_states_at_cuts_come_back() -> None:
    """Assert step, state and values of two cuts, whichever comes back first."""
    run = on_a_piece()
    run.put(branches=np.zeros((3, 5)))
    for k, s in ((0, 0.5), (1, 0.25)):
        run.z[:], run.g1[0] = [s, 2 * s, 3 * s], 4 * s
        plain(isolation.grow_branch)(run, k, s)
    for k, s in ((0, 0.5), (1, 0.25)):
        plain(isolation.load_branch)(run, k)
        assert [run.branches[k, 0], *run.far, *run.far_g] == [s, s, 2 * s, 3 * s, 4 * s]
