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
    ROWS,
    RUBBED,
    TERMS,
    TOGETHER,
    UNSOLVED,
    WORK,
    blame,
)
from xdynamics.march.assembly.closed_links import DRAG, FRICTIONLESS, GRIP, OWN_SCALE, RIGHT, SCALE, X, closed_index
from xdynamics.march.assembly.friction import solve_links
from xdynamics.march.assembly.links import ASSEMBLY, LINK, member, pattern_at, touch
from xdynamics.march.assembly.narrow_phase import NOISE, resolution_of
from xdynamics.march.assembly.normal_forces import ALLOWED
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
# of a link with friction: whether it has any, its coefficients while it slides and before, its slip, how much of it is
# by time alone and how that changes, what rounding leaves of it, what it answers to a unit of its own impulse, this
# impulse and all at the time, its force and acceleration, and what it did before and does after
RUBS, KINETIC, STATIC, SLIP, SLIP_EARLY, SLIP_BIAS, SLIP_SLACK, SLIP_OWN = range(23, 31)
PULL, TOTAL_PULL, DRAGS, SLIP_AFTER, GRIPPED, GRIPS = range(31, 37)
NUMBERS = 37  # of a link that touches
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
    if assembly.rubs == 1 and not 0.0 <= pattern.links[1].coefficient <= pattern.links[1].most:
        blame(run, RUBBED, c, link)
        run.spans[DEPTH] = pattern.links[1].coefficient
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
    if run.tallies[ROWS] == 2:
        run.touching[place, GRIPPED] = run.grips[held] if held >= 0 else FRICTIONLESS
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
    rows = run.tallies[ROWS]
    for row in range(rows):
        old, new = rows * source + row, rows * target + row
        for i in range(run.normals.shape[1]):
            run.normals[new, i], run.replies[new, i] = run.normals[old, i], run.replies[old, i]
            run.reads[new, i] = run.reads[old, i]


@shared
def note_link(run: Run, a: int, k: int, gap: float, slack: float) -> None:
    """Note a link that touches, from its pattern."""
    c = run.candidates[k, ASSEMBLY]
    assembly, pattern, own = run.assemblies[c], pattern_at(run.patterns[2 * c + 1]), 0.0
    row = int(run.tallies[ROWS]) * a
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.replies[row, i], run.reads[row, i] = 0.0, 0.0, 0
    for i in range(assembly.coordinates):
        run.normals[row, i], run.replies[row, i] = pattern.directions[0, i], pattern.responses[0, i]
        link, first, second = run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        run.reads[row, i] = member(run, assembly.first_leaf + i, link, first, second)
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
    if run.tallies[ROWS] == 2:
        note_slip(run, a, k)


@shared
def note_slip(run: Run, a: int, k: int) -> None:
    """Note the slip of a link that touches, from its pattern."""
    assembly, row, numbers = run.assemblies[run.candidates[k, ASSEMBLY]], 2 * a + 1, run.touching
    for j in range(RUBS, NUMBERS):
        numbers[a, j] = 0.0
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.replies[row, i], run.reads[row, i] = 0.0, 0.0, run.reads[row - 1, i]
    if assembly.rubs == 0:
        return
    pattern, own, steep = pattern_at(run.patterns[2 * run.candidates[k, ASSEMBLY] + 1]), 0.0, 0.0
    moved = pattern.links[1].rate
    for i in range(assembly.coordinates):
        run.normals[row, i], run.replies[row, i] = pattern.directions[1, i], pattern.responses[1, i]
        own += pattern.directions[1, i] * pattern.responses[1, i]
        steep += abs(pattern.directions[1, i])
        moved -= pattern.directions[1, i] * pattern.z[assembly.leaves + i]
    numbers[a, RUBS], numbers[a, KINETIC], numbers[a, STATIC] = 1.0, pattern.links[1].coefficient, pattern.links[1].most
    numbers[a, SLIP], numbers[a, SLIP_EARLY], numbers[a, SLIP_BIAS] = (
        pattern.links[1].rate,
        moved,
        pattern.links[1].free,
    )
    numbers[a, SLIP_SLACK], numbers[a, SLIP_OWN] = NOISE * steep * run.spans[FASTEST], own


