"""Bounds of the variables of a motion between two of its states: by Hermite's polynomials through them.

Of a coordinate the states hold q, v, a, of a first-order state x and its rate r; w is the width of the piece between
the states, `error` how far its end may be off, and `part` 1 where the piece is not the whole step. For methods that leave
a polynomial of their own see `elementary.curve_bounds`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.elementary.bounds import Interval, maximum, minimum, rounded_outward
from xdynamics.elementary.numbers import Number, absolute, choose, quotient
from xdynamics.elementary.rounding_margins import ARCHED, BENT, ROUNDED


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
