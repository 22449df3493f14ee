"""Entries of the compiled engine besides `loop.march`: many marches, states inside steps, growth of errors.

A state inside a step is judged by its distance from a more accurate one.

Inside a step over impacts of many links, each impulse of the step is spread over it, as a force that is constant. So
recorded forces act, which are means over steps, and links are solved for once, not for each time inside.

The growth of an error along a run is the distance of two marches side by side from one of its rows. Both take the same
steps of the Bogacki-Shampine pair of order 3 and 2 (1989, Applied Mathematics Letters 2, 321), as long as two digits of
their distance allow: the distance is the tangent map of the motion times a vector, by differences.
"""

from __future__ import annotations

from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.law import INSIDE
from xdynamics.kernels.program import REGIME, T1, H, S, T
from xdynamics.march.assembly.broad_phase import FAULT, SPREAD, TOGETHER
from xdynamics.march.assembly.closed_links import recall_closed
from xdynamics.march.assembly.phases import find_closed, go_on_with_links
from xdynamics.march.calls import call_law, floats_at, march_by, run_at
from xdynamics.march.contacts.phases import inform_forces, settle_contacts
from xdynamics.march.events.departures import STRAYS
from xdynamics.march.events.switch_sides import take_sides
from xdynamics.march.force_evaluation import evaluate_forces, state_slope
from xdynamics.march.implicit.newton import newton_step
from xdynamics.march.implicit.radau import radau_step
from xdynamics.march.log import events_fit, is_empty, overwrite_log
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.past import enter_past
from xdynamics.march.run import (
    BEGUN,
    KEPT,
    PIECE,
    TOUCH,
    TRIAL,
    WATCH,
    Columns,
    Run,
)
from xdynamics.march.series import series_step
from xdynamics.march.tolerance_sizes import estimate_fastest_rate, fill_derivatives, natural_sizes, time_at
from xdynamics.march.trial_step import copy_numbers, propose_step_apart

Floats = NDArray[np.float64]


@jit_separate
def judge_inside(
    run: Run, s: float, states: Floats, ends: Floats, interior_states: Floats, k: int, solved: bool
) -> None:
    """Replace the single step by the state's distance from two half steps, extrapolated with it.

    Two half steps have 2**-p of the error of the whole one. Rounding is added, one spacing of the numbers that
    were summed; so is the mismatch at the step's end, which is added to the state in proportion to how errors grow.
    """
    n, divisor, cube = states.shape[0], run.plan[0].divisor, s * s * s
    if run.plan[0].extrapolated:
        divisor = 2.0 * divisor + 1.0  # one order higher
    for i in range(n):
        value, whole_step, halves = interior_states[i, k], interior_states[n + i, k], run.z[i] if solved else np.nan
        off = abs((value - halves) + (whole_step - halves) / divisor)
        missing = cube * cube * (ends[i, k] - run.located_z[i]) if ends.shape[0] > 0 else 0.0
        interior_states[i, k] = value + missing
        interior_states[n + i, k] = off + abs(missing) + EPS * max(abs(states[i, k]), abs(value))


@jit_separate
def steps_over_links(run: Run) -> bool:
    """Whether a march steps over the impacts of many links."""
    return bool(run.plan[0].assemblies > 0 and run.plan[0].steps_over > 0)


@jit_separate
def part_with_impulses(run: Run, steps: Columns, k: int, s: float) -> bool:
    """Make the part `s` of a step (start, end, size, time, run in `steps`); whether impulses have a solution."""
    run.trial[0].rest, run.kept[0].since = 0.0, BEGUN
    # times inside one step stand side by side: its impulses are found once, and kept in `whole`
    if k == 0 or s == 1.0 or steps[0, k] != steps[0, k - 1] or steps[4, k] != steps[4, k - 1]:
        run.spans[SPREAD] = 0.0
        propose_step_apart(run, steps[1, k], steps[2, k])
        keep_changes(run)
    if s < 1.0:
        run.spans[SPREAD] = s
        propose_step_apart(run, steps[3, k], s * steps[2, k])
        run.spans[SPREAD] = 0.0
    return bool(run.counters[FAULT] == 0)


