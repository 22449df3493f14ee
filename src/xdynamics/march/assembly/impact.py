"""Impacts of many links: impulses from a linear complementarity problem, or of one link after the other.

Few links are solved for by Lemke's method, many by `normal_forces`, whose residual has to fall to rounding. Impacts of
one link at a time, with friction, are solved in closed form: Newton's law, or the energetic coefficient of restitution.
Laws are those of `march.contacts.impact`, whose references these are.

Links that touch as an impact begins are listed with the effect of an impulse along each of them.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import (
    ASSEMBLY,
    BOUNCED,
    CLOSE,
    COUNT,
    CROWDED,
    DEPTH,
    FASTEST,
    LINK,
    LOSS,
    NOISE,
    OVERLAP,
    RESIDUAL,
    ROWS,
    RUBBED,
    SHARED,
    TERMS,
    TOGETHER,
    UNSOLVED,
    WORK,
    blame,
    evaluate_candidate,
    leaf_member,
    pattern_at,
)
from xdynamics.march.assembly.closed_links import (
    BREAKS,
    DRAG,
    FRICTIONLESS,
    GRIP,
    OWN_SCALE,
    RETURNED,
    RIGHT,
    SCALE,
    X,
    closed_index,
)
from xdynamics.march.assembly.friction import solve_links
from xdynamics.march.assembly.narrow_phase import reach_of
from xdynamics.march.contacts.delassus import SUM_NOISE, clear_tableau, solve_complementarity
from xdynamics.march.contacts.impact import (
    COMPRESSION,
    ENDED,
    ENERGETIC,
    MOST_PHASES,
    NEWTON,
    POISSON,
    SEQUENTIAL,
    WITHOUT_END,
    end_of_phase,
    is_held,
    phase_slopes,
)
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
# the impulse that it gives back by Poisson's law, what its slip answers to a normal impulse, the direction of the
# friction of a grip that has just broken, and why its slip is stopped if it is
GIVES_BACK, ACROSS, BROKEN, HALTED = range(37, 41)
GOES_ON = 41  # whether a slip is not to be stopped, as it would go on
BOUNCES = 42  # whether a bounce is not skipped though it is low, as no forces exist with its link held
NUMBERS = 43  # of a link that touches
WEDGED, SLIP_ENDED = 1.0, 2.0  # why a slow slip is stopped: no forces exist while it lasts, or friction ends it so soon
OVERLAPPING = 4.0  # times how far a gap may be from zero: a deeper overlap ends the run


@jit_separate
def list_touching(run: Run, t: float) -> bool:
    """List the links that touch in the order of their numbers, with the responses to impulses along each."""
    run.counters[TOGETHER], all_listed = 0, True
    for m in range(run.counters[CLOSE]):
        all_listed = all_listed and admit(run, run.close[m], t, False)
    if run.closed[0] > 0:
        for k in range(run.counters[COUNT]):
            if closed_index(run, run.candidates[k, ASSEMBLY], run.candidates[k, LINK]) >= 0:
                all_listed = all_listed and admit(run, k, t, True)
    return all_listed


@jit_separate
def admit(run: Run, k: int, t: float, is_closed: bool) -> bool:
    """List a candidate if it is closed, or its gap is as good as zero; False where the list cannot be made."""
    c, link = run.candidates[k, ASSEMBLY], run.candidates[k, LINK]
    evaluate_candidate(run, run.z, t, k)
    (gap, steep, size), reach = gap_of(run, k), reach_of(run, k)
    if gap > reach and not is_closed:
        return True
    if not gap >= -OVERLAPPING * reach and not (
        is_closed and gap > -inf
    ):  # gaps of closed links are seen to after steps
        blame(run, OVERLAP, c, link)
        run.spans[DEPTH] = gap
        return False
    list_index = enlist(run, k, gap, NOISE * steep * run.spans[FASTEST])
    if list_index < 0:
        return False
    run.touching[list_index, ROUGH], run.touching[list_index, REACH] = NOISE * size, reach
    closed_place = closed_index(run, c, link)
    run.touching[list_index, HELD] = 1.0 if closed_place >= 0 else 0.0
    run.touching[list_index, LIFTS] = (
        1.0 if closed_place >= 0 and run.lifted[closed_place] == 1 and run.loads[closed_place] <= 0.0 else 0.0
    )
    if run.counters[ROWS] == 2:
        run.touching[list_index, GRIPPED] = run.grips[closed_place] if closed_place >= 0 else FRICTIONLESS
        if closed_place >= 0 and run.lifted[closed_place] == BREAKS:
            run.touching[list_index, BROKEN] = 1.0 if run.pulls[closed_place] > 0.0 else -1.0
    return True


@jit_separate
def gap_of(run: Run, k: int) -> tuple[float, float, float]:
    """Return the gap of a candidate that was just looked at, how steep it is, and the size of the terms it is the sum of."""
    c = run.candidates[k, ASSEMBLY]
    pattern, steep = pattern_at(run.patterns[2 * c + 1]), 0.0
    size = abs(pattern.links[0].gap)
    for i in range(run.assemblies[c].coordinates):
        steep += abs(pattern.directions[0, i])
        size += abs(pattern.directions[0, i] * pattern.z[i])
    return pattern.links[0].gap, steep, size


@jit_separate
def enlist(run: Run, k: int, gap: float, slack: float) -> int:
    """Insert an evaluated candidate into the sorted list; return its index, -1 if the list cannot be made."""
    c, link, list_index = run.candidates[k, ASSEMBLY], run.candidates[k, LINK], run.counters[TOGETHER]
    pattern = pattern_at(run.patterns[2 * c + 1])
    if list_index >= run.touching.shape[0]:
        blame(run, CROWDED, c, link)
        return -1
    if run.assemblies[c].rubs == 1 and not 0.0 <= pattern.links[1].coefficient <= pattern.links[1].most:
        blame(run, RUBBED, c, link)
        run.spans[DEPTH] = pattern.links[1].coefficient
        return -1
    if not 0.0 <= pattern.links[0].coefficient <= 1.0:
        blame(run, BOUNCED, c, link)
        run.spans[DEPTH] = pattern.links[0].coefficient
        return -1
    # kept in the order of numbers: closed links are listed from these, and `closed_index` halves that list
    while list_index > 0 and is_listed_after(run, list_index - 1, c, link):
        move_listed_link(run, list_index - 1, list_index)
        list_index -= 1
    note_link(run, list_index, k, gap, slack)
    run.counters[TOGETHER] += 1
    return list_index


@jit_separate
def is_listed_after(run: Run, a: int, c: int, link: int) -> bool:
    """Whether a link that is listed comes after another one."""
    k = int(run.touching[a, CANDIDATE])
    listed_assembly = run.candidates[k, ASSEMBLY]
    return bool(listed_assembly > c or (listed_assembly == c and run.candidates[k, LINK] > link))


@jit_separate
def move_listed_link(run: Run, source: int, target: int) -> None:
    """Move a listed link to another index."""
    for j in range(run.touching.shape[1]):
        run.touching[target, j] = run.touching[source, j]
    rows = run.counters[ROWS]
    for row in range(rows):
        old, new = rows * source + row, rows * target + row
        for i in range(run.normals.shape[1]):
            run.normals[new, i], run.unit_responses[new, i] = run.normals[old, i], run.unit_responses[old, i]
            run.coordinate_indices[new, i] = run.coordinate_indices[old, i]


@jit_separate
def note_link(run: Run, a: int, k: int, gap: float, slack: float) -> None:
    """Store the normal row of a link that touches, from its pattern."""
    c = run.candidates[k, ASSEMBLY]
    assembly, pattern, self_response = run.assemblies[c], pattern_at(run.patterns[2 * c + 1]), 0.0
    row = int(run.counters[ROWS]) * a
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.unit_responses[row, i], run.coordinate_indices[row, i] = 0.0, 0.0, 0
    for i in range(assembly.coordinates):
        run.normals[row, i], run.unit_responses[row, i] = pattern.directions[0, i], pattern.responses[0, i]
        link, first, second = run.candidates[k, 1], run.candidates[k, 2], run.candidates[k, 3]
        run.coordinate_indices[row, i] = leaf_member(run, assembly.first_leaf + i, link, first, second)
        self_response += pattern.directions[0, i] * pattern.responses[0, i]
    numbers = run.touching
    numbers[a, CANDIDATE], numbers[a, GAP], numbers[a, SLACK], numbers[a, OWN] = k, gap, slack, self_response
    numbers[a, BOUNCE], numbers[a, TOTAL], numbers[a, LOST] = pattern.links[0].coefficient, 0.0, 0.0
    numbers[a, BIAS], numbers[a, GIVES_BACK] = pattern.links[0].free, 0.0
    numbers[a, SKIPS], numbers[a, LASTS], numbers[a, TAKEN], numbers[a, BOUNCES] = 0.0, 0.0, 0.0, 0.0
    rate_by_time = pattern.links[0].rate  # by time alone
    for i in range(assembly.coordinates):
        rate_by_time -= pattern.directions[0, i] * pattern.z[assembly.leaves + i]
    numbers[a, EARLY] = rate_by_time
    numbers[a, RATE] = pattern.links[0].rate
    if run.counters[ROWS] == 2:
        note_slip(run, a, k)


@jit_separate
def note_slip(run: Run, a: int, k: int) -> None:
    """Store the slip row of a link that touches, from its pattern."""
    assembly, row, numbers = run.assemblies[run.candidates[k, ASSEMBLY]], 2 * a + 1, run.touching
    for j in range(RUBS, NUMBERS):
        numbers[a, j] = 0.0
    for i in range(run.normals.shape[1]):
        run.normals[row, i], run.unit_responses[row, i], run.coordinate_indices[row, i] = (
            0.0,
            0.0,
            run.coordinate_indices[row - 1, i],
        )
    if assembly.rubs == 0:
        return
    pattern, self_response, steep = pattern_at(run.patterns[2 * run.candidates[k, ASSEMBLY] + 1]), 0.0, 0.0
    slip_by_time, across = pattern.links[1].rate, 0.0
    for i in range(assembly.coordinates):
        run.normals[row, i], run.unit_responses[row, i] = pattern.directions[1, i], pattern.responses[1, i]
        self_response += pattern.directions[1, i] * pattern.responses[1, i]
        across += pattern.directions[1, i] * pattern.responses[0, i]
        steep += abs(pattern.directions[1, i])
        slip_by_time -= pattern.directions[1, i] * pattern.z[assembly.leaves + i]
    numbers[a, RUBS], numbers[a, KINETIC], numbers[a, STATIC] = 1.0, pattern.links[1].coefficient, pattern.links[1].most
    numbers[a, SLIP], numbers[a, SLIP_EARLY], numbers[a, SLIP_BIAS] = (
        pattern.links[1].rate,
        slip_by_time,
        pattern.links[1].free,
    )
    numbers[a, SLIP_SLACK], numbers[a, SLIP_OWN] = NOISE * steep * run.spans[FASTEST], self_response
    numbers[a, ACROSS] = across


@jit_separate
def sum_along_row(run: Run, row: int, total: float, first: int) -> float:
    """A row of a link times numbers of the trial's state, those of coordinates' owners from `first` on, added to a total."""
    for i in range(run.normals.shape[1]):
        total += run.normals[row, i] * run.z[first + run.coordinate_indices[row, i]]
    return total


@jit_separate
def gap_rate(run: Run, a: int) -> float:
    """The rate of a gap with the velocities as they are now."""
    return sum_along_row(run, int(run.counters[ROWS]) * a, run.touching[a, EARLY], run.plan[0].coordinates)


@jit_separate
def slip_of(run: Run, a: int) -> float:
    """The slip of a link with friction, with the velocities as they are now."""
    return sum_along_row(run, 2 * a + 1, run.touching[a, SLIP_EARLY], run.plan[0].coordinates)


@jit_separate
def acceleration_along(run: Run, row: int, bias: float) -> float:
    """The acceleration of a gap, or of a slip, with the accelerations of the trial's state."""
    return sum_along_row(run, row, bias, run.plan[0].used)


