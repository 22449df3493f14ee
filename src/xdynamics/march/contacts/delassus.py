"""The problem of contacts and friction elements at a state: their common forces or impulses, by complementarity.

Each reaction has a part in a problem: it presses (is non-negative, and its contact does not approach), it grips (is
within its bound, and does not slip), it slides, or its value is known. The same problem is posed in rates for impulses,
and in accelerations for forces (Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008,
chapter 10).

The linear complementarity problem is w = M z + q with w and z non-negative and, one by one, not both positive. It is
solved by Lemke's method, with ties broken lexicographically so that it cannot circle (Cottle, Pang, Stone, The Linear
Complementarity Problem, 1992, section 4.4). It finds a solution where M is copositive-plus and there is one, as in
impacts and contacts with Coulomb's friction; where it ends on a ray, it has found none.

Gaps of contacts and their rates come with the uncertainty that rounding leaves in both.

Closed contacts and sticking friction hold a state: the drift of a step is taken back. The state is projected along the
directions in which the reactions act, positions first, then velocities (Hairer, Lubich, Wanner, Geometric Numerical
Integration, 2006, section VII.1.4): no energy is gained, and no drift grows.
"""

from __future__ import annotations

from math import frexp, inf, ldexp, nan

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import TOUCHING
from xdynamics.kernels.linear import solve_linear
from xdynamics.kernels.program import UNSOUND, T
from xdynamics.march.calls import call_law
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.force_evaluation import evaluate_held, finite_state, nan_maximum
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.model.reactions import MODES, NORMAL, TANGENT
from xdynamics.schema import SETTLING

SMALL = 1e-12  # relative to the numbers compared: as good as zero
# of what reactions answer to themselves, by which they give way where their forces are not unique; and for how many turns
COMPLIANCE, TURNS = 2.0**-16, 3
MOST_TURNS = 50  # exchanges for each unknown


@jit_separate
def clear_tableau(run: Run, n: int) -> None:
    """Clear the tableau of a problem of size n: columns n and on, of z, of the artificial unknown, and q.

    Unknowns are numbered: w from 0, z from n, then the artificial one. Only those that are not in the basis have a column,
    at first their own; what leaves the basis takes that of what enters. Behind the basis stands where each of them is: in
    a column, or in the basis, -1.
    """
    for i in range(n):
        run.basis[i] = i
        for j in range(n, 2 * n + 2):
            run.problem[i, j] = 0.0
        run.problem[i, 2 * n] = -1.0
    for unknown in range(2 * n + 1):
        run.basis[n + unknown] = unknown if unknown >= n else -1


@jit_separate
def solve_complementarity(run: Run, n: int) -> bool:
    """Solve the problem of size n that is in `problem` as w - M z - z0 = q; fill `solution` with z.

    Returns
    -------
    bool
        False where the method ends on a ray, or takes too long.
    """
    for i in range(n):
        run.solution[i] = 0.0
    worst = 0
    for i in range(n):
        worst = i if run.problem[i, 2 * n + 1] < run.problem[worst, 2 * n + 1] else worst
    if n == 0 or run.problem[worst, 2 * n + 1] >= 0.0:
        return True
    # entering where q is most negative, the artificial unknown leaves no entry of q below zero
    entering = 2 * n
    row = worst
    for _ in range(MOST_TURNS * n):
        leaving = run.basis[row]
        exchange(run, n, row, entering)
        if leaving == 2 * n:
            take_solution(run, n)
            return True
        # the complement of what left enters: of every pair but one an unknown stays zero
        entering = leaving + n if leaving < n else leaving - n
        row = least_ratio(run, n, entering)
        if row < 0:
            return False
    return False


@jit_separate
def exchange(run: Run, n: int, row: int, entering: int) -> None:
    """Solve a row for an unknown, and substitute it into the others."""
    column, leaving = run.basis[n + entering], run.basis[row]
    run.basis[row], run.basis[n + entering], run.basis[n + leaving] = entering, -1, column
    pivot = run.problem[row, column]
    run.problem[row, column] = 1.0
    for j in range(n, 2 * n + 2):
        run.problem[row, j] /= pivot
    for i in range(n):
        factor = run.problem[i, column]
        if i != row:
            run.problem[i, column] = 0.0
        if i != row and factor != 0.0:
            for j in range(n, 2 * n + 2):
                run.problem[i, j] -= factor * run.problem[row, j]


@jit_separate
def entry_of(run: Run, n: int, row: int, unknown: int) -> float:
    """An entry of the tableau, of unknowns in the basis, too."""
    column = run.basis[n + unknown]
    if column >= 0:
        return float(run.problem[row, column])
    return 1.0 if run.basis[row] == unknown else 0.0


