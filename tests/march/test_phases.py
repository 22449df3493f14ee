"""Phases of the march, one at a time, as plain Python on a run made by hand."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from cases.plain import kept, law_of, made_by_hand, plain
from xdynamics.kernels.program import UNSOUND, H
from xdynamics.march import control, landing, loop, trial_step
from xdynamics.march.assembly import phases as assembly_phases
from xdynamics.march.assembly.broad_phase import MEETS
from xdynamics.march.events import departures, root_finding, zero_tests
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.outcomes import COMPLETED, OUTCOMES, RUNNING, SOUND, STEP_LIMIT, STEP_TOO_SMALL, STOPPED
from xdynamics.march.run import DETECTOR, EVENT_ROW, TRIAL, WATCH, Run
from xdynamics.schema import (
    EVENT_AFTER,
    EVENT_BEFORE,
    NODE,
    REASON_DOMAIN,
    REASON_ERROR,
    REASON_EVENT,
    REASON_EVENT_FUNCTION,
    REASON_NEWTON,
    REASON_NONFINITE,
    STEP,
    TRIAL_REASONS,
)


@pytest.mark.parametrize(
    ("node", "plan", "now", "aimed"),
    [
        (None, {"step_size": 0.1}, {"grid": 2, "t": 0.2}, (3 * 0.1, 0.1, control.AT_GRID)),
        (0.25, {"step_size": 0.1}, {"grid": 2, "t": 0.2}, (0.25, 0.25 - 0.2, control.AT_NODE)),
        (0.5, {"step_size": 0.25, "snap": 1e-15}, {"grid": 1, "t": 0.25}, (0.5, 0.25, control.AT_BOTH)),
        (None, {"adaptive": 1, "max_step": 10.0}, {"t": 9.0, "step": 0.995}, (10.0, 1.0)),
    ],
    ids=["grid", "node before the grid", "node on the grid", "stretched to the end"],
)
def test_a_step_is_aimed(
    node: float | None, plan: dict[str, float], now: dict[str, float], aimed: tuple[float, ...]
) -> None:
    """Assert end, length and landing: t0 + n h to the bit, a node, both within the snap, and the rest before the end."""
    run = made_by_hand() if node is None else made_by_hand(nodes=np.array([node]))
    for room, values in ((run.plan[0], plan), (run.now[0], now)):
        for name, value in values.items():
            setattr(room, name, value)
    plain(loop.aim_step)(run)
    assert (run.trial[0].t, run.trial[0].h, run.trial[0].landing)[: len(aimed)] == aimed


@pytest.mark.parametrize(("step", "most", "why"), [(1e-20, 1e6, STEP_TOO_SMALL), (0.1, 0.0, STEP_LIMIT)])
def test_aim_ends_a_run_that_cannot_go_on(step: float, most: float, why: int) -> None:
    """Assert that a step below the spacing of t, or one too many, ends the run where it stands."""
    run = made_by_hand()
    run.plan[0].step_size, run.plan[0].start, run.plan[0].most_steps, run.now[0].t = step, 1.0, most, 1.0
    plain(loop.aim_step)(run)
    assert run.now[0].status == why
    assert run.now[0].h == run.trial[0].h


@pytest.mark.parametrize(
    ("state", "limited", "iterations", "reason"),
    [
        ([1.0, 2.0, 3.0], 0, 0, SOUND),
        ([1.0, np.inf, 3.0], 1, 0, REASON_NONFINITE),
        ([1.0, np.nan, 3.0], 0, 0, REASON_NONFINITE),
        ([1.0, np.nan, 3.0], 1, 0, REASON_DOMAIN),
        ([np.nan, np.nan, np.nan], 1, -1, REASON_NEWTON),
    ],
)
def test_judge_names_one_reason(state: list[float], limited: int, iterations: int, reason: int) -> None:
    """Assert the reason for every kind of trial."""
    run = made_by_hand(z=np.array(state))
    run.plan[0].limited, run.trial[0].iterations = limited, iterations
    run.trial[0].unsound = 0.0 if np.isfinite(state).all() else np.nan
    assert plain(control.judge_trial)(run) == reason


def test_judge_event_functions() -> None:
    """Assert that an event function that is no number has a reason of its own."""
    run = made_by_hand(detectors=np.zeros(1, DETECTOR), g1=np.array([np.nan]))
    run.trial[0].unsound_events = np.nan
    assert plain(control.judge_trial)(run) == REASON_EVENT_FUNCTION


def test_judge_errors() -> None:
    """Assert that the largest scaled error decides, and is kept as the norm."""
    run = made_by_hand(
        e=np.array([1e-3, 3e-3]), atol=np.array([1e-2, 1e-3]), y=np.array([0.0, 1.0, 0.0]), z=np.zeros(3)
    )
    run.plan[0].estimates, run.plan[0].adaptive, run.plan[0].rtol = 1, 1, 1e-3
    assert plain(control.judge_trial)(run) == REASON_ERROR
    assert run.now[0].norm == 3e-3 / (1e-3 + 1e-3)


def test_accept_notes_and_moves() -> None:
    """Assert that an accepted trial is a row and the place to go on from."""
    run = made_by_hand(z=np.array([1.0, 2.0, 3.0]))
    run.trial[0].t, run.trial[0].h, run.trial[0].landing = 0.5, 0.25, control.AT_GRID
    plain(loop.accept)(run)
    assert run.y.tolist() == [1.0, 2.0, 3.0]
    assert run.log_rows[:5, 1].tolist() == [0.5, 0.25, 1.0, 2.0, 3.0]
    assert run.log_flags[:, 1].tolist() == [STEP, 0]
    assert (run.now[0].t, run.now[0].rows, run.now[0].grid, run.now[0].status) == (0.5, 2, 1, RUNNING)


def test_accept_at_a_node_and_at_the_end() -> None:
    """Assert that a breakpoint is a node, and that the end completes the run and is none."""
    run = made_by_hand(nodes=np.array([0.5]))
    run.trial[0].t, run.trial[0].h, run.trial[0].landing = 0.5, 0.5, control.AT_NODE
    plain(loop.accept)(run)
    assert (run.log_flags[0, 1], run.now[0].node, run.now[0].on_grid) == (NODE, 1, 0)
    run.trial[0].t, run.trial[0].h, run.trial[0].landing = 10.0, 9.5, control.AT_BOTH
    plain(loop.accept)(run)
    assert (run.log_flags[0, 2], run.now[0].status) == (STEP, COMPLETED)


def test_reject_keeps_a_row_and_shortens() -> None:
    """Assert that a rejected trial is kept with its reason, and the next one is shorter, from the same state."""
    run = made_by_hand()
    run.plan[0].adaptive, run.plan[0].order, run.plan[0].safety, run.plan[0].least = 1, 5.0, 0.9, 0.2
    run.now[0].norm, run.now[0].step, run.trial[0].h = 32.0, 0.5, 0.5
    plain(loop.reject)(run, REASON_ERROR)
    row = run.log_trials[0]
    assert (row["step_size"], row["error_norm"], row["reason"], row["step"]) == (0.5, 32.0, REASON_ERROR, 0)
    assert run.now[0].step == pytest.approx(0.5 * 0.9 / 2)
    assert (run.now[0].rejected, run.now[0].status, run.now[0].trials) == (1, RUNNING, 1)


def test_reject_ends_a_fixed_grid() -> None:
    """Assert that without chosen steps the reason of the trial is how the run ended: one vocabulary."""
    run = made_by_hand()
    plain(loop.reject)(run, REASON_DOMAIN)
    assert run.now[0].status == REASON_DOMAIN
    assert OUTCOMES[REASON_DOMAIN].word == "nonfinite_state"
    assert set(OUTCOMES) >= {
        i for i, word in enumerate(TRIAL_REASONS) if word not in ("contact_solve", "event_substep")
    }


def test_growth_is_held_after_a_rejection() -> None:
    """Assert that the step after a rejected one does not grow, and that a cut step costs none of the pace."""
    run = made_by_hand()
    plan, now = run.plan[0], run.now[0]
    plan.order, plan.safety, plan.least, plan.greatest, plan.max_step = 5.0, 0.9, 0.2, 10.0, 100.0
    now.norm, now.rejected, now.step = 1e-9, 1, 1.0
    plain(control.grow_step)(run, 0.5, False)
    assert (now.step, now.rejected) == (0.5, 0)
    now.step = 2.0
    plain(control.grow_step)(run, 1e-6, True)
    assert now.step == 2.0


def falling(*arrays: NDArray[np.float64]) -> None:
    """Exact fall from rest under a = -2, for a law of one coordinate."""
    at, y, z = arrays[0], arrays[1], arrays[5]
    h = at[H]
    z[0], z[1], z[2], at[UNSOUND] = y[0] + h * y[1] - h * h, y[1] - 2 * h, -2.0, 0.0


def height(*arrays: NDArray[np.float64]) -> None:
    """An event function: height."""
    arrays[5][0], arrays[0][UNSOUND] = arrays[1][0], 0.0


def nothing(*_arrays: NDArray[np.float64]) -> None:
    """A program that computes nothing."""


def dropped(stops: int = 0, seen: Callable[[float], float] = float, tolerance: float = 1e-12) -> Run:
    """A mass that falls from 1 m: it passes zero at t = 1 s, after one step of 0.75 s and in the next."""

    def watched(*arrays: NDArray[np.float64]) -> None:
        height(*arrays)
        arrays[5][0] = seen(arrays[5][0])

    detectors = np.zeros(1, DETECTOR)
    detectors[0].direction, detectors[0].tolerance, detectors[0].action = -1, tolerance, stops
    detectors["position"] = np.inf  # no place is asked for, only a time
    arrays = dict.fromkeys(("g", "g1", "located_g", "slopes", "entered", "pending"))
    watches = np.zeros(1, WATCH)
    watches["armed"] = watches["ever"] = watches["alive"] = 1
    law = law_of(nothing, watched, nothing, nothing, nothing, kept, nothing, falling)
    run = made_by_hand(
        y=np.array([1.0, 0.0, -2.0]),
        law=law,
        detectors=detectors,
        log_trials=np.zeros(500, made_by_hand().log_trials.dtype),
        log_events=np.zeros(5, EVENT_ROW),
        watches=watches,
        **{name: np.zeros(1) for name in arrays},
    )
    run.plan[0].step_size, run.plan[0].stages, run.plan[0].apart, run.g[0] = 0.75, 1, 1, seen(1.0)
    return run


def found(run: Run, h: float, t: float = 0.0) -> None:
    """Make a trial in the whole of which every event function is known to cross, once."""
    plain(trial_step.propose_step)(run, t + h, h)
    plain(trial_step.evaluate_events)(run)
    plain(trial_step.store_trial)(run)
    run.watches["hit"], run.watches["left"], run.watches["right"] = zero_tests.CROSSED, 0.0, h


def test_propose_leaves_the_state() -> None:
    """Assert that a trial fills z, and a look at it the event functions there, and nothing else moves."""
    run = dropped()
    before = run.y.copy()
    plain(trial_step.propose_step)(run, 0.75, 0.75)
    plain(trial_step.evaluate_events)(run)
    assert run.z.tolist() == [1 - 0.75**2, -1.5, -2.0]
    assert run.g1[0] == run.z[0]
    assert np.array_equal(run.y, before)
    assert run.now[0].evaluations == 1


@pytest.mark.parametrize("apart", [0, 1])
def test_locate_ends_the_trial_behind_the_event(apart: int) -> None:
    """Assert that the located trial brackets the root within the tolerance and is the one that is kept."""
    run = dropped()
    run.plan[0].apart = apart
    found(run, 1.5)
    plain(root_finding.locate_events)(run)
    h = run.trial[0].h
    assert 0 <= h - 1.0 <= 1e-12
    assert run.watches[0].left < 1.0 <= h
    assert run.z[0] == 1.0 - h * h


def itp(g: Callable[[float], float], high: float, tolerance: float) -> Iterator[float]:
    """Oliveira and Takahashi 2021, algorithm 1, in their symbols: kappa_1 = 0.2/(b - a), kappa_2 = 2, n_0 = 1."""
    a, b, g_a, g_b, kappa = 0.0, high, g(0.0), g(high), 0.2 / high
    most = math.ceil(math.log2(high / tolerance)) + 1
    for j in range(most + 1):
        if b - a <= tolerance:
            break
        half = (a + b) / 2
        r, delta = tolerance / 2 * 2.0 ** (most - j) - (b - a) / 2, kappa * (b - a) ** 2
        x_f = (g_b * a - g_a * b) / (g_b - g_a)
        sigma = math.copysign(1.0, half - x_f)
        x_t = x_f + sigma * delta if delta <= abs(half - x_f) else half
        x = x_t if abs(x_t - half) <= r else half - sigma * r
        yield x
        if g(x) > 0:
            a, g_a = x, g(x)
        else:
            b, g_b = x, g(x)


@pytest.mark.parametrize(
    "seen",
    [float, lambda x: x**3, lambda x: math.copysign(1.0, x), lambda x: x if x > 0 else 1e-6 * x, math.atan],
    ids=["smooth", "flat", "jump", "lopsided", "bent"],
)
@pytest.mark.parametrize("tolerance", [1e-6, 1.5 / 1024])
def test_substeps_are_those_of_the_paper(seen: Callable[[float], float], tolerance: float) -> None:
    """Assert the points at which ITP looks, one after the other, for event functions of several shapes."""
    run = dropped(seen=seen, tolerance=tolerance)
    found(run, 1.5)
    plain(root_finding.locate_events)(run)
    wanted = list(itp(lambda h: seen(1 - h * h), 1.5, tolerance))
    assert run.log_trials["step_size"][: run.now[0].trials] == pytest.approx(wanted, rel=1e-12)


@pytest.mark.parametrize(
    ("t", "tolerance"), [(0.0, 1.5 / 1024), (0.0, 0.0), (-1.0, 0.0), (1e6, 1e-15), (-1e6, 1e-15), (1e6, 1.5 / 64)]
)
def test_no_bracket_is_narrower_than_t_can_be_told(t: float, tolerance: float) -> None:
    """Assert that a jump is halved to its tolerance, or to twice the rounding of t, and no more often."""
    run = dropped(seen=lambda x: math.copysign(1.0, x), tolerance=tolerance)
    run.now[0].t = t
    found(run, 1.5, t)
    plain(root_finding.locate_events)(run)
    floor = 2 * np.finfo(float).eps * max(abs(t), abs(t + 1.5))
    assert run.now[0].trials == math.ceil(math.log2(1.5 / max(tolerance, floor)))


@pytest.mark.parametrize("side", [1, -1])
def test_a_point_on_an_end_of_the_bracket_is_moved_inside(side: int) -> None:
    """Assert that a bracket closes where one end is so near to zero that interpolation comes back to it."""
    run = dropped(seen=lambda x: x * 1e-30 if x * side > 0 else x)
    found(run, 1.5)
    plain(root_finding.locate_events)(run)
    assert 0 < run.trial[0].h - run.watches[0].left <= 1e-12
    assert run.now[0].trials <= 41 + 1 + 1  # halvings, what the method adds, the point that was moved


def bracketed(monkeypatch: pytest.MonkeyPatch, h: float, root: float, tolerance: float, **instead: object) -> Run:
    """Bracket one event of a step, a part of the search replaced."""
    run = dropped(seen=lambda x: x - (1 - root * root), tolerance=tolerance)
    found(run, h)
    for name, function in instead.items():
        monkeypatch.setitem(plain(root_finding.narrow_bracket).__globals__, name, function)
    plain(root_finding.narrow_bracket)(run, 0, 0.0)
    plain(trial_step.restore_trial)(run)
    return run


@pytest.mark.parametrize(
    ("end", "h", "root", "wanted"),
    [
        (0, 1.5, 1.0, [k / 8 for k in range(1, 9)]),
        (0, 1.0625, 1.0, [*(k / 8 for k in range(1, 8)), 0.96875]),
        (1, 1.5, 1.0, [1.375, 1.25, 1.125, 1.0, 0.875]),
        (1, 0.1875, 0.0625, [0.09375]),
    ],
)
def test_a_point_on_an_end_is_probed_a_tolerance_inside(
    monkeypatch: pytest.MonkeyPatch, end: int, h: float, root: float, wanted: list[float]
) -> None:
    """Assert where the search looks if interpolation gives nothing but an end: a tolerance from it, or in the middle."""
    run = bracketed(monkeypatch, h, root, 0.125, itp=lambda *bracket: bracket[end])
    assert run.log_trials["step_size"][: run.now[0].trials].tolist() == wanted


def test_a_search_that_comes_to_nothing_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no more substeps are made than the log has room for, and none at a point that is no number."""
    endless = bracketed(monkeypatch, 1.5, 1.0, 1e-9, itp=lambda *bracket: bracket[0])
    assert endless.now[0].trials == MOST_SUBSTEPS - 1
    assert bracketed(monkeypatch, 1.5, 1.0, 1e-9, itp=lambda *_: math.nan).now[0].trials == 0


