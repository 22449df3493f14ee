"""Impacts of many links at once: impulses that solve a linear complementarity problem, or one link after the other.

Few links are solved for by Lemke's method, many by `normal_forces`, whose residual has to fall to rounding. Laws are
those of `march.contacts.impact`.
"""

from __future__ import annotations

from math import sqrt

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.broad_phase import (
    BOUNCED,
    CLOSE,
    COUNT,
    CROWDED,
    DEPTH,
    FASTEST,
    LOSS,
    OVERLAP,
    RESIDUAL,
    TERMS,
    TOGETHER,
    UNSOLVED,
    WORK,
    blame,
)
from xdynamics.march.assembly.closed_links import RIGHT, SCALE, X, closed_index
from xdynamics.march.assembly.links import ASSEMBLY, LINK, member, pattern_at, touch
from xdynamics.march.assembly.narrow_phase import NOISE, resolution_of
from xdynamics.march.assembly.normal_forces import ALLOWED, solve_unilateral
from xdynamics.march.contacts.complementarity import prepare, solve_complementarity
from xdynamics.march.contacts.impact import NEWTON, POISSON, SEQUENTIAL
from xdynamics.march.run import Run

CANDIDATE, GAP, RATE, BOUNCE, SLACK, TARGET_RATE, IMPULSE, TOTAL, LOST, ACTS, BEFORE, OWN, EARLY, BIAS, ROUGH = range(
    15
)
# how far a gap may be from zero; whether the link was closed before, whether it then lifts; its force, the acceleration
# of its gap, whether its bounces are skipped, how
# long these would have lasted, and the energy that this takes
REACH, HELD, LIFTS, FORCE, AFTER, SKIPS, LASTS, TAKEN = range(15, 23)
NUMBERS = 23  # of a link that touches
MOST_LEMKE = 32  # links that Lemke's method solves for
MOST_ROUNDS = 1000
OVERLAPPING = 4.0  # times how far a gap may be from zero: a deeper overlap ends the run


@shared
def collide(run: Run) -> bool:
    """Change the velocities of the trial's state by the impulses of the links that touch; whether they were found."""
    run.spans[RESIDUAL] = 0.0
    if not any_approaches(run):
        return True
    law = run.assemblies[run.candidates[int(run.touching[0, CANDIDATE]), ASSEMBLY]].law
    if law == SEQUENTIAL:
        return one_after_the_other(run)
    for _ in range(MOST_ROUNDS):
        if not press(run, 1.0 if law == NEWTON else 0.0):
            return False
        if law == POISSON and not give_back(run):
            return False
        if not any_approaches(run):
            return True
    return press(run, 0.0)


@shared
def list_touching(run: Run, t: float) -> bool:
    """List the links that touch in the order of their numbers, with what impulses along each do."""
    run.tallies[TOGETHER], listed = 0, True
    for m in range(run.tallies[CLOSE]):
        listed = listed and admit(run, run.close[m], t, False)
    if run.closed[0] > 0:
        for k in range(run.tallies[COUNT]):
            if closed_index(run, run.candidates[k, ASSEMBLY], run.candidates[k, LINK]) >= 0:
                listed = listed and admit(run, k, t, True)
    return listed


@shared
def admit(run: Run, k: int, t: float, is_closed: bool) -> bool:
    """List a candidate if it is closed, or its gap is as good as zero; False where the list cannot be made."""
    c, link, count = run.candidates[k, ASSEMBLY], run.candidates[k, LINK], run.tallies[TOGETHER]
    assembly, pattern = run.assemblies[c], pattern_at(run.patterns[2 * c + 1])
    touch(run, run.z, t, k)
    gap, steep, size = pattern.links[0].gap, 0.0, abs(pattern.links[0].gap)
    for i in range(assembly.coordinates):
        steep += abs(pattern.directions[0, i])
        size += abs(pattern.directions[0, i] * pattern.z[i])
    reach = NOISE * size + 2.0 * steep * run.spans[FASTEST] * resolution_of(run, k, 0.0)
    if gap > reach and not is_closed:
        return True
    if count >= run.touching.shape[0]:
        blame(run, CROWDED, c, link)
        return False
    if not gap >= -OVERLAPPING * reach:
        blame(run, OVERLAP, c, link)
        run.spans[DEPTH] = gap
        return False
    if not 0.0 <= pattern.links[0].coefficient <= 1.0:
        blame(run, BOUNCED, c, link)
        run.spans[DEPTH] = pattern.links[0].coefficient
        return False
    place = count
    while place > 0 and follows(run, place - 1, c, link):
        move(run, place - 1, place)
        place -= 1
    note_link(run, place, k, gap, NOISE * steep * run.spans[FASTEST])
    run.touching[place, ROUGH], run.touching[place, REACH] = NOISE * size, reach
    held = closed_index(run, c, link)
    run.touching[place, HELD] = 1.0 if held >= 0 else 0.0
    run.touching[place, LIFTS] = 1.0 if held >= 0 and run.lifted[held] == 1 and run.loads[held] <= 0.0 else 0.0
    run.tallies[TOGETHER] = count + 1
    return True


