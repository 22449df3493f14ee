"""Closed links hold a motion: forces at every evaluation, and a state that is put back on them after every step."""

from __future__ import annotations

from math import inf, nan
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.assembly.broad_phase import ASTRAY, FASTEST, READY, STRAIN
from xdynamics.march.assembly.closed_links import (
    GAPS,
    RATES,
    RIGHT,
    ROUGHLY,
    SCALE,
    STEEP,
    X,
    add_answers,
    closed_from,
    list_ends,
    look_at_closed,
)
from xdynamics.march.assembly.normal_forces import solve_equations
from xdynamics.march.assembly.patterns import set_out
from xdynamics.march.force_evaluation import evaluate, finite_state
from xdynamics.march.handle import floats_at, run_at
from xdynamics.march.run import Run

State = NDArray[Any]
NOISE = 64.0 * EPS  # of the terms of a gap: what rounding may leave
MOST_CORRECTIONS = 10  # Newton steps to gaps of zero


def press(address: Any, t: float, z: Any) -> None:
    """Add to accelerations what the forces of closed links change; an entry of the engine, called by laws.

    Parameters
    ----------
    address : int
        Of a `Run`.
    t : float
    z : int
        Address of the table entry of a state, whose accelerations are those without these forces.
    """
    run = run_at(address)
    if run.closed.shape[0] > 0 and run.closed[0] > 0:
        press_closed(run, t, floats_at(z))


@shared
def press_closed(run: Run, t: float, state: State) -> None:
    """Find forces of closed links after which no gap accelerates, and add what they do to a state's accelerations."""
    if run.tallies[READY] == 0:
        set_out(run)
    first, count = closed_from(run), run.closed[0]
    look_at_closed(run, t, state)
    left = solve_equations(run, first, count)
    run.spans[STRAIN] = left if not left <= run.spans[STRAIN] else run.spans[STRAIN]
    for a in range(count):
        run.loads[a] = run.vectors[X, first + a] * run.vectors[SCALE, first + a]
    add_answers(run, state, run.plan[0].used)


@shared
def hold(run: Run, t: float) -> None:
    """Put the trial's state back on its closed links, if there are any, and evaluate the forces there."""
    run.spans[STRAIN], run.spans[ASTRAY] = 0.0, 0.0
    if run.closed[0] == 0 or not finite_state(run):
        return
    project(run, t)
    evaluate(run, t, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@shared
def project(run: Run, t: float) -> None:
    """Close the gaps of closed links in the trial's state, as far as rounding goes, then remove their rates."""
    first, count, before = closed_from(run), run.closed[0], inf
    for _ in range(MOST_CORRECTIONS):
        look_at_closed(run, t, run.z)
        worst = 0.0
        for a in range(first, first + count):
            worst = max(worst, abs(run.vectors[GAPS, a]))
            run.vectors[RIGHT, a] = -run.vectors[GAPS, a] * run.vectors[SCALE, a]
        if worst == 0.0 or not worst < before / 2.0:
            break
        before = worst
        solve_equations(run, first, count)
        add_answers(run, run.z, 0)
    for a in range(first, first + count):
        allowed = 16.0 * NOISE * run.vectors[ROUGHLY, a] + 8.0 * run.vectors[STEEP, a] * run.spans[FASTEST] * width(run)
        astray = abs(run.vectors[GAPS, a]) - allowed
        run.spans[ASTRAY] = astray if not astray <= run.spans[ASTRAY] else run.spans[ASTRAY]
    stop(run)


@shared
def release_moved(run: Run, t: float) -> None:
    """Let go of closed links whose gaps, or rates, are not zero in the trial's state, where an event has set it."""
    first, kept = closed_from(run), 0
    look_at_closed(run, t, run.z)
    for a in range(run.closed[0]):
        speed = NOISE * run.vectors[STEEP, first + a] * run.greatest[0]
        far = 16.0 * NOISE * run.vectors[ROUGHLY, first + a] + 8.0 * speed / NOISE * width(run)
        if abs(run.vectors[RATES, first + a]) <= speed and abs(run.vectors[GAPS, first + a]) <= far:
            kept += 1
            run.closed[kept] = run.closed[1 + a]
    run.closed[0] = kept
    list_ends(run)


@shared
def width(run: Run) -> float:
    """The time within which events of links are located."""
    widest = 2.0 * EPS * abs(run.now[0].t + run.trial[0].h)
    for c in range(run.assemblies.shape[0]):
        widest = max(widest, run.assemblies[c].tolerance)
    return widest


@shared
def stop(run: Run) -> None:
    """Remove the rates of closed links, which have been looked at, from the trial's state."""
    first, count = closed_from(run), run.closed[0]
    for a in range(first, first + count):
        run.vectors[RIGHT, a] = -run.vectors[RATES, a] * run.vectors[SCALE, a]
    solve_equations(run, first, count)
    add_answers(run, run.z, run.plan[0].coordinates)
