"""Moreau's time-stepping for many links: what they do over a whole step, as impulses at its middle.

A link acts whose gap is closed in the middle of the step, or as near to it as impulses are solved for. After the step its
rate is not less than -e times the rate before, and its friction has stopped its slip or is at its bound (Moreau 1999,
doi:10.1016/S0045-7825(98)00387-9; Jean 1999, doi:10.1016/S0045-7825(98)00383-1). `march.contacts.time_stepping` does the
same for contacts that are written out.
"""

from __future__ import annotations

from math import nan

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.assembly.broad_phase import (
    COUNT,
    CROWDED,
    FASTEST,
    FAULT,
    READY,
    RESIDUAL,
    ROWS,
    SPREAD,
    TOGETHER,
    blame,
    keep_boxes,
)
from xdynamics.march.assembly.closed_links import FRICTIONLESS, SLIDES_BACK, SLIDES_ON, STICKS
from xdynamics.march.assembly.impact import ALLOWED_OVER_STEP, solve
from xdynamics.march.assembly.links import ASSEMBLY, LINK, NEAR, NOISE, gap_at, touch
from xdynamics.march.assembly.patterns import set_out
from xdynamics.march.assembly.touching import (
    ACTS,
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
    rate_of,
    slip_of,
)
from xdynamics.march.force_evaluation import evaluate, finite_state
from xdynamics.march.run import Run


@shared
def step_links(run: Run, t1: float) -> None:
    """Add the impulses of a step to the trial, which was made without them."""
    n, h, fastest = run.plan[0].coordinates, run.trial[0].h, 0.0
    if run.spans[SPREAD] > 0.0:
        spread(run, t1)
        return
    run.tallies[TOGETHER], run.tallies[FAULT] = 0, 0
    if not finite_state(run):
        return
    for i in range(2 * n):
        run.half[i] = run.z[i]
    for i in range(n, 2 * n):
        fastest = max(fastest, abs(run.y[i]), abs(run.z[i]))
    run.spans[FASTEST], run.spans[RESIDUAL] = fastest, 0.0
    solved = list_pressed(run, h)
    for i in range(2 * n):
        run.z[i] = run.half[i]
    if run.tallies[TOGETHER] == 0 or not (solved and push(run)):
        return
    for i in range(n):
        run.z[i] += h / 2.0 * (run.z[n + i] - run.half[n + i])
    evaluate(run, t1, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@shared
def spread(run: Run, t1: float) -> None:
    """Add to a state inside a step what the impulses of all of it, which `whole` has, have changed by then."""
    n, h, part = run.plan[0].coordinates, run.trial[0].h, run.spans[SPREAD]
    for i in range(n):
        run.z[i] += h / 2.0 * part * run.whole[i]
        run.z[n + i] += part * run.whole[i]
    evaluate(run, t1, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@shared
def list_pressed(run: Run, h: float) -> bool:
    """List the links whose gaps are closed in the middle of the step, with their rates at its start; whether that is done."""
    n, accelerations, piece = run.plan[0].coordinates, run.plan[0].used, run.piece[0]
    for i in range(n):
        run.z[i], run.z[n + i] = run.y[i] + h / 2.0 * run.y[n + i], run.y[n + i]
        run.z[accelerations + i] = run.y[accelerations + i]
    if run.tallies[READY] == 0:
        set_out(run)
    start, end, width, wide, part, rough = piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough
    middle = run.now[0].t + h / 2.0
    piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough = run.now[0].t, middle, h / 2.0, 0.0, 0, 0
    listed = keep_boxes(run)
    piece.start, piece.end, piece.width, piece.wide, piece.part, piece.rough = start, end, width, wide, part, rough
    if not listed:
        blame(run, CROWDED, 0, 0)
    for k in range(run.tallies[COUNT]):
        if listed and run.candidates[k, NEAR] == 1:
            listed = press_on(run, middle, h, k)
    return bool(listed)


@shared
def press_on(run: Run, middle: float, h: float, k: int) -> bool:
    """List a candidate if it is closed in the middle of the step, as far as impulses tell; whether there is room for it."""
    touch(run, run.z, middle, k)
    gap, steep, size = gap_of(run, k)
    slack = NOISE * steep * run.spans[FASTEST]
    if gap > NOISE * size + ALLOWED_OVER_STEP * steep * run.spans[FASTEST] * h:
        return True
    return bool(enlist(run, k, gap, slack) >= 0)


@shared
def push(run: Run) -> bool:
    """Change the velocities of the trial by the impulses of the links that are listed; whether these were found."""
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, ACTS], run.touching[a, GIVES_BACK] = 1.0, 0.0
        run.touching[a, TARGET_RATE] = run.touching[a, BOUNCE] * min(run.touching[a, RATE], 0.0)
    return solve(run)


@shared
def note_pressed(run: Run, t: float) -> None:
    """Write to the log what pressed over the step that led to the row that is being written, its forces as means."""
    h = run.trial[0].h
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, IMPULSE] > 0.0:
            k, place, rubs = int(run.touching[a, CANDIDATE]), run.log_links[0], run.tallies[ROWS] == 2
            c = run.candidates[k, ASSEMBLY]
            run.log_closed[0, place] = run.now[0].rows
            run.log_closed[1, place] = run.assemblies[c].first_link + run.candidates[k, LINK]
            run.log_closed[2, place] = gap_at(run, run.z, t, k)
            run.log_closed[3, place] = run.touching[a, IMPULSE] / h
            run.log_closed[4, place] = (rate_of(run, a) + run.touching[a, TARGET_RATE]) / h
            run.log_closed[5, place] = run.touching[a, PULL] / h if rubs else 0.0
            run.log_closed[6, place] = does_along(run, a) if rubs else FRICTIONLESS
            run.log_links[0] = place + 1


@shared
def does_along(run: Run, a: int) -> int:
    """What a link did along its slip."""
    if run.touching[a, RUBS] == 0.0:
        return FRICTIONLESS
    slip, pull, most = slip_of(run, a), run.touching[a, PULL], run.touching[a, KINETIC] * run.touching[a, IMPULSE]
    if abs(slip) <= run.touching[a, SLIP_SLACK] or abs(pull) < most:
        return STICKS
    return SLIDES_ON if slip > 0.0 else SLIDES_BACK
