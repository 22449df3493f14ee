"""What is noted, set and remembered at an event, one phase at a time, as plain Python on a run made by hand."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.plain import Seen, law_of, nothing, plain, watching
from xdynamics.kernels.program import UNSOUND
from xdynamics.march import control, event_search, landing
from xdynamics.march.events import departures, root_finding, zero_tests
from xdynamics.march.events.enclosures import BOX, STANDS
from xdynamics.march.run import REACTION, Run
from xdynamics.model.detectors import GAP, GRIP, OCCASION, PULL, SLIP
from xdynamics.schema import CROSSING, REASON_ERROR, REASON_EVENT, REASON_EVENT_FUNCTION

FALLING = Seen(lambda s: 3.0 * (0.25 - s * s), lambda s: -6.0 * s)
RISING = Seen(lambda s: 2.0 * (s - 0.5), lambda _: 2.0)


def noting(monkeypatch: pytest.MonkeyPatch, doubt: float = 1e-14) -> Run:
    """Return a run that has located two events at half a second behind 2 s, each known to a doubt."""
    run, _ = watching(FALLING, RISING, t=2.0)
    run.put(log_rates=np.zeros((0, 5)), log_impulses=np.ones((2, 5)))
    plain(root_finding.locate_events)(run)
    run.slopes[:], run.watches["zone"] = 99.0, -1.0
    monkeypatch.setitem(plain(landing.note_events).__globals__, "function_uncertainty", lambda *_: doubt)
    return run


def test_a_row_of_an_event_has_its_own_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert time, bracket, residual, slope, doubt, direction, rows and counts of two events in one group."""
    run = noting(monkeypatch)
    run.watches[1].drift, run.watches[1].zone, run.watches[1].clear, run.now[0].events = 4e-9, 0.5, 0.625, 1
    plain(landing.note_events)(run, 7, 13)
    assert run.now[0].events == 3
    h = float(run.trial[0].h)
    for i, (row, seen) in enumerate(zip(run.log_events[1:3], (FALLING, RISING), strict=True)):
        assert (row.time, row.residual, row.slope) == (2.0 + h, seen.value(h), seen.rate(h))
        assert row.left == 2.0 + run.watches[i].left < 2.5 <= row.time
        assert (row.uncertainty, row.substeps, row.detector, row.kind) == (1e-14, 13, i, CROSSING)
        assert (row.row_before, row.row_after, run.watches[i].seen) == (7, 8, 1)
    assert run.log_events["direction"][1:3].tolist() == [-1, 1]
    assert run.log_events["interpolation"][1:3].tolist() == [0.0, 2e-9]
    assert run.log_events["murk"][1:3].tolist() == [0.0, 0.125]
    assert run.log_impulses[0].tolist() == [1.0, 0.0, 0.0, 1.0, 1.0]


def test_a_bracket_may_begin_before_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an event that was pending at the step's start has its left end there where it began to be so."""
    run = noting(monkeypatch)
    run.watches[1].left, run.pending[1] = 0.0, 0.125
    run.detectors[0].sampled, run.watches[0].up = 1, 5.0
    plain(landing.note_events)(run, 7, 13)
    assert run.log_events[1].left == 2.0 - 0.125
    assert run.log_events[0].slope == -5.0  # the mean slope, by the direction


@pytest.mark.parametrize("apart", [0, 1])
def test_an_event_that_is_past_but_not_found_is_pending(monkeypatch: pytest.MonkeyPatch, apart: int) -> None:
    """Assert for how long it has been so, and that it stays on its side; by the rule of 0.2 it is on the new one."""
    run, _ = watching(FALLING, RISING, t=2.0)
    run.plan[0].apart = apart
    run.trial[0].h, run.trial[0].t, run.y[0] = 0.625, 2.625, 0.625
    run.g1[:] = [seen.value(0.625) for seen in (FALLING, RISING)]
    run.watches["hit"], run.watches["left"], run.pending[:] = zero_tests.NONE, [0.5, 0.25], [0.03125, 0.0]
    monkeypatch.setitem(plain(departures.rearm).__globals__, "arm_event", lambda _, i, value: armed.append((i, value)))
    armed: list[tuple[int, float]] = []
    plain(departures.rearm)(run, False)
    assert run.pending.tolist() == ([0.0, 0.0] if apart else [0.03125 + 0.125, 0.375])
    assert armed == ([(i, run.g1[i]) for i in range(2)] if apart else [])


