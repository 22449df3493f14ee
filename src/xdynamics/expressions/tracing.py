"""Tracing of Python functions: called with names in place of numbers, they write themselves as expressions.

A function that branches on values, by `if`, is called once for each way through its branches, and what the ways return is
joined by choices, as `numpy.where` would; loops that end by a value, by `while` or `int`, are refused.

Functions of numpy are written under the names that the language of expressions has for them. A call of a scipy function
is refused, with the expression to write in its place. Traced numbers are real: numpy drops imaginary parts where it
makes floats.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextvars import ContextVar
from functools import reduce
from math import isfinite
from pathlib import Path
from traceback import extract_tb
from typing import Any

import numpy as np

from xdynamics.expressions.scipy_remedies import scipy_remedy, special_remedy
from xdynamics.expressions.tree import (
    FUNCTIONS,
    Binary,
    Call,
    Compare,
    Junction,
    Name,
    Negative,
    Node,
    Number,
    choice_tree,
    is_condition,
    junction,
    opposite,
    text_of,
    truth_as_number,
)
from xdynamics.faults import InputError

# numpy's name of a function -> ours
NAMED = {
    **{word: word for word in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "sign", "hypot")},
    **{word: word for word in ("floor", "ceil", "mod")},
    **{f"arc{word}": f"a{word}" for word in ("sin", "cos", "tan", "tan2")},
    **dict.fromkeys(("absolute", "fabs"), "abs"),
    **dict.fromkeys(("maximum", "fmax"), "max"),
    **dict.fromkeys(("minimum", "fmin"), "min"),
    "rint": "round",
    "remainder": "mod",
}
COMPARED = {"greater": ">", "greater_equal": ">=", "less": "<", "less_equal": "<=", "equal": "==", "not_equal": "!="}


def real(values: Any) -> Any:
    """Return numbers, or anything else, as they are; of complex ones without imaginary parts the real parts.

    Raises
    ------
    InputError
        If one has an imaginary part.
    """
    if not np.iscomplexobj(values):
        return values
    if (imaginary := np.flatnonzero(np.imag(values))).size:
        first = np.ravel(values)[imaginary[0]]
        raise InputError(f"the function makes {first:.6g}, needs real numbers; {APART}")
    return np.real(values)


MOST_NODES = 200_000
LARGEST_EXPONENT = 16
APART = "write real and imaginary parts apart"
REMEDY = "write numpy.where(condition, a, b) in the place of a branch"
TABLE = "numpy.interp(t, x, y) in the place of an interpolator of scipy"
LOOP = "and an event in the place of a loop that ends when a value is reached"
PLAIN = "as float(), int(), math functions, print and indexing do"
HERE = str(Path(__file__).parents[1])


class WholeNumberError(InputError):
    """An unknown number is used where Python needs an integer: as an index, or in `range`."""


class RecordedOperations:
    """What unknown numbers, real or complex, have in common: operations on them are recorded."""

    def __add__(self, operand: Any) -> Any:
        return _trace_operation("+", self, operand)

    def __radd__(self, operand: Any) -> Any:
        return _trace_operation("+", operand, self)

    def __sub__(self, operand: Any) -> Any:
        return _trace_operation("-", self, operand)

    def __rsub__(self, operand: Any) -> Any:
        return _trace_operation("-", operand, self)

    def __mul__(self, operand: Any) -> Any:
        return _trace_operation("*", self, operand)

    def __rmul__(self, operand: Any) -> Any:
        return _trace_operation("*", operand, self)

    def __truediv__(self, operand: Any) -> Any:
        return _trace_operation("/", self, operand)

    def __rtruediv__(self, operand: Any) -> Any:
        return _trace_operation("/", operand, self)

    def __pow__(self, exponent: Any) -> Any:
        return _trace_power(self, exponent)

    def __pos__(self) -> Any:
        return self

    def __array_ufunc__(self, ufunc: Any, how: str, *inputs: Any, **_: Any) -> Any:
        """Apply a function of numpy element by element."""
        if how != "__call__":
            return NotImplemented
        return apply_elementwise(ufunc.__name__, inputs)


class Traced(RecordedOperations):
    """An unknown number that records the operations on it."""

    def __init__(self, node: Node | Junction, nodes: int = 1) -> None:
        self.node: Any = node
        self.nodes = nodes
        if nodes > MOST_NODES:
            raise InputError(f"the function writes an expression of over {MOST_NODES} nodes; it is too long for one")

    def __mod__(self, operand: Any) -> Any:
        return _trace_remainder(self, operand)

    def __rmod__(self, operand: Any) -> Any:
        return _trace_remainder(operand, self)

    def __floordiv__(self, operand: Any) -> Any:
        return _whole_quotient(self, operand)

    def __rfloordiv__(self, operand: Any) -> Any:
        return _whole_quotient(operand, self)

    def __floor__(self) -> Traced:
        return called("floor", self)

    def __ceil__(self) -> Traced:
        return called("ceil", self)

    def __round__(self, digits: int = 0) -> Traced:
        return trace_rounding(self, digits)

    def __rpow__(self, base: Any) -> Any:
        return _trace_power(base, self)

    def __and__(self, operand: Any) -> Any:
        return _junction("and", self, operand)

    def __or__(self, operand: Any) -> Any:
        return _junction("or", self, operand)

    __rand__, __ror__ = __and__, __or__

    def __invert__(self) -> Traced:
        return Traced(opposite(self.node), self.nodes)

    def __neg__(self) -> Traced:
        return Traced(Negative(truth_as_number(self.node)), self.nodes + 1)

    def __abs__(self) -> Traced:
        return called("abs", self)

    def __lt__(self, operand: Any) -> Any:
        return _trace_comparison("<", self, operand)

    def __le__(self, operand: Any) -> Any:
        return _trace_comparison("<=", self, operand)

    def __gt__(self, operand: Any) -> Any:
        return _trace_comparison(">", self, operand)

    def __ge__(self, operand: Any) -> Any:
        return _trace_comparison(">=", self, operand)

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, operand: object) -> Any:
        return _trace_comparison("==", self, operand)

    def __ne__(self, operand: object) -> Any:
        return _trace_comparison("!=", self, operand)

    def __bool__(self) -> bool:
        way = _WAY.get()
        if way is None or len(way.conditions) >= MOST_DECISIONS:
            raise InputError(f"the function decides by a value that is not known yet; {REMEDY}, {LOOP}")
        return way.decided_by(self)

    def __float__(self) -> float:
        raise InputError(f"the function takes a number of a value that is not known yet, {PLAIN}; {REMEDY}, {TABLE}")

    __int__ = __float__

    def __repr__(self) -> str:
        return f"<{text_of(self.node)}: no number, the function is written down>"

    def __format__(self, spec: str) -> str:
        raise InputError("the function prints or formats a value that is not known yet; leave that out")

    def __index__(self) -> int:
        raise WholeNumberError(f"the function takes a whole number of a value that is not known yet; {REMEDY}")

    def conjugate(self) -> Traced:
        """Return the number itself: it is real."""
        return self

    conj = conjugate


_ARRAYS = np.ndarray


class _Way:
    """A way through the branches of a function: what its conditions were, and how each is decided, at first as true."""

    def __init__(self, decisions: Sequence[bool]) -> None:
        self.decisions, self.conditions = [*decisions], list[Traced]()

    def decided_by(self, condition: Traced) -> bool:
        """Return how the next condition is decided."""
        self.conditions.append(condition)
        if len(self.conditions) > len(self.decisions):
            self.decisions.append(True)
        return self.decisions[len(self.conditions) - 1]


_WAY: ContextVar[_Way | None] = ContextVar("way", default=None)
MOST_WAYS, MOST_DECISIONS = 64, 32  # through the branches of a function, and along one of them


def joined_branches(call: Callable[[], Any]) -> Any:
    """Call a function once for each way through its branches; return what it does, chosen by their conditions.

    Raises
    ------
    InputError
        If there are too many ways, or they return different numbers of values.
    """
    ways = 0

    def go_on(decisions: list[bool]) -> Any:
        nonlocal ways
        ways += 1
        if ways > MOST_WAYS:
            raise InputError(f"the function has over {MOST_WAYS} ways through its branches; {REMEDY}")
        way = _Way(decisions)
        token = _WAY.set(way)
        try:
            result = call()
        finally:
            _WAY.reset(token)
        for k in reversed(range(len(decisions), len(way.conditions))):
            result = _chosen(way.conditions[k], result, go_on([*way.decisions[:k], False]))
        return result

    return go_on([])


def _chosen(condition: Traced, yes: Any, no: Any) -> Any:
    """Return what two ways return, number by number, where they differ as a choice."""
    first, second = _boxed(yes), _boxed(no)
    first = first.reshape(second.shape) if first.size == second.size else first
    if first.shape != second.shape:
        raise InputError(
            f"the branches of the function return {first.size} and {second.size} numbers; let each return as many"
        )
    if not is_condition(condition.node):
        condition = Traced(Compare("!=", condition.node, Number(0.0)), condition.nodes + 1)
    results = np.empty(first.shape, object)
    for index in np.ndindex(first.shape):
        pair = _traced_number(first[index]), _traced_number(second[index])
        results[index] = pair[0] if pair[0].node == pair[1].node else choice(condition, *pair)
    return results if results.shape else results[()]


def traced(function: Callable[..., Any], *arguments: Any) -> Any:
    """Call a function with traced numbers as its arguments; a call of scipy is refused with a remedy.

    Raises
    ------
    InputError
        If it does something that cannot be traced, or ends with an error of its own.
    """
    try:
        return function(*arguments)
    except InputError as error:
        if remedy := scipy_remedy(error.__traceback__):
            raise InputError(remedy) from None
        raise
    except Exception as error:  # noqa: BLE001 - somebody else's code
        if remedy := scipy_remedy(error.__traceback__):
            raise InputError(remedy) from None
        hint = f"; write {TABLE}" if "object arrays" in str(error) else ""
        if isinstance(error, IndexError) and "must be of integer" in str(error):
            hint = "; what a condition chooses is written np.where(condition, value, row)"
        raise InputError(
            f"the function ends with {type(error).__name__}{_line_of_user(error)}: {error}{hint}"
        ) from None


def _line_of_user(error: Exception) -> str:
    """Return where a function of the user's was when it ended: the last line that is none of this package, or of a library."""
    frames = [frame for frame in extract_tb(error.__traceback__) if not frame.filename.startswith(HERE)]
    own = [frame for frame in frames if f"{os.sep}site-packages{os.sep}" not in frame.filename]
    return f", line {own[-1].lineno}" + (f", `{own[-1].line}`" if own[-1].line else "") if own else ""


