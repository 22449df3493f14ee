"""Expressions as a list of operations in the order of evaluation, with common subexpressions computed once.

For evaluating the same long expressions many times without compiling them: derivatives of forces by many coordinates
share most of their parts. Every value has the bits that `evaluate` gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from fractions import Fraction
from functools import lru_cache
from typing import Any

from xdynamics.expressions.evaluation import FLOATS, rational_power
from xdynamics.expressions.tree import Binary, Call, Compare, Name, Negative, Node, Number, exponent_of
from xdynamics.faults import InputError

Operation = Callable[..., Any]


class Tape:
    """The operations of some expressions, each of which may use the names of those before it.

    Parameters
    ----------
    expressions : iterable of (str, Node)
        Names and what they stand for, with definitions expanded.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> tape = Tape([("r", parse("sqrt(x**2 + y**2)")), ("f", parse("x/r**3"))])
    >>> tape.evaluate_tape({"x": 3.0, "y": 4.0})
    {'r': 5.0, 'f': 0.024}
    """

    def __init__(self, expressions: Iterable[tuple[str, Node]]) -> None:
        self._inputs: dict[str, int] = {}  # names that need a value, and their places
        self._numbers: dict[int, float] = {}
        self._steps: list[tuple[Operation, int, tuple[int, ...]]] = []
        self._size = 0
        self._known: dict[Any, int] = {}  # places of equal operations
        self._seen: dict[int, tuple[int, Node]] = {}  # places of nodes, which live as long as this
        self._named: dict[str, int] = {}
        for name, tree in expressions:
            slot = self._slot_of(tree)
            if name in self._inputs or name in self._named:
                self._seen.clear()  # from here on the name means something else
            self._named[name] = slot
        self._seen.clear()
        self._known.clear()

    def evaluate_tape(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the value of each expression by its name.

        Raises
        ------
        InputError
            If a name has no value.
        """
        if missing := [name for name in self._inputs if name not in values]:
            raise InputError(f"name '{missing[0]}' has no value; there are {', '.join(values) or 'none'}")
        results: list[Any] = [0.0] * self._size
        for slot, number in self._numbers.items():
            results[slot] = number
        for name, slot in self._inputs.items():
            results[slot] = values[name]
        for operation, slot, operands in self._steps:
            results[slot] = operation(*[results[operand] for operand in operands])
        return {name: results[slot] for name, slot in self._named.items()}

    def _slot_of(self, node: Node) -> int:
        """Return the place of a node's value, after adding the operations that compute it."""
        links = []
        while isinstance(node, Binary) and id(node) not in self._seen:  # a sum may have any length
            links.append(node)
            node = node.left
        slot = self._seen[id(node)][0] if id(node) in self._seen else self._leaf_slot(node)
        for link in reversed(links):
            slot = self._link_slot(link, slot)
            self._seen[id(link)] = slot, link
        return slot

    def _leaf_slot(self, node: Node) -> int:
        """Return the place of the value of a node that is not binary."""
        slot = self._computed_slot(node)
        self._seen[id(node)] = slot, node
        return slot

    def _computed_slot(self, node: Node) -> int:
        match node:
            case Number():
                return self._number_slot(node.value)
            case Name():
                return self._named[node.name] if node.name in self._named else self._name_slot(node.name)
            case Negative():
                return self._operation_slot("negative", _negative, self._slot_of(node.operand))
            case Compare():
                operation = FLOATS.operators[node.operator]
                return self._operation_slot(
                    node.operator, operation, self._slot_of(node.left), self._slot_of(node.right)
                )
            case Call(function="where"):
                return self._operation_slot("where", _choose_branch, *map(self._slot_of, node.arguments))
            case Call(function="min" | "max"):
                first, *further_slots = map(self._slot_of, node.arguments)
                for next_slot in further_slots:
                    first = self._operation_slot(node.function, FLOATS.choices[node.function], first, next_slot)
                return first
            case Call():
                return self._operation_slot(
                    node.function, FLOATS.functions[node.function], *map(self._slot_of, node.arguments)
                )
        raise InputError(f"'{node}' is no expression")

    def _link_slot(self, node: Binary, left: int) -> int:
        if node.operator == "**":
            exponent = exponent_of(node.right) or Fraction(0)
            return self._operation_slot(exponent, _raised(exponent), left)
        return self._operation_slot(node.operator, FLOATS.operators[node.operator], left, self._slot_of(node.right))

    def _operation_slot(self, key: object, operation: Operation, *operands: int) -> int:
        signature = (key, *operands)
        if signature not in self._known:
            self._known[signature] = self._new_slot()
            self._steps.append((operation, self._known[signature], operands))
        return self._known[signature]

    def _number_slot(self, value: float) -> int:
        key = ("number", repr(value))  # 0.0 and -0.0 are equal
        if key not in self._known:
            self._known[key] = self._new_slot()
            self._numbers[self._known[key]] = value
        return self._known[key]

    def _name_slot(self, name: str) -> int:
        if name not in self._inputs:
            self._inputs[name] = self._new_slot()
        return self._inputs[name]

    def _new_slot(self) -> int:
        self._size += 1
        return self._size - 1


def _negative(value: float) -> float:
    return -value


def _choose_branch(truth: bool, yes: float, no: float) -> float:  # noqa: FBT001 - an operand like the others
    return yes if truth else no


@lru_cache(maxsize=256)
def _raised(exponent: Fraction) -> Operation:
    """Return the operation of a power; for the exponents of nearly all forces it avoids arithmetic of fractions."""
    if exponent < 0:
        above, quotient = _raised(-exponent), FLOATS.operators["/"]
        return lambda base: quotient(1.0, above(base))
    if exponent == 2:
        return lambda base: base * base
    if exponent == 3:
        return lambda base: base * base * base
    if exponent == Fraction(3, 2):
        root = FLOATS.functions["sqrt"]
        return lambda base: base * root(base)
    if exponent == Fraction(1, 2):
        return FLOATS.functions["sqrt"]
    return lambda base: rational_power(base, exponent, FLOATS)