@jit_separate
def keep_changes(run: Run) -> None:
    """Store the velocity changes by impulses of the step just made."""
    n = run.plan[0].coordinates
    for i in range(n):
        run.whole[i] = run.z[n + i] - run.half[n + i] if run.counters[TOGETHER] > 0 else 0.0


State = NDArray[Any]

STATES = 12  # two states, their ends, four slopes of each
EVALUATIONS = 6  # per step
SHORT = 2.0**-20  # of the sizes: initial distance, of which ten digits are free of rounding
FAR = 2.0**10  # times that: distance at which they are no longer followed
ROUGH = 1e-3  # of the sizes: allowed error of a step in a state
ROUGHER = 1e-2  # of the distance: allowed error of a step in the distance
FIRST = 1e-2  # of a time scale from sizes and slopes: the first step
SPARE = 1.0 / 16.0  # of the allowed error, below which the next step is twice as long


@jit_separate
def follow_error(run: Run, t: float, moves: Floats, work: Floats, growth_rows: Floats, row: int) -> None:
    """Fill two rows of `growth_rows` with times and ratios of the states' distance to the initial one, as far as they reach.

    Parameters
    ----------
    run : Run
        At the initial state, with its slopes; its state is changed.
    t : float
    moves : ndarray, shape (1 + n, 2)
        First the final time; then the displacement of the second state, and the size of each variable.
    work : ndarray, shape (12, n)
    growth_rows : ndarray, shape (…, k)
        Filled as far as the states were followed.
    row : int
    """
    used, near = run.plan[0].used, 0.0
    for i in range(used):
        near = max(near, abs(moves[1 + i, 0]) / moves[1 + i, 1])
    h = FIRST * time_at(run, run.y)
    if not (near > 0.0 and h > 0.0):
        return
    for i in range(used):
        work[0, i] = run.y[i]
        work[6, i] = run.y[i] + SHORT / near * moves[1 + i, 0]
    fill_slopes(run, t, work[0], work[2])
    fill_slopes(run, t, work[6], work[8])
    far = state_distance(run, work[0], work[6], moves)
    first, count = far, 1
    growth_rows[row, 0], growth_rows[row + 1, 0] = t, 1.0
    for _ in range(growth_rows.shape[1] - 1):
        h = min(h, moves[0, 0] - t)
        if not t + h > t:
            return
        advance_pair(run, t, h, work, 0)
        advance_pair(run, t, h, work, 6)
        norm = error_ratio(run, h, work, far, moves)
        if norm <= 1.0:
            t, far = t + h, state_distance(run, work[1], work[7], moves)
            for i in range(used):
                work[0, i], work[2, i], work[6, i], work[8, i] = work[1, i], work[5, i], work[7, i], work[11, i]
            growth_rows[row, count], growth_rows[row + 1, count] = t, far / first
            count += 1
            if not 0.0 < far < FAR * first:
                return
            enter_pieces(t, run.tables, run.places, run.of_time)
        h *= 2.0 if norm < SPARE else (1.0 if norm <= 1.0 else (0.5 if norm < inf else 0.125))


@jit_separate
def fill_slopes(run: Run, t: float, state: State, slopes: Floats) -> None:
    """Fill `slopes` with the time derivatives at a state."""
    for i in range(run.plan[0].used):
        run.probe[i] = state[i]
    evaluate_forces(run, t, run.probe)
    for i in range(run.plan[0].used):
        slopes[i] = state_slope(run, run.probe, i)


@jit_separate
def advance_pair(run: Run, t: float, h: float, work: Floats, first: int) -> None:
    """Make a step from row `first` of `work` to the next row, with slopes in the four rows after that."""
    used, y, end = run.plan[0].used, work[first], work[first + 1]
    a, b, c, d = work[first + 2], work[first + 3], work[first + 4], work[first + 5]
    for i in range(used):
        end[i] = y[i] + h / 2.0 * a[i]
    fill_slopes(run, t + h / 2.0, end, b)
    for i in range(used):
        end[i] = y[i] + 0.75 * h * b[i]
    fill_slopes(run, t + 0.75 * h, end, c)
    for i in range(used):
        end[i] = y[i] + h * (2.0 * a[i] + 3.0 * b[i] + 4.0 * c[i]) / 9.0
    fill_slopes(run, t + h, end, d)