@jit_separate
def apply_impulse(run: Run, row: int, impulse: float) -> None:
    """Change velocities by an impulse along a row."""
    n = run.plan[0].coordinates
    for i in range(run.unit_responses.shape[1]):
        run.z[n + run.coordinate_indices[row, i]] += run.unit_responses[row, i] * impulse


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
    """Change velocities by the impulses of a link, and sum these and the energy that they dissipate."""
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
    """Whether a link alone has impulses that keep its gap open, and these: normal, along its slip."""
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
    """Apply the solved impulses to a link; whether no other link that was apart approaches by them."""
    give_impulses(run, a, impulse, pull)
    for b in range(run.counters[TOGETHER]):
        if b != a and run.touching[b, ACTS] == 0.0 and couple(run, a, b):
            size = abs(run.touching[b, RATE]) + abs(gap_rate(run, b))
            if gap_rate(run, b) < -max(run.touching[b, SLACK], SUM_NOISE * size):
                return refuse_impact(run, a, SHARED)
    return True


MOST_LEMKE = 32  # links that Lemke's method solves for
MOST_ROUNDS = 1000
ALLOWED_OVER_STEP = 1e-6  # of rates: what impulses over a step may leave, whose own error is far larger


@jit_separate
def collide_links(run: Run) -> bool:
    """Change the trial's velocities by the impulses of the links that touch; whether these have a solution."""
    if not any_link_approaches(run):
        return True
    law = run.assemblies[run.candidates[int(run.touching[0, CANDIDATE]), ASSEMBLY]].law
    if law == SEQUENTIAL:
        return reverse_links_in_turn(run)
    if law == ENERGETIC:
        return each_alone(run)
    for _ in range(MOST_ROUNDS):
        if not press_links(run, 1.0 if law == NEWTON else 0.0):
            return False
        if law == POISSON and not restore_link_impulses(run):
            return False
        if not any_link_approaches(run):
            return True
    return press_links(run, 0.0)


