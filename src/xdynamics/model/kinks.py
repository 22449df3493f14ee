"""Where expressions have kinks and jumps: the functions that pass through zero there, from the inside out."""

from __future__ import annotations

from collections.abc import Iterator

from xdynamics.expressions import CALLED_ALONE, Binary, Call, Compare, Name, Negative, Node, Number, chain
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.tree import children, exponent_of

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
    """Return what is rounded down, or to the nearest whole number."""
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
    yield node
    if isinstance(node, Negative):
        yield from _repeated_factors(node.operand)
    elif isinstance(node, Binary) and node.operator == "*":
        yield from _repeated_factors(node.left)
        yield from _repeated_factors(node.right)
    elif isinstance(node, Binary) and node.operator == "/":
        yield from _repeated_factors(node.left)
    elif isinstance(node, Binary) and node.operator == "**" and isinstance(node.right, Number):
        yield from [node.left] * int(node.right.value)


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