def traced_name(word: str) -> Traced:
    """Return an unknown number by its name."""
    return Traced(Name(word))


def node_of(value: Any) -> Node:
    """Return the tree of a traced number or of a plain one.

    Raises
    ------
    InputError
        If it is neither, or not finite.
    """
    return truth_as_number(_traced_value(value).node)


def called(function: str, *values: Any) -> Traced:
    """Trace the call of a function of the language.

    Raises
    ------
    InputError
        If an argument is not a finite number.
    """
    arguments = [_traced_value(argument) for argument in values]
    return Traced(
        Call(function, tuple(truth_as_number(argument.node) for argument in arguments)),
        1 + sum(argument.nodes for argument in arguments),
    )


def _traced_value(value: Any) -> Traced:
    if isinstance(value, Traced):
        return value
    if isinstance(value, np.ndarray) and value.shape == ():
        return _traced_value(value.item())
    if isinstance(value, TracedComplex):
        raise InputError("the function makes complex numbers of real ones; begin with complex ones, y0 + 0j")
    value = real(value)
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise InputError(f"the function makes {str(value)[:40]!r}, needs numbers") from None
    if not isfinite(number):
        raise InputError(f"the function makes {number!r}, needs finite numbers")
    return Traced(Negative(Number(-number)) if number < 0 else Number(number))


