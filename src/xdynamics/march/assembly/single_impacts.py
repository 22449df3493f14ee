"""Impacts of one link at a time, with friction, in closed form: Newton's law, or the energetic coefficient of restitution.

Laws are those of `march.contacts.impact` and `march.contacts.energetic`, whose references these are.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import ROWS, SHARED, TOGETHER, UNSOLVED, blame
from xdynamics.march.assembly.links import ASSEMBLY, LINK
from xdynamics.march.assembly.touching import (
    ACROSS,
    ACTS,
    BOUNCE,
    CANDIDATE,
    KINETIC,
    LOST,
    OWN,
    RATE,
    RUBS,
    SLACK,
    SLIP_OWN,
    TOTAL,
    TOTAL_PULL,
    apply_impulse,
    gap_rate,
    slip_of,
)
from xdynamics.march.contacts.delassus import SUM_NOISE
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


@jit_separate
def has_friction(run: Run, a: int) -> bool:
    """Whether a link has friction."""
    return bool(run.counters[ROWS] == 2 and run.touching[a, RUBS] == 1.0)


@jit_separate
def slip_at(run: Run, a: int) -> float:
    """The slip of a link; 0 where it has no friction."""
    return slip_of(run, a) if has_friction(run, a) else 0.0


@jit_separate
def give_impulses(run: Run, a: int, impulse: float, pull: float) -> None:
    """Change velocities by the impulses of a link, and sum these and the energy that they take."""
    rate, slip, row = gap_rate(run, a), slip_at(run, a), int(run.counters[ROWS]) * a
    apply_impulse(run, row, impulse)
    if has_friction(run, a):
        apply_impulse(run, row + 1, pull)
        run.touching[a, TOTAL_PULL] += pull
        run.touching[a, LOST] -= pull * (slip + slip_of(run, a)) / 2.0
    run.touching[a, TOTAL] += impulse
    run.touching[a, LOST] -= impulse * (rate + gap_rate(run, a)) / 2.0


@jit_separate
def refuse_impact(run: Run, a: int, fault: int) -> bool:
    """Blame a link for an impact without a solution; always False."""
    k = int(run.touching[a, CANDIDATE])
    blame(run, fault, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
    return False


@jit_separate
def reverse(run: Run, a: int) -> bool:
    """Reverse the rate of one link by Newton's law, with friction that ends its slip or is at its bound against it."""
    solved, impulse, pull = answer_of(run, a, (1.0 + run.touching[a, BOUNCE]) * gap_rate(run, a), slip_at(run, a))
    if not solved:
        return refuse_impact(run, a, UNSOLVED)
    give_impulses(run, a, impulse, pull)
    return True


@jit_separate
def answer_of(run: Run, a: int, rate: float, slip: float) -> tuple[bool, float, float]:
    """Whether a link alone has impulses, and these: normal, along its slip; of rates without them, for a gap not to close."""
    self_response = run.touching[a, OWN]
    if rate >= 0.0 or not has_friction(run, a):
        return True, max(0.0, -rate / self_response), 0.0
    across, slip_response, friction_ratio = run.touching[a, ACROSS], run.touching[a, SLIP_OWN], run.touching[a, KINETIC]
    determinant = self_response * slip_response - across * across
    if determinant > SUM_NOISE * self_response * slip_response:
        impulse, pull = (
            (across * slip - slip_response * rate) / determinant,
            (across * rate - self_response * slip) / determinant,
        )
        if impulse >= 0.0 and abs(pull) <= friction_ratio * impulse:
            return True, impulse, pull
    for k in range(2):
        slip_direction = 1.0 - 2.0 * k
        reply = self_response - slip_direction * friction_ratio * across
        if reply > 0.0:
            impulse = -rate / reply
            pull = -slip_direction * friction_ratio * impulse
            if slip_direction * (slip + across * impulse + slip_response * pull) >= 0.0:
                return True, impulse, pull
    return False, 0.0, 0.0


@jit_separate
def each_alone(run: Run) -> bool:
    """Strike every link that approaches by the energetic law; whether none acts on another one."""
    for a in range(run.counters[TOGETHER]):
        run.touching[a, ACTS] = 1.0 if gap_rate(run, a) < -run.touching[a, SLACK] else 0.0
    for a in range(run.counters[TOGETHER]):
        for b in range(a):
            if run.touching[a, ACTS] == 1.0 and run.touching[b, ACTS] == 1.0 and couple(run, a, b):
                return refuse_impact(run, a, SHARED)
    solved = True
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            solved = solved and strike_link(run, a)
    return solved


@jit_separate
def couple(run: Run, a: int, b: int) -> bool:
    """Whether impulses of one link change the rate or the slip of another."""
    rows = int(run.counters[ROWS])
    for row in range(rows * a, rows * (a + 1)):
        for second_row in range(rows * b, rows * (b + 1)):
            effect, size = 0.0, 0.0
            for i in range(run.coordinate_indices.shape[1]):
                for j in range(run.coordinate_indices.shape[1]):
                    if run.coordinate_indices[row, i] == run.coordinate_indices[second_row, j]:
                        effect += run.normals[row, i] * run.unit_responses[second_row, j]
                        size += abs(run.normals[row, i] * run.unit_responses[second_row, j])
            if abs(effect) > SUM_NOISE * size:
                return True
    return False


@jit_separate
def strike_link(run: Run, a: int) -> bool:
    """Find the impulse of one link phase by phase."""
    first, self_response, slip = gap_rate(run, a), run.touching[a, OWN], slip_at(run, a)
    across, slip_response, friction_ratio = 0.0, 0.0, 0.0
    if has_friction(run, a):
        across, slip_response, friction_ratio = (
            run.touching[a, ACROSS],
            run.touching[a, SLIP_OWN],
            run.touching[a, KINETIC],
        )
    speed, impulse, pull, work, phase = first, 0.0, 0.0, 0.0, COMPRESSION
    for _ in range(MOST_PHASES):
        ratio, opening, sliding = phase_slopes(self_response, across, slip_response, friction_ratio, slip)
        if is_held(opening, self_response, slip):
            return (
                spend_impulses(run, a, impulse, pull)
                if abs(speed) <= SUM_NOISE * abs(first)
                else refuse_impact(run, a, UNSOLVED)
            )
        phase, step, speed, slip, work = end_of_phase(
            phase, opening, sliding, speed, slip, work, run.touching[a, BOUNCE]
        )
        if phase == WITHOUT_END:
            return refuse_impact(run, a, UNSOLVED)
        impulse, pull = impulse + step, pull + ratio * step
        if phase == ENDED:
            return spend_impulses(run, a, impulse, pull)
    return refuse_impact(run, a, UNSOLVED)


@jit_separate
def spend_impulses(run: Run, a: int, impulse: float, pull: float) -> bool:
    """Give a link the impulses that were found; whether they make no other link approach that did not."""
    give_impulses(run, a, impulse, pull)
    for b in range(run.counters[TOGETHER]):
        if b != a and run.touching[b, ACTS] == 0.0 and couple(run, a, b):
            size = abs(run.touching[b, RATE]) + abs(gap_rate(run, b))
            if gap_rate(run, b) < -max(run.touching[b, SLACK], SUM_NOISE * size):
                return refuse_impact(run, a, SHARED)
    return True
