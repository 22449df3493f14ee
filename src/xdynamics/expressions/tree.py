"""The syntax tree of expressions: eight kinds of node, compared and hashed by content.

Two of them, `Element` and `Along`, are for quantities with dimensions; in the trees of single elements they do not
occur.

A sum or product of n terms is n - 1 binary nodes, each the left operand of the next. Code that descends a tree handles
such a chain in a loop, by `chain`, so a sum may have any length; only nesting costs a level of recursion.

The language has comparisons as the first argument of `where` alone. Conditions joined by `and` or `or`, and
their opposites, are therefore written as choices within choices.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache

from xdynamics.faults import InputError
from xdynamics.units.unit import decimal_text

# function name -> number of arguments; min and max take two or more
FUNCTIONS = {
    "abs": 1,
    "sign": 1,
    "sqrt": 1,
    "exp": 1,
    "log": 1,
    "sin": 1,
    "cos": 1,
    "tan": 1,
    "asin": 1,
    "acos": 1,
    "atan": 1,
    "atan2": 2,
    "sinh": 1,
    "cosh": 1,
    "tanh": 1,
    "hypot": 2,
    "min": 2,
    "max": 2,
    "where": 3,
    "floor": 1,
    "ceil": 1,
    "round": 1,
    "mod": 2,
}
DELAYED = "delayed"  # the call of a value before now: what, and how long before
CALLED_ALONE = ("floor", "ceil", "round", "mod")  # functions before a parenthesis only: as names they stay free


@dataclass(frozen=True)
class Number:
    """A non-negative finite literal, or `pi`'s value in a derived tree."""

    value: float
    column: int = field(default=0, compare=False)


# what is done along named dimensions or relations: numbers of values, of dimensions (None: one or more), of whole numbers
ALONG: dict[str, tuple[int, int | None, int]] = {
    "sum": (1, None, 0),
    "mean": (1, None, 0),
    "min": (1, None, 0),
    "max": (1, None, 0),
    "norm": (1, None, 0),
    "dot": (2, 1, 0),
    "cross": (2, 1, 0),
    "first": (1, 1, 0),
    "second": (1, 1, 0),
    "shift": (1, 1, 1),  # and what stands beyond the end
    "roll": (1, 1, 1),
    "take": (1, 1, 0),  # and the number of the element
    "index": (0, 1, 0),
    "size": (0, 1, 0),
}


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


