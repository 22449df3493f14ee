"""The part of assemblies in a march: at its start, on every trial, where links meet.

At an event the record gets impulses, rest and take-off of links.
"""

from __future__ import annotations

from math import inf

import numpy as np

from xdynamics.kernels.compiling import jit_separate, noinline
from xdynamics.kernels.law import SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.assembly.active_set import close_resting_links
from xdynamics.march.assembly.broad_phase import (
    AIM,
    ASSEMBLY,
    ASTRAY,
    BEGUN,
    CLOSE,
    COUNT,
    CROWDED,
    DEPTH,
    END,
    ENERGY,
    FASTEST,
    FAULT,
    FIGURE,
    HASTE,
    HASTY,
    IDLE,
    LANDING,
    LEFT,
    LINK,
    LOSS,
    MEETS,
    NOISE,
    OVERLAP,
    READY,
    RESIDUAL,
    ROWS,
    SHIFTED,
    SLOTS,
    STRAIN,
    STRAINED,
    TERMS,
    TOGETHER,
    UNDECIDED,
    WHOLE_STEP,
    WORK,
    blame,
    evaluate_candidate,
    keep_boxes,
    pattern_at,
)
from xdynamics.march.assembly.closed_links import GAPS, SINCE, STICKS, closed_link_row, grip_at, prepare_patterns
from xdynamics.march.assembly.holding import put_on_closed_links
from xdynamics.march.assembly.impact import (
    ACTS,
    CANDIDATE,
    GAP,
    GRIPPED,
    GRIPS,
    HALTED,
    HELD,
    LASTS,
    LOST,
    OWN,
    RATE,
    ROUGH,
    SKIPS,
    SLACK,
    TAKEN,
    TOTAL,
    TOTAL_PULL,
    any_open_approaches,
    collide_links,
    list_touching,
    weigh_link_impulses,
)
from xdynamics.march.assembly.narrow_phase import (
    fastest_velocity,
    find_first,
    find_release,
    finest_resolution,
    forces_at,
    remember_fastest,
)
from xdynamics.march.assembly.normal_forces import ALLOWED
from xdynamics.march.assembly.time_stepping import note_pressed, step_links
from xdynamics.march.calls import call_law
from xdynamics.march.control import (
    AT_BORDER,
    AT_GRID,
    count_landing_apart,
    end_march,
    grow_step,
    judge_trial_apart,
    move_to_end_apart,
    nonfinite_reason,
)
from xdynamics.march.events.departures import rearm
from xdynamics.march.events.enclosures import end_region
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.log import append_row, note_sample, note_samples
from xdynamics.march.outcomes import CONTACT_INCONSISTENT, CONTACT_PENETRATED, NONFINITE_OBSERVABLE, SOUND
from xdynamics.march.phases import ASSEMBLIES, phase
from xdynamics.march.run import BEGUN as STARTED
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE, IMPACT, REASON_CONTACT, REASON_EVENT, REST, STICK, TAKEOFF
from xdynamics.schema import SLIP as SLIP_KIND


@jit_separate
def add_link_row(run: Run, a: int, row_before: int, kind: int) -> int:
    """Add a row for a link that touches; return its number in the log."""
    now, k = run.now[0], int(run.touching[a, CANDIDATE])
    e = now.events - run.base[0].events
    event, assembly = run.log_events[e], run.assemblies[run.candidates[k, ASSEMBLY]]
    event.time, event.left, event.residual = run.trial[0].t, now.t + run.spans[LEFT], run.touching[a, GAP]
    event.slope, event.uncertainty = run.touching[a, RATE], run.touching[a, ROUGH]
    event.murk, event.interpolation, event.rest, event.substeps = 0.0, 0.0, 0.0, run.piece[0].substeps
    event.row_before, event.row_after, event.direction, event.kind = row_before, row_before + 1, -1, kind
    event.detector, event.link = assembly.detector, run.candidates[k, LINK]
    for i in range(run.log_rates.shape[0]):
        run.log_rates[i, e] = run.slopes[run.detectors.shape[0] + i]
    for i in range(run.log_impulses.shape[0]):
        run.log_impulses[i, e] = 0.0
    now.events += 1
    return e


