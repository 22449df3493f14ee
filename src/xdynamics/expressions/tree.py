"""The syntax tree: six kinds of node, compared and hashed by what they say."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from fractions import Fraction

# function name -> number of arguments; min and max take two or more
FUNCTIONS = {
    "abs": 1, "sign": 1, "sqrt": 1, "exp": 1, "log": 1, "sin": 1, "cos": 1, "tan": 1, "asin": 1, "acos": 1,
    "atan": 1, "atan2": 2, "sinh": 1, "cosh": 1, "tanh": 1, "hypot": 2, "min": 2, "max": 2, "where": 3,
}  # fmt: skip


@dataclass(frozen=True)
class Number:
    """A non-negative finite literal, or `pi`'s value in a derived tree."""

    value: float
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Name:
    """A declared name, `t`, `pi` or a unit constant."""

    name: str
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Negative:
    """Unary minus."""

    operand: Node
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Binary:
    """One of ``+ - * / **``."""

    operator: str
    left: Node
    right: Node
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Compare:
    """A comparison, found only as the first argument of `where`."""

    operator: str
    left: Node
    right: Node
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Call:
    """A function of the language with its arguments."""

    function: str
    arguments: tuple[Node, ...]
    column: int = field(default=0, compare=False)


Node = Number | Name | Negative | Binary | Compare | Call

_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "**": 4}


def children(node: Node) -> tuple[Node, ...]:
    """Return the nodes right below a node."""
    match node:
        case Negative():
            return (node.operand,)
        case Binary() | Compare():
            return (node.left, node.right)
        case Call():
            return node.arguments
    return ()


def free_names(node: Node) -> set[str]:
    """Return every name an expression mentions."""
    if isinstance(node, Name):
        return {node.name}
    return set().union(*(free_names(child) for child in children(node)))


def size(node: Node) -> int:
    """Count the nodes."""
    return 1 + sum(size(child) for child in children(node))


def text_of(node: Node) -> str:
    """Print an expression so that parsing it again gives the same tree."""
    match node:
        case Number():
            whole = node.value == int(node.value) and node.value < 1e15
            return str(int(node.value)) if whole else repr(node.value)
        case Name():
            return node.name
        case Negative():
            return f"-{_wrapped(node.operand, 3)}"
        case Call():
            return f"{node.function}({', '.join(text_of(argument) for argument in node.arguments)})"
        case Compare():
            return f"{text_of(node.left)} {node.operator} {text_of(node.right)}"
        case Binary(operator="**"):
            return f"{_wrapped(node.left, 5)}**{_wrapped(node.right, 3)}"
        case Binary():
            strength = _STRENGTH[node.operator]
            gap = " " if strength == 1 else ""
            return f"{_wrapped(node.left, strength)}{gap}{node.operator}{gap}{_wrapped(node.right, strength + 1)}"


def digest(node: Node) -> str:
    """sha256 of the printed expression."""
    return hashlib.sha256(text_of(node).encode()).hexdigest()


def exponent_of(node: Node) -> Fraction | None:
    """Return the value of a constant exponent (``2``, ``-1``, ``0.5``, ``3/2``), exact; None if it is none."""
    match node:
        case Number():
            return Fraction(repr(node.value))
        case Negative():
            inner = exponent_of(node.operand)
            return None if inner is None else -inner
        case Binary(operator="/", left=Number() | Negative(), right=Number(value=value)) if value:
            above = exponent_of(node.left)
            return None if above is None else above / Fraction(repr(value))
    return None


def _wrapped(node: Node, needed: int) -> str:
    """Print with parentheses where the node binds weaker than its place needs."""
    strength = 6
    if isinstance(node, Binary):
        strength = _STRENGTH[node.operator]
    elif isinstance(node, Negative):
        strength = 3
    text = text_of(node)
    return f"({text})" if strength < needed else text


def limits_domain(node: Node) -> bool:
    """Whether an expression has a function that is not defined for every argument."""
    if isinstance(node, Call) and node.function in ("sqrt", "log", "asin", "acos"):
        return True
    if isinstance(node, Binary) and node.operator == "**":
        exponent = exponent_of(node.right)
        if exponent is None or exponent.denominator != 1:
            return True
    return any(limits_domain(child) for child in children(node))
