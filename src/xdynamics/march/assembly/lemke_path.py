"""Forces, or impulses, of many links with friction along the path of Lemke's method, piece by piece.

The method serves where improving one link after the other does not settle. Rates without impulses are given, and t
times others are added to these. As t falls links cross from piece to piece of their surfaces, and where one that slides
presses what it slides on, t rises for a while. Where all links open at first, and each gives way a little, the path
cannot end but at t = 0 (Cottle, Pang, Stone, The Linear Complementarity Problem, 1992, section 4.4; of friction
Stewart, Trinkle, Int. J. Numer. Methods Eng. 39, 1996, 2673). From impulses that are nearly right it is far shorter,
and may lead away, the less links give way the sooner: such paths are followed one after the other, with less each time.

What a link with friction may do are pieces of one surface: it opens, holds, or slides one way or the other. Impulse x
and rate w of a link are together two numbers that may be given: of one that opens its rates, of one that holds its
impulses, of one that slides its normal impulse and its slip. Where a piece ends another begins. Each link gives way by
a small part of its impulses, w = W x - b + g (x - y), so that impulses are one value of rates, also of links that
hold more than needs holding; the compliance g is `GIVES` at last, and y, from before, what they are nearly.

Friction along a known line is one complementarity problem (Stewart, Trinkle, Int. J. Numer. Methods Eng. 39, 1996,
2673): of each link its normal force; of one that grips also its friction either way, and a slip rate that is positive
only where that friction is at its bound. A link that slides drags in proportion to its normal force, which needs no
unknown.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.banded_factors import (
    AT_ZERO,
    BY_T,
    MOST_CHANGES,
    add_product,
    change_factors,
    change_solution,
    factor_band,
    keep_solution,
    pose_masses,
    recall_solution,
    solve_factors,
)
from xdynamics.march.assembly.closed_links import (
    AMISS,
    DRAG,
    FORCE,
    FORCE_SLOPE,
    FREE,
    GRIP,
    PIECE,
    RATE,
    RATE_SLOPE,
    RETURNED,
    RIGHT,
    SCALE,
    TOWARD,
    X,
    clear_responses,
    respond,
    response_along,
)
from xdynamics.march.assembly.normal_forces import apply_link_effects, largest_entry
from xdynamics.march.contacts.delassus import clear_tableau, solve_complementarity
from xdynamics.march.run import Run

OPENS, HOLDS, SLIDES_FORTH, SLIDES_BACK = range(4)
# compliance, a rate over an impulse: the least, as less of it leaves fewer digits of changed factors; where paths from near
# begin, as one with the least crosses far more often; and by which it falls after a path that ends, and grows after another
GIVES, GIVES_AT_FIRST, GIVES_LESS, GIVES_MORE = 1e-5, 1e-2, 4.0, 16.0


@jit_separate
def ratio_of(run: Run, row: int) -> float:
    """The most friction of a link over its normal impulse, both scaled; 0 where it has none."""
    slip_scale = run.vectors[SCALE, row + 1]
    return float(run.vectors[GRIP, row + 1] * run.vectors[SCALE, row] / slip_scale) if slip_scale > 0.0 else 0.0


@jit_separate
def slip_sign(run: Run, row: int) -> float:
    """The sign of the slip of a link that slides, else 0."""
    piece = run.vectors[PIECE, row]
    return 1.0 if piece == SLIDES_FORTH else (-1.0 if piece == SLIDES_BACK else 0.0)


@jit_separate
def pose_pieces(run: Run, first: int, rows: int, n: int, gives: float) -> None:
    """Factor the matrix of coordinates with the contributions of all links' pieces."""
    pose_masses(run, first, rows, n)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
            drag = -slip_sign(run, row) * ratio_of(run, row) * slip_scale
            add_product(run, row, scale / gives, drag / gives, scale, 0.0)
            if run.vectors[PIECE, row] == HOLDS:
                add_product(run, row, 0.0, slip_scale / gives, 0.0, slip_scale)
    factor_band(run, n)


