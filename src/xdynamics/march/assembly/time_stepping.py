"""Moreau's time-stepping for many links: their action over a complete step, as impulses at its middle.

A link acts whose gap is closed in the middle of the step, or as near to it as impulses are solved for. After the step
its rate is not less than -e times the rate before, and its friction has stopped its slip or is at its bound (Moreau
1999, doi:10.1016/S0045-7825(98)00387-9; Jean 1999, doi:10.1016/S0045-7825(98)00383-1). `march.contacts.phases` does
the same for contacts that are written out.
"""

from __future__ import annotations

from math import nan

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.assembly.broad_phase import (
    ASSEMBLY,
    COUNT,
    CROWDED,
    FASTEST,
    FAULT,
    LINK,
    NEAR,
    NOISE,
    READY,
    RESIDUAL,
    ROWS,
    SPREAD,
    TOGETHER,
    blame,
    evaluate_candidate,
    gap_at,
    keep_boxes,
)
from xdynamics.march.assembly.closed_links import FRICTIONLESS, SLIDES_BACK, SLIDES_ON, STICKS, prepare_patterns
from xdynamics.march.assembly.impact import (
    ACTS,
    ALLOWED_OVER_STEP,
    BOUNCE,
    CANDIDATE,
    GIVES_BACK,
    IMPULSE,
    KINETIC,
    PULL,
    RATE,
    RUBS,
    SLIP_SLACK,
    TARGET_RATE,
    enlist,
    gap_of,
    gap_rate,
    slip_of,
    solve_link_impulses,
)
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.run import Run


@jit_separate
def step_links(run: Run, t1: float) -> None:
    """Add the impulses of a step to the trial, which was made without them."""
    n, h, fastest = run.plan[0].coordinates, run.trial[0].h, 0.0
    if run.spans[SPREAD] > 0.0:
        spread_step_impulses(run, t1)
        return
    run.counters[TOGETHER], run.counters[FAULT] = 0, 0
    if not finite_state(run):
        return
    for i in range(2 * n):
        run.half[i] = run.z[i]
    for i in range(n, 2 * n):
        fastest = max(fastest, abs(run.y[i]), abs(run.z[i]))
    run.spans[FASTEST], run.spans[RESIDUAL] = fastest, 0.0
    solved = list_pressed(run, h)
    # `list_pressed` left the middle of the step there
    for i in range(2 * n):
        run.z[i] = run.half[i]
    if run.counters[TOGETHER] == 0 or not (solved and push_listed_links(run)):
        return
    # impulses act at the middle, so that they move positions for half the step only
    for i in range(n):
        run.z[i] += h / 2.0 * (run.z[n + i] - run.half[n + i])
    evaluate_forces(run, t1, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@jit_separate
def spread_step_impulses(run: Run, t1: float) -> None:
    """Add to a state inside a step the effect of the step's impulses, in `whole`, up to its time."""
    n, h, part = run.plan[0].coordinates, run.trial[0].h, run.spans[SPREAD]
    for i in range(n):
        run.z[i] += h / 2.0 * part * run.whole[i]
        run.z[n + i] += part * run.whole[i]
    evaluate_forces(run, t1, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@jit_separate
def list_pressed(run: Run, h: float) -> bool:
    """List the links whose gaps are closed in the middle of the step, with their rates at its start; whether that is done."""
    n, accelerations, piece = run.plan[0].coordinates, run.plan[0].used, run.piece[0]
    for i in range(n):
        run.z[i], run.z[n + i] = run.y[i] + h / 2.0 * run.y[n + i], run.y[n + i]
        # boxes are bounds of Hermite's quintic, which reads accelerations at both ends
        run.z[accelerations + i] = run.y[accelerations + i]
    if run.counters[READY] == 0:
        prepare_patterns(run)
    start, end, width, wide, part, rough = piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough
    middle = run.now[0].t + h / 2.0
    piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough = run.now[0].t, middle, h / 2.0, 0.0, 0, 0
    all_listed = keep_boxes(run)
    piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough = start, end, width, wide, part, rough
    if not all_listed:
        blame(run, CROWDED, 0, 0)
    for k in range(run.counters[COUNT]):
        if all_listed and run.candidates[k, NEAR] == 1:
            all_listed = press_on(run, middle, h, k)
    return bool(all_listed)


@jit_separate
def press_on(run: Run, middle: float, h: float, k: int) -> bool:
    """List a candidate if it is closed in the middle of the step, as far as impulses tell; whether there is room for it."""
    evaluate_candidate(run, run.z, middle, k)
    gap, steep, size = gap_of(run, k)
    slack = NOISE * steep * run.spans[FASTEST]
    if gap > NOISE * size + ALLOWED_OVER_STEP * steep * run.spans[FASTEST] * h:
        return True
    return bool(enlist(run, k, gap, slack) >= 0)


@jit_separate
def push_listed_links(run: Run) -> bool:
    """Change the trial's velocities by the impulses of the listed links; whether these have a solution."""
    for a in range(run.counters[TOGETHER]):
        run.touching[a, ACTS], run.touching[a, GIVES_BACK] = 1.0, 0.0
        run.touching[a, TARGET_RATE] = run.touching[a, BOUNCE] * min(run.touching[a, RATE], 0.0)
    return solve_link_impulses(run)


@jit_separate
def note_pressed(run: Run, t: float) -> None:
    """Write the pressing links of the last step to the log, with forces as means over the step."""
    h = run.trial[0].h
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, IMPULSE] > 0.0:
            k, log_column, rubs = int(run.touching[a, CANDIDATE]), run.log_links[0], run.counters[ROWS] == 2
            c = run.candidates[k, ASSEMBLY]
            run.log_closed[0, log_column] = run.now[0].rows
            run.log_closed[1, log_column] = run.assemblies[c].first_link + run.candidates[k, LINK]
            run.log_closed[2, log_column] = gap_at(run, run.z, t, k)
            run.log_closed[3, log_column] = run.touching[a, IMPULSE] / h
            run.log_closed[4, log_column] = (gap_rate(run, a) + run.touching[a, TARGET_RATE]) / h
            run.log_closed[5, log_column] = run.touching[a, PULL] / h if rubs else 0.0
            run.log_closed[6, log_column] = mode_along_slip(run, a) if rubs else FRICTIONLESS
            run.log_links[0] = log_column + 1


@jit_separate
def mode_along_slip(run: Run, a: int) -> int:
    """The mode of a link along its slip over the step."""
    if run.touching[a, RUBS] == 0.0:
        return FRICTIONLESS
    slip, pull, friction_limit = (
        slip_of(run, a),
        run.touching[a, PULL],
        run.touching[a, KINETIC] * run.touching[a, IMPULSE],
    )
    if abs(slip) <= run.touching[a, SLIP_SLACK] or abs(pull) < friction_limit:
        return STICKS
    return SLIDES_ON if slip > 0.0 else SLIDES_BACK