@jit_separate
def error_ratio(run: Run, h: float, work: Floats, far: float, moves: Floats) -> float:
    """Return the largest ratio of a step's error to the allowed one; inf where something is not finite."""
    largest = 0.0
    for i in range(run.plan[0].used):
        error = error_of(work, 0, h, i)
        distance_error = abs(error_of(work, 6, h, i) - error)
        largest = max(
            largest, abs(error) / (ROUGH * moves[1 + i, 1]), distance_error / (ROUGHER * far * moves[1 + i, 1])
        )
        if not isfinite(error + distance_error):
            return inf
    return largest


@jit_separate
def error_of(work: Floats, first: int, h: float, i: int) -> float:
    """Return the estimated error of a variable in a step from row `first` of `work`."""
    a, b, c, d = work[first + 2, i], work[first + 3, i], work[first + 4, i], work[first + 5, i]
    return h * (-5.0 * a + 6.0 * b + 8.0 * c - 9.0 * d) / 72.0


@jit_separate
def state_distance(run: Run, first_state: State, second_state: State, moves: Floats) -> float:
    """Return the distance of two states, as the largest of their differences over the sizes."""
    distance = 0.0
    for i in range(run.plan[0].used):
        distance = max(distance, abs(second_state[i] - first_state[i]) / moves[1 + i, 1])
    return distance


IntArray = NDArray[np.int64]
Records = NDArray[Any]

END = 1 << 62  # more rows than any run has
_NO_TRIAL, _NO_PIECE, _NOT_KEPT = np.zeros(1, TRIAL), np.zeros(1, PIECE), np.zeros(1, KEPT)
_NO_WATCH, _NO_TOUCH = np.zeros(1, WATCH), np.zeros(1, TOUCH)


def march_in_turn(
    address: Any,
    march_at: Any,
    plans: Records,
    starts: Floats,
    parameters: Floats,
    atols: Floats,
    ends: Records,
    lasts: Floats,
    largest: Floats,
    passed: Floats,
    first: int,
    keeps_rows: bool,
) -> int:
    """March many runs one after the other through one `Run`, from arrays of starts and parameters to the ends.

    Parameters
    ----------
    address : int
        Of a `Run` of their model and method, which holds what the runs share.
    march_at : int
        Address of the compiled `loop.march`, so that it is not compiled a second time.
    plans : ndarray of PLAN, shape (n,)
    starts, parameters, atols : ndarray, shape (n, …)
    ends : ndarray of NOW, shape (n,)
        The final numbers of each run; filled.
    lasts : ndarray, shape (n, …)
        The last row of each run's log; filled.
    largest : ndarray, shape (n, …)
        The largest absolute values, where steps are chosen; filled.
    passed : ndarray, shape (n, …)
        Of each switch declared smooth its side at the end, how often it was passed, and when first; then how many events
        set the motion back when errors had carried it through zero; filled.
    first : int
        The run to begin with, or to go on with if it is already marching.
    keeps_rows : bool
        Whether rows of the log are kept from run to run; otherwise they are overwritten, and only events are kept.

    Returns
    -------
    int
        The run that stopped because the log is full and has to be emptied; n when all are over.
    """
    run = run_at(address)
    now = run.now[0]
    for k in range(first, starts.shape[0]):
        if now.status != RUNNING or now.rows == 0:
            begin_run(run, plans, starts, parameters, atols, k)
        while now.status == RUNNING:
            links_before = run.log_links[0] if run.plan[0].assemblies > 0 else 0
            march_by(march_at, address, END)
            keep_last(run, lasts, k)
            if keeps_rows and run.plan[0].assemblies > 0:
                for i in range(links_before, run.log_links[0]):
                    run.log_closed[0, i] -= run.base[0].rows  # rows of the log, which has those of other runs
            if now.status == RUNNING:
                if keeps_rows or not events_fit(run) or is_empty(run):
                    return k
                overwrite_log(run)
        ends[k] = run.now[0]
        for i in range(largest.shape[1]):
            largest[k, i] = run.largest[i]
        keep_passages(run, passed, k)
    return int(starts.shape[0])


@jit_separate
def keep_last(run: Run, lasts: Floats, k: int) -> None:
    """Copy the last row of the log, if any was written since it was emptied."""
    row = run.now[0].rows - run.base[0].rows - 1
    if row >= 0:
        for i in range(lasts.shape[1]):
            lasts[k, i] = run.log_rows[i, row]


