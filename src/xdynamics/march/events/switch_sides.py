"""Sides of the switches hidden in forces: taken at the start, kept along steps, changed at events.

Ticks of controllers change the values that these hold, all from the values just before. Nodes may have periodic events.
"""

from __future__ import annotations

from math import isnan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.drive_tables import find_piece_of_table
from xdynamics.kernels.law import DETECT, RESETS, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.control import AT_BOTH, AT_NODE
from xdynamics.march.events.departures import CROWDED, moment, step_ahead
from xdynamics.march.events.root_finding import event_kind, has_passed
from xdynamics.march.events.zero_tests import CROSSED, FORCED, NONE, event_resolution, sign_of
from xdynamics.march.force_evaluation import evaluate_forces, put_reset_value, set_time
from xdynamics.march.phases import WATCHERS, phase
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.model.detectors import KINK, PERIODIC, SWITCH
from xdynamics.schema import JUMP

State = NDArray[Any]


@phase(WATCHERS)
def take_sides(run: Run) -> None:
    """Determine the side of each switch that the march is on or, where it starts on a switch, goes to."""
    zero = False
    set_time(run, T, run.now[0].t)
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].drive >= 0:
            enter_piece(run, i, find_table_piece(run, i, run.y, 0.0))
    for _ in range(run.detectors.shape[0]):  # a side may decide which others count: those inside a `where`
        call_law(run.law[DETECT], run, run.y, run.g, 0)
        zero, changed = False, False
        for i in range(run.detectors.shape[0]):
            detector = run.detectors[i]
            if detector.role in (SWITCH, KINK):
                zero = zero or run.g[i] == 0.0
                if detector.drive < 0:
                    # the call stands first: `or` would skip it once anything has changed
                    changed = take_side(run, i, sign_of(run.g[i]) if run.g[i] != 0.0 else detector.at_zero) or changed
        if not changed:
            break
    if zero:
        leave_zeros(run)


@jit_separate
def leave_zeros(run: Run) -> None:
    """Set the side that the motion enters from a switch; tables first, since other switches may read them."""
    evaluate_forces(run, run.now[0].t, run.y)
    call_law(run.law[SLOPES], run, run.y, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].drive >= 0 and run.g[i] == 0.0:
            enter_piece(run, i, find_table_piece(run, i, run.y, argument_motion(run, i, run.y)))
    for _ in range(run.detectors.shape[0]):
        call_law(run.law[DETECT], run, run.y, run.g, 0)
        call_law(run.law[SLOPES], run, run.y, run.slopes, 0)
        changed = False
        for i in range(run.detectors.shape[0]):
            if is_switch(run, i):
                side = sign_of(run.g[i]) if run.g[i] != 0.0 else sign_of(run.slopes[i])
                changed = (side != 0 and take_side(run, i, side)) or changed
        if not changed:
            break
    leave_flat_zeros(run)


@jit_separate
def leave_flat_zeros(run: Run) -> None:
    """Set the side reached a moment later by switches whose value and rate are both zero.

    So is the second in ``max(0, sign(x))``: a sign has no rate, and is 0 at the start alone.
    """
    if not has_flat_zeros(run):
        return
    step_ahead(run, run.y, moment(run))
    call_law(run.law[DETECT], run, run.z, run.g1, 0)
    set_time(run, T, run.now[0].t)
    for i in range(run.detectors.shape[0]):
        if is_flat(run, i) and run.g1[i] != 0.0:
            take_side(run, i, sign_of(run.g1[i]))


@jit_separate
def has_flat_zeros(run: Run) -> bool:
    """Whether the functions of any switches and their rates are zero."""
    flat = False
    for i in range(run.detectors.shape[0]):
        flat = flat or is_flat(run, i)
    return flat


@jit_separate
def is_flat(run: Run, i: int) -> bool:
    """Whether a detector is a switch whose function and its rate are zero."""
    return bool(is_switch(run, i) and run.g[i] == 0.0 and run.slopes[i] == 0.0)


@jit_inline
def is_switch(run: Run, i: int) -> bool:
    """Whether a detector is a switch or kink of an expression, not the end of a table's piece."""
    return bool(run.detectors[i].role in (SWITCH, KINK) and run.detectors[i].drive < 0)


