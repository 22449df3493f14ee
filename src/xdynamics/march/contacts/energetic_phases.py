"""Phases of an impact with friction whose coefficient of restitution is energetic: e**2 of the work of compression returns.

The normal impulse p is the independent variable, in which rates are straight lines while the contact slips one way, or
sticks (Routh; W. J. Stronge, Impact Mechanics, 2nd ed. 2018, chapters 3 and 4; Proc. R. Soc. Lond. A 431, 1990, 169,
doi:10.1098/rspa.1990.0125): slip that comes to rest sticks where friction can hold it and reverses where it cannot. All
is in closed form: the work is a parabola in each such phase. No energy can be created, whatever friction does.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.contacts.delassus import SUM_NOISE

COMPRESSION, RESTITUTION, ENDED, WITHOUT_END = range(4)
MOST_PHASES = 8  # compression and restitution, each slipping and then sticking or slipping back, are four


@jit_separate
def phase_slopes(
    self_response: float, across: float, slip_response: float, friction_ratio: float, slip: float
) -> tuple[float, float, float]:
    """How friction, the rate of the gap and the slip grow with the normal impulse.

    An impulse changes the rate of the gap by `self_response` and the slip by `across`, one of friction the slip by `slip_response`, which
    is 0 without friction. Friction acts against the slip, by the share `friction_ratio` of the normal impulse; without slip it
    holds or, where it cannot, is at its limit.
    """
    if slip_response == 0.0:
        return 0.0, self_response, 0.0
    holding = -across / slip_response
    ratio = min(max(holding, -friction_ratio), friction_ratio)
    if slip != 0.0:
        ratio = -friction_ratio if slip > 0.0 else friction_ratio
    sticks = slip == 0.0 and ratio == holding
    return ratio, self_response + across * ratio, 0.0 if sticks else across + slip_response * ratio


@jit_separate
def end_of_phase(
    phase: int, opening: float, sliding: float, speed: float, slip: float, work: float, bounce: float
) -> tuple[int, float, float, float, float]:
    """Go on to the end of a phase: the next one, its normal impulse, and the rate of the gap, the slip and the work there.

    A phase ends where slip comes to rest, where compression ends, or where restitution has given back its work.
    """
    reached, step = 0.0, -speed / opening if opening > 0.0 else inf
    if phase == RESTITUTION:
        reached = sqrt(max(0.0, speed * speed + 2.0 * opening * work))
        step = 2.0 * work / (reached + speed) if reached + speed > 0.0 else 0.0
    until = -slip / sliding if slip * sliding < 0.0 else inf
    halts = until < step
    step = min(step, until)
    if not step < inf:
        return WITHOUT_END, step, speed, slip, work
    speed_after = speed + opening * step if halts else reached
    work -= step * (speed + speed_after) / 2.0
    if halts:
        return phase, step, speed_after, 0.0, work
    slip += sliding * step
    if phase == RESTITUTION:
        return ENDED, step, speed_after, slip, work
    return RESTITUTION, step, speed_after, slip, bounce * bounce * work


@jit_separate
def is_held(opening: float, self_response: float, slip: float) -> bool:
    """Whether sticking holds the gap too, as of a body with one coordinate: nothing moves any more."""
    return not opening > SUM_NOISE * self_response and slip == 0.0