def _traced_number(value: Any) -> Traced:
    number = _traced_value(value)
    return Traced(truth_as_number(number.node), number.nodes + 3) if is_condition(number.node) else number


def _junction(word: str, left: Any, right: Any) -> Any:
    if isinstance(right, _ARRAYS):
        return NotImplemented
    if isinstance(right, bool | np.bool_):
        return left if bool(right) is (word == "and") else bool(right)
    first, second = _traced_value(left), _traced_value(right)
    return Traced(junction(word, first.node, second.node), first.nodes + second.nodes + 6)


OPERATIONS = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide"}


def are_real(*values: Any) -> bool:
    """Whether no number has an imaginary part."""
    return not any(
        isinstance(value, TracedComplex) or (isinstance(value, complex | np.complexfloating) and value.imag != 0.0)
        for value in values
    )


def _trace_operation(operator: str, left: Any, right: Any) -> Any:
    # left to numpy, which goes through the elements
    if isinstance(left, _ARRAYS) or isinstance(right, _ARRAYS):
        return NotImplemented
    if not are_real(left, right):
        return applied_to_complex(OPERATIONS[operator], (left, right))
    first, second = _traced_number(left), _traced_number(right)
    if operator == "*" and Number(0.0) in (first.node, second.node):  # a sparse matrix times a vector
        return Traced(Number(0.0))
    if (operator == "+" and first.node == Number(0.0)) or (operator == "*" and first.node == Number(1.0)):
        return second
    if (operator in "+-" and second.node == Number(0.0)) or (operator in "*/" and second.node == Number(1.0)):
        return first
    return Traced(Binary(operator, first.node, second.node), first.nodes + second.nodes + 1)