@shared
def follows(run: Run, a: int, c: int, link: int) -> bool:
    """Whether a link that is listed comes after another one."""
    k = int(run.touching[a, CANDIDATE])
    own = run.candidates[k, ASSEMBLY]
    return bool(own > c or (own == c and run.candidates[k, LINK] > link))


@shared
def move(run: Run, source: int, target: int) -> None:
    """Move a link that is listed to another place."""
    for j in range(run.touching.shape[1]):
        run.touching[target, j] = run.touching[source, j]
    for i in range(run.normals.shape[1]):
        run.normals[target, i], run.replies[target, i] = run.normals[source, i], run.replies[source, i]
        run.reads[target, i] = run.reads[source, i]


@shared
def note_link(run: Run, a: int, k: int, gap: float, slack: float) -> None:
    """Note a link that touches, from its pattern."""
    c = run.candidates[k, ASSEMBLY]
    assembly, pattern, own = run.assemblies[c], pattern_at(run.patterns[2 * c + 1]), 0.0
    for i in range(run.normals.shape[1]):
        run.normals[a, i], run.replies[a, i], run.reads[a, i] = 0.0, 0.0, 0
    for i in range(assembly.coordinates):
        run.normals[a, i], run.replies[a, i] = pattern.directions[0, i], pattern.responses[0, i]
        link, first, second = run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        run.reads[a, i] = member(run, assembly.first_leaf + i, link, first, second)
        own += pattern.directions[0, i] * pattern.responses[0, i]
    numbers = run.touching
    numbers[a, CANDIDATE], numbers[a, GAP], numbers[a, SLACK], numbers[a, OWN] = k, gap, slack, own
    numbers[a, BOUNCE], numbers[a, TOTAL], numbers[a, LOST] = pattern.links[0].coefficient, 0.0, 0.0
    numbers[a, BIAS] = pattern.links[0].free
    moved = pattern.links[0].rate  # by time alone
    for i in range(assembly.coordinates):
        moved -= pattern.directions[0, i] * pattern.z[assembly.leaves + i]
    numbers[a, EARLY] = moved
    numbers[a, RATE] = pattern.links[0].rate


