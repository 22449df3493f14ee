"""Which of the links that touch are closed from now on: the accelerations decide, and bounces too low are skipped.

Of links that touch and do not part, forces and accelerations solve a complementarity problem: either a link presses, or
its gap opens. A link that bounces so low that it may be skipped, or too briefly to be resolved, joins them.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.broad_phase import LOSS, STRAIN, STRAINED, TERMS, TOGETHER, WORK, blame
from xdynamics.march.assembly.closed_links import RIGHT, SCALE, X, list_ends, look_at_closed
from xdynamics.march.assembly.holding import project, stop
from xdynamics.march.assembly.impact import (
    ACTS,
    AFTER,
    BIAS,
    BOUNCE,
    CANDIDATE,
    EARLY,
    FORCE,
    LASTS,
    LIFTS,
    OWN,
    RATE,
    SKIPS,
    SLACK,
    TAKEN,
    acceleration_of,
    rate_of,
)
from xdynamics.march.assembly.links import ASSEMBLY, LINK
from xdynamics.march.assembly.narrow_phase import NOISE, resolution_of
from xdynamics.march.assembly.normal_forces import ALLOWED, solve_unilateral
from xdynamics.march.force_evaluation import evaluate
from xdynamics.march.run import Run

LOW = 1e-9  # of the height of the highest bounce: those that may be skipped, unless the model says how low they are
ROUNDS = 4  # of examining again which links come to rest


@shared
def rest(run: Run, t: float) -> bool:
    """Find out which links that touch are closed, and put the trial's state on them; whether their forces were found."""
    note_speeds(run)
    run.closed[0] = 0
    evaluate(run, t, run.z)  # without forces of links
    for a in range(run.tallies[TOGETHER]):
        still = abs(rate_of(run, a)) <= run.touching[a, SLACK] + falling(run, a) * resolution(run, a)
        run.touching[a, ACTS] = 1.0 if still and run.touching[a, LIFTS] == 0.0 else 0.0
        run.touching[a, SKIPS], run.touching[a, LASTS], run.touching[a, TAKEN] = 0.0, 0.0, 0.0
    for _ in range(ROUNDS):
        if not solve_forces(run):
            return False
        if not skip_bounces(run):
            break
    close(run)
    take_energy(run, t)
    project(run, t)
    return True


@shared
def note_speeds(run: Run) -> None:
    """Remember how fast links of each contact met."""
    for a in range(run.tallies[TOGETHER]):
        c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
        run.greatest[1 + c] = max(run.greatest[1 + c], -run.touching[a, RATE])


@shared
def resolution(run: Run, a: int) -> float:
    """The time within which what happens to a link is located."""
    return resolution_of(run, int(run.touching[a, CANDIDATE]), 0.0)


@shared
def falling(run: Run, a: int) -> float:
    """The size of the terms of a link's acceleration without forces of links."""
    accelerations, size = run.plan[0].used, abs(run.touching[a, BIAS])
    for i in range(run.normals.shape[1]):
        size += abs(run.normals[a, i] * run.z[accelerations + run.reads[a, i]])
    return size


@shared
def solve_forces(run: Run) -> bool:
    """Find the forces of links that do not part, and the acceleration of every gap with them."""
    count = run.tallies[TOGETHER]
    for a in range(count):
        acts = run.touching[a, ACTS] == 1.0
        run.vectors[SCALE, a] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, a] = -acceleration_of(run, a) * run.vectors[SCALE, a]
    left = solve_unilateral(run, 0, count)
    if not left <= ALLOWED:
        k = int(run.touching[0, CANDIDATE])
        blame(run, STRAINED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        run.spans[STRAIN] = left
        return False
    for a in range(count):
        run.touching[a, FORCE] = run.vectors[X, a] * run.vectors[SCALE, a]
    note_accelerations(run)
    return True


@shared
def note_accelerations(run: Run) -> None:
    """Note the acceleration of every gap that touches, with the forces just found."""
    count = run.tallies[TOGETHER]
    for a in range(count):
        for i in range(run.reads.shape[1]):
            run.swing[run.reads[a, i]] = 0.0
    for a in range(count):
        for i in range(run.reads.shape[1]):
            run.swing[run.reads[a, i]] += run.replies[a, i] * run.touching[a, FORCE]
    for a in range(count):
        total = acceleration_of(run, a)
        for i in range(run.reads.shape[1]):
            total += run.normals[a, i] * run.swing[run.reads[a, i]]
        run.touching[a, AFTER] = total


@shared
def skip_bounces(run: Run) -> bool:
    """Let links settle whose next bounce is too low; whether any did."""
    any_settles = False
    for a in range(run.tallies[TOGETHER]):
        rate, fall = rate_of(run, a), -run.touching[a, AFTER]
        waits = run.touching[a, ACTS] == 0.0 and run.touching[a, LIFTS] == 0.0
        if waits and rate > 0.0 and fall > NOISE * falling(run, a) and is_low(run, a, rate, fall):
            share = 1.0 - run.touching[a, BOUNCE]  # by which each remaining bounce is shorter than the last
            run.touching[a, LASTS] = 2.0 * rate / fall / share if share > 0.0 else inf
            run.touching[a, ACTS], run.touching[a, SKIPS], any_settles = 1.0, 1.0, True
    return any_settles


@shared
def is_low(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether the next bounce of a link is as good as none."""
    c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
    height = run.assemblies[c].rest_height
    if rate <= max(run.touching[a, SLACK], 2.0 * fall * resolution(run, a)):
        return True
    if run.touching[a, BOUNCE] >= 1.0:  # bounces never end
        return False
    return rate * rate <= (2.0 * fall * height if height >= 0.0 else LOW * run.greatest[1 + c] * run.greatest[1 + c])


@shared
def close(run: Run) -> None:
    """Write down which links are closed from now on: those that press, and those whose gap does not open either."""
    count = 0
    for a in range(run.tallies[TOGETHER]):
        opens = run.touching[a, FORCE] == 0.0 and run.touching[a, AFTER] > 4.0 * NOISE * falling(run, a)
        if run.touching[a, ACTS] == 1.0 and not opens:
            k = int(run.touching[a, CANDIDATE])
            count += 1
            run.closed[count] = run.assemblies[run.candidates[k, ASSEMBLY]].first_link + run.candidates[k, LINK]
        else:
            run.touching[a, ACTS], run.touching[a, SKIPS] = 0.0, 0.0
    run.closed[0] = count
    list_ends(run)


@shared
def take_energy(run: Run, t: float) -> None:
    """Remove the rates of closed links, and note what energy bounces that are skipped had."""
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, TAKEN] = rate_of(run, a)
    look_at_closed(run, t, run.z)
    stop(run)
    row = run.touching.shape[0]
    for a in range(run.tallies[TOGETHER]):
        before = run.touching[a, TAKEN]
        run.touching[a, TAKEN] = 0.0
        if run.touching[a, ACTS] == 1.0:
            impulse, after = run.vectors[X, row] * run.vectors[SCALE, row], rate_of(run, a)
            taken = -impulse * (before + after) / 2.0
            run.touching[a, TAKEN] = taken if run.touching[a, SKIPS] == 1.0 else 0.0
            run.spans[LOSS] += taken
            run.spans[WORK] -= impulse * run.touching[a, EARLY]
            run.spans[TERMS] += abs(impulse) * (abs(before) + abs(after))
            row += 1
