"""Moreau's time-stepping: the action of contacts over a whole step, as impulses at its middle.

The law of impacts holds for a contact that stays as for one that is hit: after the step its rate is not less than -e
times the rate before. No event is located, and many contacts may close and open in one step.
"""

from __future__ import annotations

from math import nan

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.contacts.delassus import ABSENT, GRIPPING, PRESSING, look_at_links, slips, solve_reactions
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.run import Run
from xdynamics.model.reactions import NORMAL, TANGENT
from xdynamics.schema import BACKWARD, CLOSED, FORWARD, LOOSE, OPEN, STICKING


@jit_separate
def step_in_time(run: Run, t1: float) -> None:
    """Add the impulses of a step to the trial, which was made without them."""
    n, h = run.plan[0].coordinates, run.trial[0].h
    middle = run.now[0].t + h / 2.0
    for i in range(2 * n):
        run.half[i] = run.z[i]
    for i in range(n):
        run.z[i], run.z[n + i] = run.y[i] + h / 2.0 * run.y[n + i], run.y[n + i]
    look_at_links(run, middle)
    find_closed_contacts(run)
    for i in range(n):
        run.z[n + i] = run.half[n + i]
    look_at_links(run, middle)
    solved = push_closed_contacts(run, h)
    for i in range(n):
        change = 0.0
        for k in range(run.touches.shape[0]):
            change += run.responses[k, i] * run.touches[k].found
        run.z[i], run.z[n + i] = run.half[i] + h / 2.0 * change, run.half[n + i] + change
    evaluate_forces(run, t1, run.z)
    for k in range(run.touches.shape[0]):
        run.z[run.plan[0].pressed + k] = run.touches[k].found / h
        conclude_step(run, k)
    run.at[UNSOUND] = 0.0 if solved and finite_state(run) else nan


@jit_separate
def find_closed_contacts(run: Run) -> None:
    """Find which contacts are closed in the middle of the step, and their coefficients of restitution."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touch.near = int(run.reactions[k].role == NORMAL and run.links[k].gap <= 0.0)
        touch.rate, touch.bounce, touch.found, touch.known = run.links[k].rate, run.links[k].coefficient, 0.0, 0.0


@jit_separate
def push_closed_contacts(run: Run, h: float) -> bool:
    """Find the impulses of the step; whether they exist."""
    for k in range(run.touches.shape[0]):
        touch, reaction = run.touches[k], run.reactions[k]
        touch.part, touch.origin, touch.bound = ABSENT, run.links[k].rate, 0.0
        if reaction.role == NORMAL:
            if touch.near:
                touch.part = PRESSING
                touch.origin += touch.bounce * min(touch.rate, 0.0)
        elif reaction.role == TANGENT:
            if run.touches[reaction.normal].near:
                touch.part, touch.coefficient = GRIPPING, run.links[k].coefficient
        else:
            touch.part, touch.bound = GRIPPING, h * run.links[k].coefficient
    return solve_reactions(run)


@jit_separate
def conclude_step(run: Run, k: int) -> None:
    """Set what a contact, or friction, did over the step."""
    touch = run.touches[k]
    if run.reactions[k].role == NORMAL:
        touch.state = CLOSED if touch.found > 0.0 else OPEN
    elif touch.part != GRIPPING:
        touch.state = LOOSE
    elif slips(run, k):
        touch.state = FORWARD if touch.after > 0.0 else BACKWARD
    else:
        touch.state = STICKING