# the methods that dataclass makes would descend a chain by recursion
@dataclass(frozen=True, eq=False, repr=False)
class Binary:
    """One of ``+ - * / **``."""

    operator: str
    left: Node
    right: Node
    column: int = field(default=0, compare=False)

    def __eq__(self, node: object) -> bool:
        if not isinstance(node, Binary):
            return NotImplemented
        if self is node:
            return True
        (first, links), (other_first, other_links) = chain(self), chain(node)
        return (
            len(links) == len(other_links)
            and first == other_first
            and all(a.operator == b.operator and a.right == b.right for a, b in zip(links, other_links, strict=True))
        )

    def __hash__(self) -> int:
        first, links = chain(self)
        return hash((first, *((link.operator, link.right) for link in links)))

    def __repr__(self) -> str:
        return f"<Binary {text_of(self)}>"

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle and copy a chain as a list, since both descend a tree by recursion."""
        first, links = chain(self)
        return _linked, (first, [(link.operator, link.right, link.column) for link in links])


@dataclass(frozen=True)
class Compare:
    """A comparison; it occurs only as the first argument of `where`."""

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


@dataclass(frozen=True)
class Element:
    """One element of a quantity with dimensions: ``r[Jupiter, x]``, ``u[-1]``; a label or a number for each of them."""

    name: str
    entries: tuple[str | int, ...]
    column: int = field(default=0, compare=False)


@dataclass(frozen=True)
class Along:
    """A function along named dimensions or relations: ``sum(a, body)``, ``first(r, pair)``, ``roll(u, site, -1)``.

    Attributes
    ----------
    function : str
        One of `ALONG`; with `min` and `max` a dimension is told from a value where dimensions are known. Derivatives
        have ``onto`` as well: what links give to the elements at their first and at their second ends.
    arguments : tuple of Node
        The values; the second is of `shift` what stands beyond the end, of `take` the number of the element.
    dims : tuple of str
        Dimensions, or a relation.
    places : int
        How far `shift` and `roll` go.
    """

    function: str
    arguments: tuple[Node, ...]
    dims: tuple[str, ...]
    places: int = 0
    column: int = field(default=0, compare=False)


Node = Number | Name | Negative | Binary | Compare | Call | Element | Along

_LONGEST_SHOWN = 400
# 3 is that of a unary minus
_STRENGTH = {"+": 1, "-": 1, "*": 2, "/": 2, "**": 4}


def children(node: Node) -> tuple[Node, ...]:
    """Return the nodes directly below a node."""
    match node:
        case Negative():
            return (node.operand,)
        case Binary() | Compare():
            return (node.left, node.right)
        case Call() | Along():
            return node.arguments
    return ()


def chain(node: Node) -> tuple[Node, list[Binary]]:
    """Split a chain of binary nodes into its first operand and the nodes from there up to `node`.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> first, links = chain(parse("a*b + c - d/e"))
    >>> text_of(first), [(link.operator, text_of(link.right)) for link in links]
    ('a', [('*', 'b'), ('+', 'c'), ('-', 'd/e')])
    """
    links = []
    while isinstance(node, Binary):
        links.append(node)
        node = node.left
    links.reverse()
    return node, links


def summands(tree: Node) -> list[Node]:
    """Return the terms of a sum, whose sizes show how much cancels.

    Examples
    --------
    >>> from xdynamics.expressions import parse, text_of
    >>> [text_of(term) for term in summands(parse("(x**2 - l**2)/2 - y"))]
    ['x**2/2', 'l**2/2', 'y']
    """
    match tree:
        case Negative():
            return summands(tree.operand)
        case Binary(operator="+" | "-"):
            return summands(tree.left) + summands(tree.right)
        case Binary(operator="*" | "/"):
            return [Binary(tree.operator, term, tree.right) for term in summands(tree.left)]
        case _:
            return [tree]


def every(node: Node) -> Iterator[Node]:
    """Yield a node and all below it, in no particular order."""
    waiting = [node]
    while waiting:
        current = waiting.pop()
        yield current
        waiting += children(current)


def free_names(node: Node) -> set[str]:
    """Return every name that an expression mentions."""
    return {leaf.name for leaf in every(node) if isinstance(leaf, Name | Element)}


def size(node: Node) -> int:
    """Count the nodes."""
    return sum(1 for _ in every(node))


def text_of(node: Node) -> str:
    """Print an expression so that parsing the text gives an equal tree."""
    match node:
        case Number():
            is_whole = node.value == int(node.value) and node.value < 1e15
            return str(int(node.value)) if is_whole else decimal_text(node.value)
        case Name():
            return node.name
        case Negative():
            return f"-{_parenthesise(node.operand, 3)}"
        case Call():
            return f"{node.function}({', '.join(text_of(argument) for argument in node.arguments)})"
        case Compare():
            return f"{text_of(node.left)} {node.operator} {text_of(node.right)}"
        case Element():
            return f"{node.name}[{', '.join(map(str, node.entries))}]"
        case Along():
            return _text_along(node)
        case Binary():
            return _text_of_chain(node)


def shortened_text(node: Node) -> str:
    """Print an expression for a message; a long one is shortened to its beginning and end."""
    text = text_of(node)
    return text if len(text) <= _LONGEST_SHOWN else f"{text[:60]} … {text[-60:]}"


def digest(node: Node) -> str:
    """sha256 of the printed expression."""
    return hashlib.sha256(text_of(node).encode()).hexdigest()


def exponent_of(node: Node) -> Fraction | None:
    """Return the exact value of a constant exponent (``2``, ``-1``, ``0.5``, ``3/2``); None if it is not one."""
    match node:
        case Number():
            return _exact_literal(node.value)
        case Negative():
            inner = exponent_of(node.operand)
            return None if inner is None else -inner
        case Binary(operator="/", left=Number() | Negative(), right=Number(value=value)) if value:
            numerator = exponent_of(node.left)
            return None if numerator is None else numerator / _exact_literal(value)
    return None


@lru_cache(maxsize=256)
def _exact_literal(value: float) -> Fraction:
    """Return a literal as the decimal number that it is written as."""
    return Fraction(repr(value))


def limits_domain(node: Node) -> bool:
    """Whether an expression has a function that is not defined for every argument."""
    return any(map(_limited, every(node)))


def _limited(node: Node) -> bool:
    if isinstance(node, Binary) and node.operator == "**":
        exponent = exponent_of(node.right)
        return exponent is None or exponent.denominator != 1
    return isinstance(node, Call | Along) and node.function in ("sqrt", "log", "asin", "acos", "norm")


def _text_along(node: Along) -> str:
    """Print a function along dimensions: values, dimensions, shift, and last the value beyond the end."""
    arity, _, numbers = ALONG.get(node.function, (len(node.arguments), 1, 0))
    values = [text_of(argument) for argument in node.arguments]
    words = [*values[:arity], *node.dims, *([str(node.places)] if numbers else []), *values[arity:]]
    return f"{node.function}({', '.join(words)})"


def _text_of_chain(node: Binary) -> str:
    """Print a chain from its first operand on; all parentheses on the left open before it."""
    first, links = chain(node)
    parts, opened, strength = [text_of(first)], 0, _strength(first)
    for link in links:
        strength_of_link = _STRENGTH[link.operator]
        # 5, as powers join from the right: (a**b)**c needs its parentheses
        if strength < (5 if link.operator == "**" else strength_of_link):
            parts.append(")")
            opened += 1
        gap = " " if strength_of_link == 1 else ""
        parts.append(
            f"{gap}{link.operator}{gap}{_parenthesise(link.right, 3 if link.operator == '**' else strength_of_link + 1)}"
        )
        strength = strength_of_link
    return "(" * opened + "".join(parts)


def _parenthesise(node: Node, needed: int) -> str:
    """Print a node with parentheses if it binds less tightly than its parent needs."""
    text = text_of(node)
    return f"({text})" if _strength(node) < needed else text


def _strength(node: Node) -> int:
    if isinstance(node, Binary):
        return _STRENGTH[node.operator]
    return 3 if isinstance(node, Negative) else 6


def _linked(first: Node, links: list[tuple[str, Node, int]]) -> Node:
    for operator, right, column in links:
        first = Binary(operator, first, right, column)
    return first


OPPOSITE = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
SIGNS = {"and": "&", "or": "|"}


@dataclass(frozen=True)
class Junction:
    """Two conditions, of which both have to hold, or one."""

    word: str
    left: Condition
    right: Condition


Condition = Compare | Junction


def is_condition(node: Node | Junction) -> bool:
    """Whether a tree holds or does not, rather than being a number."""
    return isinstance(node, Compare | Junction)


def junction(word: str, left: Node | Junction, right: Node | Junction) -> Junction:
    """Join two conditions.

    Raises
    ------
    InputError
        If one is a number.
    """
    if isinstance(left, Compare | Junction) and isinstance(right, Compare | Junction):
        return Junction(word, left, right)
    sign = SIGNS[word]
    raise InputError(
        f"the function joins by {sign} what is no comparison; put each in parentheses: (a > 0) {sign} (b > 0)"
    )


def opposite(node: Node | Junction) -> Condition:
    """Return the condition that holds where another does not.

    Raises
    ------
    InputError
        If it is a number.
    """
    if isinstance(node, Junction):
        return Junction("or" if node.word == "and" else "and", opposite(node.left), opposite(node.right))
    if isinstance(node, Compare):
        return Compare(OPPOSITE[node.operator], node.left, node.right)
    raise InputError("the function takes ~ of what is no comparison; write ~(a > 0)")


def choice_tree(condition: Node | Junction, yes: Node, no: Node) -> Node:
    """Return the tree of a choice."""
    if isinstance(condition, Junction):
        inner_choice = choice_tree(condition.right, yes, no)
        return (
            choice_tree(condition.left, inner_choice, no)
            if condition.word == "and"
            else choice_tree(condition.left, yes, inner_choice)
        )
    return Call("where", (condition, yes, no))


def truth_as_number(node: Node | Junction) -> Node:
    """Return a number as it is, and for a condition 1 where it holds, else 0, as Python counts truths."""
    return choice_tree(node, Number(1.0), Number(0.0)) if isinstance(node, Compare | Junction) else node
