"""How the next coefficient of a function's series follows from those of its arguments and its own before.

Each function solves a differential equation with rational coefficients, of which the recurrence is the comparison of
powers: Griewank and Walther, Evaluating Derivatives, 2nd ed., section 13.2, tables 13.1 and 13.2; Jorba and Zou 2005,
Exp. Math. 14, 99, proposition 2.1. With k for the order and ' for `series.slope`, k times the coefficient:

    exp   e' = a' e               sin, cos    s' = a' c,  c' = -a' s
    log   a l' = a'               tan         t' = a' (1 + t**2)
    pow   a p' = r a' p           asin        s' sqrt(1 - a**2) = a'

Functions with a corner keep to the side on which the value lies; at the corner to that on which the motion goes on.
Where a root is of zero its series has no further coefficients; the error estimate knows of that, and the step is short.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

from xdynamics.kernels.jets.quotients import begin_quotient, divided, or_nothing
from xdynamics.kernels.jets.series import Order, Series, slope
from xdynamics.kernels.program import Operand

Recurrence = Callable[..., Operand]  # of an order, the function's series and those of its arguments


class Rule(NamedTuple):
    """A function's recurrence, and what is to be known at order 0 besides its value."""

    following: Recurrence
    beginning: Callable[..., None] = lambda *_: None


def _turned(order: Order, value: Operand) -> Operand:
    return order.compute("negative", value)


# ---------------------------------------------------------------------------------------------------------- arithmetic


def _slope_before(order: Order, own: Series) -> Series:
    """Return the series of k times the coefficients, of which that of this order is not known yet."""
    return order.part(own, "slope")


def _each(operation: str) -> Rule:
    def following(order: Order, _own: Series, *given: Series) -> Operand:
        return order.compute(operation, *map(order.now, given))

    return Rule(following)


def _product(order: Order, _own: Series, a: Series, b: Series) -> Operand:
    if a is b and a.square is not None:
        return order.now(a.square)
    return order.convolution(a, b)


def _quotient_begun(order: Order, own: Series, _a: Series, b: Series) -> None:
    begin_quotient(order, own, order.first(b))


def _quotient(order: Order, own: Series, a: Series, b: Series) -> Operand:
    rest = order.now(a) if b.constant else order.compute("subtract", order.now(a), order.convolution(b, own, skip=1))
    return divided(order, own, rest, order.first(b))


def _root_begun(order: Order, own: Series, *given: Series) -> None:
    begin_quotient(order, own, _twice(order, own))
    if len(given) == 1:
        own.square = given[0]


def _twice(order: Order, own: Series) -> Operand:
    return order.compute("add", order.first(own), order.first(own))


def _root(order: Order, own: Series, a: Series) -> Operand:
    return _root_of(order, own, order.now(a))


def _root_of(order: Order, own: Series, now: Operand) -> Operand:
    """The next coefficient of the root of a series, by that of the series."""
    rest = order.compute("subtract", now, order.convolution(own, own, skip=2))
    twice = _twice(order, own)
    return or_nothing(order, twice, divided(order, own, rest, twice))


def _power_begun(order: Order, own: Series, a: Series, _exponent: Series) -> None:
    begin_quotient(order, own, order.first(a))


def _power(order: Order, own: Series, a: Series, exponent: Series) -> Operand:
    rising = order.convolution(slope(order, a), own, skip=1)
    rest = order.convolution(_slope_before(order, own), a, skip=2)
    top = order.compute("subtract", order.compute("multiply", order.first(exponent), rising), rest)
    return or_nothing(order, order.first(a), order.over(divided(order, own, top, order.first(a))))


# ------------------------------------------------------------------------------------------------------- transcendental


def _with_slope(order: Order, _own: Series, a: Series) -> None:
    slope(order, a)


def _exp(order: Order, own: Series, a: Series) -> Operand:
    return order.over(order.convolution(slope(order, a), own, skip=1))


def _quotient_of_slopes(order: Order, own: Series, rising: Operand, divisor: Series) -> Operand:
    """The next coefficient of y where y' d is known: k times that of y' is what is left of it, over d[0]."""
    rest = order.compute("subtract", rising, order.convolution(_slope_before(order, own), divisor, skip=2))
    return order.over(divided(order, own, rest, order.first(divisor)))


def _log_begun(order: Order, own: Series, a: Series) -> None:
    begin_quotient(order, own, order.first(a))


def _log(order: Order, own: Series, a: Series) -> Operand:
    return _quotient_of_slopes(order, own, order.now(slope(order, a)), a)


