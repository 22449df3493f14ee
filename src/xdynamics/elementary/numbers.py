"""The numbers that elementary functions are written for: floats, arrays, and lines of a program in the making.

Only operations that IEEE 754 makes the same on every machine: + - * / and square roots rounded to nearest, comparisons,
choices, and exact work on the 64 bits of a number. A function written so serves Python, NumPy and machine code.

`LaneValue` stands for a line of LLVM text; arithmetic with it writes further lines.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np

from xdynamics.elementary.tables import TABLES

_INSTRUCTIONS = {
    "+": ("fadd", "add"), "-": ("fsub", "sub"), "*": ("fmul", "mul"), "/": ("fdiv", ""), "&": ("", "and"),
    "|": ("", "or"), "^": ("", "xor"), "<<": ("", "shl"), ">>": ("", "ashr"),
}  # fmt: skip
# nan is unequal to all numbers: `une` is the one comparison that holds for it
_COMPARED = {
    "<": ("fcmp olt", "icmp slt"), "<=": ("fcmp ole", "icmp sle"), ">": ("fcmp ogt", "icmp sgt"),
    ">=": ("fcmp oge", "icmp sge"), "==": ("fcmp oeq", "icmp eq"), "!=": ("fcmp une", "icmp ne"),
}  # fmt: skip


class FunctionLines:
    """The lines of one function, whose values have one number per lane.

    Parameters
    ----------
    lanes : int
    """

    def __init__(self, lanes: int) -> None:
        self.lanes = lanes
        self.lines: list[str] = []
        self.block = "entry"
        self.tables: set[str] = set()
        self._count = 0

    def kind(self, letter: str) -> str:
        """Return LLVM's type for numbers (n), whole numbers (w), truths (t) and pointers (p)."""
        scalar = {"n": "double", "w": "i64", "t": "i1", "p": "ptr"}[letter]
        return scalar if self.lanes == 1 else f"<{self.lanes} x {scalar}>"

    def constant(self, value: float | int) -> LaneValue:
        """Write a constant as an operand: a truth, a whole number in digits, any other with all its bits."""
        # first, as a bool of Python is an int too
        if isinstance(value, bool):
            return self._splat_constant("t", "i1", str(value).lower())
        if isinstance(value, int):
            return self._splat_constant("w", "i64", str(value))
        return self._splat_constant("n", "double", f"0x{struct.pack('>d', value).hex().upper()}")

    def value(self, value: LaneValue | float | int) -> LaneValue:
        """Return a value, which may be a constant, as an operand."""
        return value if isinstance(value, LaneValue) else self.constant(value)

    def _splat_constant(self, letter: str, scalar: str, text: str) -> LaneValue:
        return LaneValue(self, letter, text if self.lanes == 1 else f"<{', '.join([f'{scalar} {text}'] * self.lanes)}>")

    def line(self, letter: str, text: str) -> LaneValue:
        """Write a line and return its value."""
        self._count += 1
        self.lines.append(f"%v.{self._count} = {text}")  # no array's name has a dot
        return LaneValue(self, letter, f"%v.{self._count}")

    def label(self) -> str:
        """Return a name for a block."""
        self._count += 1
        return f"block.{self._count}"

    def begin(self, label: str) -> None:
        """Begin a block."""
        self.lines.append(f"{label}:")
        self.block = label

    def broadcast(self, letter: str, scalar: str) -> LaneValue:
        """Return one number, whole number or truth in every lane."""
        if self.lanes == 1:
            return LaneValue(self, letter, scalar)
        scalar_type, kind = {"n": "double", "w": "i64", "t": "i1"}[letter], self.kind(letter)
        first = self.line(letter, f"insertelement {kind} poison, {scalar_type} {scalar}, i64 0").text
        return self.line(letter, f"shufflevector {kind} {first}, {kind} poison, <{self.lanes} x i32> zeroinitializer")

    def read(self, letter: str, origin: str, index: LaneValue) -> LaneValue:
        """Return an element of an array that all lanes share, in each lane that of its index."""
        scalar, kind = {"n": "double", "w": "i64"}[letter], self.kind(letter)
        address = self.line("p", f"getelementptr {scalar}, ptr {origin}, {self.kind('w')} {index.text}").text
        if self.lanes == 1:
            return self.line(letter, f"load {scalar}, ptr {address}, align 8")
        return self.line(
            letter,
            f"call {kind} @llvm.masked.gather.{self.suffix(letter)}.v{self.lanes}p0"
            f"({self.kind('p')} {address}, i32 8, {self.kind('t')} {self.constant(value=True).text}, {kind} poison)",
        )

    def by_lane(self, function: Callable[..., LaneValue], operands: Sequence[LaneValue]) -> LaneValue:
        """Return a function of single numbers, computed for one lane after the other."""
        if self.lanes == 1:
            return function(*operands)
        lanes, kinds, vector = (
            self.lanes,
            [self.kind(number.letter) for number in operands],
            LaneValue(self, "n", "poison"),
        )
        for lane in range(lanes):
            self.lanes = 1
            scalars = [
                self.line(number.letter, f"extractelement {kind} {number.text}, i64 {lane}")
                for kind, number in zip(kinds, operands, strict=True)
            ]
            value = function(*scalars).text
            self.lanes = lanes
            vector = self.line("n", f"insertelement {self.kind('n')} {vector.text}, double {value}, i64 {lane}")
        return vector

    def any_lane(self, truth: LaneValue) -> str:
        """Return whether a truth holds in some lane."""
        if self.lanes == 1:
            return truth.text
        bits = self.line("w", f"bitcast {self.kind('t')} {truth.text} to i{self.lanes}").text
        return self.line("t", f"icmp ne i{self.lanes} {bits}, 0").text

    def call(self, name: str, operands: list[LaneValue]) -> LaneValue:
        """Call a function of numbers."""
        arguments = ", ".join(f"{self.kind('n')} {argument.text}" for argument in operands)
        return self.line("n", f"call {self.kind('n')} @{name}({arguments})")

    def suffix(self, letter: str = "n") -> str:
        """Return the suffix of intrinsics for this many lanes."""
        scalar = {"n": "f64", "w": "i64", "t": "i1"}[letter]
        return scalar if self.lanes == 1 else f"v{self.lanes}{scalar}"