@jit_separate
def take_side(run: Run, i: int, where: int) -> bool:
    """Set forces to one side of a switch; whether they were on another."""
    if run.modes[run.detectors[i].to] == float(where) and run.watches[i].guard == where:
        return False
    choose_side(run, i, where)
    return True


@jit_separate
def choose_side(run: Run, i: int, where: int) -> None:
    """Set forces to one side of a switch, and guard that side."""
    run.modes[run.detectors[i].to], run.watches[i].guard = float(where), where


@jit_separate
def keep_sides(run: Run, state_was_set: bool, landed: bool) -> bool:
    """Set all switches to the sides of the trial's state after an event; whether any side changed.

    `state_was_set` says that the event may have set the state elsewhere, beyond several points of a table, say; `landed` that
    switches on which the trial ends are passed. Else they have been, and rounding would decide on their sides.
    """
    set_time(run, T, run.trial[0].t)
    call_law(run.law[DETECT], run, run.z, run.slopes, 0)
    changed = keep_pieces(run, state_was_set, landed)
    if changed:  # conditions on a table's value are evaluated with the piece after the point
        call_law(run.law[DETECT], run, run.z, run.slopes, 0)
    for _ in range(run.detectors.shape[0]):
        switched = False
        for i in range(run.detectors.shape[0]):
            detector, watch = run.detectors[i], run.watches[i]
            if is_switch(run, i) and (landed or watch.hit == NONE):
                side = sign_of(run.slopes[i])
                side_before = np.int64(run.modes[detector.to])
                if watch.hit in (CROSSED, FORCED):
                    side = -watch.armed
                if side != 0 and side != side_before:
                    choose_side(run, i, side)
                    switched = True
        if not switched:
            break
        changed = True
        call_law(run.law[DETECT], run, run.z, run.slopes, 0)  # conditions inside the branch of a `where` that holds now
    return changed


@jit_separate
def keep_pieces(run: Run, state_was_set: bool, landed: bool) -> bool:
    """Enter the pieces of tables that the trial's state is in now; whether any was entered."""
    changed = False
    for i in range(run.detectors.shape[0]):
        detector, hit = run.detectors[i], run.watches[i].hit != NONE
        if hit and not landed:
            continue
        if detector.drive < 0 or not (hit or (state_was_set and not run.slopes[i] > 0.0)):
            continue
        piece, piece_before = (
            find_table_piece(run, i, run.z, argument_motion(run, i, run.z)),
            run.places[3 * detector.drive + 2],
        )
        if hit and (piece == piece_before or not state_was_set):
            piece = passed_into(run, i)
        enter_piece(run, i, piece)
        changed = True
    return changed


@jit_separate
def slides_along_switch(run: Run) -> bool:
    """Whether the motion is driven back to a switch at which a force jumps, or to an event behind which another regime holds.

    It was driven there on the side before, too.

    For a table, the side after the switch is inside the next piece, where its function is positive again. At a switch
    where a force has a kink, being driven back is rest: with ``sign(v)*sqrt(abs(v))`` a motion is at zero after a
    finite time. What the force on the side beyond does to it in a step counts as zero from there on. Nothing drives time
    back, nor a function that has jumped over zero: that of ``where(mod(q, b) < b/2, …)``.
    """
    sliding = False
    set_time(run, T, run.trial[0].t)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        detector, watch = run.detectors[i], run.watches[i]
        if passes_switch(run, i):
            # a trial that solves equations anew may end before a switch that it was to end behind
            driven_back = run.slopes[i] * side_behind(run, i) < 0.0 and has_passed(run, i, run.g1[i])
            sliding = sliding or driven_back
        elif detector.slides > 0 and watch.hit in (CROSSED, FORCED) and event_kind(run, i) != JUMP:
            sliding = sliding or run.slopes[i] * -watch.armed < 0.0
        elif detector.role == KINK and detector.drive < 0 and watch.hit in (CROSSED, FORCED):
            watch.floor = abs(run.slopes[i]) * run.located[0].h if run.slopes[i] * -watch.armed < 0.0 else 0.0
    return sliding or rests_on_switch(run)


