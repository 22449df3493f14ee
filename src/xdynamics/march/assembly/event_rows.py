"""What the record says of links at an event: impulses, rest and take-off."""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import LEFT, RESIDUAL, ROWS, SLOTS, TOGETHER
from xdynamics.march.assembly.closed_links import GAPS, STICKS, closed_link_row, grip_at
from xdynamics.march.assembly.links import ASSEMBLY, END, LINK
from xdynamics.march.assembly.narrow_phase import forces_at
from xdynamics.march.assembly.touching import (
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
)
from xdynamics.march.run import Run
from xdynamics.schema import IMPACT, REST, STICK, TAKEOFF
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


@jit_separate
def note_links(run: Run, t: float) -> None:
    """Write what is closed in the trial's state, which is that of the row that is being written."""
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
