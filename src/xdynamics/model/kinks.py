"""Kinks and jumps of expressions: the functions that are zero there, and the smooth expressions beside them.

Functions are listed from the inside out. On known sides of its switches an expression is smooth: its signs and
comparisons become numbers of the march.

At ticks, `floor`, `ceil`, `round` and `mod` count an argument that is a whole number to rounding as whole. A tick at
60 us is three periods of 20 us, and 60e-6/20e-6 is 2.9999999999999996. In forces the switches of these functions have
the same margin (`kinks.jump_function`). Comparisons of their results have the same margin too: ``mod(t, T) < T/2`` is
false at a tick in the middle of a period.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from xdynamics.expressions import CALLED_ALONE, Along, Binary, Call, Compare, Name, Negative, Node, Number, chain
from xdynamics.expressions.calculus import ONE, TWO, ZERO
from xdynamics.expressions.tree import children, every, exponent_of

JUMPING = ("sign", "where", *CALLED_ALONE)
SWITCHING = ("abs", "min", "max", *JUMPING)


_ROUNDING = Number(1e-15)


# The conditions for a switch to have an effect: comparisons of the `where`s around it, each with its required truth.
Path = tuple[tuple[Compare, bool], ...]


def jump_function(node: Call) -> Node:
    """Return the function that passes through zero where `floor`, `ceil`, `round` or `mod` jumps.

    It is positive where the whole number is even. The small terms put a whole number, where sines and cosines of
    multiples of pi are off by rounding, on its own side; they move a jump by less than 1e-15 of the argument.
    """
    u = rounded_argument(node.function, node.arguments)
    far = Call("hypot", (ONE, u))
    if node.function == "round":
        return Binary("+", Call("cos", (Binary("*", Name("pi"), u),)), Binary("*", _ROUNDING, far))
    return Call("sin", (Binary("+", Binary("*", Name("pi"), u), Binary("*", _ROUNDING, Binary("-", far, ONE))),))


def rounded_argument(function: str, arguments: tuple[Node, ...]) -> Node:
    """Return the argument of the rounding in `floor`, `ceil`, `round` or `mod`."""
    if function == "mod":
        return Binary("/", arguments[0], arguments[1])
    return Negative(arguments[0]) if function == "ceil" else arguments[0]


def original_call(function: str, node: Node) -> Call:
    """Return the call of `floor`, `ceil`, `round` or `mod` as it was written, from its `jump_function`."""
    wave = node.left if isinstance(node, Binary) else node
    assert isinstance(wave, Call)  # noqa: S101 - as `jump_function` makes it
    angle = wave.arguments[0]
    assert isinstance(angle, Binary)  # noqa: S101
    product = angle if function == "round" else angle.left
    assert isinstance(product, Binary)  # noqa: S101
    u = product.right
    if function == "mod" and isinstance(u, Binary):
        return Call("mod", (u.left, u.right))
    return Call(function, (u.operand if function == "ceil" and isinstance(u, Negative) else u,))


FLATTEST = 100  # repetitions of a factor: of higher powers no method sees where they are not smooth
Kink = tuple[str, Node, bool, int, Path, int]


def kinks(node: Node, path: Path = (), factors: tuple[Node, ...] = ()) -> Iterator[Kink]:
    """Yield the switches of a tree from the inside out.

    Each is the name of a function, the expression that passes through zero, whether there is a jump, the side of zero,
    the `where`s around it, and the derivative that jumps: ``v*abs(v)`` is flatter at zero than ``abs(v)``.

    Parameters
    ----------
    node : Node
    path : Path
        The `where`s around the node.
    factors : tuple of Node
        What the node is multiplied by.
    """
    if isinstance(node, Binary):
        yield from _kinks_of_chain(node, path, factors)
        return
    condition = node.arguments[0] if isinstance(node, Call) and node.function == "where" else None
    if isinstance(condition, Compare):
        branches = children(node)[1:]
        yield from kinks(condition, path)
        bounded = condition.operator in ("==", "!=")  # of a moving value, these change at single instants only
        for part, holds in zip(branches, (True, False), strict=True):
            yield from kinks(part, path if bounded else (*path, (condition, holds)), factors)
    else:
        for part in children(node):
            yield from kinks(part, path, factors if isinstance(node, Negative) else ())
    if not isinstance(node, Call):
        return
    for function, jumps, at_zero in kinks_of_call(node):
        continuous = (
            not jumps or any(_vanishes(factor, function) for factor in factors) or _branches_vanish(node, function)
        )
        flatness = int(not jumps or _branches_vanish(node, function)) + sum(factor == function for factor in factors)
        yield node.function, function, not continuous, at_zero, path, flatness


def _branches_vanish(node: Call, function: Node) -> bool:
    """Whether both branches of a `where` are zero at its switch: its value has a kink there, and no jump."""
    return node.function == "where" and all(_vanishes(branch, function) for branch in node.arguments[1:])


_WITH_ARGUMENT = ("abs", "sqrt", "sin", "tan", "asin", "atan", "sinh", "tanh", "min", "max", "hypot")


def _vanishes(node: Node, function: Node) -> bool:
    """Whether an expression is seen to be zero where the function of a switch is."""
    if node == function or _is_zero(node):
        return True
    match node:
        case Negative():
            return _vanishes(node.operand, function)
        case Binary(operator="*"):
            return _vanishes(node.left, function) or _vanishes(node.right, function)
        case Binary(operator="/"):
            return _vanishes(node.left, function)
        case Binary(operator="**"):
            exponent = exponent_of(node.right)
            return exponent is not None and exponent > 0 and _vanishes(node.left, function)
        case Binary() if _vanishes(node.left, function) and _vanishes(node.right, function):
            return True
        case Call() if node.function in _WITH_ARGUMENT:
            return all(_vanishes(argument, function) for argument in node.arguments)
    return _is_difference(node, function)


def _is_difference(node: Node, function: Node) -> bool:
    """Whether a function is that of a comparison of an expression with zero, or of both sides of a difference."""
    if not (isinstance(function, Binary) and function.operator == "-"):
        return isinstance(function, Negative) and node == function.operand
    left, right = function.left, function.right
    if isinstance(node, Binary) and node.operator == "-":
        return (node.left, node.right) == (right, left)
    return (_is_zero(right) and _is_difference_side(node, left)) or (
        _is_zero(left) and _is_difference_side(node, right)
    )


def _is_difference_side(node: Node, side: Node) -> bool:
    return node == (side.operand if isinstance(side, Negative) else side)


def _is_zero(node: Node) -> bool:
    """Whether an expression is written as zero: ``0*metre``."""
    match node:
        case Number():
            return node.value == 0.0
        case Negative():
            return _is_zero(node.operand)
        case Binary(operator="*" | "/"):
            return _is_zero(node.left) or (node.operator == "*" and _is_zero(node.right))
    return False


def _kinks_of_chain(node: Binary, path: Path, factors: tuple[Node, ...]) -> Iterator[Kink]:
    """Yield the switches of sums, and of products, where a factor can make a switch of another flatter."""
    first, links = chain(node)
    pending = [factors]  # the factors that the value up to each link is multiplied by, from the last link to the first
    for link in reversed(links):
        right_factors = _repeated_factors(link.right) if link.operator == "*" else ()
        pending.append(() if link.operator == "**" else (*pending[-1], *right_factors))
    yield from kinks(first, path, pending.pop())
    for link in links:
        factors_after = pending.pop()
        link_factors = (*factors_after, *_repeated_factors(link.left)) if link.operator == "*" else factors_after
        yield from kinks(link.right, path, link_factors if link.operator in "+-*" else ())


def _repeated_factors(node: Node) -> Iterator[Node]:
    """Yield the factors of a product, those of integer powers repeated; the product itself is included."""
    waiting = [node]
    while waiting:
        factor = waiting.pop()
        yield factor
        match factor:
            case Negative():
                waiting.append(factor.operand)
            case Binary(operator="*"):
                waiting += [factor.right, factor.left]
            case Binary(operator="/"):
                waiting.append(factor.left)
            case Binary(operator="**", right=Number(power)):
                yield from [factor.left] * min(int(power), FLATTEST)


def kinks_of_call(node: Call) -> Iterator[tuple[Node, bool, int]]:
    """Yield the functions of the switches of a call itself, whether there is a jump, and the side of zero."""
    if node.function in ("abs", "sign"):
        yield node.arguments[0], node.function == "sign", 1
    elif node.function in CALLED_ALONE:
        yield jump_function(node), True, 1
    elif node.function in ("min", "max"):
        *earlier_arguments, last = node.arguments
        for i, argument in enumerate(earlier_arguments):
            later_arguments = (*earlier_arguments[i + 1 :], last)
            yield (
                Binary(
                    "-",
                    argument,
                    later_arguments[0] if len(later_arguments) == 1 else Call(node.function, later_arguments),
                ),
                False,
                1,
            )
    elif node.function == "where":
        condition = node.arguments[0]
        if isinstance(condition, Compare) and condition.operator not in ("==", "!="):
            yield Binary("-", condition.left, condition.right), True, 1 if condition.operator in ("<", ">=") else -1


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
        """Return the sides inside a choice that the side of a function decides."""
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
                # a side is 1 or -1 and never zero, so that <= says the same as <
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
        """Restrict an argument to its domain, where the march holds a side that the motion has left."""
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
        """Return one tree where the motion is on the sides that the march holds, another where it has left one."""
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
    """Write `floor`, `ceil`, `round` and `mod` on a known side: by the near even, or odd, whole number."""
    shifted_side = Binary("+", ONE, side_name) if function == "round" else side_name
    halves = Binary("+", Binary("/", rounded_argument(function, inner), TWO), Binary("/", shifted_side, Number(4.0)))
    odd = Binary("/", Binary("-", ONE, side_name), TWO)
    whole_number = Binary("+", Binary("*", TWO, Call("floor", (halves,))), odd)
    if function == "mod":
        return Binary("-", inner[0], Binary("*", inner[1], whole_number))
    return Negative(whole_number) if function == "ceil" else whole_number


ROUNDING = Number(1e-15)  # of the sizes of what is added up


def with_whole_numbers(node: Node) -> Node:
    """Return an expression whose `floor`, `ceil`, `round`, `mod` take nearly whole numbers as whole."""
    match node:
        case Negative():
            return Negative(with_whole_numbers(node.operand), node.column)
        case Binary():
            first, links = chain(node)
            tree = with_whole_numbers(first)
            for part in links:
                tree = Binary(part.operator, tree, with_whole_numbers(part.right), part.column)
            return tree
        case Compare():
            inner = replace(node, left=with_whole_numbers(node.left), right=with_whole_numbers(node.right))
            return _compare_rounded(inner, node) if _counts_whole_numbers(node) else inner
        case Call() | Along():
            call = replace(node, arguments=tuple(map(with_whole_numbers, node.arguments)))
            if not isinstance(call, Call) or not isinstance(node, Call):
                return call
            if call.function == "sign" and _counts_whole_numbers(node):
                near = Compare("<=", Call("abs", call.arguments), _margin(node.arguments[0]))
                return Call("where", (near, ZERO, call))
            return _settle_call(call, node) if call.function in CALLED_ALONE else call
    return node


def _counts_whole_numbers(node: Node) -> bool:
    """Whether an expression has `floor`, `ceil`, `round` or `mod` anywhere."""
    return any(isinstance(part, Call) and part.function in CALLED_ALONE for part in every(node))


def _compare_rounded(inner: Compare, node: Compare) -> Compare:
    """Return a comparison in which both sides are equal if they are so to rounding."""
    difference, margin = Binary("-", inner.left, inner.right), _margin(Binary("-", node.left, node.right))
    match node.operator:
        case "<" | ">=":
            return Compare(node.operator, difference, Negative(margin))
        case "==" | "!=":
            return Compare("<=" if node.operator == "==" else ">", Call("abs", (difference,)), margin)
    return Compare(node.operator, difference, margin)


def _settle_call(call: Call, node: Call) -> Node:
    """Return a call that is decided where its argument is nearly whole; for `round` where twice it is."""
    u, plain = rounded_argument(call.function, call.arguments), rounded_argument(node.function, node.arguments)
    number, margin = (
        (Binary("*", TWO, u), Binary("*", TWO, _margin(plain))) if call.function == "round" else (u, _margin(plain))
    )
    nearest = Call("round", (number,))
    near = Compare("<=", Call("abs", (Binary("-", number, nearest),)), margin)
    settled_value: Node = nearest
    if call.function == "mod":
        settled_value = Binary("*", ZERO, call.arguments[1])
    elif call.function == "round":  # the even one of two equally near ones
        settled_value = Call("round", (Binary("/", nearest, TWO),))
    elif call.function == "ceil":
        settled_value = Negative(nearest)
    return Call("where", (near, settled_value, call))


def _margin(node: Node) -> Node:
    """Return how far rounding may have moved an expression."""
    return Binary("*", ROUNDING, _size_of_terms(node))


def _size_of_terms(node: Node) -> Node:
    """Return the sum of the sizes of an expression's terms, before whole numbers are subtracted."""
    match node:
        case Negative():
            return _size_of_terms(node.operand)
        case Binary(operator="+" | "-"):
            return Binary("+", _size_of_terms(node.left), _size_of_terms(node.right))
        case Binary(operator="*"):
            return Binary("*", _size_of_terms(node.left), _size_of_terms(node.right))
        case Binary(operator="/"):
            return Binary("/", _size_of_terms(node.left), Call("abs", (node.right,)))
        case Call(function="mod"):
            return Binary("+", _size_of_terms(node.arguments[0]), Call("abs", (node.arguments[1],)))
        case Call(function="floor" | "ceil" | "round"):
            return Binary("+", _size_of_terms(node.arguments[0]), ONE)
    return Call("abs", (node,))