def _constant_exponent(exponent: Any) -> float | None:
    """Return an exponent that is a number, traced or not; None of an expression."""
    if not isinstance(exponent, Traced):
        return float(exponent)
    sign, node = (-1.0, exponent.node.operand) if isinstance(exponent.node, Negative) else (1.0, exponent.node)
    return sign * node.value if isinstance(node, Number) else None


def _trace_power(base: Any, exponent: Any) -> Any:
    if isinstance(base, _ARRAYS) or isinstance(exponent, _ARRAYS):
        return NotImplemented
    if not are_real(base, exponent):
        return applied_to_complex("power", (base, exponent))
    number = _constant_exponent(exponent)
    if number is None or abs(number) > LARGEST_EXPONENT:
        if number is None or not number.is_integer():
            return called("exp", _trace_operation("*", exponent, called("log", base)))
        even = number - number % 2.0  # of a negative number too
        power = called("exp", _trace_operation("*", even, called("log", called("abs", base))))
        return power if number == even else _trace_operation("*", base, power)
    traced_base = _traced_number(base)
    return Traced(Binary("**", traced_base.node, _traced_value(exponent).node), traced_base.nodes + 2)


def _trace_remainder(left: Any, right: Any) -> Any:
    if isinstance(left, _ARRAYS) or isinstance(right, _ARRAYS):
        return NotImplemented
    return called("mod", left, right)


def _whole_quotient(left: Any, right: Any) -> Any:
    if isinstance(left, _ARRAYS) or isinstance(right, _ARRAYS):
        return NotImplemented
    return called("floor", _trace_operation("/", left, right))


def trace_rounding(value: Any, digits: int = 0) -> Traced:
    """Round to a number of decimals."""
    scale = 10.0**digits
    return (
        called("round", value)
        if digits == 0
        else _trace_operation("/", called("round", _trace_operation("*", value, scale)), scale)
    )


def heaviside(x: Any, at_zero: Any) -> Traced:
    """Trace a step."""
    if not isinstance(at_zero, Traced) and float(at_zero) in (0.0, 1.0):
        return choice(_trace_comparison(">=" if at_zero else ">", x, 0.0), 1.0, 0.0)
    return choice(_trace_comparison(">", x, 0.0), 1.0, choice(_trace_comparison("<", x, 0.0), 0.0, at_zero))


def _trace_comparison(operator: str, left: Any, right: Any) -> Any:
    if isinstance(right, _ARRAYS):
        return NotImplemented
    first, second = _traced_value(left), _traced_value(right)
    return Traced(Compare(operator, first.node, second.node), first.nodes + second.nodes + 1)


