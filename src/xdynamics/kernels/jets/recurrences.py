"""Recurrences of Taylor coefficients: the next coefficient of a function from its arguments and its own before.

Each function solves a differential equation with rational coefficients, of which the recurrence is the comparison of
powers: Griewank and Walther, Evaluating Derivatives, 2nd ed., section 13.2, tables 13.1 and 13.2; Jorba and Zou 2005,
Exp. Math. 14, 99, proposition 2.1. With k for the order and ' for `slope_series`, k times the coefficient:

    exp   e' = a' e               sin, cos    s' = a' c,  c' = -a' s
    log   a l' = a'               tan         t' = a' (1 + t**2)
    pow   a p' = r a' p           asin        s' sqrt(1 - a**2) = a'

Functions with a corner keep to the side on which the value lies; at the corner to that on which the motion goes on.
Where a root is of zero its series has no further coefficients; the error estimate knows of that, and the step is short.

A series is a row of coefficients, the value of the program being the first; those of values that do not change with
time are zero but for that. There are two ways to write them: each coefficient as a value of its own, for small
programs, or in memory, by a loop over orders, for the others. The operations are those of any kind of number that a
printer knows. A quotient by a value that is constant over all orders is a product with its reciprocal.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import NamedTuple, Protocol

from xdynamics.kernels.program import Location, Operand

MEMORY, ORDER, TERM = "w", "_order", "_term"  # array of the coefficients; indices of loops over orders and over terms
# of the order k: (k - 1)//2, as many pairs of terms; whether there is a term in their middle, and k/2, which it is
HALF, ODD, MIDDLE = "_half", "_odd", "_middle"


@dataclass(eq=False)
class Series:
    """The coefficients of a value.

    Attributes
    ----------
    constant : bool
        Whether the value does not change with time.
    truth : bool
        Whether it is a comparison, which is in memory as 1 or 0.
    terms : dict of int to operand
        Coefficients that are values of the text: all of them, or the first alone.
    location : Place, optional
        Where the first coefficient is, of series in memory.
    stride : int
        How far a coefficient is from the one before.
    read : bool
        Whether a coefficient is read from memory.
    square : Series, optional
        That of which it is the square root.
    scaled : (Series, Operand), optional
        What it is a multiple of, and the factor.
    made : (str, tuple of Series), optional
        Of which others it is the sum, or the difference: its coefficients are computed again wherever they are read, as
        those of two bodies take less room than those of every two.
    """

    constant: bool = False
    truth: bool = False
    terms: dict[int, Operand] = field(default_factory=dict)
    location: Location | None = None
    stride: int = 1
    read: bool = False
    square: Series | None = None
    scaled: tuple[Series, Operand] | None = None
    made: tuple[str, tuple[Series, ...]] | None = None
    parts: dict[str, Series] = field(default_factory=dict)


class Order(Protocol):
    """The lines of one order: 0 is that of the values themselves."""

    fused: bool  # whether products are added by fma, and what is divided by is kept as a reciprocal
    high: bool  # whether coefficients are so small that reciprocals of 53 bits do

    @property
    def number(self) -> Operand:
        """The order as a number."""

    def divide_by_order(self, value: Operand) -> Operand:
        """Return a value over the order, by which a coefficient of a rate becomes the next one of its integral."""

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation; return its operand."""

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total."""

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1, at orders above 0."""

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum a[j]*b[k - j] over j from `skip` to k, but for a skip of 2 over j from 1 to k - 1."""

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another, as the cosine with a sine."""

    def keep(self, series: Series, value: Operand) -> None:
        """Set the coefficient of this order."""

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written."""

    def read(self, location: Location) -> Operand:
        """Read a number that does not change."""


def has_pairs(source: str) -> bool:
    """Whether a law, printed as Python, has sums of products by pairs of terms."""
    return f" {HALF} = " in source


def reciprocal(number: float) -> tuple[float, float]:
    """Return the reciprocal of a number as the sum of two floats.

    Examples
    --------
    >>> reciprocal(4), reciprocal(3)
    ((0.25, 0.0), (0.3333333333333333, 1.850371707708594e-17))
    """
    nearest = 1.0 / number
    return nearest, float(1 / Fraction(number) - Fraction(nearest))


def slope_series(order: Order, series: Series) -> Series:
    """Return the series whose coefficients are k times those of another: that of its derivative times the time."""
    rising = order.part(series, "slope")
    if order.knows(rising):
        return rising
    if series.constant:
        rising.constant = True
        rising.terms[0] = 0.0
    elif order.number == 0.0:
        order.keep(rising, 0.0)
    else:
        order.keep(rising, order.compute("multiply", order.number, order.now(series)))
    return rising


def begin_quotient(order: Order, target: Series, divisor: Operand) -> None:
    """Store the reciprocal, to 106 bits, of the value that divides all coefficients."""
    if not order.fused or _is_literal(divisor):
        return
    nearest, low_part = (order.part(target, name) for name in ("reciprocal", "rest"))
    nearest.constant = low_part.constant = True
    order.keep(nearest, order.compute("divide", 1.0, divisor))
    # the remainder of a division is a float, and one fma finds it without an error
    left = order.compute("fma", order.compute("negative", divisor), order.now(nearest), 1.0)
    order.keep(low_part, order.compute("divide", left, divisor))


def divide_coefficient(order: Order, target: Series, value: Operand, divisor: Operand) -> Operand:
    """Divide by the divisor of `begin_quotient`: rounded to nearest as a division is, in half the time."""
    if not order.fused:
        return order.compute("divide", value, divisor)
    nearest, low_part = _reciprocal(order, target, divisor)
    if order.high or low_part == 0.0:
        return order.compute("multiply", value, nearest)
    return order.compute("fma", value, nearest, order.compute("multiply", value, low_part))


def _reciprocal(order: Order, target: Series, divisor: Operand) -> tuple[Operand, Operand]:
    """Return the reciprocal of a divisor as a float and its rest."""
    if _is_literal(divisor):
        return reciprocal(float(divisor))
    nearest, low_part = (order.first(order.part(target, name)) for name in ("reciprocal", "rest"))
    return nearest, low_part


def multiple_of(order: Order, name: str, target: Series, operands: Sequence[Series]) -> tuple[Series, Operand] | None:
    """Return the series and the constant factor of which another series is the product; else None."""
    match name, operands:
        case "negative", (of,):
            return of, -1.0
        case "multiply", (a, b) if a.constant != b.constant:
            return (b, order.first(a)) if a.constant else (a, order.first(b))
        case "divide", (a, b) if b.constant and order.fused:
            return a, _reciprocal(order, target, order.first(b))[0]
    return None


def _is_literal(divisor: Operand) -> bool:
    """Whether it is a literal, of which the reciprocal is known when the program is written."""
    # within these neither the reciprocal nor its rest over- or underflows
    return not isinstance(divisor, str) and 1e-150 < abs(divisor) < 1e150


def or_nothing(order: Order, divisor: Operand, value: Operand) -> Operand:
    """Return a coefficient, or 0 where its divisor is 0."""
    return order.compute("choose", order.compute("equal", divisor, 0.0), 0.0, value)


Recurrence = Callable[..., Operand]  # of an order, the function's series and those of its arguments


class Rule(NamedTuple):
    """A function's recurrence, and the further values that it needs at order 0."""

    following: Recurrence
    beginning: Callable[..., None] = lambda *_: None


