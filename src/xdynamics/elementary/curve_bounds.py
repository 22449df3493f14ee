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

from xdynamics.elementary.bounds import Interval, maximum, minimum, rounded_outward, sound_interval
from xdynamics.elementary.motion_bounds import HERMITE
from xdynamics.elementary.numbers import Number, absolute, choose, quotient
from xdynamics.elementary.rounding_margins import EPS, ROUNDED, SMOOTH

QUINTIC = 5  # degree of Hermite's polynomial of a coordinate
STEEPEST = 4.0  # over the mean: the slope of the distance between shortened steps and the polynomial of the whole one


class PolynomialBounds(NamedTuple):
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
    shifted, power = list(coefficients), share
    degree = len(shifted) - 1
    for i in range(degree):  # to powers of s - first
        for k in range(degree - 1, i - 1, -1):
            shifted[k] = shifted[k] + first * shifted[k + 1]
    for k in range(1, degree + 1):
        shifted[k] = shifted[k] * power * (1.0 / comb(degree, k))
        power = power * share
    for i in range(1, degree + 1):
        for k in range(degree, i - 1, -1):
            shifted[k] = shifted[k] + shifted[k - 1]
    return shifted


def bound_on_piece(coefficients: Sequence[Number], ends: Sequence[Number], piece: Piece) -> PolynomialBounds:
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
    displacements = bernstein([0.0, *coefficients[1:]], piece.first, share)
    slopes = bernstein([k * coefficients[k] for k in range(1, degree + 1)], piece.first, share)
    sizes = [absolute(coefficient) for coefficient in coefficients[1:]]
    reached, power = list[Number](), piece.last  # as far as the piece alone: of a small one near the start, less by far
    for size in sizes:
        reached.append(size * power)
        power = power * piece.last
    value_rounding, slope_rounding = (
        reduce(maximum, magnitudes) * (4.0 * degree * degree * EPS) for magnitudes in (reached, sizes)
    )
    rounding = value_rounding + ROUNDED * maximum(absolute(start), absolute(end))
    lack = (end - start) - (displacements[-1] - displacements[0])
    values = [start + ((b - displacements[0]) + lack * (k / degree)) for k, b in enumerate(displacements)]
    bent = quotient(share, piece.last) * absolute(lack)  # such a power, over its chord on the piece
    off = top + bent / 2.0 + rounding
    lack = choose(absolute(lack) <= 4.0 * rounding, 0.0, lack)  # rounding says nothing of a slope
    lean = choose(piece.w > 0.0, quotient(lack, piece.w), 0.0)
    tilt = STEEPEST * quotient(share, piece.last) * absolute(lean) + quotient(
        slope_top + degree * slope_rounding, piece.h
    )
    low, high = quotient(reduce(minimum, slopes), piece.h), quotient(reduce(maximum, slopes), piece.h)
    return PolynomialBounds(
        reduce(minimum, values), reduce(maximum, values), off, low + lean - tilt, high + lean + tilt
    )


def _enclose_on_curves(
    name: str, rule: Callable[..., Interval], places: int, polynomials: int, margin: Number, *operands: Number
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
    *operands : number
        The coefficients of each polynomial; of each place the numbers in the states at the piece's start and end; then
        the numbers of the piece.
    """
    *numbers, w, error, part, h, first, last = operands
    terms = (len(numbers) - 2 * places) // polynomials
    states = numbers[polynomials * terms :]
    ends = [states[2 * k : 2 * k + 2] for k in range(places)]
    piece = Piece(w, error, h, first, last)
    curves = [bound_on_piece(numbers[k * terms : (k + 1) * terms], ends[k], piece) for k in range(polynomials)]
    curve = rule(margin, piece, curves, ends)
    if terms > QUINTIC:
        return curve
    smooth = HERMITE[name](margin, *(end[k] for k in range(2) for end in ends), w, error, part)
    return sound_interval(maximum(curve.low, smooth.low), minimum(curve.high, smooth.high), SMOOTH)


def _enclose_value(
    margin: Number, piece: Piece, curves: Sequence[PolynomialBounds], ends: Sequence[Sequence[Number]]
) -> Interval:
    """Enclose what the last polynomial is of; it is also the slope of one before. At one state it is the number there."""
    *earlier_curves, curve = curves
    end_values = ends[len(earlier_curves)]
    low, high, off = curve.low, curve.high, curve.off
    for earlier_curve in earlier_curves:
        low, high = minimum(low, earlier_curve.falling), maximum(high, earlier_curve.rising)
    stands, still = piece.w <= 0.0, ROUNDED * maximum(absolute(end_values[0]), absolute(end_values[1]))
    low, high = choose(stands, minimum(*end_values), low), choose(stands, maximum(*end_values), high)
    off = choose(stands, still, off) + piece.error
    return rounded_outward(low - off, high + off, margin)


def _enclose_slope(
    margin: Number, piece: Piece, curves: Sequence[PolynomialBounds], ends: Sequence[Sequence[Number]]
) -> Interval:
    """Enclose the slope of the last polynomial."""
    stands, (start, end) = piece.w <= 0.0, ends[len(curves)]
    still = ROUNDED * maximum(absolute(start), absolute(end))
    low = choose(stands, minimum(start, end) - still, curves[-1].falling)
    return rounded_outward(low, choose(stands, maximum(start, end) + still, curves[-1].rising), margin)


def _enclose_rate(
    margin: Number, piece: Piece, curves: Sequence[PolynomialBounds], ends: Sequence[Sequence[Number]]
) -> Interval:
    """Enclose a rate: the slope of the last polynomial, and the rates by the forces at both ends."""
    slope, (start, end) = _enclose_slope(margin, piece, curves, ends), ends[len(curves)]
    still = ROUNDED * maximum(absolute(start), absolute(end))
    low, high = minimum(slope.low, minimum(start, end) - still), maximum(slope.high, maximum(start, end) + still)
    return rounded_outward(low, high, margin)


# the rule of each variable, the number of its places, and of which of the first of them it needs the polynomial
_RULES = {
    "position": (_enclose_value, 3, 1),
    "velocity": (_enclose_value, 3, 2),
    "acceleration": (_enclose_rate, 3, 2),
    "velocity_slope": (_enclose_slope, 3, 2),
    "state": (_enclose_value, 2, 1),
    "rate": (_enclose_rate, 2, 1),
    "state_slope": (_enclose_slope, 2, 1),
}
POLYNOMIALS = {name: polynomials for name, (_, _, polynomials) in _RULES.items()}


def on_curve(name: str) -> str:
    """Return the name of the operation that encloses a variable by polynomials."""
    return f"{name}_on_curve"


CURVED: Mapping[str, Callable[..., Interval]] = {
    on_curve(name): partial(_enclose_on_curves, name, *rule) for name, rule in _RULES.items()
}
