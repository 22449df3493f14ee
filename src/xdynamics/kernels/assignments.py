"""Syntax trees to instructions, in the order written; a repeated part is computed once."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

from xdynamics.expressions import (
    Along,
    Binary,
    Call,
    Compare,
    Element,
    Name,
    Negative,
    Node,
    Number,
    chain,
    exponent_of,
    shortened_text,
)
from xdynamics.kernels.program import Compute, Line, Load, Location, Operand, StoreTo
from xdynamics.units.unit import Rounded, exact_value

OPERATIONS = {
    "+": "add",
    "-": "subtract",
    "*": "multiply",
    "/": "divide",
    "<": "less",
    "<=": "at_most",
    ">": "more",
    ">=": "at_least",
    "==": "equal",
    "!=": "unequal",
}
_FOLDED: dict[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "negative": operator.neg,
}
LONG = 8  # coefficients of a polynomial that is summed in parts
CALLED = {"min": "least", "max": "greatest", "where": "choose"}


class Assignments:
    """Turns syntax trees into instructions.

    Powers are products and square roots: ``x**3`` is ``x*x*x``, ``r**-1.5`` is ``1/(r*sqrt(r))``. Neither this nor the
    sharing of equal parts changes a bit of the result.

    Parameters
    ----------
    find : callable
        Called with these assignments and a name when they first meet it; returns its operand.
    prefix : str
        Prefix of the names of intermediate values.
    """

    def __init__(self, find: Callable[[Assignments, str], Operand], prefix: str = "_") -> None:
        self.lines: list[Line] = []
        self._find = find
        self._prefix = prefix
        self._named: dict[str, Operand] = {}
        self._known: dict[tuple[str, ...], str] = {}
        self._loaded: dict[Location, str] = {}
        self._unnamed: set[Operand] = set()

    def value(self, tree: Node) -> Operand:
        """Write the instructions that a tree needs; return its operand.

        Raises
        ------
        TypeError
            If the tree has dimensions.
        """
        match tree:
            case Number():
                return tree.value
            case Name():
                return self.operand_of(tree.name)
            case Negative():
                return self.compute("negative", self.value(tree.operand))
            case Binary():
                # a sum may have thousands of terms, more than Python allows calls inside one another
                first, links = chain(tree)
                result = self.value(first)
                for link in links:
                    result = self._write_binary(link, result)
                return result
            case Compare():
                return self.compute(OPERATIONS[tree.operator], self.value(tree.left), self.value(tree.right))
            case Call():
                return self._write_call(tree)
            case Element() | Along():
                raise TypeError(f"'{shortened_text(tree)}' is not yet of single elements")

    def assign(self, name: str, tree: Node) -> Operand:
        """Compute a tree and name its value."""
        return self.name(name, self.value(tree))

    def name(self, name: str, value: Operand) -> Operand:
        """Give a value a name, which appears in the text unless the value already had one."""
        self._named[name] = value
        last = self.lines[-1] if self.lines else None
        # no line has read the last one yet, so its target may still be renamed
        if isinstance(last, Compute) and last.target == value and value in self._unnamed:
            self._unnamed.discard(value)
            self.lines[-1] = Compute(name, last.operation, last.arguments)
            self._known[_computation_key(last.operation, last.arguments)] = name
            self._named[name] = name
        return self._named[name]

    def operand_of(self, name: str) -> Operand:
        """Return the operand of a name."""
        if name not in self._named:
            self.name(name, self._find(self, name))
        return self._named[name]

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation, unless its value was computed before; return its operand."""
        if operation in _FOLDED and all(isinstance(argument, float) for argument in arguments):
            folded = _FOLDED[operation](*arguments)
            if math.isfinite(folded):  # so 1/(2 - 2) becomes a visible division by a literal zero
                # the exact value goes along: programs of 31 digits are printed from it
                exact = [exact_value(argument) for argument in arguments if isinstance(argument, float)]
                return Rounded.from_exact(_FOLDED[operation](*exact), folded)
        key = _computation_key(operation, arguments)
        if key not in self._known:
            self._known[key] = f"{self._prefix}{len(self._known)}"
            self._unnamed.add(self._known[key])
            self.lines.append(Compute(self._known[key], operation, arguments))
        return self._known[key]

    def load(self, location: Location, name: str = "") -> Operand:
        """Read a location once, and reuse the value for further reads."""
        if location not in self._loaded:
            self._loaded[location] = name or f"{self._prefix}l{len(self._loaded)}"
            self.lines.append(Load(self._loaded[location], location))
        return self._loaded[location]

    def store(self, location: Location, value: Operand) -> None:
        """Write a value to a location."""
        self.lines.append(StoreTo(location, value))

    def _write_binary(self, node: Binary, left: Operand) -> Operand:
        """Write a binary node whose left operand is already written."""
        if node.operator == "**":
            return self.power(left, exponent_of(node.right) or Fraction(0))
        return self.compute(OPERATIONS[node.operator], left, self.value(node.right))

    def _write_call(self, tree: Call) -> Operand:
        operation = CALLED.get(tree.function, tree.function)
        values = [self.value(argument) for argument in tree.arguments]
        if tree.function not in ("min", "max"):
            return self.compute(operation, *values)
        result = values[0]
        for value in values[1:]:
            result = self.compute(operation, result, value)
        return result

    def power(self, base: Operand, exponent: Fraction) -> Operand:
        """Write a power as products and square roots where these suffice."""
        if exponent == 0:
            return 1.0
        if exponent < 0:
            return self.compute("divide", 1.0, self.power(base, -exponent))
        integer_part, fraction = divmod(exponent, 1)
        if fraction == 0:
            return self._integer_power(base, integer_part)
        if fraction == Fraction(1, 2):
            root = self.compute("sqrt", base)
            return self.compute("multiply", self._integer_power(base, integer_part), root) if integer_part else root
        return self.compute("power", base, Rounded.from_exact(exponent, float(exponent)))

    def _integer_power(self, base: Operand, times: int) -> Operand:
        """Write x**2 and x**3 as products, higher powers by squaring."""
        if times == 1:
            return base
        if times <= 3:
            square = self.compute("multiply", base, base)
            return square if times == 2 else self.compute("multiply", square, base)
        half = self._integer_power(base, times // 2)
        square = self.compute("multiply", half, half)
        return self.compute("multiply", square, base) if times % 2 else square


class FusedAssignments(Assignments):
    """Assignments with fused multiply-adds, and with products by reciprocals for quotients by numbers.

    A long polynomial ``c + d*(c_1 + d*(c_2 + …))`` is one of d**4 in four parts from c_2 on, which do not wait for each
    other; what rounding leaves of them is small beside the first terms.
    """

    def _write_binary(self, node: Binary, left: Operand) -> Operand:
        product = node.right
        if node.operator == "/" and isinstance(product, Number):
            return self.compute("multiply", left, 1.0 / product.value)
        if node.operator != "+" or not isinstance(product, Binary) or product.operator != "*":
            return super()._write_binary(node, left)
        distance, coefficients = self.value(product.left), _nested_coefficients(product)
        if len(coefficients) < LONG:
            return self.compute("fma", distance, self.value(product.right), left)
        first, *higher_coefficients = map(self.value, coefficients)
        return self._horner_scheme(distance, [left, first, self._in_parts(distance, higher_coefficients)])

    def _in_parts(self, x: Operand, coefficients: Sequence[Operand]) -> Operand:
        """Write a polynomial in four parts."""
        square = self.compute("multiply", x, x)
        fourth = self.compute("multiply", square, square)
        a, b, c, d = (self._horner_scheme(fourth, coefficients[k::4]) for k in range(4))
        return self._horner_scheme(square, [self._horner_scheme(x, [a, b]), self._horner_scheme(x, [c, d])])

    def _horner_scheme(self, x: Operand, coefficients: Sequence[Operand]) -> Operand:
        *lower_coefficients, total = coefficients
        for coefficient in reversed(lower_coefficients):
            total = self.compute("fma", x, total, coefficient)
        return total


def _nested_coefficients(product: Binary) -> list[Node]:
    """Return c, c_1, … of ``d*(c + d*(c_1 + …))``."""
    coefficients, distance = [], product.left
    while True:
        match product.right:
            case Binary("+", coefficient, Binary("*", factor, _) as inner) if factor == distance:
                coefficients.append(coefficient)
                product = inner
            case last:
                return [*coefficients, last]


def _computation_key(operation: str, arguments: tuple[Operand, ...]) -> tuple[str, ...]:
    """Return the key of a computation, with numbers as printed: 0.0 equals -0.0, but atan2 tells them apart."""
    # by exact values, too: two of them may round to one float, and differ in programs of 31 digits
    return (operation, *(str(entry.exact) if isinstance(entry, Rounded) else repr(entry) for entry in arguments))
