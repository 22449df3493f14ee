"""Expressions on known sides of their switches: smooth, where signs and comparisons become numbers of the march."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from xdynamics.expressions import CALLED_ALONE, Binary, Call, Compare, Name, Negative, Node, Number, chain
from xdynamics.expressions.calculus import ONE, TWO, ZERO
from xdynamics.expressions.tree import exponent_of
from xdynamics.model.kinks import jump_function, kinks, rounded_argument

FAR = Number(1e300)  # bounds nothing
# The least and the greatest argument with a value; a logarithm has none at zero itself.
DOMAINS: Mapping[str, tuple[Node, Node | None]] = {
    "sqrt": (ZERO, None),
    "log": (Number(1e-300), None),
    "asin": (Negative(ONE), ONE),
    "acos": (Negative(ONE), ONE),
}


def on_sides(node: Node, sides: Mapping[Node, str]) -> Node:
    """Substitute sides for signs and comparisons.

    Roots and what else has no value beyond some argument keep the value at its end where the motion has passed a switch
    whose side is held: a step that is landed a rounding beyond ``max(-x, 0*metre)**1.5`` would have no force otherwise.
    """
    return _Sides(sides, ()).substitute(node)


@dataclass(frozen=True)
class _Sides:
    """Names of sides by the functions of switches, and the functions of those that decide whether a node counts."""

    names: Mapping[Node, str]
    around: tuple[Node, ...]

    def with_decider(self, function: Node) -> _Sides:
        """Return the same inside of what the side of a function decides."""
        return self if function in self.around else _Sides(self.names, (*self.around, function))

    def substitute(self, node: Node) -> Node:
        """Substitute sides in a tree."""
        if isinstance(node, Binary):
            first, links = chain(node)
            tree = self.substitute(first)
            for child in links:
                if is_root(child):
                    tree = self._continued(child.left, tree, (ZERO, None))
                tree = Binary(child.operator, tree, self.substitute(child.right), child.column)
            return tree
        if isinstance(node, Negative):
            return Negative(self.substitute(node.operand), node.column)
        if isinstance(node, Compare):
            return Compare(node.operator, self.substitute(node.left), self.substitute(node.right), node.column)
        return self._substitute_call(node) if isinstance(node, Call) else node

    def _substitute_call(self, node: Call) -> Node:
        if node.function in ("min", "max"):
            return self._extremum(node)
        condition = node.arguments[0]
        if node.function == "where" and isinstance(condition, Compare):
            function = Binary("-", condition.left, condition.right)
            if function in self.names:
                inner_sides, decided = self.with_decider(function), Name(self.names[function])
                arms = map(inner_sides.substitute, node.arguments[1:])
                return Call("where", (Compare(condition.operator[0], decided, ZERO), *arms), node.column)
        inner = tuple(map(self.substitute, node.arguments))
        if node.function in ("abs", "sign") and condition in self.names:
            side_name = Name(self.names[condition])
            return side_name if node.function == "sign" else Binary("*", side_name, inner[0])
        if node.function in CALLED_ALONE and (name := self.names.get(jump_function(node))) is not None:
            return _whole_on_side(node.function, inner, Name(name))
        if node.function in DOMAINS:
            inner = (self._continued(condition, inner[0], DOMAINS[node.function]),)
        return Call(node.function, inner, node.column)

    def _extremum(self, node: Call) -> Node:
        """Write min and max as `where`, as far as their sides are known."""
        extremum, later_arguments = self.substitute(node.arguments[-1]), node.arguments[-1:]
        for argument in reversed(node.arguments[:-1]):
            best = later_arguments[0] if len(later_arguments) == 1 else Call(node.function, later_arguments)
            side_name = self.names.get(Binary("-", argument, best))
            if side_name is None:
                extremum = Call(node.function, (self.substitute(argument), extremum))
            else:
                condition = Compare("<" if node.function == "min" else ">", Name(side_name), ZERO)
                extremum = Call("where", (condition, self.substitute(argument), extremum))
            later_arguments = (argument, *later_arguments)
        return extremum

    def _continued(self, plain: Node, argument: Node, domain: tuple[Node, Node | None]) -> Node:
        """Keep an argument inside of a domain where a side is held that the motion has left."""
        functions = dict.fromkeys((*self.around, *self._switch_functions(plain)))
        if not functions:
            return argument
        lower_bound, greatest = domain
        argument = Call("max", (argument, self._where_held(functions, Negative(FAR), lower_bound)))
        return argument if greatest is None else Call("min", (argument, self._where_held(functions, FAR, greatest)))

    def _switch_functions(self, plain: Node) -> Iterator[Node]:
        """Yield the functions of the switches of an expression."""
        return (function for _, function, *_ in kinks(plain) if function in self.names)

    def _where_held(self, functions: Mapping[Node, None], agreed: Node, left: Node) -> Node:
        """Return one tree where the motion is on the sides that are held, another where it has left one of them."""
        tree = agreed
        for function in functions:
            distance = Binary("*", Name(self.names[function]), function)
            tree = Call("where", (Compare(">", distance, ZERO), tree, left))
        return tree


def is_root(node: Binary) -> bool:
    """Whether a power has no value of a negative base."""
    exponent = exponent_of(node.right) if node.operator == "**" else None
    return exponent is not None and exponent.denominator != 1


def _whole_on_side(function: str, inner: tuple[Node, ...], side_name: Name) -> Node:
    """Write `floor`, `ceil`, `round` and `mod` for a known side: the even, or odd, whole number that is near."""
    shifted_side = Binary("+", ONE, side_name) if function == "round" else side_name
    halves = Binary("+", Binary("/", rounded_argument(function, inner), TWO), Binary("/", shifted_side, Number(4.0)))
    odd = Binary("/", Binary("-", ONE, side_name), TWO)
    whole_number = Binary("+", Binary("*", TWO, Call("floor", (halves,))), odd)
    if function == "mod":
        return Binary("-", inner[0], Binary("*", inner[1], whole_number))
    return Negative(whole_number) if function == "ceil" else whole_number