@jit_separate
def take_up(run: Run, row: int, n: int, changes: int, piece: int, gives: float) -> int:
    """Move a link to a neighbouring piece, with the solutions; return the number of products beside the factors."""
    scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
    piece_before, holds = int(run.vectors[PIECE, row]), HOLDS in (int(run.vectors[PIECE, row]), piece)
    # of the two pieces the one that may slide, for `slip_sign`
    run.vectors[PIECE, row] = piece_before if piece in (OPENS, HOLDS) else piece
    drag = slip_sign(run, row) * ratio_of(run, row)
    run.vectors[PIECE, row] = piece
    stiffness = (-1.0 if piece_before == HOLDS or piece == OPENS else 1.0) / gives
    if holds:
        changes = change_factors(run, row, n, changes, 0.0, stiffness * slip_scale, drag * scale, slip_scale)
    else:
        changes = change_factors(run, row, n, changes, stiffness * scale, -stiffness * drag * slip_scale, scale, 0.0)
    if changes < MOST_CHANGES:
        normal_share, slip_share = (drag, 1.0) if holds else (1.0, 0.0)
        for solved, free_rates in ((AT_ZERO, FREE), (BY_T, TOWARD)):
            # a changed product a b^T takes away as much of the right side, times what b is along the free rates
            free = normal_share * run.vectors[free_rates, row] + slip_share * run.vectors[free_rates, row + 1]
            change_solution(run, n, changes - 1, solved, free)
    return int(changes)


@jit_separate
def solve_pieces(run: Run, first: int, rows: int, n: int, solved: int, gives: float) -> None:
    """Solve for changes of rates of coordinates, as links' pieces are: at t = 0, or by t."""
    free_rates = FREE if solved == AT_ZERO else TOWARD
    clear_responses(run, first, rows)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            load = -run.vectors[free_rates, row] / gives
            drag = -slip_sign(run, row) * ratio_of(run, row) * load
            drag = -run.vectors[free_rates, row + 1] / gives if run.vectors[PIECE, row] == HOLDS else drag
            load, drag = load * run.vectors[SCALE, row], drag * run.vectors[SCALE, row + 1]
            for i in range(run.coordinate_indices.shape[1]):
                run.swing[run.coordinate_indices[row, i]] += load * run.normals[row, i] + drag * run.normals[row + 1, i]
    solve_factors(run, n, 0)
    keep_solution(run, n, solved)


@jit_separate
def follow_pieces(run: Run, first: int, rows: int, n: int, solved: int, gives: float) -> None:
    """Find impulses and rates of all links from a solution."""
    free_rates, force, rate = (FREE, FORCE, RATE) if solved == AT_ZERO else (TOWARD, FORCE_SLOPE, RATE_SLOPE)
    recall_solution(run, n, solved)
    vectors = run.vectors  # as a name of its own: else each access would read anew where the array stands
    for row in range(first, first + rows, 2):
        opening = response_along(run, row) * vectors[SCALE, row] + vectors[free_rates, row]
        slipping = response_along(run, row + 1) * vectors[SCALE, row + 1] + vectors[free_rates, row + 1]
        if vectors[PIECE, row] == OPENS:
            vectors[force, row], vectors[force, row + 1] = 0.0, 0.0
            vectors[rate, row], vectors[rate, row + 1] = opening, slipping
        elif vectors[PIECE, row] == HOLDS:
            vectors[force, row], vectors[force, row + 1] = -opening / gives, -slipping / gives
            vectors[rate, row], vectors[rate, row + 1] = 0.0, 0.0
        else:
            drag = slip_sign(run, row) * ratio_of(run, row) * opening / gives
            vectors[force, row], vectors[force, row + 1] = -opening / gives, drag
            vectors[rate, row], vectors[rate, row + 1] = 0.0, slipping + gives * drag


@jit_separate
def room_to_piece_end(run: Run, row: int, end: int, force: int, rate: int) -> float:
    """How far a link is from one of two ends of its piece; positive within, and linear in impulses and rates."""
    piece, ratio = run.vectors[PIECE, row], ratio_of(run, row)
    if piece == OPENS:
        return float(run.vectors[rate, row])
    if piece == HOLDS:
        friction_limit, pull = ratio * run.vectors[force, row], run.vectors[force, row + 1]
        return float(friction_limit - pull if end == 0 else friction_limit + pull)
    return float(run.vectors[force, row] if end == 0 else slip_sign(run, row) * run.vectors[rate, row + 1])


@jit_separate
def count_piece_ends(run: Run, row: int) -> int:
    """How many ends the piece of a link has."""
    if run.vectors[SCALE, row] == 0.0:
        return 0
    return 1 if run.vectors[PIECE, row] == OPENS or ratio_of(run, row) == 0.0 else 2


