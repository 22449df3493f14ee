"""The numbers that elementary functions are written for: floats, arrays, and lines of a program that is being written.

Only operations that IEEE 754 makes the same on every machine: + - * / and square roots rounded to nearest, comparisons,
choices, and exact work on the 64 bits of a number. A function written so serves Python, NumPy and machine code.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from xdynamics.elementary.llvm_numbers import LaneValue
from xdynamics.elementary.tables import TABLES

Number = Any  # a float, an array of floats, or a written one
Integer = Any  # the same for whole numbers of 64 bits
Truth = Any

_FLOATS = struct.Struct("<d")
_WHOLES = struct.Struct("<q")
_ARRAYS = {name: np.array(table) for name, table in TABLES.items()}
UPPER_HALF = -(1 << 27)  # the bits of sign, exponent and 25 of the 52 others
MAGIC = 1.5 * 2.0**52  # numbers of this size are whole: a number added to it is rounded to a whole one
MAGIC_BITS = 0x4338000000000000
INF, NAN = math.inf, math.nan
LARGEST_FRACTION, LARGEST_TURNS = 2.0**51, 2.0**53  # from the first on all numbers count as whole here
FRACTION, ONE = (1 << 52) - 1, 1023 << 52  # bits of the fraction, of 1.0


def bits(x: Number) -> Integer:
    """Return the 64 bits of a number as a whole number."""
    if isinstance(x, float):
        return _WHOLES.unpack(_FLOATS.pack(x))[0]
    return x.view(np.int64) if isinstance(x, np.ndarray) else x.bits()


def number(w: Integer) -> Number:
    """Return the number that has these bits."""
    if isinstance(w, int):
        return _FLOATS.unpack(_WHOLES.pack(w))[0]
    return w.view(np.float64) if isinstance(w, np.ndarray) else w.number()


def choose(truth: Truth, yes: Any, no: Any) -> Any:
    """Return one of two values, both already computed."""
    if isinstance(truth, bool | np.bool_):
        return yes if truth else no
    return np.where(truth, yes, no) if isinstance(truth, np.ndarray) else truth.choose(yes, no)


def minimum_of_two(x: Number, y: Number) -> Number:
    """Return the smaller; nan if either is."""
    return choose((x < y) | (x != x), x, y)


def maximum_of_two(x: Number, y: Number) -> Number:
    """Return the larger; nan if either is."""
    return choose((x > y) | (x != x), x, y)


def sign(x: Number) -> Number:
    """Return 1, -1, or x if it is zero or nan."""
    return choose(x > 0.0, 1.0, choose(x < 0.0, -1.0, x))


def positive_or_nan(x: Number) -> Number:
    """Return x if it is positive, else nan."""
    return choose(x > 0.0, x, math.nan)


def usually(truth: Truth, usual: Callable[[], Any], unusual: Callable[[], Any]) -> Any:
    """Return the usual result where a truth holds, and elsewhere the unusual one, computed only if it is needed."""
    if isinstance(truth, bool | np.bool_):
        return usual() if truth else unusual()
    if isinstance(truth, LaneValue):
        return truth.usually(usual(), unusual)
    if truth.all():
        return usual()
    first, second = usual(), unusual()
    return (
        tuple(map(partial(np.where, truth), first, second))
        if isinstance(first, tuple)
        else np.where(truth, first, second)
    )


def repeat_while(truth: Callable[..., Truth], step: Callable[..., tuple[Any, ...]], *state: Any) -> tuple[Any, ...]:
    """Repeat a step while a truth holds; in lanes, while it holds in any, the others keeping their state.

    Of a written state every number is written; of arrays, a further step is to keep what has ended.
    """
    if isinstance(state[0], LaneValue):
        return state[0].repeated(truth, step, state)
    while np.any(truth(*state)):
        state = step(*state)
    return state


def sqrt(x: Number) -> Number:
    """Return the square root; nan below zero."""
    if isinstance(x, float):
        return math.sqrt(x) if x >= 0.0 else math.nan
    return np.sqrt(x) if isinstance(x, np.ndarray) else x.sqrt()


def floor(x: Number) -> Number:
    """Return the greatest whole number that is at most x."""
    if isinstance(x, LaneValue):
        return x.floor()
    return np.floor(x) if isinstance(x, np.ndarray) else float(np.floor(x))


def ceiling(x: Number) -> Number:
    """Return the least whole number that is at least x."""
    return -floor(-x)


def round_half_even(x: Number) -> Number:
    """Return the whole number nearest to x; of two equally near ones the even one, as Python's `round`."""
    return choose(absolute(x) < LARGEST_FRACTION, signed((absolute(x) + MAGIC) - MAGIC, x), x)


def significand(x: Number) -> Number:
    """Return a positive normal number over the largest power of two that it is not below."""
    return number((bits(x) & FRACTION) | ONE)