@jit_separate
def keep_passages(run: Run, passed: Floats, k: int) -> None:
    """Copy the numbers of switches declared smooth, the end of the working memory, and count the events that strayed."""
    count, strayed = passed.shape[1] - 1, 0
    for i in range(count):
        passed[k, i] = run.w[run.w.shape[0] - count + i]
    for i in range(run.departures.shape[0]):
        strayed += int(run.departures[i].goes_on & STRAYS != 0)
    passed[k, count] = strayed


@jit_inline
def begin_run(run: Run, plans: Records, starts: Floats, parameters: Floats, atols: Floats, k: int) -> None:
    """Set a run to its start; the log continues after the previous run."""
    now, base = run.now[0], run.base[0]
    # a place in the log is now.rows less base.rows, and now.rows goes back to 0: the log continues where it was
    base.rows, base.trials, base.events, base.samples = (
        base.rows - now.rows,
        base.trials - now.trials,
        base.events - now.events,
        base.samples - now.samples,
    )
    run.plan[0] = plans[k]
    now.t, now.h, now.norm, now.step, now.step_log, now.first_step = plans[k].start, 0.0, 0.0, 0.0, 0.0, 0.0
    now.rest = plans[k].start_rest
    now.status, now.rows, now.trials, now.events, now.samples = RUNNING, 0, 0, 0, 0
    now.grid, now.node, now.crossed, now.on_grid, now.rejected = 0, 0, 0, 1, 0
    now.evaluations, now.jacobians, now.factorisations = 0, 0, 0
    now.regime = plans[k].regime
    clear_previous_run(run)
    for i in range(run.y.shape[0]):  # no rounding is carried along yet
        run.y[i] = starts[k, i] if i < starts.shape[1] else 0.0
    for i in range(parameters.shape[1]):
        run.p[i] = parameters[k, i]
    for i in range(atols.shape[1]):
        run.atol[i] = atols[k, i]


@jit_separate
def clear_previous_run(run: Run) -> None:
    """Clear everything that the previous run left."""
    run.trial[0], run.piece[0], run.kept[0] = _NO_TRIAL[0], _NO_PIECE[0], _NOT_KEPT[0]
    for i in range(run.watches.shape[0]):
        run.watches[i] = _NO_WATCH[0]
    for i in range(run.touches.shape[0]):
        run.touches[i] = _NO_TOUCH[0]
    for i in range(run.at.shape[0]):
        run.at[i] = 0.0
    for i in range(run.w.shape[0]):  # switches passed, and what a method keeps from its last step
        run.w[i] = 0.0
    for i in range(run.e.shape[0]):  # errors of steps, which make event functions uncertain
        run.e[i] = run.located_e[i] = run.full_e[i] = 0.0


