"""Bounds of values in interval arithmetic: outward rounding, and the motion between two states of a step.

Rounding is that of IEEE 754's double precision. Margins cover rounding, and what lies between computed values; they are
the same in single runs and in lanes.

Between two states, variables are bounded by Hermite's polynomials through them. Of a coordinate the states hold q, v,
a, of a first-order state x and its rate r; w is the width of the piece between the states, `error` how far its end may
be off, and `part` 1 where the piece is not the whole step.

Where a method leaves a polynomial of the whole step, variables are bounded by that. The polynomial is given by its
coefficients in s, which runs from 0 to 1 over the step. On the piece it is moved so that it passes both states, in
proportion to s between them: where the states are on it, it is the polynomial itself. Its Bernstein coefficients on the
piece bound it (Farouki 2012, The Bernstein polynomial basis, Comput. Aided Geom. Des. 29, 379).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from math import comb, inf
from typing import NamedTuple

from xdynamics.elementary.numbers import Integer, Number, absolute, choose, quotient

EPS, MOST = 2.0**-52, 1.7976931348623157e308
# Added to the size of a bound, whose product with eps widens it: a zero is widened by the least normal number, since
# smaller ones take many processors a hundred cycles. Version 0.2 took the least number of all.
LEAST, LEAST_OF_0_2 = 2.0**-970, 2.0**-1022
ULPS = 4.0 * EPS  # of an elementary function
ROUNDED = 4.0 * EPS  # of a state, relative
# distance of a rate from the straight line, in terms of odd and even, if it is half a wave (pi/2, 1/9.5) or less
ARCHED, BENT = 1.571, 0.1053
SMOOTH, BREAKS, UNBOUNDED = 0, 1, 2  # whether a value may jump there, or be infinite or undefined


class Interval(NamedTuple):
    """A value between two bounds, and its flaw: whether it may jump there, or be infinite or undefined."""

    low: Number
    high: Number
    flaw: Integer = SMOOTH


def below(x: Number, margin: Number) -> Number:
    """Return a number below x; -inf where x is."""
    # |x| eps is a spacing of x or more, and rounding to nearest errs by half of one at most
    return choose(x == inf, MOST, x - (absolute(x) + margin) * EPS)


def above(x: Number, margin: Number) -> Number:
    """Return a number above x; inf where x is."""
    # where x has overflowed, the formula would give -inf + inf, which is nan
    return choose(x == -inf, -MOST, x + (absolute(x) + margin) * EPS)


def minimum(x: Number, *further_numbers: Number) -> Number:
    """Return the least of some numbers, two at a time; where one is nan, as Python's `min` does."""
    if not further_numbers:
        return x
    if len(further_numbers) > 1:
        return minimum(minimum(x, further_numbers[0]), minimum(*further_numbers[1:]))
    return choose(further_numbers[0] < x, further_numbers[0], x)


def maximum(x: Number, *further_numbers: Number) -> Number:
    """Return the greatest of some numbers, two at a time; where one is nan, as Python's `max` does."""
    if not further_numbers:
        return x
    if len(further_numbers) > 1:
        return maximum(maximum(x, further_numbers[0]), maximum(*further_numbers[1:]))
    return choose(further_numbers[0] > x, further_numbers[0], x)


def sound_interval(low: Number, high: Number, flaw: Integer) -> Interval:
    """Return an interval, unbounded where the bounds are reversed or nan."""
    # false for nan, too: both bounds are then infinite
    sound = low <= high
    return Interval(choose(sound, low, -inf), choose(sound, high, inf), choose(sound, flaw, UNBOUNDED))


def rounded_outward(low: Number, high: Number, margin: Number, flaw: Integer = SMOOTH) -> Interval:
    """Return the interval between two bounds, rounded outward."""
    return sound_interval(below(low, margin), above(high, margin), flaw)


def _distances(
    q0: Number, v0: Number, a0: Number, q1: Number, v1: Number, a1: Number, w: Number
) -> tuple[Number, Number]:
    """Return how far cubics through positions and velocities are from the quintic: at its middle, and beside it."""
    odd = absolute((q1 - q0) - w * (v0 + v1) / 2.0 + w * w * (a1 - a0) / 12.0)
    return odd, absolute(v1 - v0 - w * (a0 + a1) / 2.0)