def choice(condition: Any, yes: Any, no: Any) -> Traced:
    """Trace a choice by a condition, or make it where the condition is known."""
    if not isinstance(condition, Traced):
        return _traced_value(yes if condition else no)
    first, second = _traced_number(yes), _traced_number(no)
    return Traced(
        choice_tree(condition.node, first.node, second.node), condition.nodes + first.nodes + second.nodes + 1
    )


def apply_elementwise(ufunc: str, inputs: Sequence[Any]) -> Any:
    """Apply a function of numpy, by its name, to numbers or to the elements of arrays."""
    arrays = np.broadcast_arrays(*map(_boxed, inputs))
    results = np.empty(arrays[0].shape, object)
    for index in np.ndindex(results.shape):
        results[index] = applied(ufunc, [array[index] for array in arrays])
    return results if results.shape else results[()]


def _boxed(value: Any) -> Any:
    """Return an array of objects; a zero-dimensional one for a single number."""
    if isinstance(value, np.ndarray | list | tuple):
        return np.asarray(value, object)
    box = np.empty((), object)
    box[()] = value
    return box


def _towards_zero(x: Any) -> Traced:
    return choice(_trace_comparison(">=", x, 0.0), called("floor", x), called("ceil", x))


_OPERATORS: dict[str, Callable[..., Any]] = {
    "add": lambda x, y: _trace_operation("+", x, y),
    "subtract": lambda x, y: _trace_operation("-", x, y),
    "multiply": lambda x, y: _trace_operation("*", x, y),
    "divide": lambda x, y: _trace_operation("/", x, y),
    "negative": lambda x: -_traced_value(x),
    "positive": lambda x: x,
    "square": lambda x: _trace_operation("*", x, x),
    "power": _trace_power,
    "float_power": _trace_power,
    **{f"{head}_and": lambda x, y: _junction("and", x, y) for head in ("bitwise", "logical")},
    **{f"{head}_or": lambda x, y: _junction("or", x, y) for head in ("bitwise", "logical")},
    **{word: lambda x: ~_traced_value(x) for word in ("invert", "logical_not")},
    "reciprocal": lambda x: _trace_operation("/", 1.0, x),
    "cbrt": lambda x: called("sign", x) * abs(_traced_value(x)) ** (1 / 3),
    "floor_divide": _whole_quotient,
    "fmod": lambda x, y: _trace_operation("-", x, _trace_operation("*", y, _towards_zero(_trace_operation("/", x, y)))),
    "trunc": _towards_zero,
    "heaviside": heaviside,
    "log10": lambda x: _trace_operation("/", called("log", x), float(np.log(10.0))),
    "log2": lambda x: _trace_operation("/", called("log", x), float(np.log(2.0))),
    "exp2": lambda x: called("exp", _trace_operation("*", x, float(np.log(2.0)))),
    **dict.fromkeys(("rad2deg", "degrees"), lambda x: _trace_operation("*", x, 180 / np.pi)),
    **dict.fromkeys(("deg2rad", "radians"), lambda x: _trace_operation("*", x, np.pi / 180)),
    "conjugate": lambda x: x,
    "expm1": lambda x: called("exp", x) - 1.0,
    "log1p": lambda x: called("log", _trace_operation("+", 1.0, x)),
}


def applied(ufunc: str, arguments: Sequence[Any]) -> Any:
    """Trace a function of numpy, by its name, of single numbers.

    Raises
    ------
    InputError
        If the language has none for it.
    """
    if not are_real(*arguments):
        return applied_to_complex(ufunc, arguments)
    if ufunc in _OPERATORS:
        return _OPERATORS[ufunc](*arguments)
    if ufunc in COMPARED:
        return _trace_comparison(COMPARED[ufunc], *arguments)
    if ufunc not in NAMED and not hasattr(np, ufunc):
        raise InputError(special_remedy(ufunc))
    if ufunc not in NAMED:
        raise InputError(
            f"the function calls numpy.{ufunc}, which the language of expressions has not; there are"
            f" {', '.join(FUNCTIONS)}"
        )
    return called(NAMED[ufunc], *arguments)


