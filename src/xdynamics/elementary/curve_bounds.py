"""Bounds of the variables of a motion on a piece of a step, by the polynomial that the method leaves of the whole step.

The polynomial is given by its coefficients in s, which runs from 0 to 1 over the step. On the piece it is moved so that it
passes both states, in proportion to s between them: where the states are on it, it is the polynomial itself. Its Bernstein
coefficients on the piece bound it (Farouki 2012, The Bernstein polynomial basis, Comput. Aided Geom. Des. 29, 379).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from math import comb
from typing import NamedTuple

from xdynamics.elementary.bounds import Interval, greatest, least, outward, settled
from xdynamics.elementary.motion_bounds import HERMITE
from xdynamics.elementary.numbers import Number, absolute, choose, quotient
from xdynamics.elementary.rounding_margins import EPS, ROUNDED, SMOOTH

QUINTIC = 5  # degree of Hermite's polynomial of a coordinate
STEEPEST = 4.0  # over the mean: the slope of the distance between shortened steps and the polynomial of the whole one


class Moved(NamedTuple):
    """Bounds of a polynomial on a piece, moved to pass both states: of its values, which may be `off`, and its slopes."""

    low: Number
    high: Number
    off: Number
    falling: Number
    rising: Number


class Piece(NamedTuple):
    """A piece of a step: its width, how far its end may be off, the width of the step, its ends in s."""

    w: Number
    error: Number
    h: Number
    first: Number
    last: Number


def bernstein(coefficients: Sequence[Number], first: Number, share: Number) -> list[Number]:
    """Return the Bernstein coefficients of a polynomial in s on the piece from `first`, `share` wide.

    Examples
    --------
    >>> bernstein([0.0, 0.0, 1.0], 0.5, 0.5)
    [0.25, 0.5, 1.0]
    """
    moved, power = list(coefficients), share
    degree = len(moved) - 1
    for i in range(degree):  # to powers of s - first
        for k in range(degree - 1, i - 1, -1):
            moved[k] = moved[k] + first * moved[k + 1]
    for k in range(1, degree + 1):
        moved[k] = moved[k] * power * (1.0 / comb(degree, k))
        power = power * share
    for i in range(1, degree + 1):
        for k in range(degree, i - 1, -1):
            moved[k] = moved[k] + moved[k - 1]
    return moved


def moved_along(coefficients: Sequence[Number], ends: Sequence[Number], piece: Piece) -> Moved:
    """Bound a polynomial on a piece, moved to pass a value at either end.

    It is widened by its distance from polynomials of lower degree, that of Chebyshev's of its highest term: a step in
    which this is large is so long that the polynomial may be anything between the stages. What shortened steps lack to
    the polynomial grows as a power of s from the start of the step, of at most `STEEPEST`.
    """
    degree, share, (start, end) = len(coefficients) - 1, piece.last - piece.first, ends
    slope_top = (degree * 2.0 ** (3 - 2 * degree)) * absolute(coefficients[-1])
    for _ in range(degree - 1):
        slope_top = slope_top * share
    top = slope_top * share * (0.25 / degree)
    ways = bernstein([0.0, *coefficients[1:]], piece.first, share)
    slopes = bernstein([k * coefficients[k] for k in range(1, degree + 1)], piece.first, share)
    sizes = [absolute(coefficient) for coefficient in coefficients[1:]]
    reached, power = list[Number](), piece.last  # as far as the piece alone: of a small one near the start, less by far
    for size in sizes:
        reached.append(size * power)
        power = power * piece.last
    way, slope_way = (reduce(greatest, each) * (4.0 * degree * degree * EPS) for each in (reached, sizes))
    rounding = way + ROUNDED * greatest(absolute(start), absolute(end))
    lack = (end - start) - (ways[-1] - ways[0])
    values = [start + ((b - ways[0]) + lack * (k / degree)) for k, b in enumerate(ways)]
    bent = quotient(share, piece.last) * absolute(lack)  # such a power, over its chord on the piece
    off = top + bent / 2.0 + rounding
    lack = choose(absolute(lack) <= 4.0 * rounding, 0.0, lack)  # rounding says nothing of a slope
    lean = choose(piece.w > 0.0, quotient(lack, piece.w), 0.0)
    tilt = STEEPEST * quotient(share, piece.last) * absolute(lean) + quotient(slope_top + degree * slope_way, piece.h)
    low, high = quotient(reduce(least, slopes), piece.h), quotient(reduce(greatest, slopes), piece.h)
    return Moved(reduce(least, values), reduce(greatest, values), off, low + lean - tilt, high + lean + tilt)


def _on_curves(
    name: str, rule: Callable[..., Interval], places: int, polynomials: int, margin: Number, *given: Number
) -> Interval:
    """Enclose a variable by a rule and, where that is of higher degree, by Hermite's polynomial too.

    The ends of a step are of higher order than its polynomial of low degree is between them; where rates are smooth,
    Hermite's polynomial through them is nearer the motion, where they are not, it bounds nothing.

    Parameters
    ----------
    name : str
    rule : callable
    places, polynomials : int
        Number of places of the state that it is enclosed by, and of the first of them that have polynomials.
    margin : number
    *given : number
        The coefficients of each polynomial; of each place the numbers in the states at the piece's start and end; then
        the numbers of the piece.
    """
    *numbers, w, error, part, h, first, last = given
    terms = (len(numbers) - 2 * places) // polynomials
    states = numbers[polynomials * terms :]
    ends = [states[2 * k : 2 * k + 2] for k in range(places)]
    piece = Piece(w, error, h, first, last)
    curves = [moved_along(numbers[k * terms : (k + 1) * terms], ends[k], piece) for k in range(polynomials)]
    curve = rule(margin, piece, curves, ends)
    if terms > QUINTIC:
        return curve
    smooth = HERMITE[name](margin, *(end[k] for k in range(2) for end in ends), w, error, part)
    return settled(greatest(curve.low, smooth.low), least(curve.high, smooth.high), SMOOTH)


def _value(margin: Number, piece: Piece, curves: Sequence[Moved], ends: Sequence[Sequence[Number]]) -> Interval:
    """Enclose what the last polynomial is of; it is also the slope of one before. At one state it is the number there."""
    *before, curve = curves
    own = ends[len(before)]
    low, high, off = curve.low, curve.high, curve.off
    for other in before:
        low, high = least(low, other.falling), greatest(high, other.rising)
    stands, still = piece.w <= 0.0, ROUNDED * greatest(absolute(own[0]), absolute(own[1]))
    low, high = choose(stands, least(*own), low), choose(stands, greatest(*own), high)
    off = choose(stands, still, off) + piece.error
    return outward(low - off, high + off, margin)


def _slope(margin: Number, piece: Piece, curves: Sequence[Moved], ends: Sequence[Sequence[Number]]) -> Interval:
    """Enclose the slope of the last polynomial."""
    stands, (start, end) = piece.w <= 0.0, ends[len(curves)]
    still = ROUNDED * greatest(absolute(start), absolute(end))
    low = choose(stands, least(start, end) - still, curves[-1].falling)
    return outward(low, choose(stands, greatest(start, end) + still, curves[-1].rising), margin)


def _rate(margin: Number, piece: Piece, curves: Sequence[Moved], ends: Sequence[Sequence[Number]]) -> Interval:
    """Enclose a rate: the slope of the last polynomial, and the rates by the forces at both ends."""
    slope, (start, end) = _slope(margin, piece, curves, ends), ends[len(curves)]
    still = ROUNDED * greatest(absolute(start), absolute(end))
    low, high = least(slope.low, least(start, end) - still), greatest(slope.high, greatest(start, end) + still)
    return outward(low, high, margin)


# the rule of each variable, the number of its places, and of which of the first of them it needs the polynomial
_RULES = {
    "position": (_value, 3, 1),
    "velocity": (_value, 3, 2),
    "acceleration": (_rate, 3, 2),
    "velocity_slope": (_slope, 3, 2),
    "state": (_value, 2, 1),
    "rate": (_rate, 2, 1),
    "state_slope": (_slope, 2, 1),
}
POLYNOMIALS = {name: polynomials for name, (_, _, polynomials) in _RULES.items()}


def on_curve(name: str) -> str:
    """Return the name of the operation that encloses a variable by polynomials."""
    return f"{name}_on_curve"


CURVED: Mapping[str, Callable[..., Interval]] = {
    on_curve(name): partial(_on_curves, name, *rule) for name, rule in _RULES.items()
}