def states_inside(
    address: Any,
    parameters: Floats,
    steps: Floats,
    states: Floats,
    ends: Floats,
    closed: IntArray,
    interior_states: Floats,
    reintegrated: bool,
    with_distances: bool,
) -> None:
    """Evaluate the state at each time inside its step, and its distance from a more accurate one.

    Parameters
    ----------
    address : int
        Of a `Run`.
    parameters : ndarray, shape (r, …)
        Of each run that steps belong to; if empty, all belong to one run, which has its parameters already.
    steps : ndarray, shape (9 + m, k) or (11 + m, k)
        For each time: start and end of its step, step size, the time, the run, the regime, whether the step begins
        after an event, where its closed links begin and how many there are (-1: to be found), the state of each of m
        reactions; where numbers are sums of two, the rests of start and time.
    states : ndarray, shape (n, k)
        The state at the start.
    ends : ndarray, shape (n or 0, k)
        The state at the end, of a method that does not reach it twice by the same iterations.
    closed : ndarray of int, shape (2, c)
        Number of each closed link, and what it does along its slip.
    interior_states : ndarray, shape (2*n, k)
        Filled: the state, and its distance from two steps of half the length, extrapolated; nan where equations were
        not solved.
    reintegrated : bool
        Whether to make a shorter step, or to use the interpolant of the whole one.
    with_distances : bool
        Whether to compute the distances, which takes two more steps; else they are nan.
    """
    run = run_at(address)
    n, current, stepped = states.shape[0], np.int64(-1), steps_over_links(run)
    for k in range(steps.shape[1]):
        t, t1, h, time = steps[0, k], steps[1, k], steps[2, k], steps[3, k]
        if parameters.shape[0] > 0 and np.int64(steps[4, k]) != current:
            current = np.int64(steps[4, k])
            for i in range(parameters.shape[1]):
                run.p[i] = parameters[current, i]
        s = (time - t) / (t1 - t)  # h is not t1 - t to the bit, and at t1 the step has to be the whole one
        run.now[0].regime, run.now[0].step = np.int64(steps[5, k]), h
        for i in range(run.touches.shape[0]):
            run.touches[i].state = np.int64(steps[9 + i, k])
        start_rest, end_rest = 0.0, 0.0
        if run.plan[0].doubled > 0:
            start_rest, end_rest = steps[steps.shape[0] - 2, k], steps[steps.shape[0] - 1, k]
        run.now[0].rest = start_rest
        links_known = recall_closed(run, closed, np.int64(steps[7, k]), np.int64(steps[8, k]))
        enter_step(run, t, states, k, steps[6, k] != 0.0, links_known)
        links_found, run.now[0].status = run.now[0].status == RUNNING, RUNNING  # whether closed links were found
        solved = (
            part_with_impulses(run, steps, k, s) if stepped else make_apart_step(run, t, time, s * h, end_rest)
        ) and links_found
        for i in range(n):
            interior_states[i, k] = interior_states[n + i, k] = run.z[i] if solved else np.nan
        if not reintegrated or ends.shape[0] > 0:
            solved = make_apart_step(run, t, t1, h, 0.0) and links_found
            copy_numbers(run.z, run.located_z)
        if not reintegrated:
            run.at[T], run.at[T1], run.at[H], run.at[S] = t, t1, h, s
            call_law(run.law[INSIDE], run, run.y, run.located_z, 0)
            for i in range(n):
                interior_states[i, k] = run.e[i] if solved else np.nan
        if with_distances and not stepped:
            solved = make_apart_step(run, t, t + (time - t) / 2.0, s * h / 2.0, 0.0)
            copy_numbers(run.z, run.y)
            run.now[0].rest = 0.0
            solved = make_apart_step(run, t + (time - t) / 2.0, time, s * h / 2.0, end_rest) and solved
        else:
            solved = False
        judge_inside(run, s, states, ends, interior_states, k, solved)


def follow_growths(address: Any, states: Floats, moves: Floats, work: Floats, growth_rows: Floats) -> None:
    """Follow the growth of an error along a run from each state; see `follow_error`.

    Parameters
    ----------
    address : int
        Of a `Run`, whose state is changed.
    states : ndarray, shape (1 + n, k)
        Time and state.
    moves : ndarray, shape (1 + n, 2)
        First the final time; then the error and the size of each variable.
    work : ndarray, shape (12, n)
    growth_rows : ndarray, shape (2*k, m)
        Filled: for each state the times, and the ratio of the error to its initial size.
    """
    run = run_at(address)
    for k in range(states.shape[1]):
        stand_at_state(run, states, k)
        follow_error(run, states[0, k], moves, work, growth_rows, 2 * k)


def fastest_rates(address: Any, states: Floats, rates: Floats) -> None:
    """Estimate the fastest rate of the motion about each state, contacts open; see `tolerance_sizes.estimate_fastest_rate`.

    Parameters
    ----------
    address : int
        Of a `Run`, whose state is changed.
    states : ndarray, shape (1 + n, k)
        Time and state; of shape (1, 1) the time alone where the run has the state.
    rates : ndarray, shape (1 + n, n or k)
        Filled: in the first row the rate at each state; in the rows after it, if there are any, the derivatives of
        the slope of variable i by variable j at the only state, each over its size.
    """
    run = run_at(address)
    for i in range(run.touches.shape[0]):
        run.touches[i] = _NO_TOUCH[0]
    for k in range(states.shape[1]):
        set_slopes_at_state(run, states, k)
        natural_sizes(run, run.y)
        rates[0, k] = estimate_fastest_rate(run, states[0, k], run.y)
    if rates.shape[0] > 1:
        fill_derivatives(run, states[0, 0], run.y, rates)