def _negated(order: Order, value: Operand) -> Operand:
    return order.compute("negative", value)


# ---------------------------------------------------------------------------------------------------------- arithmetic


def _slope_before(order: Order, target: Series) -> Series:
    """Return the series of k times the coefficients, of which that of this order is not known yet."""
    return order.part(target, "slope")


def _termwise(operation: str) -> Rule:
    def following(order: Order, _target: Series, *operands: Series) -> Operand:
        return order.compute(operation, *map(order.now, operands))

    return Rule(following)


def _product_coefficient(order: Order, _target: Series, a: Series, b: Series) -> Operand:
    if a is b and a.square is not None:
        return order.now(a.square)
    return order.convolution(a, b)


def _begin_quotient_rule(order: Order, target: Series, _a: Series, b: Series) -> None:
    begin_quotient(order, target, order.first(b))


def _quotient_coefficient(order: Order, target: Series, a: Series, b: Series) -> Operand:
    numerator = (
        order.now(a) if b.constant else order.compute("subtract", order.now(a), order.convolution(b, target, skip=1))
    )
    return divide_coefficient(order, target, numerator, order.first(b))


def _begin_root(order: Order, target: Series, *operands: Series) -> None:
    begin_quotient(order, target, _doubled_first(order, target))
    if len(operands) == 1:
        target.square = operands[0]