@shared
def weigh_impulses(run: Run) -> None:
    """Sum the energy that impulses took, what moving surfaces gave by them, and the size of the terms."""
    run.spans[LOSS], run.spans[WORK], run.spans[TERMS] = 0.0, 0.0, 0.0
    for a in range(run.tallies[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        run.spans[LOSS] += run.touching[a, LOST]
        run.spans[WORK] -= impulse * run.touching[a, EARLY]
        run.spans[TERMS] += abs(impulse) * (abs(run.touching[a, RATE]) + abs(rate_of(run, a)))


@shared
def along(run: Run, a: int, total: float, first: int) -> float:
    """A link's normal times numbers of the trial's state, those of coordinates' owners from `first` on, added to a total."""
    for i in range(run.normals.shape[1]):
        total += run.normals[a, i] * run.z[first + run.reads[a, i]]
    return total


@shared
def rate_of(run: Run, a: int) -> float:
    """The rate of a gap with the velocities as they are now."""
    return along(run, a, run.touching[a, EARLY], run.plan[0].coordinates)


@shared
def acceleration_of(run: Run, a: int) -> float:
    """The acceleration of a gap with the accelerations of the trial's state."""
    return along(run, a, run.touching[a, BIAS], run.plan[0].used)


@shared
def apply(run: Run, a: int, impulse: float) -> None:
    """Change velocities by an impulse along a link."""
    n = run.plan[0].coordinates
    for i in range(run.replies.shape[1]):
        run.z[n + run.reads[a, i]] += run.replies[a, i] * impulse


@shared
def any_approaches(run: Run) -> bool:
    """Whether a link that touches approaches by more than rounding leaves."""
    approaches = False
    for a in range(run.tallies[TOGETHER]):
        approaches = approaches or rate_of(run, a) < -run.touching[a, SLACK]
    return approaches


@shared
def one_after_the_other(run: Run) -> bool:
    """Reverse the rate of one link after the other, until none approaches."""
    for _ in range(MOST_ROUNDS * run.tallies[TOGETHER]):
        quiet = True
        for a in range(run.tallies[TOGETHER]):
            rate = rate_of(run, a)
            if rate < -run.touching[a, SLACK]:
                quiet = False
                impulse = -(1.0 + run.touching[a, BOUNCE]) * rate / run.touching[a, OWN]
                apply(run, a, impulse)
                run.touching[a, TOTAL] += impulse
                run.touching[a, LOST] -= impulse * (rate + rate_of(run, a)) / 2.0
        if quiet:
            return True
    return press(run, 0.0)  # what is left after so many is far below what began


@shared
def press(run: Run, share: float) -> bool:
    """Find the impulses of links that approach or rest together; `share` of each restitution counts."""
    for a in range(run.tallies[TOGETHER]):
        rate = rate_of(run, a)
        run.touching[a, ACTS] = 1.0 if rate <= run.touching[a, SLACK] else 0.0
        run.touching[a, TARGET_RATE] = share * run.touching[a, BOUNCE] * min(rate, 0.0)
    return solve(run)


@shared
def give_back(run: Run) -> bool:
    """Have each link give back its share of the impulse of compression (Poisson)."""
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, BEFORE] = rate_of(run, a)
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            apply(run, a, run.touching[a, BOUNCE] * run.touching[a, IMPULSE])
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            impulse = run.touching[a, BOUNCE] * run.touching[a, IMPULSE]
            run.touching[a, TOTAL] += impulse
            run.touching[a, LOST] -= impulse * (run.touching[a, BEFORE] + rate_of(run, a)) / 2.0
        run.touching[a, TARGET_RATE] = 0.0
    return solve(run)


@shared
def solve(run: Run) -> bool:
    """Find non-negative impulses after which no link that acts is below its target, nor above it with an impulse."""
    count = 0
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, BEFORE], run.touching[a, IMPULSE] = rate_of(run, a), 0.0
        count += 1 if run.touching[a, ACTS] == 1.0 else 0
    solved = by_lemke(run, count) if count <= MOST_LEMKE else by_gradients(run)
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, TOTAL] += run.touching[a, IMPULSE]
            run.touching[a, LOST] -= run.touching[a, IMPULSE] * (run.touching[a, BEFORE] + rate_of(run, a)) / 2.0
    residual = unsolved(run)
    run.spans[RESIDUAL] = max(run.spans[RESIDUAL], residual)
    if not (solved and residual <= largest_slack(run)):
        k = int(run.touching[0, CANDIDATE])
        blame(run, UNSOLVED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        return False
    return True


@shared
def largest_slack(run: Run) -> float:
    """What rounding may leave of the residual of all links together."""
    most = 0.0
    for a in range(run.tallies[TOGETHER]):
        most = max(most, run.touching[a, SLACK])
    return most


@shared
def unsolved(run: Run) -> float:
    """The residual: how far a link that acts is below its target, or above it though it has an impulse."""
    worst = 0.0
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            above = rate_of(run, a) + run.touching[a, TARGET_RATE]
            worst = max(worst, abs(min(above, run.touching[a, IMPULSE] * run.touching[a, OWN])))
    return worst


@shared
def by_gradients(run: Run) -> bool:
    """Find the impulses by projected gradients."""
    count = run.tallies[TOGETHER]
    for a in range(count):
        acts = run.touching[a, ACTS] == 1.0
        run.vectors[SCALE, a] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, a] = -(rate_of(run, a) + run.touching[a, TARGET_RATE]) * run.vectors[SCALE, a]
    left = solve_unilateral(run, 0, count)
    for a in range(count):
        run.touching[a, IMPULSE] = run.vectors[X, a] * run.vectors[SCALE, a]
        apply(run, a, run.touching[a, IMPULSE])
    return left <= ALLOWED


@shared
def by_lemke(run: Run, n: int) -> bool:
    """Find the impulses by Lemke's method, scaled so that every link answers itself with one."""
    prepare(run, n)
    i = 0
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            j = 0
            for b in range(run.tallies[TOGETHER]):
                if run.touching[b, ACTS] == 1.0:
                    run.problem[i, n + j] = -answer(run, a, b) / run.touching[b, OWN]
                    j += 1
            run.problem[i, 2 * n + 1] = rate_of(run, a) + run.touching[a, TARGET_RATE]
            i += 1
    if not solve_complementarity(run, n):
        return False
    i = 0
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, IMPULSE] = run.solution[i] / run.touching[a, OWN]
            apply(run, a, run.touching[a, IMPULSE])
            i += 1
    return True


@shared
def answer(run: Run, a: int, b: int) -> float:
    """The effect of a unit of one link's impulse on the rate of another."""
    total = 0.0
    for i in range(run.normals.shape[1]):
        for j in range(run.replies.shape[1]):
            if run.reads[a, i] == run.reads[b, j]:
                total += run.normals[a, i] * run.replies[b, j]
    return total