@jit_separate
def least_ratio(run: Run, n: int, entering: int) -> int:
    """Choose the row that limits a growing unknown: that of the artificial one if possible, -1 if none does."""
    largest, best, column = 0.0, -1, run.basis[n + entering]
    for i in range(n):
        largest = max(largest, abs(run.problem[i, column]))
    for i in range(n):
        if run.problem[i, column] > SMALL * largest and (best < 0 or limits_before(run, n, i, best, column)):
            best = i
    return best


@jit_separate
def limits_before(run: Run, n: int, first_row: int, second_row: int, column: int) -> bool:
    """Whether one row limits the unknown that enters, of a column, earlier than another."""
    pivot, second_pivot, q = run.problem[first_row, column], run.problem[second_row, column], 2 * n + 1
    for k in range(n + 1):
        left = (run.problem[first_row, q] if k == 0 else entry_of(run, n, first_row, k - 1)) / pivot
        right = (run.problem[second_row, q] if k == 0 else entry_of(run, n, second_row, k - 1)) / second_pivot
        if abs(left - right) > SMALL * max(abs(left), abs(right)):
            return bool(left < right)
        if k == 0 and (run.basis[first_row] == 2 * n or run.basis[second_row] == 2 * n):
            return bool(run.basis[first_row] == 2 * n)
    return False


@jit_separate
def take_solution(run: Run, n: int) -> None:
    """Read the unknowns z that are in the basis."""
    for i in range(n):
        if n <= run.basis[i] < 2 * n:
            # rounding may have put it a little below zero
            run.solution[run.basis[i] - n] = max(0.0, run.problem[i, 2 * n + 1])


ABSENT, PRESSING, SLIDING, GRIPPING, KNOWN = range(5)
SUM_NOISE = 64.0 * EPS  # of a sum's terms: what rounding may leave


@jit_separate
def look_at_links(run: Run, t: float) -> None:
    """Compute gaps, rates, coefficients and matrices at the trial's state."""
    run.at[T] = t
    call_law(run.law[TOUCHING], run, run.z, run.contact_tables, 0)


@jit_separate
def solve_reactions(run: Run) -> bool:
    """Find the forces or impulses from the part of each reaction; whether they exist."""
    n = place_unknowns(run)
    clear_tableau(run, n)
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            pose_pressing(run, k, n)
        elif run.touches[k].part == GRIPPING:
            pose_gripping(run, k, n)
    if not solve_complementarity(run, n):
        return False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        total = 0.0
        for j in range(n):
            total += run.effects[k, j] * run.solution[j]
        touch.found = touch.scale * total + touch.known
    for k in range(run.touches.shape[0]):
        run.touches[k].after = run.touches[k].origin + reaction_effect(run, k)
    return True


@jit_separate
def solve_compliantly(run: Run, turns: int) -> bool:
    """Find the forces or impulses of reactions that give way by `COMPLIANCE`, and then less and less; whether they exist.

    They exist where others are not unique, and are nearest those of the last turn: each turn, reactions give way from
    where these were (the proximal point method; Rockafellar, SIAM J. Control Optim. 14, 1976, 877).
    """
    m, solved = run.touches.shape[0], True
    for k in range(m):
        run.column[k], run.square[k] = run.delassus[k, k], run.touches[k].origin
        run.delassus[k, k] *= 1.0 + COMPLIANCE
    for _ in range(turns):
        solved = solved and solve_reactions(run)
        for k in range(m):
            run.touches[k].origin = run.square[k] - COMPLIANCE * run.column[k] * run.touches[k].found
    for k in range(m):
        touch, role = run.touches[k], run.reactions[k].role
        run.delassus[k, k], touch.origin = run.column[k], run.square[k]
        if role == TANGENT and touch.part == GRIPPING:
            # what rounding over the compliance leaves beyond the bound
            bound = touch.coefficient * run.touches[run.reactions[k].normal].found
            touch.found = min(max(touch.found, -bound), bound)
    return solved


@jit_separate
def reaction_effect(run: Run, k: int) -> float:
    """The effect of all solved reactions on the rate, or acceleration, of one."""
    total = 0.0
    for j in range(run.touches.shape[0]):
        total += run.delassus[k, j] * run.touches[j].found
    return total