class LaneValue:
    """A value of the text: a number, a whole number or a truth, in every lane."""

    __hash__ = None  # type: ignore[assignment]

    def __init__(self, lines: FunctionLines, letter: str, text: str) -> None:
        self._lines = lines
        self.letter = letter
        self.text = text

    def as_operand(self, value: Any) -> LaneValue:
        """Return a value, which may be a constant, as a written one of the same kind."""
        if isinstance(value, LaneValue):
            return value
        return self._lines.constant(float(value) if self.letter == "n" else value)

    def _binary_operation(self, sign: str, left: Any, right: Any) -> LaneValue:
        first, second = self.as_operand(left), self.as_operand(right)
        instruction = _INSTRUCTIONS[sign][self.letter != "n"]
        return self._lines.line(
            self.letter, f"{instruction} {self._lines.kind(self.letter)} {first.text}, {second.text}"
        )

    def _comparison(self, sign: str, operand: Any) -> LaneValue:
        instruction = _COMPARED[sign][self.letter != "n"]
        return self._lines.line(
            "t", f"{instruction} {self._lines.kind(self.letter)} {self.text}, {self.as_operand(operand).text}"
        )

    def __add__(self, operand: Any) -> LaneValue:
        return self._binary_operation("+", self, operand)

    def __radd__(self, operand: Any) -> LaneValue:
        return self._binary_operation("+", operand, self)

    def __sub__(self, operand: Any) -> LaneValue:
        return self._binary_operation("-", self, operand)

    def __rsub__(self, operand: Any) -> LaneValue:
        return self._binary_operation("-", operand, self)

    def __mul__(self, operand: Any) -> LaneValue:
        return self._binary_operation("*", self, operand)

    def __rmul__(self, operand: Any) -> LaneValue:
        return self._binary_operation("*", operand, self)

    def __truediv__(self, operand: Any) -> LaneValue:
        return self._binary_operation("/", self, operand)

    def __rtruediv__(self, operand: Any) -> LaneValue:
        return self._binary_operation("/", operand, self)

    def __and__(self, operand: Any) -> LaneValue:
        return self._binary_operation("&", self, operand)

    def __rand__(self, operand: Any) -> LaneValue:
        return self._binary_operation("&", operand, self)

    def __or__(self, operand: Any) -> LaneValue:
        return self._binary_operation("|", self, operand)

    def __ror__(self, operand: Any) -> LaneValue:
        return self._binary_operation("|", operand, self)

    def __xor__(self, operand: Any) -> LaneValue:
        return self._binary_operation("^", self, operand)

    def __lshift__(self, operand: Any) -> LaneValue:
        return self._binary_operation("<<", self, operand)

    def __rshift__(self, operand: Any) -> LaneValue:
        return self._binary_operation(">>", self, operand)

    def __neg__(self) -> LaneValue:
        return self._lines.line("n", f"fneg {self._lines.kind('n')} {self.text}")

    def __lt__(self, operand: Any) -> LaneValue:
        return self._comparison("<", operand)

    def __le__(self, operand: Any) -> LaneValue:
        return self._comparison("<=", operand)

    def __gt__(self, operand: Any) -> LaneValue:
        return self._comparison(">", operand)

    def __ge__(self, operand: Any) -> LaneValue:
        return self._comparison(">=", operand)

    def __eq__(self, operand: Any) -> LaneValue:  # type: ignore[override]
        return self._comparison("==", operand)

    def __ne__(self, operand: Any) -> LaneValue:  # type: ignore[override]
        return self._comparison("!=", operand)

    def bits(self) -> LaneValue:
        """Return the bits of a number."""
        return self._lines.line("w", f"bitcast {self._lines.kind('n')} {self.text} to {self._lines.kind('w')}")

    def number(self) -> LaneValue:
        """Return the number with these bits."""
        return self._lines.line("n", f"bitcast {self._lines.kind('w')} {self.text} to {self._lines.kind('n')}")

    def converted(self) -> LaneValue:
        """Return a whole number as a number."""
        return self._lines.line("n", f"sitofp {self._lines.kind('w')} {self.text} to {self._lines.kind('n')}")

    def sqrt(self) -> LaneValue:
        """Return the square root."""
        return self._lines.call(f"llvm.sqrt.{self._lines.suffix()}", [self])

    def fma(self, factor: Any, term: Any) -> LaneValue:
        """Return the product with a factor plus a term, rounded once: see `elementary.fma`."""
        return self._lines.call(f"fma.{self._lines.lanes}", [self, self.as_operand(factor), self.as_operand(term)])

    def floor(self) -> LaneValue:
        """Return the greatest whole number that is at most this one."""
        return self._lines.call(f"llvm.floor.{self._lines.suffix()}", [self])

    def absolute(self) -> LaneValue:
        """Return the absolute value."""
        return self._lines.call(f"llvm.fabs.{self._lines.suffix()}", [self])

    def signed(self, like: LaneValue) -> LaneValue:
        """Return the absolute value with another number's sign."""
        return self._lines.call(f"llvm.copysign.{self._lines.suffix()}", [self, like])

    def choose(self, yes: Any, no: Any) -> LaneValue:
        """Return one of two values."""
        if not isinstance(yes, LaneValue) and not isinstance(no, LaneValue):
            yes = self._lines.constant(yes)
        like = yes if isinstance(yes, LaneValue) else no
        first, second = like.as_operand(yes), like.as_operand(no)
        kind = self._lines.kind(like.letter)
        # `!unpredictable` keeps LLVM from making a branch of the choice
        return self._lines.line(
            like.letter,
            f"select {self._lines.kind('t')} {self.text}, {kind} {first.text}, {kind} {second.text}, !unpredictable !0",
        )

    def entry(self, table: str) -> LaneValue:
        """Return an entry of a table, which may differ between lanes."""
        self._lines.tables.add(table)
        return self._lines.read("w" if isinstance(TABLES[table][0], int) else "n", f"@table_{table}", self)

    def usually(self, usual: Any, unusual: Callable[[], Any]) -> Any:
        """Branch to the unusual computation if any lane needs it; the other lanes keep the usual result."""
        lines, previous_block = self._lines, self._lines.block
        unusual_block, end = lines.label(), lines.label()
        all_usual = self.text
        if lines.lanes > 1:
            all_usual = lines.line(
                "t", f"call i1 @llvm.vector.reduce.and.{lines.suffix('t')}({lines.kind('t')} {all_usual})"
            ).text
        lines.lines.append(f"br i1 {all_usual}, label %{end}, label %{unusual_block}")
        usual_values = usual if isinstance(usual, tuple) else (usual,)
        lines.begin(unusual_block)
        computed = unusual()
        lane_values = [
            self.choose(*pair)
            for pair in zip(usual_values, computed if isinstance(usual, tuple) else (computed,), strict=True)
        ]
        last_block = lines.block
        lines.lines.append(f"br label %{end}")
        lines.begin(end)
        merged_values = [
            lines.line(
                value.letter,
                f"phi {lines.kind(value.letter)} [ {old.text}, %{previous_block} ], [ {value.text}, %{last_block} ]",
            )
            for old, value in zip(usual_values, lane_values, strict=True)
        ]
        return tuple(merged_values) if isinstance(usual, tuple) else merged_values[0]

    def repeated(
        self, truth: Callable[..., LaneValue], step: Callable[..., tuple[LaneValue, ...]], state: tuple[LaneValue, ...]
    ) -> tuple[LaneValue, ...]:
        """Repeat a step of a state, of which this is the first number, while a truth holds in some lane."""
        lines, previous_block = self._lines, self._lines.block
        test, body, end = lines.label(), lines.label(), lines.label()
        lines.lines.append(f"br label %{test}")
        lines.begin(test)
        current = tuple(LaneValue(lines, part.letter, f"%{test}.{k}") for k, part in enumerate(state))
        phi_line, holds = len(lines.lines), truth(*current)
        lines.lines.append(f"br i1 {lines.any_lane(holds)}, label %{body}, label %{end}")
        lines.begin(body)
        new = step(*current)
        if lines.lanes > 1:
            new = tuple(holds.choose(new_part, old_part) for new_part, old_part in zip(new, current, strict=True))
        lines.lines.append(f"br label %{test}")
        lines.lines[phi_line:phi_line] = [
            f"{part.text} = phi {lines.kind(part.letter)} [ {first.text}, %{previous_block} ], [ {last.text}, %{lines.block} ]"
            for part, first, last in zip(current, state, new, strict=True)
        ]
        lines.begin(end)
        return current


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
    """Return the number with these bits."""
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
    # nan alone differs from itself; a nan in y fails the comparison and is chosen
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
    # math.floor makes whole numbers of Python, of which none is infinite or nan
    return np.floor(x) if isinstance(x, np.ndarray) else float(np.floor(x))