def _hermite_position(margin: Number, *operands: Number) -> Interval:
    """Enclose a coordinate: the Bernstein coefficients of Hermite's quintic, widened by its distance from cubics."""
    q0, v0, a0, q1, v1, a1, w, error, _ = operands
    odd, even = _distances(*operands[:7])
    off = odd + w * even / 128.0 + ROUNDED * maximum(absolute(q0), absolute(q1)) + error
    b1, b2 = q0 + w * v0 / 5.0, q0 + 2.0 * w * v0 / 5.0 + w * w * a0 / 20.0
    b4, b3 = q1 - w * v1 / 5.0, q1 - 2.0 * w * v1 / 5.0 + w * w * a1 / 20.0
    low, high = minimum(minimum(q0, b1, b2, b3), minimum(b4, q1)), maximum(maximum(q0, b1, b2, b3), maximum(b4, q1))
    return rounded_outward(low - off, high + off, margin)


def _hermite_velocity(margin: Number, *operands: Number) -> Interval:
    """Enclose a velocity.

    Bounds by positions are divided by the width of the piece. On a piece made short by cutting, rounding would dominate
    them, and so would the mismatch of positions and velocities of a method of low order: there, velocities are bounded
    by accelerations, and accelerations by their change.
    """
    q0, v0, a0, q1, v1, a1, w, error, part = operands
    odd, even = _distances(*operands[:7])
    size, fastest = maximum(absolute(q0), absolute(q1)), maximum(absolute(v0), absolute(v1))
    b1, b2 = v0 + w * a0 / 3.0, v1 - w * a1 / 3.0
    off = choose(w > 0.0, quotient(4.0 * (odd + w * even / 128.0), w), 0.0)
    by_acceleration = (part != 0) | (odd <= 4.0 * ROUNDED * (size + w * fastest))
    off = (
        choose(by_acceleration, minimum(off, w * maximum(absolute(a0), absolute(a1))), off) + ROUNDED * fastest + error
    )
    return rounded_outward(minimum(v0, b1, b2, v1) - off, maximum(v0, b1, b2, v1) + off, margin)


def _hermite_acceleration(margin: Number, *operands: Number) -> Interval:
    _, _, a0, _, _, a1, w, _, part = operands
    odd, even = _distances(*operands[:7])
    bent = quotient(24.0 * odd, w * w)
    bent = choose(part != 0, minimum(bent, absolute(a1 - a0)), bent)
    off = choose(w > 0.0, bent + quotient(2.0 * even, w), 0.0) + ROUNDED * maximum(absolute(a0), absolute(a1))
    return rounded_outward(minimum(a0, a1) - off, maximum(a0, a1) + off, margin)


def _hermite_state(margin: Number, *operands: Number) -> Interval:
    x0, r0, x1, r1, w, error, _ = operands
    odd, even = absolute((x1 - x0) - w * (r0 + r1) / 2.0), w * absolute(r1 - r0)
    b1, b2 = x0 + w * r0 / 3.0, x1 - w * r1 / 3.0
    off = odd / 8.0 + even / 64.0 + ROUNDED * maximum(absolute(x0), absolute(x1)) + error
    return rounded_outward(minimum(x0, b1, b2, x1) - off, maximum(x0, b1, b2, x1) + off, margin)


def _hermite_rate(margin: Number, *operands: Number) -> Interval:
    x0, r0, x1, r1, w, _, _ = operands
    odd, even = absolute((x1 - x0) - w * (r0 + r1) / 2.0), w * absolute(r1 - r0)
    off = choose(w > 0.0, quotient(ARCHED * odd + BENT * even, w), 0.0) + ROUNDED * maximum(absolute(r0), absolute(r1))
    return rounded_outward(minimum(r0, r1) - off, maximum(r0, r1) + off, margin)


HERMITE: Mapping[str, Callable[..., Interval]] = {
    "position": _hermite_position,
    "velocity": _hermite_velocity,
    "acceleration": _hermite_acceleration,
    "state": _hermite_state,
    "rate": _hermite_rate,
    "velocity_slope": _hermite_acceleration,
    "state_slope": _hermite_rate,
}


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
    # Chebyshev's polynomials: c s**n is as far as |c| 2**(1 - 2 n) from those of lower degree on [0, 1]; here for the
    # slope, of degree n - 1
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
    """Enclose a value by the last polynomial, also where that is a former slope; at one state return its number."""
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