def _pair(other: str, sign: str, other_sign: str) -> Rule:
    """Of two functions, each the slope of the other but for signs: the other is a part of the one."""

    def beginning(order: Order, own: Series, a: Series) -> None:
        order.keep(order.part(own, other), order.compute(other, order.first(a)))
        slope(order, a)

    def following(order: Order, own: Series, a: Series) -> Operand:
        rising, partner = slope(order, a), order.part(own, other)
        first = order.over(order.convolution(rising, partner, skip=1))
        second = order.over(order.convolution(rising, own, skip=1))
        order.keep(partner, second if other_sign == "+" else _turned(order, second))
        return first if sign == "+" else _turned(order, first)

    return Rule(following, beginning)


def _by_square(sign: str) -> Rule:
    """Of a function whose slope is 1 plus or minus its square."""

    def square(order: Order, own: Series) -> Operand:
        return order.convolution(own, own)

    def beginning(order: Order, own: Series, a: Series) -> None:
        operation = "add" if sign == "+" else "subtract"
        order.keep(order.part(own, "square"), order.compute(operation, 1.0, square(order, own)))
        slope(order, a)

    def following(order: Order, own: Series, a: Series) -> Operand:
        part = order.part(own, "square")
        found = order.over(order.convolution(slope(order, a), part, skip=1))
        order.keep(own, found)
        value = square(order, own)
        order.keep(part, value if sign == "+" else _turned(order, value))
        return found

    return Rule(following, beginning)


def _with_slopes(rule: Recurrence, begun: Callable[..., None] = lambda *_: None) -> Rule:
    """Of functions whose recurrence reads k times their own coefficients."""

    def beginning(order: Order, own: Series, *given: Series) -> None:
        order.keep(_slope_before(order, own), 0.0)
        for series in given:
            slope(order, series)
        begun(order, own, *given)

    def following(order: Order, own: Series, *given: Series) -> Operand:
        found = rule(order, own, *given)
        order.keep(_slope_before(order, own), order.compute("multiply", order.number, found))
        return found

    return Rule(following, beginning)


def _one_more_than_square(order: Order, own: Series, a: Series) -> None:
    order.keep(order.part(own, "squares"), order.compute("add", 1.0, order.convolution(a, a)))
    begin_quotient(order, own, order.now(order.part(own, "squares")))


def _sum_of_squares(order: Order, own: Series, y: Series, x: Series) -> None:
    total = order.compute("add", order.convolution(y, y), order.convolution(x, x))
    order.keep(order.part(own, "squares"), total)
    begin_quotient(order, own, total)


def _atan(order: Order, own: Series, a: Series) -> Operand:
    squares = order.part(own, "squares")
    order.keep(squares, order.convolution(a, a))
    return _quotient_of_slopes(order, own, order.now(slope(order, a)), squares)


def _atan2(order: Order, own: Series, y: Series, x: Series) -> Operand:
    squares = order.part(own, "squares")
    order.keep(squares, order.compute("add", order.convolution(y, y), order.convolution(x, x)))
    turning = order.convolution(slope(order, y), x, skip=1), order.convolution(slope(order, x), y, skip=1)
    return _quotient_of_slopes(order, own, order.compute("subtract", *turning), squares)


def _hypot(order: Order, own: Series, a: Series, b: Series) -> Operand:
    return _root_of(order, own, order.compute("add", order.convolution(a, a), order.convolution(b, b)))


def _arc(*, turned: bool) -> Rule:
    """Of asin and acos: their slopes over those of the argument are plus and minus 1/sqrt(1 - a**2)."""

    def begun(order: Order, own: Series, a: Series) -> None:
        # (1 - a)*(1 + a) keeps the digits that 1 - a**2 loses near 1
        value = order.first(a)
        product = order.compute("multiply", order.compute("subtract", 1.0, value), order.compute("add", 1.0, value))
        root = order.part(own, "root")
        order.keep(root, order.compute("sqrt", product))
        _root_begun(order, root)
        begin_quotient(order, own, order.now(root))

    def rule(order: Order, own: Series, a: Series) -> Operand:
        root, rising = order.part(own, "root"), order.now(slope(order, a))
        order.keep(root, _root_of(order, root, _turned(order, order.convolution(a, a))))
        found = _quotient_of_slopes(order, own, _turned(order, rising) if turned else rising, root)
        return or_nothing(order, order.first(root), found)

    return _with_slopes(rule, begun)


# ------------------------------------------------------------------------------------------------------------- corners


def _still(_order: Order, _own: Series, *_given: Series) -> Operand:
    return 0.0


def _same(order: Order, _own: Series, a: Series) -> Operand:
    return order.now(a)