def _add_numpy_methods() -> None:
    """Give traced numbers the methods that numpy calls on elements of object arrays."""
    for word, ours in NAMED.items():
        setattr(Traced, word, lambda self, *operands, ours=ours: called(ours, self, *operands))


_add_numpy_methods()


class TracedComplex(RecordedOperations):
    """An unknown complex number: what is done to it is done to its parts, `real` and `imag`, traced numbers or plain ones."""

    def __init__(self, real: Any, imag: Any) -> None:
        self.real, self.imag = real, imag

    def __neg__(self) -> TracedComplex:
        return TracedComplex(-self.real, -self.imag)

    def __abs__(self) -> Traced:
        return called("sqrt", _squared_size(self))

    def conjugate(self) -> TracedComplex:
        """Return the number with its imaginary part negated."""
        return TracedComplex(self.real, -self.imag)

    conj = conjugate

    def __float__(self) -> float:
        raise InputError(f"the function takes a real number of a complex one, as float() does; {APART}")

    __bool__ = __int__ = __complex__ = __float__

    __hash__ = None  # type: ignore[assignment]

    def __eq__(self, _operand: object) -> bool:
        raise InputError("the function compares complex numbers; compare their real and imaginary parts, or np.abs")


def parts(value: Any) -> tuple[Any, Any]:
    """Return the real and the imaginary part of a number, traced or not."""
    return (value.real, value.imag) if isinstance(value, TracedComplex | complex | np.complexfloating) else (value, 0.0)


def applied_to_complex(ufunc: str, arguments: Sequence[Any]) -> Any:
    """Trace a function of numpy, by its name, of single numbers of which one is complex.

    Raises
    ------
    InputError
        If there is no rule for it.
    """
    if ufunc not in _RULES:
        raise InputError(f"the function calls numpy.{ufunc} of complex numbers, which is not traced; {APART}")
    return _RULES[ufunc](*arguments)


def _squared_size(x: Any) -> Any:
    real, imag = parts(x)
    return real * real + imag * imag


def _product(x: Any, y: Any) -> TracedComplex:
    (a, b), (c, d) = parts(x), parts(y)
    return TracedComplex(a * c - b * d, a * d + b * c)


def _quotient(x: Any, y: Any) -> TracedComplex:
    (a, b), (c, d) = parts(x), parts(y)
    if isinstance(d, float) and d == 0.0:
        return TracedComplex(a / c, b / c)
    size = _squared_size(y)
    return TracedComplex((a * c + b * d) / size, (b * c - a * d) / size)


def _power(x: Any, exponent: Any) -> Any:
    if isinstance(exponent, Traced | TracedComplex) or exponent not in range(1, LARGEST_EXPONENT + 1):
        power = "that varies" if isinstance(exponent, Traced | TracedComplex) else exponent
        needed = f"needs a whole one from 1 to {LARGEST_EXPONENT}"
        raise InputError(f"the function raises a complex number to the power {power}, {needed}; {APART}")
    return reduce(_product, [x] * int(np.real(exponent)))


def _each_part(operation: Callable[[Any, Any], Any]) -> Callable[[Any, Any], TracedComplex]:
    return lambda x, y: TracedComplex(*map(operation, parts(x), parts(y)))


def _exponential(x: Any) -> TracedComplex:
    real, imag = parts(x)
    size = called("exp", real)
    return TracedComplex(size * called("cos", imag), size * called("sin", imag))


_RULES: dict[str, Callable[..., Any]] = {
    "add": _each_part(lambda x, y: x + y),
    "subtract": _each_part(lambda x, y: x - y),
    "multiply": _product,
    "divide": _quotient,
    "power": _power,
    "square": lambda x: _product(x, x),
    "negative": lambda x: -x,
    "positive": lambda x: x,
    "conjugate": lambda x: TracedComplex(parts(x)[0], -parts(x)[1]),
    "absolute": abs,
    "reciprocal": lambda x: _quotient(1.0, x),
    "exp": _exponential,
    "sin": lambda x: (_exponential(1j * x) - _exponential(-1j * x)) / 2j,
    "cos": lambda x: (_exponential(1j * x) + _exponential(-1j * x)) / 2.0,
}
