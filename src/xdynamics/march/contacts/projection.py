"""Closed contacts and sticking friction hold a state: the drift of a step is taken back.

The state is projected along the directions in which the reactions act, positions first, then velocities (Hairer,
Lubich, Wanner, Geometric Numerical Integration, 2006, section VII.1.4): no energy is gained, and no drift grows.
"""

from __future__ import annotations

from math import inf, nan

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.linear import solve_linear
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.contacts.delassus import look_at_links
from xdynamics.march.force_evaluation import evaluate_held, finite_state
from xdynamics.march.run import Run
from xdynamics.model.reactions import MODES, NORMAL
from xdynamics.schema import SETTLING

MOST_NEWTON_STEPS = 10  # Newton steps to a gap of zero


@jit_separate
def hold_closed_contacts(run: Run, t: float, settling: bool) -> None:
    """Put the trial's state on the constraints that hold it, if any, and evaluate the forces there."""
    run.at[UNSOUND] = 0.0
    if list_holding(run, settling) == 0 or not finite_state(run):
        return
    projection_before = run.z[run.plan[0].moved]
    is_held = hold_positions(run, t, settling) and hold_rates(run, t, settling)
    evaluate_held(run, t, run.z, 0.0)
    if run.plan[0].held > 0 and not projection_before <= run.z[run.plan[0].moved]:
        run.z[run.plan[0].moved] = (
            projection_before  # how far constraints moved the result of the step; nan if they failed
        )
    run.at[UNSOUND] = 0.0 if is_held and finite_state(run) else nan


@jit_separate
def list_holding(run: Run, settling: bool) -> int:
    """List the reactions that hold, those of settling contacts only where `settling` asks for them."""
    count = 0
    for k in range(run.touches.shape[0]):
        waits = run.reactions[k].role == NORMAL and run.touches[k].state == SETTLING and not settling
        if run.modes[MODES * k] == 1.0 and not waits:
            run.chosen[count] = k
            count += 1
    return count


@jit_separate
def hold_positions(run: Run, t: float, settling: bool) -> bool:
    """Close the gaps of closed contacts, as far as rounding goes."""
    count, worst_before = list_holding(run, settling), inf
    for _ in range(MOST_NEWTON_STEPS):
        look_at_links(run, t)
        worst = 0.0
        for i in range(count):
            run.column[i] = -run.links[run.chosen[i]].gap
            worst = max(worst, abs(run.column[i]))
        if worst == 0.0 or not worst < worst_before / 2.0:
            return True
        worst_before = worst
        if not move_along_reactions(run, count, 0):
            return False
    return True


@jit_separate
def hold_rates(run: Run, t: float, settling: bool) -> bool:
    """Remove the rates of closed contacts and sticking friction."""
    look_at_links(run, t)
    count = list_holding(run, settling)
    for i in range(count):
        run.column[i] = -run.links[run.chosen[i]].rate
    if not move_along_reactions(run, count, run.plan[0].coordinates):
        return False
    for i in range(count):  # and by what impulse, for `march.contacts.balance`
        run.slowed[run.chosen[i]], run.pulled[run.chosen[i]] = run.links[run.chosen[i]].rate, run.column[i]
    return True


@jit_separate
def move_along_reactions(run: Run, count: int, first: int) -> bool:
    """Move positions, or from place `first` on velocities, along the reactions by what `column` says of each gap."""
    for i in range(count):
        for j in range(count):
            run.square[i * count + j] = run.delassus[run.chosen[i], run.chosen[j]]
    if not solve_linear(run.square, run.column, count):
        return False
    for i in range(count):
        for k in range(run.plan[0].coordinates):
            run.z[first + k] += run.responses[run.chosen[i], k] * run.column[i]
    return True