def test_a_substep_that_was_not_solved_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the bracket stays as wide as it is where equations were not solved."""

    def unsolved(run: Run, _i: int, _s: float) -> None:
        run.trial[0].iterations, run.g1[0] = -1, -1.0

    run = bracketed(monkeypatch, 1.5, 1.0, 1e-9, evaluate_part=unsolved)
    assert (run.watches[0].left, run.trial[0].h) == (0.0, 1.5)


def test_an_event_that_another_one_brings_to_light_has_the_whole_step() -> None:
    """Assert the bracket of an event that has crossed where an other one ends the step, and not at its end."""
    run = dropped()
    detectors = np.zeros(2, DETECTOR)
    detectors["tolerance"], detectors["position"] = 1e-9, np.inf

    def both(*arrays: NDArray[np.float64]) -> None:
        h = math.sqrt(max(0.0, 1 - arrays[1][0]))
        arrays[5][:2], arrays[0][UNSOUND] = [(h - 0.25) * (h - 1.25), 0.5 - h], 0.0

    arrays = {name: np.zeros(2) for name in ("g1", "located_g", "slopes")}
    run.put(
        law=law_of(nothing, both, nothing, nothing, nothing, kept, nothing, falling),
        detectors=detectors,
        g=np.array([0.3125, 0.5]),
        watches=np.zeros(2, WATCH),
        **arrays,
    )
    run.watches["armed"] = 1
    found(run, 1.5)
    plain(root_finding.locate_events)(run)
    assert run.trial[0].h == pytest.approx(0.5, abs=1e-9)
    assert run.watches[0].left == 0.0
    assert 0.0 < run.trial[0].h - run.watches[1].left <= 1e-9


def test_the_located_trial_comes_back_whole() -> None:
    """Assert that every number of a trial is kept and taken back, whether it was sound among them."""
    run = dropped()
    run.put(samples=np.zeros(3), located_samples=np.zeros(3))
    for i, name in enumerate(TRIAL.names, start=1):
        run.trial[name] = i
    arrays = [run.z, run.e, run.g1, run.samples]
    for array in arrays:
        array[:] = np.arange(1.0, len(array) + 1)
    before = [one.tobytes() for one in (run.trial, *arrays)]
    plain(trial_step.store_trial)(run)
    run.trial[:] = np.zeros(1, TRIAL)
    for one in arrays:
        one[:] = 0.0
    plain(trial_step.restore_trial)(run)
    assert [one.tobytes() for one in (run.trial, *arrays)] == before


@pytest.mark.parametrize("stops", [0, 1])
def test_hand_over_writes_both_sides_without_another_step(monkeypatch: pytest.MonkeyPatch, stops: int) -> None:
    """Assert two rows at one time, one event, and that the event's state is the located trial, not made again."""
    run = dropped(stops)
    found(run, 1.5)
    run.located[0].landing = control.AT_GRID
    for phase, name in ((landing.note_events, "function_uncertainty"), (departures.rearm, "arm_event")):
        monkeypatch.setitem(plain(phase).__globals__, name, lambda *_: 0.0)
    plain(landing.locate_and_land)(run)
    assert run.now[0].evaluations == run.now[0].trials
    event, row = run.log_events[0], int(run.log_events[0].row_before)
    assert run.now[0].events == 1
    assert run.log_flags[0, row : row + 2].tolist() == [EVENT_BEFORE, EVENT_AFTER]
    assert run.log_rows[0, row] == run.log_rows[0, row + 1] == event.time == run.now[0].t
    assert run.log_rows[1, row + 1] == 0.0
    assert event.direction == -1
    assert run.now[0].status == (STOPPED if stops else RUNNING)
    assert not run.now[0].on_grid


def test_a_trial_that_ends_where_bodies_meet_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that one that fails the error test is not landed on, and that nothing is judged where links cannot be watched."""
    land = plain(assembly_phases.land_on_meeting)
    verdicts, landed = [REASON_ERROR, SOUND], []
    monkeypatch.setitem(land.__globals__, "judge_trial_apart", lambda _: verdicts.pop(0))
    monkeypatch.setitem(land.__globals__, "pass_meeting", landed.append)
    run = made_by_hand(counters=np.zeros(50, np.int64), spans=np.zeros(50))
    run.counters[MEETS] = assembly_phases.FREELY
    assert (land(run), landed) == (REASON_ERROR, [])
    assert (land(run), landed) == (REASON_EVENT, [run])
    run.counters[MEETS] = assembly_phases.AT_A_LOSS
    assert (land(run), landed, verdicts) == (REASON_EVENT, [run], [])