@jit_separate
def add_impulses(run: Run) -> bool:
    """Add the solved impulses to those of the complete impact, and change the rates by them."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        rate_before = touch.rate
        touch.rate += reaction_effect(run, j)
        touch.total += touch.found
        touch.lost -= touch.found * (rate_before + touch.rate) / 2.0  # as seen from the body that is struck
    return True


@jit_separate
def place_unknowns(run: Run) -> int:
    """Number the unknowns, and store their unit effects on the reactions; return their number."""
    n, m = 0, run.touches.shape[0]
    for k in range(m):
        touch = run.touches[k]
        # a power of two, by which scaling is exact
        # scaled twice, a diagonal entry is from 1/2 up to 2, whatever the units of gaps and masses
        touch.scale = ldexp(1.0, -(frexp(run.delassus[k, k])[1] // 2))
        touch.place = n
        n += 1 if touch.part == PRESSING else (3 if touch.part == GRIPPING else 0)
    for k in range(m):
        for j in range(n):
            run.effects[k, j] = 0.0
    for k in range(m):
        touch = run.touches[k]
        if touch.part == PRESSING:
            run.effects[k, touch.place] = 1.0
        elif touch.part == GRIPPING:
            # friction is the difference of two non-negative unknowns; a third is how much the grip slips
            run.effects[k, touch.place], run.effects[k, touch.place + 1] = 1.0, -1.0
        elif touch.part == SLIDING:
            normal = run.touches[run.reactions[k].normal]
            run.effects[k, normal.place] = -touch.way * touch.coefficient * normal.scale / touch.scale
    return n


@jit_separate
def pose_pressing(run: Run, k: int, n: int) -> None:
    """Write the row of a contact that presses: it does not approach."""
    unknown_index = run.touches[k].place
    for j in range(n):
        run.problem[unknown_index, n + j] = -unknown_response(run, k, j)
    run.problem[unknown_index, 2 * n + 1] = free_rate(run, k)


@jit_separate
def pose_gripping(run: Run, k: int, n: int) -> None:
    """Write the rows of a grip: there is no slip, or the grip is at its bound, against the slip."""
    touch = run.touches[k]
    unknown_index, slip = touch.place, touch.place + 2
    bound = touch.bound
    for j in range(n):
        value = unknown_response(run, k, j)
        run.problem[unknown_index, n + j], run.problem[unknown_index + 1, n + j] = -value, value
    for i in (unknown_index, unknown_index + 1):
        run.problem[i, n + slip] = -1.0
        run.problem[slip, n + i] = 1.0
    if run.reactions[k].role == TANGENT:
        normal = run.touches[run.reactions[k].normal]
        run.problem[slip, n + normal.place] = -touch.coefficient * normal.scale / touch.scale
        bound += touch.coefficient * normal.known
    run.problem[unknown_index, 2 * n + 1] = free_rate(run, k)
    run.problem[unknown_index + 1, 2 * n + 1] = -free_rate(run, k)
    run.problem[slip, 2 * n + 1] = bound / touch.scale


@jit_separate
def unknown_response(run: Run, k: int, j: int) -> float:
    """The effect of a unit of unknown j on the rate, or acceleration, of a reaction, both scaled."""
    total = 0.0
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * (run.touches[i].scale * run.effects[i, j])
    return run.touches[k].scale * total


@jit_separate
def free_rate(run: Run, k: int) -> float:
    """The rate, or acceleration, of a reaction without the unknowns, scaled."""
    total = run.touches[k].origin
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * run.touches[i].known
    return run.touches[k].scale * total


@jit_separate
def slips(run: Run, k: int) -> bool:
    """Whether a grip slips, by the solution of the problem."""
    touch = run.touches[k]
    return run.solution[touch.place + 2] > SMALL * touch.scale * size_of_terms(run, k)


@jit_separate
def size_of_terms(run: Run, k: int) -> float:
    """The size of the terms of a reaction's rate, or acceleration, with all solved reactions."""
    size = abs(run.touches[k].origin)
    for j in range(run.touches.shape[0]):
        size += abs(run.delassus[k, j] * run.touches[j].found)
    return size


BLUR = 16.0 * EPS  # of the numbers whose difference a gap is, or of t: less is not resolved


