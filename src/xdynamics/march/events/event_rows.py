"""Rows of the record about events: when, how uncertain, of which kind, and what they did to the state."""

from __future__ import annotations

import numpy as np

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.events.departures import note_rates
from xdynamics.march.events.root_finding import event_kind, is_plain
from xdynamics.march.events.zero_tests import NONE, function_uncertainty
from xdynamics.march.exact_times import set_time
from xdynamics.march.log import first_of_group
from xdynamics.march.run import NO_LINK, Run
from xdynamics.model.detectors import GRIP, PERIODIC, PULL, SLIP
from xdynamics.schema import CROSSING

_CROSSING = np.int64(CROSSING)  # no literal: numba compiles a copy of a function for each
STATE = 2  # of a row of the log, after time and step


@jit_separate
def leave_out(run: Run) -> None:
    """Ignore that a grip is lost where the contact itself opens."""
    for i in range(run.detectors.shape[0]):
        grip = run.detectors[i]
        if grip.role not in (GRIP, SLIP) or run.watches[i].hit == NONE:
            continue
        for j in range(run.detectors.shape[0]):
            pull = run.detectors[j]
            opens = pull.role == PULL and run.watches[j].hit != NONE
            if opens and run.reactions[grip.reaction].normal == pull.reaction:
                run.watches[i].hit = NONE


@jit_separate
def note_events(run: Run, row: int, substeps: int) -> None:
    """Write a row for each event that the trial ends at, between the rows `row` and the next."""
    now, trial = run.now[0], run.trial[0]
    set_time(run, T, trial.t)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    if trial.h > 0.0:
        note_rates(run)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit == NONE:
            continue
        event = run.log_events[now.events - run.base[0].events]
        left = now.t + watch.left if watch.left > 0.0 else now.t - run.pending[i]
        event.time, event.left, event.residual, event.slope = trial.t, left, run.g1[i], run.slopes[i]
        if run.detectors[i].sampled:
            event.slope = -watch.armed * watch.up
        event.uncertainty, event.substeps = function_uncertainty(run, i, run.z), substeps
        event.interpolation = watch.drift / abs(event.slope) if watch.drift > 0.0 else 0.0
        event.murk = watch.clear - watch.zone if watch.zone >= 0.0 else 0.0
        event.row_before, event.row_after, event.detector, event.kind = row, row + 1, i, event_kind(run, i)
        event.direction, event.link = -watch.armed, NO_LINK
        event.rest = rest_to_root(run, i) if run.plan[0].doubled > 0 else 0.0
        if run.detectors[i].role == PERIODIC:  # at a time that was known before
            event.left, event.residual, event.slope, event.uncertainty = trial.t, 0.0, 1.0, 0.0
            event.interpolation, event.murk, event.kind, event.rest = 0.0, 0.0, _CROSSING, trial.rest
        watch.seen += 1
        for k in range(run.log_rates.shape[0]):
            run.log_rates[k, now.events - run.base[0].events] = run.slopes[run.detectors.shape[0] + k]
        for k in range(run.log_impulses.shape[0]):
            run.log_impulses[k, now.events - run.base[0].events] = 0.0
        now.events += 1


@jit_separate
def rest_to_root(run: Run, i: int) -> float:
    """Return what is left of an event's time beside the float: of the trial's end, and from there to the root by the slope."""
    trial, change = run.trial[0], -run.g1[i] / run.slopes[i] if run.slopes[i] != 0.0 else 0.0
    return float(trial.rest + change) if is_plain(run, i) else float(trial.rest)


@jit_separate
def note_offsets(run: Run, row_before: int) -> None:
    """Note how far positions were moved by contacts that came to rest, beyond what events set them to."""
    n, rows, first = run.plan[0].coordinates, run.log_impulses.shape[0], first_of_group(run, row_before)
    if rows == 0 or run.targets.shape[0] + run.touches.shape[0] == 0:
        return
    owner, last = first, run.now[0].events - run.base[0].events
    for e in range(first, last):
        if run.detectors[run.log_events[e].detector].reaction >= 0:
            owner = e
            break
    for i in range(n):
        offset = run.z[i] - run.log_rows[STATE + i, row_before - run.base[0].rows]
        for e in range(first, last):
            offset -= run.log_impulses[rows - n + i, e]
        run.log_impulses[rows - n + i, owner] += offset