@jit_separate
def note_link_impacts(run: Run, row_before: int) -> None:
    """Write a row for each link that was struck: its impulse, by coordinates of both ends, and the energy it took."""
    slots, rows = run.counters[SLOTS], int(run.counters[ROWS])
    for a in range(run.counters[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        if run.touching[a, OWN] * impulse <= (run.touching[a, SLACK] if run.touching[a, HELD] == 1.0 else 0.0):
            continue
        e = add_link_row(run, a, row_before, IMPACT)
        if run.touching[a, HELD] == 1.0:  # it was closed, and is struck by others at their time
            run.log_events[e].residual, run.log_events[e].uncertainty = 0.0, 0.0
        assembly = run.assemblies[run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]]
        for i in range(assembly.coordinates):
            slot = (
                run.slots[run.coordinate_indices[rows * a, i]]
                + slots * run.pattern_inputs[assembly.first_leaf + i, END]
            )
            run.log_impulses[slot, e] += run.normals[rows * a, i] * impulse
            if rows == 2:
                run.log_impulses[slot, e] += run.normals[2 * a + 1, i] * run.touching[a, TOTAL_PULL]
        run.log_impulses[2 * slots, e] = run.touching[a, LOST]
        run.log_impulses[2 * slots + 1, e] = run.spans[RESIDUAL]


@jit_separate
def note_link_changes(run: Run, row_before: int) -> None:
    """Write a row for each link that comes to rest, perhaps again after an impact, or takes off without an impulse.

    One that stays closed has a row where it begins to slip or to stick.
    """
    for a in range(run.counters[TOGETHER]):
        rests = run.touching[a, HELD] == 0.0 or run.touching[a, SKIPS] == 1.0
        if run.touching[a, ACTS] == 1.0 and rests:
            e = add_link_row(run, a, row_before, REST)
            run.log_impulses[2 * run.counters[SLOTS], e] = run.touching[a, TAKEN]
            run.log_events[e].residual, run.log_events[e].murk = 0.0, 2.0 * run.touching[a, LASTS]
        elif run.touching[a, ACTS] == 0.0 and run.touching[a, HELD] == 1.0 and run.touching[a, TOTAL] <= 0.0:
            e = add_link_row(run, a, row_before, TAKEOFF)
            run.log_events[e].residual = 0.0
        elif run.touching[a, ACTS] == 1.0 and run.counters[ROWS] == 2:
            did, does = run.touching[a, GRIPPED], run.touching[a, GRIPS]
            stops = run.touching[a, HALTED] != 0.0 and run.touching[a, TAKEN] != 0.0
            if stops or (did != does and (did == STICKS or does == STICKS)):
                e = add_link_row(run, a, row_before, STICK if does == STICKS else SLIP_KIND)
                run.log_impulses[2 * run.counters[SLOTS], e] = run.touching[a, TAKEN]
                run.log_events[e].residual = 0.0


@phase(ASSEMBLIES)
def note_links(run: Run, t: float) -> None:
    """Write the closed links of the trial's state to the row that is being written."""
    if run.plan[0].steps_over > 0:
        note_pressed(run, t)
        return
    if run.closed[0] == 0:
        return
    forces_at(run, run.z, t)
    for a in range(run.closed[0]):
        log_column = run.log_links[0]
        run.log_closed[0, log_column], run.log_closed[1, log_column] = run.now[0].rows, run.closed[1 + a]
        run.log_closed[2, log_column], run.log_closed[3, log_column] = (
            run.vectors[GAPS, closed_link_row(run, a)],
            run.loads[a],
        )
        run.log_closed[4, log_column], run.log_closed[5, log_column] = run.remains[a], run.pulls[a]
        run.log_closed[6, log_column] = grip_at(run, a)
        run.log_links[0] = log_column + 1


MOST_HASTE = 1000  # events that follow each other within what times are located to
MOST_STRIKES = 200  # at one time, of links that what stops others has approach, each more slowly than before
MOST_IDLE, IDLY = 100, 1e-2  # landings in a row at which nothing changes, each after less than this of a step
LEFT_OVER = 16.0 * NOISE  # of energies: what rounding may leave for each link and coordinate
FREELY, CUT, AT_A_LOSS = range(1, 4)  # whether the trial in which links meet was cut for a node; or was not watched
_BEFORE, _AFTER = np.int64(EVENT_BEFORE), np.int64(EVENT_AFTER)  # no literals: numba compiles a copy for each
append_row_apart, note_samples_apart, grow_step_apart = (
    noinline(append_row),
    noinline(note_samples),
    noinline(grow_step),
)


@phase(ASSEMBLIES)
def act_on_links(run: Run, t: float) -> None:
    """Put the trial's state, at a time, back on closed links; or add what links do over the step, for Moreau's method."""
    if run.plan[0].steps_over > 0:
        step_links(run, t)
    else:
        put_on_closed_links(run, t)


@phase(ASSEMBLIES)
def go_on_with_links(run: Run) -> None:
    """Go on from the state in `y` with the closed links that are listed."""
    prepare_patterns(run)


@phase(ASSEMBLIES)
def begin_links(run: Run) -> None:
    """Refuse links that overlap at the start, by more than rounding, and find out which are closed there."""
    for i in range(run.greatest.shape[0]):
        run.greatest[i] = 0.0
    if not list_near(run):
        return
    for k in range(run.counters[COUNT]):
        if overlaps(run, k):
            run.now[0].status = CONTACT_PENETRATED
            return
    if run.plan[0].steps_over > 0:
        run.counters[TOGETHER] = 0  # nothing pressed before the first step
    else:
        close_touching(run)
    run.counters[BEGUN], run.counters[HASTE], run.counters[IDLE] = 0, 0, 0


@phase(ASSEMBLIES)
def find_closed(run: Run) -> None:
    """Find out which links are closed in the state in `y`, as a march does that begins there.

    What rounding leaves of rates is a share of the speeds of the march, of which bodies at rest know nothing: the least is
    what they would gain in the step without forces of links.
    """
    if run.plan[0].steps_over == 0 and list_near(run):
        accelerations = run.plan[0].used
        for i in range(run.plan[0].coordinates):
            gained = abs(run.z[accelerations + i]) * run.now[0].step
            run.spans[FASTEST] = max(run.spans[FASTEST], gained)
        close_touching(run)


@jit_separate
def list_near(run: Run) -> bool:
    """List the links that may touch in the state in `y`; whether there is room for them."""
    # margins of no time: `part_with_release` looks anew at forces where the next step starts
    run.closed[0], run.release_functions[SINCE, 0] = 0, -inf
    copy_numbers(run.y, run.z)
    evaluate_forces(run, run.now[0].t, run.z)
    copy_numbers(run.z, run.y)
    prepare_patterns(run)
    set_piece_from_now(run, 0.0)
    if not keep_boxes(run):
        blame(run, CROWDED, 0, 0)
        run.now[0].status = REASON_CONTACT
        return False
    run.counters[CLOSE], run.spans[FASTEST] = run.counters[COUNT], fastest_velocity(run)
    for k in range(run.counters[COUNT]):
        run.close[k] = k
    return True


@jit_separate
def close_touching(run: Run) -> None:
    """Find forces of the links that touch, and which of them are closed."""
    if not (list_touching(run, run.now[0].t) and close_resting_links(run, run.now[0].t)):
        run.now[0].status = REASON_CONTACT


@jit_separate
def overlaps(run: Run, k: int) -> bool:
    """Whether a candidate's gap is negative at the start, by more than rounding."""
    c = run.candidates[k, ASSEMBLY]
    evaluate_candidate(run, run.y, run.now[0].t, k)
    pattern = pattern_at(run.patterns[2 * c + 1])
    gap = pattern.links[0].gap
    size = abs(gap)
    for i in range(run.assemblies[c].coordinates):
        size += abs(pattern.directions[0, i] * pattern.z[i])
    if gap < -NOISE * size:
        blame(run, OVERLAP, c, run.candidates[k, LINK])
        run.spans[DEPTH] = gap
        return True
    return False


@jit_separate
def set_piece_from_now(run: Run, h: float) -> None:
    """Set the piece to one that begins where the march is."""
    piece = run.piece[0]
    piece.start, piece.end, piece.width, piece.wide = run.now[0].t, run.now[0].t + h, h, 0.0
    piece.rough, piece.part = 0, 0


@phase(ASSEMBLIES)
def find_meeting(run: Run) -> bool:
    """Shorten the trial to where links first meet, or a closed one lifts; whether any do, or cannot be watched."""
    if run.plan[0].steps_over > 0:
        judge_impulses(run)
    else:
        watch_links(run)
    return bool(run.counters[MEETS] > 0)


@jit_separate
def watch_links(run: Run) -> None:
    """Shorten the trial to where links first meet, or a closed one lifts, if any do, which `counters[MEETS]` says."""
    if run.counters[READY] == 0 or run.counters[BEGUN] == 0:
        prepare_patterns(run)
    run.piece[0].substeps, run.counters[MEETS] = 0, 0
    set_piece_from_now(run, run.trial[0].h)
    if not keep_boxes(run):
        give_up(run, CROWDED, REASON_CONTACT)
        return
    landing, target = run.trial[0].landing, run.trial[0].t
    meets = find_first(run)
    remember_fastest(run)
    # the call stands first: in the trial just shortened a closed link may let go earlier still
    meets = find_release(run) or meets
    if meets:
        run.release_functions[SINCE, 0] = -inf
    else:
        run.counters[IDLE] = 0
    if meets and is_hasty(run):
        give_up(run, HASTY, REASON_CONTACT)
    elif meets and run.counters[IDLE] > MOST_IDLE:
        give_up(run, UNDECIDED, REASON_CONTACT)
    # the call stands first, as it ends the march where no links meet, too
    elif closed_links_hold(run) and meets:
        run.counters[MEETS], run.counters[LANDING] = FREELY if landing == AT_GRID else CUT, landing
        run.spans[AIM] = target
        run.trial[0].landing = AT_BORDER


@jit_separate
def judge_impulses(run: Run) -> None:
    """End the march if impulses over the step have no solution."""
    run.counters[MEETS] = 0
    if run.counters[FAULT] != 0:
        end_march(run, REASON_CONTACT)
        run.counters[MEETS] = AT_A_LOSS


@jit_separate
def closed_links_hold(run: Run) -> bool:
    """Whether closed links have forces and their gaps are closed; else the march has ended."""
    # negated, so that nan counts as not found
    if not run.spans[STRAIN] <= ALLOWED:
        give_up(run, STRAINED, REASON_CONTACT)
    elif not run.spans[ASTRAY] <= 0.0:
        give_up(run, SHIFTED, CONTACT_INCONSISTENT)
    return bool(run.spans[STRAIN] <= ALLOWED and run.spans[ASTRAY] <= 0.0)


@jit_separate
def give_up(run: Run, fault: int, why: int) -> None:
    """End the march where it stands, with the first closed link that seems to let go, if any does."""
    blame(run, fault, 0, 0)
    # backwards, so that the first of them is the one that stays blamed
    for a in range(run.closed[0] - 1, -1, -1):
        if run.lifted[a] > 0:
            blame(run, fault, run.closed_link_ends[a, 0], run.closed_link_ends[a, 1])
    end_march(run, why)
    run.counters[MEETS] = AT_A_LOSS


@phase(ASSEMBLIES)
def land_on_meeting(run: Run) -> int:
    """Accept the trial, which ends where links meet, and go on after their impacts; return the verdict on the trial."""
    if run.counters[MEETS] == AT_A_LOSS:
        return REASON_EVENT
    if run.plan[0].adaptive:
        grow_step_apart(run, run.spans[WHOLE_STEP], run.counters[MEETS] == CUT)
    reason = judge_trial_apart(run)
    if reason != SOUND:
        return reason
    pass_meeting(run)
    return REASON_EVENT


@jit_separate
def pass_meeting(run: Run) -> None:
    """Note the states before and after the impacts at the trial's end, and go on from there."""
    now, trial = run.now[0], run.trial[0]
    # an event within a spacing of t still moves the march on
    trial.t = max(trial.t, np.nextafter(now.t, np.inf))
    reached = trial.h == run.spans[WHOLE_STEP] or trial.t >= run.spans[AIM]
    trial.t = run.spans[AIM] if reached else trial.t
    row_before, events = now.rows, now.events
    if not append_row_apart(run, _BEFORE, trial.t, trial.h, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    note_samples_apart(run, row_before)
    run.at[T] = trial.t
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    strikes = list_touching(run, trial.t) and strike_links(run, trial.t)
    note_link_impacts(run, row_before)
    if not strikes:
        end_before_impacts(run, row_before, REASON_CONTACT)
        return
    weigh_link_impulses(run)
    note_link_changes(run, row_before)
    note_idleness(run, now.events > events)
    evaluate_forces(run, trial.t, run.z)
    note_sample(run, trial.t, run.z, row_before + 1)
    if not finite_state(run):
        end_before_impacts(run, row_before, nonfinite_reason(run))
        return
    if not append_row_apart(run, _AFTER, trial.t, 0.0, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    if not closed_links_hold(run):
        move_to_end_apart(run)
        return
    if not keeps_energy(run):
        move_to_end_apart(run)
        end_march(run, CONTACT_INCONSISTENT)
        return
    go_on_after_impacts(run, reached)


@jit_separate
def strike_links(run: Run, t: float) -> bool:
    """Solve for impulses of links that touch, and for the closed links after them; whether both succeed.

    What stops slips and bounces that are too low may have others approach, which are struck in their turn.
    """
    run.spans[LOSS], run.spans[WORK], run.spans[TERMS], run.spans[RESIDUAL] = 0.0, 0.0, 0.0, 0.0
    for _ in range(MOST_STRIKES):
        if not (collide_links(run) and close_resting_links(run, t)):
            return False
        if run.counters[ROWS] == 1 or not any_open_approaches(run):
            break
    return True


@jit_separate
def go_on_after_impacts(run: Run, reached: bool) -> None:
    """Go on from the state after impacts, as a march begins, or from the node if the step reached one."""
    run.now[0].on_grid = 0
    if reached:
        run.trial[0].landing = run.counters[LANDING]
        count_landing_apart(run)
    move_to_end_apart(run)
    run.kept[0].since = STARTED
    end_region(run)
    for i in range(run.detectors.shape[0]):
        run.watches[i].hit = NONE
    rearm(run, True)


@jit_separate
def is_hasty(run: Run) -> bool:
    """Whether a great many events have followed each other within the resolution of their times."""
    soon = run.trial[0].t - run.now[0].t <= 4.0 * finest_resolution(run, run.trial[0].h)
    run.counters[HASTE] = run.counters[HASTE] + 1 if soon else 0
    return bool(run.counters[HASTE] > MOST_HASTE)


@jit_separate
def note_idleness(run: Run, changes: bool) -> None:
    """Count a landing soon after the last one, and one at which no link was struck, lifted, or began to slip or to stick."""
    soon = run.trial[0].h <= IDLY * run.spans[WHOLE_STEP]
    run.counters[IDLE] = run.counters[IDLE] + 1 if soon and not changes else 0


@jit_separate
def keeps_energy(run: Run) -> bool:
    """Whether the change of kinetic energy agrees, to rounding, with the event's loss and the surfaces' work.

    For masses M and impulses p with M (v1 - v0) = p it changes by p (v0 + v1)/2, whatever the law of impacts.
    """
    energy_column, row = run.plan[0].kinetic, run.now[0].rows - run.base[0].rows
    if energy_column < 0:
        return True
    energy_before, energy_after = run.log_rows[energy_column, row - 2], run.log_rows[energy_column, row - 1]
    bound = (
        LEFT_OVER
        * (run.counters[TOGETHER] + run.plan[0].coordinates)
        * (energy_before + energy_after + run.spans[TERMS])
    )
    run.spans[FIGURE] = abs(energy_after - energy_before + run.spans[LOSS] - run.spans[WORK])
    # negated, so that nan breaks the guard, too
    if not run.spans[FIGURE] <= bound:
        blame(run, ENERGY, 0, 0)
        return False
    return True


@jit_separate
def end_before_impacts(run: Run, row_before: int, why: int) -> None:
    """End the march before impacts that have no state after them."""
    now = run.now[0]
    for e in range(now.events - run.base[0].events):
        if run.log_events[e].row_before == row_before:
            run.log_events[e].row_after = row_before
    move_to_end_apart(run)
    end_march(run, why)