def _side(order: Order, first: Operand, second: Operand) -> Operand:
    """Return whether a value is negative, or at zero about to be."""
    going = order.compute("choose", order.compute("equal", first, 0.0), second, first)
    return order.compute("less", going, 0.0)


def _abs(order: Order, _own: Series, a: Series) -> Operand:
    negative, now = _side(order, order.first(a), order.second(a)), order.now(a)
    return order.compute("choose", negative, _turned(order, now), now)


def _extreme(*, least: bool) -> Rule:
    def following(order: Order, _own: Series, a: Series, b: Series) -> Operand:
        ahead = (order.compute("subtract", at(a), at(b)) for at in (order.first, order.second))
        lower, pair = _side(order, *ahead), (order.now(a), order.now(b))
        return order.compute("choose", lower, *(pair if least else pair[::-1]))

    return Rule(following)


def _choice(order: Order, _own: Series, truth: Series, a: Series, b: Series) -> Operand:
    return order.compute("choose", order.first(truth), order.now(a), order.now(b))


def _rest(order: Order, own: Series, a: Series, b: Series) -> Operand:
    """The next coefficient of what is left of a after whole turns of b."""
    if b.constant:
        return order.now(a)
    taken = order.compute("subtract", order.first(a), order.first(own))
    turns = order.compute("round", order.compute("divide", taken, order.first(b)))
    return order.compute("subtract", order.now(a), order.compute("multiply", turns, order.now(b)))


# -------------------------------------------------------------------------------------------------------------- tables


def _cubic(*names: str, factors: tuple[float, ...]) -> Rule:
    """Of a piece of a table, by what its derivatives over factorials are where the argument is, and powers of its way."""

    def beginning(order: Order, own: Series, a: Series, piece: Series, drive: int) -> None:
        for name, factor in zip(names, factors, strict=True):
            part = order.part(own, name)
            part.constant = True
            found = order.compute(name, order.first(a), order.first(piece), drive)
            order.keep(part, order.compute("multiply", factor, found))
        for power in ("way", "square", "cube"):
            order.keep(order.part(own, power), 0.0)

    def following(order: Order, own: Series, a: Series, _piece: Series, _drive: int) -> Operand:
        way, square, cube = (order.part(own, power) for power in ("way", "square", "cube"))
        order.keep(way, order.now(a))
        order.keep(square, order.convolution(way, way, skip=2))
        order.keep(cube, order.convolution(way, square, skip=2))
        total: Operand = 0.0
        for name, power in zip(names, (way, square, cube), strict=False):
            total = order.compute(
                "add", total, order.compute("multiply", order.first(order.part(own, name)), order.now(power))
            )
        return total

    return Rule(following, beginning)


RULES: Mapping[str, Rule] = {
    "add": _each("add"),
    "subtract": _each("subtract"),
    "negative": _each("negative"),
    "multiply": Rule(_product),
    "divide": Rule(_quotient, _quotient_begun),
    "sqrt": Rule(_root, _root_begun),
    "power": _with_slopes(_power, _power_begun),
    "exp": Rule(_exp, _with_slope),
    "log": _with_slopes(_log, _log_begun),
    "sin": _pair("cos", "+", "-"),
    "cos": _pair("sin", "-", "+"),
    "sinh": _pair("cosh", "+", "+"),
    "cosh": _pair("sinh", "+", "+"),
    "tan": _by_square("+"),
    "tanh": _by_square("-"),
    "asin": _arc(turned=False),
    "acos": _arc(turned=True),
    "atan": _with_slopes(_atan, _one_more_than_square),
    "atan2": _with_slopes(_atan2, _sum_of_squares),
    "hypot": Rule(_hypot, _root_begun),
    "abs": Rule(_abs),
    "least": _extreme(least=True),
    "greatest": _extreme(least=False),
    "choose": Rule(_choice),
    "mod": Rule(_rest),
    "positive": Rule(_same),
    "value_at": _cubic("slope_at", "bend_at", "cube_at", factors=(1.0, 1.0, 1.0)),
    "slope_at": _cubic("bend_at", "cube_at", factors=(2.0, 3.0)),
}
# steps in value, which stay as they are until the march lands on where they change
CONSTANT = frozenset(
    (
        "less",
        "at_most",
        "more",
        "at_least",
        "equal",
        "unequal",
        "sign",
        "floor",
        "ceil",
        "round",
        "find_piece",
        "piece_of",
    )
)
OTHER = {"sin": "cos", "cos": "sin", "sinh": "cosh", "cosh": "sinh"}  # whose series the recurrence makes along with one