@jit_separate
def collect_detectors(run: Run) -> None:
    """Store the detector that has located an event of each reaction."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touch.hit, touch.total = NONE, 0.0
        if touch.state != SETTLING:
            touch.lost, touch.doubt = 0.0, 0.0
    for i in range(run.detectors.shape[0]):
        detector = run.detectors[i]
        if detector.reaction >= 0 and run.watches[i].hit != NONE:
            run.touches[detector.reaction].hit = detector.role


@jit_separate
def gap_width(run: Run, k: int) -> float:
    """How wide a gap may be by rounding alone, or by its rate and acceleration within the time tolerance.

    Of a gap that was never open nothing else is known: what holds it closed leaves rounding of any size.
    """
    time = run.reactions[k].tolerance
    return max(SUM_NOISE * size_of_gap(run, k), (abs(run.links[k].rate) + abs(run.links[k].free) * time) * time)


@jit_separate
def impact_spread(run: Run, k: int) -> float:
    """How far from zero impacts may have left a gap: each is located within the time tolerance, or the spacing of t.

    Bodies that stay together after an impact are apart, or overlap, by as much: that is neither flight nor penetration.
    """
    return run.swiftest[k] * location_time(run, k)


@jit_separate
def location_time(run: Run, k: int) -> float:
    """The time within which an event of a contact or friction is located: its tolerance, or the spacing of t."""
    return max(run.reactions[k].tolerance, BLUR * abs(run.at[T]))


@jit_separate
def size_of_gap(run: Run, k: int) -> float:
    """The size of the numbers whose difference a gap is."""
    size, n = abs(run.links[k].gap), run.plan[0].coordinates
    rate_by_time = run.links[k].rate  # by time alone
    for i in range(n):
        size += abs(run.directions[k, i] * run.z[i])
        rate_by_time -= run.directions[k, i] * run.z[n + i]
    return max(size + abs(rate_by_time * run.at[T]), run.touches[k].largest)


@jit_separate
def find_touching(run: Run) -> None:
    """Find which contacts touch, and how uncertain rates are."""
    n = run.plan[0].coordinates
    for k in range(run.touches.shape[0]):
        touch, size = run.touches[k], abs(run.links[k].rate)
        for i in range(n):
            size += abs(run.directions[k, i] * run.z[n + i])
        touch.fastest = max(touch.fastest, abs(run.links[k].rate))
        touch.steepest = max(touch.steepest, run.delassus[k, k])
        run.swiftest[k] = max(run.swiftest[k], size)
        size = max(touch.fastest, run.swiftest[k])
        touch.slack = max(SUM_NOISE * size, (abs(run.links[k].free) + brake(run, k)) * run.reactions[k].tolerance)
        touch.near = 0
        if run.reactions[k].role == NORMAL:
            still = abs(run.links[k].rate) <= touch.slack
            reach = max(gap_width(run, k), impact_spread(run, k)) if still else gap_width(run, k)
            touch.near = int(touch.hit == GAP or run.links[k].gap <= reach)


@jit_separate
def brake(run: Run, k: int) -> float:
    """The deceleration of a slip by friction at its limit."""
    if run.reactions[k].role == NORMAL:
        return 0.0
    force, normal = run.links[k].coefficient, run.reactions[k].normal
    if run.reactions[k].role == TANGENT:
        force *= abs(run.links[normal].free) / run.delassus[normal, normal]
    return force * run.delassus[k, k]


@jit_separate
def approaching(run: Run) -> bool:
    """Whether a contact that touches approaches."""
    approaches = False
    for k in range(run.touches.shape[0]):
        approaches = approaches or (run.touches[k].near == 1 and run.links[k].rate < -run.touches[k].slack)
    return approaches


@jit_separate
def had_impact(run: Run) -> bool:
    """Whether there was an impact."""
    impact = False
    for k in range(run.touches.shape[0]):
        impact = impact or run.touches[k].total != 0.0
    return impact


MOST_NEWTON_STEPS = 10  # Newton steps to a gap of zero


@jit_separate
def hold_closed_contacts(run: Run, t: float, settling: bool) -> None:
    """Project the trial's state onto closed contacts and grips, if any, and evaluate the forces there."""
    run.at[UNSOUND] = 0.0
    if list_holding(run, settling) == 0 or not finite_state(run):
        return
    projection_before = run.z[run.plan[0].moved]
    is_held = hold_positions(run, t, settling) and hold_rates(run, t, settling)
    evaluate_held(run, t, run.z, 0.0)
    if run.plan[0].held > 0:  # how far constraints moved the result of the step; nan if they failed, then or now
        run.z[run.plan[0].moved] = nan_maximum(run.z[run.plan[0].moved], projection_before)
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
    """Move positions, or velocities from index `first` on, along reactions by the gap changes in `column`."""
    for i in range(count):
        for j in range(count):
            run.square[i * count + j] = run.delassus[run.chosen[i], run.chosen[j]]
    if not solve_linear(run.square, run.column, count):
        return False
    for i in range(count):
        for k in range(run.plan[0].coordinates):
            run.z[first + k] += run.responses[run.chosen[i], k] * run.column[i]
    return True
