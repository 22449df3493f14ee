"""Impulses of many links with friction along the path of Lemke's method, piece by piece.

Rates without impulses are given, and t times others are added to these. As t falls links cross from piece to piece of
`cone_pieces`, and where one that slides presses what it slides on, t rises for a while. Where all links open at first, and
each gives way a little, the path cannot end but at t = 0 (Cottle, Pang, Stone, The Linear Complementarity Problem, 1992,
section 4.4; of friction Stewart, Trinkle, Int. J. Numer. Methods Eng. 39, 1996, 2673). From impulses that are nearly right
it is far shorter, and may lead away; then it is begun anew.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.banded_factors import MOST_CHANGES
from xdynamics.march.assembly.closed_links import (
    FORCE,
    FORCE_SLOPE,
    FREE,
    PIECE,
    RATE,
    RATE_SLOPE,
    RIGHT,
    SCALE,
    TOWARD,
    TRIED,
    X,
)
from xdynamics.march.assembly.cone_pieces import (
    GIVES,
    HOLDS,
    OPENS,
    SLIDES_BACK,
    SLIDES_FORTH,
    count_piece_ends,
    follow_pieces,
    piece_beyond_end,
    pose_pieces,
    ratio_of,
    room_to_piece_end,
    slip_sign,
    take_up,
)
from xdynamics.march.assembly.normal_forces import apply_link_effects, largest_entry
from xdynamics.march.run import Run

# crossings at most, over the number of rows: from impulses that are there, and from none
FROM_NEAR, FROM_FAR = 0.25, 16.0
ASTRAY = 100.0  # t at which a path from impulses that are there is given up
FLOOR = 1e-9  # of the largest rate: the least room of a link in its piece at the beginning
UNEVEN = 0.6180339887498949  # by which rooms differ, so that no two links cross at once


@jit_separate
def follow_from_near(run: Run, first: int, rows: int, n: int) -> bool:
    """Find impulses from those that are there; whether that was done, else these stay."""
    begin_near(run, first, rows)
    return take_end_of_path(run, first, rows, n, 1.0, int(FROM_NEAR * rows), ASTRAY)


@jit_separate
def follow_from_far(run: Run, first: int, rows: int, n: int) -> bool:
    """Find impulses from none; whether that was done, else those stay that are there."""
    start = begin_far(run, first, rows)
    return take_end_of_path(run, first, rows, n, start, int(FROM_FAR * rows), inf)


@jit_separate
def come_nearer(run: Run, first: int, rows: int, n: int) -> bool:
    """Find impulses anew that are nearly those that were found, by which links give way less; whether that was done."""
    for row in range(first, first + rows):
        run.vectors[TRIED, row] = run.vectors[X, row]
        free_before = run.vectors[FREE, row]
        run.vectors[FREE, row] = -run.vectors[RIGHT, row] - GIVES * run.vectors[X, row]
        run.vectors[TOWARD, row] = free_before - run.vectors[FREE, row]
    return take_end_of_path(run, first, rows, n, 1.0, rows, ASTRAY)


@jit_separate
def take_end_of_path(run: Run, first: int, rows: int, n: int, t: float, max_crossings: int, astray: float) -> bool:
    """Take the impulses to which a path leads; whether it leads to any."""
    if not follow_crossings(run, first, rows, n, t, max_crossings, astray):
        return False
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[FORCE, row]
    return True


@jit_separate
def begin_far(run: Run, first: int, rows: int) -> float:
    """Let all links open, by rates that differ a little; return the t from which on they do."""
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
def begin_near(run: Run, first: int, rows: int) -> None:
    """Let each link do what a step of its impulses against its rates asks, and give it the rates by which it does."""
    apply_link_effects(run, X, RATE, first, rows)
    for row in range(first, first + rows):
        run.vectors[RATE, row] -= run.vectors[RIGHT, row]
        run.vectors[FREE, row], run.vectors[FORCE, row] = -run.vectors[RIGHT, row], run.vectors[X, row]
    smallest_room, share = FLOOR * largest_entry(run, RIGHT, first, rows), 0.0
    for row in range(first, first + rows, 2):
        share += UNEVEN - (1.0 if share + UNEVEN >= 1.0 else 0.0)
        place_within(run, row, smallest_room * (1.0 + share))
    apply_link_effects(run, FORCE, TOWARD, first, rows)
    for row in range(first, first + rows):
        toward = run.vectors[TOWARD, row] - run.vectors[RIGHT, row] + GIVES * run.vectors[FORCE, row]
        run.vectors[TOWARD, row] = run.vectors[RATE, row] - toward if run.vectors[SCALE, row] > 0.0 else 0.0


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
def follow_crossings(run: Run, first: int, rows: int, n: int, t: float, max_crossings: int, astray: float) -> bool:
    """Follow the path from a t on to zero; whether it leads there. `FORCE` has its impulses."""
    t_direction, changes, crossed_row, crossed_end = -1.0, MOST_CHANGES, -1, 0
    for _ in range(max_crossings):
        if changes >= MOST_CHANGES:
            pose_pieces(run, first, rows, n)
            changes = 0
        follow_pieces(run, first, rows, n, changes, FREE, FORCE, RATE)
        follow_pieces(run, first, rows, n, changes, TOWARD, FORCE_SLOPE, RATE_SLOPE)
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
        crossed_row, changes = row, take_up(run, row, n, changes, piece)
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
                length = max(0.0, (-room_to_piece_end(run, row, end, FORCE, RATE) / slope - t) * t_direction)
                if length < shortest:
                    nearest_row, nearest_end, shortest = row, end, length
    return nearest_row, nearest_end, shortest