def exponent(x: Number) -> Number:
    """Return the power to which 2 is raised there."""
    return number((bits(x) >> 52) + (MAGIC_BITS - 1023)) - MAGIC


def binary_power(k: Number) -> Number:
    """Return 2**k of a number that is whole, from -1022 to 1023."""
    return power_of_two(bits(k + MAGIC) - MAGIC_BITS)


def modulo(x: Number, y: Number) -> Number:
    """Return x - y*floor(x/y), exactly rounded, with the sign of y, as Python's %; nan from 2**53 turns on."""
    turns = floor(quotient(x, y))
    product, lost = exact_product(turns, y)
    remainder = choose(turns == 0.0, x, (x - product) - lost)
    beyond = ((remainder < 0.0) & (y > 0.0)) | ((remainder > 0.0) & (y < 0.0))  # a quotient that was rounded up
    remainder = choose(beyond, remainder + y, remainder)
    remainder = choose(remainder == 0.0, choose(y < 0.0, -0.0, 0.0), remainder)
    return choose(absolute(turns) < LARGEST_TURNS, remainder, NAN)


def quotient(x: Number, y: Number) -> Number:
    """Return x/y, also of floats by zero."""
    return x * math.copysign(math.inf, y) if isinstance(y, float) and y == 0.0 else x / y


def absolute(x: Number) -> Number:
    """Return |x|."""
    return x.absolute() if isinstance(x, LaneValue) else abs(x)


def signed(x: Number, like: Number) -> Number:
    """Return |x| with the sign of another number."""
    if isinstance(x, float):
        return math.copysign(x, like)
    return np.copysign(x, like) if isinstance(x, np.ndarray) else x.signed(like)


def table_entry(table: str, index: Integer) -> Number:
    """Return an entry of one of the tables."""
    if isinstance(index, int):
        return TABLES[table][index]
    return _ARRAYS[table][index] if isinstance(index, np.ndarray) else index.entry(table)


def round_to_integer(x: Number) -> tuple[Number, Integer]:
    """Return the whole number nearest to x, |x| < 2**51, as a float and as an integer."""
    shifted = x + MAGIC
    return shifted - MAGIC, bits(shifted) - MAGIC_BITS


def whole_number(w: Integer) -> Number:
    """Return a whole number, |w| < 2**51, as a float."""
    return number(w + MAGIC_BITS) - MAGIC


def power_of_two(w: Integer) -> Number:
    """Return 2**w for -1022 <= w <= 1023."""
    return number((w + 1023) << 52)


def upper(x: Number) -> Number:
    """Return x with 26 significant bits: products of two such numbers are exact."""
    return number(bits(x) & UPPER_HALF)


def exact_sum(x: Number, y: Number) -> tuple[Number, Number]:
    """Return the rounded sum and its rounding error, for any x and y (Knuth)."""
    total = x + y
    y_rounded = total - x
    return total, (x - (total - y_rounded)) + (y - y_rounded)


def ordered_sum(x: Number, y: Number) -> tuple[Number, Number]:
    """Return the rounded sum and its rounding error, for |x| >= |y| (Dekker 1971, doi:10.1007/BF01397083)."""
    total = x + y
    return total, y - (total - x)


def exact_product(x: Number, y: Number) -> tuple[Number, Number]:
    """Return the rounded product and its rounding error, to within 2**-105 of the product (Dekker)."""
    product = x * y
    x1, y1 = upper(x), upper(y)
    x2, y2 = x - x1, y - y1
    return product, ((x1 * y1 - product) + x1 * y2 + x2 * y1) + x2 * y2


def polynomial(u: Number, powers: tuple[float, ...]) -> Number:
    """Evaluate a polynomial by pairs of terms in parallel (Estrin), with half the latency of Horner's scheme."""
    terms: list[Number] = list(powers)
    step = u
    while len(terms) > 3:
        terms = [terms[i] + step * terms[i + 1] for i in range(0, len(terms) - 1, 2)] + terms[len(terms) // 2 * 2 :]
        step = step * step
    value = terms.pop()
    while terms:
        value = terms.pop() + step * value
    return value


def divide_with_tails(x: Number, x_tail: Number, y: Number, y_tail: Number) -> tuple[Number, Number]:
    """Return the rounded quotient of two numbers with tails, and its tail."""
    quotient = x / choose(y == 0.0, 1.0, y)
    product, lost = exact_product(quotient, y)
    return quotient, (((x - product) - lost) + (x_tail - quotient * y_tail)) / choose(y == 0.0, 1.0, y)


def exponent_of(x: Number) -> Integer:
    """Return the exponent of |x|, limited to -1022 … 1021."""
    exponent = ((bits(x) >> 52) & 2047) - 1023
    return choose(exponent < 1022, choose(exponent < -1022, -1022, exponent), 1021)