@shared
def weigh_impulses(run: Run) -> None:
    """Sum the energy that impulses took, what moving surfaces gave by them, and the size of the terms."""
    run.spans[LOSS], run.spans[WORK], run.spans[TERMS] = 0.0, 0.0, 0.0
    for a in range(run.tallies[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        run.spans[LOSS] += run.touching[a, LOST]
        run.spans[WORK] -= impulse * run.touching[a, EARLY]
        run.spans[TERMS] += abs(impulse) * (abs(run.touching[a, RATE]) + abs(rate_of(run, a)))
        if run.touching[a, RUBS] == 1.0:
            pull = run.touching[a, TOTAL_PULL]
            run.spans[WORK] -= pull * run.touching[a, SLIP_EARLY]
            run.spans[TERMS] += abs(pull) * (abs(run.touching[a, SLIP]) + abs(slip_of(run, a)))


@shared
def along(run: Run, row: int, total: float, first: int) -> float:
    """A row of a link times numbers of the trial's state, those of coordinates' owners from `first` on, added to a total."""
    for i in range(run.normals.shape[1]):
        total += run.normals[row, i] * run.z[first + run.reads[row, i]]
    return total


@shared
def rate_of(run: Run, a: int) -> float:
    """The rate of a gap with the velocities as they are now."""
    return along(run, int(run.tallies[ROWS]) * a, run.touching[a, EARLY], run.plan[0].coordinates)


@shared
def slip_of(run: Run, a: int) -> float:
    """The slip of a link with friction, with the velocities as they are now."""
    return along(run, 2 * a + 1, run.touching[a, SLIP_EARLY], run.plan[0].coordinates)


@shared
def acceleration_along(run: Run, row: int, bias: float) -> float:
    """The acceleration of a gap, or of a slip, with the accelerations of the trial's state."""
    return along(run, row, bias, run.plan[0].used)


@shared
def apply(run: Run, row: int, impulse: float) -> None:
    """Change velocities by an impulse along a row."""
    n = run.plan[0].coordinates
    for i in range(run.replies.shape[1]):
        run.z[n + run.reads[row, i]] += run.replies[row, i] * impulse


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
                apply(run, a, impulse)  # without friction, a link has one row
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
    rubs = run.tallies[ROWS] == 2
    for a in range(run.tallies[TOGETHER]):
        if rubs:
            run.touching[a, SLIP_AFTER], run.touching[a, PULL] = slip_of(run, a), 0.0
    solved = by_lemke(run, count) if count <= MOST_LEMKE and not rubs else by_gradients(run)
    for a in range(run.tallies[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, TOTAL] += run.touching[a, IMPULSE]
            run.touching[a, LOST] -= run.touching[a, IMPULSE] * (run.touching[a, BEFORE] + rate_of(run, a)) / 2.0
            if run.touching[a, RUBS] == 1.0 and rubs:
                pull = run.touching[a, PULL]
                run.touching[a, TOTAL_PULL] += pull
                run.touching[a, LOST] -= pull * (run.touching[a, SLIP_AFTER] + slip_of(run, a)) / 2.0
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
            if run.tallies[ROWS] == 2 and run.touching[a, RUBS] == 1.0:
                own, most = run.touching[a, SLIP_OWN], run.touching[a, KINETIC] * run.touching[a, IMPULSE]
                pull = run.touching[a, PULL]
                projected = min(max(-most, pull - slip_of(run, a) / own), most)
                worst = max(worst, abs(pull - projected) * own)
    return worst


@shared
def by_gradients(run: Run) -> bool:
    """Find the impulses by projected gradients."""
    count, rows = run.tallies[TOGETHER], int(run.tallies[ROWS])
    for a in range(count):
        acts, row = run.touching[a, ACTS] == 1.0, rows * a
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, row] = -(rate_of(run, a) + run.touching[a, TARGET_RATE]) * run.vectors[SCALE, row]
        if rows == 2:
            pose_slip(run, a, acts, slip_of(run, a))
            run.vectors[GRIP, row + 1] = run.touching[a, KINETIC]
    left = solve_links(run, 0, count)
    for a in range(count):
        row = rows * a
        run.touching[a, IMPULSE] = run.vectors[X, row] * run.vectors[SCALE, row]
        apply(run, row, run.touching[a, IMPULSE])
        if rows == 2:
            run.touching[a, PULL] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1]
            apply(run, row + 1, run.touching[a, PULL])
    return left <= ALLOWED


@shared
def pose_slip(run: Run, a: int, acts: bool, slip: float) -> None:
    """Write what a link's slip, or its acceleration, is to change by; nothing where it has no friction."""
    row, acts = 2 * a + 1, acts and run.touching[a, RUBS] == 1.0
    scale = 1.0 / sqrt(run.touching[a, SLIP_OWN]) if acts else 0.0
    run.vectors[SCALE, row], run.vectors[OWN_SCALE, row] = scale, scale
    run.vectors[RIGHT, row], run.vectors[GRIP, row], run.vectors[DRAG, row] = -slip * scale, 0.0, 0.0


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
