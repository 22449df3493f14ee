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

from xdynamics.elementary.bounds import Interval, above, below, greatest, least, outward, settled
from xdynamics.elementary.curve_bounds import CURVED
from xdynamics.elementary.motion_bounds import HERMITE
from xdynamics.elementary.numbers import Number, Truth, Whole, absolute, ceiling, choose, floor, nearest, quotient, sqrt
from xdynamics.elementary.rounding_margins import BREAKS, LEAST, SMOOTH, ULPS, UNBOUNDED

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

    def outward(self, low: Number, high: Number, flaw: Whole = SMOOTH) -> Interval:
        """Return the interval between two bounds, rounded outward."""
        return outward(low, high, self.margin, flaw)

    def monotone(self, name: str, low: Number, high: Number, flaw: Whole) -> Interval:
        """Enclose a function that rises or falls."""
        return self.ordered(self.functions[name](low), self.functions[name](high), flaw)

    def ordered(self, one: Number, other: Number, flaw: Whole) -> Interval:
        """Return the interval between two values of elementary functions."""
        falls = one > other
        low, high = choose(falls, other, one), choose(falls, one, other)
        return self.outward(low - ULPS * absolute(low), high + ULPS * absolute(high), flaw)


def _product(of: Intervals, a: Interval, low: Number, high: Number, flaw: Whole) -> Interval:
    w, x, y, z = a.low * low, a.low * high, a.high * low, a.high * high
    sound = ((w == w) & (x == x)) & ((y == y) & (z == z))
    return of.outward(choose(sound, least(w, x, y, z), -inf), choose(sound, greatest(w, x, y, z), inf), flaw)


def _square(of: Intervals, a: Interval) -> Interval:
    small, large = _sizes(a)
    return of.outward(small * small, large * large, a.flaw)


def _quotient(of: Intervals, a: Interval, b: Interval) -> Interval:
    """Divide; a divisor that may be zero leaves nothing known."""
    spans = (b.low <= 0.0) & (b.high >= 0.0)
    low = choose(spans, 1.0, below(quotient(1.0, b.high), of.margin))
    high = choose(spans, 1.0, above(quotient(1.0, b.low), of.margin))
    dividend = Interval(choose(spans, -inf, a.low), choose(spans, inf, a.high))
    return _product(of, dividend, low, high, choose(spans, UNBOUNDED, _worst(a, b)))


def _signs(_: Intervals, a: Interval) -> Interval:
    low, high = _sign(a.low), _sign(a.high)
    return settled(low, high, choose(low == high, a.flaw, greatest(a.flaw, BREAKS)))


def _stepped(rule: Callable[[Number], Number], _: Intervals, a: Interval) -> Interval:
    """Enclose a function that rises by jumps."""
    low, high = rule(a.low), rule(a.high)
    return settled(low, high, choose(low == high, a.flaw, greatest(a.flaw, BREAKS)))


def _remainder(of: Intervals, a: Interval, b: Interval) -> Interval:
    turns = _stepped(floor, of, _quotient(of, a, b))
    taken = _product(of, b, turns.low, turns.high, _worst(b, turns))
    return of.outward(a.low - taken.high, a.high - taken.low, _worst(a, taken))


def _root(of: Intervals, a: Interval) -> Interval:
    undefined = a.low < 0.0
    low = choose(undefined, 0.0, greatest(0.0, below(sqrt(a.low), of.margin)))
    return settled(low, above(sqrt(a.high), of.margin), choose(undefined, UNBOUNDED, a.flaw))


def _choice(_: Intervals, a: Interval, b: Interval, c: Interval) -> Interval:
    """Take the branch that a condition says, or both where it is undecided."""
    always, never = a.low == 1.0, a.high == 0.0
    both = Interval(least(b.low, c.low), greatest(b.high, c.high), greatest(BREAKS, _worst(b, c)))
    branches = zip(b, c, both, strict=True)
    return settled(*(choose(always, first, choose(never, second, either)) for first, second, either in branches))


def _judged(a: Interval, b: Interval, always: Truth, never: Truth) -> Interval:
    """Enclose a truth: 1, 0, or from 0 to 1 where it is undecided, as for a nan, which is neither less nor more."""
    known = _worst(a, b) < UNBOUNDED
    return Interval(choose(known & always, 1.0, 0.0), choose(known & never, 0.0, 1.0))


def _tangent(of: Intervals, a: Interval) -> Interval:
    """Nothing is known of a tangent where there may be a pole."""
    slack = _slack(a)
    turned = floor((a.high + slack) / pi + 0.5) != floor((a.low - slack) / pi + 0.5)
    return _either((a.high - a.low >= 3.0) | turned, Interval(-inf, inf, UNBOUNDED), of.monotone("tan", *a))