@jit_separate
def rests_on_switch(run: Run) -> bool:
    """Whether the motion was at a switch a moment ago, and would be there again in another, driven back from both sides.

    Where forces drive the rate of its function alone, as those on a mass drive its velocity, passages that crowd together
    so have no motion behind them.
    """
    crowds = False
    for i in range(run.detectors.shape[0]):
        if passes_switch(run, i):
            crowds = crowds or run.trial[0].h <= CROWDED * event_resolution(run, i, 0.0)
    if not crowds:
        return False
    find_bends(run)
    for i in range(run.detectors.shape[0]):
        bend, pause = run.arguments[i], CROWDED * event_resolution(run, i, 0.0)
        returns = bend * side_behind(run, i) < 0.0 and 2.0 * abs(run.slopes[i]) <= pause * abs(bend)
        if returns and passes_switch(run, i):
            return True
    return False


@jit_separate
def passes_switch(run: Run, i: int) -> bool:
    """Whether the motion passes a switch or a point of a table at the trial's end, neither of time nor by a jump over it."""
    detector, hit = run.detectors[i], run.watches[i].hit
    passed = detector.role == SWITCH and hit in (CROSSED, FORCED) and not detector.of_time
    return bool(passed and event_kind(run, i) != JUMP)


@jit_inline
def side_behind(run: Run, i: int) -> int:
    """The sign of a switch's function behind the trial's end; in the next piece of a table it is positive again."""
    return int(run.watches[i].guard if run.detectors[i].drive >= 0 else -run.watches[i].armed)


@jit_separate
def find_bends(run: Run) -> None:
    """Leave in `arguments` how fast the rates of event functions change, by those a moment after the trial's state.

    The evaluation of forces that this takes is no part of a step, and is not counted.
    """
    evaluations, duration = run.now[0].evaluations, moment(run)
    copy_numbers(run.z, run.whole)
    copy_numbers(run.slopes, run.arguments)
    step_ahead(run, run.whole, duration)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.slopes.shape[0]):
        before = run.arguments[i]
        run.arguments[i], run.slopes[i] = (run.slopes[i] - before) / duration, before
    copy_numbers(run.whole, run.z)
    set_time(run, T, run.trial[0].t)
    run.now[0].evaluations = evaluations


@jit_separate
def find_table_piece(run: Run, i: int, state: State, rate: float) -> int:
    """Return the piece of a table that a state is in; at a point between two, the piece into which it moves.

    A state leaves the ends of the table only once it moves, not when about to: beyond, the force may differ at once.
    """
    detector = run.detectors[i]
    first, count = run.places[3 * detector.drive], run.places[3 * detector.drive + 1]
    x, speed, _ = table_argument(run, i, state)
    piece = find_piece_of_table(x, run.tables, first, count)
    if x == run.tables[first + count - 1] and rate != 0.0 and speed > 0.0:
        return count - 1
    if (
        piece == count - 2
        and rate != 0.0
        and speed > 0.0
        and last_piece_is_point(run, i)
        and not isnan(run.tables[first + 5 * count - 1])
    ):
        return count - 1
    moves_back = rate < 0.0 if piece > 1 else rate != 0.0 and speed < 0.0
    return piece - 1 if moves_back and piece > 0 and x == run.tables[first + piece] else piece


@jit_separate
def last_piece_is_point(run: Run, i: int) -> bool:
    """Whether the last piece of a table is no wider than rounding: its last value holds at one point only."""
    first, count = run.places[3 * run.detectors[i].drive], run.places[3 * run.detectors[i].drive + 1]
    last = run.tables[first + count - 1]
    return bool(last - run.tables[first + count - 2] <= 4.0 * EPS * max(abs(last), last - run.tables[first]))


@jit_separate
def argument_motion(run: Run, i: int, state: State) -> float:
    """Return how fast a table's argument moves, or is about to."""
    _, speed, turn = table_argument(run, i, state)
    return speed if speed != 0.0 else turn


@jit_separate
def table_argument(run: Run, i: int, state: State) -> tuple[float, float, float]:
    """Return a table's argument at a state, its rate, and its second derivative, which sets it in motion from rest."""
    detector = run.detectors[i]
    if detector.argument >= 0:
        return state[detector.argument], state[detector.rate], state[detector.turn]
    call_law(run.law[SLOPES], run, state, run.arguments, 0)
    first = -1 - detector.argument
    return run.arguments[first], run.arguments[first + 1], run.arguments[first + 2]


