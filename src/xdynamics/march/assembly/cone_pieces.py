"""What a link with friction may do, as pieces of one surface: it opens, holds, or slides one way or the other.

Impulse x and rate w of a link are together two numbers that may be given: of one that opens its rates, of one that holds its
impulses, of one that slides its normal impulse and its slip. Where a piece ends another begins. Each link gives way by a small
part of its impulses, w = W x - b + `GIVES` (x - y), so that impulses are one value of rates, also of links that hold more
than needs holding; y, from before, is what they are nearly.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.banded_factors import add_product, change_factors, factor_band, pose_masses, solve_factors
from xdynamics.march.assembly.closed_links import GRIP, PIECE, SCALE
from xdynamics.march.assembly.responses import clear_responses, response_along
from xdynamics.march.run import Run

OPENS, HOLDS, SLIDES_FORTH, SLIDES_BACK = range(4)
GIVES = 1e-5  # of an impulse, over what it answers itself with: less of it leaves fewer digits of changed factors


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
def pose_pieces(run: Run, first: int, rows: int, n: int) -> None:
    """Factor the matrix of coordinates with what all links do."""
    pose_masses(run, first, rows, n)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
            drag = -slip_sign(run, row) * ratio_of(run, row) * slip_scale
            add_product(run, row, scale / GIVES, drag / GIVES, scale, 0.0)
            if run.vectors[PIECE, row] == HOLDS:
                add_product(run, row, 0.0, slip_scale / GIVES, 0.0, slip_scale)
    factor_band(run, n)


@jit_separate
def take_up(run: Run, row: int, n: int, changes: int, piece: int) -> int:
    """Let a link go on to a piece next to its own; return how many products are beside the factors then."""
    scale, slip_scale = run.vectors[SCALE, row], run.vectors[SCALE, row + 1]
    piece_before, holds = int(run.vectors[PIECE, row]), HOLDS in (int(run.vectors[PIECE, row]), piece)
    run.vectors[PIECE, row] = piece_before if piece in (OPENS, HOLDS) else piece
    drag = slip_sign(run, row) * ratio_of(run, row)
    run.vectors[PIECE, row] = piece
    stiffness = (-1.0 if piece_before == HOLDS or piece == OPENS else 1.0) / GIVES
    if holds:
        return int(change_factors(run, row, n, changes, 0.0, stiffness * slip_scale, drag * scale, slip_scale))
    return int(change_factors(run, row, n, changes, stiffness * scale, -stiffness * drag * slip_scale, scale, 0.0))


@jit_separate
def follow_pieces(
    run: Run, first: int, rows: int, n: int, changes: int, free_rates: int, force: int, rate: int
) -> None:
    """Find impulses and rates of all links, in vectors, as their pieces are, of rates without impulses that are given."""
    clear_responses(run, first, rows)
    for row in range(first, first + rows, 2):
        if run.vectors[PIECE, row] != OPENS:
            load = -run.vectors[free_rates, row] / GIVES
            drag = -slip_sign(run, row) * ratio_of(run, row) * load
            drag = -run.vectors[free_rates, row + 1] / GIVES if run.vectors[PIECE, row] == HOLDS else drag
            load, drag = load * run.vectors[SCALE, row], drag * run.vectors[SCALE, row + 1]
            for i in range(run.coordinate_indices.shape[1]):
                run.swing[run.coordinate_indices[row, i]] += load * run.normals[row, i] + drag * run.normals[row + 1, i]
    solve_factors(run, n, changes)
    for row in range(first, first + rows, 2):
        opening = response_along(run, row) * run.vectors[SCALE, row] + run.vectors[free_rates, row]
        slipping = response_along(run, row + 1) * run.vectors[SCALE, row + 1] + run.vectors[free_rates, row + 1]
        if run.vectors[PIECE, row] == OPENS:
            run.vectors[force, row], run.vectors[force, row + 1] = 0.0, 0.0
            run.vectors[rate, row], run.vectors[rate, row + 1] = opening, slipping
        elif run.vectors[PIECE, row] == HOLDS:
            run.vectors[force, row], run.vectors[force, row + 1] = -opening / GIVES, -slipping / GIVES
            run.vectors[rate, row], run.vectors[rate, row + 1] = 0.0, 0.0
        else:
            drag = slip_sign(run, row) * ratio_of(run, row) * opening / GIVES
            run.vectors[force, row], run.vectors[force, row + 1] = -opening / GIVES, drag
            run.vectors[rate, row], run.vectors[rate, row + 1] = 0.0, slipping + GIVES * drag


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