@jit_separate
def piece_beyond_end(run: Run, row: int, end: int, slip: float) -> tuple[int, int]:
    """The piece beyond an end of a link's own, and which of its ends that is; by the slip where it opens."""
    piece = run.vectors[PIECE, row]
    if piece == OPENS:
        return (SLIDES_FORTH if slip >= 0.0 or ratio_of(run, row) == 0.0 else SLIDES_BACK), 0
    if piece == HOLDS:
        return (SLIDES_BACK if end == 0 else SLIDES_FORTH), 1
    if end == 0:
        return OPENS, 0
    return HOLDS, (0 if piece == SLIDES_BACK else 1)


MOST_UNKNOWNS = 512  # four of a link that grips; exchanges grow with their number, and each with its square


@jit_separate
def solve_by_pivots(run: Run, first: int, rows: int) -> bool:
    """Solve for forces and friction of all links at once; whether that ended with a solution."""
    links, grips = count_unknowns(run, first, rows)
    n = links + 3 * grips
    if not 0 < n <= run.problem.shape[0]:
        return False
    clear_tableau(run, n)
    pose_forces(run, first, rows, links, grips)
    pose_friction_bounds(run, first, rows, links, grips)
    if not solve_complementarity(run, n):
        return False
    take_forces(run, first, rows, links, grips)
    return True


@jit_separate
def count_unknowns(run: Run, first: int, rows: int) -> tuple[int, int]:
    """Count links that may press and those that grip; `AMISS` has the index of each among these."""
    links, grips = 0, 0
    for row in range(first, first + rows, 2):
        run.vectors[AMISS, row], run.vectors[AMISS, row + 1] = -1.0, -1.0
        if run.vectors[SCALE, row] > 0.0:
            run.vectors[AMISS, row] = links
            links += 1
        if run.vectors[SCALE, row + 1] > 0.0 and run.vectors[GRIP, row + 1] > 0.0:
            run.vectors[AMISS, row + 1] = grips
            grips += 1
    return links, grips


