"""Text to syntax tree, through Python's parser and a whitelist."""

from __future__ import annotations

import ast
import re
import warnings
from math import isfinite

from xdynamics.expressions.tree import (
    FUNCTIONS,
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    exponent_of,
)
from xdynamics.faults import InputError

LONGEST_TEXT = 2000
MOST_NODES = 400
DEEPEST = 40
LARGEST_EXPONENT = 16

_ALLOWED = re.compile(r"[A-Za-z0-9_+\-*/().,<>=! ]*")
_BINARY: dict[type[ast.operator], str] = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**"}
_COMPARE: dict[type[ast.cmpop], str] = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==",
                                        ast.NotEq: "!="}  # fmt: skip


def parse(text: str) -> Node:
    """Read one expression of the language.

    Parameters
    ----------
    text : str
        ASCII, at most 2,000 characters, 400 nodes, 40 levels; exponents constant and at most 16 in size.

    Raises
    ------
    InputError
        With the column where reading failed.

    Examples
    --------
    >>> from xdynamics.expressions import text_of
    >>> text_of(parse("-c*v_y*abs( v_y )"))
    '-c*v_y*abs(v_y)'
    """
    if not isinstance(text, str):
        raise InputError(f"expression {text!r} is no text")
    source = text.strip()
    _check_raw(source)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            parsed = ast.parse(source, mode="eval").body
    except SyntaxError as error:
        raise InputError(
            f"expression {_shown(source)} cannot be read at column {error.offset or 1}: {error.msg}"
        ) from None
    except (RecursionError, MemoryError, ValueError, OverflowError):
        raise InputError(f"expression {_shown(source)} cannot be read: it is nested too deeply") from None
    return _Reader(source).read(parsed, 1)


def _check_raw(source: str) -> None:
    """Refuse what Python's parser should never see."""
    if not source:
        raise InputError("expression is empty")
    if len(source) > LONGEST_TEXT:
        raise InputError(f"expression {_shown(source)} has {len(source)} characters, {LONGEST_TEXT} at most")
    good = _ALLOWED.match(source)
    end = good.end() if good else 0
    if end < len(source):
        raise InputError(f"expression {_shown(source)} has the character {source[end]!r} at column {end + 1}")
    if found := re.search(r"(?<![A-Za-z0-9_])[0-9.]+_", source):
        raise InputError(f"expression {_shown(source)} has an underscore in a number at column {found.start() + 1}")
    depth = deepest = 0
    for character in source:
        depth += (character == "(") - (character == ")")
        deepest = max(deepest, depth)
    if deepest > DEEPEST:
        raise InputError(f"expression {_shown(source)} has {deepest} levels of parentheses, {DEEPEST} at most")


def _shown(source: str) -> str:
    return repr(source if len(source) <= 60 else source[:60] + "…")


class _Reader:
    """Walks Python's tree once, counting nodes and levels, and builds ours."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.nodes = 0

    def read(self, node: ast.expr, level: int) -> Node:
        self.nodes += 1
        if self.nodes > MOST_NODES:
            raise InputError(
                f"expression {_shown(self.source)} has over {MOST_NODES} nodes; name parts of it in definitions"
            )
        if level > DEEPEST:
            raise InputError(
                f"expression {_shown(self.source)} has over {DEEPEST} levels (a sum has one for each term);"
                " name parts of it in definitions"
            )
        column = node.col_offset + 1
        match node:
            case ast.Constant(value=value) if isinstance(value, int | float) and not isinstance(value, bool):
                return Number(self._finite(value, column), column)
            case ast.Name():
                return Name(node.id, column)
            case ast.UnaryOp(op=ast.USub()):
                return Negative(self.read(node.operand, level + 1), column)
            case ast.UnaryOp(op=ast.UAdd()):
                return self.read(node.operand, level + 1)
            case ast.BinOp() if type(node.op) in _BINARY:
                operator = _BINARY[type(node.op)]
                pair = self.read(node.left, level + 1), self.read(node.right, level + 1)
                if operator == "**":
                    self._check_exponent(pair[1], column)
                return Binary(operator, *pair, column)
            case ast.Call(func=ast.Name(id=function), keywords=[]):
                return self._call(function, node, level)
        raise self._fault(column, "there is something that is no part of the language")

    def _call(self, function: str, node: ast.Call, level: int) -> Node:
        column = node.col_offset + 1
        if function not in FUNCTIONS:
            raise self._fault(column, f"function '{function}' is not known; there are {', '.join(FUNCTIONS)}")
        needed, got = FUNCTIONS[function], len(node.args)
        if got != needed and not (function in ("min", "max") and got > needed):
            raise self._fault(column, f"function '{function}' takes {needed} arguments, got {got}")
        if function == "where":
            condition = self._comparison(node.args[0], level + 1)
            return Call("where", (condition, *(self.read(one, level + 1) for one in node.args[1:])), column)
        return Call(function, tuple(self.read(one, level + 1) for one in node.args), column)

    def _comparison(self, node: ast.expr, level: int) -> Node:
        self.nodes += 1
        column = node.col_offset + 1
        if not isinstance(node, ast.Compare) or len(node.ops) != 1 or type(node.ops[0]) not in _COMPARE:
            raise self._fault(column, "the first argument of 'where' must be one comparison, like 'y > 0*metre'")
        operator = _COMPARE[type(node.ops[0])]
        return Compare(operator, self.read(node.left, level), self.read(node.comparators[0], level), column)

    def _check_exponent(self, node: Node, column: int) -> None:
        exponent = exponent_of(node)
        if exponent is None:
            raise self._fault(column, "an exponent must be a constant, like 2, -1, 0.5 or (3/2)")
        if abs(exponent) > LARGEST_EXPONENT:
            raise self._fault(column, f"exponent {exponent} is over {LARGEST_EXPONENT} in size")

    def _finite(self, value: float, column: int) -> float:
        try:
            number = float(value)
        except OverflowError:
            number = float("inf")
        if not isfinite(number):
            raise self._fault(column, "a number is not finite")
        return number

    def _fault(self, column: int, what: str) -> InputError:
        return InputError(f"expression {_shown(self.source)}, column {column}: {what}")