def test_what_is_no_event_to_come_is_not_pending(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a met event, a contact's, one whose value an action changed and one not watched for are none."""
    changes: list[tuple[str, Any]] = [
        ("hit", zero_tests.CROSSED),
        ("armed", 0),
        ("reaction", 0),
        ("direction", 1),
        ("g1", 0.0),
        ("", 0),
    ]
    for what, value in changes:
        run, _ = watching(FALLING, t=2.0)
        run.y[0], run.watches[0].hit = 0.625, zero_tests.NONE
        run.g[0] = run.g1[0] = FALLING.value(0.625)
        where: Any = run.watches if what in ("hit", "armed") else run.detectors
        if what == "g1":
            run.g1[0] = value
        elif what:
            where[what] = value
        monkeypatch.setitem(plain(departures.is_pending).__globals__, "noise_floor", lambda *_: 1e-9)
        assert plain(departures.is_pending)(run, 0) == (not what)
    monkeypatch.setitem(plain(departures.is_pending).__globals__, "noise_floor", lambda *_: 10.0)
    run.detectors[0].direction = 1  # of one that is not watched for, what is too small to have a side
    assert plain(departures.is_pending)(run, 0)


@pytest.mark.parametrize(
    ("role", "normal", "other", "hit", "left"),
    [
        (GRIP, 1, PULL, True, False),
        (SLIP, 1, PULL, True, False),
        (GRIP, 0, PULL, True, True),
        (GRIP, 1, PULL, False, True),
        (GRIP, 1, GAP, True, True),
        (OCCASION, 1, PULL, True, True),
    ],
)
def test_no_grip_is_lost_where_its_contact_opens(role: int, normal: int, other: int, hit: bool, left: bool) -> None:
    """Assert which events of friction go with that of their own contact."""
    run, _ = watching(FALLING, RISING)
    run.put(reactions=np.zeros(3, REACTION))
    run.reactions["normal"] = [-1, -1, normal]
    run.detectors["role"], run.detectors["reaction"] = [role, other], [2, 1]
    run.watches[1].hit = zero_tests.CROSSED if hit else zero_tests.NONE
    plain(landing.leave_out)(run)
    assert (run.watches[0].hit != zero_tests.NONE) == left


def test_a_reset_sets_what_it_names() -> None:
    """Assert position and velocity, the shift that is noted, and that what rounding was carried is forgotten, of its own alone."""
    run, _ = watching(FALLING, RISING)
    run.put(
        law=law_of(
            nothing, nothing, nothing, lambda *given: given[5].__setitem__(slice(3), [5.0, 6.0, 7.0]), nothing, nothing
        ),
        resets=np.zeros(3),
        targets=np.array([[0, 0], [1, 0], [0, 1]]),
        log_impulses=np.zeros((1, 5)),
        z=np.array([1.0, 2.0, 3.0, 0.25, 0.5]),
    )
    run.plan[0].used, run.plan[0].evaluated, run.plan[0].coordinates = 2, 1, 1
    plain(landing.reset)(run, 0, 2)
    assert run.z.tolist() == [5.0, 7.0, 3.0, 0.0, 0.0]
    assert run.log_impulses.tolist() == [[0.0, 0.0, 4.0, 0.0, 0.0]]
    run.z[:] = [1.0, 2.0, 3.0, 0.25, 0.5]
    plain(landing.reset)(run, 1, 3)
    assert run.z.tolist() == [6.0, 2.0, 3.0, 0.0, 0.5]
    assert run.log_impulses.tolist() == [[0.0, 0.0, 4.0, 5.0, 0.0]]


@pytest.mark.parametrize("apart", [0, 1])
def test_what_happens_ends_the_region_without_events(monkeypatch: pytest.MonkeyPatch, apart: int) -> None:
    """Assert that no box outlives a look at a trial, and that no event function is left to be looked at."""
    run, _ = watching(FALLING)
    run.put(box_variables=np.zeros((1, 3), np.int64), region=np.zeros(BOX + 4))
    run.region[STANDS], run.plan[0].apart = 1.0, apart
    verdict = plain(event_search.find_event)(run, REASON_ERROR)
    assert (run.region[STANDS], verdict, run.watches[0].alive) == (0.0, REASON_ERROR, apart)
    run.region[STANDS] = 1.0
    monkeypatch.setitem(plain(event_search.begin_events).__globals__, "arm_event", lambda *_: None)
    plain(event_search.begin_events)(run)
    assert run.region[STANDS] == 0.0


@pytest.mark.parametrize(
    ("made", "at", "node", "final"),
    [
        (0, control.AT_NODE, 1, True),
        (3, control.AT_BOTH, 1, True),
        (0, control.AT_GRID, 1, False),
        (0, control.AT_NODE, 0, False),
    ],
)
def test_a_trial_without_events_stays_as_it_is(
    monkeypatch: pytest.MonkeyPatch, made: int, at: int, node: int, final: bool
) -> None:
    """Assert that it comes back whole, says whether substeps were made, and asks what the run's last one is asked."""
    run, _ = watching(FALLING, h=0.25)
    run.put(nodes=np.array([0.25]))
    run.trial[0].landing, run.now[0].node, run.kept[0].growth = at, node, 1.5
    state = run.z.copy()

    def isolate(run: Run, last: bool) -> bool:
        run.z[:], run.kept[0].growth, run.piece[0].substeps = 0.0, 0.0, made
        return last != final

    monkeypatch.setitem(plain(event_search.search_trial).__globals__, "isolate", isolate)
    plain(event_search.search_trial)(run)
    assert run.z.tolist() == state.tolist()
    assert (run.kept[0].growth, run.piece[0].cut) == (1.5, int(made > 0))


def test_a_trial_with_an_event_or_without_numbers_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the reasons."""
    run, _ = watching(FALLING)
    monkeypatch.setitem(plain(event_search.search_trial).__globals__, "isolate", lambda *_: True)
    assert plain(event_search.search_trial)(run) == REASON_EVENT
    run.put(
        law=law_of(nothing, lambda *given: given[0].__setitem__(UNSOUND, np.nan), nothing, nothing, nothing, nothing)
    )
    assert plain(event_search.search_trial)(run) == REASON_EVENT_FUNCTION


def test_an_event_at_a_grid_time_is_at_that_time() -> None:
    """Assert that a group that ends at a grid time has it to the bit, where 0.5 + 0.1 is another number than 6*0.1."""
    assert 0.5 + 0.1 != 6 * 0.1
    model = xd.Model(
        name="clock",
        coordinates={"x": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={"one": {"function": "t - 0.59999999999995*second"}, "other": {"function": "x - 0.5999999999999*metre"}},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    assert run.time.values[run.event_row_before.values].tolist() == [6 * 0.1] * 2
    assert run.time.values[-5:].tolist() == [6 * 0.1, 7 * 0.1, 0.8, 0.9, 1.0]
    assert run.sizes["sample"] == 4 * 10 + 1  # no force is evaluated behind events without an action
