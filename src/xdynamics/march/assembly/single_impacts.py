"""Impacts of one link at a time, with friction, in closed form: Newton's law, or the energetic coefficient of restitution.

Laws are those of `march.contacts.impact` and `march.contacts.energetic`, whose references these are.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
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
    apply,
    rate_of,
    slip_of,
)
from xdynamics.march.contacts.delassus import NOISE
from xdynamics.march.contacts.energetic_phases import (
    COMPRESSION,
    ENDED,
    MOST_PHASES,
    WITHOUT_END,
    end_of_phase,
    is_held,
    slopes,
)
from xdynamics.march.run import Run


@shared
def rubs(run: Run, a: int) -> bool:
    """Whether a link has friction."""
    return bool(run.tallies[ROWS] == 2 and run.touching[a, RUBS] == 1.0)


@shared
def slip_at(run: Run, a: int) -> float:
    """The slip of a link; 0 where it has no friction."""
    return slip_of(run, a) if rubs(run, a) else 0.0


@shared
def give(run: Run, a: int, impulse: float, pull: float) -> None:
    """Change velocities by the impulses of a link, and sum these and the energy that they take."""
    rate, slip, row = rate_of(run, a), slip_at(run, a), int(run.tallies[ROWS]) * a
    apply(run, row, impulse)
    if rubs(run, a):
        apply(run, row + 1, pull)
        run.touching[a, TOTAL_PULL] += pull
        run.touching[a, LOST] -= pull * (slip + slip_of(run, a)) / 2.0
    run.touching[a, TOTAL] += impulse
    run.touching[a, LOST] -= impulse * (rate + rate_of(run, a)) / 2.0


@shared
def refuse(run: Run, a: int, fault: int) -> bool:
    """Blame a link for an impact without a solution; always False."""
    k = int(run.touching[a, CANDIDATE])
    blame(run, fault, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
    return False


@shared
def reverse(run: Run, a: int) -> bool:
    """Reverse the rate of one link by Newton's law, with friction that ends its slip or is at its bound against it."""
    solved, impulse, pull = answer_of(run, a, (1.0 + run.touching[a, BOUNCE]) * rate_of(run, a), slip_at(run, a))
    if not solved:
        return refuse(run, a, UNSOLVED)
    give(run, a, impulse, pull)
    return True


@shared
def answer_of(run: Run, a: int, rate: float, slip: float) -> tuple[bool, float, float]:
    """Whether a link alone has impulses, and these: normal, along its slip; of rates without them, for a gap not to close."""
    own = run.touching[a, OWN]
    if rate >= 0.0 or not rubs(run, a):
        return True, max(0.0, -rate / own), 0.0
    across, along, most = run.touching[a, ACROSS], run.touching[a, SLIP_OWN], run.touching[a, KINETIC]
    determinant = own * along - across * across
    if determinant > NOISE * own * along:
        impulse, pull = (across * slip - along * rate) / determinant, (across * rate - own * slip) / determinant
        if impulse >= 0.0 and abs(pull) <= most * impulse:
            return True, impulse, pull
    for k in range(2):
        way = 1.0 - 2.0 * k
        reply = own - way * most * across
        if reply > 0.0:
            impulse = -rate / reply
            pull = -way * most * impulse
            if way * (slip + across * impulse + along * pull) >= 0.0:
                return True, impulse, pull
    return False, 0.0, 0.0


@shared
def each_alone(run: Run) -> bool:
    """Strike every link that approaches by the energetic law; whether none acts on another one."""
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, ACTS] = 1.0 if rate_of(run, a) < -run.touching[a, SLACK] else 0.0
    for a in range(run.tallies[TOGETHER]):
        for b in range(a):
            if run.touching[a, ACTS] == 1.0 and run.touching[b, ACTS] == 1.0 and couple(run, a, b):
                return refuse(run, a, SHARED)
    solved = True
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            solved = solved and strike(run, a)
    return solved


@shared
def couple(run: Run, a: int, b: int) -> bool:
    """Whether impulses of one link change the rate or the slip of another."""
    rows = int(run.tallies[ROWS])
    for row in range(rows * a, rows * (a + 1)):
        for other in range(rows * b, rows * (b + 1)):
            effect, size = 0.0, 0.0
            for i in range(run.reads.shape[1]):
                for j in range(run.reads.shape[1]):
                    if run.reads[row, i] == run.reads[other, j]:
                        effect += run.normals[row, i] * run.replies[other, j]
                        size += abs(run.normals[row, i] * run.replies[other, j])
            if abs(effect) > NOISE * size:
                return True
    return False


@shared
def strike(run: Run, a: int) -> bool:
    """Find the impulse of one link phase by phase."""
    first, own, slip = rate_of(run, a), run.touching[a, OWN], slip_at(run, a)
    across, along, most = 0.0, 0.0, 0.0
    if rubs(run, a):
        across, along, most = run.touching[a, ACROSS], run.touching[a, SLIP_OWN], run.touching[a, KINETIC]
    speed, impulse, pull, work, phase = first, 0.0, 0.0, 0.0, COMPRESSION
    for _ in range(MOST_PHASES):
        ratio, opening, sliding = slopes(own, across, along, most, slip)
        if is_held(opening, own, slip):
            return spend(run, a, impulse, pull) if abs(speed) <= NOISE * abs(first) else refuse(run, a, UNSOLVED)
        phase, step, speed, slip, work = end_of_phase(
            phase, opening, sliding, speed, slip, work, run.touching[a, BOUNCE]
        )
        if phase == WITHOUT_END:
            return refuse(run, a, UNSOLVED)
        impulse, pull = impulse + step, pull + ratio * step
        if phase == ENDED:
            return spend(run, a, impulse, pull)
    return refuse(run, a, UNSOLVED)


@shared
def spend(run: Run, a: int, impulse: float, pull: float) -> bool:
    """Give a link the impulses that were found; whether they make no other link approach that did not."""
    give(run, a, impulse, pull)
    for b in range(run.tallies[TOGETHER]):
        if b != a and run.touching[b, ACTS] == 0.0 and couple(run, a, b):
            size = abs(run.touching[b, RATE]) + abs(rate_of(run, b))
            if rate_of(run, b) < -max(run.touching[b, SLACK], NOISE * size):
                return refuse(run, a, SHARED)
    return True