def ceiling(x: Number) -> Number:
    """Return the least whole number that is at least x."""
    return -floor(-x)


def round_half_even(x: Number) -> Number:
    """Return the whole number nearest to x; of two equally near ones the even one, as Python's `round`."""
    # the sum with MAGIC has no place for a fraction; the sign is put back so that -0.4 becomes -0.0
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
    # x itself without turns, also for an infinite y, whose product with 0 is nan
    remainder = choose(turns == 0.0, x, (x - product) - lost)
    beyond = ((remainder < 0.0) & (y > 0.0)) | ((remainder > 0.0) & (y < 0.0))  # a quotient that was rounded up
    remainder = choose(beyond, remainder + y, remainder)
    # IEEE 754 makes x - x the zero 0.0; Python's % gives a zero with the sign of y
    remainder = choose(remainder == 0.0, choose(y < 0.0, -0.0, 0.0), remainder)
    return choose(absolute(turns) < LARGEST_TURNS, remainder, NAN)


def quotient(x: Number, y: Number) -> Number:
    """Return x/y, also of floats by zero."""
    # Python's division by zero raises; x*inf is IEEE 754's quotient, also its nan for x = 0
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
    # both sides of a later choice are computed, and a float of Python divided by zero would raise
    quotient = x / choose(y == 0.0, 1.0, y)
    product, lost = exact_product(quotient, y)
    return quotient, (((x - product) - lost) + (x_tail - quotient * y_tail)) / choose(y == 0.0, 1.0, y)


def exponent_of(x: Number) -> Integer:
    """Return the exponent of |x|, limited to -1022 … 1021."""
    exponent = ((bits(x) >> 52) & 2047) - 1023
    return choose(exponent < 1022, choose(exponent < -1022, -1022, exponent), 1021)
