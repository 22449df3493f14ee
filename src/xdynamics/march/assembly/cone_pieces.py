"""What a link with friction may do, as pieces of one surface: it opens, holds, or slides one way or the other.

Impulse x and rate w of a link are together two numbers that may be given: of one that opens its rates, of one that holds its
impulses, of one that slides its normal impulse and its slip. Where a piece ends another begins. Each link gives way by a small
part of its impulses, w = W x - b + `GIVES` (x - y), so that impulses are one value of rates, also of links that hold more
than needs holding; y, from before, is what they are nearly.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.banded_factors import (
    add_product,
    change_factors,
    factor,
    pose_masses,
    solve_factors,
)
from xdynamics.march.assembly.closed_links import GRIP, PIECE, SCALE
from xdynamics.march.assembly.responses import clear, response_along
from xdynamics.march.run import Run

OPENS, HOLDS, SLIDES_FORTH, SLIDES_BACK = range(4)
GIVES = 1e-5  # of an impulse, over what it answers itself with: less of it leaves fewer digits of changed factors


@shared
def ratio_of(run: Run, row: int) -> float:
    """The most friction of a link over its normal impulse, both scaled; 0 where it has none."""
    along = run.vectors[SCALE, row + 1]
    return float(run.vectors[GRIP, row + 1] * run.vectors[SCALE, row] / along) if along > 0.0 else 0.0


@shared
def side_of(run: Run, row: int) -> float:
    """The sign of the slip of a link that slides, else 0."""
    piece = run.vectors[PIECE, row]
    return 1.0 if piece == SLIDES_FORTH else (-1.0 if piece == SLIDES_BACK else 0.0)


@shared
def pose_pieces(run: Run, first: int, rows: int, n: int) -> None:
    """Factor the matrix of coordinates with what all links do."""
    pose_masses(run, first, rows, n)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            scale, along = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
            drag = -side_of(run, row) * ratio_of(run, row) * along
            add_product(run, row, scale / GIVES, drag / GIVES, scale, 0.0)
            if run.vectors[PIECE, row] == HOLDS:
                add_product(run, row, 0.0, along / GIVES, 0.0, along)
    factor(run, n)


@shared
def take_up(run: Run, row: int, n: int, changes: int, piece: int) -> int:
    """Let a link go on to a piece next to its own; return how many products are beside the factors then."""
    scale, along = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
    before, holds = int(run.vectors[PIECE, row]), HOLDS in (int(run.vectors[PIECE, row]), piece)
    run.vectors[PIECE, row] = before if piece in (OPENS, HOLDS) else piece
    drag = side_of(run, row) * ratio_of(run, row)
    run.vectors[PIECE, row] = piece
    stiffness = (-1.0 if before == HOLDS or piece == OPENS else 1.0) / GIVES
    if holds:
        return int(change_factors(run, row, n, changes, 0.0, stiffness * along, drag * scale, along))
    return int(change_factors(run, row, n, changes, stiffness * scale, -stiffness * drag * along, scale, 0.0))


@shared
def follow_pieces(run: Run, first: int, rows: int, n: int, changes: int, given: int, force: int, rate: int) -> None:
    """Find impulses and rates of all links, in vectors, as their pieces are, of rates without impulses that are given."""
    clear(run, first, rows)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            load = -run.vectors[given, row] / GIVES
            drag = -side_of(run, row) * ratio_of(run, row) * load
            drag = -run.vectors[given, row + 1] / GIVES if run.vectors[PIECE, row] == HOLDS else drag
            load, drag = load * run.vectors[SCALE, row], drag * run.vectors[SCALE, row + 1]
            for i in range(run.reads.shape[1]):
                run.swing[run.reads[row, i]] += load * run.normals[row, i] + drag * run.normals[row + 1, i]
    solve_factors(run, n, changes)
    for row in range(first, first + rows, 2):
        opening = response_along(run, row) * run.vectors[SCALE, row] + run.vectors[given, row]
        slipping = response_along(run, row + 1) * run.vectors[SCALE, row + 1] + run.vectors[given, row + 1]
        if run.vectors[PIECE, row] == OPENS:
            run.vectors[force, row], run.vectors[force, row + 1] = 0.0, 0.0
            run.vectors[rate, row], run.vectors[rate, row + 1] = opening, slipping
        elif run.vectors[PIECE, row] == HOLDS:
            run.vectors[force, row], run.vectors[force, row + 1] = -opening / GIVES, -slipping / GIVES
            run.vectors[rate, row], run.vectors[rate, row + 1] = 0.0, 0.0
        else:
            drag = side_of(run, row) * ratio_of(run, row) * opening / GIVES
            run.vectors[force, row], run.vectors[force, row + 1] = -opening / GIVES, drag
            run.vectors[rate, row], run.vectors[rate, row + 1] = 0.0, slipping + GIVES * drag


@shared
def room_of(run: Run, row: int, end: int, force: int, rate: int) -> float:
    """How far a link is from one of two ends of its piece; positive within, and linear in impulses and rates."""
    piece, ratio = run.vectors[PIECE, row], ratio_of(run, row)
    if piece == OPENS:
        return float(run.vectors[rate, row])
    if piece == HOLDS:
        least, pull = ratio * run.vectors[force, row], run.vectors[force, row + 1]
        return float(least - pull if end == 0 else least + pull)
    return float(run.vectors[force, row] if end == 0 else side_of(run, row) * run.vectors[rate, row + 1])


@shared
def ends_of(run: Run, row: int) -> int:
    """How many ends the piece of a link has."""
    if run.vectors[SCALE, row] == 0.0:
        return 0
    return 1 if run.vectors[PIECE, row] == OPENS or ratio_of(run, row) == 0.0 else 2


@shared
def beyond(run: Run, row: int, end: int, slip: float) -> tuple[int, int]:
    """The piece beyond an end of a link's own, and which of its ends that is; by the slip where it opens."""
    piece = run.vectors[PIECE, row]
    if piece == OPENS:
        return (SLIDES_FORTH if slip >= 0.0 or ratio_of(run, row) == 0.0 else SLIDES_BACK), 0
    if piece == HOLDS:
        return (SLIDES_BACK if end == 0 else SLIDES_FORTH), 1
    if end == 0:
        return OPENS, 0
    return HOLDS, (0 if piece == SLIDES_BACK else 1)