@jit_separate
def weigh_link_impulses(run: Run) -> None:
    """Sum the energy loss of impulses, the work of moving surfaces, and the size of the terms."""
    for a in range(run.counters[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        run.spans[LOSS] += run.touching[a, LOST]
        run.spans[WORK] -= impulse * run.touching[a, EARLY]
        run.spans[TERMS] += abs(impulse) * (abs(run.touching[a, RATE]) + abs(gap_rate(run, a)))
        if run.touching[a, RUBS] == 1.0:
            pull = run.touching[a, TOTAL_PULL]
            run.spans[WORK] -= pull * run.touching[a, SLIP_EARLY]
            run.spans[TERMS] += abs(pull) * (abs(run.touching[a, SLIP]) + abs(slip_of(run, a)))


@jit_separate
def any_link_approaches(run: Run) -> bool:
    """Whether a link that touches approaches by more than rounding leaves."""
    approaches = False
    for a in range(run.counters[TOGETHER]):
        approaches = approaches or gap_rate(run, a) < -run.touching[a, SLACK]
    return approaches


@jit_separate
def any_open_approaches(run: Run) -> bool:
    """Whether a link without impulse approaches; residual rates of others stem from slightly old directions."""
    approaches = False
    for a in range(run.counters[TOGETHER]):
        approaches = approaches or (run.touching[a, ACTS] == 0.0 and gap_rate(run, a) < -run.touching[a, SLACK])
    return approaches


@jit_separate
def reverse_links_in_turn(run: Run) -> bool:
    """Reverse the rate of one link after the other, until none approaches."""
    for _ in range(MOST_ROUNDS * run.counters[TOGETHER]):
        quiet = True
        for a in range(run.counters[TOGETHER]):
            rate = gap_rate(run, a)
            if rate < -run.touching[a, SLACK]:
                quiet = False
                if not reverse(run, a):
                    return False
        if quiet:
            return True
    return press_links(run, 0.0)  # what is left after so many is far below what began


@jit_separate
def press_links(run: Run, share: float) -> bool:
    """Find the impulses of links that approach or rest together; `share` of each restitution counts."""
    for a in range(run.counters[TOGETHER]):
        rate = gap_rate(run, a)
        run.touching[a, ACTS] = 1.0 if rate <= run.touching[a, SLACK] else 0.0
        run.touching[a, TARGET_RATE] = share * run.touching[a, BOUNCE] * min(rate, 0.0)
        run.touching[a, GIVES_BACK] = 0.0
    return solve_link_impulses(run)


@jit_separate
def restore_link_impulses(run: Run) -> bool:
    """Add each link's share of restitution to its impulse of compression (Poisson)."""
    rows = int(run.counters[ROWS])
    for a in range(run.counters[TOGETHER]):
        acts = run.touching[a, ACTS] == 1.0
        run.touching[a, BEFORE], run.touching[a, TARGET_RATE] = gap_rate(run, a), 0.0
        run.touching[a, GIVES_BACK] = run.touching[a, BOUNCE] * run.touching[a, IMPULSE] if acts else 0.0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, GIVES_BACK] != 0.0:
            apply_impulse(run, rows * a, run.touching[a, GIVES_BACK])
    for a in range(run.counters[TOGETHER]):
        impulse = run.touching[a, GIVES_BACK]
        run.touching[a, TOTAL] += impulse
        run.touching[a, LOST] -= impulse * (run.touching[a, BEFORE] + gap_rate(run, a)) / 2.0
    return solve_link_impulses(run)


@jit_separate
def solve_link_impulses(run: Run) -> bool:
    """Find non-negative impulses after which no link that acts is below its target, nor above it with an impulse."""
    count = 0
    for a in range(run.counters[TOGETHER]):
        run.touching[a, BEFORE], run.touching[a, IMPULSE] = gap_rate(run, a), 0.0
        count += 1 if run.touching[a, ACTS] == 1.0 else 0
    rubs = run.counters[ROWS] == 2
    for a in range(run.counters[TOGETHER]):
        if rubs:
            run.touching[a, SLIP_AFTER], run.touching[a, PULL] = slip_of(run, a), 0.0
    solved = solve_by_lemke(run, count) if count <= MOST_LEMKE and not rubs else solve_by_gradients(run)
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, TOTAL] += run.touching[a, IMPULSE]
            run.touching[a, LOST] -= run.touching[a, IMPULSE] * (run.touching[a, BEFORE] + gap_rate(run, a)) / 2.0
            if run.touching[a, RUBS] == 1.0 and rubs:
                pull = run.touching[a, PULL]
                run.touching[a, TOTAL_PULL] += pull
                run.touching[a, LOST] -= pull * (run.touching[a, SLIP_AFTER] + slip_of(run, a)) / 2.0
    residual = impulse_residual(run)
    run.spans[RESIDUAL] = max(run.spans[RESIDUAL], residual)
    allowed = largest_slack(run) * (ALLOWED_OVER_STEP / NOISE if run.plan[0].steps_over > 0 else 1.0)
    if not (solved and residual <= allowed):
        k = int(run.touching[0, CANDIDATE])
        blame(run, UNSOLVED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        return False
    return True


@jit_separate
def largest_slack(run: Run) -> float:
    """The rounding bound of the residual of all links: of their rates, and of the changes by impulses.

    A ball below many others has an impulse that would give it alone many times the velocity of all.
    """
    slack = 0.0
    for a in range(run.counters[TOGETHER]):
        slack = max(slack, run.touching[a, SLACK], NOISE * abs(run.touching[a, IMPULSE]) * run.touching[a, OWN])
    return slack


@jit_separate
def impulse_residual(run: Run) -> float:
    """The residual: how far a link that acts is below its target, or above it though it has an impulse."""
    worst = 0.0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            above = gap_rate(run, a) + run.touching[a, TARGET_RATE]
            # min(w, x) vanishes only where both are non-negative and one of them is zero
            worst = max(worst, abs(min(above, run.touching[a, IMPULSE] * run.touching[a, OWN])))
            if run.counters[ROWS] == 2 and run.touching[a, RUBS] == 1.0:
                self_response, load = run.touching[a, SLIP_OWN], run.touching[a, IMPULSE] + run.touching[a, GIVES_BACK]
                friction_limit = run.touching[a, KINETIC] * load
                pull = run.touching[a, PULL]
                projected = min(max(-friction_limit, pull - slip_of(run, a) / self_response), friction_limit)
                worst = max(worst, abs(pull - projected) * self_response)
    return worst


@jit_separate
def solve_by_gradients(run: Run) -> bool:
    """Solve for impulses by projected gradients; whether they are finite. `impulse_residual` judges them."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    for a in range(count):
        acts, row = run.touching[a, ACTS] == 1.0, rows * a
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, row] = -(gap_rate(run, a) + run.touching[a, TARGET_RATE]) * run.vectors[SCALE, row]
        if rows == 2:
            pose_slip(run, a, acts, slip_of(run, a))
            run.vectors[GRIP, row + 1], run.vectors[RETURNED, row] = (
                run.touching[a, KINETIC],
                run.touching[a, GIVES_BACK],
            )
    left = solve_links(run, 0, count)
    for a in range(count):
        row = rows * a
        run.touching[a, IMPULSE] = run.vectors[X, row] * run.vectors[SCALE, row]
        apply_impulse(run, row, run.touching[a, IMPULSE])
        if rows == 2:
            run.touching[a, PULL] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1]
            apply_impulse(run, row + 1, run.touching[a, PULL])
    return left < inf


@jit_separate
def pose_slip(run: Run, a: int, acts: bool, slip: float) -> None:
    """Store the wanted change of a link's slip, or of its acceleration; zero without friction."""
    row, acts = 2 * a + 1, acts and run.touching[a, RUBS] == 1.0
    scale = 1.0 / sqrt(run.touching[a, SLIP_OWN]) if acts else 0.0
    run.vectors[SCALE, row], run.vectors[OWN_SCALE, row] = scale, scale
    run.vectors[RIGHT, row], run.vectors[GRIP, row], run.vectors[DRAG, row] = -slip * scale, 0.0, 0.0


@jit_separate
def solve_by_lemke(run: Run, n: int) -> bool:
    """Find the impulses by Lemke's method, scaled so that every link answers itself with one."""
    clear_tableau(run, n)
    i = 0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            j = 0
            for b in range(run.counters[TOGETHER]):
                if run.touching[b, ACTS] == 1.0:
                    run.problem[i, n + j] = -link_response(run, a, b) / run.touching[b, OWN]
                    j += 1
            run.problem[i, 2 * n + 1] = gap_rate(run, a) + run.touching[a, TARGET_RATE]
            i += 1
    if not solve_complementarity(run, n):
        return False
    i = 0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, IMPULSE] = run.solution[i] / run.touching[a, OWN]
            apply_impulse(run, a, run.touching[a, IMPULSE])
            i += 1
    return True


@jit_separate
def link_response(run: Run, a: int, b: int) -> float:
    """The effect of a unit of one link's impulse on the rate of another."""
    total = 0.0
    for i in range(run.normals.shape[1]):
        for j in range(run.unit_responses.shape[1]):
            if run.coordinate_indices[a, i] == run.coordinate_indices[b, j]:
                total += run.normals[a, i] * run.unit_responses[b, j]
    return total