def _doubled_first(order: Order, target: Series) -> Operand:
    return order.compute("add", order.first(target), order.first(target))


def _root_coefficient(order: Order, target: Series, a: Series) -> Operand:
    return _root_of_series(order, target, order.now(a))


def _root_of_series(order: Order, target: Series, now: Operand) -> Operand:
    """The next coefficient of the root of a series, by that of the series."""
    numerator = order.compute("subtract", now, order.convolution(target, target, skip=2))
    twice = _doubled_first(order, target)
    return or_nothing(order, twice, divide_coefficient(order, target, numerator, twice))


def _begin_power(order: Order, target: Series, a: Series, _exponent: Series) -> None:
    begin_quotient(order, target, order.first(a))


def _power_coefficient(order: Order, target: Series, a: Series, exponent: Series) -> Operand:
    rising = order.convolution(slope_series(order, a), target, skip=1)
    older_terms = order.convolution(_slope_before(order, target), a, skip=2)
    top = order.compute("subtract", order.compute("multiply", order.first(exponent), rising), older_terms)
    return or_nothing(
        order, order.first(a), order.divide_by_order(divide_coefficient(order, target, top, order.first(a)))
    )


# ------------------------------------------------------------------------------------------------------- transcendental


def _with_slope(order: Order, _target: Series, a: Series) -> None:
    slope_series(order, a)


def _exp_coefficient(order: Order, target: Series, a: Series) -> Operand:
    return order.divide_by_order(order.convolution(slope_series(order, a), target, skip=1))


def _quotient_of_slopes(order: Order, target: Series, rising: Operand, divisor: Series) -> Operand:
    """Return the next coefficient of y from y' d, which is known: k y[k] is the rest of the product over d[0]."""
    numerator = order.compute("subtract", rising, order.convolution(_slope_before(order, target), divisor, skip=2))
    return order.divide_by_order(divide_coefficient(order, target, numerator, order.first(divisor)))


def _begin_log(order: Order, target: Series, a: Series) -> None:
    begin_quotient(order, target, order.first(a))


def _log_coefficient(order: Order, target: Series, a: Series) -> Operand:
    return _quotient_of_slopes(order, target, order.now(slope_series(order, a)), a)


def _coupled_pair(partner_name: str, sign: str, other_sign: str) -> Rule:
    """Return the rule of two functions, each the slope of the other but for signs, with the partner as a part."""

    def beginning(order: Order, target: Series, a: Series) -> None:
        order.keep(order.part(target, partner_name), order.compute(partner_name, order.first(a)))
        slope_series(order, a)

    def following(order: Order, target: Series, a: Series) -> Operand:
        rising, partner = slope_series(order, a), order.part(target, partner_name)
        first = order.divide_by_order(order.convolution(rising, partner, skip=1))
        second = order.divide_by_order(order.convolution(rising, target, skip=1))
        order.keep(partner, second if other_sign == "+" else _negated(order, second))
        return first if sign == "+" else _negated(order, first)

    return Rule(following, beginning)


def _by_square(sign: str) -> Rule:
    """Return the rule of a function with slope 1 plus or minus its square."""

    def square(order: Order, target: Series) -> Operand:
        return order.convolution(target, target)

    def beginning(order: Order, target: Series, a: Series) -> None:
        operation = "add" if sign == "+" else "subtract"
        order.keep(order.part(target, "square"), order.compute(operation, 1.0, square(order, target)))
        slope_series(order, a)

    def following(order: Order, target: Series, a: Series) -> Operand:
        part = order.part(target, "square")
        coefficient = order.divide_by_order(order.convolution(slope_series(order, a), part, skip=1))
        order.keep(target, coefficient)
        value = square(order, target)
        order.keep(part, value if sign == "+" else _negated(order, value))
        return coefficient

    return Rule(following, beginning)


