"""Impacts by the energetic coefficient of restitution, whose phases `march.contacts.energetic_phases` solves in closed form.

Several contacts at once are struck one by one where none acts on another that approaches. Where they do act on each
other, the distribution of impulses depends on their stiffnesses (Liu, Zhao, Brogliato, Proc. R. Soc. A 464, 2008, 3193,
doi:10.1098/rspa.2008.0078), which rigid bodies do not have: there is no solution then.
"""

from __future__ import annotations

from math import sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.contacts.delassus import ABSENT, PRESSING, SUM_NOISE, add_impulses, reaction_effect
from xdynamics.march.contacts.energetic_phases import (
    COMPRESSION,
    ENDED,
    MOST_PHASES,
    WITHOUT_END,
    end_of_phase,
    is_held,
    phase_slopes,
)
from xdynamics.march.run import Run
from xdynamics.model.reactions import NORMAL, TANGENT

FRICTIONLESS = -1


@jit_separate
def strike_energetically(run: Run) -> bool:
    """Find the impulse of every contact that approaches; whether they are determined."""
    for k in range(run.touches.shape[0]):
        run.touches[k].part = PRESSING if contact_approaches(run, k) else ABSENT
    solved = True
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and acts_alone(run, k)
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and strike_one(run, k)
    return solved


@jit_separate
def contact_approaches(run: Run, k: int) -> bool:
    """Whether a contact that touches approaches."""
    touch = run.touches[k]
    return bool(run.reactions[k].role == NORMAL and touch.near and touch.rate < -touch.slack)


@jit_separate
def acts_alone(run: Run, k: int) -> bool:
    """Whether a contact that approaches acts on no other one that does."""
    for j in range(run.touches.shape[0]):
        owner = run.reactions[j].normal
        if owner != k and run.reactions[j].role in (NORMAL, TANGENT) and run.touches[owner].part == PRESSING:
            for i in range(run.touches.shape[0]):
                is_own = i == k or (run.reactions[i].role == TANGENT and run.reactions[i].normal == k)
                if is_own and abs(run.delassus[j, i]) > SUM_NOISE * sqrt(run.delassus[j, j] * run.delassus[i, i]):
                    return False
    return True


@jit_separate
def tangent_of(run: Run, k: int) -> int:
    """The number of a contact's friction; `FRICTIONLESS` where it has none."""
    for j in range(run.touches.shape[0]):
        if run.reactions[j].role == TANGENT and run.reactions[j].normal == k:
            return j
    return FRICTIONLESS


@jit_separate
def strike_one(run: Run, k: int) -> bool:
    """Find the impulse of one contact phase by phase, and what it does to all rates; whether no other one is pressed."""
    tangent, normal, self_response = tangent_of(run, k), run.touches[k], run.delassus[k, k]
    speed, slip, across, slip_response, friction_ratio = normal.rate, 0.0, 0.0, 0.0, 0.0
    if tangent != FRICTIONLESS:
        across, slip_response = run.delassus[tangent, k], run.delassus[tangent, tangent]
        slip, friction_ratio = run.touches[tangent].rate, run.links[tangent].coefficient
    impulse, friction, work, phase = 0.0, 0.0, 0.0, COMPRESSION
    for j in range(run.touches.shape[0]):
        run.touches[j].found = 0.0
    for _ in range(MOST_PHASES):
        ratio, opening, sliding = phase_slopes(self_response, across, slip_response, friction_ratio, slip)
        if is_held(opening, self_response, slip):
            return abs(speed) <= SUM_NOISE * abs(normal.rate) and add_impulses(run)
        phase, step, speed, slip, work = end_of_phase(phase, opening, sliding, speed, slip, work, normal.bounce)
        if phase == WITHOUT_END:
            return False
        impulse, friction = impulse + step, friction + ratio * step
        normal.found = impulse
        if tangent != FRICTIONLESS:
            run.touches[tangent].found = friction
        if presses_others(run, k):
            return False
        if phase == ENDED:
            return add_impulses(run)
    return False


@jit_separate
def presses_others(run: Run, k: int) -> bool:
    """Whether the impulses so far make another contact that touches approach."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        if j != k and run.reactions[j].role == NORMAL and touch.near and touch.part == ABSENT:
            change = reaction_effect(run, j)
            if change < 0.0 and touch.rate + change < -max(touch.slack, SUM_NOISE * (abs(touch.rate) + abs(change))):
                return True
    return False