@jit_separate
def pose_forces(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Write the effect of a unit of each force along every link, and the rates without forces."""
    n, constant_column = links + 3 * grips, 2 * (links + 3 * grips) + 1
    clear_responses(run, first, rows)
    for row in range(first, first + rows, 2):
        add_drag(run, row, run.vectors[RETURNED, row])
    for row in range(first, first + rows):
        rate = response_along(run, row) * run.vectors[SCALE, row] - run.vectors[RIGHT, row]
        pose_entry(run, row, first, links, grips, constant_column, rate)
    for row in range(first, first + rows):
        unknown_index = int(run.vectors[AMISS, row])
        if unknown_index < 0:
            continue
        clear_responses(run, first, rows)
        respond(run, row, run.vectors[SCALE, row])
        presses = (row - first) % 2 == 0
        if presses:
            add_drag(run, row, run.vectors[SCALE, row])
        for effect_row in range(first, first + rows):
            effect = response_along(run, effect_row) * run.vectors[SCALE, effect_row]
            if presses:
                pose_entry(run, effect_row, first, links, grips, n + unknown_index, -effect)
            else:
                pose_entry(run, effect_row, first, links, grips, n + links + unknown_index, -effect)
                pose_entry(run, effect_row, first, links, grips, n + links + grips + unknown_index, effect)


@jit_separate
def add_drag(run: Run, row: int, load: float) -> None:
    """Add the drag of a sliding link that presses with a load."""
    if run.vectors[SCALE, row + 1] > 0.0:
        respond(run, row + 1, run.vectors[DRAG, row + 1] * load)


@jit_separate
def pose_entry(run: Run, row: int, first: int, links: int, grips: int, column: int, value: float) -> None:
    """Write an entry of the rows of a link: of its gap, or of both ways of its slip."""
    unknown_index = int(run.vectors[AMISS, row])
    if unknown_index < 0:
        return
    if (row - first) % 2 == 0:
        run.problem[unknown_index, column] = value
    else:
        run.problem[links + unknown_index, column], run.problem[links + grips + unknown_index, column] = value, -value


@jit_separate
def pose_friction_bounds(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Write the complementarity of grips: friction within the bound by pressure, or slip."""
    n = links + 3 * grips
    for row in range(first + 1, first + rows, 2):
        grip, press = int(run.vectors[AMISS, row]), int(run.vectors[AMISS, row - 1])
        if grip < 0:
            continue
        ratio, bound = run.vectors[GRIP, row] / run.vectors[SCALE, row], links + 2 * grips + grip
        for direction in range(2):
            unknown_index = links + direction * grips + grip
            run.problem[unknown_index, n + bound], run.problem[bound, n + unknown_index] = -1.0, 1.0
        if press >= 0:
            run.problem[bound, n + press] = -ratio * run.vectors[SCALE, row - 1]
        run.problem[bound, 2 * n + 1] = ratio * run.vectors[RETURNED, row - 1]


@jit_separate
def take_forces(run: Run, first: int, rows: int, links: int, grips: int) -> None:
    """Read the solution."""
    for row in range(first, first + rows, 2):
        press, grip = int(run.vectors[AMISS, row]), int(run.vectors[AMISS, row + 1])
        run.vectors[X, row] = run.solution[press] if press >= 0 else 0.0
        load = run.vectors[X, row] * run.vectors[SCALE, row] + run.vectors[RETURNED, row]
        if grip >= 0:
            run.vectors[X, row + 1] = run.solution[links + grip] - run.solution[links + grips + grip]
        elif run.vectors[SCALE, row + 1] > 0.0:
            run.vectors[X, row + 1] = run.vectors[DRAG, row + 1] * load / run.vectors[SCALE, row + 1]
        else:
            run.vectors[X, row + 1] = 0.0


# crossings at most, over the number of rows: from impulses that are there, beside some for any number, and from none
FROM_NEAR, ANY_FROM_NEAR, FROM_FAR = 0.02, 64, 4.0
ASTRAY = 100.0  # t at which a path from impulses that are there is given up
FLOOR = 1e-9  # of the largest rate: the least room of a link in its piece at the beginning
UNEVEN = 0.6180339887498949  # by which rooms differ, so that no two links cross at once


@jit_separate
def follow_from_near(run: Run, first: int, rows: int, n: int, gives: float, factored: bool) -> bool:
    """Solve for impulses from the present ones, about which links give way; whether that succeeds, else these stay.

    `factored` says that factors are those of the links' pieces as they are, with this compliance.
    """
    factored = begin_near(run, first, rows, gives) and factored
    max_crossings = ANY_FROM_NEAR + int(FROM_NEAR * rows)
    return take_end_of_path(run, first, rows, n, 1.0, max_crossings, ASTRAY, gives, factored)


@jit_separate
def follow_from_far(run: Run, first: int, rows: int, n: int) -> bool:
    """Find impulses from none; whether that was done, else those stay that are there."""
    start = begin_far(run, first, rows)
    return take_end_of_path(run, first, rows, n, start, int(FROM_FAR * rows), inf, GIVES, False)


@jit_separate
def take_end_of_path(
    run: Run, first: int, rows: int, n: int, t: float, max_crossings: int, astray: float, gives: float, factored: bool
) -> bool:
    """Set the impulses at the end of a path; whether the path has an end."""
    if not follow_crossings(run, first, rows, n, t, max_crossings, astray, gives, factored):
        return False
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[FORCE, row]
    return True


@jit_separate
def begin_far(run: Run, first: int, rows: int) -> float:
    """Open all links, by slightly different rates; return the t from which on they are open."""
    start, share = 0.0, 0.0
    for row in range(first, first + rows, 2):
        share += UNEVEN - (1.0 if share + UNEVEN >= 1.0 else 0.0)
        run.vectors[PIECE, row] = OPENS
        for row_index in range(row, row + 2):
            run.vectors[FREE, row_index], run.vectors[TOWARD, row_index] = -run.vectors[RIGHT, row_index], 0.0
        run.vectors[TOWARD, row] = 1.0 + share / 2.0
        start = max(start, -run.vectors[FREE, row] / run.vectors[TOWARD, row])
    return 1.1 * start


@jit_separate
def begin_near(run: Run, first: int, rows: int, gives: float) -> bool:
    """Set each link to the piece that a step of its impulses against its rates gives; whether it was there before."""
    apply_link_effects(run, X, RATE, first, rows)
    for row in range(first, first + rows):
        run.vectors[RATE, row] -= run.vectors[RIGHT, row]
        run.vectors[FREE, row] = -run.vectors[RIGHT, row] - gives * run.vectors[X, row]
        run.vectors[FORCE, row] = run.vectors[X, row]
    smallest_room, share, as_before = FLOOR * largest_entry(run, RIGHT, first, rows), 0.0, True
    for row in range(first, first + rows, 2):
        piece_before = run.vectors[PIECE, row]
        share += UNEVEN - (1.0 if share + UNEVEN >= 1.0 else 0.0)
        place_within(run, row, smallest_room * (1.0 + share))
        as_before = as_before and run.vectors[PIECE, row] == piece_before
    apply_link_effects(run, FORCE, TOWARD, first, rows)
    for row in range(first, first + rows):
        rate = run.vectors[TOWARD, row] + run.vectors[FREE, row] + gives * run.vectors[FORCE, row]
        run.vectors[TOWARD, row] = run.vectors[RATE, row] - rate if run.vectors[SCALE, row] > 0.0 else 0.0
    return as_before


@jit_separate
def place_within(run: Run, row: int, room: float) -> None:
    """Choose the piece of a link, and change its impulses and rates as little as that needs, but for some room."""
    ratio, press, pull = ratio_of(run, row), run.vectors[X, row], run.vectors[X, row + 1]
    load, drag = press - run.vectors[RATE, row], pull - run.vectors[RATE, row + 1]
    run.vectors[PIECE, row] = OPENS
    if run.vectors[SCALE, row] == 0.0 or load <= 0.0:
        run.vectors[FORCE, row], run.vectors[FORCE, row + 1] = 0.0, 0.0
        run.vectors[RATE, row] = max(run.vectors[RATE, row], room)
        return
    press = max(press, room)
    run.vectors[FORCE, row], run.vectors[RATE, row] = press, 0.0
    if abs(drag) < ratio * load:
        friction_limit = ratio * press * (1.0 - FLOOR)
        run.vectors[PIECE, row] = HOLDS
        run.vectors[FORCE, row + 1], run.vectors[RATE, row + 1] = min(max(-friction_limit, pull), friction_limit), 0.0
    else:
        run.vectors[PIECE, row] = SLIDES_BACK if drag > 0.0 and ratio > 0.0 else SLIDES_FORTH
        side = slip_sign(run, row)
        run.vectors[FORCE, row + 1] = -side * ratio * press
        if ratio > 0.0:
            run.vectors[RATE, row + 1] = side * max(side * run.vectors[RATE, row + 1], room)


@jit_separate
def follow_crossings(
    run: Run, first: int, rows: int, n: int, t: float, max_crossings: int, astray: float, gives: float, factored: bool
) -> bool:
    """Follow the path from a t on to zero; whether it leads there. `FORCE` has its impulses."""
    # changes begin as if used up, so that the first turn solves
    t_direction, changes, crossed_row, crossed_end = -1.0, MOST_CHANGES, -1, 0
    for _ in range(max_crossings):
        if changes >= MOST_CHANGES:
            changes = 0
            if not factored:
                pose_pieces(run, first, rows, n, gives)
            factored = False
            solve_pieces(run, first, rows, n, AT_ZERO, gives)
            solve_pieces(run, first, rows, n, BY_T, gives)
        follow_pieces(run, first, rows, n, AT_ZERO, gives)
        follow_pieces(run, first, rows, n, BY_T, gives)
        if crossed_row >= 0:  # on, away from the end that was crossed
            t_direction = (
                1.0 if room_to_piece_end(run, crossed_row, crossed_end, FORCE_SLOPE, RATE_SLOPE) > 0.0 else -1.0
            )
        row, end, length = next_crossing(run, first, rows, t, t_direction, crossed_row, crossed_end)
        if t_direction < 0.0 and length >= t and changes == 0:
            return True
        if t_direction < 0.0 and length >= t:  # of factors as they are, which have more digits
            changes = MOST_CHANGES
            continue
        if not length < inf or t > astray:
            return False
        t += t_direction * length
        slip = run.vectors[RATE, row + 1] + t * run.vectors[RATE_SLOPE, row + 1]
        piece, crossed_end = piece_beyond_end(run, row, end, slip)
        crossed_row, changes = row, take_up(run, row, n, changes, piece, gives)
    return False


@jit_separate
def next_crossing(
    run: Run, first: int, rows: int, t: float, t_direction: float, crossed_row: int, crossed_end: int
) -> tuple[int, int, float]:
    """The link that comes to an end of its piece first, on one way of t, which end, and how far that is."""
    nearest_row, nearest_end, shortest = -1, 0, inf
    for row in range(first, first + rows, 2):
        for end in range(count_piece_ends(run, row)):
            slope = room_to_piece_end(run, row, end, FORCE_SLOPE, RATE_SLOPE)
            if slope * t_direction < 0.0 and not (row == crossed_row and end == crossed_end):
                # rounding may have put a link slightly beyond its end
                length = max(0.0, (-room_to_piece_end(run, row, end, FORCE, RATE) / slope - t) * t_direction)
                if length < shortest:
                    nearest_row, nearest_end, shortest = row, end, length
    return nearest_row, nearest_end, shortest