def _with_slopes(rule: Recurrence, begin: Callable[..., None] = lambda *_: None) -> Rule:
    """Return the rule of functions whose recurrence reads k times their own coefficients."""

    def beginning(order: Order, target: Series, *operands: Series) -> None:
        order.keep(_slope_before(order, target), 0.0)
        for series in operands:
            slope_series(order, series)
        begin(order, target, *operands)

    def following(order: Order, target: Series, *operands: Series) -> Operand:
        coefficient = rule(order, target, *operands)
        order.keep(_slope_before(order, target), order.compute("multiply", order.number, coefficient))
        return coefficient

    return Rule(following, beginning)


def _one_more_than_square(order: Order, target: Series, a: Series) -> None:
    order.keep(order.part(target, "squares"), order.compute("add", 1.0, order.convolution(a, a)))
    begin_quotient(order, target, order.now(order.part(target, "squares")))


def _sum_of_squares(order: Order, target: Series, y: Series, x: Series) -> None:
    total = order.compute("add", order.convolution(y, y), order.convolution(x, x))
    order.keep(order.part(target, "squares"), total)
    begin_quotient(order, target, total)


def _atan_coefficient(order: Order, target: Series, a: Series) -> Operand:
    squares = order.part(target, "squares")
    order.keep(squares, order.convolution(a, a))
    return _quotient_of_slopes(order, target, order.now(slope_series(order, a)), squares)


def _atan2_coefficient(order: Order, target: Series, y: Series, x: Series) -> Operand:
    squares = order.part(target, "squares")
    order.keep(squares, order.compute("add", order.convolution(y, y), order.convolution(x, x)))
    turning = order.convolution(slope_series(order, y), x, skip=1), order.convolution(slope_series(order, x), y, skip=1)
    return _quotient_of_slopes(order, target, order.compute("subtract", *turning), squares)


def _hypot_coefficient(order: Order, target: Series, a: Series, b: Series) -> Operand:
    return _root_of_series(order, target, order.compute("add", order.convolution(a, a), order.convolution(b, b)))


def _arc_rule(*, negated: bool) -> Rule:
    """Return the rule of asin and acos: by the argument they have the slopes plus and minus 1/sqrt(1 - a**2)."""

    def begin_root(order: Order, target: Series, a: Series) -> None:
        # (1 - a)*(1 + a) keeps the digits that 1 - a**2 loses near 1
        value = order.first(a)
        product = order.compute("multiply", order.compute("subtract", 1.0, value), order.compute("add", 1.0, value))
        root = order.part(target, "root")
        order.keep(root, order.compute("sqrt", product))
        _begin_root(order, root)
        begin_quotient(order, target, order.now(root))

    def rule(order: Order, target: Series, a: Series) -> Operand:
        root, rising = order.part(target, "root"), order.now(slope_series(order, a))
        order.keep(root, _root_of_series(order, root, _negated(order, order.convolution(a, a))))
        coefficient = _quotient_of_slopes(order, target, _negated(order, rising) if negated else rising, root)
        return or_nothing(order, order.first(root), coefficient)

    return _with_slopes(rule, begin_root)


# ------------------------------------------------------------------------------------------------------------- corners


def _argument_coefficient(order: Order, _target: Series, a: Series) -> Operand:
    return order.now(a)


def _is_negative_ahead(order: Order, first: Operand, second: Operand) -> Operand:
    """Return whether a value is negative, or at zero about to be."""
    going = order.compute("choose", order.compute("equal", first, 0.0), second, first)
    return order.compute("less", going, 0.0)


def _abs_coefficient(order: Order, _target: Series, a: Series) -> Operand:
    negative, now = _is_negative_ahead(order, order.first(a), order.second(a)), order.now(a)
    return order.compute("choose", negative, _negated(order, now), now)


