"""Interval arithmetic, rounded outward: every operation of the language on numbers that lie between two bounds.

As the elementary functions, each operation is one sequence of operations on numbers, for floats and written programs
alike: single runs, runs side by side and plain Python get the same bounds (Moore, Kearfott, Cloud, Introduction to
Interval Analysis, 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import inf, pi
from typing import Any

from xdynamics.elementary.bounds import (
    BREAKS,
    CURVED,
    HERMITE,
    LEAST,
    SMOOTH,
    ULPS,
    UNBOUNDED,
    Interval,
    above,
    below,
    maximum,
    minimum,
    rounded_outward,
    sound_interval,
)
from xdynamics.elementary.numbers import (
    Integer,
    Number,
    Truth,
    absolute,
    ceiling,
    choose,
    floor,
    quotient,
    round_half_even,
    sqrt,
)

LARGEST_ANGLE = 1e15  # beyond it the distance of neighbouring numbers is a fraction of a turn


@dataclass(frozen=True)
class Intervals:
    """Intervals as a kind of number.

    Parameters
    ----------
    functions : mapping of str to callable
        The elementary functions that are evaluated at bounds.
    margin : number
        Added to the size of a bound, whose product with eps widens it.
    rough : bool
        Whether a sine or cosine is evaluated once, at the middle of an interval, instead of at both ends.
    """

    functions: Mapping[str, Callable[[Number], Number]]
    margin: Number = LEAST
    rough: bool = False

    def of(self, operation: str, *operands: Any) -> Any:
        """Return the result of an operation: an interval, or one of its bounds."""
        return _RULES[operation](self, *operands)

    def outward(self, low: Number, high: Number, flaw: Integer = SMOOTH) -> Interval:
        """Return the interval between two bounds, rounded outward."""
        return rounded_outward(low, high, self.margin, flaw)

    def monotone(self, name: str, low: Number, high: Number, flaw: Integer) -> Interval:
        """Enclose a function that rises or falls."""
        return self.ordered(self.functions[name](low), self.functions[name](high), flaw)

    def ordered(self, first: Number, second: Number, flaw: Integer) -> Interval:
        """Return the interval between two values of elementary functions."""
        falls = first > second
        low, high = choose(falls, second, first), choose(falls, first, second)
        return self.outward(low - ULPS * absolute(low), high + ULPS * absolute(high), flaw)


def _interval_product(arithmetic: Intervals, a: Interval, low: Number, high: Number, flaw: Integer) -> Interval:
    w, x, y, z = a.low * low, a.low * high, a.high * low, a.high * high
    # zero times an infinite bound is nan: nothing is known of such a product
    sound = ((w == w) & (x == x)) & ((y == y) & (z == z))
    return arithmetic.outward(choose(sound, minimum(w, x, y, z), -inf), choose(sound, maximum(w, x, y, z), inf), flaw)


def _interval_square(arithmetic: Intervals, a: Interval) -> Interval:
    small, large = _absolute_bounds(a)
    return arithmetic.outward(small * small, large * large, a.flaw)


def _interval_quotient(arithmetic: Intervals, a: Interval, b: Interval) -> Interval:
    """Divide; a divisor that may be zero leaves nothing known."""
    spans = (b.low <= 0.0) & (b.high >= 0.0)
    # 1 in place of any divisor: the dividend is the whole line then
    low = choose(spans, 1.0, below(quotient(1.0, b.high), arithmetic.margin))
    high = choose(spans, 1.0, above(quotient(1.0, b.low), arithmetic.margin))
    dividend = Interval(choose(spans, -inf, a.low), choose(spans, inf, a.high))
    return _interval_product(arithmetic, dividend, low, high, choose(spans, UNBOUNDED, _worse_flaw(a, b)))


def _enclose_sign(_: Intervals, a: Interval) -> Interval:
    low, high = _sign_of_bound(a.low), _sign_of_bound(a.high)
    return sound_interval(low, high, choose(low == high, a.flaw, maximum(a.flaw, BREAKS)))


def _enclose_steps(rule: Callable[[Number], Number], _: Intervals, a: Interval) -> Interval:
    """Enclose a function that rises by jumps."""
    low, high = rule(a.low), rule(a.high)
    return sound_interval(low, high, choose(low == high, a.flaw, maximum(a.flaw, BREAKS)))


def _interval_remainder(arithmetic: Intervals, a: Interval, b: Interval) -> Interval:
    turns = _enclose_steps(floor, arithmetic, _interval_quotient(arithmetic, a, b))
    whole_turns = _interval_product(arithmetic, b, turns.low, turns.high, _worse_flaw(b, turns))
    return arithmetic.outward(a.low - whole_turns.high, a.high - whole_turns.low, _worse_flaw(a, whole_turns))


def _interval_root(arithmetic: Intervals, a: Interval) -> Interval:
    undefined = a.low < 0.0
    low = choose(undefined, 0.0, maximum(0.0, below(sqrt(a.low), arithmetic.margin)))
    return sound_interval(low, above(sqrt(a.high), arithmetic.margin), choose(undefined, UNBOUNDED, a.flaw))


def _enclose_choice(_: Intervals, a: Interval, b: Interval, c: Interval) -> Interval:
    """Return the branch of a decided condition, or the hull of both where it is undecided."""
    always, never = a.low == 1.0, a.high == 0.0
    both = Interval(minimum(b.low, c.low), maximum(b.high, c.high), maximum(BREAKS, _worse_flaw(b, c)))
    branches = zip(b, c, both, strict=True)
    return sound_interval(*(choose(always, first, choose(never, second, either)) for first, second, either in branches))


def _truth_bounds(a: Interval, b: Interval, always: Truth, never: Truth) -> Interval:
    """Enclose a truth: 1, 0, or from 0 to 1 where it is undecided, as for a nan, which is neither less nor more."""
    is_defined = _worse_flaw(a, b) < UNBOUNDED
    return Interval(choose(is_defined & always, 1.0, 0.0), choose(is_defined & never, 0.0, 1.0))


def _enclose_tangent(arithmetic: Intervals, a: Interval) -> Interval:
    """Nothing is known of a tangent where there may be a pole."""
    slack = _angle_slack(a)
    crosses_pole = floor((a.high + slack) / pi + 0.5) != floor((a.low - slack) / pi + 0.5)
    return _choose_interval(
        (a.high - a.low >= 3.0) | crosses_pole, Interval(-inf, inf, UNBOUNDED), arithmetic.monotone("tan", *a)
    )


def _within_one(a: Interval) -> Interval:
    """Return the part of an interval within the domain of arcsine, flagged if it reaches beyond."""
    low, high = (minimum(1.0, maximum(-1.0, x)) for x in a[:2])
    return Interval(low, high, choose((a.low < -1.0) | (a.high > 1.0), UNBOUNDED, a.flaw))


def _enclose_logarithm(arithmetic: Intervals, a: Interval) -> Interval:
    undefined = a.low <= 0.0
    return arithmetic.monotone("log", choose(undefined, 0.0, a.low), a.high, choose(undefined, UNBOUNDED, a.flaw))


def _enclose_power(arithmetic: Intervals, a: Interval, b: Interval) -> Interval:
    """Raise to a power that is not whole: by logarithms, which are moved by a share to cover rounding."""
    undefined, ends = a.low < 0.0, []
    for x, slack in ((choose(undefined, 0.0, a.low), -ULPS), (a.high, ULPS)):
        itself = (x <= 0.0) | (x == inf)
        logarithm = b.low * arithmetic.functions["log"](choose(itself, 1.0, x))
        ends.append(choose(itself, x, arithmetic.functions["exp"](logarithm + slack * absolute(logarithm))))
    return arithmetic.ordered(ends[0], ends[1], choose(undefined, UNBOUNDED, a.flaw))


def _enclose_hypotenuse(arithmetic: Intervals, a: Interval, b: Interval) -> Interval:
    shortest, longest = (_vector_length(x, y) for x, y in zip(_absolute_bounds(a), _absolute_bounds(b), strict=True))
    low = maximum(0.0, below(shortest - ULPS * shortest, arithmetic.margin))
    return sound_interval(low, above(longest + ULPS * longest, arithmetic.margin), _worse_flaw(a, b))


def _enclose_angle(arithmetic: Intervals, a: Interval, b: Interval) -> Interval:
    """Enclose the angle of a vector: it jumps at the cut, and the origin has none."""
    cut = (b.low <= 0.0) & ((a.low <= 0.0) & (a.high >= 0.0))
    angles = []
    for y, x in ((y, x) for y in a[:2] for x in b[:2]):
        flat = absolute(x) >= absolute(y)
        angle_of_ratio = arithmetic.functions["atan"](quotient(choose(flat, y, x), choose(flat, x, y)))
        behind = choose(y >= 0.0, angle_of_ratio + pi, angle_of_ratio - pi)
        upright = choose(y > 0.0, pi / 2.0, -pi / 2.0)
        angles.append(choose(flat, choose(x > 0.0, angle_of_ratio, behind), upright - angle_of_ratio))
    low, high, flaw = minimum(*angles), maximum(*angles), _worse_flaw(a, b)
    angle = arithmetic.outward(low - ULPS * absolute(low), high + ULPS * absolute(high), flaw)
    return _choose_interval(cut, Interval(-pi - ULPS, pi + ULPS, maximum(flaw, BREAKS)), angle)


def _enclose_wave(name: str, shift: float, arithmetic: Intervals, a: Interval) -> Interval:
    """Enclose a sine (`shift` 0.5) or a cosine (`shift` 0): its values at the ends, and the crests between."""
    function, slack, (low, high, flaw) = arithmetic.functions[name], _angle_slack(a), a
    narrow = (high - low < 2.0 * pi) & ((absolute(low) < LARGEST_ANGLE) & (absolute(high) < LARGEST_ANGLE))
    finite = (absolute(low) < inf) & (absolute(high) < inf)
    if arithmetic.rough:
        # no sine changes by more than its argument does
        middle, half = function((low + high) / 2.0), (high - low) / 2.0 + slack
        bottom, top = middle - half, middle + half
    else:
        at_low, at_high = function(low), function(high)
        first, last = (low - slack) / pi - shift, (high + slack) / pi - shift  # crests at even, troughs at odd numbers
        top = choose(_has_even_integer(first, last), 1.0, maximum(at_low, at_high))
        bottom = choose(_has_even_integer(first - 1.0, last - 1.0), -1.0, minimum(at_low, at_high))
        bottom, top = (
            below(bottom - ULPS * absolute(bottom), arithmetic.margin),
            above(top + ULPS * absolute(top), arithmetic.margin),
        )
    low, high = choose(narrow, maximum(-1.0, bottom), -1.0), choose(narrow, minimum(1.0, top), 1.0)
    return sound_interval(low, high, choose(finite, flaw, UNBOUNDED))


BY_ZERO = ("add", "subtract", "multiply", "divide")


def with_zeros(operation: str, enclosure: Interval, a: Interval, b: Interval) -> Interval:
    """Return the result of an operation, exact where an operand is zero, which rounding would widen."""
    a_zero, b_zero = ((x.low == 0.0) & (x.high == 0.0) for x in (a, b))
    low, high = enclosure.low, enclosure.high
    if operation == "multiply":
        low, high = (choose(a_zero | b_zero, 0.0, end) for end in (low, high))
    elif operation == "divide":  # by what is not zero
        nothing = a_zero & (enclosure.flaw < UNBOUNDED)
        low, high = (choose(nothing, 0.0, end) for end in (low, high))
    elif operation == "add":
        low = choose(b_zero, a.low, choose(a_zero, b.low, low))
        high = choose(b_zero, a.high, choose(a_zero, b.high, high))
    else:
        low = choose(b_zero, a.low, choose(a_zero, -b.high, low))
        high = choose(b_zero, a.high, choose(a_zero, -b.low, high))
    return Interval(low, high, enclosure.flaw)


def _has_even_integer(first: Number, last: Number) -> Truth:
    """Whether an even number lies between two."""
    return floor(last / 2.0) >= -floor(-(first / 2.0))


def _worse_flaw(a: Interval, b: Interval) -> Integer:
    return maximum(a.flaw, b.flaw)


def _absolute_bounds(a: Interval) -> tuple[Number, Number]:
    """Return the least and the greatest absolute value."""
    low_size, high_size = absolute(a.low), absolute(a.high)
    return choose((a.low < 0.0) & (a.high > 0.0), 0.0, minimum(low_size, high_size)), maximum(low_size, high_size)


def _sign_of_bound(x: Number) -> Number:
    return choose(x > 0.0, 1.0, choose(x < 0.0, -1.0, choose(x == 0.0, 0.0, x)))


def _are_one_point(a: Interval, b: Interval) -> Truth:
    return (a.low == a.high) & ((a.high == b.low) & (b.low == b.high))


def _are_disjoint(a: Interval, b: Interval) -> Truth:
    return (a.high < b.low) | (a.low > b.high)


def _angle_slack(a: Interval) -> Number:
    return ULPS * (absolute(a.low) + absolute(a.high) + 1.0)


def _vector_length(x: Number, y: Number) -> Number:
    """Return the length of a vector of two sizes, without overflow."""
    large, small = maximum(x, y), minimum(x, y)
    ratio = quotient(small, large)
    return choose((large > 0.0) & (large < inf), large * sqrt(1.0 + ratio * ratio), large)


def _choose_interval(truth: Truth, a: Interval, b: Interval) -> Interval:
    return Interval(*(choose(truth, *pair) for pair in zip(a, b, strict=True)))


_RULES: Mapping[str, Callable[..., Any]] = {
    "point": lambda _, x: Interval(x, x),
    "between": lambda _, low, high: Interval(low, high),
    "low": lambda _, a: a.low,
    "high": lambda _, a: a.high,
    "flaw": lambda _, a: choose(a.flaw == SMOOTH, choose(a.low == a.low, 0.0, 1.0), 1.0),
    "flawed": lambda _, low, high, flaw: Interval(low, high, choose(flaw == 0.0, SMOOTH, UNBOUNDED)),
    "add": lambda arithmetic, a, b: arithmetic.outward(a.low + b.low, a.high + b.high, _worse_flaw(a, b)),
    "subtract": lambda arithmetic, a, b: arithmetic.outward(a.low - b.high, a.high - b.low, _worse_flaw(a, b)),
    "multiply": lambda arithmetic, a, b: _interval_product(arithmetic, a, b.low, b.high, _worse_flaw(a, b)),
    "square": _interval_square,
    "divide": _interval_quotient,
    "negative": lambda _, a: Interval(-a.high, -a.low, a.flaw),
    "abs": lambda _, a: sound_interval(*_absolute_bounds(a), a.flaw),
    "sign": _enclose_sign,
    "sqrt": _interval_root,
    "floor": partial(_enclose_steps, floor),
    "ceil": partial(_enclose_steps, ceiling),
    "round": partial(_enclose_steps, round_half_even),
    "mod": _interval_remainder,
    "least": lambda _, a, b: sound_interval(minimum(a.low, b.low), minimum(a.high, b.high), _worse_flaw(a, b)),
    "greatest": lambda _, a, b: sound_interval(maximum(a.low, b.low), maximum(a.high, b.high), _worse_flaw(a, b)),
    "positive": lambda _, a: a._replace(flaw=choose(a.low > 0.0, a.flaw, UNBOUNDED)),
    "choose": _enclose_choice,
    "less": lambda _, a, b: _truth_bounds(a, b, a.high < b.low, a.low >= b.high),
    "at_most": lambda _, a, b: _truth_bounds(a, b, a.high <= b.low, a.low > b.high),
    "more": lambda _, a, b: _truth_bounds(a, b, a.low > b.high, a.high <= b.low),
    "at_least": lambda _, a, b: _truth_bounds(a, b, a.low >= b.high, a.high < b.low),
    "equal": lambda _, a, b: _truth_bounds(a, b, _are_one_point(a, b), _are_disjoint(a, b)),
    "unequal": lambda _, a, b: _truth_bounds(a, b, _are_disjoint(a, b), _are_one_point(a, b)),
    **{
        name: lambda arithmetic, a, name=name: arithmetic.monotone(name, *a) for name in ("exp", "atan", "sinh", "tanh")
    },
    **{name: lambda arithmetic, a, name=name: arithmetic.monotone(name, *_within_one(a)) for name in ("asin", "acos")},
    "cosh": lambda arithmetic, a: arithmetic.monotone("cosh", *_absolute_bounds(a), a.flaw),
    "sin": partial(_enclose_wave, "sin", 0.5),
    "cos": partial(_enclose_wave, "cos", 0.0),
    "tan": _enclose_tangent,
    "log": _enclose_logarithm,
    "power": _enclose_power,
    "hypot": _enclose_hypotenuse,
    "atan2": _enclose_angle,
    **{
        name: lambda arithmetic, *operands, rule=rule: rule(arithmetic.margin, *operands)
        for name, rule in {**HERMITE, **CURVED}.items()
    },
}