def _within_one(a: Interval) -> Interval:
    """Return what an arcsine is defined for."""
    low, high = (least(1.0, greatest(-1.0, x)) for x in a[:2])
    return Interval(low, high, choose((a.low < -1.0) | (a.high > 1.0), UNBOUNDED, a.flaw))


def _logarithm(of: Intervals, a: Interval) -> Interval:
    undefined = a.low <= 0.0
    return of.monotone("log", choose(undefined, 0.0, a.low), a.high, choose(undefined, UNBOUNDED, a.flaw))


def _power(of: Intervals, a: Interval, b: Interval) -> Interval:
    """Raise to a power that is not whole: by logarithms, which are moved by a share to cover rounding."""
    undefined, ends = a.low < 0.0, []
    for x, slack in ((choose(undefined, 0.0, a.low), -ULPS), (a.high, ULPS)):
        itself = (x <= 0.0) | (x == inf)
        logarithm = b.low * of.functions["log"](choose(itself, 1.0, x))
        ends.append(choose(itself, x, of.functions["exp"](logarithm + slack * absolute(logarithm))))
    return of.ordered(ends[0], ends[1], choose(undefined, UNBOUNDED, a.flaw))


def _hypotenuse(of: Intervals, a: Interval, b: Interval) -> Interval:
    shortest, longest = (_length(x, y) for x, y in zip(_sizes(a), _sizes(b), strict=True))
    low = greatest(0.0, below(shortest - ULPS * shortest, of.margin))
    return settled(low, above(longest + ULPS * longest, of.margin), _worst(a, b))


def _angle(of: Intervals, a: Interval, b: Interval) -> Interval:
    """Enclose the angle of a vector: it jumps at the cut, and the origin has none."""
    cut = (b.low <= 0.0) & ((a.low <= 0.0) & (a.high >= 0.0))
    angles = []
    for y, x in ((y, x) for y in a[:2] for x in b[:2]):
        flat = absolute(x) >= absolute(y)
        turned = of.functions["atan"](quotient(choose(flat, y, x), choose(flat, x, y)))
        behind = choose(y >= 0.0, turned + pi, turned - pi)
        upright = choose(y > 0.0, pi / 2.0, -pi / 2.0)
        angles.append(choose(flat, choose(x > 0.0, turned, behind), upright - turned))
    low, high, flaw = least(*angles), greatest(*angles), _worst(a, b)
    angle = of.outward(low - ULPS * absolute(low), high + ULPS * absolute(high), flaw)
    return _either(cut, Interval(-pi - ULPS, pi + ULPS, greatest(flaw, BREAKS)), angle)


def _wave(name: str, shift: float, of: Intervals, a: Interval) -> Interval:
    """Enclose a sine (`shift` 0.5) or a cosine (`shift` 0): its values at the ends, and the crests between."""
    function, slack, (low, high, flaw) = of.functions[name], _slack(a), a
    narrow = (high - low < 2.0 * pi) & ((absolute(low) < LARGEST_ANGLE) & (absolute(high) < LARGEST_ANGLE))
    finite = (absolute(low) < inf) & (absolute(high) < inf)
    if of.rough:
        middle, half = function((low + high) / 2.0), (high - low) / 2.0 + slack
        bottom, top = middle - half, middle + half
    else:
        at_low, at_high = function(low), function(high)
        first, last = (low - slack) / pi - shift, (high + slack) / pi - shift  # crests at even, troughs at odd numbers
        top = choose(_meets(first, last), 1.0, greatest(at_low, at_high))
        bottom = choose(_meets(first - 1.0, last - 1.0), -1.0, least(at_low, at_high))
        bottom, top = (
            below(bottom - ULPS * absolute(bottom), of.margin),
            above(top + ULPS * absolute(top), of.margin),
        )
    low, high = choose(narrow, greatest(-1.0, bottom), -1.0), choose(narrow, least(1.0, top), 1.0)
    return settled(low, high, choose(finite, flaw, UNBOUNDED))


BY_ZERO = ("add", "subtract", "multiply", "divide")


def with_zeros(operation: str, found: Interval, a: Interval, b: Interval) -> Interval:
    """Return the result of an operation, exact where an operand is zero, which rounding would widen."""
    a_zero, b_zero = ((x.low == 0.0) & (x.high == 0.0) for x in (a, b))
    low, high = found.low, found.high
    if operation == "multiply":
        low, high = (choose(a_zero | b_zero, 0.0, end) for end in (low, high))
    elif operation == "divide":  # by what is not zero
        nothing = a_zero & (found.flaw < UNBOUNDED)
        low, high = (choose(nothing, 0.0, end) for end in (low, high))
    elif operation == "add":
        low = choose(b_zero, a.low, choose(a_zero, b.low, low))
        high = choose(b_zero, a.high, choose(a_zero, b.high, high))
    else:
        low = choose(b_zero, a.low, choose(a_zero, -b.high, low))
        high = choose(b_zero, a.high, choose(a_zero, -b.low, high))
    return Interval(low, high, found.flaw)


