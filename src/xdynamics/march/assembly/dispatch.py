"""What assemblies do in a march: at its start, on every trial, where links meet."""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics.kernels.compiling import apart, shared
from xdynamics.kernels.law import SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.acceptance import AT_BORDER, AT_GRID, end, judge_apart, land_apart, move_apart, nonfinite
from xdynamics.march.assembly.broad_phase import (
    AIM,
    BEGUN,
    COUNT,
    CROWDED,
    DEPTH,
    FAULT,
    LANDING,
    LEFT,
    MEETS,
    OVERLAP,
    RESIDUAL,
    RESTS,
    SHARE,
    SLOTS,
    TOGETHER,
    WHOLE_STEP,
    blame,
    keep_boxes,
)
from xdynamics.march.assembly.impact import (
    BIAS,
    CANDIDATE,
    GAP,
    LOST,
    RATE,
    ROUGH,
    SLACK,
    TOTAL,
    collide,
    rate_of,
)
from xdynamics.march.assembly.links import ASSEMBLY, END, LINK, pattern_at, touch
from xdynamics.march.assembly.narrow_phase import NOISE, find_first, resolution_of
from xdynamics.march.calls import called, enclosed_by
from xdynamics.march.control import grow
from xdynamics.march.events.arming import rearm
from xdynamics.march.events.event_free_region import end_region
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.force_evaluation import evaluate, finite_state
from xdynamics.march.handle import run_at
from xdynamics.march.log import note, note_sample, note_samples
from xdynamics.march.outcomes import CONTACT_PENETRATED, NONFINITE_OBSERVABLE, SOUND
from xdynamics.march.run import ALL, BEGIN_LINKS, ENCLOSE, FIND_MEETING, Run
from xdynamics.march.run import BEGUN as STARTED
from xdynamics.march.trial_step import copy
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE, IMPACT, REASON_CONTACT, REASON_EVENT

FREELY, CUT, AT_A_LOSS = range(1, 4)  # whether the trial in which links meet was cut for a node; or was not watched
_BEFORE, _AFTER = np.int64(EVENT_BEFORE), np.int64(EVENT_AFTER)  # no literals: numba compiles a copy for each
note_apart, note_samples_apart, grow_apart = apart(note), apart(note_samples), apart(grow)


def meet(address: Any, _number: float, command: int) -> None:
    """Do what assemblies need; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`.
    command : int
        `BEGIN_LINKS`: check that no links overlap at the start. `FIND_MEETING`: shorten the trial to where links first
        meet, if any do, which `tallies[MEETS]` says. `LAND_ON_MEETING`: accept the trial, and go on after the impacts.
    """
    run = run_at(address)
    if command == BEGIN_LINKS:
        begin(run)
    elif command == FIND_MEETING:
        find(run)
    else:
        land(run)


@shared
def begin(run: Run) -> None:
    """Refuse links that overlap at the start, by more than rounding."""
    copy(run.y, run.z)
    set_out(run)
    span(run, 0.0)
    if not keep_boxes(run):
        blame(run, CROWDED, 0, 0)
        run.now[0].status = REASON_CONTACT
    for k in range(run.tallies[COUNT]):
        c = run.candidates[k, ASSEMBLY]
        touch(run, run.y, run.now[0].t, k)
        pattern = pattern_at(run.patterns[2 * c + 1])
        gap = pattern.links[0].gap
        size = abs(gap)
        for i in range(run.assemblies[c].coordinates):
            size += abs(pattern.directions[0, i] * pattern.z[i])
        if gap < -NOISE * size:
            blame(run, OVERLAP, c, run.candidates[k, LINK])
            run.spans[DEPTH] = gap
            run.now[0].status = CONTACT_PENETRATED
            break
    run.tallies[BEGUN] = 0


@shared
def set_out(run: Run) -> None:
    """Give patterns the parameters of the run, and forget all boxes."""
    run.tallies[BEGUN], run.tallies[FAULT], run.tallies[MEETS], run.spans[SHARE] = 0, 0, 0, 1.0
    for k in range(run.handed.shape[0]):
        pattern = pattern_at(run.patterns[run.handed[k, 0]])
        pattern.p[run.handed[k, 1]] = run.p[run.handed[k, 2]]
    for c in range(run.patterns.shape[0]):
        pattern = pattern_at(run.patterns[c])
        enclosed_by(pattern.functions[ENCLOSE], pattern, pattern.y, pattern.y, 0, pattern.parts[0], ALL)


@shared
def span(run: Run, h: float) -> None:
    """Set the piece to one that begins where the march is."""
    piece = run.piece[0]
    piece.start, piece.end, piece.width, piece.wide = run.now[0].t, run.now[0].t + h, h, 0.0
    piece.rough, piece.part = 0, 0