def _extreme_rule(*, is_least: bool) -> Rule:
    def following(order: Order, _target: Series, a: Series, b: Series) -> Operand:
        ahead = (
            order.compute("subtract", coefficient_of(a), coefficient_of(b))
            for coefficient_of in (order.first, order.second)
        )
        lower, pair = _is_negative_ahead(order, *ahead), (order.now(a), order.now(b))
        return order.compute("choose", lower, *(pair if is_least else pair[::-1]))

    return Rule(following)


def _choice_coefficient(order: Order, _target: Series, truth: Series, a: Series, b: Series) -> Operand:
    return order.compute("choose", order.first(truth), order.now(a), order.now(b))


def _remainder_coefficient(order: Order, target: Series, a: Series, b: Series) -> Operand:
    """Return the next coefficient of the remainder of a after integer multiples of b."""
    if b.constant:
        return order.now(a)
    whole_turns = order.compute("subtract", order.first(a), order.first(target))
    turns = order.compute("round", order.compute("divide", whole_turns, order.first(b)))
    return order.compute("subtract", order.now(a), order.compute("multiply", turns, order.now(b)))


# -------------------------------------------------------------------------------------------------------------- tables


def _cubic_rule(*names: str, factors: tuple[float, ...]) -> Rule:
    """Return the rule of a table's piece, by its derivatives over factorials and powers of the argument's change."""

    def beginning(order: Order, target: Series, a: Series, piece: Series, drive: int) -> None:
        for name, factor in zip(names, factors, strict=True):
            part = order.part(target, name)
            part.constant = True
            derivative = order.compute(name, order.first(a), order.first(piece), drive)
            order.keep(part, order.compute("multiply", factor, derivative))
        for power in ("way", "square", "cube"):
            order.keep(order.part(target, power), 0.0)

    def following(order: Order, target: Series, a: Series, _piece: Series, _drive: int) -> Operand:
        displacement, square, cube = (order.part(target, power) for power in ("way", "square", "cube"))
        order.keep(displacement, order.now(a))
        order.keep(square, order.convolution(displacement, displacement, skip=2))
        order.keep(cube, order.convolution(displacement, square, skip=2))
        total: Operand = 0.0
        for name, power in zip(names, (displacement, square, cube), strict=False):
            total = order.compute(
                "add", total, order.compute("multiply", order.first(order.part(target, name)), order.now(power))
            )
        return total

    return Rule(following, beginning)


RULES: Mapping[str, Rule] = {
    "add": _termwise("add"),
    "subtract": _termwise("subtract"),
    "negative": _termwise("negative"),
    "multiply": Rule(_product_coefficient),
    "divide": Rule(_quotient_coefficient, _begin_quotient_rule),
    "sqrt": Rule(_root_coefficient, _begin_root),
    "power": _with_slopes(_power_coefficient, _begin_power),
    "exp": Rule(_exp_coefficient, _with_slope),
    "log": _with_slopes(_log_coefficient, _begin_log),
    "sin": _coupled_pair("cos", "+", "-"),
    "cos": _coupled_pair("sin", "-", "+"),
    "sinh": _coupled_pair("cosh", "+", "+"),
    "cosh": _coupled_pair("sinh", "+", "+"),
    "tan": _by_square("+"),
    "tanh": _by_square("-"),
    "asin": _arc_rule(negated=False),
    "acos": _arc_rule(negated=True),
    "atan": _with_slopes(_atan_coefficient, _one_more_than_square),
    "atan2": _with_slopes(_atan2_coefficient, _sum_of_squares),
    "hypot": Rule(_hypot_coefficient, _begin_root),
    "abs": Rule(_abs_coefficient),
    "least": _extreme_rule(is_least=True),
    "greatest": _extreme_rule(is_least=False),
    "choose": Rule(_choice_coefficient),
    "mod": Rule(_remainder_coefficient),
    "positive": Rule(_argument_coefficient),
    "value_at": _cubic_rule("slope_at", "bend_at", "cube_at", factors=(1.0, 1.0, 1.0)),
    "slope_at": _cubic_rule("bend_at", "cube_at", factors=(2.0, 3.0)),
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