@jit_separate
def passed_into(run: Run, i: int) -> int:
    """Return the piece after the point that the trial has passed, or a later one."""
    detector = run.detectors[i]
    x, mode_index = table_argument(run, i, run.z)[0], detector.to
    last_piece, piece = (
        run.places[3 * detector.drive + 2],
        find_table_piece(run, i, run.z, argument_motion(run, i, run.z)),
    )
    # distances to the piece's two ends, as `enter_piece` scales them: the passed end has the lesser
    upwards = (
        run.modes[mode_index + 3] - run.modes[mode_index + 2] * x
        < run.modes[mode_index] * x + run.modes[mode_index + 1]
    )
    return max(piece, last_piece + 1) if upwards else min(piece, last_piece - 1)


@jit_separate
def enter_piece(run: Run, i: int, piece: int) -> None:
    """Let forces follow one piece of a table, and guard its ends.

    Where the model ends with its table, there is no end to guard: values beyond it are NaN.
    """
    drive, mode_index = run.detectors[i].drive, run.detectors[i].to
    first, count = run.places[3 * drive], run.places[3 * drive + 1]
    run.places[3 * drive + 2] = piece
    run.watches[i].guard = 1
    low, high = run.tables[first + piece], run.tables[first + min(piece + 1, count - 1)]
    if piece == count - 1 and last_piece_is_point(
        run, i
    ):  # from beyond, too, such a value is passed with the piece before it
        low = high = run.tables[first + count - 2]
    inverse = 1.0 / (high - low) if high > low else 1.0 / (run.tables[first + count - 1] - run.tables[first])
    constant = first + 4 * count + piece  # the value at the beginning of a piece
    left = piece > 0 and not isnan(run.tables[constant - 1])
    right = piece < count - 1 and not isnan(run.tables[constant + 1])
    if piece == count - 3 and isnan(run.tables[first + 5 * count - 1]):  # a last value that holds at one point only
        right = not last_piece_is_point(run, i)
    # an end with nothing beyond keeps the distance 1, so that it is never reached
    run.modes[mode_index] = inverse if left else 0.0
    run.modes[mode_index + 1] = -(inverse * low) if left else 1.0
    run.modes[mode_index + 2] = inverse if right else 0.0
    run.modes[mode_index + 3] = inverse * high if right else 1.0


@jit_separate
def tick_at_start(run: Run) -> None:
    """Let controllers act at the start, before anything else reads their values."""
    if run.ticks.shape[0] > 0 and run.ticks[0] != 0:
        evaluate_forces(run, run.now[0].t, run.y)
        apply_actions(run, run.ticks[0], run.now[0].t, run.y)


@jit_separate
def tick_at_end(run: Run) -> bool:
    """Let controllers act at the end of a trial, if it is a tick; whether it is."""
    if not ticks_at_end(run):
        return False
    apply_actions(run, run.ticks[run.now[0].node + 1], run.trial[0].t, run.z)
    evaluate_forces(run, run.trial[0].t, run.z)
    return True


@jit_separate
def ticks_at_end(run: Run) -> bool:
    """Whether controllers act at the end of a trial that reaches its node."""
    landed = run.ticks.shape[0] > 0 and run.trial[0].landing in (AT_NODE, AT_BOTH)
    return bool(landed and run.ticks[run.now[0].node + 1] != 0)


@jit_separate
def rings_at_end(run: Run) -> bool:
    """Whether periodic events are met at the end of a trial."""
    now = run.now[0]
    landed = run.alarms.shape[0] > 0 and run.trial[0].landing in (AT_NODE, AT_BOTH)
    return bool(landed and run.alarms[now.node + 1] != 0)


@jit_separate
def ring_events(run: Run) -> None:
    """Add the periodic events at the trial's end to those of its group."""
    due, number = run.alarms[run.now[0].node + 1], 0
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].role == PERIODIC:
            if (due >> number) & 1 == 1:
                run.watches[i].hit, run.watches[i].armed = CROSSED, -1
            number += 1


@jit_separate
def apply_actions(run: Run, actions: int, t: float, state: State) -> None:
    """Set the changes of some actions in a state, all from the state's former values."""
    set_time(run, T, t)
    call_law(run.law[RESETS], run, state, run.resets, 0)
    for k in range(run.targets.shape[0]):
        action = -1 - run.targets[k, 0]
        if action >= 0 and (actions >> action) & 1 == 1:
            put_reset_value(run, k, state)