@shared
def find(run: Run) -> None:
    """Shorten the trial to where links first meet, if any do."""
    if run.tallies[BEGUN] == 0:
        set_out(run)
    run.piece[0].substeps, run.tallies[MEETS] = 0, 0
    span(run, run.trial[0].h)
    if not keep_boxes(run):
        blame(run, CROWDED, 0, 0)
        end(run, REASON_CONTACT)
        run.tallies[MEETS] = AT_A_LOSS
        return
    landing, target = run.trial[0].landing, run.trial[0].t
    if find_first(run):
        run.tallies[MEETS], run.tallies[LANDING] = FREELY if landing == AT_GRID else CUT, landing
        run.spans[AIM] = target
        run.trial[0].landing = AT_BORDER


@shared
def land(run: Run) -> None:
    """Accept the trial, which ends where links meet, and go on after their impacts."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    run.piece[0].verdict = REASON_EVENT
    if run.tallies[MEETS] == AT_A_LOSS:
        return
    if plan.adaptive:
        grow_apart(run, run.spans[WHOLE_STEP], run.tallies[MEETS] == CUT)
    reason = judge_apart(run)
    if reason != SOUND:
        run.piece[0].verdict = reason
        return
    trial.t = max(trial.t, np.nextafter(now.t, np.inf))
    reached = trial.h == run.spans[WHOLE_STEP] or trial.t >= run.spans[AIM]
    trial.t = run.spans[AIM] if reached else trial.t
    before = now.rows
    if not note_apart(run, _BEFORE, trial.t, trial.h, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return
    note_samples_apart(run, before)
    run.at[T] = trial.t
    called(run.law[SLOPES], run, run.z, run.slopes, 0)
    if not collide(run, trial.t):
        leave(run, before, REASON_CONTACT)
        return
    note_impacts(run, before)
    evaluate(run, trial.t, run.z)
    note_sample(run, trial.t, run.z, before + 1)
    if not finite_state(run):
        leave(run, before, nonfinite(run))
        return
    if rests(run):
        leave(run, before, REASON_CONTACT)
        return
    if not note_apart(run, _AFTER, trial.t, 0.0, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return
    now.on_grid = 0
    if reached:
        trial.landing = run.tallies[LANDING]
        land_apart(run)
    move_apart(run)
    run.kept[0].since = STARTED
    end_region(run)
    for i in range(run.detectors.shape[0]):
        run.watches[i].hit = NONE
    rearm(run)


@shared
def leave(run: Run, before: int, why: int) -> None:
    """End the march before impacts that have no state after them."""
    now = run.now[0]
    for e in range(now.events - run.base[0].events):
        if run.log_events[e].row_before == before:
            run.log_events[e].row_after = before
    move_apart(run)
    end(run, why)


@shared
def note_impacts(run: Run, before: int) -> None:
    """Write a row for each link that was struck: its impulse, by coordinates of both ends, and the energy it took."""
    now, trial, slots = run.now[0], run.trial[0], run.tallies[SLOTS]
    for a in range(run.tallies[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        if impulse == 0.0:
            continue
        k = int(run.touching[a, CANDIDATE])
        c, e = run.candidates[k, ASSEMBLY], now.events - run.base[0].events
        event, assembly = run.log_events[e], run.assemblies[c]
        event.time, event.left, event.residual = trial.t, now.t + run.spans[LEFT], run.touching[a, GAP]
        event.slope, event.uncertainty = run.touching[a, RATE], run.touching[a, ROUGH]
        event.murk, event.interpolation, event.substeps = 0.0, 0.0, run.piece[0].substeps
        event.row_before, event.row_after, event.direction, event.kind = before, before + 1, -1, IMPACT
        event.detector, event.link = assembly.detector, run.candidates[k, LINK]
        for i in range(run.log_rates.shape[0]):
            run.log_rates[i, e] = run.slopes[run.detectors.shape[0] + i]
        for i in range(run.log_impulses.shape[0]):
            run.log_impulses[i, e] = 0.0
        for i in range(assembly.coordinates):
            slot = run.slots[run.reads[a, i]] + slots * run.leafs[assembly.first_leaf + i, END]
            run.log_impulses[slot, e] += run.normals[a, i] * impulse
        run.log_impulses[2 * slots, e] = run.touching[a, LOST]
        run.log_impulses[2 * slots + 1, e] = run.spans[RESIDUAL]
        now.events += 1


@shared
def rests(run: Run) -> bool:
    """Whether a link does not part after the impacts for longer than can be resolved, though it is pressed."""
    accelerations = run.plan[0].used
    for a in range(run.tallies[TOGETHER]):
        k = int(run.touching[a, CANDIDATE])
        fall, size = -run.touching[a, BIAS], abs(run.touching[a, BIAS])
        for i in range(run.normals.shape[1]):
            term = run.normals[a, i] * run.z[accelerations + run.reads[a, i]]
            fall, size = fall - term, size + abs(term)
        rate = rate_of(run, a)
        if fall > NOISE * size and rate <= max(run.touching[a, SLACK], 2.0 * fall * resolution_of(run, k, 0.0)):
            blame(run, RESTS, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
            return True
    return False
