"""Parsing of text into a syntax tree: tokens from the left, and errors that state their position.

An error message proposes the text that was probably meant: numbers with units, marks of derivatives, signs of print.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite

from xdynamics.expressions.tree import (
    ALONG,
    DELAYED,
    FUNCTIONS,
    Along,
    Binary,
    Call,
    Compare,
    Element,
    Name,
    Negative,
    Node,
    Number,
    every,
    exponent_of,
)
from xdynamics.faults import InputError
from xdynamics.units import coherent, constant_of, parse_quantity
from xdynamics.units.unit import read_decimal

LONGEST_CORRECTED = 1000  # characters; a longer text is not rewritten

_SIGNS = {
    **dict.fromkeys("·×∙⋅", "*"),
    **dict.fromkeys("−–", "-"),
    "÷": "/",
    "²": "**2",
    "³": "**3",
    "^": "**",
    "π": "pi",
    "°": " degree",
}
_MODULE = re.compile(r"\b(?:np|numpy|math)\.(?=[a-z])")
_MARKED = re.compile(r"\b(?!v_)([A-Za-z][A-Za-z0-9_]*)'(?!')")
_NUMBER = r"(?<![A-Za-z0-9_.])(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?![0-9.]|[eE][+-]?[0-9])"
_WORD = r"[A-Za-z]+(?:(?:\*\*|\^)?[+-]?[0-9]+(?![A-Za-z0-9_.]))?(?![A-Za-z0-9_(])"
_WITH_UNIT = re.compile(rf"{_NUMBER} *(?P<unit>{_WORD}(?:(?: +| */ *){_WORD})*)")
_FACTOR = re.compile(r"(?P<sign>/?) *(?P<name>[A-Za-z]+)(?:\*\*)?(?P<power>[+-]?[0-9]+)?")
_IMPLIED = re.compile(rf"{_NUMBER} *(?=[A-Za-z_(])|(?<=\)) *(?=[A-Za-z0-9_(])")


def likely_correction(source: str, is_readable: Callable[[str], bool]) -> str:
    """Return the probable correction of an unreadable text, as the end of a message; empty if unknown.

    Examples
    --------
    >>> likely_correction("sin(30 degree)", lambda text: " d" not in text)
    "; write 'sin(30*degree)'"
    """
    if len(source) > LONGEST_CORRECTED:
        return ""
    plain = _MARKED.sub(r"v_\1", _MODULE.sub("", "".join(_SIGNS.get(sign, sign) for sign in source)))
    with_units, multiplied = _multiplied(_WITH_UNIT.sub(_unit_product, plain)), _multiplied(plain)
    candidates = [text for text in dict.fromkeys((with_units, multiplied)) if text != source and is_readable(text)]
    if not candidates:
        return ""
    if len(candidates) == 1:
        return f"; write '{candidates[0]}'"
    symbol = next(re.finditer("[A-Za-z0-9]+", next(_WITH_UNIT.finditer(plain))["unit"]))[0]
    return f"; write '{candidates[0]}', or '{candidates[1]}' if {symbol} is a name of the model"


def with_unit_names(quantity: str) -> str:
    """Return a quantity as an expression: its number times the names of its unit.

    Examples
    --------
    >>> with_unit_names("-5 N"), with_unit_names("10 ms")
    ('-5*newton', '0.01*second')
    """
    return _WITH_UNIT.sub(_unit_product, quantity)


def _unit_product(match: re.Match[str]) -> str:
    """Write a number and its unit as a product of unit names; one that has no name in SI units."""
    try:
        quantity = parse_quantity(match[0])
    except InputError:
        return match[0]
    factors = [*_FACTOR.finditer(match["unit"])]
    number = match["number"]
    if not all(constant_of(factor["name"]) for factor in factors):
        number, factors = repr(quantity.si), [*_FACTOR.finditer(coherent(quantity.unit).text)]
    names = (f"{factor['sign'] or '*'}{constant_of(factor['name'])}" for factor in factors)
    powers = (f"**{int(factor['power'])}" if factor["power"] else "" for factor in factors)
    return number + "".join(name + power for name, power in zip(names, powers, strict=True))


def _multiplied(text: str) -> str:
    """Write the products that a text leaves out, as after the number of ``2 x``."""
    return _IMPLIED.sub(lambda match: f"{match['number'] or ''}*", text)


LONGEST_TEXT = 1_000_000

_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/().,<>=!\[\] ]*")
_TOKEN = re.compile(
    r" *(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?![A-Za-z0-9_.])"
    r"|(?P<word>[A-Za-z_][A-Za-z0-9_]*)|(?P<quoted>\"[^\"']*\"|'[^\"']*')|(?P<sign>\*\*|[<>=!]=|[-+*/(),<>\[\]]))"
)
_QUOTED = re.compile(r"(?<=,)( *)(?:\"[A-Za-z0-9_+\-*/(). ]{1,100}\"|'[A-Za-z0-9_+\-*/(). ]{1,100}')(?= *\))")
_REMEDIES = {
    "^": "; a power is written **",
    "|": "; an absolute value is written abs(x)",
    ":": "; there are no slices: neighbours are shift(u, site, 1, fill), and a part is where(index(site) < 3, u, fill)",
    "'": "; no sign stands for a derivative: the velocity of x is v_x, and its acceleration follows from the forces",
}


def _check_raw(source: str) -> None:
    """Refuse a text that is empty, too long, or has characters outside the language."""
    if not source:
        raise InputError("expression is empty")
    if len(source) > LONGEST_TEXT:
        raise InputError(f"expression {_quoted_excerpt(source)} has {len(source)} characters, {LONGEST_TEXT} at most")
    good = _ALLOWED.match(_QUOTED.sub(lambda match: " " * len(match[0]), source))
    end = good.end() if good else 0
    if end < len(source):
        remedy = _REMEDIES.get(source[end], "")
        raise InputError(
            f"expression {_quoted_excerpt(source)} has the character {source[end]!r} at column {end + 1}{remedy}"
        )
    if match := re.search(r"(?<![A-Za-z0-9_])[0-9.]+_", source):
        raise InputError(
            f"expression {_quoted_excerpt(source)} has an underscore in a number at column {match.start() + 1}"
        )


def _quoted_excerpt(source: str) -> str:
    return repr(source if len(source) <= 60 else source[:60] + "…")


@dataclass(frozen=True)
class Token:
    """A word, number, sign or text in quotes, with its column from 1."""

    kind: str
    text: str
    column: int


class Tokens:
    """The tokens of a text, of which the next one is seen before it is taken.

    Parameters
    ----------
    source : str

    Attributes
    ----------
    next : Token
        Of kind ``end`` behind the last one.

    Raises
    ------
    InputError
        If the text is empty, too long, or has characters outside the language.
    """

    def __init__(self, source: str) -> None:
        _check_raw(source)
        self.source = source
        self.position = 0
        self.next = self._token()

    def take_token(self) -> Token:
        """Return the next token, and see the one behind it."""
        token, self.next = self.next, Token("end", "", 0)
        if token.text:
            self.next = self._token()
        return token

    def _token(self) -> Token:
        match = _TOKEN.match(self.source, self.position)
        if match is None and self.source[self.position :].strip():
            column = self.position + 1
            raise InputError(
                f"expression {_quoted_excerpt(self.source)} cannot be read at column {column}: no word, number or sign of the"
                " language"
            )
        if match is None or match.lastgroup is None:
            return Token("end", "", len(self.source) + 1)
        self.position = match.end()
        return Token(match.lastgroup, match[match.lastgroup], match.start(match.lastgroup) + 1)

    def unreadable(self, problem: str, token: Token | None = None) -> InputError:
        """Return the error of a text that ends or goes on otherwise than it may, at a token, or else at the next one."""
        column = (token or self.next).column
        return InputError(f"expression {_quoted_excerpt(self.source)} cannot be read at column {column}: {problem}")

    def fault(self, column: int, problem: str) -> InputError:
        """Return the error for a problem at a column of the source."""
        return InputError(f"expression {_quoted_excerpt(self.source)}, column {column}: {problem}")


LONGEST_WORD = 200
DEEPEST = 40
LARGEST_EXPONENT = 16

_FORM = f'{DELAYED}(x, "20 ms")'
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2}
FORMS = {name: f"{name}(a, dimension)" for name in ("sum", "mean", "min", "max", "norm")} | {
    "dot": "dot(a, b, dimension)",
    "cross": "cross(a, b, dimension)",
    "first": "first(a, relation)",
    "second": "second(a, relation)",
    "shift": "shift(a, dimension, n, fill)",
    "roll": "roll(a, dimension, n)",
    "take": "take(a, dimension, number)",
    "index": "index(dimension)",
    "size": "size(dimension)",
}
_COMPARED = ("<", "<=", ">", ">=", "==", "!=")
LIST = "list"  # the call that three values in brackets are, for functions of a model alone
OwnFunctions = Mapping[str, Callable[[list[Node]], Node]]


def parse(text: str, model_functions: OwnFunctions | None = None) -> Node:
    """Read one expression of the language.

    Parameters
    ----------
    text : str
        ASCII, with at most 40 nested levels of parentheses, functions and signs; sums and products may have any length.
        Exponents are constant and at most 16 in size.
    model_functions : mapping of str to callable, optional
        Functions of a model, which return the tree of a call from its arguments; among these there may be lists, as in
        ``point(frame, [x, y, z])``.

    Raises
    ------
    InputError
        With the column where reading failed.

    Notes
    -----
    Precedence is that of Python: a power binds more tightly than the sign before it, less than one in its exponent.

    Examples
    --------
    >>> from xdynamics.expressions import text_of
    >>> text_of(parse("-c*v_y*abs( v_y )"))
    '-c*v_y*abs(v_y)'
    """
    if not isinstance(text, str):
        raise InputError(f"expression {text!r} is no text; write it in quotes, like '2*x', with nothing beside it")
    source = text.strip()
    try:
        return _parse_source(source, model_functions)
    except InputError as error:
        raise InputError(f"{error}{likely_correction(source, _is_readable)}") from None


def _parse_source(source: str, model_functions: OwnFunctions | None = None) -> Node:
    return _Reader(source, model_functions or {}).read_expression()


def _is_readable(source: str) -> bool:
    try:
        _parse_source(source)
    except InputError:
        return False
    return True


class _Reader(Tokens):
    """Parses by operator precedence (V. R. Pratt, Top down operator precedence, 1973), chains in a loop."""

    def __init__(self, source: str, model_functions: OwnFunctions) -> None:
        super().__init__(source)
        self.model_functions = model_functions
        self.level = 0

    def read_expression(self) -> Node:
        """Parse the text to its end.

        Raises
        ------
        InputError
            With the column where reading failed.
        """
        tree = self._number_tree(self._read_comparison())
        if self.next.text:
            raise self.unreadable(f"{self.next.text!r} has no operator before it{_of_python(self.next.text)}")
        return tree

    def _read_comparison(self) -> Node:
        """Read a sum, or a comparison of two sums."""
        column, left = self.next.column, self._read_operands(1)
        if self.next.text not in _COMPARED:
            return left
        operator = self.take_token().text
        comparison = Compare(operator, left, self._read_operands(1), column)
        if self.next.text in _COMPARED:
            raise self.fault(column, "a comparison has two sides")
        return comparison

    def _read_operands(self, weakest: int) -> Node:
        """Read operands joined by operators, all at least as strong as `weakest`."""
        column, tree = self.next.column, self._read_signed()
        while (strength := _STRENGTH.get(self.next.text, 0)) >= weakest:
            operator = self.take_token().text
            # one more, so that operators of one strength join from the left
            right = self._read_operands(strength + 1)
            tree = Binary(operator, self._number_tree(tree), self._number_tree(right), column)
        return tree

    def _read_signed(self) -> Node:
        """Read an operand with its signs, and its exponent."""
        column = self.next.column
        if self.next.text not in ("+", "-"):
            return self._read_power()
        sign = self.take_token().text
        self._enter_level(column)
        operand = self._number_tree(self._read_signed())
        self.level -= 1
        return Negative(operand, column) if sign == "-" else operand

    def _read_power(self) -> Node:
        column, base = self.next.column, self._read_atom()
        if self.next.text != "**":
            return base
        self.take_token()
        self._enter_level(column)
        exponent = self._number_tree(self._read_signed())
        self.level -= 1
        self._check_exponent(exponent, column)
        return Binary("**", self._number_tree(base), exponent, column)

    def _read_atom(self) -> Node:
        token = self.take_token()
        if token.kind == "number":
            return Number(self._finite(token), token.column)
        if token.kind == "word":
            return self._read_word(token)
        if token.text == "[" and self.model_functions:
            return self._read_list(token)
        if token.text != "(":
            raise self.unreadable(
                "the expression ends too early" if not token.text else f"{token.text!r} is out of place", token
            )
        self._enter_level(token.column)
        inner = self._read_comparison()
        self._close_level(")")
        return inner

    def _read_list(self, token: Token) -> Node:
        """Read values in brackets."""
        self._enter_level(token.column)
        values = [self._number_tree(self._read_comparison())]
        while self.next.text == ",":
            self.take_token()
            values.append(self._number_tree(self._read_comparison()))
        self._close_level("]")
        return Call(LIST, tuple(values), token.column)

    def _read_word(self, token: Token) -> Node:
        if len(token.text) > LONGEST_WORD:
            raise self.fault(token.column, f"a word has {len(token.text)} characters, {LONGEST_WORD} at most")
        # names stand in printed Python as they are
        if keyword.iskeyword(token.text):
            raise self.fault(token.column, f"'{token.text}' is a word of Python and no part of the language")
        if self.next.text == "[":
            return Element(token.text, self._read_entries(), token.column)
        if self.next.text != "(":
            return Name(token.text, token.column)
        self._enter_level(self.take_token().column)
        if token.text == DELAYED:
            return self._read_delayed(token)
        arguments: list[Node] = []
        while self.next.text != ")":
            arguments.append(self._read_comparison())
            if self.next.text != ",":
                break
            self.take_token()
        self._close_level(")")
        return self._call_of(token, arguments)

    def _read_delayed(self, token: Token) -> Node:
        """Read a delayed value and its delay, an expression or a quantity in quotes, after the parenthesis."""
        if self.next.text == ")":
            raise self.fault(token.column, f"'{DELAYED}' is written {_FORM}, and here has 0 arguments")
        delayed_value = self._number_tree(self._read_comparison())
        if self.next.text != ",":
            raise self.fault(token.column, f"'{DELAYED}' is written {_FORM}, and here has no delay")
        self.take_token()
        delay = (
            self._read_quantity(self.take_token())
            if self.next.kind == "quoted"
            else self._number_tree(self._read_comparison())
        )
        if self.next.text == ",":
            raise self.fault(token.column, f"'{DELAYED}' is written {_FORM}, and here has over 2 arguments")
        self._close_level(")")
        if any(
            isinstance(node, Call) and node.function == DELAYED
            for part in (delayed_value, delay)
            for node in every(part)
        ):
            raise self.fault(token.column, f"'{DELAYED}' stands in '{DELAYED}'; write one delay, the sum of both")
        return Call(DELAYED, (delayed_value, delay), token.column)

    def _read_quantity(self, token: Token) -> Node:
        """Return a quantity in quotes as an expression."""
        text = token.text[1:-1]
        try:
            parse_quantity(text)
            return _parse_source(with_unit_names(text.strip()))
        except InputError as error:
            raise self.fault(token.column, f"the delay {token.text} is no quantity: {error}") from None

    def _read_entries(self) -> tuple[str | int, ...]:
        """Read the labels and integers in brackets."""
        self.take_token()
        entries: list[str | int] = []
        while True:
            sign = self.take_token().text if self.next.text == "-" else ""
            token = self.take_token()
            if token.kind == "word" and not sign:
                entries.append(token.text)
            elif token.kind == "number" and token.text.isdigit():
                entries.append(int(sign + token.text))
            else:
                raise self.unreadable(
                    "in brackets stand labels and whole numbers alone, like [Jupiter, x] or [-1]", token
                )
            if self.next.text != ",":
                break
            self.take_token()
        if self.next.text != "]":
            raise self.unreadable("']' is missing")
        self.take_token()
        return tuple(entries)

    def _reduction_of(self, token: Token, arguments: list[Node]) -> Node:
        """Return a function along dimensions, whose last arguments are their names, or integers."""
        function, column = token.text, token.column
        arity, max_dims, numbers = ALONG[function]
        extra = 1 if function in ("shift", "take") else 0
        got, needed = len(arguments), arity + numbers + extra
        if got < needed + 1 or (max_dims is not None and got > needed + max_dims):
            dim_names = [dim.name for dim in arguments[2:] if isinstance(dim, Name)]
            several = function == "dot" and len(dim_names) == got - 2 > 1
            remedy = f"; over several dimensions write sum(a*b, {', '.join(dim_names)})" if several else ""
            raise self.fault(
                column, f"'{function}' is written {FORMS[function]}; number of arguments here: {got}{remedy}"
            )
        end = got - numbers - extra
        values, dims = arguments[:arity], arguments[arity:end]
        if not all(isinstance(dim, Name) for dim in dims):
            raise self.fault(column, f"'{function}' is written {FORMS[function]}: a dimension is a name")
        places = exponent_of(arguments[end]) if numbers else Fraction(0)
        if places is None or places.denominator != 1:
            raise self.fault(
                column, f"'{function}' is written {FORMS[function]}: the number of places is a whole literal"
            )
        values += arguments[end + numbers :]
        names = tuple(dim.name for dim in dims if isinstance(dim, Name))
        return Along(function, tuple(map(self._number_tree, values)), names, int(places), column)

    def _call_of(self, token: Token, arguments: list[Node]) -> Node:
        function, column = token.text, token.column
        if function in self.model_functions:
            return self.model_functions[function](arguments)
        if function in ALONG and function not in FUNCTIONS:
            return self._reduction_of(token, arguments)
        if function not in FUNCTIONS:
            dimension_functions = ", ".join(name for name in ALONG if name not in FUNCTIONS)
            raise self.fault(
                column,
                f"function '{function}' is not known; write {_OF_OTHERS[function]}"
                if function in _OF_OTHERS
                else f"function '{function}' is not known; there are {', '.join(FUNCTIONS)}; of quantities with dimensions"
                f" {dimension_functions}",
            )
        arity, got = FUNCTIONS[function], len(arguments)
        if got != arity and not (function in ("min", "max") and got > arity):
            raise self.fault(column, f"function '{function}' takes {arity} arguments, got {got}")
        conditions = 1 if function == "where" else 0
        if conditions and not isinstance(arguments[0], Compare):
            raise self.fault(column, "the first argument of 'where' must be one comparison, like 'y > 0*metre'")
        further = (self._number_tree(argument) for argument in arguments[conditions:])
        return Call(function, (*arguments[:conditions], *further), column)

    def _number_tree(self, node: Node) -> Node:
        """Refuse a comparison where a number is needed."""
        if isinstance(node, Compare):
            raise self.fault(node.column, "a comparison stands in 'where' alone, like where(y > 0*metre, a, b)")
        if isinstance(node, Call) and node.function == LIST:
            raise self.fault(node.column, f"a list in brackets stands in {', '.join(self.model_functions)} alone")
        return node

    def _check_exponent(self, node: Node, column: int) -> None:
        exponent = exponent_of(node)
        if exponent is None:
            raise self.fault(column, "an exponent must be a constant, like 2, -1, 0.5 or (3/2)")
        if abs(exponent) > LARGEST_EXPONENT:
            raise self.fault(column, f"exponent {exponent} is over {LARGEST_EXPONENT} in size")

    def _finite(self, token: Token) -> float:
        number = read_decimal(token.text)
        if not isfinite(number):
            raise self.fault(token.column, "a number is not finite")
        return number

    def _enter_level(self, column: int) -> None:
        self.level += 1
        if self.level > DEEPEST:
            raise self.fault(
                column,
                f"there are over {DEEPEST} levels of parentheses, functions and signs in one another;"
                " name the inner ones in definitions",
            )

    def _close_level(self, text: str) -> None:
        if self.next.text != text:
            raise self.unreadable(f"{text!r} is missing{_of_python(self.next.text)}")
        self.take_token()
        self.level -= 1


# what Python, or another language, writes, and what is written here
_OF_PYTHON = {
    "and": "; two conditions are one in the other: where(a, where(b, yes, no), no)",
    "or": "; two conditions are one in the other: where(a, yes, where(b, yes, no))",
    "not": "; of a condition write the opposite: where(x <= 0*metre, yes, no)",
    "if": "; a choice is where(condition, yes, no)",
    "else": "; a choice is where(condition, yes, no)",
}
_OF_OTHERS = {
    **dict.fromkeys(("heaviside", "step", "Heaviside", "unitstep", "u"), "where(u > 0, 1, 0)"),
    **dict.fromkeys(("ln", "Log"), "log(u)"),
    "log10": "log(u)/log(10)",
    "square": "u**2",
    "pow": "u**2",
    "cbrt": "u**(1/3)",
    **dict.fromkeys(("clip", "clamp", "saturate"), "min(max(u, low), high)"),
    **dict.fromkeys(("if", "ifelse", "piecewise", "Piecewise"), "where(condition, yes, no)"),
    **{f"arc{word}": f"a{word}(u)" for word in ("sin", "cos", "tan")},
    "interp": "a drive, [drives.table]",
    **dict.fromkeys(("fabs", "magnitude"), "abs(u)"),
    **dict.fromkeys(("sgn", "signum"), "sign(u)"),
}


def _of_python(word: str) -> str:
    """Return what is written in the place of a word of Python; nothing for others."""
    return _OF_PYTHON.get(word, "")