@jit_separate
def stand_at_state(run: Run, states: Floats, k: int) -> None:
    """Set the run to a time and a state, between steps; errors of rounding are not read there, and not written."""
    for i in range(run.y.shape[0] if run.plan[0].doubled > 0 else run.plan[0].used + run.plan[0].evaluated):
        run.y[i] = states[1 + i, k] if 1 + i < states.shape[0] else 0.0
    enter_here(run, states[0, k])


@jit_separate
def set_slopes_at_state(run: Run, states: Floats, k: int) -> None:
    """Set the run to a time and a state for slopes alone, without force terms; `states` of one row keeps the state."""
    used, t, size, doubled = run.plan[0].used, states[0, k], run.y.shape[0], run.plan[0].doubled > 0
    for i in range(0 if states.shape[0] == 1 else size if doubled else used):
        run.y[i] = states[1 + i, k] if 1 + i < states.shape[0] else 0.0
    set_sides_at_time(run, t)
    if run.plan[0].reactions > 0:
        inform_forces(run, t)
    for i in range(size if doubled else used):
        run.probe[i] = run.y[i]
    evaluate_forces(run, t, run.probe)
    for i in range(used, size if doubled else 2 * used - run.plan[0].coordinates):
        run.y[i] = run.probe[i]


@jit_separate
def enter_step(run: Run, t: float, states: Floats, k: int, behind: bool, links_known: bool) -> None:
    """Set the run to the start of a step: on the far side of any change, and after an event with contacts settled.

    Closed links of many are known, or found as a march does that begins there: not as one does that has come there, which
    has seen where slips began, and how fast links met.
    """
    for i in range(run.y.shape[0]):  # no rounding is carried along
        run.y[i] = states[i, k] if i < states.shape[0] else 0.0
    if links_known:
        go_on_with_links(run)
    enter_here(run, t)
    if behind and run.plan[0].reactions > 0:
        settle_contacts(run, t)
    if run.plan[0].assemblies > 0 and not links_known:
        find_closed(run)
        evaluate_forces(run, t, run.y)


@jit_separate
def set_sides_at_time(run: Run, t: float) -> None:
    """Set tables and switches to a time and the state in `y`."""
    enter_pieces(t, run.tables, run.places, run.of_time)
    run.at[REGIME] = run.now[0].regime
    run.now[0].t = t
    enter_past(run, t)
    if run.plan[0].switches > 0:
        take_sides(run)


@jit_separate
def enter_here(run: Run, t: float) -> None:
    """Set forces, sides and contacts to a time and the state in `y`."""
    set_sides_at_time(run, t)
    if run.plan[0].reactions > 0:
        inform_forces(run, t)
    evaluate_forces(run, t, run.y)


@jit_separate
def make_apart_step(run: Run, t: float, t1: float, h: float, end_rest: float) -> bool:
    """Make a step without memory of previous ones; return whether its equations were solved; `end_rest` is left of its end."""
    run.now[0].t, run.trial[0].rest = t, end_rest
    run.kept[0].since = BEGUN
    propose_step_apart(run, t1, h)
    return run.trial[0].iterations >= 0


def step_by_newton(address: Any, _t: float, _t1: float, _h: float, y: Any, z: Any, sample: int) -> None:
    """Make a step by `march.implicit.newton`; callers use its address, so that they need not compile it again.

    Parameters
    ----------
    address : int
        Of a `Run`.
    _t, _t1, _h : float
        Ends and size of the step, which the run's `at` holds too.
    y, z : int
        Addresses of the table entries of two of its states: the start of the step, and the end, which is filled.
    sample : int
        Place of the step's force evaluations in `samples`.
    """
    newton_step(run_at(address), floats_at(y), floats_at(z), sample)


def step_by_radau(address: Any, t: float, t1: float, h: float, y: Any, z: Any, sample: int) -> None:
    """Make a step by `march.implicit.radau`, compiled once for all callers by address."""
    radau_step(run_at(address), t, t1, h, floats_at(y), floats_at(z), sample)


def step_by_series(address: Any, _t: float, _t1: float, _h: float, y: Any, z: Any, sample: int) -> None:
    """Make a step by `march.series`, compiled once for all callers by address."""
    series_step(run_at(address), floats_at(y), floats_at(z), sample)