def _meets(first: Number, last: Number) -> Truth:
    """Whether an even number lies between two."""
    return floor(last / 2.0) >= -floor(-(first / 2.0))


def _worst(a: Interval, b: Interval) -> Whole:
    return greatest(a.flaw, b.flaw)


def _sizes(a: Interval) -> tuple[Number, Number]:
    """Return the least and the greatest absolute value."""
    one, other = absolute(a.low), absolute(a.high)
    return choose((a.low < 0.0) & (a.high > 0.0), 0.0, least(one, other)), greatest(one, other)


def _sign(x: Number) -> Number:
    return choose(x > 0.0, 1.0, choose(x < 0.0, -1.0, choose(x == 0.0, 0.0, x)))


def _same(a: Interval, b: Interval) -> Truth:
    return (a.low == a.high) & ((a.high == b.low) & (b.low == b.high))


def _apart(a: Interval, b: Interval) -> Truth:
    return (a.high < b.low) | (a.low > b.high)


def _slack(a: Interval) -> Number:
    return ULPS * (absolute(a.low) + absolute(a.high) + 1.0)


def _length(x: Number, y: Number) -> Number:
    """Return the length of a vector of two sizes, without overflow."""
    large, small = greatest(x, y), least(x, y)
    ratio = quotient(small, large)
    return choose((large > 0.0) & (large < inf), large * sqrt(1.0 + ratio * ratio), large)


def _either(truth: Truth, a: Interval, b: Interval) -> Interval:
    return Interval(*(choose(truth, *pair) for pair in zip(a, b, strict=True)))


_RULES: Mapping[str, Callable[..., Any]] = {
    "point": lambda _, x: Interval(x, x),
    "between": lambda _, low, high: Interval(low, high),
    "low": lambda _, a: a.low,
    "high": lambda _, a: a.high,
    "flaw": lambda _, a: choose(a.flaw == SMOOTH, choose(a.low == a.low, 0.0, 1.0), 1.0),
    "flawed": lambda _, low, high, flaw: Interval(low, high, choose(flaw == 0.0, SMOOTH, UNBOUNDED)),
    "add": lambda of, a, b: of.outward(a.low + b.low, a.high + b.high, _worst(a, b)),
    "subtract": lambda of, a, b: of.outward(a.low - b.high, a.high - b.low, _worst(a, b)),
    "multiply": lambda of, a, b: _product(of, a, b.low, b.high, _worst(a, b)),
    "square": _square,
    "divide": _quotient,
    "negative": lambda _, a: Interval(-a.high, -a.low, a.flaw),
    "abs": lambda _, a: settled(*_sizes(a), a.flaw),
    "sign": _signs,
    "sqrt": _root,
    "floor": partial(_stepped, floor),
    "ceil": partial(_stepped, ceiling),
    "round": partial(_stepped, nearest),
    "mod": _remainder,
    "least": lambda _, a, b: settled(least(a.low, b.low), least(a.high, b.high), _worst(a, b)),
    "greatest": lambda _, a, b: settled(greatest(a.low, b.low), greatest(a.high, b.high), _worst(a, b)),
    "positive": lambda _, a: a._replace(flaw=choose(a.low > 0.0, a.flaw, UNBOUNDED)),
    "choose": _choice,
    "less": lambda _, a, b: _judged(a, b, a.high < b.low, a.low >= b.high),
    "at_most": lambda _, a, b: _judged(a, b, a.high <= b.low, a.low > b.high),
    "more": lambda _, a, b: _judged(a, b, a.low > b.high, a.high <= b.low),
    "at_least": lambda _, a, b: _judged(a, b, a.low >= b.high, a.high < b.low),
    "equal": lambda _, a, b: _judged(a, b, _same(a, b), _apart(a, b)),
    "unequal": lambda _, a, b: _judged(a, b, _apart(a, b), _same(a, b)),
    **{name: lambda of, a, name=name: of.monotone(name, *a) for name in ("exp", "atan", "sinh", "tanh")},
    **{name: lambda of, a, name=name: of.monotone(name, *_within_one(a)) for name in ("asin", "acos")},
    "cosh": lambda of, a: of.monotone("cosh", *_sizes(a), a.flaw),
    "sin": partial(_wave, "sin", 0.5),
    "cos": partial(_wave, "cos", 0.0),
    "tan": _tangent,
    "log": _logarithm,
    "power": _power,
    "hypot": _hypotenuse,
    "atan2": _angle,
    **{name: lambda of, *given, rule=rule: rule(of.margin, *given) for name, rule in {**HERMITE, **CURVED}.items()},
}
